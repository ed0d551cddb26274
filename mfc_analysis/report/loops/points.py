"""The smallest margins of a loop over all its analysis points, each with its point, channel and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins

CLOSE = 1e-6  #: relative difference below which two analysis points have the same margin; the first one is named
PEAK = "sensitivity_peak"
METRICS = ("phase_deg", "gain_increase_db", "gain_reduction_db", "delay", PEAK)  #: fields of ``Margins``


@dataclass(frozen=True)
class Smallest:
    """The smallest margin (largest peak) of a loop."""

    value: float  #: in the unit of the metric; NaN: the loop is unstable
    point: str  #: the analysis point
    channel: str
    when: float  #: [s]
    crossover: float  #: [rad/s] of that channel; inf where there is none

    @property
    def where(self) -> str:
        """Channel and analysis point."""
        return f"{self.channel} at “{self.point}”"


def smallest(found: Sequence[Margins]) -> Mapping[str, Smallest]:
    """The smallest margin and the largest sensitivity peak over all analysis points, by the names of ``METRICS``. A NaN is passed over."""
    out: dict[str, Smallest] = {}
    for name in METRICS:
        sign = -1.0 if name == PEAK else 1.0
        best = Smallest(np.nan, found[0].at, "", float(found[0].times[0]), np.inf)
        for m in found:
            values = getattr(m, name)
            some = np.flatnonzero(~np.isnan(values))
            if not some.size:
                continue
            i, k = (int(x) for x in np.unravel_index(some[np.argmin(sign * values.ravel()[some])], values.shape))
            value = float(values[i, k])
            if np.isnan(best.value) or sign * value < sign * best.value - CLOSE * min(abs(value), abs(best.value)):
                best = Smallest(value, m.at, m.channels[k], float(m.times[i]), float(m.crossover[i, k]))
        out[name] = best
    return out
