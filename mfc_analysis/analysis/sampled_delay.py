"""Delay margins of loops with a sampled controller: the smallest additional dead time with a root on the contour, exact (``shifted``).

With Y/U = r e^(j a) at the angle theta = omega h, a dead time of T = d + f samples puts a root on the unit circle where r(theta, f) = 1 and
(d + 1) theta = a(theta, f) + 2 pi k. The curves r = 1 in the plane of theta and f are followed through crossovers at nodes of f; they turn
back where two crossovers meet. A whole d between the values of (a + 2 pi k)/theta - 1 at the ends of a segment is a candidate, polished by
Newton in (theta, T). Roots that leave through z = -1 or through the arc of the slow roots are found apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.frequency.arc import angles
from mfc_analysis.analysis.shifted import Shifted, shifted
from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

NODES = 4  #: of f in [0, 1], at least,
INNER = 2  #: and in each piece
FOLDS = 10  #: halvings of f towards a place where a curve turns back
LONGEST = 2000  #: [samples] longest additional dead time at which a crossing is sought of a curve that does not reach all fractions
STEEPEST = 3.0  #: a maximum of log r further below zero than this is no place to search, of CLIMBS zooms
CLIMBS = 5
TURNS = 3  #: turns k tried at first
SLACK = 0.3  #: [samples] and
SHARE = 0.05  #: of the time: candidates this close to the first are all polished
NEWTON = 12  #: steps
MOST_TURN = 10.0  #: [samples] largest slope of D along a segment,
TOUCH = 1e-3  #: and how near to a whole number counts as passing it
SAME = 1e-9  #: [samples] a crossing this close to the present dead time is the loop itself
DIRECT = 1e-12  #: gain from a channel to itself within the sample that counts,
FINE, ARC, HALVINGS = 12, 60, 40  #: frequencies a sample of dead time, angles on the arc, along which such a loop is judged, and their halvings
ENTRIES = 3_000_000  #: complex numbers of the polynomials of one chunk of points


def sampled_delays(system: OpenSystem, at: str, theta: Array, modes: tuple[Complex, Complex], modal: Bools) -> tuple[Array, Array]:
    """Delay margins [s] and their frequencies [rad/s], (m, n), of a stable sampled loop at ``at``; inf where there is none.

    ``theta``: (m, k) increasing angles [rad] from those of 1/horizon on that resolve the closed poles. ``modes``: these (m, nx) and their
    vectors, used where ``modal`` (m,).
    """
    n = len(np.arange(system.nw)[system.wires[at]])
    delay, where = np.full((len(theta), n), np.inf), np.full((len(theta), n), np.inf)
    step = max(1, ENTRIES // (n * 16 * system.nx * max(1, int(np.log2(system.nx)))))
    for use in (True, False):
        some = np.flatnonzero(modal == use)
        for k in range(0, some.size, step):
            chunk = some[k : k + step]
            found = shifted(system.at(chunk), at, (modes[0][chunk], modes[1][chunk]) if use else None)
            T, angle = _first(found, theta[chunk], modes[0][chunk], system.radius * system.dt)
            delay[chunk], where[chunk] = (T - found.present) * system.dt, angle / system.dt
    return delay, where


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

    def __getitem__(self, some: Ints | Bools) -> _Points:
        return _Points(*(values[some] for values in vars(self).values()))


def _first(loop: Shifted, theta: Array, poles: Complex, radius: float) -> tuple[Array, Array]:
    """The smallest total dead time (m, n) [samples] above the present one with a root on the contour, and its angle [rad]."""
    theta = np.concatenate([theta, np.full((len(theta), 1), np.pi)], axis=1)
    count = max(INNER, -(-NODES // (loop.edges.size - 1)))
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
    start, end = _segments(loop, f, gamma, delta, theta, size)
    best = np.full(size.shape[:2], np.inf), np.full(size.shape[:2], np.inf)
    _search(loop, start, end, radius, best)
    _least(best, *_at_nyquist(loop))
    if radius > 0:
        _least(best, *_on_the_arc(loop, poles, radius))
    _jumped(loop, theta, radius, best)
    return best


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
        drop = sum(value - np.where(np.isfinite(lower), lower, value) for pair in ((1, 6), (3, 4)) for lower in (np.minimum(*(around[i] for i in pair)),))
        top &= -value < drop
        point, channel, j, k = np.nonzero(top)
        low = np.stack([theta[point, np.maximum(k - 1, 0)], f[np.maximum(j - 1, 0)]])
        high = np.stack([theta[point, np.minimum(k + 1, K - 1)], f[np.minimum(j + 1, J - 1)]])
        mesh = np.stack(np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7))).reshape(2, 1, -1)
        for _ in range(CLIMBS if point.size else 0):
            places = low[..., None] + (high - low)[..., None] * mesh
            cases = np.repeat(point, mesh.shape[2]), np.repeat(channel, mesh.shape[2])
            found = sign * loop.at(*cases, np.exp(1j * places[0].ravel()), places[1].ravel())[0].real.reshape(point.size, -1)
            best = np.nanargmax(np.where(np.isnan(found), -np.inf, found), axis=1)
            middle, step = places[:, np.arange(point.size), best], (high - low) / 6
            low, high, most = np.maximum(middle - step, low), np.minimum(middle + step, high), found[np.arange(point.size), best]
            if (most > 0).all():
                break
        if point.size:
            parts.append((point[most > 0], middle[0][most > 0], middle[1][most > 0]))
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True)) if parts else (np.zeros(0, int), np.zeros(0), np.zeros(0))


# --- the curves ------------------------------------------------------------------------------------------------------


def _segments(loop: Shifted, f: Array, gamma: Complex, delta: Array, theta: Array, size: Array) -> tuple[_Points, _Points]:
    """The ends of the segments of all curves; ``size``: log r (m, n, J, k) at the nodes f (J,) and angles theta (m, k)."""
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
    each = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)
    start, end = np.repeat(first[row, node], times) + each, np.repeat(first[row, node + 1], times) + each
    parts = [(found[start], found[end])]
    for row, node in zip(*np.nonzero(number[:, :-1] != number[:, 1:]), strict=True):
        a, b = (found[first[row, j] + np.arange(number[row, j])] for j in (node, node + 1))
        parts += _folded(loop, int(row // n), int(row % n), theta[row // n], (float(f[node]), a), (float(f[node + 1]), b), FOLDS)
    return _joined([a for a, _ in parts]), _joined([b for _, b in parts])


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
    found = _crossovers(loop, *one, np.repeat(gamma, k.size, 0), np.repeat(delta, k.size), np.full(k.size, middle), theta[k], theta[k + 1], size[k], size[k + 1])
    return [
        *_folded(loop, point, channel, theta, low, (middle, found), depth - 1),
        *_folded(loop, point, channel, theta, (middle, found), high, depth - 1),
    ]


# --- candidates and roots --------------------------------------------------------------------------------------------

_Cases = tuple[Ints, Ints, Array, Array]  # point, channel, angle, dead time [samples]


def _search(loop: Shifted, start: _Points, end: _Points, lowest: float, best: tuple[Array, Array]) -> None:
    """Polish what may be the first of each channel, the earliest first, until no earlier candidate is left."""
    point, channel, angle, T = _candidates(loop, start, end, best[0].shape)
    while T.size:
        first = np.full(best[0].shape, np.inf)
        np.minimum.at(first, (point, channel), np.where(T > loop.present[channel], T, np.inf))
        near = T <= first[point, channel] * (1 + SHARE) + SLACK
        _least(best, *_polished(loop, point[near], channel[near], angle[near], T[near], _circle, lowest))
        left = ~near & (T <= best[0][point, channel] * (1 + SHARE) + SLACK)
        point, channel, angle, T = point[left], channel[left], angle[left], T[left]


def _circle(theta: Array) -> tuple[Complex, Complex, Complex]:
    return np.exp(1j * theta), 1j * theta, np.full(theta.size, 1j)


def _candidates(loop: Shifted, start: _Points, end: _Points, shape: tuple[int, ...]) -> _Cases:
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
            (np.where(by_f, df, -dtheta * one.by_theta.real / one.by_f.real), np.where(by_f, df * slope, dtheta)) for (one, _), slope in zip(ends, bend, strict=True)
        ]
    rise = [one.by_f.imag * f + one.by_theta.imag * theta for (one, _), (f, theta) in zip(ends, tangents, strict=True)]
    lowest = np.floor(np.min([((now + 1 - one.f) * one.theta - phase) / (2 * np.pi) for one, phase in ends], axis=0))

    def passed(i: Ints, k: Array) -> _Cases:
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
        for x0, x1 in zip(knots[:-1], knots[1:], strict=True):
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
        np.minimum.at(best, (point, channel), np.where(T > loop.present[channel] + SAME, T, np.inf))
    until = np.minimum(best[start.point, start.channel] * (1 + SHARE) + 2, now + LONGEST)
    number = np.floor((until + 1) * np.maximum(start.theta, end.theta) / (2 * np.pi) - lowest - TURNS + 2).astype(np.int64)
    for segment in np.flatnonzero(number > 0):
        found.append(passed(np.full(number[segment], segment), lowest[segment] + TURNS + np.arange(number[segment])))
    point, channel, angle, T = (np.concatenate(one) for one in zip(*found, strict=True))
    ahead = T > loop.present[channel] - 0.1
    return point[ahead], channel[ahead], angle[ahead], T[ahead]


_Contour = Callable[[Array], tuple[Complex, Complex, Complex]]  # parameter -> z, ln z and its slope


def _polished(loop: Shifted, point: Ints, channel: Ints, u: Array, T: Array, contour: _Contour, lowest: float) -> _Cases:
    """Newton in the parameter of the contour and the dead time; those that converge to a later dead time than the present one."""
    u, T, first = u.copy(), T.copy(), T.copy()
    miss = np.full(u.size, np.inf)
    for _ in range(NEWTON):
        d = np.maximum(np.ceil(T) - 1, 0)
        z, log_z, slope = contour(u)
        value, by_z, by_f = loop.at(point, channel, z, T - d)
        error = value - (d + 1) * log_z
        error = error.real + 1j * (np.remainder(error.imag + np.pi, 2 * np.pi) - np.pi)
        miss = np.abs(error)
        by_u = (by_z * z - (d + 1)) * slope
        with np.errstate(divide="ignore", invalid="ignore"):
            across = by_u.real * by_f.imag - by_u.imag * by_f.real
            du = (error.real * by_f.imag - error.imag * by_f.real) / across
            dT = (by_u.real * error.imag - by_u.imag * error.real) / across
        size = np.maximum(np.maximum(np.abs(du) / (0.2 * np.abs(u) + 1e-3), np.abs(dT) / 0.3), 1)
        go = np.isfinite(du) & np.isfinite(dT)
        if not go.any() or (np.abs(dT[go]) <= 1e-13 * T[go]).all():
            break
        u, T = np.where(go, u - du / size, u), np.where(go, T - dT / size, T)
    good = (miss < 1e-7) & (T > loop.present[channel] + SAME) & (np.abs(T - first) < 1 + 0.1 * first) & (u >= lowest * (1 - 1e-9)) & (u <= np.pi)
    return point[good], channel[good], u[good], T[good]


def _at_nyquist(loop: Shifted) -> _Cases:
    """Roots that leave through z = -1, where Y/U is real: 1 for odd d, -1 for even d."""
    m, n = loop.at_infinity.shape
    f = np.unique(np.concatenate([np.linspace(a, b, 5) for a, b in zip(loop.edges[:-1], loop.edges[1:], strict=True)]))
    ratio = loop.over(np.full((m, 1), -1.0 + 0j), *loop.nodes(f))[..., 0].real
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(ratio))
    point, channel, k = np.nonzero(((size[..., 1:] > 0) != (size[..., :-1] > 0)) & (ratio[..., 1:] * ratio[..., :-1] > 0))
    a, b, high = f[k], f[k + 1], size[point, channel, k + 1] > 0
    x = (a + b) / 2
    z = np.full(k.size, -1.0 + 0j)
    for _ in range(60):
        value, _, slope = loop.at(point, channel, z, x)
        right = (value.real > 0) == high
        a, b = np.where(right, a, x), np.where(right, x, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - value.real / slope.real
        inside = (step > a) & (step < b)
        if not k.size or (np.abs(np.where(inside, step, (a + b) / 2) - x) < 1e-15).all():
            break
        x = np.where(inside, step, (a + b) / 2)
    odd = ratio[point, channel, k] > 0
    d = np.maximum(np.ceil(loop.present[channel] + SAME - x), 0)
    d += (np.remainder(d, 2) == 1) != odd
    return point, channel, np.full(k.size, np.pi), d + x


def _on_the_arc(loop: Shifted, poles: Complex, radius: float) -> _Cases:
    """Roots that leave through the arc s = radius e^(j phi) of the slow roots; the parameter is phi, the angle returned that of z."""
    m, n = loop.at_infinity.shape
    phi = angles(rates(poles, 1.0), radius)
    s = radius * np.exp(1j * phi)
    half = np.array([0.5])
    ratio = loop.over(np.exp(s), *loop.nodes(half))[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.unwrap(np.angle(ratio), axis=2)
        a -= np.where(np.abs(a[..., :1]) < 1, a[..., :1], a[..., :1] - np.pi)
        log = np.log(np.abs(ratio)) + 1j * a
    log = np.where(np.isfinite(log), log, -99.0)  # a channel without a loop
    found = []
    for k in (0, 1):
        T = (log + 2j * np.pi * k) / s[:, None] - 0.5
        point, channel, i = np.nonzero((T.imag[..., 1:] > 0) != (T.imag[..., :-1] > 0))
        share = T.imag[point, channel, i] / (T.imag[point, channel, i] - T.imag[point, channel, i + 1])
        at = T.real[point, channel, i] + share * (T.real[point, channel, i + 1] - T.real[point, channel, i])
        found.append((point, channel, phi[point, i] + share * (phi[point, i + 1] - phi[point, i]), at))
        if k == 0:
            point, channel = np.nonzero(ratio[..., 0].real > 0)
            found.append((point, channel, np.zeros(point.size), T.real[point, channel, 0]))
    point, channel, u, T = (np.concatenate(one) for one in zip(*found, strict=True))
    ahead = T > loop.present[channel] + SAME
    point, channel, u, T = point[ahead], channel[ahead], u[ahead], T[ahead]
    point, channel, u, T = _polished(
        loop, point, channel, u, T,
        lambda x: (np.exp(radius * np.exp(1j * x)), radius * np.exp(1j * x), 1j * radius * np.exp(1j * x)), -np.inf,
    )  # fmt: skip
    inside = (u > -1e-9) & (u < np.pi / 2)
    return point[inside], channel[inside], radius * np.sin(u[inside]), T[inside]


def _jumped(loop: Shifted, theta: Array, radius: float, best: tuple[Array, Array]) -> None:
    """Where a channel acts on itself within the sample, a dead time just above a whole number costs one sample more and may be a loss.

    No root is on the contour there (its angle: inf). The loop is lost where U - z^-(d + 1) Y(z; 0+) turns around zero on the contour.
    """
    direct = (np.abs(loop.old_direct) > DIRECT) | (np.abs(loop.delta) > DIRECT).any(axis=(2, 3))
    for point, channel in zip(*np.nonzero(direct), strict=True):
        now = float(loop.present[channel])
        last = min(best[0][point, channel], now + LONGEST)

        def log_ratio(p: Array, point: int = point, channel: int = channel) -> tuple[Complex, Complex]:
            """ln z at p along the contour, -1 to 0 on the arc and then the angle beyond it, and log Y/U there."""
            log_z = np.where(p < 0, radius * np.exp(1j * np.pi / 2 * np.minimum(p + 1, 1)), 1j * (radius + np.maximum(p, 0)))
            with np.errstate(divide="ignore", invalid="ignore"):
                return log_z, loop.at(np.full(p.size, point), np.full(p.size, channel), np.exp(log_z), np.zeros(p.size))[0]

        along = np.union1d(np.linspace(0, np.pi - radius, int(FINE * (last + 1))), np.maximum(theta[point] - radius, 0))
        p = np.concatenate([np.linspace(-1, 0, ARC)[:-1] if radius > 0 else np.zeros(0), along])
        log_z, log = log_ratio(p)
        if not (log.real > 0).any():  # smaller than one all along: never lost
            continue
        for d in np.arange(np.ceil(now - SAME), last):
            x, F = p, 1 - np.exp(log - (d + 1) * log_z)
            for _ in range(HALVINGS):
                wide = np.flatnonzero(np.abs(np.angle(F[1:] / F[:-1])) > 1)
                if not wide.size:
                    break
                middle = (x[wide] + x[wide + 1]) / 2
                where, more = log_ratio(middle)
                x, F = np.insert(x, wide + 1, middle), np.insert(F, wide + 1, 1 - np.exp(more - (d + 1) * where))
            if abs(np.angle(F[1:] / F[:-1]).sum()) > np.pi / 2:
                best[0][point, channel], best[1][point, channel] = max(d, now), np.inf
                break


def _least(best: tuple[Array, Array], point: Ints, channel: Ints, angle: Array, T: Array) -> None:
    order = np.argsort(-T, kind="stable")  # of several for one entry the smallest is written last
    point, channel, angle, T = point[order], channel[order], angle[order], T[order]
    better = T < best[0][point, channel]
    best[0][point[better], channel[better]], best[1][point[better], channel[better]] = T[better], angle[better]
