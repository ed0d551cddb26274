"""The frequencies that a Bode plot shows: around the poles and the crossings of a loop."""

from __future__ import annotations

import numpy as np

from mfc_analysis.maths.arrays import Array, Complex

MOST_DECADES = 7.0  #: of a frequency axis
BEYOND = 20.0  #: factor below the lowest and above the highest frequency of interest


def window(rates: Complex, crossings: Array, crossover: float, dt: float = 0.0, count: int = 360) -> Array:
    """(count,) [rad/s] around the poles ``rates`` [1/s] and the crossings [rad/s], at most seven decades about the crossover [rad/s].

    Of a sampled loop (``dt`` [s]) up to half the sample rate.
    """
    at = np.concatenate([np.abs(np.ravel(rates)), np.ravel(crossings)])
    at = at[np.isfinite(at) & (at > 1e-6)]
    low, high = (float(at.min()) / BEYOND, float(at.max()) * BEYOND) if at.size else (1e-2, 1e2)
    if dt:
        high = np.pi / dt * (1 - 1e-9)
        low = min(low, high / 100)
    if np.log10(high / low) > MOST_DECADES:
        middle = crossover if np.isfinite(crossover) else float(np.sqrt(low * high))
        low, high = max(low, middle * 10 ** (-0.6 * MOST_DECADES)), min(high, middle * 10 ** (0.4 * MOST_DECADES))
    return np.asarray(np.geomspace(low, high, count), float)
