"""A response in sections, on each of which it is a polynomial; and its metrics, exact between the samples.

Extremes come from the slope of the polynomials, crossings from the sections between extremes, on which the response is monotone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import polynomial

from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.roots import root_between

BAND = 0.02  #: settling band
METRICS = ("rise", "settling", "overshoot", "undershoot", "peak", "peak_time")
LOOKS = np.linspace(0.0, 1.0, 6)  #: places in a section between which the slope changes its sign at most once
HALVINGS = 44


@dataclass(frozen=True, eq=False)
class Piece:
    """k sections side by side: y(t_i + theta h_i) = sum_p c_ip theta^p, 0 <= theta <= 1. One coefficient: y is held."""

    t: Array  #: (k + 1,) [s]
    c: Array  #: (k, p)

    @property
    def samples(self) -> tuple[Array, Array]:
        """(k + 1,) times [s] and values at the ends of the sections."""
        return self.t, np.append(self.c[:, 0], self.c[-1].sum())

    @cached_property
    def nodes(self) -> tuple[Array, Array, Ints, Array]:
        """Time [s], value, section and theta of the ends of all sections and of the extremes inside them, in their order."""
        k, h = len(self.c), np.diff(self.t)
        section, theta = np.repeat(np.arange(k), 2), np.tile([0.0, 1.0], k)
        if self.c.shape[1] > 1:
            inner, place = self._extremes()
            section, theta = np.concatenate([section, inner]), np.concatenate([theta, place])
            order = np.lexsort((theta, section))
            section, theta = section[order], theta[order]
        return self.t[section] + theta * h[section], self._at(section, theta, self.c), section, theta

    @staticmethod
    def _at(section: Ints, theta: Array, c: Array) -> Array:
        """The polynomials c (k, p) of these sections at theta: (j,)."""
        value = c[section, -1].copy()
        for p in range(c.shape[1] - 2, -1, -1):
            value *= theta
            value += c[section, p]
        return np.asarray(value)

    def _extremes(self) -> tuple[Ints, Array]:
        """Sections and theta of the zeros of the slope, each between two of ``LOOKS``."""
        slope = self.c[:, 1:] * np.arange(1, self.c.shape[1])
        seen = polynomial.polyval(LOOKS, slope.T)  # (k, places)
        section, look = np.nonzero(seen[:, :-1] * seen[:, 1:] < 0)
        low, high = LOOKS[look], LOOKS[look + 1]
        rises = seen[section, look] > 0
        for _ in range(HALVINGS if section.size else 0):
            middle = 0.5 * (low + high)
            right = (self._at(section, middle, slope) > 0) == rises
            low, high = np.where(right, middle, low), np.where(right, high, middle)
        return section, np.asarray(0.5 * (low + high))

    def crossing(self, node: int, level: float) -> float:
        """[s] where the response passes the level between this node and the next."""
        time, value, section, theta = self.nodes
        if section[node] != section[node + 1]:
            return float(time[node + 1])
        c, i = self.c[section[node]].copy(), int(section[node])
        c[0] -= level
        ends = {float(theta[j]): float(value[j]) - level for j in (node, node + 1)}
        found = root_between(
            lambda x: ends[x] if x in ends else float(polynomial.polyval(x, c)), float(theta[node]), float(theta[node + 1]), xtol=1e-15, rtol=1e-14
        )
        return float(self.t[i] + found * (self.t[i + 1] - self.t[i]))


@dataclass
class _Extreme:
    """The largest sign * y so far."""

    sign: float
    value: float = -np.inf
    time: float = np.nan

    def see(self, time: Array, y: Array) -> None:
        k = int(np.argmax(self.sign * y))
        if self.sign * y[k] > self.value:
            self.value, self.time = float(self.sign * y[k]), float(time[k])


def metrics(pieces: Sequence[Piece], steady: float, reach: Array | None = None) -> dict[str, float]:
    """Rise, settling [s], overshoot, undershoot, peak and its time [s] of a response that ends at ``steady``.

    ``reach`` (pieces,): bounds of abs(y - steady) from each piece on, decreasing; pieces that cannot matter are not looked at.
    """
    reach = np.full(len(pieces), np.inf) if reach is None else reach
    sign = -1.0 if steady < 0 else 1.0
    top, low = _Extreme(sign), _Extreme(-sign)
    levels = {0.1: np.nan, 0.9: np.nan}
    for i, far in enumerate(reach):
        done = not np.isnan(list(levels.values())).any() or steady == 0
        if done and sign * steady + far <= top.value and far - sign * steady <= low.value:
            break
        time, y, *_ = pieces[i].nodes
        top.see(time, y)
        low.see(time, y)
        for part, when in levels.items():
            if np.isnan(when):
                levels[part] = _first(pieces[i], part * steady)
    end = abs(steady)
    below = low.value > max(top.value, end)
    peak = max(low.value, top.value, end)
    monotone = top.value <= end * (1 + 1e-9) and not below
    when = np.inf if monotone else low.time if below else top.time
    none = end <= 1e-9 * peak
    band = BAND * (peak if none else end)
    settling = 0.0
    for i in range(len(pieces) - 1, -1, -1):
        if reach[i] > band:
            last = _last_outside(pieces[i], steady, band)
            if last is not None:
                settling = last
                break
    if none:
        return dict(zip(METRICS, (np.nan, settling, np.nan, np.nan, peak, when), strict=True))
    over = top.value / end - 1
    over, under = (over if over > 1e-9 else 0.0), max(0.0, low.value / end)
    return dict(zip(METRICS, (levels[0.9] - levels[0.1], settling, over, under, peak, when), strict=True))


def _first(piece: Piece, level: float) -> float:
    """[s] the first time at which y reaches the level; NaN: not in this piece."""
    time, y, *_ = piece.nodes
    beyond = y >= level if level > 0 else y <= level
    k = int(np.argmax(beyond))
    if not beyond[k]:
        return float("nan")
    return float(time[k]) if k == 0 else piece.crossing(k - 1, level)


def _last_outside(piece: Piece, steady: float, band: float) -> float | None:
    """[s] the last time outside the band; None: nowhere in this piece."""
    time, y, *_ = piece.nodes
    outside = np.flatnonzero(np.abs(y - steady) > band)
    if not outside.size:
        return None
    k = int(outside[-1])
    return float(time[k]) if k + 1 == time.size else piece.crossing(k, steady + float(np.copysign(band, y[k] - steady)))
