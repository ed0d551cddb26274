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
from scipy.linalg import expm, matrix_balance, schur, solve_sylvester

from mfc_analysis.maths.arrays import Array, Complex

MOVES = 1e-3  #: [SI] an entry of the slow transition matrix below this is no motion
ALONG = 1e-6  #: of the largest change from the same start below which a state does not move along
KEEPS_MOVING = 1.5  #: times its value at half the horizon: a ramp doubles, a free position stays, a growth of 1/horizon is 1.6
NUDGES = (1.0, 1.01, 0.99, 1.05, 0.95)  #: factors of the radius, tried in turn where a root lies so near it that it cannot be sorted


@dataclass(frozen=True, eq=False)
class SlowPart:
    """k slow roots of one loop: x_slow(t) = ``at(t)`` x(0) in the physical states."""

    block: Array  #: (k, k) [1/s] S
    right: Array  #: (nx, k)
    left: Array  #: (k, nx), left @ right = I
    dt: float = 0.0  #: [s] of a sampled loop: S is (Z - I) / dt then

    @property
    def roots(self) -> Complex:
        """(k,) [1/s]."""
        found = np.linalg.eigvals(self.block).astype(np.complex128)
        return np.asarray(np.log1p(found * self.dt) / self.dt if self.dt else found, np.complex128)

    def at(self, time: float) -> Array:
        """(nx, nx) transition matrix of the slow part over ``time`` [s]."""
        if self.dt:
            power = np.linalg.matrix_power(np.eye(len(self.block)) + self.dt * self.block, max(0, round(time / self.dt)))
            return np.asarray(self.right @ power @ self.left)
        return np.asarray(self.right @ expm(self.block * time) @ self.left)

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
        return moving(self.at(horizon), self.at(horizon / 2))


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


def parts(A: Array, radius: float, dt: float = 0.0) -> Parts:
    """A (nx, nx) of one closed loop in its slow part, abs(s) < ``radius`` [1/s], and the rest. A sampled loop: ``dt`` > 0, s = ln(z) / dt."""
    rate = (A - np.eye(len(A))) / dt if dt else A
    balanced, (scale, _) = matrix_balance(rate, permute=False, separate=True)
    T, U, k = _sorted(balanced, radius, dt)
    S, F, X = T[:k, :k], T[k:, k:], T[:k, k:]
    R = solve_sylvester(S, -F, -X) if 0 < k < len(A) else np.zeros((k, len(A) - k))
    first, second = U[:, :k], U[:, k:]
    slow = SlowPart(S, scale[:, None] * first, (first.T - R @ second.T) / scale, dt)
    return Parts(slow, F, scale[:, None] * (first @ R + second), second.T / scale)


def _sorted(A: Array, radius: float, dt: float) -> tuple[Array, Array, int]:
    """Real Schur form T, U of A with the k slow roots first."""

    def is_slow(re: float, im: float, limit: float) -> bool:
        s = complex(re, im)
        return bool(abs(np.log1p(s * dt) / dt if dt and s != -1 / dt else s) < limit)

    for nudge in NUDGES:
        try:
            found: Any = schur(A, output="real", sort=lambda re, im, limit=nudge * radius: is_slow(re, im, limit))
        except np.linalg.LinAlgError:
            continue
        return np.asarray(found[0]), np.asarray(found[1]), int(found[2])
    found = schur(A, output="real")
    return np.asarray(found[0]), np.asarray(found[1]), 0
