"""The indentation of Nyquist's contour at the origin: the arc s = radius e^(j theta), 0 <= theta <= pi/2, through which slow roots leave.

A root of 1 + f L on the arc at a real gain f needs L real there: Im H = 0, H = S - 1. At theta = 0 this always holds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.maths.arrays import Array, Complex, Ints

FIRST = (0.0, 1e-4, 1e-3, 1e-2, 0.03)  #: angles on the arc: at 0 L is real, just above it a pair of roots may pass,
EVEN = 9  #: even ones,
AROUND = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])  #: and around each pole near it, in units of its distance
NEAR = 4.0  #: a pole within this factor of the radius lies near the arc

Place = Callable[[Array], Complex]  # angles -> s (or w of a sampled loop)
Evaluate = Callable[[Ints, Ints, Complex], Complex]  # point, channel and s (k,) -> H (k,)


def places(radius: float, dt: float) -> Place:
    """The arc: s = radius e^(j theta), or tanh(s dt / 2) in the w plane of a sampled loop."""

    def at(theta: Array) -> Complex:
        s = radius * np.exp(1j * theta)
        return np.asarray(np.tanh(s * dt / 2) if dt else s, np.complex128)

    return at


def angles(poles: Complex, radius: float) -> Array:
    """(m, k) increasing angles in [0, pi/2] that resolve the poles (m, nx) [1/s] near the arc; some are repeated."""
    fixed = np.concatenate([FIRST, np.linspace(0, np.pi / 2, EVEN)[1:]])
    even = np.broadcast_to(fixed, (len(poles), len(fixed)))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(poles) / radius
        near = (ratio < NEAR) & (ratio > 1 / NEAR)
        around = np.abs(np.angle(poles))[..., None] + (np.abs(ratio - 1) + 1e-6)[..., None] * AROUND
    some = near.any(axis=0)
    around = np.where(near[..., None], around, 0.0)[:, some].reshape(len(poles), -1)
    return np.sort(np.concatenate([even, np.clip(around, 0, np.pi / 2)], axis=1), axis=1)


def arc_crossings(radius: float, theta: Array, H: Complex, at: Place, evaluate: Evaluate) -> Crossings:
    """All places on the arc ``at`` at which L is real, with w = Im s [rad/s].

    ``H``: (m, n, k) at the angles ``theta`` (m, k), of which the first is 0.
    """
    f = H.imag
    point, channel, k = np.nonzero(((f[..., 1:-1] >= 0) != (f[..., 2:] >= 0)) & (theta[:, None, 1:-1] > 0))
    a, b = theta[point, k + 1], theta[point, k + 2]
    fa, fb = f[point, channel, k + 1], f[point, channel, k + 2]
    x, found = b.copy(), H[point, channel, k + 2]
    for _ in range(50):
        with np.errstate(divide="ignore", invalid="ignore"):
            secant = (a * fb - b * fa) / (fb - fa)
        x = np.where((secant > a) & (secant < b), secant, (a + b) / 2)
        found = evaluate(point, channel, at(x))
        right = (found.imag >= 0) == (fb >= 0)
        fa, fb = np.where(right, fa / 2, found.imag), np.where(right, found.imag, fb / 2)
        a, b = np.where(right, a, x), np.where(right, x, b)
        if np.all((np.abs(found.imag) <= 1e-13 * np.abs(found)) | (b - a <= 1e-13)):
            break
    m, n = f.shape[:2]
    every = np.indices((m, n)).reshape(2, -1)
    return Crossings(
        np.concatenate([every[0], point]), np.concatenate([every[1], channel]), np.concatenate([np.zeros(m * n), radius * np.sin(x)]),
        np.concatenate([H[..., 0].real.ravel().astype(np.complex128), found]),
    )  # fmt: skip
