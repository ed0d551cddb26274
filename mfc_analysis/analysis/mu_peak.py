"""The largest mu(S - I/2) over all frequencies, with a proof that no frequency has more: branch and bound on intervals.

On an interval around c with a balance D of its own, mu <= sigma(D (S - I/2) D^-1), and S is known by ``Taylor``: a quadratic polynomial and a
bound of the rest. Between nodes at a distance h the largest singular value of a quadratic is at most that at the nodes, plus h^2/8 times that of
its second derivative (the deviation from the chord, on which sigma is convex). Intervals that can exceed the largest mu found are divided.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mfc_analysis.analysis.frequency.sensitivity import Opened, sensitivity_at_infinity
from mfc_analysis.analysis.frequency.taylor import NODES, Piece, Taylor, beyond, left_over, over_cells, pieces
from mfc_analysis.analysis.mu import Raised, largest_bound, lower_bound, osborne_bound, raised
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Complex

CERTAIN = 1e-6  #: relative: no frequency has more than the largest mu found by this
MOST = 20_000  #: centers at one point
TOGETHER = 32  #: points at a time
WIDER = 4.0  #: factor by which the last frequency of a loop with dead time is raised
WIDEST = 60  #: times


@dataclass(frozen=True)
class Peak:
    """The largest upper bound of mu(S - I/2)."""

    value: float
    frequency: float  #: [rad/s]
    lower: float  #: a lower bound of mu there
    certain: bool  #: no frequency has more, up to ``CERTAIN``


@dataclass(frozen=True, eq=False)
class _Best:
    """The largest so far, and where it was found."""

    value: float
    frequency: float
    lower: float
    matrix: Complex  #: (n, n)
    certain: bool = True
    piece: Piece | None = None
    center: float = 0.0
    radius: float = 0.0


_T = TypeVar("_T")
_Search = Generator[tuple[Complex, float], Raised, _T]  # asks for the largest mu of matrices (k, n, n) above a value


def mu_peaks(channels: Opened, points: Sequence[tuple[int, Complex]]) -> list[Peak]:
    """The largest upper bound of mu(S - I/2) at each of the points, from 1/horizon to infinity (a sampled loop: to half the sample rate).

    ``points``: their indices, and the poles [1/s] of the loop, dead time left out, which say where to begin. The points are searched together,
    so that mu is computed of the matrices of many at a time.
    """
    out: list[Peak] = []
    for k in range(0, len(points), TOGETHER):
        out += _together([_peak(channels, index, poles) for index, poles in points[k : k + TOGETHER]])
    return out


def _together(searches: Sequence[_Search[Peak]]) -> list[Peak]:
    found: dict[int, Peak] = {}
    answers: dict[int, Raised | None] = dict.fromkeys(range(len(searches)))
    while answers:
        asked: dict[int, tuple[Complex, float]] = {}
        for k, answer in answers.items():
            try:
                asked[k] = next(searches[k]) if answer is None else searches[k].send(answer)
            except StopIteration as end:
                found[k] = end.value
        every = raised([M for M, _ in asked.values()], [above for _, above in asked.values()]) if asked else []
        answers = dict(zip(asked, every, strict=True))
    return [found[k] for k in range(len(searches))]


def _peak(channels: Opened, index: int, poles: Complex) -> _Search[Peak]:
    system = channels.system
    parts = pieces(channels, index, system.radius, poles)
    best, seen = yield from _searched(parts, _Best(-1.0, np.nan, -1.0, np.zeros((0, 0), np.complex128)), 0)
    if system.delayed:
        best = yield from _further(channels, index, parts[0], best, seen)
    best = yield from _centered(best)
    lower = best.lower
    if lower < best.value * (1 - CERTAIN / 2):
        lower = max(lower, lower_bound(best.matrix, best.value * (1 - CERTAIN / 2)))
    return Peak(best.value, best.frequency, min(lower, best.value), best.certain)


def _centered(best: _Best) -> _Search[_Best]:
    """Nearer to the top than the search leaves it: the vertex of the parabola through three places."""
    if best.piece is None:
        return best
    c, r = best.center, best.radius
    beside, top = [], best
    for x in (c - r, c + r):
        found = (yield from _sample(best.piece, np.array([x]), np.zeros(1), replace(best, value=-1.0)))[0]
        beside.append(found.value)
        top = found if found.value > top.value else top
    bend = beside[0] + beside[1] - 2 * best.value
    if bend >= 0:
        return top
    shift = float(np.clip(0.5 * (beside[0] - beside[1]) / bend, -1, 1))
    return (yield from _sample(best.piece, np.array([c + shift * r]), np.zeros(1), top))[0]


def _further(channels: Opened, index: int, last: Piece, best: _Best, seen: int) -> _Search[_Best]:
    """Beyond the last frequency of a loop with dead time, until the loops are too small there."""
    far = sensitivity_at_infinity(channels, index) - 0.5 * np.eye(channels.wires.size)
    size, _, lower = largest_bound(far[None])
    if size >= best.value * (1 - 1e-12):
        best = _Best(size, np.inf, lower, far, best.certain)
    far = np.abs(far)
    if (channels.rates >= 0).any():
        far = np.diag(np.diagonal(far))
    for _ in range(WIDEST):
        w = float(last.edges[-1])
        left = beyond(channels, index, w)
        if np.isfinite(left).all() and osborne_bound((far + left)[None].astype(complex))[0][0] <= best.value * (1 + CERTAIN):
            return best
        if seen >= MOST or not best.certain:
            break
        last = replace(last, edges=w * np.geomspace(1, WIDER, 5))
        best, seen = yield from _searched([last], best, seen)
    return replace(best, certain=False)


def _searched(parts: Sequence[Piece], best: _Best, seen: int) -> _Search[tuple[_Best, int]]:
    """The larger of the best and the largest over the pieces; and the number of centers seen, with the ``seen`` before."""
    for part in parts:
        best, _ = yield from _divided(part, part.edges[[0, -1]], np.zeros(2), best)
    todo = [((part.edges[1:] + part.edges[:-1]) / 2, (part.edges[1:] - part.edges[:-1]) / 2) for part in parts]
    while any(c.size for c, _ in todo):
        if seen > MOST:
            return replace(best, certain=False), seen
        for k, (part, (c, r)) in enumerate(zip(parts, todo, strict=True)):
            if c.size:
                best, todo[k] = yield from _divided(part, c, r, best)
                seen += c.size
    return best, seen


def _sample(piece: Piece, c: Array, r: Array, best: _Best) -> _Search[tuple[_Best, Taylor, Array, Array]]:
    """The larger of the best and the mu at the centers; S - I/2 there, and bounds (k,) of its mu with their balance (k, n)."""
    found = piece.around(c, r)
    M = found.value - np.eye(found.value.shape[-1]) / 2
    if not np.isfinite(M).all():
        raise NotConverged("the sensitivity of the loop is not finite at some frequencies: a root lies on the stability boundary to rounding")
    top = yield M, best.value
    k = top.index
    if k >= 0:
        best = _Best(top.value, piece.frequency(float(c[k])), top.lower, M[k], best.certain, piece, float(c[k]), float(r[k]))
    return best, Taylor(M, found.slope, found.bend, found.rest), top.balance, top.bound


def _divided(piece: Piece, c: Array, r: Array, best: _Best) -> _Search[tuple[_Best, tuple[Array, Array]]]:
    """The larger of the best and the mu at the centers, and what is left of the intervals that can exceed it."""
    best, found, balance, bound = yield from _sample(piece, c, r, best)
    most = best.value * (1 + CERTAIN)
    some = np.flatnonzero(_reach(found, balance, r, bound) > most)
    if not some.size:
        return best, (c[:0], r[:0])
    left, right = left_over(_over(found[some], balance[some], r[some]) > most)
    width = r[some, None] * 2 / NODES
    a, b = (c[some] - r[some])[:, None] + width * left, (c[some] - r[some])[:, None] + width * right
    rest = right > left
    return best, (((a + b) / 2)[rest], ((b - a) / 2)[rest])


def _reach(found: Taylor, balance: Array, r: Array, sigma: Array) -> Array:
    """A rough bound of sigma over each interval, from Frobenius norms."""
    scale = np.exp(balance[:, :, None] - balance[:, None, :])
    with np.errstate(over="ignore"):
        slope, bend, rest = (np.sqrt(((np.abs(x) * scale) ** 2).sum(axis=(1, 2))) for x in (found.slope, found.bend, found.rest))
        return np.asarray(sigma + r * slope + r * r / 2 * bend + rest)


def _over(found: Taylor, balance: Array, r: Array) -> Array:
    """Bounds (k, NODES) of sigma over equal cells of each interval, from the nodes of the quadratic."""
    scale = np.exp(balance[:, :, None] - balance[:, None, :])
    value, slope, bend, rest = (x * scale for x in (found.value, found.slope, found.bend, found.rest))
    with np.errstate(over="ignore"):
        rest, bent = (np.sqrt((np.abs(x) ** 2).sum(axis=(1, 2))) for x in (rest, bend))
    x = (r[:, None] * np.linspace(-1, 1, NODES + 1))[:, :, None, None]
    nodes = value[:, None] + x * slope[:, None] + x * x / 2 * bend[:, None]
    one = nodes.shape[-1] == 1
    sigma = np.abs(nodes[..., 0, 0]) if one else np.sqrt(np.linalg.eigvalsh(np.swapaxes(nodes.conj(), -1, -2) @ nodes)[..., -1])
    return over_cells(sigma, bent, rest, r)
