"""The slow part of a loop over a horizon: the roots with abs(s) < 1/horizon, taken out as an invariant subspace.

Free positions, ramps and creep are slow: within the horizon they change nothing by a factor e, and neither rounding nor a model can tell
them from zero. No rank is decided; a root belongs to the slow part by its size alone.

With the ordered Schur form of the balanced A, diag(1/d) A diag(d) = U [S X; 0 F] U^T, and R from S R - R F = -X, the parts decouple:

    x = right x_slow + fast_right x_fast,     x_slow' = S x_slow,     x_fast' = F x_fast.

Source: Golub & Van Loan, Matrix Computations, 7.6 (reordering, Sylvester equation).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm, get_lapack_funcs

from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array

MOVES = 1e-3  #: [SI] an entry of the slow transition matrix below this is no motion
ALONG = 1e-6  #: of the largest change from the same start below which a state does not move along
KEEPS_MOVING = 1.5  #: times its value at half the horizon: a ramp doubles, a free position stays, a growth of 1/horizon is 1.6
LAPACK: Any = get_lapack_funcs(("gebal", "gees", "trsen", "trsyl"), dtype=np.float64)
WORK = 40  #: times the size of A: memory for LAPACK
MOVED = 2.0  #: factor by which a slow root may grow while it is sorted


@dataclass(frozen=True, eq=False)
class SlowPart:
    """k slow roots of one loop: x_slow(t) = ``at(t)`` x(0) in the physical states."""

    block: Array  #: (k, k) [1/s] S
    right: Array  #: (nx, k)
    left: Array  #: (k, nx), left @ right = I
    dt: float = 0.0  #: [s] of a sampled loop: S is (Z - I) / dt then

    def at(self, time: float) -> Array:
        """(nx, nx) transition matrix of the slow part over ``time`` [s]."""
        return np.asarray(self.right @ self._transition(time) @ self.left)

    def _transition(self, time: float) -> Array:
        if self.dt:
            return np.asarray(np.linalg.matrix_power(np.eye(len(self.block)) + self.dt * self.block, max(0, round(time / self.dt))), float)
        return np.asarray(expm(self.block * time), float)

    def integral(self, time: float) -> Array:
        """(k, k) integral of the transition matrix of x_slow over ``time`` [s]: x_slow after a unit step of each of its rates."""
        k = len(self.block)
        chain = np.zeros((2 * k, 2 * k))
        chain[:k, :k], chain[:k, k:] = self.block, np.eye(k)
        if self.dt:
            return np.asarray(np.linalg.matrix_power(np.eye(2 * k) + self.dt * chain, max(0, round(time / self.dt)))[:k, k:], float)
        return np.asarray(expm(chain * time)[:k, k:], float)

    def moves(self, horizon: float) -> Array:
        """(nx, nx) what keeps moving within the horizon [s]: the change of the transition over its second half, 0 where nothing does."""
        half = self._transition(horizon / 2)
        whole = self._transition(horizon) if self.dt else half @ half
        return moving(self.right @ whole @ self.left, self.right @ half @ self.left)


@dataclass(frozen=True, eq=False)
class Parts:
    """One loop in two decoupled parts, x = right x_slow + fast_right x_fast."""

    slow: SlowPart
    fast: Array  #: (nx - k, nx - k) F; of a sampled loop (Z - I) / dt
    fast_right: Array  #: (nx, nx - k)
    fast_left: Array  #: (nx - k, nx)


def moving(whole: Array, half: Array) -> Array:
    """The change from ``half`` to ``whole``, transition matrices over half the horizon and over all of it, of the states that keep moving.

    From a start (a column) from which a state keeps moving, all states that it moves are kept: a tool's motion is that of its joints together.
    """
    size, change = np.abs(whole), whole - half
    keeps = (size > MOVES) & (size > KEEPS_MOVING * np.abs(half))
    return np.asarray(np.where(keeps.any(axis=0) & (np.abs(change) > ALONG * np.abs(change).max(axis=0, initial=0.0)), change, 0.0))


def parts(A: Array, radius: float, dt: float = 0.0, least: int = 0) -> Parts:
    """A (nx, nx) of one closed loop in its slow part, abs(s) < ``radius`` [1/s], and the rest. A sampled loop: ``dt`` > 0, s = ln(z) / dt.

    The ``least`` slowest roots are in the slow part in any case: those that are known to be slow, of which rounding may put one outside.
    Raises ``NotConverged`` where rounding mixes slow roots with the others.
    """
    n, (balance, schur, sort, sylvester) = len(A), LAPACK
    balanced, _, _, scale, _ = balance((A - np.eye(n)) / dt if dt else A, scale=1, permute=0)
    T, _, re, im, U, _, failed = schur(lambda re, im: 0, balanced, sort_t=0, lwork=WORK * n)
    size = _sizes(re, im, dt)
    ascending, k = np.sort(size), max(least, int(np.count_nonzero(size < radius)))
    if 0 < k < n and not failed:
        chosen = size <= ascending[k - 1]  # both roots of a pair
        k = int(np.count_nonzero(chosen))
        T, U, re, im, *_, failed = sort(chosen, T, U, job="N")
        failed = failed or _sizes(re[:k], im[:k], dt).max() > MOVED * max(radius, ascending[k - 1])
    if failed:
        raise NotConverged("the slow part of the linear loop has no digits: its coefficients differ by more than 16 decades")
    S, F, first, second = T[:k, :k], T[k:, k:], U[:, :k], U[:, k:]
    R = np.zeros((k, n - k))
    if R.size:
        R, shrunk, _ = sylvester(S, F, -T[:k, k:], isgn=-1)
        R = R / shrunk
    slow = SlowPart(S, scale[:, None] * first, (first.T - R @ second.T) / scale, dt)
    return Parts(slow, F, scale[:, None] * (first @ R + second), second.T / scale)


def _sizes(re: Array, im: Array, dt: float) -> Array:
    """abs(s) [1/s] of eigenvalues of A, or of (Z - I) / dt; both of a pair alike."""
    if not dt:
        return np.hypot(re, im)
    with np.errstate(divide="ignore"):
        return np.asarray(np.abs(np.log1p((re + 1j * np.abs(im)) * dt)) / dt)
