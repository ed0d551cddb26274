"""A loop over its dead time: growth of the exact roots at many dead times, and maps of dead time x a second quantity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.stability import growth, stability
from mfc_analysis.analysis.system import HORIZON, OpenSystem
from mfc_analysis.dynamics.hardware import LONGEST, SHORTEST, Hardware
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes


@dataclass(frozen=True, eq=False)
class DelayMap(Shown):
    """Growth of a loop over dead time and a second quantity."""

    delays: Array  #: (d,) [s]
    values: Array  #: (g,) of the second quantity
    growth: Array  #: (g, d) [1/s] largest real part of the roots that are not slow; negative: stable

    def __str__(self) -> str:
        T, v = self.delays, self.values
        size = f"{T.size} dead times from {T.min():.4g} to {T.max():.4g} s x {v.size} values from {v.min():.4g} to {v.max():.4g}"
        return f"stability map of {size}: stable at {int(self.stable.sum())} of {self.growth.size} points"

    __repr__ = __str__

    @property
    def stable(self) -> Bools:
        """(g, d)."""
        return np.asarray(self.growth < 0)

    def plot(self, ylabel: str = "value", *, ax: Axes | None = None) -> Axes:
        """The region of stability; ``ylabel``: the second quantity, with its unit. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        axes, log = plots.shown("map", ax)[0], plots.log_axes(self.delays, self.values)
        return plots.stability_map(self.delays, self.values, self.growth, xlabel="dead time [s]", ylabel=ylabel, log=log, ax=axes)


def over_delay(loop: ClosedLoop, delays: ArrayLike, time: float = 0.0, *, horizon: float = HORIZON) -> Array:
    """(d,) [1/s] largest real part of the exact roots that are not slow, for each dead time of the actuators in place of the given one.

    Args:
        loop: a continuous loop. delays: (d,) [s], 1e-9 to 1e9. time: [s] on the reference. horizon: [s] of the verdict: roots with
            abs(s) < 1/horizon are slow.

    The dead times of the force sensor and of a servo are kept. Raises BadArgument for other dead times, a horizon below 1e-6 s or
    below a twentieth of a dead time, Unsupported for a sampled loop.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    takes = f"dead times from {SHORTEST:g} to {LONGEST:g} s"
    T = checks.vector("delays", delays, takes)
    if np.any(T < SHORTEST) or np.any(T > LONGEST):
        raise BadArgument("delays", delays, takes)
    hardware = loop.hardware or Hardware()
    if hardware.sample_time is not None:
        raise Unsupported("hardware.sample_time", hardware.sample_time, "a continuous loop: the poles of a sampled loop include its dead time")
    return growth(_late(loop, [time], horizon)(T))


def stable_over_delay(loop: ClosedLoop, times: ArrayLike, horizon: float) -> Callable[[Sequence[float]], list[bool]]:
    """Dead times [s] of the actuators, as in ``over_delay`` -> for each, whether all roots that are not slow are stable at all m ``times`` [s]."""
    late = cache(lambda: _late(loop, times, horizon))

    def judged(delays: Sequence[float]) -> list[bool]:
        found = stability(late()(np.asarray(delays, float))).nonzero_stable.reshape(len(delays), -1)
        return [bool(each.all()) for each in found]

    return judged


def _late(loop: ClosedLoop, times: ArrayLike, horizon: float) -> Callable[[Array], OpenSystem]:
    """Dead times (d,) [s] of the actuators -> the loop with every wire cut at m ``times`` [s]: d m points, those of the first dead time first."""
    hardware = loop.hardware or Hardware()
    late, own = replace(loop, hardware=replace(hardware, delay=1.0)), replace(hardware, delay=None).command_delay
    opened = late.linearize(times, horizon=horizon).opened
    where, m = opened.wires[late.equations.actuator], len(opened.times)

    def at(T: Array) -> OpenSystem:
        waits = np.tile(opened.wire_delay, (T.size * m, 1))
        waits[:, where] = np.repeat(T + own, m)[:, None]
        return replace(opened.at(np.tile(np.arange(m), T.size)), wire_delay=waits)

    return at


def delay_map(make_loop: Callable[[float], ClosedLoop], delays: ArrayLike, values: ArrayLike, *, horizon: float = HORIZON) -> DelayMap:
    """The loop ``make_loop(value)`` over dead time x values, one linearisation for each value.

    Args:
        make_loop: value (a bandwidth, a gain, a payload) -> loop. delays: (d,) [s] > 0. values: (g,). horizon: [s] of the verdict.

    Raises the errors of ``over_delay``.
    """
    at, T = checks.vector("values", values), checks.vector("delays", delays)
    if at.size == 0:
        raise BadArgument("values", values, "at least one value")
    return DelayMap(T, at, np.stack([over_delay(make_loop(float(v)), T, horizon=horizon) for v in at]))
