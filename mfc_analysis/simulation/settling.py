"""Whether a simulated run settles, to confirm a linear stability verdict."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array


def settles(t: ArrayLike, y: ArrayLike) -> bool:
    """True if the swings of a signal in the last fifth of its time are smaller than those in the second fifth.

    Args:
        t: (m,) [s] increasing; y: (m,) or (m, k) any unit: an error or a force. The swing of a component is the range of its deviation from
            a straight line through that fifth of the run, so that a slow drift does not count.

    Raises BadArgument for fewer than 20 samples or inconsistent shapes.
    """
    times, signal = np.asarray(t, float), np.asarray(y, float)
    if times.ndim != 1 or times.size < 20 or signal.shape[0] != times.size:
        raise BadArgument("t, y", f"shapes {times.shape} and {signal.shape}", "at least 20 samples of a signal, (m,) and (m,) or (m, k)")
    signal = signal.reshape(times.size, -1)
    if not np.isfinite(signal).all():
        return False
    part = (times - times[0]) / (times[-1] - times[0])
    early, late = (part >= 0.2) & (part <= 0.4), part >= 0.8
    return bool(np.all(_swing(times[late], signal[late]) <= _swing(times[early], signal[early])))


def _swing(t: Array, y: Array) -> Array:
    line = np.stack([np.ones_like(t), t], axis=1)
    return np.asarray(np.ptp(y - line @ np.linalg.lstsq(line, y, rcond=None)[0], axis=0))
