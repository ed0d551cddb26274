"""x' = A x in decoupled modes: well separated eigenvalues one by one, close ones together.

With the ordered complex Schur form of the balanced A and one triangular Sylvester equation for each mode,

    A = sum_j right_j T_j left_j,    left_j right_j = I,    left_j right_k = 0,

T_j upper triangular. Eigenvalues closer together than a gap share a mode; the gap grows until no mode is amplified much, so that
multiple eigenvalues, with which eigenvectors are worth nothing, stay together.

Source: Bavely & Stewart, "An algorithm for computing reducing subspaces by block diagonalization", SIAM J. Numerical Analysis 16 (1979) 359-367.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm, get_lapack_funcs, matrix_balance, schur

from mfc_analysis.maths.arrays import Array, Complex, Ints

GAPS = (1e-4, 1e-3, 1e-2, 0.1, 0.5)  #: relative distances below which two eigenvalues share a mode, tried in turn
LEAST = 1e-100  #: of the largest entry of A, or [1/s]: entries that count as 0
COUPLED = 1e4  #: amplification of a mode against the others with which a gap is good enough; else the gap with the least
SPLIT = 1e-7  #: of the size of A: eigenvalues that rounding may have split off a multiple one at zero
ROUNDING = 100 * float(np.finfo(float).eps)  #: of the size of A, times that amplification: an eigenvalue's error


@dataclass(frozen=True, eq=False)
class Mode:
    """The part of the states that k close eigenvalues move: x = right z, z' = T z, z = left x."""

    T: Complex  #: (k, k) [1/s] upper triangular
    right: Complex  #: (nx, k)
    left: Complex  #: (k, nx)
    error: float  #: [1/s] within which rounding leaves the eigenvalues

    @property
    def rates(self) -> Complex:
        """(k,) eigenvalues [1/s]."""
        return np.asarray(np.diag(self.T))

    def decays(self, dt: float = 0.0) -> bool:
        """Whether every eigenvalue lies left of the axis by more than its error; A = (Z - I) / dt: I + dt T in the unit circle."""
        s = self.rates
        return bool((np.abs(1 + dt * s) < 1 - dt * self.error).all() if dt else s.real.max() < -self.error)

    def integral(self, time: float, dt: float = 0.0) -> Complex:
        """(k, k) integral of exp(T t) over ``time`` [s]: z after a unit step of each of its rates."""
        k = len(self.T)
        chain = np.zeros((2 * k, 2 * k), np.complex128)
        chain[:k, :k], chain[:k, k:] = self.T, np.eye(k)
        if dt:
            return np.asarray(np.linalg.matrix_power(np.eye(2 * k) + dt * chain, max(0, round(time / dt)))[:k, k:])
        return np.asarray(expm(chain * time)[:k, k:], np.complex128)


def modes(A: Array, radius: float = 0.0) -> list[Mode]:
    """The modes of A (nx, nx). No mode has eigenvalues on both sides of abs(s) = ``radius`` [1/s]; those that rounding may split are together."""
    if not len(A):
        return []
    A = np.where(np.abs(A) > LEAST * max(1.0, float(np.abs(A).max())), A, 0.0)  # LAPACK balances and factors no matrix with such entries
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    size = float(np.abs(balanced).max(initial=0.0))
    split = min(radius, SPLIT * size)
    s, V = (np.asarray(x, np.complex128) for x in np.linalg.eig(balanced))
    if _together(s, GAPS[0], radius, split).max() == len(A) - 1:  # all apart: one by one, as long as the eigenvectors are worth something
        W = np.linalg.inv(V)
        amplified = np.linalg.norm(V, axis=0) * np.linalg.norm(W, axis=1)
        if amplified.max() <= COUPLED:
            right, left = np.asarray(scale[:, None] * V, np.complex128), np.asarray(W / scale, np.complex128)
            return [Mode(s[[j], None], right[:, [j]], left[[j]], ROUNDING * size * float(g)) for j, g in enumerate(amplified)]
    found: Any = schur(balanced, output="complex")
    T, U = found[0], found[1]
    best: tuple[float, Any] = (np.inf, None)
    for gap in GAPS:
        R, V, W, order = _decoupled(T, U, _together(np.diag(T), gap, radius, split))
        masks = [np.asarray(order == j) for j in range(int(order.max()) + 1)]
        grown = [float(np.linalg.norm(V[:, at], 2) * np.linalg.norm(W[at], 2)) for at in masks]
        if max(grown) < best[0]:
            best = max(grown), (R, V, W, masks, grown)
        if max(grown) <= COUPLED:
            break
    R, V, W, masks, grown = best[1]
    right, left = np.asarray(scale[:, None] * V, np.complex128), np.asarray(W / scale, np.complex128)
    return [Mode(np.asarray(R[np.ix_(at, at)]), right[:, at], left[at], ROUNDING * size * g) for at, g in zip(masks, grown, strict=True)]


def _together(s: Complex, gap: float, radius: float, split: float) -> Ints:
    """(n,) number of the mode of each eigenvalue: two within ``gap`` of their size, or both below ``split``, share one, and so do chains of them."""
    size = np.abs(s)
    near = np.abs(s[:, None] - s) <= gap * np.maximum(size[:, None], size)
    near |= (size[:, None] <= split) & (size <= split)
    near &= (size[:, None] < radius) == (size < radius)
    near |= np.eye(len(s), dtype=bool)
    for _ in range(len(s).bit_length()):
        near = near @ near
    return np.asarray(np.unique(near.argmax(axis=1), return_inverse=True)[1])


def _decoupled(T: Complex, U: Complex, label: Ints) -> tuple[Complex, Complex, Complex, Ints]:
    """Schur form with the eigenvalues of each mode side by side, right and left bases that decouple the modes, and the order of their numbers."""
    order, n = label.copy(), len(T)
    lapack: Any = get_lapack_funcs(("trsen", "trsyl"), dtype=np.complex128)
    reorder, sylvester = lapack
    T, U = np.array(T, np.complex128), np.array(U, np.complex128)
    for j in range(int(label.max())):
        chosen = order <= j
        if not chosen[: chosen.sum()].all():
            found = reorder(chosen.astype(np.int32), T, U, job=b"N", lwork=max(1, 2 * n * n))
            T, U = found[0], found[1]
            order = np.concatenate([order[chosen], order[~chosen]])
    right, left = U.copy(), U.conj().T.copy()
    for j in range(int(label.max())):
        one, rest = order == j, order > j
        answer = sylvester(T[np.ix_(one, one)], T[np.ix_(rest, rest)], -T[np.ix_(one, rest)], isgn=-1)
        R = answer[0] / answer[1]
        right[:, rest] += right[:, one] @ R
        left[one] -= R @ left[rest]
        T[np.ix_(one, rest)] = 0.0
    return T, right, left, order
