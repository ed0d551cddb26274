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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import Channels, channels, has_rate, point_wires
from mfc_analysis.analysis.delay.characteristic import Delayed, delayed_points
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, arc_delays, places
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned
from mfc_analysis.analysis.frequency.resolvent import CONDITION
from mfc_analysis.analysis.margin_metrics import FARTHEST, MarginMetrics, also_late, assembled
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

MOST = 40_000  #: frequencies at one point
NEAR, CLIMBED = 0.7, 3  #: a local maximum of at least this fraction of the highest is refined, and this many of them
FLAT = 1e-9  #: relative difference of two sizes below which they count as equal
TURN = 0.2  #: [rad] phase of e^(-jwT) between two frequencies


@dataclass(frozen=True, eq=False)
class _Point:
    """One point, ready for evaluation: W(s) = M + C (sI - A)^-1 B of the relevant wires."""

    A: Array
    B: Array
    C: Array
    M: Array
    T: Array  #: (k,) [s] of these wires
    rows: Ints  #: (n,) indices of the channels among them
    rates: Ints | None  #: (n,) indices of the wires with their rates
    modes: tuple[Complex, Complex, Complex] | None  #: poles, C V, V^-1 B where these are well conditioned

    def H(self, s: Complex) -> Complex:
        """S_i - 1 of all channels, (n, k), at s (k,)."""
        W, matrix = self._loop(s)
        n = self.rows.size
        inject = np.zeros((s.size, len(self.T), n), np.complex128)
        inject[:, self.rows, np.arange(n)] = 1
        if self.rates is not None:
            inject[:, self.rates, np.arange(n)] = s[:, None]
        X = np.linalg.solve(matrix, inject)
        return np.asarray(np.einsum("wnk,wkn->nw", W[:, self.rows], X) - 1)

    def one(self, channel: Ints, s: Complex) -> Complex:
        """S_i - 1 (k,) of one channel (k,) each at s (k,)."""
        W, matrix = self._loop(s)
        each = np.arange(s.size)
        inject = np.zeros((s.size, len(self.T), 1), np.complex128)
        inject[each, self.rows[channel], 0] = 1
        if self.rates is not None:
            inject[each, self.rates[channel], 0] = s
        X = np.linalg.solve(matrix, inject)
        return np.asarray((W[each, self.rows[channel]] * X[:, :, 0]).sum(axis=1) - 1)

    def _loop(self, s: Complex) -> tuple[Complex, Complex]:
        W = self._W(s)
        E = np.exp(-s[:, None] * self.T)[:, :, None]
        return W, (1 - E) * W + E * np.eye(len(self.T))

    def _W(self, s: Complex) -> Complex:
        if self.modes is not None:
            poles, left, right = self.modes
            return np.asarray((left / (s[:, None, None] - poles)) @ right + self.M)
        matrix = s[:, None, None] * np.eye(len(self.A)) - self.A
        return np.asarray(self.C @ np.linalg.solve(matrix, np.broadcast_to(self.B.astype(complex), (s.size, *self.B.shape))) + self.M)


def delayed_metrics(system: OpenSystem, at: str, judged: Bools, walks: Sequence[Array]) -> MarginMetrics:
    """The metrics of all channels of the point ``at``, dead time exact; NaN where not judged. ``walks``: those of the verdict (``Stability``)."""
    ch = channels(system, at)
    metrics = MarginMetrics(*(np.full(ch.H0.shape, np.nan) for _ in range(10)))
    cut = delayed_points(system) if judged.any() else []
    for i in np.flatnonzero(judged):
        found = _metrics(_point(system, at, int(i)), ch.at(np.array([i])), cut[i], walks[i], system.radius)
        for name, values in vars(metrics).items():
            values[i] = found[name]
    return metrics


def _point(system: OpenSystem, at: str, index: int) -> _Point:
    nu, ny, nw = system.nu, system.ny, system.nw
    wires = np.arange(nw)[point_wires(system, at)]
    cut = [wires, np.arange(nw)[system.wires["rate"]]] if has_rate(system, at) else [wires]
    matter = np.unique(np.concatenate([*cut, np.flatnonzero(system.wire_delay)]))
    through = np.linalg.inv(np.eye(nw) - system.D[index][ny:, nu:])
    into, out = system.B[index][:, nu:] @ through, through @ system.C[index][ny:]
    A = system.A[index] + into @ system.C[index][ny:]
    B, C = into[:, matter], out[matter]
    poles, V = np.linalg.eig(A)
    modes = None
    if np.linalg.cond(V) < CONDITION:
        modes = poles.astype(np.complex128), (C @ V).astype(np.complex128), np.linalg.solve(V, B.astype(complex))
    where = [np.searchsorted(matter, c) for c in cut]
    return _Point(A, B, C, through[np.ix_(matter, matter)], system.wire_delay[matter], where[0], where[1] if len(where) > 1 else None, modes)


def _metrics(point: _Point, ch: Channels, cut: Delayed, walk: Array, radius: float) -> dict[str, Array]:
    opened = [np.linalg.eigvals(ch.A[0] - np.outer(ch.B[0][:, i], ch.C[0][i]) / (1 + ch.H0[0, i])) for i in range(ch.H0.shape[1])]
    poles = np.concatenate([cut.places, *opened]).astype(np.complex128)
    w = thinned(frequencies_of_interest(poles[None], radius), poles[None])[0]
    w = np.union1d(w, walk[(walk >= radius) & (walk <= w[-1])])
    low_end, high = radius, max(3 * radius, 3 * np.pi / float(cut.T.max()))
    at, theta = places(radius, 0.0), angles(poles[None], radius)
    on_arc = point.H(at(theta[0]))[None]
    arc = arc_crossings(radius, theta, on_arc, at, lambda _, channel, s: point.one(channel, s))
    gain: list[tuple[Ints, Array, Complex]] = []
    phase: list[tuple[Ints, Array, Complex]] = []
    end = np.abs(1 + point.H(on_axis(np.array([radius])))[:, 0])
    peaks = end, np.full(end.size, radius)
    metrics: dict[str, Array] = {}
    for _ in range(6):
        piece = _resolved(w, low_end, high, float(cut.T.max()))
        H = point.H(on_axis(piece))
        piece, H = _refined(point, piece, H)
        gain.append(_crossings(point, piece, H, gain=True))
        phase.append(_crossings(point, piece, H, gain=False))
        peaks = _peaks(point, piece, H, *peaks)
        metrics = assembled(_joined(gain), _joined(phase), arc, ch.H0, lambda x: x)
        further = _needed(point, w, high, metrics["gain_increase"][0])
        if further <= high or piece.size >= MOST:
            break
        low_end, high = high, further
    also_late(metrics, *arc_delays(theta, on_arc, at, lambda _, channel, s: point.one(channel, s), metrics["delay"]))
    far = np.abs(1 + ch.H0[0])
    better = far >= peaks[0] * (1 - 1e-12)
    peak, where = np.where(better, far, peaks[0]), np.where(better, np.inf, peaks[1])
    return {**metrics, "sensitivity_peak": np.maximum(peak, 1.0)[None], "peak_frequency": where[None]}


def _resolved(w: Array, low: float, high: float, longest: float) -> Array:
    """Frequencies w in [low, high], in steps with a small phase change of e^(-jwT) and a small logarithmic change."""
    count = int(min(MOST, np.ceil((high - low) * longest / TURN) + 2))
    even = np.linspace(low, high, count)
    start = low or min(float(w[w > 0].min()), high)
    spread = np.geomspace(start, high, int(30 * np.log10(high / start)) + 2)
    every = np.unique(np.concatenate([w[(w >= low) & (w <= high)], even, spread]))
    return np.asarray(every[every > 0])


def _refined(point: _Point, w: Array, H: Complex) -> tuple[Array, Complex]:
    """Additional frequencies where Re H + 1/2 or Im H turns back just before zero, since two crossings may lie there."""
    for _ in range(2):
        gaps: set[int] = set()
        for f in (H.real + 0.5, H.imag):
            size = np.abs(f)
            same = (f[:, 1:-1] * f[:, 2:] > 0) & (f[:, 1:-1] * f[:, :-2] > 0)
            dip = same & (size[:, 1:-1] < size[:, 2:]) & (size[:, 1:-1] < size[:, :-2])
            dip &= size[:, 1:-1] < np.maximum(size[:, 2:] - size[:, 1:-1], size[:, :-2] - size[:, 1:-1])
            gaps.update(int(k) for k in np.nonzero(dip)[1])
        if not gaps:
            break
        left = np.array(sorted(gaps | {k + 1 for k in gaps}))
        extra = (w[left, None] + (w[left + 1] - w[left])[:, None] * np.linspace(0, 1, 8)[1:-1]).ravel()
        w, H = np.concatenate([w, extra]), np.concatenate([H, point.H(on_axis(extra))], axis=1)
        w, first = np.unique(w, return_index=True)
        H = H[:, first]
    return w, H


def _crossings(point: _Point, w: Array, H: Complex, gain: bool) -> tuple[Ints, Array, Complex]:
    """Channels, frequencies and H of the sign changes of Re H + 1/2 (``gain``) or Im H, by the Illinois rule."""
    f = H.real + 0.5 if gain else H.imag
    changes = (f[:, :-1] >= 0) != (f[:, 1:] >= 0)  # a zero exactly on one of them counts once
    if not gain:  # a loop with negligible gain changes sign everywhere by rounding
        size = np.abs(H)
        changes &= np.maximum(size[:, :-1], size[:, 1:]) > 1 / FARTHEST
    channel, k = np.nonzero(changes)
    a, b, fa, fb = w[k], w[k + 1], f[channel, k], f[channel, k + 1]
    x, hx = a.copy(), H[channel, k]
    todo = np.arange(channel.size)
    for _ in range(60):
        if not todo.size:
            break
        try_ = (a[todo] * fb[todo] - b[todo] * fa[todo]) / (fb[todo] - fa[todo])
        x[todo] = np.where((try_ >= a[todo]) & (try_ <= b[todo]), try_, (a[todo] + b[todo]) / 2)
        hx[todo] = point.one(channel[todo], on_axis(x[todo]))
        fx = hx[todo].real + 0.5 if gain else hx[todo].imag
        right = (fx >= 0) == (fb[todo] >= 0)
        fa[todo], fb[todo] = np.where(right, fa[todo] / 2, fx), np.where(right, fx, fb[todo] / 2)
        a[todo], b[todo] = np.where(right, a[todo], x[todo]), np.where(right, x[todo], b[todo])
        found = (np.abs(fx) <= 1e-13 * np.abs(hx[todo])) | (b[todo] - a[todo] <= 1e-13 * b[todo])
        todo = todo[~found]
    return channel, x, hx


def _peaks(point: _Point, w: Array, H: Complex, peak: Array, where: Array) -> tuple[Array, Array]:
    """The largest |S| of each channel on w, refined at its three highest frequencies, where it exceeds ``peak``."""
    size = np.abs(1 + H)
    found_at = [(c, *one) for c in range(len(size)) for one in _brackets(size[c], NEAR * max(float(peak[c]), float(size[c].max())))]
    channel, k, low, high = (np.array([one[i] for one in found_at], np.int64) for i in range(4))
    a, b, best, at = w[low], w[high], size[channel, k], w[k]
    inner = np.linspace(0, 1, 9)
    for _ in range(7):
        x = a[:, None] + (b - a)[:, None] * inner
        found = np.abs(1 + point.one(np.repeat(channel, inner.size), on_axis(x.ravel()))).reshape(x.shape)
        top = found.argmax(axis=1)
        rows = np.arange(channel.size)
        better = found[rows, top] > best
        best, at = np.where(better, found[rows, top], best), np.where(better, x[rows, top], at)
        a, b = x[rows, np.maximum(top - 1, 0)], x[rows, np.minimum(top + 1, 8)]
    peak, where = peak.copy(), where.copy()
    for c, value, place in zip(channel, best, at, strict=True):
        if value > peak[c]:
            peak[c], where[c] = value, place
    return peak, where


def _brackets(size: Array, least: float) -> list[tuple[int, int, int]]:
    """The highest local maxima (index, and those of their bracket) of at least ``least``; a bracket reaches to where the size has really fallen.

    Frequencies that nearly coincide have sizes that differ by rounding only: one maximum, not several.
    """
    inner = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:]) & (size[1:-1] > least)
    tops = 1 + np.flatnonzero(inner)
    out: list[tuple[int, int, int]] = []
    for k in tops[np.argsort(-size[tops], kind="stable")].tolist():
        if any(low < k < high for _, low, high in out):
            continue
        fallen = np.flatnonzero(size < size[k] * (1 - FLAT))
        right = int(np.searchsorted(fallen, k))
        out.append((k, int(fallen[right - 1]) if right else 0, int(fallen[right]) if right < fallen.size else size.size - 1))
        if len(out) == CLIMBED:
            break
    return out


def _joined(parts: list[tuple[Ints, Array, Complex]]) -> Crossings:
    channel, w, H = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Crossings(np.zeros(channel.size, np.int64), channel, w, H)


def _needed(point: _Point, w: Array, high: float, increase: Array) -> float:
    """[rad/s] up to which a crossing could limit a margin: |L| >= 1, or a gain below the increase found so far. ``w`` resolves the poles."""
    last = max(64 * high, float(w[-1]))
    w = np.union1d(np.geomspace(high, last, int(25 * np.log10(last / high)) + 2), w[w > high])
    H = point.H(on_axis(w))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.abs(H / (1 + H))
    binds = size >= np.minimum(1.0, 0.98 / increase)[:, None]
    binds &= size > 1e-4
    at = np.flatnonzero(binds.any(axis=0))
    return float(w[min(at[-1] + 1, w.size - 1)]) if at.size else high
