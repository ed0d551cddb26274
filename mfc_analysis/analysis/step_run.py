"""Responses in sections, on each of which they are polynomials; and their metrics, exact between the samples.

Extremes come from the slope of the polynomials, crossings from the runs between extremes, on which a response is monotone. All responses
of a run have the same sections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mfc_analysis.maths.arrays import Array, Bools, Ints

BAND = 0.02  #: settling band
METRICS = ("rise", "settling", "overshoot", "undershoot", "peak", "peak_time")
NO_END = 1e-7  #: of its peak: a response that ends below that returns to zero
PARTS = (0.1, 0.9)  #: of the final value, between which a response rises
LOOKS = np.linspace(0.0, 1.0, 6)  #: places in a section between which the slope changes its sign at most once
CLOSE = 1e-10  #: last move of a search in theta; Newton's next one is about its square
ITERATIONS = 60  #: of a safeguarded Newton search, which at worst halves
HELD = np.ones((1, 1))  #: basis of responses that are held from sample to sample


@dataclass(frozen=True, eq=False)
class Piece:
    """P responses in k sections: y(t_i + theta h_i) = sum_p c_p theta^p, 0 <= theta <= 1, with c = basis @ ends of the section."""

    t: Array  #: (k + 1,) [s]
    ends: Array  #: (q, P, k) what is known at the ends of each section; the first is y at its start
    basis: Array  #: (p, q)

    def of(self, which: Ints) -> Piece:
        """Some of its responses."""
        return self if which.size == self.ends.shape[1] else Piece(self.t, self.ends[:, which], self.basis)

    @property
    def samples(self) -> tuple[Array, Array]:
        """(k + 1,) times [s] and (P, k + 1) values at the ends of the sections."""
        return self.t, np.append(self.ends[0], (self.basis.sum(axis=0) @ self.ends[:, :, -1])[:, None], axis=1)

    def values(self, times: Array) -> Array:
        """(P, j) at these times [s] within the run."""
        section = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, self.t.size - 2)
        theta = (times - self.t[section]) / np.diff(self.t)[section]
        return _at(np.tensordot(self.basis, self.ends[:, :, section], axes=1), theta)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """(P, k) largest and smallest values in each section."""
        q, P, k = self.ends.shape
        flat = self.ends.reshape(q, -1)
        start, end = self.ends[0], (self.basis.sum(axis=0) @ flat).reshape(P, k)
        high, low = np.maximum(start, end), np.minimum(start, end)
        if len(self.basis) > 1:
            orders = np.arange(1, len(self.basis))
            seen = LOOKS[:, None] ** (orders - 1) * orders @ self.basis[1:] @ flat
            look, at = np.nonzero(seen[:-1] * seen[1:] < 0)
            c = self.basis @ flat[:, at]
            y = _at(c, _root(_slope(c), LOOKS[look], LOOKS[look + 1], seen[look + 1, at] > 0))
            np.maximum.at(high.reshape(-1), at, y)
            np.minimum.at(low.reshape(-1), at, y)
        return high, low

    def runs(self, which: Ints, section: Ints) -> tuple[Array, Array, Array]:
        """Coefficients (p, j) of response ``which`` in ``section``, and theta and values (j, places) between which it is monotone."""
        c = self.basis @ self.ends[:, which, section]
        theta = np.tile(np.concatenate([[0.0], LOOKS[:-1], [1.0]]), (section.size, 1))  # where there is no extreme, a place like any other
        if len(c) > 1:
            slope = _slope(c)
            seen = _at(slope[..., None], LOOKS)
            row, look = np.nonzero(seen[:, :-1] * seen[:, 1:] < 0)
            theta[row, look + 1] = _root(slope[:, row], LOOKS[look], LOOKS[look + 1], seen[row, look + 1] > 0)
        return c, theta, np.broadcast_to(_at(c[..., None], theta), theta.shape)

    def time(self, section: Ints, theta: Array) -> Array:
        """[s]"""
        return np.asarray(self.t[section] + theta * (self.t[section + 1] - self.t[section]))

    def first(self, which: Ints, section: Ints, level: Array, sign: Array) -> Array:
        """[s] the first time at which sign * y reaches the level, in sections in which it does."""
        c, theta, y = self.runs(which, section)
        beyond = sign[:, None] * y >= level[:, None]
        k, row = beyond.argmax(axis=1), np.arange(section.size)
        before = np.maximum(k - 1, 0)
        return self.time(section, np.where(k > 0, _crossing(c, theta[row, before], theta[row, k], sign * level, sign > 0), theta[row, k]))

    def last(self, which: Ints, section: Ints, steady: Array, band: Array) -> Array:
        """[s] the last time outside the band about ``steady``, in sections that are not all inside."""
        c, theta, y = self.runs(which, section)
        apart = y - steady[:, None]
        k, row = theta.shape[1] - 1 - (np.abs(apart) > band[:, None])[:, ::-1].argmax(axis=1), np.arange(section.size)
        after, above = np.minimum(k + 1, theta.shape[1] - 1), apart[row, k] > 0
        found = _crossing(c, theta[row, k], theta[row, after], steady + np.where(above, band, -band), ~above)
        return self.time(section, np.where(after > k, found, 1.0))

    def extreme(self, which: Ints, section: Ints, sign: Array) -> Array:
        """[s] where sign * y is largest in its section."""
        _, theta, y = self.runs(which, section)
        return self.time(section, theta[np.arange(section.size), (sign[:, None] * y).argmax(axis=1)])


def _at(c: Array, theta: Array) -> Array:
    """The polynomials c (p, ...) at theta (...)."""
    value = c[-1]
    for one in c[-2::-1]:
        value = value * theta + one
    return np.asarray(value)


def _slope(c: Array) -> Array:
    return c[1:] * np.arange(1, len(c)).reshape(-1, *[1] * (c.ndim - 1)) if len(c) > 1 else np.zeros_like(c)


def _crossing(c: Array, low: Array, high: Array, level: Array, rises: Bools) -> Array:
    moved = c.copy()
    moved[0] -= level
    return _root(moved, low, high, rises)


def _root(c: Array, low: Array, high: Array, rises: Bools) -> Array:
    """(j,) where the polynomials c (p, j) change their sign between low and high, from below where they rise: Newton, safeguarded."""
    slope, ends = _slope(c), np.abs([_at(c, low), _at(c, high)])
    x = low + (high - low) * (ends[0] / np.maximum(ends.sum(axis=0), 1e-300))
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(ITERATIONS if x.size else 0):
            y = _at(c, x)
            left = (y < 0) == rises
            low, high = np.where(left, x, low), np.where(left, high, x)
            new = x - y / _at(slope, x)
            new = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
            moved, x = np.abs(new - x).max(), new
            if moved < CLOSE:
                break
    return np.asarray(x)


def metrics_of(run: Piece, steady: Array, least: Array | float = 0.0) -> dict[str, Array]:
    """``metrics`` of responses that end with this piece."""
    return metrics(lambda _, which: run.of(which), steady, np.full((1, steady.size), np.inf), least)


def metrics(piece: Callable[[int, Ints], Piece], steady: Array, reach: Array, least: Array | float = 0.0) -> dict[str, Array]:
    """Rise, settling [s], overshoot, undershoot, peak and its time [s] (P,) of responses that end at ``steady`` (P,).

    ``piece(i, which)``: piece i of the responses ``which``. ``reach`` (pieces, P): bounds of abs(y - steady) from each piece on, decreasing;
    pieces that cannot matter are not looked at. ``least`` (P,): the band is at least as wide, the error of the responses.
    """
    P, end = steady.size, np.abs(steady)
    sign = np.where(steady < 0, -1.0, 1.0)
    value, when = np.full((2, P), -np.inf), np.full((2, P), np.nan)  # of the largest sign * y, and of the largest -sign * y
    levels = np.full((2, P), np.nan)
    for i, far in enumerate(reach):
        done = (~np.isnan(levels).any(axis=0) | (end == 0)) & (end + far <= value[0]) & (far - end <= value[1])
        which = np.flatnonzero(~done)
        if not which.size:
            break
        now = piece(i, which)
        high, low = now.bounds
        up, s = sign[which] > 0, sign[which]
        for j, (side, y) in enumerate(((s, np.where(up[:, None], high, -low)), (-s, np.where(up[:, None], -low, high)))):
            k = y.argmax(axis=1)
            found = y[np.arange(which.size), k]
            better = np.flatnonzero(found > value[j, which])
            value[j, which[better]] = found[better]
            when[j, which[better]] = now.extreme(better, k[better], side[better])
            if j == 0:
                level = np.multiply.outer(PARTS, end[which])
                part, new = np.nonzero(np.isnan(levels[:, which]) & (found >= level))
                section = (y[new] >= level[part, new, None]).argmax(axis=1)
                levels[part, which[new]] = now.first(new, section, level[part, new], s[new])
    (top, bottom), (top_at, bottom_at) = value, when
    below = bottom > np.maximum(top, end)
    peak = np.maximum(np.maximum(bottom, top), end)
    none = end <= NO_END * peak
    band = np.maximum(BAND * np.where(none, peak, end), least)
    settling, inside = np.zeros(P), np.ones(P, bool)
    for i in range(len(reach) - 1, -1, -1):
        which = np.flatnonzero(inside & (reach[i] > band))
        if not which.size:
            continue
        now = piece(i, which)
        outside = np.maximum(now.bounds[0] - steady[which, None], steady[which, None] - now.bounds[1]) > band[which, None]
        new = np.flatnonzero(outside.any(axis=1))
        at = which[new]
        settling[at] = now.last(new, outside.shape[1] - 1 - outside[new, ::-1].argmax(axis=1), steady[at], band[at])
        inside[at] = False
    with np.errstate(divide="ignore", invalid="ignore"):
        over, under = top / end - 1, np.maximum(0.0, bottom / end)
    return {
        "rise": np.where(none, np.nan, levels[1] - levels[0]),
        "settling": settling,
        "overshoot": np.where(none, np.nan, np.where(over > 1e-9, over, 0.0)),
        "undershoot": np.where(none, np.nan, under),
        "peak": peak,
        "peak_time": np.where((top <= end * (1 + 1e-9)) & ~below, np.inf, np.where(below, bottom_at, top_at)),
    }
