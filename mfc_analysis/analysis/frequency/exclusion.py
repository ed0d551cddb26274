"""Gain crossovers by exclusion: cheaper than an eigenvalue problem for each channel, and as reliable.

Where H(jw) = H0 + sum r_k / (jw - s_k) is known by its modes, f(w) = Re H + 1/2 deviates from its chord over [a, b] by at most

    (b - a)^2 / 4 * sum |r_k| / d_k^3,       d_k: distance of s_k from the segment j[a, b],

because |H''| <= 2 sum |r_k| / d_k^3. An interval holds no crossover if f has the same sign at both ends and is larger than this
bound; it holds at most one if its chord is steeper than 2 (b - a) sum |r_k| / d_k^3. All others are halved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mfc_analysis.analysis.frequency.grid import Grid, inverse_cubes
from mfc_analysis.analysis.frequency.resolvent import Resolvent
from mfc_analysis.maths.arrays import Array, Bools, Ints

HALVINGS = 40
FARTHEST = 100.0  #: times the last frequency of the grid: farther up phase crossings are left to the eigenvalue problem
MOST = 60  #: most open intervals of one channel, on average; above this the eigenvalue problem is used


@dataclass(frozen=True, eq=False)
class Intervals:
    """k intervals, each with its point, its channel and f at its ends."""

    point: Ints
    channel: Ints
    a: Array  #: [rad/s]
    b: Array
    fa: Array
    fb: Array

    def __getitem__(self, some: Bools) -> Intervals:
        return Intervals(*(x[some] for x in vars(self).values()))


def crossover_intervals(grid: Grid) -> tuple[Intervals, Bools]:
    """Intervals with exactly one gain crossover each, and (m, n) where some crossovers are not found. Of points that are all modal."""
    return _isolated(grid.found, grid, grid.H.real + 0.5, _gain_end(grid.found))


def phase_intervals(grid: Grid) -> tuple[Resolvent, Intervals, Bools]:
    """The same of the phase crossings: Im H = 0. They are the crossovers of -j (H - H0) - 1/2, the first of what is returned.

    None are found on a grid from 0 on, where Im H is 0.
    """
    found = grid.found
    turned = replace(found, ch=replace(found.ch, H0=np.full(found.ch.H0.shape, -0.5)), residues=-1j * found.residues)
    end = grid.real_end()
    known = (end < FARTHEST * grid.w[:, -1:]) & (grid.w[:, :1] > 0)
    some, failed = _isolated(turned, grid, grid.H.imag, np.where(known, end, np.inf))
    return turned, some, failed


def _isolated(found: Resolvent, grid: Grid, f: Array, end: Array) -> tuple[Intervals, Bools]:
    """Intervals with exactly one zero of f each, and where some are not found.

    ``f``: (m, n, k) on the grid; ``end``: (m, n) [rad/s] above which it has no zero.
    """
    w, bend = grid.w, grid.bend
    weight = np.abs(found.residues)
    failed = ~np.isfinite(f).all(axis=2) | np.isinf(end)
    open_ = ~_empty(f[..., :-1], f[..., 1:], (w[:, 1:] - w[:, :-1])[:, None], bend) & (w[:, None, :-1] < end[..., None])
    point, channel, k = np.nonzero(open_ & ~failed[..., None])
    first = Intervals(point, channel, w[point, k], w[point, k + 1], f[point, channel, k], f[point, channel, k + 1])
    steep = _steep(first, bend[point, channel, k])
    point, channel = np.nonzero((end > w[:, -1:]) & ~failed)
    tail = Intervals(point, channel, w[point, -1], end[point, channel], f[point, channel, -1], np.zeros(point.size))
    tail = Intervals(point, channel, tail.a, tail.b, tail.fa, _f(found, point, channel, tail.b))
    return _halved(found, weight, [first[steep]], _together([first[~steep], tail]), failed)


def _halved(found: Resolvent, weight: Array, done: list[Intervals], todo: Intervals, failed: Bools) -> tuple[Intervals, Bools]:
    for _ in range(HALVINGS):
        if not todo.a.size:
            break
        crowded = np.zeros(failed.shape, np.int64)
        np.add.at(crowded, (todo.point, todo.channel), 1)
        failed |= crowded > MOST
        todo = todo[~failed[todo.point, todo.channel]]
        middle = np.where(todo.b > 4 * todo.a, np.sqrt(np.maximum(todo.a, 1e-6 * todo.b) * todo.b), (todo.a + todo.b) / 2)
        fm = _f(found, todo.point, todo.channel, middle)
        both = _together(
            [
                Intervals(todo.point, todo.channel, todo.a, middle, todo.fa, fm),
                Intervals(todo.point, todo.channel, middle, todo.b, fm, todo.fb),
            ]
        )
        cubes = inverse_cubes(found.poles[both.point], both.a[:, None], both.b[:, None])[..., 0]
        bend = (weight[both.point, both.channel] * cubes).sum(axis=1)
        some = ~_empty(both.fa, both.fb, both.b - both.a, bend)
        both, bend = both[some], bend[some]
        narrow = both.b - both.a <= 1e-10 * both.b
        finished = _steep(both, bend) | narrow
        done.append(both[finished & ((both.fa >= 0) != (both.fb >= 0))])
        todo = both[~finished]
    if todo.a.size:
        failed[todo.point, todo.channel] = True
    every = _together(done)
    return every[~failed[every.point, every.channel]], failed


def narrowed(found: Resolvent, some: Intervals) -> Array:
    """The approximate crossover (k,) [rad/s] in each interval: Newton safeguarded by bisection."""
    a, b = some.a, some.b
    rising = some.fb > some.fa
    x = a - some.fa * (b - a) / (some.fb - some.fa)
    for _ in range(6):
        H, slope = found.at(some.point, some.channel, x)
        f = H.real + 0.5
        left = (f < 0) == rising
        a, b = np.where(left, x, a), np.where(left, b, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - f / slope.real
        x = np.where((step >= a) & (step <= b), step, (a + b) / 2)
    return x


def _f(found: Resolvent, point: Ints, channel: Ints, w: Array) -> Array:
    return np.asarray(found.at(point, channel, w)[0].real + 0.5)


def _empty(fa: Array, fb: Array, h: Array, bend: Array) -> Bools:
    same = (fa >= 0) == (fb >= 0)
    return np.asarray(same & (np.minimum(np.abs(fa), np.abs(fb)) > 0.25 * h * h * bend))


def _steep(some: Intervals, bend: Array) -> Bools:
    h = some.b - some.a
    crosses = (some.fa >= 0) != (some.fb >= 0)
    return np.asarray(crosses & (np.abs(some.fb - some.fa) > 2 * h * h * bend))


def _gain_end(found: Resolvent) -> Array:
    """(m, n) [rad/s] above which f keeps the sign of its limit; inf where that limit is zero."""
    limit = np.abs(found.ch.H0 + 0.5)
    infinite = limit < 1e-9
    total = np.abs(found.residues).sum(axis=2)
    return np.where(infinite, np.inf, np.abs(found.poles).max(axis=1)[:, None] + 1.01 * total / np.where(infinite, 1.0, limit))


def _together(parts: list[Intervals]) -> Intervals:
    return Intervals(*(np.concatenate(x) for x in zip(*(vars(p).values() for p in parts), strict=True)))
