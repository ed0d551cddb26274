"""Roots at zero, found by rank: their number, whether they drift, and the system without them.

The size of a computed eigenvalue does not decide: with lag a genuine root may lie at -2e-3, and a triple zero is computed as
three numbers of size 1e-5. Rounding errors are set to zero, rows and columns are scaled to one (Ruiz), and the rank of the
result decides. Left and right null vectors that are orthogonal belong to a Jordan chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

ROUNDED = 4e-15  #: an entry below this fraction of the largest in its row is rounding error
RANK = 1e-10  #: singular values below this, where rows and columns have maximum one, are zero
ANGLE = 1e-8  #: cosines between left and right null spaces below this are zero


@dataclass(frozen=True, eq=False)
class ZeroRoots:
    """Roots at zero of m matrices."""

    dropped: Ints  #: (m,) integrals that act on nothing
    neutral: Ints  #: (m,) semisimple roots at zero among the others
    drifts: Bools  #: (m,) a Jordan chain at zero among the others
    count: Ints  #: (m,) all roots at zero with multiplicity, the dropped ones included


@dataclass(frozen=True, eq=False)
class Split:
    """One system in two decoupled parts: the roots that are not at zero, and a nilpotent part with the roots at zero."""

    A: Array  #: (k, k) all roots except those at zero
    B: Array  #: (k, p)
    C: Array  #: (q, k)
    A_zero: Array  #: (a, a) nilpotent
    B_zero: Array  #: (a, p)
    C_zero: Array  #: (q, a)


def equilibrated(A: Array) -> tuple[Array, Array, Array]:
    """E = diag(r) A diag(c) with the largest entry of each row and column near one, and r, c (..., nx): Ruiz scaling.

    Rounding errors are set to zero first. Rows and columns of zeros stay, with r c = 1. ``sqrt(r / c)`` balances the states.
    """
    E, r, c = _scaled(A)
    some_row, some_column = E.any(axis=-1), E.any(axis=-2)
    r = np.where(some_row, r, 1 / c)
    c = np.where(some_column, c, 1 / r)
    return E, r, c


def _scaled(A: Array) -> tuple[Array, Array, Array]:
    """``equilibrated`` for any (..., p, q); rows and columns of zeros keep a scale of one."""
    size = np.abs(A)
    size = np.where(size < ROUNDED * size.max(axis=-1, keepdims=True), 0.0, size)
    some_row, some_column = (size > 0).any(axis=-1), (size > 0).any(axis=-2)
    r, c = np.ones(A.shape[:-1]), np.ones((*A.shape[:-2], A.shape[-1]))
    for _ in range(8):
        now = size * r[..., :, None] * c[..., None, :]
        rows, columns = now.max(axis=-1), now.max(axis=-2)
        r = r / np.sqrt(np.where(some_row, rows, 1.0))
        c = c / np.sqrt(np.where(some_column, columns, 1.0))
    return np.where(size > 0, A, 0.0) * r[..., :, None] * c[..., None, :], r, c


def surely_regular(A: Array) -> Bools:
    """(m,) True where A (m, nx, nx) has full rank by a wide margin: the inverse of its scaled form is small."""
    E, _, _ = equilibrated(A)
    try:
        inverse = np.linalg.inv(E)
    except np.linalg.LinAlgError:
        return np.array([np.linalg.matrix_rank(e, tol=100 * RANK) == len(e) for e in E], bool)
    return np.asarray(np.abs(inverse).sum(axis=2).max(axis=1) < 1e-2 / RANK)


def zero_roots(A: Array, integrals: tuple[int, ...] = ()) -> ZeroRoots:
    """The roots at zero of A (m, nx, nx); directions among the states ``integrals`` that act on nothing are dropped first."""
    m = len(A)
    dropped, neutral, count = np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros(m, np.int64)
    drifts = np.zeros(m, bool)
    for i in np.flatnonzero(~surely_regular(A)):
        scale, balanced = _balanced(A[i])
        rest = _without_idle(balanced, integrals)
        right, left = _null_spaces(rest)
        dropped[i] = len(scale) - len(rest)
        neutral[i] = np.count_nonzero(np.linalg.svd(left.T @ right, compute_uv=False) > ANGLE)
        drifts[i] = neutral[i] < right.shape[1]
        count[i] = _zero_space(balanced).shape[1]
    return ZeroRoots(dropped, neutral, drifts, count)


def without_zero_roots(A: Array, B: Array, C: Array, count: int | None = None) -> Split:
    """A (nx, nx), B (nx, p), C (q, nx) with the roots at zero split off: C (sI - A)^-1 B is the sum of the two parts.

    ``count``: the number of roots at zero, if known from elsewhere (rounding hides the zeros of a sampled loop).
    """
    scale, balanced = _balanced(A)
    B, C = B / scale[:, None], C * scale
    right, left = _zero_space(balanced), _zero_space(balanced.T)
    if count is not None and not right.shape[1] == left.shape[1] == count:
        right, left = _slowest_space(balanced, count), _slowest_space(balanced.T, count)
    pairing = np.linalg.solve(left.T @ right, left.T)
    others = _complement(left)
    return Split(
        A=others.T @ balanced @ others,
        B=others.T @ (B - right @ (pairing @ B)),
        C=C @ others,
        A_zero=pairing @ balanced @ right,
        B_zero=pairing @ B,
        C_zero=C @ right,
    )


def nonzero_roots(A: Array, count: int) -> Complex:
    """The (nx - count,) eigenvalues of A (nx, nx) that are not at zero; ``count`` of ``ZeroRoots``."""
    found = np.linalg.eigvals(without_zero_roots(A, np.zeros((len(A), 0)), np.zeros((0, len(A))), count).A)
    assert found.size == len(A) - count
    return np.asarray(found, np.complex128)


def without_decoupled_zeros(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """A (nx, nx), B (nx, p), C (q, nx) without the chains of roots at zero that are unobservable from C or uncontrollable from B.

    C (sI - A)^-1 B does not change, nor does any loop closed around it.
    """
    scale, A = _balanced(A)
    B, C = B / scale[:, None], C * scale
    while len(A):
        unseen = _null_columns(np.vstack([A, C]))
        if unseen.shape[1]:
            rest = _complement(unseen)
        else:
            undriven = _null_columns(np.vstack([A.T, B.T]))
            if not undriven.shape[1]:
                break
            rest = _complement(undriven)
        A, B, C = _restricted(A, rest), rest.T @ B, C @ rest
    return A, B, C


def _null_columns(A: Array) -> Array:
    """Orthonormal null space (q, k) of A (p, q), p >= q."""
    E, _, c = _scaled(A)
    _, s, vt = np.linalg.svd(E, full_matrices=False)
    k = int(np.count_nonzero(s < RANK))
    return np.linalg.qr(c[:, None] * vt[len(vt) - k :].T)[0]


def _balanced(A: Array) -> tuple[Array, Array]:
    """Scales d and diag(1/d) A diag(d), with rows and columns of similar size."""
    E, r, c = equilibrated(A)
    root = np.sqrt(r * c)
    return np.sqrt(c / r), E / root[:, None] / root[None, :]


def _null_spaces(A: Array) -> tuple[Array, Array]:
    """Orthonormal right and left null spaces (n, k) of one balanced A."""
    if not len(A):
        return np.zeros((0, 0)), np.zeros((0, 0))
    E, r, c = equilibrated(A)
    u, s, vt = np.linalg.svd(E)
    k = int(np.count_nonzero(s < RANK))
    right, left = c[:, None] * vt[len(A) - k :].T, r[:, None] * u[:, len(A) - k :]
    return np.linalg.qr(right)[0], np.linalg.qr(left)[0]


def _zero_space(A: Array) -> Array:
    """Orthonormal basis (n, a) of the generalised null space of one balanced A, chain by chain."""
    null, _ = _null_spaces(A)
    if null.shape[1] in (0, len(A)):
        return null
    others = _complement(null)
    return np.hstack([null, others @ _zero_space(_restricted(A, others))])


def _slowest_space(A: Array, count: int) -> Array:
    """Orthonormal basis (n, count) of the invariant subspace of the ``count`` eigenvalues nearest zero."""
    from scipy.linalg import schur

    if count == 0:
        return np.zeros((len(A), 0))
    size = np.sort(np.abs(np.linalg.eigvals(A)))
    limit = np.inf if count >= len(A) else float(np.sqrt(max(size[count - 1], 1e-300) * size[count]))
    return np.asarray(schur(A, output="real", sort=lambda re, im: np.hypot(re, im) < limit)[1][:, :count], float)


def _without_idle(A: Array, integrals: tuple[int, ...]) -> Array:
    """One balanced A without the directions of ``integrals`` whose columns vanish."""
    if not integrals:
        return A
    E, _, c = equilibrated(A)
    columns = E[:, integrals]
    _, s, vt = np.linalg.svd(columns)
    k = int(np.count_nonzero(s < RANK)) + max(0, len(integrals) - len(s))
    if not k:
        return A
    idle = np.zeros((len(A), k))
    idle[list(integrals)] = c[list(integrals), None] * vt[len(integrals) - k :].T
    return _restricted(A, _complement(np.linalg.qr(idle)[0]))


def _restricted(A: Array, basis: Array) -> Array:
    small = basis.T @ A @ basis
    return np.where(np.abs(small) < 1e-14 * np.abs(A).max(), 0.0, small)


def _complement(basis: Array) -> Array:
    """Orthonormal complement (n, n - k) of an orthonormal basis (n, k)."""
    return np.linalg.qr(basis, mode="complete")[0][:, basis.shape[1] :]
