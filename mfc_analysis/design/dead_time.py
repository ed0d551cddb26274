"""A loop over its dead time: growth of the exact roots at many dead times, and maps of dead time x a second quantity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.stability import growth
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop


@dataclass(frozen=True, eq=False)
class DelayMap:
    """Growth of a loop over dead time and a second quantity."""

    delays: Array  #: (d,) [s]
    values: Array  #: (g,) of the second quantity
    growth: Array  #: (g, d) [1/s] largest real part of the roots that are not at zero; negative: stable

    @property
    def stable(self) -> Bools:
        """(g, d)."""
        return np.asarray(self.growth < 0)


def over_delay(loop: ClosedLoop, delays: ArrayLike, time: float = 0.0) -> Array:
    """(d,) [1/s] largest real part of the exact roots that are not at zero, for each dead time of the actuators in place of the given one.

    Args:
        loop: a continuous loop. delays: (d,) [s] > 0. time: [s] on the reference.

    The dead time of the force sensor is kept. Raises BadArgument for dead times that are not positive, Unsupported for a sampled loop.
    """
    T = checks.array("delays", np.atleast_1d(np.asarray(delays)), (None,), "dead times > 0 [s]")
    if np.any(T <= 0):
        raise BadArgument("delays", delays, "dead times > 0 [s]")
    hardware = loop.hardware or Hardware()
    if hardware.sample_time is not None:
        raise Unsupported("hardware.sample_time", hardware.sample_time, "a continuous loop: the poles of a sampled loop include its dead time")
    late = replace(loop, hardware=replace(hardware, delay=1.0))
    opened = late.linearize([time]).opened
    where = opened.wires[late.equations.actuator]
    out = np.empty(T.size)
    for i, each in enumerate(T):
        waits = opened.wire_delay.copy()
        waits[where] = each
        out[i] = growth(replace(opened, wire_delay=waits))[0]
    return out


def delay_map(make_loop: Callable[[float], ClosedLoop], delays: ArrayLike, values: ArrayLike) -> DelayMap:
    """The loop ``make_loop(value)`` over dead time x values, one linearisation for each value.

    Args:
        make_loop: value (a bandwidth, a gain, a payload) -> loop. delays: (d,) [s] > 0. values: (g,).

    Raises as ``over_delay``.
    """
    at = checks.array("values", values, (None,))
    T = checks.array("delays", delays, (None,), "dead times > 0 [s]")
    return DelayMap(T, at, np.stack([over_delay(make_loop(float(v)), T) for v in at]))
