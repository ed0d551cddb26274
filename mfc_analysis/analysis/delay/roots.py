"""The rightmost characteristic roots of a loop with dead time. There are infinitely many roots.

Chebyshev collocation of each wire's transport gives a matrix whose rightmost eigenvalues have nearly all digits; Newton on the determinant
gives the rest. Collocation finds where roots are; how many are unstable is counted (``count``).

Sources: Breda, Maset, Vermiglio, "Pseudospectral differencing methods for characteristic roots of delay differential
equations", SIAM J. Sci. Comput. 27 (2005), 482-495 (the collocation); Trefethen, Spectral Methods in MATLAB, ch. 6 (its
matrix); Ruhe, "Algorithms for the nonlinear eigenvalue problem", SIAM J. Numer. Anal. 10 (1973), 674-689 (multiple roots).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from mfc_analysis.analysis.delay.characteristic import Delayed, delayed_points, in_a_loop
from mfc_analysis.analysis.delay.stacked import perron
from mfc_analysis.analysis.delay.verdict import chain, delayed_verdicts
from mfc_analysis.analysis.spectrum import poles, spectrum
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.errors import Unsupported
from mfc_analysis.maths.arrays import Array, Complex, Ints, on_axis
from mfc_analysis.maths.checks import whole

MOST_NODES = 200  #: for one wire
FEW_NODES, RESOLVED = 8, 2.0  #: nodes of a wire that suffice for roots that turn less than so many radians in its dead time
MOST_ROOTS = 10_000  #: roots asked for
MOST_SIZE = 600  #: of the collocated matrix
NEAR = 1e-2  #: relative distance to a root of the collocation up to which another is that one
NEAR_TURN = 0.1  #: and at most this over T: the roots of a chain are 2 pi / T apart


def delay_roots(system: OpenSystem, count: int = 6, slow: Sequence[Complex] | None = None) -> Complex:
    """The (m, count) rightmost characteristic roots [rad/s] of the closed loop with its dead time, rightmost first.

    Integrals that act on nothing are left out. Where there are fewer roots (dead time outside every loop) the others are -inf.
    ``slow``: the slow roots at each point [1/s], those of the verdict, if already known.
    Raises ``Unsupported`` for a sampled loop, whose dead time is in its poles, ``BadArgument``, and ``NotConverged`` as ``stability``.
    """
    if system.dt:
        raise Unsupported("delay_roots", "a sampled loop", "a continuous one: the poles in z of a sampled loop include its dead time")
    count = whole("count", count, 1, MOST_ROOTS)
    system = without_idle(system)
    out = np.full((len(system.A), count), -np.inf, np.complex128)
    if not system.delayed:
        found = poles(system)
        order = np.lexsort((-found.imag, np.abs(found.imag), -found.real), axis=1)[:, :count]
        out[:, : order.shape[1]] = np.take_along_axis(found, order, 1)
        return out
    if slow is None:
        slow = [verdict.slow_roots for verdict in delayed_verdicts(system, spectrum(system))]
    for i, (point, some) in enumerate(zip(delayed_points(system), slow, strict=True)):
        roots = _ordered(np.concatenate([some, rightmost(point, count, system.radius)]))[:count]
        out[i, : roots.size] = roots
    return out


def slow_rates(system: OpenSystem) -> Array:
    """Decay rates [1/s] of the roots that are not slow and turn less than ``RESOLVED`` in a dead time, of a system with one point; not polished."""
    (point,) = delayed_points(system)
    roots = _fast(_collocated(point, np.full(point.T.size, FEW_NODES)), system.radius)
    return np.asarray(-roots.real[np.abs(roots) * point.T.max() < RESOLVED], float)


def rightmost(point: Delayed, count: int, radius: float) -> Complex:
    """At least ``count`` rightmost roots that are not slow, abs(s) >= ``radius`` [1/s], if that many exist; rightmost first."""
    if not in_a_loop(point.alone)[0]:
        return _ordered(_fast(point.open_poles, radius))[: max(count, 2)]
    reach, more, found_before = _reach(point), 0, -1
    good = np.zeros(0, np.complex128)
    most = min(MOST_NODES, MOST_SIZE // len(point.T))
    for _ in range(6):
        nodes = np.minimum(np.ceil(0.9 * reach * point.T) + 10 + more, most).astype(int)
        good, sure = _polished(point, _fast(_collocated(point, nodes), radius)[: 2 * count + 10])
        if sure >= count or nodes.max() >= most or (more > 40 and sure <= found_before):
            break
        more, found_before = 2 * more + 12, sure
    far = chain(point)[:count]  # unstable roots that turn faster than the nodes resolve
    far = np.concatenate([far, far.conj()])
    known = np.minimum(NEAR * np.abs(far), NEAR_TURN / float(point.T.max()))  # Newton alone scatters the copies of a multiple root
    good = np.concatenate([good, far[np.abs(far[:, None] - good).min(axis=1, initial=np.inf) > known]])
    return _ordered(_fast(good, radius))[: max(count, 2)]


def _fast(roots: Complex, radius: float) -> Complex:
    return roots[np.abs(roots) >= radius]


def _reach(point: Delayed) -> float:
    """[rad/s] frequency above which no delayed loop can oscillate: the Perron root of |G(jw)| stays below one."""
    size = np.abs(point.places)
    even = np.geomspace(max(float(size.min()), 1e-3 * float(size.max())) * 0.3, 1e3 * float(size.max()), 80)
    w = np.union1d(even, size * 1.0001)
    alive = np.flatnonzero(perron(np.abs(point.gain(on_axis(w)))) >= 0.7)
    return float(w[min(alive[-1] + 1, w.size - 1)]) if alive.size else float(w[0])


def differentiation(n: int) -> Array:
    """(n + 1, n + 1) Chebyshev differentiation matrix on [-1, 1], nodes from 1 down to -1."""
    k = np.arange(n + 1)
    x = np.cos(np.pi * k / n)
    c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
    D = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(n + 1))
    return np.asarray(D - np.diag(D.sum(axis=1)))


def _collocated(point: Delayed, nodes: Ints) -> Complex:
    """Eigenvalues of the loop with each wire's transport collocated, rightmost first."""
    nx, nd = len(point.A), len(point.T)
    start = nx + np.concatenate([[0], np.cumsum(nodes)])
    big = np.zeros((start[-1], start[-1]))
    arrives = start[1:] - 1  # the last node of each wire: the signal after the dead time
    big[:nx, :nx] = point.A
    big[:nx, arrives] = point.B
    for j in range(nd):
        d = differentiation(int(nodes[j])) * (2 / point.T[j])
        rows = slice(start[j], start[j + 1])
        big[rows, rows] = d[1:, 1:]
        big[rows, :nx] = np.outer(d[1:, 0], point.C[j])
        big[rows, arrives] += np.outer(d[1:, 0], point.D[j])
    return _ordered(np.linalg.eigvals(big).astype(np.complex128))


def _polished(point: Delayed, roots: Complex) -> tuple[Complex, int]:
    """Newton on the determinant: roots that converge nearby, and how many converge before the first that does not.

    Roots that agree to rounding are copies of a multiple root and are polished together.
    """
    size = np.abs(roots) + 1e-3 / point.T.max()
    apart = np.abs(roots[:, None] - roots[None, :]) + np.where(np.eye(roots.size, dtype=bool), np.inf, 0.0)
    single = apart.min(axis=1, initial=np.inf) > 1e-3 * size
    s, settled = roots.copy(), ~single
    copies = np.flatnonzero(settled)
    if copies.size:  # eigenvalues of the transport alone are not roots: they are far from a zero of the determinant
        s[copies[~(np.abs(_newton(point, s[copies])) < 1e-4 * size[copies])]] = np.nan
        _polish_copies(point, s, copies[np.isfinite(s[copies])], size)
    for _ in range(12):
        todo = np.flatnonzero(~settled & np.isfinite(s))
        if not todo.size:
            break
        change = _newton(point, s[todo])
        s[todo] = s[todo] + change
        settled[todo] = np.abs(change) < 1e-13 * size[todo]
        wild = np.abs(s[todo] - roots[todo]) > 0.3 * np.minimum(apart[todo].min(axis=1, initial=np.inf), size[todo])
        s[todo[wild]] = np.nan
    near = np.isfinite(s) & (np.abs(s - roots) < 1e-2 * size)
    first_bad = int(np.argmin(near)) if not near.all() else near.size
    real = (single & (roots.imag == 0)) | (np.abs(s.imag) < 1e-12 * size)
    s = np.where(real, s.real + 0j, s)
    return s[near], first_bad


def _polish_copies(point: Delayed, s: Complex, copies: Ints, size: Array) -> None:
    """Polishes clusters of roots in place: successive linear problems M(c) x = -d M'(c) x about their mean c, all copies at once (Ruhe 1973)."""
    left = list(copies)
    while left:
        first = left[0]
        group = [i for i in left if abs(s[i] - s[first]) < 2e-3 * size[first]]
        left = [i for i in left if i not in group]
        found = s[group]
        for _ in range(4):
            middle = found.mean()
            M, slope = point.matrix(np.array([middle]))
            with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
                inverse = np.linalg.eigvals(np.linalg.solve(M[0], slope[0]))
                nearest = inverse[np.argsort(-np.abs(inverse), kind="stable")[: len(group)]]
                found = middle - 1 / nearest
            if not np.all(np.abs(found - middle) < 1e-2 * size[first]) or abs(found.mean() - middle) < 1e-14 * size[first]:
                break
        if np.all(np.abs(found - s[group].mean()) < 1e-2 * size[first]):
            s[group] = found


def _newton(point: Delayed, s: Complex) -> Complex:
    """Newton steps -1 / trace(M^-1 M') at s (k,), with the characteristic matrix M."""
    M, slope = point.matrix(s)
    try:
        quotient = np.linalg.solve(M, slope)
    except np.linalg.LinAlgError:  # exactly on a root
        return np.zeros(1, np.complex128) if s.size == 1 else np.concatenate([_newton(point, one) for one in s[:, None]])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-1 / np.trace(quotient, axis1=1, axis2=2))


def _ordered(roots: Complex) -> Complex:
    """Rightmost first, with copies (equal up to rounding) together; of a pair, the one with positive imaginary part first."""
    unit = 1e-9 * (np.abs(roots[np.isfinite(roots)]).max(initial=0.0) or 1.0)
    real, above = np.round(roots.real / unit), np.round(np.abs(roots.imag) / unit)
    return np.asarray(roots[np.lexsort((-roots.imag, above, -real))])
