"""What each imperfection of a loop costs: lag, dead time, sampling, filter, payload, friction, flexibility, one at a time and together.

The ideal loop is the one given without them all. A payload or friction that is off is off in the plant and in the controller's model; what
the model then still has wrong is the imperfection "model error". Each is switched on alone in the ideal loop, and off alone in the loop given;
the two costs differ, and the first ones do not add up, where imperfections interact.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.design.searches import shown
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import table
from mfc_analysis.requirements.evidence import Evidence, Found
from mfc_analysis.requirements.requirements import KINDS, Requirements
from mfc_analysis.robots.robot import Robot

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

USUAL = ("phase_deg", "gain_increase_db", "delay", "sensitivity_peak")  #: metrics where no requirement is set
SAID = "cost of each alone (in brackets: on top of all the others); positive: worse"
SAME = 1e-9  #: relative difference of two mass matrices or torques that is rounding

FIELDS: dict[str, tuple[str, ...]] = {
    "lag": ("torque_lag", "velocity_lag"),
    "dead time": ("delay", "force_delay"),
    "sampling": ("sample_time",),
    "filter": ("velocity_filter", "force_filter"),
    "flexibility": ("joint_stiffness", "joint_damping", "motor_inertia"),
    "torque limit": ("torque_limit",),
    "servo": ("servo",),
    "velocity limit": ("velocity_limit",),
    "force sensor": ("force_limit", "force_deadband"),
}  #: imperfection -> fields of ``Hardware``


@dataclass(frozen=True, eq=False)
class Attribution:
    """The metrics of a loop with f imperfections: ideal, with each alone, with all but each, and with all. k metrics; NaN: not defined."""

    metrics: tuple[str, ...]  #: (k,) fields of ``Requirements``
    factors: tuple[str, ...]  #: (f,) imperfections that the loop has
    ideal: Array  #: (k,) without any of them
    given: Array  #: (k,) with all: the loop itself
    alone: Array  #: (f, k) with only this one
    without: Array  #: (f, k) with all but this one
    place: tuple[str, ...]  #: (k,) joint or channel of the worst value of the loop given
    when: tuple[float | None, ...]  #: (k,) [s] of it
    ends: tuple[str, str] = ("ideal", "as given")  #: the loop without any and with all of them, in words

    @property
    def shown(self) -> int:
        """Index of the metric to draw: the phase margin, or the first whose joint cost is finite."""
        finite = [i for i, cost in enumerate(self.joint) if np.isfinite(cost)]
        return self.metrics.index("phase_deg") if "phase_deg" in self.metrics else (finite or [0])[0]

    @property
    def first(self) -> Array:
        """(f, k) cost of each on top of the ideal loop, in the unit of the metric; positive: worse."""
        return self._cost(self.ideal, self.alone)

    @property
    def last(self) -> Array:
        """(f, k) cost of each on top of all the others."""
        return self._cost(self.without, self.given)

    @property
    def sum(self) -> Array:
        """(k,) sum of the costs ``first``."""
        return np.asarray(self.first.sum(axis=0))

    @property
    def joint(self) -> Array:
        """(k,) cost of all of them together."""
        return self._cost(self.ideal, self.given)

    def _cost(self, before: Array, after: Array) -> Array:
        sign = np.array([1.0 if KINDS[name].least else -1.0 for name in self.metrics])
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(np.isinf(before) & (before == after), 0.0, sign * (before - after)))

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of cells: the metric, ideal, the cost of each alone (and on top of the others), their sum, the joint cost, as given."""
        first, last = self.first, self.last
        out: list[tuple[str, ...]] = [
            ("", *(f"{KINDS[name].label} {f'[{KINDS[name].unit}]' if KINDS[name].unit else ''}".strip() for name in self.metrics))
        ]
        out.append((self.ends[0], *map(_said, self.ideal)))
        out += [(name, *(f"{_cost(a)} ({_cost(b)})" for a, b in zip(first[i], last[i], strict=True))) for i, name in enumerate(self.factors)]
        out += [("sum, each alone", *map(_cost, self.sum)), ("all together", *map(_cost, self.joint)), (self.ends[1], *map(_said, self.given))]
        return out

    def plot(self, metric: str | None = None, *, ax: Axes | None = None) -> Axes:
        """Bars of the costs in one metric: of each imperfection alone, of each on top of all the others, and of all together.

        ``metric``: one of ``metrics``; None: ``shown``. ``ax``: to draw in; None: a new figure of pyplot. Raises BadArgument.
        """
        from mfc_analysis import plots

        k = self.shown if metric is None else self.metrics.index(checks.choice("metric", metric, self.metrics))
        kind, together = KINDS[self.metrics[k]], float(self.joint[k])
        label, title = f"cost [{kind.unit}]" if kind.unit else "cost", f"Where the {kind.label} went"
        return plots.costs(self.factors, self.first[:, k], self.last[:, k], together, xlabel=label, title=title, ax=plots.shown("costs", ax)[0])

    def _repr_html_(self) -> str:
        head, *rows = self.rows()
        return table(f"{SAID[:1].upper()}{SAID[1:]}", head, rows)

    def __str__(self) -> str:
        rows = self.rows()
        wide = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        return "\n".join([SAID] + ["  " + "  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)).rstrip() for row in rows])

    __repr__ = __str__


def _said(x: float) -> str:
    return "undefined" if np.isnan(x) else "no limit" if np.isinf(x) else f"{0.0 if abs(x) < 1e-12 else x:.4g}"


def _cost(x: float) -> str:
    return "infinite" if np.isinf(x) else _said(x)


def attribute(
    loop: ClosedLoop, requirements: Requirements | None = None, times: ArrayLike = (0.0,), *, at: str | None = None, progress: bool = False
) -> Attribution:
    """What each imperfection of a loop costs in each metric that is required (without any: phase, gain and delay margin, sensitivity peak).

    Args:
        loop: as given. requirements: whose metrics count. times: (m,) [s]. at: analysis point; None: the plant input.
        progress: a bar on the terminal.

    Raises BadArgument, UnknownPoint for ``at``.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    asked = Requirements() if requirements is None else requirements
    checks.instance("requirements", asked, Requirements, "a Requirements, such as mfc.Requirements(phase_deg=45)")
    t = checks.times(times)
    return attributed(lambda on: with_imperfections(loop, on), imperfections(loop), asked, t, at, progress=progress)


def attributed(
    make: Callable[[Collection[str]], ClosedLoop], factors: tuple[str, ...], asked: Requirements, times: Array, at: str | None,
    ends: tuple[str, str] = ("ideal", "as given"), *, progress: bool = False,
) -> Attribution:  # fmt: skip
    """The attribution of a loop as a function of the factors that are on, such as the changes between two loops."""
    metrics = tuple(asked.asked()) or USUAL
    with shown(progress, "imperfections") as tick:

        def found(on: Collection[str]) -> list[Found]:
            tick(len(on))
            evidence = Evidence(make(on).equations, times, at, asked.horizon, asked.step)
            return [evidence.found(name) for name in metrics]

        given = found(factors)
        ideal = found(()) if factors else given
        alone = [found((name,)) for name in factors] if len(factors) > 1 else [given] * len(factors)
        without = [found([other for other in factors if other != name]) for name in factors] if len(factors) > 1 else [ideal] * len(factors)

    def values(rows: list[list[Found]]) -> Array:
        return np.array([[one.value for one in row] for row in rows], float).reshape(len(rows), len(metrics))

    return Attribution(
        metrics, factors, values([ideal])[0], values([given])[0], values(alone), values(without),
        tuple(one.where for one in given), tuple(one.when for one in given), ends,
    )  # fmt: skip


def imperfections(loop: ClosedLoop) -> tuple[str, ...]:
    """The imperfections that a loop has, of the hardware and then of the arm."""
    hardware = loop.hardware or Hardware()
    plant, model = loop.robot, loop.equations.model
    both = (plant, model)
    there = [name for name, fields in FIELDS.items() if any(getattr(hardware, field) is not None for field in fields)]
    if loop.law.plant == "velocity":  # q' is what is commanded: no dynamics
        return tuple(there)
    there += ["payload"] if any(p.mass for robot in both for p in robot.payloads) else []
    there += ["friction"] if any(robot.viscous.any() or robot.coulomb.any() for robot in both) else []
    return (*there, *(["model error"] if model is not plant and _differ(_bare(plant), _bare(model), loop.nominal([0.0]).q[0]) else []))


def with_imperfections(loop: ClosedLoop, on: Collection[str]) -> ClosedLoop:
    """The loop with only these of its imperfections; the loop itself with all of them."""
    off = [name for name in imperfections(loop) if name not in on]
    if not off:
        return loop
    hardware = loop.hardware or Hardware()
    if "sampling" in off:
        hardware = hardware.every(None)
    none: dict[str, Any] = {field: None for name in off if name in FIELDS for field in FIELDS[name]}
    hardware = replace(hardware, **none)
    plant, model = loop.robot, loop.equations.model
    if "model error" in off:
        model = _bare(plant).with_friction(model.viscous, model.coulomb, model.coulomb_speed) if model is not plant else plant
        for p in loop.equations.model.payloads:
            model = model.with_payload(p.mass, p.com, p.inertia)
    changes: list[Callable[[Robot], Robot]] = []
    if "payload" in off:
        changes.append(lambda robot: robot.with_payloads_scaled(0.0))
    if "friction" in off:
        changes.append(lambda robot: robot.with_friction(0.0, 0.0))
    same = model is plant
    for change in changes:
        plant = change(plant)
        model = plant if same else change(model)
    return replace(loop, robot=plant, controller_model=model, hardware=hardware)


def _bare(robot: Robot) -> Robot:
    """The robot without payload and friction."""
    return robot.with_payloads_scaled(0.0).with_friction(0.0, 0.0)


def _differ(a: Robot, b: Robot, q: Array) -> bool:
    pairs = ((a.mass(q), b.mass(q)), (a.gravity(q), b.gravity(q)))
    return any(np.abs(x - y).max() > SAME * np.abs(x).max(initial=1e-12) for x, y in pairs)
