r"""A force loop over the stiffness of its environment: poles, verdicts and margins at many stiffnesses at once.

A surface whose force is ``preload`` at the operating point enters the linear loop by its stiffness alone, and linearly: A, B, C, D of the
opened loop at any stiffness follow from those at two stiffnesses. Two linearisations therefore serve any number of stiffnesses, and the
analysis runs on all of them as one batch. The operating point does not change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.spectrum import poles as poles_of
from mfc_analysis.analysis.stability import Stability, growth, stability
from mfc_analysis.analysis.system import HORIZON, OpenSystem, without_idle
from mfc_analysis.dynamics.environment import STIFFEST, stiffened
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.plots.figure import Axes


_APART = (1e3, 2e3)  #: [N/m] the two stiffnesses that are linearised: of a typical order, so that rounding stays small


@dataclass(frozen=True, eq=False)
class StiffnessSweep(Shown):
    """One loop at k stiffnesses; nothing else changes."""

    stiffness: Array  #: (k,) [N/m, Nm/rad]
    opened: OpenSystem  #: the loop with every wire cut; its m points are the stiffnesses

    def __str__(self) -> str:
        k, lost = self.stiffness, self.stiffness[~self.stable]
        first = f", not at {lost[0]:.4g} N/m first" if lost.size else ""
        return f"{len(k)} stiffnesses from {k.min():.4g} to {k.max():.4g} N/m: stable at {int(self.stable.sum())}{first}"

    __repr__ = __str__

    @cached_property
    def poles(self) -> Complex:
        """(k, nx) closed-loop poles [1/s], slowest first; dead time left out."""
        return poles_of(self.opened)

    @cached_property
    def stability(self) -> Stability:
        """The verdict over the horizon at each stiffness, dead time included."""
        return stability(without_idle(self.opened))

    @property
    def stable(self) -> Bools:
        """(k,) True where the roots that are not slow decay, dead time included; False where every root is slow."""
        return self.stability.nonzero_stable

    @cached_property
    def growth(self) -> Array:
        """(k,) [1/s] largest real part of the roots that are not slow, dead time included; ln|z| / dt for a sampled loop; NaN: every root is slow."""
        return growth(self.opened)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The growth of the slowest root that counts, over stiffness: unstable above 0. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        x, y = "stiffness [N/m]", "largest real part of the roots [1/s]"
        return plots.curves(self.stiffness, [("", self.growth)], xlabel=x, ylabel=y, log="x", limit=0.0, ax=plots.shown("map", ax)[0])

    def margins(self, at: str = "force") -> Margins:
        """Margins at each stiffness: (k, n) metrics. Raises UnknownPoint."""
        from mfc_analysis.analysis.margins import margins

        return margins(self.opened, at, self.stability if self.opened.delayed else None)


def over_stiffness(loop: ClosedLoop, stiffness: ArrayLike, time: float = 0.0, *, horizon: float = HORIZON) -> StiffnessSweep:
    """The loop at k stiffnesses of every surface that has a preload; surfaces without one do not change.

    Args:
        loop: a torque loop in contact. stiffness: (k,) [N/m, Nm/rad] > 0, to which those surfaces are scaled.
        time: [s] on the reference; this operating point and its force are kept.
        horizon: [s] of the verdict: roots with abs(s) < 1/horizon are slow.

    Raises:
        BadArgument: no surface with a preload, stiffnesses that are not positive, a horizon below 1e-6 s or two sample times.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    takes = f"stiffnesses > 0, up to {STIFFEST:g} N/m"
    k = checks.vector("stiffness", stiffness, takes)
    if np.any(k <= 0) or np.any(k > STIFFEST):
        raise BadArgument("stiffness", stiffness, takes)
    return _line(loop, time, horizon)(k)


def _line(loop: ClosedLoop, time: float, horizon: float) -> Callable[[Array], StiffnessSweep]:
    """Stiffnesses (k,) -> the loop at these, from two linearisations made once."""
    first = at_stiffness(loop, _APART[0], time).linearize([time], horizon=horizon)
    one, two = first.opened, at_stiffness(loop, _APART[1], time).linearize([time], coordinates=first.coordinates).opened

    def swept(k: Array) -> StiffnessSweep:
        part = ((k - _APART[0]) / (_APART[1] - _APART[0]))[:, None, None]
        A, B, C, D = (np.asarray(x + part * (y - x)) for x, y in ((one.A, two.A), (one.B, two.B), (one.C, two.C), (one.D, two.D)))
        return StiffnessSweep(k, replace(one, times=np.full(len(k), float(time)), A=A, B=B, C=C, D=D))

    return swept


def at_stiffness(loop: ClosedLoop, stiffness: float, time: float = 0.0) -> ClosedLoop:
    """The same loop with another stiffness [N/m] of every surface that has a preload, and the same force on the reference at ``time``.

    Raises BadArgument where no surface has a preload.
    """
    surfaces = loop.equations.surfaces
    if not any(s.f0.any() for s in surfaces):
        raise BadArgument("environment", surfaces, "a surface with a preload, whose stiffness is varied")
    X = loop.robot.pose(loop.nominal([time]).q[0])
    return replace(loop, environment=[stiffened(s, stiffness, X) if s.f0.any() else s for s in surfaces])


@dataclass(frozen=True, eq=False)
class StabilityMap(Shown):
    """Growth of a loop over stiffness and a second quantity."""

    stiffness: Array  #: (k,) [N/m]
    values: Array  #: (g,) of the second quantity
    growth: Array  #: (g, k) [1/s] largest real part of the roots that are not slow; negative: stable; NaN: every root is slow, not stable

    def __str__(self) -> str:
        k, v = self.stiffness, self.values
        size = f"{k.size} stiffnesses from {k.min():.4g} to {k.max():.4g} N/m x {v.size} values from {v.min():.4g} to {v.max():.4g}"
        return f"stability map of {size}: stable at {int(self.stable.sum())} of {self.growth.size} points"

    __repr__ = __str__

    @property
    def stable(self) -> Bools:
        """(g, k)."""
        return np.asarray(self.growth < 0)

    def plot(self, ylabel: str = "value", *, ax: Axes | None = None) -> Axes:
        """The region of stability; ``ylabel``: the second quantity, with its unit. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        axes = plots.shown("map", ax)[0]
        return plots.stability_map(
            self.stiffness,
            self.values,
            self.growth,
            xlabel="stiffness [N/m]",
            ylabel=ylabel,
            log=plots.log_axes(self.stiffness, self.values),
            ax=axes,
        )

    def boundary(self) -> Array:
        """(g,) [N/m] the lowest stiffness at which the loop loses stability, interpolated; inf: nowhere; NaN: unstable at the first stiffness."""
        out = np.full(len(self.values), np.inf)
        for i, row in enumerate(self.growth):
            lost = np.flatnonzero((row[:-1] < 0) & ~(row[1:] < 0))
            if lost.size:
                j = int(lost[0])
                a, b = np.arcsinh(row[j]), np.arcsinh(np.nan_to_num(row[j + 1]))
                log = np.log(self.stiffness[j : j + 2])
                out[i] = np.exp(log[0] + (log[1] - log[0]) * a / (a - b))
            elif not row[0] < 0:
                out[i] = np.nan
        return out


def stiffness_map(
    make_loop: Callable[[float], ClosedLoop], stiffness: ArrayLike, values: Sequence[float] | Array, *, horizon: float = HORIZON
) -> StabilityMap:
    """The loop ``make_loop(value)`` over stiffness x values: two linearisations for each value, for any number of stiffnesses.

    Args:
        make_loop: value (a gain, a lag, a dead time) -> loop in contact. stiffness: (k,) [N/m]. values: (g,). horizon: [s] of the verdict.

    Raises the errors of ``over_stiffness``.
    """
    at, k = checks.vector("values", values), checks.vector("stiffness", stiffness)
    if at.size == 0:
        raise BadArgument("values", values, "at least one value")
    return StabilityMap(k, at, np.stack([over_stiffness(make_loop(float(v)), k, horizon=horizon).growth for v in at]))


def stable_up_to(loop: ClosedLoop, upper: float = 1e6, lower: float = 1.0, *, horizon: float = HORIZON) -> float:
    """[N/m] the lowest stiffness in (lower, upper) at which the loop loses stability, to a relative 1e-6.

    inf: stable throughout; NaN: unstable at ``lower``. Checks exact stability over ``horizon`` [s], dead time included, at 20 stiffnesses and
    then between two of them; a narrower window of instability can be missed. As ``design.max_stiffness``, in a tenth of its time.
    Raises the errors of ``over_stiffness``.
    """
    low, high = (checks.number(name, x, low=0.0, high=STIFFEST, strict=True) for name, x in (("lower", lower), ("upper", upper)))
    swept, grid = _line(loop, 0.0, horizon), np.geomspace(low, high, 20)
    stable = swept(grid).stable
    if not stable[0]:
        return float("nan")
    if stable.all():
        return float("inf")
    j = int(np.argmin(stable))
    low, high = float(grid[j - 1]), float(grid[j])
    while high / low - 1 > 1e-6:
        inner = np.geomspace(low, high, 5)[1:-1]
        j = int(np.argmin([*swept(inner).stable, False]))
        low, high = (low, *inner)[j], (*inner, high)[j]
    return float(np.sqrt(low * high))
