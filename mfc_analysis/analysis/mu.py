r"""Structured singular value of a complex matrix for independent complex scalars: 1 / the smallest diagonal Delta with I - M Delta singular.

.. math:: \max_{Q\ \text{unitary diagonal}} \rho(Q M) = \mu(M) \le \inf_{D} \bar\sigma(D M D^{-1})

The infimum equals mu for up to three scalars, and the logarithm of the singular value is convex in log D. Osborne's balancing gives a nearby D
in closed form; Newton's method on Schatten norms of rising order finds the infimum. Both work on all matrices at once.

Sources: Packard & Doyle, "The complex structured singular value", Automatica 29 (1993) 71-109; Osborne, "On pre-conditioning of
matrices", J. ACM 7 (1960) 338-345; Sezginer & Overton, IEEE Trans. Automatic Control 35 (1990) 1287-1293 (convexity).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Complex

SWEEPS = 4  #: of Osborne's balancing, to within a few percent of the infimum
POLISH = 30  #: most Newton steps
FIRST, LAST, GROWTH = 2.0, 1e6, 2.0  #: p of the Schatten norm at first and at last, and its factor from step to step
SHARP = 64.0  #: p from which on a bound that is not the largest is not polished further
LEVEL = 1e-6  #: difference of the squared moduli of the two vectors at which the balance is best
LONGEST = 2.0  #: step of log D
AT_ONCE = 8  #: matrices of a set polished together
CLOSE = 1e-8  #: relative difference below which two bounds are equal
TINY = 1e-14  #: the balancing treats entries below this fraction of the largest as zero


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
    return _singular(M, balance)[0][:, -1], balance


def polished_bound(M: Complex, balance: Array, enough: float | Array = 0.0) -> tuple[Array, Array, Array]:
    """Smallest upper bounds (k,) of mu with their balance (k, n), and lower bounds (k,), from a nearby balance.

    A bound that falls below ``enough`` (>= 0, one or (k,)) is not the smallest but a good one.

    The Schatten norm tr((M^H M)^p)^(1/2p) of D M D^-1 is smooth and convex in log D, and the largest singular value as p rises: Newton steps on
    it, p doubled after each. Where the largest singular value is simple, at the best D the moduli of its two vectors are equal; their phases
    then give the diagonal that attains it, and both bounds are equal.
    """
    upper, best = np.full(len(M), np.inf), balance.copy()
    size = np.full(len(M), np.inf)
    p, step, old = np.full(len(M), FIRST), np.zeros(balance.shape), balance.copy()
    todo, enough = np.arange(len(M)), np.broadcast_to(enough, len(M))
    for _ in range(POLISH):
        new = old[todo] + step[todo]
        values, U, V, scaled = _singular(M[todo], new)
        better = values[:, -1] < upper[todo]
        upper[todo], best[todo] = np.where(better, values[:, -1], upper[todo]), np.where(better[:, None], new, best[todo])
        u, v = U[..., -1], V[..., -1]
        level = (np.abs(np.abs(u) ** 2 - np.abs(v) ** 2).max(axis=1) <= LEVEL) | (upper[todo] <= np.where(p[todo] >= SHARP, enough[todo], 0.0))
        down = _schatten(values, p[todo]) <= size[todo] * (1 + 1e-12)
        level |= down & (p[todo] == LAST)
        down &= ~level
        kept = todo[down]
        old[kept] = new[down]
        p[kept] = np.minimum(GROWTH * p[kept], LAST)
        size[kept] = _schatten(values[down], p[kept])
        if kept.size:
            step[kept] = _newton_step(values[down], U[down], V[down], scaled[down], p[kept])
        step[todo[~down]] /= 4
        todo = todo[~level]
        if not todo.size:
            break
    _, U, V, _ = _singular(M, best)
    turned = np.exp(1j * (np.angle(V[..., -1]) - np.angle(U[..., -1])))[:, :, None] * M
    return upper, best, np.minimum(_spectral_radius(turned), upper)


def _schatten(values: Array, p: Array) -> Array:
    """Schatten norms (k,) of order 2p, p (k,), from the singular values (k, n)."""
    top = values[:, -1]
    ratio = (values / np.maximum(top, 1e-300)[:, None]) ** (2 * p[:, None])
    return np.asarray(top * ratio.sum(axis=1) ** (0.5 / p))


def _newton_step(values: Array, U: Complex, V: Complex, scaled: Complex, p: Array) -> Array:
    """Newton's step (k, n) of log D for the logarithm of the Schatten norm of order 2p.

    With H = M^H M of the scaled matrix and its eigenvalues l: first and second derivatives of tr(H^p) by divided differences of p l^(p - 1).
    """
    k, n = values.shape
    top = np.maximum(values[:, -1], 1e-300)
    q = np.maximum(values / top[:, None], 1e-6)
    l, p = q * q, p[:, None]
    power = l**p
    total, weight = power.sum(axis=1), p * power / l
    a, b = l[:, :, None], l[:, None, :]
    with np.errstate(all="ignore"):
        mean, gap = (a + b) / 2, a - b
        near = np.abs(gap) <= 1e-6 / p[..., None] * mean
        divided = np.where(near, (p * (p - 1))[..., None] * mean ** (p[..., None] - 2), (weight[:, :, None] - weight[:, None, :]) / gap)
    # derivative of H by log D_i in the basis V
    uu = U.conj()[:, :, :, None] * U[:, :, None, :] * (2 * q[:, :, None] * q[:, None, :])[:, None]
    X = uu - V.conj()[:, :, :, None] * V[:, :, None, :] * (a + b)[:, None]
    g = (np.diagonal(X.real, axis1=2, axis2=3) * weight[:, None]).sum(axis=2) / total[:, None]
    flat = (X * np.sqrt(np.maximum(divided, 0.0))[:, None]).reshape(k, n, n * n)
    bend = (flat @ np.swapaxes(flat.conj(), 1, 2)).real
    S = scaled / top[:, None, None]
    P = (V * weight[:, None, :]) @ np.swapaxes(V.conj(), 1, 2)
    H, SP = np.swapaxes(S.conj(), 1, 2) @ S, S @ P
    cross = (SP * S.conj()).real
    bend += 2 * (H * np.swapaxes(P, 1, 2)).real - 4 * (cross + np.swapaxes(cross, 1, 2))
    bend[:, range(n), range(n)] += 2 * (H * np.swapaxes(P, 1, 2)).sum(axis=2).real + 4 * cross.sum(axis=2)
    bend = bend / total[:, None, None] - g[:, :, None] * g[:, None, :]
    ridge = 1e-9 * np.trace(bend, axis1=1, axis2=2) + 1e-12
    step = -np.linalg.solve(bend + np.abs(ridge)[:, None, None] * np.eye(n) + 1.0 / n, g[:, :, None])[..., 0]
    return np.asarray(step * np.minimum(1, LONGEST / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None])


def largest_bound(M: Complex) -> tuple[float, int, float]:
    """Largest upper bound of mu over (k, n, n), its index, and the lower bound of mu that polishing finds there.

    Raises ``NotConverged`` where a matrix is not finite.
    """
    if not np.isfinite(M).all():
        raise NotConverged("the sensitivity of the loop is not finite at some frequencies: a root lies on the stability boundary to rounding")
    found = raised([M], [-1.0])[0]
    return found.value, found.index, found.lower


@dataclass(frozen=True, eq=False)
class Raised:
    """The largest upper bound of mu over k matrices that exceeds a given one."""

    value: float
    index: int  #: -1: none does
    lower: float  #: the lower bound that polishing finds there
    bound: Array  #: (k,) upper bounds of all: those that could exceed the largest so far are polished
    balance: Array  #: (k, n)


def raised(every: Sequence[Complex], above: Sequence[float]) -> list[Raised]:
    """For each set of matrices (k, n, n), all of one n, the largest upper bound that exceeds its ``above``; the sets are worked on together."""
    ends = np.cumsum([len(M) for M in every])
    first = ends - [len(M) for M in every]
    M = np.concatenate(every)
    bound, balance = osborne_bound(M)
    order = [start + np.argsort(-bound[start:end], kind="stable") for start, end in zip(first, ends, strict=True)]
    best, where, attained = np.array(above, float), np.full(len(every), -1), np.zeros(len(every))
    todo, exact = list(range(len(every))), M.shape[-1] == 1
    while todo:
        tried = [order[j][:AT_ONCE] for j in todo]
        tried = [some[bound[some] > best[j] * (1 + (0 if exact else CLOSE))] for j, some in zip(todo, tried, strict=True)]
        some, lower = np.concatenate(tried), np.zeros(len(M))
        if exact:
            lower = bound
        elif some.size:
            enough = np.repeat(np.maximum(best[todo], 0.0), [one.size for one in tried])
            bound[some], balance[some], lower[some] = polished_bound(M[some], balance[some], enough)
        for j, one in zip(todo, tried, strict=True):
            top = one[bound[one].argmax()] if one.size else -1
            if one.size and bound[top] > best[j]:
                best[j], where[j], attained[j] = bound[top], top - first[j], lower[top]
            order[j] = order[j][AT_ONCE:] if one.size else one
        todo = [j for j in todo if order[j].size]
    return [
        Raised(float(best[j]), int(where[j]), float(min(attained[j], best[j])), bound[a:b], balance[a:b])
        for j, (a, b) in enumerate(zip(first, ends, strict=True))
    ]


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


def _singular(M: Complex, balance: Array) -> tuple[Array, Complex, Complex, Complex]:
    """Singular values of D M D^-1, D = exp(balance), smallest first (k, n), left and right vectors as columns (k, n, n), and the matrix."""
    scaled = M * np.exp(balance[:, :, None] - balance[:, None, :])
    try:
        values, V = np.linalg.eigh(np.swapaxes(scaled.conj(), -1, -2) @ scaled)
    except np.linalg.LinAlgError:  # LAPACK has not converged on one of them: its Frobenius norm is an upper bound as well
        if len(M) > 1:
            each = [_singular(M[k : k + 1], balance[k : k + 1]) for k in range(len(M))]
            sizes, left, right, all_ = (np.concatenate(part) for part in zip(*each, strict=True))
            return sizes, left, right, all_
        even = np.full(M.shape, 1 / np.sqrt(M.shape[-1]), np.complex128)
        return np.full(balance.shape, float(np.linalg.norm(scaled))), even, even, scaled
    size = np.sqrt(np.maximum(values, 0.0))
    U = (scaled @ V) / np.maximum(size, 1e-6 * size[:, -1:] + 1e-300)[:, None, :]
    return size, U, V, scaled


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
