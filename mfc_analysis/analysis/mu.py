r"""Structured singular value of a complex matrix for independent complex scalars: 1 / the smallest diagonal Delta with I - M Delta singular.

.. math:: \max_{Q\ \text{unitary diagonal}} \rho(Q M) = \mu(M) \le \inf_{D} \bar\sigma(D M D^{-1})

The infimum equals mu for up to three scalars. Osborne's balancing gives a nearby D in closed form, for all matrices at once;
SLICOT's AB13MD finds the infimum, one matrix at a time.

Sources: Packard & Doyle, "The complex structured singular value", Automatica 29 (1993) 71-109; Osborne, "On pre-conditioning of
matrices", J. ACM 7 (1960) 338-345; Fan, Tits & Doyle, IEEE Trans. Automatic Control 36 (1991) 25-38 (AB13MD).
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Complex

SWEEPS = 4  #: of Osborne's balancing, to within a few percent of the infimum
POLISH = 14  #: polishing iterations; where the largest singular value is simple, each gains half a digit
AT_ONCE = 8  #: matrices polished together
CLOSE = 1e-8  #: relative difference below which two bounds are equal
TINY = 1e-14  #: the balancing treats entries below this fraction of the largest as zero


def has_slycot() -> bool:
    """Whether SLICOT's bound is available (there is no wheel for Macs with Intel processors)."""
    return find_spec("slycot") is not None


def osborne_bound(M: Complex) -> tuple[Array, Array]:
    """Upper bounds of mu, (k,), of matrices (k, n, n): largest singular values after diagonal balancing; and the log of the balance (k, n)."""
    P = np.abs(M) ** 2
    floor = TINY**2 * P.max(axis=(-2, -1)) + 1e-300
    squared = np.ones(M.shape[:-1])
    for _ in range(SWEEPS if M.shape[-1] > 1 else 0):
        for i in range(M.shape[-1]):
            row = (P[:, i, :] / squared).sum(axis=-1) - P[:, i, i] / squared[:, i]
            column = (P[:, :, i] * squared).sum(axis=-1) - P[:, i, i] * squared[:, i]
            squared[:, i] = np.sqrt((np.maximum(column, 0) + floor) / (np.maximum(row, 0) + floor))
    balance = np.log(squared) / 2
    return _largest_singular(M, balance)[0], balance


def polished_bound(M: Complex, balance: Array) -> tuple[Array, Array]:
    """Smaller upper bounds (k,) and lower bounds (k,) of mu, from a nearby balance (k, n).

    Where the largest singular value is simple, the best D makes the moduli of its two vectors equal. Their phases then give the
    diagonal that attains it, and both bounds are equal.
    """
    upper = np.full(len(M), np.inf)
    u = v = np.zeros(balance.shape, np.complex128)
    for k in range(POLISH):
        size, u, v = _largest_singular(M, balance)
        upper = np.minimum(upper, size)
        if k < POLISH - 1:
            balance = balance + 0.25 * np.clip(np.log((np.abs(v) + 1e-12) / (np.abs(u) + 1e-12)), -1, 1)
    turned = np.exp(1j * (np.angle(v) - np.angle(u)))[:, :, None] * M
    return upper, _spectral_radius(turned)


def slicot_bound(M: Complex) -> float:
    """Upper bound of mu of one (n, n) matrix by AB13MD; exact for n <= 3."""
    from slycot import ab13md

    n = M.shape[0]
    if not M.any():
        return 0.0
    return float(ab13md(M, np.ones(n, int), np.full(n, 2))[0])


def largest_bound(M: Complex, use_slicot: bool | None = None) -> tuple[float, int, float]:
    """Largest upper bound of mu over (k, n, n), its index, and the lower bound of mu that polishing finds there.

    Osborne's bound ranks all matrices. Polishing takes those that can still exceed the best so far, and SLICOT (if ``use_slicot``; None: if
    installed) those that can exceed it after polishing. Raises ``NotConverged`` where a matrix is not finite.
    """
    if not np.isfinite(M).all():
        raise NotConverged("the sensitivity of the loop is not finite at some frequencies: a root lies on the stability boundary to rounding")
    slicot = has_slycot() if use_slicot is None else use_slicot
    bound, balance = osborne_bound(M)
    order = np.argsort(-bound, kind="stable")
    if M.shape[-1] == 1:
        return float(bound[order[0]]), int(order[0]), float(bound[order[0]])
    best, where, attained = -1.0, 0, 0.0
    for start in range(0, order.size, AT_ONCE):
        some = order[start : start + AT_ONCE]
        some = some[bound[some] > best * (1 + CLOSE)]
        if not some.size:
            break
        upper, lower = polished_bound(M[some], balance[some])
        for j in np.argsort(-upper, kind="stable"):
            if upper[j] <= best * (1 + CLOSE):
                break
            wins = slicot and upper[j] > lower[j] * (1 + CLOSE)  # where both bounds are equal no better bound exists
            found = min(slicot_bound(M[some[j]]), float(upper[j])) if wins else float(upper[j])
            if found > best:
                best, where, attained = found, int(some[j]), float(lower[j])
    return best, where, min(attained, best)


def lower_bound(M: Complex, enough: float = np.inf) -> float:
    """Lower bound of mu of one matrix: rho(Q M) with the phases Q of the power iteration, from a few starts until it is ``enough``."""
    best = float(_spectral_radius(M[None])[0])
    try:
        U, _, Vh = np.linalg.svd(M)
    except np.linalg.LinAlgError:  # LAPACK has not converged
        return best
    for start in range(min(3, len(M))):
        b, w = Vh[start].conj(), U[:, start]
        for k in range(1, 61):
            a = _unit(M @ b)
            w = _unit(M.conj().T @ _with_phases(w, a))
            b = _with_phases(a, w)
            if k % 10 == 0:
                Q = np.exp(1j * (np.angle(b) - np.angle(M @ b)))
                best = max(best, float(_spectral_radius((Q[:, None] * M)[None])[0]))
                if best >= enough:
                    return best
    return best


def _largest_singular(M: Complex, balance: Array) -> tuple[Array, Complex, Complex]:
    """Largest singular value of D M D^-1, D = exp(balance), with its vectors: (k,), (k, n), (k, n)."""
    scaled = M * np.exp(balance[:, :, None] - balance[:, None, :])
    try:
        values, vectors = np.linalg.eigh(np.swapaxes(scaled.conj(), -1, -2) @ scaled)
    except np.linalg.LinAlgError:  # LAPACK has not converged on one of them: its Frobenius norm is an upper bound as well
        if len(M) > 1:
            each = [_largest_singular(M[k : k + 1], balance[k : k + 1]) for k in range(len(M))]
            size, u, v = (np.concatenate(part) for part in zip(*each, strict=True))
            return size, u, v
        one = np.ones(balance.shape, np.complex128) / np.sqrt(M.shape[-1])
        return np.asarray(np.linalg.norm(scaled, axis=(-2, -1)), float), one, one
    v = vectors[:, :, -1]
    u = (scaled @ v[:, :, None])[:, :, 0]
    size = np.sqrt(np.maximum(values[:, -1], 0.0))
    return size, u / np.maximum(size, 1e-300)[:, None], v


def _spectral_radius(M: Complex) -> Array:
    """(k,) of matrices (k, n, n); 0, a lower bound of mu, where LAPACK does not converge."""
    try:
        return np.asarray(np.abs(np.linalg.eigvals(M)).max(axis=-1), float)
    except np.linalg.LinAlgError:
        return np.concatenate([_spectral_radius(M[k : k + 1]) for k in range(len(M))]) if len(M) > 1 else np.zeros(1)


def _with_phases(size: Complex, phase: Complex) -> Complex:
    """Moduli of one vector with the phases of another."""
    return np.asarray(np.abs(size) * np.exp(1j * np.angle(phase)))


def _unit(x: Complex) -> Complex:
    return np.asarray(x / max(float(np.linalg.norm(x)), 1e-300))
