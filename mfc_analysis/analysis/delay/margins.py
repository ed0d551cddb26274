"""Exact margins of loops with dead time: e^(-jwT) on every delayed wire, without Pade approximation.

There are infinitely many crossings of the sensitivities (``sensitivities``). They are bracketed on a frequency grid that
resolves the open and closed poles, the roots of the loop with dead time near the axis (by the samples of the verdict's count), and the phase of
e^(-jwT); then polished. The search continues to higher frequencies until no further crossing can limit a margin. No frequency below
1/horizon counts; a gain interval also ends on the indentation of the contour (``arc``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.channels import Channels, channels
from mfc_analysis.analysis.delay.grid import between, room
from mfc_analysis.analysis.delay.sensitivities import Sensitivities, sensitivities
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, arc_delays, places
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned
from mfc_analysis.analysis.margin_metrics import FARTHEST, MarginMetrics, also_late, assembled, put
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

MOST = 40_000  #: frequencies at one point
CHUNK = 1_000_000  #: complex numbers at a time
NEAR, CLIMBED = 0.7, 3  #: a local maximum of at least this fraction of the highest is refined, and this many of them
LEVEL, SAME = (
    1e-9,
    1e-13,
)  #: relative rise of the last step and of the next one, to the vertex of the parabola through three places, at which the refinement ends
FLAT = 1e-9  #: relative difference of two sizes below which they count as equal
TURN = 0.2  #: [rad] phase of e^(-jwT) between two frequencies,
DECADE = 30  #: and frequencies in a decade
MOST_STEPS = 60  #: of a search for a crossing,
NARROW = 1e-13  #: and the relative width at which it ends


def delayed_metrics(system: OpenSystem, at: str, judged: Bools, walks: Sequence[Array]) -> MarginMetrics:
    """The metrics of all channels of the point ``at``, dead time exact; NaN where not judged. ``walks``: those of the verdict (``Stability``)."""
    ch = channels(system, at)
    metrics = MarginMetrics(*(np.full(ch.H0.shape, np.nan) for _ in range(10)))
    every = np.asarray(np.flatnonzero(judged), np.int64)
    size = np.array([walks[int(i)].size for i in every]) + 1000.0
    for some in _groups(every, size, ch.H0.shape[1]):
        found = _metrics(
            sensitivities(system, at, some), ch.at(some), _cut_poles(system.at(some)), _padded([walks[int(i)] for i in some]), system.radius
        )
        put(metrics, some, MarginMetrics(**found))
    return metrics


def _groups(index: Ints, size: Array, channels: int) -> Iterator[Ints]:
    """The ``index`` (k,) in parts of similar ``size`` (k,), each of at most ``CHUNK`` numbers: size x channels x points."""
    order = np.argsort(-size, kind="stable")
    first = 0
    while first < order.size:
        largest = float(size[order[first]])
        last = first + max(1, int(CHUNK / (max(largest, 1.0) * max(channels, 1))))
        some = order[first:last]
        some = some[size[some] >= 0.5 * largest]
        yield np.sort(index[some])
        first += some.size


def _padded(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Rows of different length, each continued by its last value (an empty one by 0)."""
    longest = max(one.size for one in parts)
    return np.stack([np.pad(one, (0, longest - one.size), mode="edge" if one.size else "constant") for one in parts])


def _cut_poles(system: OpenSystem) -> Complex:
    """(m, nx + nw) poles [1/s] with the delayed wires cut, and 1/T of these wires: features of the loop with dead time."""
    late = system.wire_delay > 0
    found = np.linalg.eigvals(close_wires(system, keep=late)[0]).astype(np.complex128)
    return np.asarray(np.concatenate([found, np.broadcast_to(1 / system.wire_delay[late], (len(found), int(late.sum())))], axis=1), np.complex128)


def _metrics(point: Sensitivities, ch: Channels, cut: Complex, walk: Array, radius: float) -> dict[str, Array]:
    """The metrics (m, n). ``cut``: features of the loop with dead time (m, j); ``walk``: frequencies of its count (m, k)."""
    m, n = ch.H0.shape
    column = ch.B / (1 + ch.H0)[:, None]
    opened = np.linalg.eigvals(ch.A[:, None] - column.transpose(0, 2, 1)[:, :, :, None] * ch.C[:, :, None, :]).reshape(m, -1)
    poles = np.concatenate([cut, point.poles, opened], axis=1).astype(np.complex128)
    w = thinned(frequencies_of_interest(poles, radius), poles)
    w = np.sort(np.concatenate([w, np.where((walk >= radius) & (walk <= w[:, -1:]), walk, w[:, -1:])], axis=1), axis=1)
    longest = float(point.T.max())
    low, high = np.full(m, radius), np.full(m, max(3 * radius, 3 * np.pi / longest))
    at, theta = places(radius, 0.0), angles(poles, radius)
    on_arc = point.over(at(theta))
    arc = arc_crossings(radius, theta, on_arc, at, point.one)
    gain: list[Crossings] = []
    phase: list[Crossings] = []
    peaks = np.abs(1 + point.H(np.arange(m), on_axis(np.full(m, radius)))), np.full((m, n), radius)
    metrics: dict[str, Array] = {}
    left = np.arange(m)
    for _ in range(6):
        if not left.size:
            break
        again = []
        for some in _groups(left, (high - low)[left] * longest / TURN, n):
            piece = _resolved(w[some], low[some], high[some], longest)
            piece, H = _refined(point, some, piece, point.over_some(some, on_axis(piece)))
            for found, kind in zip(_crossings(point, some, piece, H), (gain, phase), strict=True):
                kind.append(found)
            _peaks(point, some, piece, H, *peaks)
            again.append(some[np.count_nonzero(np.diff(piece, axis=1), axis=1) + 1 < MOST])
        metrics = assembled(_joined(gain), _joined(phase), arc, ch.H0, lambda x: x)
        left = np.sort(np.concatenate(again))
        further = _needed(point, left, w[left], high[left], metrics["gain_increase"][left])
        left, further = left[further > high[left]], further[further > high[left]]
        low[left], high[left] = high[left], further
    also_late(metrics, *arc_delays(theta, on_arc, at, point.one, metrics["delay"]))
    far = np.abs(1 + ch.H0)
    better = far >= peaks[0] * (1 - 1e-12)
    peak, where = np.where(better, far, peaks[0]), np.where(better, np.inf, peaks[1])
    return {**metrics, "sensitivity_peak": np.maximum(peak, 1.0), "peak_frequency": where}


def _resolved(w: Array, low: Array, high: Array, longest: float) -> Array:
    """(m, k) increasing frequencies, w (m, j) among them, in [low, high] (m,) in steps with a small phase change of e^(-jwT) and a small
    logarithmic change; some are repeated."""
    least = np.where(low > 0, low, np.minimum(np.where(w > 0, w, np.inf).min(axis=1), high))[:, None]
    w = np.sort(np.clip(np.concatenate([least, w, high[:, None]], axis=1), least, high[:, None]), axis=1)
    spread = np.clip(np.exp(between(np.log(w), np.full(len(w), np.log(10) / DECADE))), least, high[:, None])
    w = np.sort(np.concatenate([w, spread], axis=1), axis=1)
    return np.sort(np.concatenate([w, between(w, np.maximum(TURN / longest, (high - low) / MOST))], axis=1), axis=1)


def _refined(point: Sensitivities, some: Ints, w: Array, H: Complex) -> tuple[Array, Complex]:
    """Additional frequencies where Re H + 1/2 or Im H turns back just before zero, since two crossings may lie there."""
    for _ in range(2):
        gaps = np.zeros((len(w), w.shape[1] - 1), bool)
        for f in (H.real + 0.5, H.imag):
            size = np.abs(f)
            left, middle, right = size[..., :-2], size[..., 1:-1], size[..., 2:]
            dip = (f[..., 1:-1] * f[..., 2:] > 0) & (f[..., 1:-1] * f[..., :-2] > 0) & (middle < right) & (middle < left)
            dip &= middle < np.maximum(right - middle, left - middle)
            turns = dip.any(axis=1)
            gaps[:, :-1] |= turns
            gaps[:, 1:] |= turns
        row, k = np.nonzero(gaps & (np.diff(w, axis=1) > 0))
        if not row.size:
            break
        inner = np.linspace(0, 1, 8)[1:-1]
        extra = w[row, k][:, None] + (w[row, k + 1] - w[row, k])[:, None] * inner
        row = np.repeat(row, inner.size)
        more, column = room(row, w[:, -1:])
        H_more, _ = room(row, H[..., -1:])
        more[row, column] = extra.ravel()
        H_more[row, :, column] = point.H(some[row], on_axis(extra.ravel()))
        w, H = np.concatenate([w, more], axis=1), np.concatenate([H, H_more], axis=2)
        order = np.argsort(w, axis=1, kind="stable")
        w, H = np.take_along_axis(w, order, 1), np.take_along_axis(H, order[:, None], 2)
    return w, H


def _crossings(point: Sensitivities, some: Ints, w: Array, H: Complex) -> tuple[Crossings, Crossings]:
    """The sign changes of Re H + 1/2 (gain) and of Im H (phase)."""
    size = np.abs(H)
    loud = np.maximum(size[..., :-1], size[..., 1:]) > 1 / FARTHEST  # a loop with negligible gain changes sign of Im H everywhere by rounding
    changes = []
    for f, counts in ((H.real + 0.5, True), (H.imag, loud)):
        row, channel, k = np.nonzero(((f[..., :-1] >= 0) != (f[..., 1:] >= 0)) & counts)  # a zero exactly on one of them counts once
        changes.append((some[row], channel, w[row, k], w[row, k + 1], f[row, channel, k], f[row, channel, k + 1], H[row, channel, k]))
    number = changes[0][0].size
    owner, channel, a, b, fa, fb, hx = (np.concatenate(both) for both in zip(*changes, strict=True))
    gain = np.arange(owner.size) < number
    x, todo, part = a.copy(), np.arange(owner.size), fa / (fa - fb)
    for _ in range(MOST_STEPS):
        if not todo.size:
            break
        x[todo] = try_ = a + part * (b - a)
        hx[todo] = h = point.one(owner[todo], channel[todo], on_axis(try_))
        f = np.where(gain[todo], h.real + 0.5, h.imag)
        same = (f >= 0) == (fa >= 0)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = try_, f
        going = ~((np.abs(f) <= 1e-13 * np.minimum(np.abs(h), np.abs(1 + h))) | (np.abs(b - a) <= 2 * NARROW * np.abs(a)))
        todo, (a, b, c, fa, fb, fc) = todo[going], (each[going] for each in (a, b, c, fa, fb, fc))
        part = _next(a, b, c, fa, fb, fc)
    every = Crossings(owner, channel, x, hx)
    return every[gain], every[~gain]


def _next(a: Array, b: Array, c: Array, fa: Array, fb: Array, fc: Array) -> Array:
    """Where between a, the last place tried, and b, on the other side of the zero, to try next, in parts of b - a; c: the end that was left.

    Inverse quadratic interpolation where it is safe, else bisection (Chandrupatla, Adv. Eng. Software 28, 1997, 145-149).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        along, rise = (a - b) / (c - b), (fa - fb) / (fc - fb)
        part = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        safe = (rise**2 < along) & ((1 - rise) ** 2 < 1 - along) & np.isfinite(part)
        least = NARROW * np.abs(a) / np.abs(b - a)
    return np.clip(np.where(safe, part, 0.5), least, 1 - least)


def _peaks(point: Sensitivities, some: Ints, w: Array, H: Complex, peak: Array, where: Array) -> None:
    """Raises ``peak`` and its frequency ``where`` (all points, n) in place to the largest |S| on w, refined at its highest frequencies."""
    size = np.abs(1 + H)
    row, channel, k, low, high = _brackets(size, NEAR * np.maximum(peak[some], size.max(axis=2)))
    owner, each = some[row], np.arange(row.size)
    a, x, b = w[row, low], w[row, k], w[row, high]
    fa, f, fb = size[row, channel, low], size[row, channel, k], size[row, channel, high]
    tried = a[:, None] + (b - a)[:, None] * np.linspace(0, 1, 9)
    inner = np.abs(1 + point.one(np.repeat(owner, 7), np.repeat(channel, 7), on_axis(tried[:, 1:-1].ravel()))).reshape(-1, 7)
    found = np.column_stack([fa, inner, fb])
    highest, first = found.max(axis=1), found.argmax(axis=1)
    best, at = np.where(highest > f, highest, f), np.where(highest > f, tried[each, first], x)
    top = np.clip(first, 1, 7)
    a, x, b = (tried[each, top + i] for i in (-1, 0, 1))
    fa, f, fb = (found[each, top + i] for i in (-1, 0, 1))
    highest_of = np.zeros(peak.shape)
    np.maximum.at(highest_of, (owner, channel), best)
    todo, level = each, np.zeros(each.size, bool)  # level: the last step made no difference
    for _ in range(MOST_STEPS):
        with np.errstate(divide="ignore", invalid="ignore"):
            left, right = (x - a) * (f - fb), (x - b) * (f - fa)
            shift = 0.5 * ((x - a) * left - (x - b) * right) / (left - right)
            rise = shift * shift * np.abs((left - right) / ((x - a) * (x - b) * (b - a)))  # to the vertex of the parabola
            lower = f + 4 * rise < highest_of[owner[todo], channel[todo]]
        going = ~(lower | (level & ((rise <= SAME * f) | (b - a <= 1e-8 * x))))
        if not going.any():
            break
        todo, (a, x, b, fa, f, fb, shift) = todo[going], (each[going] for each in (a, x, b, fa, f, fb, shift))
        vertex = x - shift
        vertex = np.where((vertex > a) & (vertex < b) & (vertex != x), vertex, np.where(x - a > b - x, (a + x) / 2, (x + b) / 2))
        g = np.abs(1 + point.one(owner[todo], channel[todo], on_axis(vertex)))
        level = np.abs(g - f) <= LEVEL * f
        higher = g > f
        left_end = higher == (vertex > x)  # the end that moves: to the vertex, or to x where the vertex is higher
        end, f_end = np.where(higher, x, vertex), np.where(higher, f, g)
        a, fa = np.where(left_end, end, a), np.where(left_end, f_end, fa)
        b, fb = np.where(left_end, b, end), np.where(left_end, fb, f_end)
        x, f = np.where(higher, vertex, x), np.where(higher, g, f)
        better = f > best[todo]
        best[todo[better]], at[todo[better]] = f[better], x[better]
    order = np.argsort(best, kind="stable")  # of several values the last one written, the highest, stays
    order = order[best[order] > peak[some[row[order]], channel[order]]]
    into = some[row[order]], channel[order]
    peak[into], where[into] = best[order], at[order]


def _brackets(size: Array, least: Array) -> tuple[Ints, Ints, Ints, Ints, Ints]:
    """Of the highest local maxima on the last axis of ``size`` (m, n, k), of at least ``least`` (m, n): point, channel, index, and the indices of
    a bracket, which reaches to where the size has really fallen.

    Frequencies that nearly coincide have sizes that differ by rounding only: one maximum, not several.
    """
    m, n, last = *size.shape[:2], size.shape[2] - 1
    size = size.reshape(m * n, -1)
    owner, k = np.nonzero((size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:]) & (size[:, 1:-1] > least.reshape(-1, 1)))
    k = k + 1
    order = np.lexsort((-size[owner, k], owner))
    owner, k = owner[order], k[order]
    parts = []
    for _ in range(CLIMBED):
        if not owner.size:
            break
        first = np.concatenate([[True], np.diff(owner) > 0])
        mine, top = owner[first], k[first]
        fallen = size[mine, top] * (1 - FLAT)
        ends = []
        for step, edge in ((-1, 0), (1, last)):
            end = top + step
            climbing = np.flatnonzero((end != edge) & (size[mine, end] >= fallen))
            while climbing.size:
                end[climbing] += step
                climbing = climbing[(end[climbing] != edge) & (size[mine[climbing], end[climbing]] >= fallen[climbing])]
            ends.append(end)
        parts.append((mine, top, *ends))
        group = np.cumsum(first) - 1
        outside = (k <= ends[0][group]) | (k >= ends[1][group])
        owner, k = owner[outside], k[outside]
    mine, top, low, high = (np.concatenate([part[i] for part in parts]) if parts else np.zeros(0, np.int64) for i in range(4))
    return mine // n, mine % n, top, low, high


def _joined(parts: list[Crossings]) -> Crossings:
    return Crossings(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("point", "channel", "w", "H")))


def _needed(point: Sensitivities, some: Ints, w: Array, high: Array, increase: Array) -> Array:
    """(k,) [rad/s] up to which a crossing could limit a margin: |L| >= 1, or a gain below the increase found so far. ``w`` resolves the poles."""
    last = np.maximum(64 * high, w[:, -1])
    span = (last / high)[:, None]
    even = high[:, None] * span ** np.linspace(0, 1, int(25 * np.log10(span.max(initial=1.0))) + 2)
    w = np.sort(np.concatenate([even, np.maximum(w, high[:, None])], axis=1), axis=1)
    H = point.over_some(some, on_axis(w))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.abs(H / (1 + H))
    binds = np.any((size >= np.minimum(1.0, 0.98 / increase)[..., None]) & (size > 1e-4), axis=1)
    row, k = np.nonzero(binds)
    reach = high.copy()
    reach[row] = w[row, np.minimum(k + 1, w.shape[1] - 1)]  # in increasing order: the last one stays
    return reach
