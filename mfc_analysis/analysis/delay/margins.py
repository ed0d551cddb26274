"""Exact margins of loops with dead time: e^(-jwT) on every delayed wire, without Pade approximation.

With W(s) = (I - G(s))^-1, the closed loop without dead time from after each cut to after each cut (G: all wires cut), and
E = diag(e^(-s T)), the sensitivities of the loop with dead time are

    (I - E G)^-1 = W [(I - E) W + E]^-1,        S_i = e_i W [(I - E) W + E]^-1 p_i,

p_i = e_i (at "position": e_q + s e_v). There are infinitely many crossings. They are bracketed on a frequency grid that
resolves the open and closed poles, the roots of the loop with dead time near the axis (by the samples of the verdict's count), and the phase of
e^(-jwT); then polished. The search continues to higher frequencies until no further crossing can limit a margin. No frequency below
1/horizon counts; a gain interval also ends on the indentation of the contour (``arc``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.channels import Channels, channels, has_rate, point_wires
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, arc_delays, places
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned
from mfc_analysis.analysis.frequency.resolvent import CONDITION
from mfc_analysis.analysis.margin_metrics import FARTHEST, MarginMetrics, also_late, assembled, put
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

MOST = 40_000  #: frequencies at one point
CHUNK = 1_000_000  #: complex numbers at a time
NEAR, CLIMBED = 0.7, 3  #: a local maximum of at least this fraction of the highest is refined, and this many of them
PARABOLAS = 8  #: steps of the refinement, from vertex to vertex of the parabola through three places
ON_POLE, BESIDE = 1e-12, 1e-9  #: relative distance from a pole at which a place lies on it, and by which it is moved
FLAT = 1e-9  #: relative difference of two sizes below which they count as equal
TURN = 0.2  #: [rad] phase of e^(-jwT) between two frequencies


@dataclass(frozen=True, eq=False)
class _Points:
    """m points, ready for evaluation: W(s) = M + C (sI - A)^-1 B of the k relevant wires."""

    A: Array  #: (m, nx, nx)
    B: Array  #: (m, nx, k)
    C: Array  #: (m, k, nx)
    M: Array  #: (m, k, k)
    T: Array  #: (k,) [s] of these wires
    rows: Ints  #: (n,) indices of the channels among them, one after the other
    rates: Ints | None  #: (n,) indices of the wires with their rates
    modal: Bools  #: (m,) modes are well conditioned
    poles: Complex  #: (m, nx)
    residues: Complex  #: (m, nx, k k) not defined where not ``modal``

    def H(self, point: Ints, s: Complex) -> Complex:
        """S_i - 1 (q, n) of all channels at s (q,), each of one point (q,)."""
        n, each = self.rows.size, np.arange(self.rows.size)
        out = np.empty((s.size, n), np.complex128)
        for some in self._chunks(s.size):
            W, matrix = self._loop(point[some], s[some])
            inject = np.zeros((1 if self.rates is None else len(W), len(self.T), n), np.complex128)
            inject[:, self.rows, each] = 1
            if self.rates is not None:
                inject[:, self.rates, each] = s[some, None]
            X = np.linalg.solve(matrix, inject)
            out[some] = (W[:, self.rows[0] : self.rows[-1] + 1] * X.transpose(0, 2, 1)).sum(axis=2) - 1
        return out

    def over(self, s: Complex) -> Complex:
        """S_i - 1 (m, n, q) of all channels at s (m, q) of each point."""
        return self.over_some(np.arange(len(s)), s)

    def over_some(self, points: Ints, s: Complex) -> Complex:
        """S_i - 1 (p, n, q) of all channels at s (p, q) of each of the ``points`` (p,)."""
        H = self.H(np.repeat(points, s.shape[1]), s.ravel())
        return np.ascontiguousarray(H.reshape(*s.shape, self.rows.size).transpose(0, 2, 1))

    def one(self, point: Ints, channel: Ints, s: Complex) -> Complex:
        """S_i - 1 (q,) at s (q,), each of one point and channel (q,)."""
        out = np.empty(s.size, np.complex128)
        for some in self._chunks(s.size):
            W, matrix = self._loop(point[some], s[some])
            each, row = np.arange(len(W)), self.rows[channel[some]]
            inject = np.zeros((len(W), len(self.T), 1), np.complex128)
            inject[each, row, 0] = 1
            if self.rates is not None:
                inject[each, self.rates[channel[some]], 0] = s[some]
            out[some] = (W[each, row] * np.linalg.solve(matrix, inject)[:, :, 0]).sum(axis=1) - 1
        return out

    def _chunks(self, size: int) -> Iterator[slice]:
        step = max(1, CHUNK // max(self.A.shape[-1], len(self.T)) ** 2)
        return (slice(k, k + step) for k in range(0, size, step))

    def _loop(self, point: Ints, s: Complex) -> tuple[Complex, Complex]:
        k = len(self.T)
        with np.errstate(invalid="ignore"):
            on_pole = np.abs(s[:, None] - self.poles[point]).min(axis=1, initial=np.inf) <= ON_POLE * np.abs(s)
        s = np.where(on_pole, s * (1 + BESIDE), s)  # of the loop without dead time: W is infinite there, S is not
        W = np.empty((s.size, k * k), np.complex128)
        order = np.argsort(point, kind="stable")
        start = np.searchsorted(point[order], np.arange(len(self.A) + 1))
        for i in np.flatnonzero(np.diff(start)):
            mine = order[start[i] : start[i + 1]]
            if self.modal[i]:
                W[mine] = (1 / (s[mine, None] - self.poles[i])) @ self.residues[i]
            else:
                matrix = s[mine, None, None] * np.eye(len(self.A[i])) - self.A[i]
                W[mine] = (self.C[i] @ np.linalg.solve(matrix, self.B[i].astype(complex)[None])).reshape(-1, k * k)
        W = W.reshape(-1, k, k) + self.M[point]
        E = np.exp(-s[:, None] * self.T)
        matrix = (1 - E)[:, :, None] * W
        matrix[:, np.arange(k), np.arange(k)] += E
        return W, matrix


def delayed_metrics(system: OpenSystem, at: str, judged: Bools, walks: Sequence[Array]) -> MarginMetrics:
    """The metrics of all channels of the point ``at``, dead time exact; NaN where not judged. ``walks``: those of the verdict (``Stability``)."""
    ch = channels(system, at)
    metrics = MarginMetrics(*(np.full(ch.H0.shape, np.nan) for _ in range(10)))
    every = np.asarray(np.flatnonzero(judged), np.int64)
    size = np.array([walks[int(i)].size for i in every]) + 1000.0
    for some in _groups(every, size, ch.H0.shape[1]):
        found = _metrics(_points(system, at, some), ch.at(some), _cut_poles(system.at(some)), _padded([walks[int(i)] for i in some]), system.radius)
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


def _points(system: OpenSystem, at: str, index: Ints) -> _Points:
    nu, ny, nw = system.nu, system.ny, system.nw
    wires = np.arange(nw)[point_wires(system, at)]
    cut = [wires, np.arange(nw)[system.wires["rate"]]] if has_rate(system, at) else [wires]
    matter = np.unique(np.concatenate([*cut, np.flatnonzero(system.wire_delay)]))
    through = np.linalg.inv(np.eye(nw) - system.D[index][:, ny:, nu:])
    into, out = system.B[index][:, :, nu:] @ through, through @ system.C[index][:, ny:]
    A = system.A[index] + into @ system.C[index][:, ny:]
    B, C = into[:, :, matter], out[:, matter]
    poles, V = np.linalg.eig(A)
    modal = np.asarray(np.linalg.cond(V) < CONDITION)
    left, right = C @ V, np.zeros(B.shape, np.complex128)
    right[modal] = np.linalg.solve(V[modal], B[modal].astype(complex))
    residues = (left.transpose(0, 2, 1)[:, :, :, None] * right[:, :, None, :]).reshape(*poles.shape, matter.size**2)
    where = [np.searchsorted(matter, c) for c in cut]
    return _Points(
        A, B, C, np.asarray(through[:, matter[:, None], matter], float), system.wire_delay[matter], where[0], where[1] if len(where) > 1 else None,
        modal, poles.astype(np.complex128), residues.astype(np.complex128),
    )  # fmt: skip


def _metrics(point: _Points, ch: Channels, cut: Complex, walk: Array, radius: float) -> dict[str, Array]:
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
    span = high[:, None] / least
    turns = float(np.ceil((high - low).max() * longest / TURN))
    even = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, int(min(MOST, turns + 2)))
    spread = least * span ** np.linspace(0, 1, int(30 * np.log10(span.max())) + 2)
    return np.sort(np.clip(np.concatenate([w, even, spread], axis=1), least, high[:, None]), axis=1)


def _refined(point: _Points, some: Ints, w: Array, H: Complex) -> tuple[Array, Complex]:
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
        count = np.bincount(row, minlength=len(w)) * inner.size
        column = np.arange(extra.size) - np.repeat(np.cumsum(count) - count, count)  # of each among those of its row
        row = np.repeat(row, inner.size)
        more = np.repeat(w[:, -1:], count.max(), axis=1)
        H_more = np.repeat(H[..., -1:], count.max(), axis=2)
        more[row, column] = extra.ravel()
        H_more[row, :, column] = point.H(some[row], on_axis(extra.ravel()))
        w, H = np.concatenate([w, more], axis=1), np.concatenate([H, H_more], axis=2)
        order = np.argsort(w, axis=1, kind="stable")
        w, H = np.take_along_axis(w, order, 1), np.take_along_axis(H, order[:, None], 2)
    return w, H


def _crossings(point: _Points, some: Ints, w: Array, H: Complex) -> tuple[Crossings, Crossings]:
    """The sign changes of Re H + 1/2 (gain) and of Im H (phase), by the Illinois rule."""
    size = np.abs(H)
    loud = np.maximum(size[..., :-1], size[..., 1:]) > 1 / FARTHEST  # a loop with negligible gain changes sign of Im H everywhere by rounding
    changes = []
    for f, counts in ((H.real + 0.5, True), (H.imag, loud)):
        row, channel, k = np.nonzero(((f[..., :-1] >= 0) != (f[..., 1:] >= 0)) & counts)  # a zero exactly on one of them counts once
        changes.append((some[row], channel, w[row, k], w[row, k + 1], f[row, channel, k], f[row, channel, k + 1], H[row, channel, k]))
    number = changes[0][0].size
    owner, channel, a, b, fa, fb, hx = (np.concatenate(both) for both in zip(*changes, strict=True))
    gain = np.arange(owner.size) < number
    x = a.copy()
    todo = np.arange(owner.size)
    for _ in range(60):
        if not todo.size:
            break
        l, r, fl, fr = a[todo], b[todo], fa[todo], fb[todo]
        try_ = (l * fr - r * fl) / (fr - fl)
        x[todo] = try_ = np.where((try_ >= l) & (try_ <= r), try_, (l + r) / 2)
        hx[todo] = h = point.one(owner[todo], channel[todo], on_axis(try_))
        f = np.where(gain[todo], h.real + 0.5, h.imag)
        right = (f >= 0) == (fr >= 0)
        a[todo], fa[todo] = np.where(right, l, try_), np.where(right, fl / 2, f)
        b[todo], fb[todo] = np.where(right, try_, r), np.where(right, f, fr / 2)
        todo = todo[~((np.abs(f) <= 1e-13 * np.abs(h)) | (b[todo] - a[todo] <= 1e-13 * b[todo]))]
    every = Crossings(owner, channel, x, hx)
    return every[gain], every[~gain]


def _peaks(point: _Points, some: Ints, w: Array, H: Complex, peak: Array, where: Array) -> None:
    """Raises ``peak`` and its frequency ``where`` (all points, n) in place to the largest |S| on w, refined at its highest frequencies."""
    size = np.abs(1 + H)
    row, channel, k, low, high = _brackets(size, NEAR * np.maximum(peak[some], size.max(axis=2)))
    owner, each = some[row], np.arange(row.size)
    a, x, b = w[row, low], w[row, k], w[row, high]
    fa, f, fb = size[row, channel, low], size[row, channel, k], size[row, channel, high]
    best, at = f, x
    inner = np.linspace(0, 1, 9)
    for _ in range(2):
        tried = a[:, None] + (b - a)[:, None] * inner
        found = np.abs(1 + point.one(np.repeat(owner, 9), np.repeat(channel, 9), on_axis(tried.ravel()))).reshape(tried.shape)
        highest, first = found.max(axis=1), found.argmax(axis=1)
        best, at = np.where(highest > best, highest, best), np.where(highest > best, tried[each, first], at)
        top = np.clip(first, 1, 7)
        a, x, b = (tried[each, top + i] for i in (-1, 0, 1))
        fa, f, fb = (found[each, top + i] for i in (-1, 0, 1))
    for _ in range(PARABOLAS):
        with np.errstate(divide="ignore", invalid="ignore"):
            left, right = (x - a) * (f - fb), (x - b) * (f - fa)
            vertex = x - 0.5 * ((x - a) * left - (x - b) * right) / (left - right)
        vertex = np.where((vertex > a) & (vertex < b) & (vertex != x), vertex, np.where(x - a > b - x, (a + x) / 2, (x + b) / 2))
        g = np.abs(1 + point.one(owner, channel, on_axis(vertex)))
        higher = g > f
        left_end = higher == (vertex > x)  # the end that moves: to the vertex, or to x where the vertex is higher
        end, f_end = np.where(higher, x, vertex), np.where(higher, f, g)
        a, fa = np.where(left_end, end, a), np.where(left_end, f_end, fa)
        b, fb = np.where(left_end, b, end), np.where(left_end, fb, f_end)
        x, f = np.where(higher, vertex, x), np.where(higher, g, f)
    best, at = np.where(f > best, f, best), np.where(f > best, x, at)
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


def _needed(point: _Points, some: Ints, w: Array, high: Array, increase: Array) -> Array:
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
