"""One-sided contact in a run: the axes that are touched, and the events at which this changes. Between two events the equations have no jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array

LEAST = 1e-9  #: [N, Nm] elastic force at which an axis is touched (softer than 1 N/m: at this depth [m, rad]); the lift is at 0


@dataclass(frozen=True, eq=False)
class Event:
    """Contact with a surface made or lost: its penetration along an axis passes 0."""

    time: float  #: [s]
    kind: str  #: "touch" or "lift"
    surface: int  #: index in the list of environments
    axis: str  #: direction of its compliance frame


class Touching:
    """The axes of the surfaces that are touched, from the state at the start of a run on."""

    def __init__(self, e: Equations, x: Array) -> None:
        self.e = e
        self.watched = [(i, j, name) for i, s in enumerate(e.surfaces) if s.one_sided for j, name in zip(s.index, s.axis_names, strict=True)]
        self.least = np.array([LEAST * min(1.0, float(e.surfaces[i].K[j, j]) or 1.0) for i, j, _ in self.watched])
        self.axes = [np.zeros(6, bool) for _ in e.surfaces]  #: (6,) of each surface: is the axis touched
        for (i, j, _), pressed in zip(self.watched, self._elastic(x) > self.least, strict=True):
            self.axes[i][j] = pressed

    def _elastic(self, x: Array) -> Array:
        """(watched axes,) elastic forces."""
        found = self.e.touch(self.e.split(x)).elastic
        return np.array([found[i][j] for i, j, _ in self.watched])

    def _left(self, x: Array) -> Array:
        """(watched axes,) how far the elastic force is from the next event; it falls to 0 there. inf where it has none: the rates say why."""
        try:
            elastic = self._elastic(x)
        except MfcError:
            return np.full(len(self.watched), np.inf)
        return np.where([self.axes[i][j] for i, j, _ in self.watched], elastic, self.least - elastic)

    def change(self) -> Callable[[float, Array], float]:
        """The event function of ``solve_ivp``, until the next change.

        solve_ivp takes its signs at the steps, and searches on the dense output, which differs from the steps by the tolerance: at the
        steps this function keeps to its first value.
        """
        steps: dict[float, float] = {}

        def left(t: float, x: Array) -> float:
            if t not in steps:
                found = float(self._left(x).min())
                if steps and t < max(steps):
                    return found
                steps[t] = found
                if len(steps) > 2:
                    del steps[min(steps)]
            return steps[t]

        left.terminal, left.direction = True, -1  # type: ignore[attr-defined]  # solve_ivp reads them there
        return left

    def switch(self, t: float, x: Array) -> list[Event]:
        """The events at (t, x), where ``change`` has found one; from here on their axes are touched or not."""
        left = self._left(x)
        events = []
        for k in np.flatnonzero((left <= max(0.0, float(left.min()))) & np.isfinite(left)):
            i, j, name = self.watched[k]
            self.axes[i][j] = not self.axes[i][j]
            events.append(Event(t, "touch" if self.axes[i][j] else "lift", i, name))
        return events
