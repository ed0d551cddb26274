"""Exact margins of loops with dead time: e^(-jwT) on every delayed wire, without Pade approximation.

There are infinitely many crossings of the sensitivities (``sensitivities``). They are bracketed on a frequency grid that
resolves the closed poles, the roots of the loop with dead time near the axis (by the samples of the verdict's count), and the phase of
e^(-jwT); then polished. A zero of a sensitivity needs no frequencies of its own: its size falls towards it from as far as the next of these
roots. The search continues to higher frequencies until no further crossing can limit a margin. No frequency below
1/horizon counts; a gain interval also ends on the indentation of the contour (``arc``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.delay.grid import apart, between, room
from mfc_analysis.analysis.delay.sensitivities import Sensitivities, sensitivities
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, arc_delays, places
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned
from mfc_analysis.analysis.margin_metrics import FARTHEST, MarginMetrics, also_late, assembled, put
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

Values = TypeVar("Values", Array, Ints)

MOST = 40_000  #: frequencies at one point
CHUNK = 1_000_000  #: complex numbers at a time
NEAR, CLIMBED = 0.7, 8  #: a local maximum of at least this fraction of the highest is refined, and at most this many of them
SURELY, RISES = 0.7, 2.0  #: least and largest rise to a maximum between three places, in units of that to the vertex of the parabola through them
SAME = 1e-9  #: relative difference between H and the polynomial through it at the maximum at which the refinement ends
NODES = -np.cos(np.pi * np.arange(9) / 8)  #: where H is evaluated in a bracket of a maximum, from -1 to 1 (Chebyshev),
FINE = np.linspace(-1, 1, 65)  #: and where the polynomial through it is
FIT = np.linalg.inv(NODES[:, None] ** np.arange(NODES.size)).T  #: its coefficients
FINE_POWERS = FINE ** np.arange(NODES.size)[:, None]
FLAT = 1e-9  #: relative difference of two sizes below which they count as equal
TURN = 0.3  #: [rad] phase of e^(-jwT) between two frequencies,
DECADE = 10  #: and frequencies in a decade
MOST_STEPS = 60  #: of a search for a crossing,
NARROW = 1e-13  #: and the relative width at which it ends;
SMOOTH = 4  #: its first steps go where the polynomial through all places so far has its zero


def delayed_metrics(system: OpenSystem, at: str, judged: Bools, walks: Sequence[Array]) -> MarginMetrics:
    """The metrics of all channels of the point ``at``, dead time exact; NaN where not judged. ``walks``: those of the verdict (``Stability``)."""
    H0 = channels(system, at).H0
    metrics = MarginMetrics(*(np.full(H0.shape, np.nan) for _ in range(10)))
    every = np.asarray(np.flatnonzero(judged), np.int64)
    size = np.array([walks[int(i)].size for i in every]) + 1000.0
    for some in _groups(every, size, H0.shape[1]):
        found = _metrics(sensitivities(system, at, some), H0[some], _padded([walks[int(i)] for i in some]), system.radius)
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


def _padded(parts: Sequence[Array]) -> Array:
    """Rows of different length, each continued by its last value (an empty one by 0)."""
    out = np.zeros((len(parts), max(one.size for one in parts)))
    for row, one in zip(out, parts, strict=True):
        row[: one.size], row[one.size :] = one, one[-1] if one.size else 0.0
    return out


def _metrics(point: Sensitivities, H0: Array, walk: Array, radius: float) -> dict[str, Array]:
    """The metrics (m, n). ``H0``: H at infinity (m, n); ``walk``: frequencies (m, k) of the count, which resolve the roots with dead time."""
    m, n = H0.shape
    poles = apart(point.poles)
    w = thinned(frequencies_of_interest(poles, radius), poles)
    w = np.sort(np.concatenate([w, np.where((walk >= radius) & (walk <= w[:, -1:]), walk, w[:, -1:])], axis=1), axis=1)
    longest = float(point.T.max())
    low, high = np.full(m, radius), np.full(m, max(3 * radius, 3 * np.pi / longest))
    at, theta = places(radius, 0.0), angles(point.poles, radius)
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
        metrics = assembled(_joined(gain), _joined(phase), arc, H0, lambda x: x)
        left = np.sort(np.concatenate(again))
        further = _needed(point, left, w[left], high[left], metrics["gain_increase"][left])
        left, further = left[further > high[left]], further[further > high[left]]
        low[left], high[left] = high[left], further
    also_late(metrics, *arc_delays(radius, theta, on_arc, at, point.one, metrics["delay"]))
    far = np.abs(1 + H0)
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
        four = np.clip(k[:, None] + np.arange(-1, 3), 0, w.shape[1] - 1)
        changes.append((some[row], channel, w[row[:, None], four], f[row[:, None], channel[:, None], four], H[row, channel, k]))
    number = changes[0][0].size
    owner, channel, xs, fs, hx = (np.concatenate(both) for both in zip(*changes, strict=True))
    gain = np.arange(owner.size) < number
    a, b, fa, fb = xs[:, 1], xs[:, 2], fs[:, 1], fs[:, 2]
    x, todo, part = a.copy(), np.arange(owner.size), fa / (fa - fb)
    for step in range(MOST_STEPS):
        if not todo.size:
            break
        if step < SMOOTH:
            guess = (_inverse(xs, fs) - a) / (b - a)
            part = np.where((guess > 0) & (guess < 1), guess, part)
        x[todo] = try_ = a + part * (b - a)
        hx[todo] = h = point.one(owner[todo], channel[todo], on_axis(try_))
        f = np.where(gain[todo], h.real + 0.5, h.imag)
        same = (f >= 0) == (fa >= 0)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = try_, f
        going = ~((np.abs(f) <= 1e-13 * np.minimum(np.abs(h), np.abs(1 + h))) | (np.abs(b - a) <= 2 * NARROW * np.abs(a)))
        xs, fs = np.column_stack([xs, try_]), np.column_stack([fs, f])
        todo, (a, b, c, fa, fb, fc, xs, fs) = todo[going], _some(going, a, b, c, fa, fb, fc, xs, fs)
        part = _next(a, b, c, fa, fb, fc)
    every = Crossings(owner, channel, x, hx)
    return every[gain], every[~gain]


def _some(which: Bools, *values: Values) -> list[Values]:
    return [each[which] for each in values]


def _inverse(x: Array, f: Array) -> Array:
    """(k,) where the polynomials x(f) through places x (k, q) with values f (k, q) have f = 0 (Neville's rule); not finite where values repeat."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for n in range(1, x.shape[1]):
            x = (f[:, :-n] * x[:, 1:] - f[:, n:] * x[:, :-1]) / (f[:, :-n] - f[:, n:])
    return np.asarray(x[:, 0])


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
    """Raises ``peak`` and its frequency ``where`` (all points, n) in place to the largest |S| on w, refined at its highest frequencies.

    By the maximum of |1 + p|, p the polynomial through H at ``NODES`` of a bracket, again in a part of the bracket until H is p there.
    """
    size = np.abs(1 + H)
    row, channel, low, high = _brackets(w, size, np.maximum(peak[some], size.max(axis=2)))
    owner, best, at = some[row], np.zeros(row.size), np.zeros(row.size)
    a, b, Ha, Hb, todo = w[row, low], w[row, high], H[row, channel, low], H[row, channel, high], np.arange(row.size)
    highest = np.zeros(peak.shape)
    for _ in range(MOST_STEPS):
        if not todo.size:
            break
        x = (a + b)[:, None] / 2 + (b - a)[:, None] / 2 * NODES
        inner = point.one(np.repeat(owner[todo], NODES.size - 2), np.repeat(channel[todo], NODES.size - 2), on_axis(x[:, 1:-1].ravel()))
        at_nodes = np.column_stack([Ha, inner.reshape(todo.size, -1), Hb])
        top, expected = _top(at_nodes)
        place = (a + b) / 2 + (b - a) / 2 * top
        there = point.one(owner[todo], channel[todo], on_axis(place))
        x, known = np.column_stack([x, place]), np.column_stack([at_nodes, there])
        order = np.argsort(x, axis=1, kind="stable")
        x, known = np.take_along_axis(x, order, 1), np.take_along_axis(known, order, 1)
        height, each = np.abs(1 + known), np.arange(todo.size)
        k = height.argmax(axis=1)
        better = height[each, k] > best[todo]
        best[todo[better]], at[todo[better]] = height[each, k][better], x[each, k][better]
        np.maximum.at(highest, (owner[todo], channel[todo]), best[todo])
        off = np.abs(there - expected)
        lower = np.maximum(height[each, k], np.abs(1 + expected)) + 10 * off < highest[owner[todo], channel[todo]]
        going = ~(lower | (off <= SAME * np.abs(1 + there)) | (b - a <= 1e-8 * b))
        left, right = np.maximum(k - 1, 0), np.minimum(k + 1, NODES.size)
        todo, each, left, right = _some(going, todo, each, left, right)
        a, b, Ha, Hb = x[each, left], x[each, right], known[each, left], known[each, right]
    order = np.argsort(best, kind="stable")  # of several values the last one written, the highest, stays
    order = order[best[order] > peak[some[row[order]], channel[order]]]
    into = some[row[order]], channel[order]
    peak[into], where[into] = best[order], at[order]


def _top(H: Complex) -> tuple[Array, Complex]:
    """Where in [-1, 1] |1 + p| is largest, and p there, (k,) each: p of the polynomials through H (k, q) at ``NODES``."""
    c = H @ FIT
    fine = c @ FINE_POWERS
    x = FINE[np.abs(1 + fine).argmax(axis=1)]
    low, high = x - 2 / FINE.size, x + 2 / FINE.size
    powers = np.arange(c.shape[1])
    first, second = c[:, 1:] * powers[1:], c[:, 2:] * (powers[2:] * powers[1:-1])
    for _ in range(4):  # Newton on the slope of the square
        at = x[:, None] ** powers
        value, slope, curve = 1 + (c * at).sum(axis=1), (first * at[:, :-1]).sum(axis=1), (second * at[:, :-2]).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (value.conj() * slope).real / ((value.conj() * curve).real + np.abs(slope) ** 2)
        x = np.clip(np.where(np.isfinite(step), x - step, x), np.maximum(low, -1), np.minimum(high, 1))
    return x, np.asarray((c * x[:, None] ** powers).sum(axis=1), np.complex128)


def _brackets(w: Array, size: Array, highest: Array) -> tuple[Ints, Ints, Ints, Ints]:
    """Of the highest local maxima of ``size`` (m, n, k) on w (m, k) between whose neighbours the ``highest`` (m, n) may be exceeded: point, channel,
    and the indices of a bracket, which reaches to where the size has really fallen.

    The vertex of the parabola through three sizes ranks them. Frequencies that nearly coincide have sizes that differ by rounding only: one
    maximum, not several.
    """
    m, n, last = *size.shape[:2], size.shape[2] - 1
    size = size.reshape(m * n, -1)
    least = NEAR * highest.reshape(-1, 1)
    owner, k = np.nonzero((size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:]) & (size[:, 1:-1] > least))
    k = k + 1
    (x, a, b), (f, fa, fb) = ((values[row, k + i] for i in (0, -1, 1)) for values, row in ((w, owner // n), (size, owner)))
    with np.errstate(divide="ignore", invalid="ignore"):
        left, right = (x - a) * (f - fb), (x - b) * (f - fa)
        shift = 0.5 * ((x - a) * left - (x - b) * right) / (left - right)
        rise = shift * shift * np.abs((left - right) / ((x - a) * (x - b) * (b - a)))
    fall = f - np.minimum(fa, fb)
    rise = np.fmin(np.where(np.isfinite(rise), rise, np.inf), fall)
    surely = highest.ravel().copy()
    np.maximum.at(surely, owner, f + SURELY * np.minimum(rise, fall / 8))  # an eighth where the places are evenly spaced
    may = f + RISES * rise >= surely[owner]
    owner, k, top = owner[may], k[may], (f + rise)[may]
    order = np.lexsort((-top, owner))
    owner, k = owner[order], k[order]
    parts: list[tuple[Ints, ...]] = []
    for _ in range(CLIMBED):
        if not owner.size:
            break
        first = np.concatenate([[True], np.diff(owner) > 0])
        mine, top = owner[first], k[first]
        fallen = size[mine, top] * (1 - FLAT)
        ends: list[Ints] = []
        for step, edge in ((-1, 0), (1, last)):
            end = top + step
            climbing = np.flatnonzero((end != edge) & (size[mine, end] >= fallen))
            while climbing.size:
                end[climbing] += step
                climbing = climbing[(end[climbing] != edge) & (size[mine[climbing], end[climbing]] >= fallen[climbing])]
            ends.append(end)
        parts.append((mine, *ends))
        group = np.cumsum(first) - 1
        outside = (k <= ends[0][group]) | (k >= ends[1][group])
        owner, k = _some(outside, owner, k)
    mine, low, high = (np.concatenate([part[i] for part in parts]) if parts else np.zeros(0, np.int64) for i in range(3))
    return mine // n, mine % n, low, high


def _joined(parts: list[Crossings]) -> Crossings:
    return Crossings(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("point", "channel", "w", "H")))


def _needed(point: Sensitivities, some: Ints, w: Array, high: Array, increase: Array) -> Array:
    """(k,) [rad/s] up to which a crossing could limit a margin: |L| >= 1, or a gain below the increase found so far. ``w`` resolves the poles."""
    last = np.maximum(64 * high, w[:, -1])
    span = (last / high)[:, None]
    even = high[:, None] * span ** np.linspace(0, 1, int(DECADE * np.log10(span.max(initial=1.0))) + 2)
    w = np.sort(np.concatenate([even, np.maximum(w, high[:, None])], axis=1), axis=1)
    H = point.over_some(some, on_axis(w))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.abs(H / (1 + H))
    binds = np.any((size >= np.minimum(1.0, 0.98 / increase)[..., None]) & (size > 1e-4), axis=1)
    row, k = np.nonzero(binds)
    reach = high.copy()
    reach[row] = w[row, np.minimum(k + 1, w.shape[1] - 1)]  # in increasing order: the last one stays
    return reach
