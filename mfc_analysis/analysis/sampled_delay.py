"""Delay margins of loops with a sampled controller: the smallest additional dead time with a root on the contour, exact (``shifted``).

With Y/U = r e^(j a) at the angle theta = omega h, a dead time of T = d + f samples puts a root on the unit circle where r(theta, f) = 1 and
(d + 1) theta = a(theta, f) + 2 pi k. The curves r = 1 in the plane of theta and f are followed through crossovers at nodes of f; they turn
back where two crossovers meet. A whole d between the values of (a + 2 pi k)/theta - 1 at the ends of a segment is a candidate, polished by
Newton in (theta, T). Roots that leave through z = -1 or through the arc of the slow roots are found apart.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.late_roots import LONGEST, SAME, Cases, at_nyquist, circle, jumped, least, on_the_arc, polished
from mfc_analysis.analysis.shifted import Shifted, shifted
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

NODES = 4  #: of f in [0, 1], at least,
INNER = 2  #: and in each piece; more
MOST_NODES = 64  #: (up to these) at points where
BENT = 0.03  #: [samples] the third order of a curve moves d by more than this
FOLDS = 10  #: halvings of f towards a place where a curve turns back
STEEPEST = 3.0  #: a maximum of log r further below zero than this is no place to search, of CLIMBS zooms
CLIMBS = 5
TURNS = 3  #: turns k tried at first
SLACK = 0.3  #: [samples] and
SHARE = 0.05  #: of the time: candidates this close to the first are all polished
MOST_TURN = 10.0  #: [samples] largest slope of D along a segment,
TOUCH = 1e-3  #: and how near to a whole number counts as passing it
ENTRIES = 3_000_000  #: complex numbers of the polynomials of one chunk of points


def sampled_delays(system: OpenSystem, at: str, theta: Array, modes: tuple[Complex, Complex], modal: Bools) -> tuple[Array, Array]:
    """Delay margins [s] and their frequencies [rad/s], (m, n), of a stable sampled loop at ``at``; inf where there is none.

    ``theta``: (m, k) increasing angles [rad] from those of 1/horizon on that resolve the closed poles. ``modes``: these (m, nx) and their
    vectors, used where ``modal`` (m,).
    """
    n = len(np.arange(system.nw)[system.wires[at]])
    delay, where = np.full((len(theta), n), np.inf), np.full((len(theta), n), np.inf)
    step = max(1, ENTRIES // (n * 16 * system.nx * max(1, int(np.log2(system.nx)))))
    todo = [(chunk, use, NODES) for use in (True, False) for chunk in _chunks(np.flatnonzero(modal == use), step)]
    while todo:
        chunk, use, nodes = todo.pop()
        found = shifted(system.at(chunk), at, (modes[0][chunk], modes[1][chunk]) if use else None)
        T, angle, rough = _first(found, theta[chunk], modes[0][chunk], system.radius * system.dt, nodes)
        delay[chunk], where[chunk] = (T - found.present) * system.dt, angle / system.dt
        if rough.any() and nodes < MOST_NODES:
            todo += [(some, use, 4 * nodes) for some in _chunks(chunk[rough], max(1, step // 4))]
    return delay, where


def _chunks(index: Ints, step: int) -> list[Ints]:
    return [index[k : k + step] for k in range(0, index.size, step)]


@dataclass(frozen=True, eq=False)
class _Points:
    """k points of the curves r = 1, each with its point and channel, and with the slopes of log Y/U."""

    point: Ints
    channel: Ints
    f: Array
    theta: Array
    phase: Array
    by_theta: Complex
    by_f: Complex

    def __getitem__(self, some: Ints | Bools | slice) -> _Points:
        return _Points(*(values[some] for values in vars(self).values()))


def _first(loop: Shifted, theta: Array, poles: Complex, radius: float, nodes: int) -> tuple[Array, Array, Bools]:
    """The smallest total dead time (m, n) [samples] above the present one with a root on the contour, and its angle [rad].

    Also (m,) the points at which a curve bends so much between its ``nodes`` that more of them are needed.
    """
    theta = np.concatenate([theta, np.full((len(theta), 1), np.pi)], axis=1)
    count = max(INNER, -(-nodes // (loop.edges.size - 1)))
    f = np.unique(np.concatenate([np.linspace(a, b, count + 1) for a, b in zip(loop.edges[:-1], loop.edges[1:], strict=True)]))
    gamma, delta = loop.nodes(f)
    size = _sizes(loop, theta, gamma, delta)
    point, at_theta, at_f = _islands(loop, f, theta, size)
    if point.size:
        extra = np.full((len(theta), point.size), np.pi)
        extra[point, np.arange(point.size)] = at_theta
        theta, f = np.sort(np.concatenate([theta, extra], axis=1), axis=1), np.union1d(f, at_f)
        gamma, delta = loop.nodes(f)
        size = _sizes(loop, theta, gamma, delta)
    start, end, regular = _segments(loop, f, gamma, delta, theta, size)
    best = np.full(size.shape[:2], np.inf), np.full(size.shape[:2], np.inf)
    _search(loop, start, end, radius, best)
    least(best, *at_nyquist(loop))
    if radius > 0:
        least(best, *on_the_arc(loop, poles, radius))
    jumped(loop, theta, radius, best)
    rough = np.zeros(len(theta), bool)
    rough[start.point[:regular][_bent(loop, start[:regular], end[:regular])]] = True
    return *best, rough


def _sizes(loop: Shifted, theta: Array, gamma: Complex, delta: Array) -> Array:
    """log r (m, n, J, k) at the nodes of f and the angles theta (m, k)."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.clip(np.log(np.abs(loop.over(np.exp(1j * theta), gamma, delta))), -99, 99))


def _islands(loop: Shifted, f: Array, theta: Array, size: Array) -> tuple[Ints, Array, Array]:
    """Points, angles and fractions (k,) at which log r has another sign than at all places of the grid around."""
    parts = []
    for sign in (1, -1):
        value = sign * size
        padded = np.pad(value, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
        J, K = value.shape[2:]
        around = [padded[:, :, 1 + a : 1 + a + J, 1 + b : 1 + b + K] for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
        top = (value < 0) & (value > -STEEPEST)
        for one in around:
            top &= value >= one
        fallen = np.minimum(around[1], around[6]), np.minimum(around[3], around[4])  # to the neighbours in f, in theta
        top &= -value < sum(value - np.where(np.isfinite(lower), lower, value) for lower in fallen)
        point, channel, j, k = np.nonzero(top)
        low = np.stack([theta[point, np.maximum(k - 1, 0)], f[np.maximum(j - 1, 0)]])
        high = np.stack([theta[point, np.minimum(k + 1, K - 1)], f[np.minimum(j + 1, J - 1)]])
        mesh = np.stack(np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7))).reshape(2, 1, -1)
        if not point.size:
            continue
        middle, most = low, np.zeros(point.size)
        for _ in range(CLIMBS):
            places = low[..., None] + (high - low)[..., None] * mesh
            cases = np.repeat(point, mesh.shape[2]), np.repeat(channel, mesh.shape[2])
            found = sign * loop.at(*cases, np.exp(1j * places[0].ravel()), places[1].ravel())[0].real.reshape(point.size, -1)
            best = np.nanargmax(np.where(np.isnan(found), -np.inf, found), axis=1)
            middle, step = places[:, np.arange(point.size), best], (high - low) / 6
            low, high, most = np.maximum(middle - step, low), np.minimum(middle + step, high), found[np.arange(point.size), best]
            if (most > 0).all():
                break
        parts.append((point[most > 0], middle[0][most > 0], middle[1][most > 0]))
    parts.append((np.zeros(0, np.int64), np.zeros(0), np.zeros(0)))
    point, angle, fraction = (np.concatenate(one) for one in zip(*parts, strict=True))
    return np.asarray(point, np.int64), angle, fraction


# --- the curves ------------------------------------------------------------------------------------------------------


def _segments(loop: Shifted, f: Array, gamma: Complex, delta: Array, theta: Array, size: Array) -> tuple[_Points, _Points, int]:
    """The ends of the segments of all curves, and how many, the first, are not near a fold.

    ``size``: log r (m, n, J, k) at the nodes f (J,) and angles theta (m, k).
    """
    m, n, J, _ = size.shape
    above = size > 0
    point, channel, node, k = np.nonzero(above[..., 1:] != above[..., :-1])
    found = _crossovers(
        loop, point, channel, gamma[point, channel, node], delta[point, channel, node], f[node], theta[point, k], theta[point, k + 1],
        size[point, channel, node, k], size[point, channel, node, k + 1],
    )  # fmt: skip
    number = np.bincount((point * n + channel) * J + node, minlength=m * n * J).reshape(m * n, J)
    first = (np.cumsum(number.ravel()) - number.ravel()).reshape(m * n, J)
    row, node = np.nonzero((number[:, :-1] == number[:, 1:]) & (number[:, 1:] > 0))
    times = number[row, node]
    each = np.arange(int(times.sum())) - np.repeat(np.cumsum(times) - times, times)
    start, end = np.repeat(first[row, node], times) + each, np.repeat(first[row, node + 1], times) + each
    parts = [(found[start], found[end])]
    for row, node in zip(*np.nonzero(number[:, :-1] != number[:, 1:]), strict=True):
        a, b = (found[first[row, j] + np.arange(int(number[row, j]))] for j in (node, node + 1))
        parts += _folded(loop, int(row // n), int(row % n), theta[row // n], (float(f[node]), a), (float(f[node + 1]), b), FOLDS)
    return _joined([a for a, _ in parts]), _joined([b for _, b in parts]), parts[0][0].f.size


def _bent(loop: Shifted, start: _Points, end: _Points) -> Bools:
    """Segments of which a cubic with the slopes of both ends does not tell enough: its third order matters for whole d."""
    df, dtheta = end.f - start.f, end.theta - start.theta
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = [-one.by_f.real / one.by_theta.real for one in (start, end)]
        third = np.abs(df * (slopes[0] + slopes[1]) - 2 * dtheta) * np.maximum(
            loop.present[start.channel] + 1, start.phase % (2 * np.pi) / start.theta
        )
        return np.asarray(~(third < BENT * np.minimum(start.theta, end.theta)))


def _joined(parts: list[_Points]) -> _Points:
    return _Points(*(np.concatenate(values) for values in zip(*(vars(one).values() for one in parts), strict=True)))


def _crossovers(
    loop: Shifted, point: Ints, channel: Ints, gamma: Complex, delta: Array, f: Array, a: Array, b: Array, fa: Array, fb: Array
) -> _Points:  # fmt: skip
    """The crossovers between a and b, where log r changes its sign, at known fractions (Illinois rule)."""
    a, b, fa, fb = a.copy(), b.copy(), np.clip(fa, -50, 50), np.clip(fb, -50, 50)
    x, phase, todo = b.copy(), np.zeros(a.size), np.arange(a.size)
    for _ in range(60):
        if not todo.size:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            secant = (a[todo] * fb[todo] - b[todo] * fa[todo]) / (fb[todo] - fa[todo])
        x[todo] = np.where((secant > a[todo]) & (secant < b[todo]), secant, (a[todo] + b[todo]) / 2)
        z = np.exp(1j * x[todo])
        ratio = loop.ratio(loop.left(point[todo], channel[todo], z)[0], z, gamma[todo], delta[todo], point[todo], channel[todo])
        with np.errstate(divide="ignore"):
            fx = np.clip(np.log(np.abs(ratio)), -50, 50)
        phase[todo] = np.angle(ratio)
        right = (fx > 0) == (fb[todo] > 0)
        fa[todo], fb[todo] = np.where(right, fa[todo] / 2, fx), np.where(right, fx, fb[todo] / 2)
        a[todo], b[todo] = np.where(right, a[todo], x[todo]), np.where(right, x[todo], b[todo])
        todo = todo[(np.abs(fx) > 1e-8) & (b[todo] - a[todo] > 1e-13 * b[todo])]
    _, by_z, by_f = loop.at(point, channel, np.exp(1j * x), f)
    return _Points(point, channel, f, x, phase, 1j * np.exp(1j * x) * by_z, by_f)


def _folded(
    loop: Shifted, point: int, channel: int, theta: Array, low: tuple[float, _Points], high: tuple[float, _Points], depth: int
) -> list[tuple[_Points, _Points]]:  # fmt: skip
    """The segments between two fractions with different numbers of crossovers: halved towards the fold, at which the two ends are joined."""
    (fa, a), (fb, b) = low, high
    if a.f.size == b.f.size:
        return [(a, b)] if a.f.size else []
    if depth == 0:
        few, many = sorted((a, b), key=lambda one: one.f.size)
        left = np.ones(many.f.size, bool)
        links = []
        for i in range(few.f.size):
            near = int(np.argmin(np.where(left, np.abs(many.theta - few.theta[i]), np.inf)))
            left[near] = False
            links.append((few[np.array([i])], many[np.array([near])]))
        rest = np.flatnonzero(left)
        return links + [(many[rest[k : k + 1]], many[rest[k + 1 : k + 2]]) for k in range(0, rest.size - 1, 2)]
    middle = (fa + fb) / 2
    cases = np.full(theta.size, point), np.full(theta.size, channel)
    size = loop.at(*cases, np.exp(1j * theta), np.full(theta.size, middle))[0].real
    k = np.flatnonzero((size[1:] > 0) != (size[:-1] > 0))
    one = np.full(k.size, point), np.full(k.size, channel)
    gamma, delta = loop.node(point, channel, middle)
    found = _crossovers(
        loop, *one, np.repeat(gamma, k.size, 0), np.repeat(delta, k.size), np.full(k.size, middle), theta[k], theta[k + 1], size[k], size[k + 1]
    )
    return [
        *_folded(loop, point, channel, theta, low, (middle, found), depth - 1),
        *_folded(loop, point, channel, theta, (middle, found), high, depth - 1),
    ]


# --- candidates and roots --------------------------------------------------------------------------------------------


def _search(loop: Shifted, start: _Points, end: _Points, lowest: float, best: tuple[Array, Array]) -> None:
    """Polish what may be the first of each channel, the earliest first, until no earlier candidate is left."""
    point, channel, angle, T = _candidates(loop, start, end, best[0].shape)
    while T.size:
        first = np.full(best[0].shape, np.inf)
        np.minimum.at(first, (point, channel), np.where(loop.present[channel] < T, T, np.inf))
        near = first[point, channel] * (1 + SHARE) + SLACK >= T
        least(best, *polished(loop, point[near], channel[near], angle[near], T[near], circle, lowest))
        left = ~near & (best[0][point, channel] * (1 + SHARE) + SLACK >= T)
        point, channel, angle, T = point[left], channel[left], angle[left], T[left]


def _candidates(loop: Shifted, start: _Points, end: _Points, shape: tuple[int, ...]) -> Cases:
    """Where a segment passes a whole d. Between its ends D = (a + 2 pi k)/theta - 1 is a cubic with the slopes of both."""
    now = loop.present[start.channel]
    turn = start.phase + np.remainder(end.phase - start.phase + np.pi, 2 * np.pi) - np.pi
    ends = [(one, phase) for one, phase in ((start, start.phase), (end, turn))]
    df, dtheta = end.f - start.f, end.theta - start.theta
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = [-one.by_f.real / one.by_theta.real for one, _ in ends]
        steep = np.maximum(np.abs(bend[0]), np.abs(bend[1])) * np.abs(df) > 3 * np.abs(dtheta) + 1e-3
        along = (bend[0] * df * dtheta > 0) & (bend[1] * df * dtheta > 0)  # theta does not turn back
        by_f = ~(steep & along) & (df != 0)
        tangents = [
            (np.where(by_f, df, -dtheta * one.by_theta.real / one.by_f.real), np.where(by_f, df * slope, dtheta))
            for (one, _), slope in zip(ends, bend, strict=True)
        ]
    rise = [one.by_f.imag * f + one.by_theta.imag * theta for (one, _), (f, theta) in zip(ends, tangents, strict=True)]
    lowest = np.floor(np.min([((now + 1 - one.f) * one.theta - phase) / (2 * np.pi) for one, phase in ends], axis=0))

    def passed(i: Ints, k: Array) -> Cases:
        (da, sa), (db, sb) = (
            ((phase[i] + 2 * np.pi * k) / one.theta[i] - 1, (up[i] - (phase[i] + 2 * np.pi * k) / one.theta[i] * along[1][i]) / one.theta[i])
            for (one, phase), along, up in zip(ends, tangents, rise, strict=True)
        )
        straight = db - da
        sa, sb = (np.where(np.isfinite(s), np.clip(s, -MOST_TURN, MOST_TURN), straight) for s in (sa, sb))
        c2, c3 = 3 * straight - 2 * sa - sb, sa + sb - 2 * straight  # D = da + sa x + c2 x^2 + c3 x^3

        def cubic(x: Array) -> Array:
            return da + x * (sa + x * (c2 + x * c3))

        root = np.sqrt(np.maximum(c2 * c2 - 3 * c3 * sa, 0))
        q = -(c2 + np.where(c2 < 0, -root, root))
        with np.errstate(divide="ignore", invalid="ignore"):
            turns = np.sort(np.nan_to_num(np.clip([q / (3 * c3), sa / q], 0, 1)), axis=0)
        knots = [np.zeros(i.size), turns[0], turns[1], np.ones(i.size)]
        parts = []
        for x0, x1 in itertools.pairwise(knots):
            d0, d1 = cubic(x0), cubic(x1)
            lo, hi = np.minimum(d0, d1), np.maximum(d0, d1)
            first = np.maximum(np.ceil(lo - TOUCH), np.ceil(now[i] - np.maximum(start.f, end.f)[i]))
            for more in range(2):
                d = first + more
                some = np.flatnonzero((d <= hi + TOUCH) & (x1 >= x0))
                a, b = x0[some], x1[some]
                up = d1[some] > d0[some]
                whole = (da[some], sa[some], c2[some], c3[some])
                for _ in range(20):
                    x = (a + b) / 2
                    above = (whole[0] + x * (whole[1] + x * (whole[2] + x * whole[3])) > d[some]) == up
                    a, b = np.where(above, a, x), np.where(above, x, b)
                x, s = (a + b) / 2, i[some]
                theta, f = start.theta[s] + x * dtheta[s], start.f[s] + x * df[s]
                parts.append((start.point[s], start.channel[s], theta, d[some] + f))
        return tuple(np.concatenate(one) for one in zip(*parts, strict=True))  # type: ignore[return-value]

    every = np.arange(start.f.size)
    found = [passed(every, lowest + k) for k in range(TURNS)]
    best = np.full(shape, np.inf)
    for point, channel, _, T in found:
        np.minimum.at(best, (point, channel), np.where(loop.present[channel] + SAME < T, T, np.inf))
    until = np.minimum(best[start.point, start.channel] * (1 + SHARE) + 2, now + LONGEST)
    number = np.floor((until + 1) * np.maximum(start.theta, end.theta) / (2 * np.pi) - lowest - TURNS + 2).astype(np.int64)
    for segment in np.flatnonzero(number > 0):
        k = np.arange(int(number[segment]))
        found.append(passed(np.full(k.size, segment), lowest[segment] + TURNS + k))
    point, channel, angle, T = (np.concatenate(one) for one in zip(*found, strict=True))
    ahead = loop.present[channel] - 0.1 < T
    return point[ahead], channel[ahead], angle[ahead], T[ahead]
