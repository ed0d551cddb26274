"""The sensitivity peak: the supremum of |S_i| over all frequencies, zero and infinity included.

S_i has the poles of the closed loop. It is smooth between frequencies placed by these poles, a fraction of their damping apart.
The highest values on this grid are refined to the peak.
"""

from __future__ import annotations

import numpy as np

from mfc_analysis.analysis.frequency.resolvent import Resolvent
from mfc_analysis.maths.arrays import Array, Complex, Ints

AT = np.array([-2.5, -1.0, 0.0, 1.0, 2.5])  #: frequencies around a pole, in units of its decay rate,
BETWEEN = np.array([-6.0, -0.4, 0.4, 6.0])  #: and further ones around its conjugate
BESIDE = np.array([0.3, 0.6, 1.0, 1.7, 3.5])  #: frequencies around a real pole, in units of its modulus
LADDER = 20  #: frequencies with logarithmic spacing from the slowest to the fastest pole
CLIMBED = 3  #: local maxima refined in each channel,
NEAR = 0.7  #: if they are at least this fraction of the highest


def frequencies_of_interest(poles: Complex, lowest: float) -> Array:
    """(m, k) increasing frequencies [rad/s] from ``lowest`` on that resolve every resonance of the poles (m, nx)."""
    size = np.abs(poles)
    top = np.maximum(size.max(axis=1, keepdims=True), lowest or 1e-300)
    size = np.where(size > 1e-9 * top, np.maximum(size, lowest), top)
    rate, height = np.abs(poles.real)[:, :, None], np.abs(poles.imag)[:, :, None]
    near = np.where(poles.imag[:, :, None] > 0, height + rate * AT, size[:, :, None] * BESIDE)
    near = np.where(poles.imag[:, :, None] < 0, np.concatenate([height + rate * BETWEEN, size[:, :, None]], axis=2), near)
    slow, fast = np.log(size.min(axis=1)) - 4.6, np.log(top[:, 0]) + 4.6
    ladder = np.exp(slow[:, None] + (fast - slow)[:, None] * np.linspace(0, 1, LADDER))
    every = np.concatenate([near.reshape(len(poles), -1), ladder], axis=1)
    return np.sort(np.concatenate([np.full((len(poles), 1), lowest), np.where(every > lowest, every, ladder[:, -1:])], axis=1), axis=1)


def thinned(w: Array, poles: Complex) -> Array:
    """Fewer of the increasing frequencies w (m, k): about one per 0.3 of the distance to the nearest pole (m, nx). The last is repeated.

    Where many poles coincide most of the frequencies of interest are nearly equal.
    """
    distance = np.abs(1j * w[:, :, None] - poles[:, None, :]).min(axis=2)
    step = np.diff(w, axis=1)
    cell = np.floor(np.cumsum(step / np.maximum(np.maximum(0.3 * distance[:, :-1], step), 1e-300), axis=1))  # a pole may lie on a frequency
    keep = np.ones(w.shape, bool)
    keep[:, 1:-1] = np.diff(cell, axis=1) > 0
    return np.sort(np.where(keep, w, w[:, -1:]), axis=1)[:, : int(keep.sum(axis=1).max())]


def sensitivity_peak(found: Resolvent, w: Array, H: Complex) -> tuple[Array, Array]:
    """Largest |S_i| (m, n) from the lowest of the frequencies of interest ``w`` (m, k) to infinity, and its frequency (m, n) [rad/s].

    ``H``: S_i - 1 (m, n, k) at these frequencies.
    """
    size = np.abs(1 + H)
    ends = np.stack([size[..., 0], np.abs(1 + found.ch.H0)])
    low, high = np.pad(size, ((0, 0), (0, 0), (1, 0)))[..., :-1], np.pad(size, ((0, 0), (0, 0), (0, 1)))[..., 1:]
    top = (size >= low) & (size >= high)
    top &= ((w > w[:, :1]) & (w < w[:, -1:]))[:, None]
    best = np.maximum(size.max(axis=2), ends.max(axis=0))
    top &= size > NEAR * best[..., None]
    ranked = np.argsort(np.where(top, -size, 0.0), axis=2)[..., :CLIMBED]
    point, channel, rank = np.nonzero(np.take_along_axis(top, ranked, 2))
    value, where = _climbed(found, w, point, channel, ranked[point, channel, rank])
    peak, at = np.zeros(best.shape), np.full(best.shape, np.inf)
    order = np.argsort(value, kind="stable")  # of several values the last one written, the highest, stays
    peak[point[order], channel[order]], at[point[order], channel[order]] = value[order], where[order]
    for end, frequency in zip(ends, (w[:, :1], np.full((1, 1), np.inf)), strict=True):
        better = end >= peak * (1 - 1e-12)
        peak, at = np.where(better, end, peak), np.where(better, frequency, at)
    return peak, at


def _climbed(found: Resolvent, w: Array, point: Ints, channel: Ints, k: Ints) -> tuple[Array, Array]:
    """Peak of |S| between the neighbours of w[point, k]: secant steps on d|S|^2/dw, safeguarded by bisection on its sign."""
    last = w.shape[1] - 1
    a, b = w[point, np.maximum(k - 1, 0)], w[point, np.minimum(k + 1, last)]
    x = w[point, k]
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
