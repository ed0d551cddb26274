"""The indentation of Nyquist's contour at the origin: the arc s = radius e^(j theta), 0 <= theta <= pi/2, through which slow roots leave.

A root of 1 + f L on the arc at a real gain f needs L real there: Im H = 0, H = S - 1. At theta = 0 this always holds.
A root of 1 + e^(-s tau) L on the arc needs tau = ln|L| / Re s and arg(-L) = tau Im s. At theta = 0 it needs L < -1: of a stable loop that is
so where L has an odd number of real unstable poles, such as with a free position that one channel alone drives away and the others hold.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

FIRST = (0.0, 1e-4, 1e-3, 1e-2, 0.03)  #: angles on the arc: at 0 L is real, just above it a pair of roots may pass,
EVEN = 9  #: even ones,
AROUND = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])  #: and around each pole near it, in units of its distance
NEAR = 4.0  #: a pole within this factor of the radius lies near the arc
PARTS = 16  #: of a step between angles where dead time may move a root to the arc
BELOW = 1.5  #: logarithm by which L may be below one at an end of such a step
ON = 1e-6  #: distance of L from -1 up to which a root lies there

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
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
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
    point, channel, x, found = _zeros(theta, H, at, evaluate, lambda H, _: np.asarray(H.imag), np.ones((*H.shape[:2], H.shape[2] - 1), bool))
    m, n = H.shape[:2]
    every = np.indices((m, n)).reshape(2, -1)
    return Crossings(
        np.concatenate([every[0], point]), np.concatenate([every[1], channel]), np.concatenate([np.zeros(m * n), radius * np.sin(x)]),
        np.concatenate([H[..., 0].real.ravel().astype(np.complex128), found]),
    )  # fmt: skip


def arc_delays(radius: float, theta: Array, H: Complex, at: Place, evaluate: Evaluate, limit: Array) -> tuple[Crossings, Array]:
    """Places on the arc to which a dead time moves a root, with w = Im s [rad/s], and that dead time (k,) [s], as far as below ``limit`` (m, n).

    ``H`` as above.
    """

    def rate(theta: Array) -> Complex:
        return np.asarray(radius * np.exp(1j * theta), np.complex128)

    def missed(H: Complex, theta: Array) -> Array:
        return _missed(H, rate(theta))

    place = np.broadcast_to(rate(theta)[:, None], H.shape)
    delay = _delay(H, place)
    with np.errstate(divide="ignore", over="ignore"):
        may = (delay > -BELOW / place.real) & (delay < limit[..., None])
    point, channel, x, found = _zeros(theta, H, at, evaluate, missed, may[..., :-1] | may[..., 1:], PARTS)
    there, s = Crossings(point, channel, rate(x).imag, found), rate(x)
    delay = _delay(found, s)
    with np.errstate(invalid="ignore", over="ignore"):
        on = (delay > 0) & (np.abs(there.L * np.exp(-s * delay) + 1) < ON)
    point, channel = np.nonzero(H[..., 0].real < -1)  # L < -1
    real = H[point, channel, 0].real
    with np.errstate(divide="ignore", invalid="ignore"):
        late = -np.log1p(1 / real) / radius
    rest = there[on]
    every = Crossings(
        np.concatenate([rest.point, point]),
        np.concatenate([rest.channel, channel]),
        np.concatenate([rest.w, np.zeros(real.size)]),
        np.concatenate([rest.H, real.astype(np.complex128)]),
    )
    return every, np.concatenate([delay[on], late])


def _delay(H: Complex, s: Complex) -> Array:
    """[s] dead time with which abs(L e^(-s tau)) is 1."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(np.log(np.abs(H / (1 + H))) / s.real)


def _missed(H: Complex, s: Complex) -> Array:
    """Sine of the angle by which L with that dead time misses -1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(np.sin(np.angle(H / (1 + H)) - _delay(H, s) * s.imag)))


def _zeros(
    theta: Array, H: Complex, at: Place, evaluate: Evaluate, function: Callable[[Complex, Array], Array], where: Bools, parts: int = 1
) -> tuple[Ints, Ints, Array, Complex]:
    """Point, channel, angle and H of the sign changes above theta = 0 of a function of H and the angle, by the Illinois rule.

    ``where``: (m, n, k - 1) the steps of ``theta`` that matter, each searched in so many ``parts``.
    """
    point, channel, k = np.nonzero(where & (theta[:, None, :-1] > 0))
    a, b, at_a, at_b = theta[point, k], theta[point, k + 1], H[point, channel, k], H[point, channel, k + 1]
    if parts > 1:
        x = a[:, None] + (b - a)[:, None] * np.linspace(0, 1, parts + 1)[1:-1]
        inner = evaluate(np.repeat(point, parts - 1), np.repeat(channel, parts - 1), at(x.ravel())).reshape(x.shape)
        x, inner = np.column_stack([a, x, b]), np.column_stack([at_a, inner, at_b])
        point, channel = np.repeat(point, parts), np.repeat(channel, parts)
        a, b, at_a, at_b = x[:, :-1].ravel(), x[:, 1:].ravel(), inner[:, :-1].ravel(), inner[:, 1:].ravel()
    fa, fb = function(at_a, a), function(at_b, b)
    change = (fa >= 0) != (fb >= 0)
    point, channel, found = np.asarray(point[change], np.int64), np.asarray(channel[change], np.int64), at_b[change]
    a, b, fa, fb = (each[change] for each in (a, b, fa, fb))
    x, todo = b.copy(), np.arange(b.size)
    for _ in range(50):
        if not todo.size:
            break
        l, r, fl, fr = a[todo], b[todo], fa[todo], fb[todo]
        with np.errstate(divide="ignore", invalid="ignore"):
            secant = (l * fr - r * fl) / (fr - fl)
        x[todo] = try_ = np.where((secant > l) & (secant < r), secant, (l + r) / 2)
        found[todo] = h = evaluate(point[todo], channel[todo], at(try_))
        f = function(h, try_)
        right = (f >= 0) == (fr >= 0)
        a[todo], fa[todo] = np.where(right, l, try_), np.where(right, fl / 2, f)
        b[todo], fb[todo] = np.where(right, try_, r), np.where(right, f, fr / 2)
        todo = todo[~((np.abs(f) <= 1e-13 * np.abs(h)) | (b[todo] - a[todo] <= 1e-13))]
    return point, channel, x, found
