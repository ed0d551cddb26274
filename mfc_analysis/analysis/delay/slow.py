"""The slow part of a loop with dead time: the residues of its resolvent inside the circle abs(s) = 1/horizon.

With x(s) = R(s) x(0), R = (sI - A - B (I - E D)^-1 E C)^-1, the slow part of the response from x(0) (no signal in transit) is

    x_slow(t) = 1/(2 pi j) oint e^(st) R(s) ds  x(0),

by the trapezoidal rule on the circle, which converges exponentially. Its first two moments at t = 0 give the slow roots.

Source: Beyn, "An integral method for solving nonlinear eigenvalue problems", Linear Algebra Appl. 436 (2012), 3839-3863.
"""

from __future__ import annotations

import numpy as np

from mfc_analysis.analysis.delay.characteristic import Delayed
from mfc_analysis.analysis.slow import moving
from mfc_analysis.maths.arrays import Array, Complex

FEWEST, MOST = 64, 2048  #: points on the circle
AGREES = 1e-5  #: relative change of the transition at which no more points are taken


def slow_part(point: Delayed, radius: float, count: int) -> tuple[Complex, Array]:
    """The slow roots [1/s], at most ``count``, and (nx, nx) what keeps moving over the second half of the horizon 1/``radius``."""
    horizon, before = 1 / radius, None
    points = FEWEST
    while True:
        angles = np.pi * (np.arange(points // 2) + 0.5) / (points // 2)  # the upper half: the lower one is its conjugate
        s = np.asarray(radius * np.exp(1j * angles), np.complex128)
        R = _resolvent(point, s)
        whole, half = (_moment(R, s * np.exp(s * t)) for t in (horizon, horizon / 2))
        if (before is not None and np.abs(whole - before).max() <= AGREES * np.abs(whole).max()) or points >= MOST:
            break
        before, points = whole, 2 * points
    physical = point.scale[:, None] / point.scale
    U, size, Vh = np.linalg.svd(_moment(R, s))
    k = min(count, len(size), int(np.count_nonzero(size > 1e-10 * size[0])))
    block = U[:, :k].T @ _moment(R, s * s) @ (Vh[:k].T / size[:k])
    return np.linalg.eigvals(block).astype(np.complex128), moving(physical * whole, physical * half)


def _moment(R: Complex, weight: Complex) -> Array:
    return np.asarray((R * weight[:, None, None]).mean(axis=0).real)


def _resolvent(point: Delayed, s: Complex) -> Complex:
    z, slope = point.z(s)
    E = np.exp(-s[:, None] * point.T)[:, :, None]
    back = np.linalg.solve(np.eye(len(point.T)) - E * point.D, E * point.C)
    closed = z[:, None, None] * np.eye(len(point.A)) - point.A - point.B @ back
    try:
        return np.asarray(np.linalg.inv(closed) * slope[:, None, None])
    except np.linalg.LinAlgError:  # a root lies exactly on a point of the circle
        return _resolvent(point, s * (1 + 1e-9))
