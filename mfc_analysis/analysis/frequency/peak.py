"""The sensitivity peak: the supremum of |S_i| over all frequencies, zero and infinity included.

S_i has the poles of the closed loop. It is smooth between frequencies placed by these poles, a fraction of their damping apart.
The highest values on this grid are refined to the peak. Where the modes are known, every interval in which |S_i| could still be larger is
then searched, so that no peak between the frequencies is missed.
"""

from __future__ import annotations

import numpy as np

from mfc_analysis.analysis.frequency.grid import Grid
from mfc_analysis.analysis.frequency.resolvent import Resolvent
from mfc_analysis.analysis.frequency.taylor import NODES, left_over, over_cells, pole_terms
from mfc_analysis.maths.arrays import Array, Complex, Ints

AT = np.array([-2.5, -1.0, 0.0, 1.0, 2.5])  #: frequencies around a pole, in units of its decay rate,
BETWEEN = np.array([-6.0, -0.4, 0.4, 6.0])  #: and further ones around its conjugate
BESIDE = np.array([0.3, 0.6, 1.0, 1.7, 3.5])  #: frequencies around a real pole, in units of its modulus
LADDER = 20  #: frequencies with logarithmic spacing from the slowest to the fastest pole
CLIMBED = 3  #: local maxima refined in each channel,
NEAR = 0.7  #: if they are at least this fraction of the highest
CERTAIN = 1e-5  #: relative: between the frequencies no |S| is larger than the peak by this
WAVES = 50  #: most divisions of an interval


def frequencies_of_interest(poles: Complex, lowest: float) -> Array:
    """(m, k) increasing frequencies [rad/s] from ``lowest`` on that resolve every resonance of the poles (m, nx). The last may be repeated."""
    size = np.abs(poles)
    top = np.maximum(size.max(axis=1, keepdims=True), lowest or 1e-300)
    size = np.where(size > 1e-9 * top, np.maximum(size, lowest), top)
    rate, height = np.abs(poles.real)[:, :, None], np.abs(poles.imag)[:, :, None]
    near = np.where(poles.imag[:, :, None] > 0, height + rate * AT, size[:, :, None] * BESIDE)
    near = np.where(poles.imag[:, :, None] < 0, np.concatenate([height + rate * BETWEEN, size[:, :, None]], axis=2), near)
    slow, fast = np.log(size.min(axis=1)) - 4.6, np.log(top[:, 0]) + 4.6
    ladder = np.exp(slow[:, None] + (fast - slow)[:, None] * np.linspace(0, 1, LADDER))
    every = np.concatenate([near.reshape(len(poles), -1), ladder], axis=1)
    some = every > lowest
    found = np.sort(np.concatenate([np.full((len(poles), 1), lowest), np.where(some, every, ladder[:, -1:])], axis=1), axis=1)
    return found[:, : 1 + int(some.sum(axis=1).max())]


def thinned(w: Array, poles: Complex) -> Array:
    """Fewer of the increasing frequencies w (m, k): about one per 0.3 of the distance to the nearest pole (m, nx). The last is repeated.

    Where many poles coincide most of the frequencies of interest are nearly equal.
    """
    distance = np.stack([_distance(*one) for one in zip(w, poles, strict=True)])
    step = np.diff(w, axis=1)
    cell = np.floor(np.cumsum(step / np.maximum(np.maximum(0.3 * distance[:, :-1], step), 1e-300), axis=1))  # a pole may lie on a frequency
    keep = np.ones(w.shape, bool)
    keep[:, 1:-1] = np.diff(cell, axis=1) > 0
    return np.sort(np.where(keep, w, w[:, -1:]), axis=1)[:, : int(keep.sum(axis=1).max())]


def _distance(w: Array, poles: Complex) -> Array:
    """(k,) distance of the points jw (k,) from the nearest pole (nx,)."""
    poles = poles[poles.imag >= 0]  # the others are their conjugates
    squared = w[:, None] - poles.imag
    squared *= squared
    squared += poles.real**2
    return np.asarray(np.sqrt(squared.min(axis=1)))


def sensitivity_peak(grid: Grid) -> tuple[Array, Array]:
    """Largest |S_i| (m, n) from the lowest frequency of a grid (``frequencies_of_interest``) to infinity, and its frequency (m, n) [rad/s]."""
    found, w = grid.found, grid.w
    size = np.abs(1 + grid.H)
    ends = np.stack([size[..., 0], np.abs(1 + found.ch.H0)])
    low, high = np.pad(size, ((0, 0), (0, 0), (1, 0)))[..., :-1], np.pad(size, ((0, 0), (0, 0), (0, 1)))[..., 1:]
    top = (size >= low) & (size >= high)
    top &= ((w > w[:, :1]) & (w < w[:, -1:]))[:, None]
    best = np.maximum(size.max(axis=2), ends.max(axis=0))
    top &= size > NEAR * best[..., None]
    ranked = np.argsort(np.where(top, -size, 0.0), axis=2)[..., :CLIMBED]
    point, channel, rank = np.nonzero(np.take_along_axis(top, ranked, 2))
    k = ranked[point, channel, rank]
    value, where = _climbed(found, w[point, k - 1], w[point, k], w[point, k + 1], point, channel)
    peak, at = np.zeros(best.shape), np.full(best.shape, np.inf)
    order = np.argsort(value, kind="stable")  # of several values the last one written, the highest, stays
    peak[point[order], channel[order]], at[point[order], channel[order]] = value[order], where[order]
    highest = np.argmax(size, axis=2)
    higher = best > peak
    peak, at = np.where(higher, best, peak), np.where(higher, np.take_along_axis(w, highest, 1), at)
    for end, frequency in zip(ends, (w[:, :1], np.full((1, 1), np.inf)), strict=True):
        better = end >= peak * (1 - 1e-12)
        peak, at = np.where(better, end, peak), np.where(better, frequency, at)
    _search(grid, size, peak, at)
    return peak, at


def _search(grid: Grid, size: Array, peak: Array, at: Array) -> None:
    """Raises ``peak`` and its frequency ``at`` (m, n) in place where |S| exceeds it by more than ``CERTAIN`` between the frequencies.

    Of the points with modes. Intervals in which it cannot are excluded: those above all poles by the moments, then by the deviation from the
    chord, then by Taylor polynomials (``taylor``). The others are divided. ``size`` (m, n, k): |S| on the grid.
    """
    found, w = grid.found, grid.w
    h, end = np.diff(w, axis=1), grid.peak_end(peak * (1 + CERTAIN))
    over = np.maximum(size[..., 1:], size[..., :-1]) + (h * h)[:, None] / 4 * grid.bend > peak[..., None] * (1 + CERTAIN)
    point, channel, k = np.nonzero(over & (h > 0)[:, None] & found.modal[:, None, None] & (w[:, None, :-1] < end[..., None]))
    c, r = (w[point, k + 1] + w[point, k]) / 2, (w[point, k + 1] - w[point, k]) / 2
    raised = np.zeros(peak.shape)  # half the width of the interval
    for _ in range(WAVES):
        if not c.size:
            break
        residues, poles = found.residues[point, channel], found.poles[point]
        one, two, three, four = pole_terms(poles, c[:, None], r[:, None])
        value, slope, curve = (
            1 + found.ch.H0[point, channel] + (one * residues).sum(axis=1),
            (two * residues).sum(axis=1),
            (three * residues).sum(axis=1),
        )
        rest = (four * np.abs(residues)).sum(axis=1)
        height = np.abs(value)
        order = np.argsort(height, kind="stable")
        order = order[height[order] > peak[point[order], channel[order]] * (1 + CERTAIN)]
        some = point[order], channel[order]
        peak[some], at[some], raised[some] = height[order], c[order], r[order]
        x = r[:, None] * np.linspace(-1, 1, NODES + 1)
        nodes = np.abs(value[:, None] + x * slope[:, None] + x * x / 2 * curve[:, None])
        left, right = left_over(over_cells(nodes, np.abs(curve), rest, r) > peak[point, channel, None] * (1 + CERTAIN))
        a, b = (c - r)[:, None] + r[:, None] * (2 / NODES) * left, (c - r)[:, None] + r[:, None] * (2 / NODES) * right
        row, side = np.nonzero((right > left) & (b > a))
        c, r = ((a + b) / 2)[row, side], ((b - a) / 2)[row, side]
        point, channel = point[row], channel[row]
    point, channel = np.nonzero(raised)
    if point.size:
        x, r = at[point, channel], raised[point, channel]
        value, where = _climbed(found, x - r, x, x + r, point, channel)
        better = value > peak[point, channel]
        peak[point[better], channel[better]], at[point[better], channel[better]] = value[better], where[better]


def _climbed(found: Resolvent, a: Array, x: Array, b: Array, point: Ints, channel: Ints) -> tuple[Array, Array]:
    """Peak of |S| in [a, b] from x on, (k,) each: secant steps on d|S|^2/dw, safeguarded by bisection on its sign."""
    H, slope = found.at(point, channel, x)
    value, where = np.abs(1 + H), x.copy()
    old_x, old_g = x, (np.conj(1 + H) * slope).real
    a, b = np.where(old_g > 0, x, a), np.where(old_g > 0, b, x)
    x = (a + b) / 2
    for _ in range(9):
        H, slope = found.at(point, channel, x)
        g = (np.conj(1 + H) * slope).real
        better = np.abs(1 + H) > value
        value, where = np.where(better, np.abs(1 + H), value), np.where(better, x, where)
        a, b = np.where(g > 0, x, a), np.where(g > 0, b, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            secant = x - g * (x - old_x) / (g - old_g)
        old_x, old_g = x, g
        x = np.where((secant > a) & (secant < b), secant, (a + b) / 2)
    return value, where
