"""The sensitivity peak: the supremum of |S_i| over all frequencies, zero and infinity included.

S_i has the poles of the closed loop, so between frequencies placed by these poles, a fraction of their damping apart, it is
smooth; the highest ones found there are climbed to the top.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.resolvent import Resolvent

Array = NDArray[np.float64]

AROUND = np.array([-6.0, -2.5, -1.0, -0.4, 0.0, 0.4, 1.0, 2.5, 6.0])  #: places around a pole, in units of its decay rate
LADDER = 12  #: frequencies spread evenly in the logarithm from the slowest to the fastest pole
CLIMBED = 3  #: local maxima climbed in each channel


def frequencies_of_interest(poles: NDArray[np.complex128]) -> Array:
    """(m, k) rising positive frequencies [rad/s] that resolve every resonance of the poles (m, nx)."""
    size = np.abs(poles)
    top = size.max(axis=1, keepdims=True)
    size = np.where(size > 1e-9 * top, size, top)
    near = np.abs(poles.imag)[:, :, None] + np.abs(poles.real)[:, :, None] * AROUND
    near = np.where(poles.imag[:, :, None] >= 0, near, size[:, :, None] * 1.7 ** (AROUND / 2))
    slow, fast = np.log(size.min(axis=1)) - 2.3, np.log(top[:, 0]) + 2.3
    ladder = np.exp(slow[:, None] + (fast - slow)[:, None] * np.linspace(0, 1, LADDER))
    every = np.concatenate([near.reshape(len(poles), -1), size, ladder], axis=1)
    return np.sort(np.where(every > 0, every, ladder[:, :1]), axis=1)


def sensitivity_peak(found: Resolvent, at_zero: NDArray[np.complex128]) -> tuple[Array, Array]:
    """Largest |S_i| (m, n) and its frequency (m, n) [rad/s], 0 and inf included. ``at_zero``: S_i(0) - 1 (m, n), NaN: not looked at."""
    w = frequencies_of_interest(found.poles)
    size = np.abs(1 + found.on(w))
    ends = np.stack([np.abs(1 + at_zero), np.abs(1 + found.ch.H0)])
    low, high = np.pad(size, ((0, 0), (0, 0), (1, 0)))[..., :-1], np.pad(size, ((0, 0), (0, 0), (0, 1)))[..., 1:]
    top = (size >= low) & (size >= high)
    ranked = np.argsort(np.where(top, -size, 0.0), axis=2)[..., :CLIMBED]
    point, channel, _ = np.indices(ranked.shape)
    value, where = _climbed(found, w, point.ravel(), channel.ravel(), ranked.ravel())
    value, where = value.reshape(ranked.shape), where.reshape(ranked.shape)
    best = value.argmax(axis=2)[..., None]
    peak, at = np.take_along_axis(value, best, 2)[..., 0], np.take_along_axis(where, best, 2)[..., 0]
    for end, frequency in zip(ends, (0.0, np.inf), strict=True):
        better = end >= peak * (1 - 1e-12)
        peak, at = np.where(better, end, peak), np.where(better, frequency, at)
    return peak, at


def _climbed(found: Resolvent, w: Array, point: NDArray[np.int64], channel: NDArray[np.int64], k: NDArray[np.int64]) -> tuple[Array, Array]:
    """Top of |S| between the neighbours of w[point, k]: bisection on the sign of d|S|^2/dw, safeguarding secant steps."""
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
