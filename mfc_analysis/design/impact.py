r"""Touching a surface at speed: peak force, bounces and time to settle, by simulation of the one-sided contact.

Each run starts a microsecond before the touch: the tool is at the surface and moves along its normal at the given speed, and does not turn; the
law's integral is at its value in free motion, the force integral at 0, an actuator lag at the torque commanded there. The reference is that
of the loop: a force law presses on, a motion law goes on to its reference behind the surface.

A mass m that meets an elastic surface k at speed v feels at most v sqrt(k m).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.stability import growth
from mfc_analysis.design.limits import with_stiffness
from mfc_analysis.design.sweeps import evaluated
from mfc_analysis.dynamics.environment import STIFFEST
from mfc_analysis.dynamics.equations import Equations, solve_command_for_slots
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.dynamics.start_state import start_state
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.dual import Dual, value
from mfc_analysis.simulation.simulation import Simulation, simulate

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

BEFORE = 1e-6  #: [s] before the touch at which a run starts
FASTEST = 100.0  #: [m/s]
BAND = 0.05  #: settled: the force stays within this part of its last value
LAST = 0.8  #: of the run, after which a force that still leaves the band has not settled
SAMPLES = 1001  #: of the force of each run
SHORTEST, LONGEST = 0.05, 10.0  #: [s] of a run whose duration is not given
UNSTABLE = 2.0  #: [s] of one where no root in contact decays
DECAYS = 12.0  #: time constants of the slowest root in such a run
FINE = 400  #: times at which the force is looked at in each contact, geometrically and evenly spaced each
QUANTITIES = {"peak": "peak force [N]", "bounces": "bounces [-]", "settling": "time to settle [s]"}


@dataclass(frozen=True, eq=False)
class Impact:
    """Touching a surface at g stiffnesses and k speeds. NaN (bounces: -1) where a run could not be made, see ``failed``."""

    stiffness: Array  #: (g,) [N/m] of the surface along its normal
    speeds: Array  #: (k,) [m/s] along the normal at the touch
    peak: Array  #: (g, k) [N] largest force along the normal
    bounces: Ints  #: (g, k) times the tool left the surface
    settling: Array  #: (g, k) [s] from the touch until the force stays within 5 % of its last value; NaN: not in the run, or not in contact
    last: Array  #: (g, k) [N] force at the end of the run
    times: Array  #: (n,) [s] of ``force``, from the start of the run
    force: Array  #: (g, k, n) [N] along the normal
    failed: Mapping[tuple[int, int], str] = field(default_factory=dict)  #: runs that could not be made, or did not reach their end, with the reason

    def worst(self) -> tuple[int, int]:
        """Place in the map of the largest peak force."""
        i, j = np.unravel_index(int(np.argmax(np.nan_to_num(self.peak, nan=-1.0))), self.peak.shape)
        return int(i), int(j)

    def __str__(self) -> str:
        g, k = self.peak.shape
        i, j = self.worst()
        stiff = f"{self.stiffness[0]:.4g} N/m" if g == 1 else f"{g} stiffnesses from {self.stiffness.min():.4g} to {self.stiffness.max():.4g} N/m"
        fast = f"{self.speeds[0]:.4g} m/s" if k == 1 else f"{k} speeds from {self.speeds.min():.4g} to {self.speeds.max():.4g} m/s"
        where = "" if g == k == 1 else f" at {self.stiffness[i]:.4g} N/m and {self.speeds[j]:.4g} m/s"
        lost, loose = len(self.failed), int(np.isnan(self.settling).sum())
        slowest = "" if loose == self.peak.size else f", within {np.nanmax(self.settling):.4g} s"
        settles = f"; settles in {self.peak.size - loose} of {self.peak.size} runs{slowest}"
        failed = f"; {lost} runs did not reach their end" if lost else ""
        return f"impact at {fast} on {stiff}: peak force {self.peak[i, j]:.4g} N{where}, at most {self.bounces.max()} bounces{settles}{failed}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        rows = []
        for i, stiff in enumerate(self.stiffness):
            for j, fast in enumerate(self.speeds):
                settling = "not settled" if np.isnan(self.settling[i, j]) else f"{self.settling[i, j]:.4g}"
                rows.append((f"{stiff:.4g}", f"{fast:.4g}", f"{self.peak[i, j]:.4g}", f"{self.bounces[i, j]}", settling, f"{self.last[i, j]:.4g}"))
        heads = ("stiffness [N/m]", "speed [m/s]", "peak force [N]", "bounces", "settles in [s]", "last force [N]")
        notes = [f"{self.stiffness[i]:.4g} N/m, {self.speeds[j]:.4g} m/s: {why}" for (i, j), why in self.failed.items()]
        return table(str(self), heads, rows, notes)

    def plot(self, quantity: str = "peak", *, ax: Axes | None = None) -> Axes:
        """The map: a quantity over speed, a curve for each stiffness; over stiffness where there is one speed. Of one run its force over time.

        ``quantity``: "peak", "bounces" or "settling". ``ax``: to draw in; None: a new figure of pyplot. Raises UnknownName.
        """
        from mfc_analysis import plots

        if quantity not in QUANTITIES:
            raise UnknownName("quantity", quantity, QUANTITIES)
        if self.peak.size == 1:
            panel = plots.Panel("force [N]", self.force[0, 0])
            title = f"Impact at {self.speeds[0]:.4g} m/s on {self.stiffness[0]:.4g} N/m"
            return plots.traces(self.times, (panel,), title=title, axes=plots.shown("time history", ax))[0]
        values = np.asarray(getattr(self, quantity), float)
        if self.speeds.size == 1:
            x, xlabel, series = self.stiffness, "stiffness [N/m]", [("", values[:, 0])]
        else:
            some = np.unique(np.linspace(0, self.stiffness.size - 1, 8).round().astype(int))
            x, xlabel = self.speeds, "speed [m/s]"
            series = [(f"{self.stiffness[i]:.3g} N/m", values[i]) for i in some]
        log = "x" if x.min() > 0 and x.max() > 10 * x.min() else ""
        log += "y" if quantity == "peak" and np.nanmin(values) > 0 and np.nanmax(values) > 10 * np.nanmin(values) else ""
        return plots.curves(x, series, xlabel=xlabel, ylabel=QUANTITIES[quantity], log=log, title="Impact", ax=plots.shown("map", ax)[0])


def impact(
    loop: ClosedLoop,
    speeds: ArrayLike,
    stiffness: ArrayLike | None = None,
    *,
    duration: float | None = None,
    max_evaluations: int | None = None,
    progress: bool = False,
    n_jobs: int | None = None,
) -> Impact:
    """Simulates the touch of a one-sided surface at each speed, on each stiffness.

    Args:
        loop: with exactly one one-sided surface that has a translation; its normal is the axis with a preload, else the first one. A law with
            velocity inputs, such as ``Admittance``, commands the speed at the touch, and its drives have it.
        speeds: (k,) [m/s] > 0 of the tool along the normal at the touch. stiffness: (g,) [N/m] > 0 of the surface, as ``max_stiffness`` varies
            it, the force at the reference kept; None: its own.
        duration: [s] of each run; None: 12 time constants of the slowest root in contact on the softest surface, 0.05 to 10 s.
        max_evaluations: of each run, as ``ClosedLoop.simulate``.
        progress: a bar on the terminal. n_jobs: processes, as in ``sweep``.

    Raises BadArgument: no such surface, an arm that cannot move along its normal, or a velocity law whose command is not set by a state of its own.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    v = _positive("speeds", speeds, FASTEST, "m/s")
    surface, axis = _touched(loop)
    own = float(loop.equations.surfaces[surface].K[axis, axis])
    if stiffness is None and not own > 0:
        raise BadArgument("environment", loop.equations.surfaces[surface], "a surface that is stiff along its normal, or stiffness=")
    k = np.array([own]) if stiffness is None else _positive("stiffness", stiffness, STIFFEST, "N/m")
    stiffer = None if stiffness is None else with_stiffness(loop)[0]

    def made(stiffness: float) -> ClosedLoop:
        return loop if stiffer is None else stiffer(stiffness)

    def case(stiffness: float, speed: float) -> tuple[ClosedLoop, float]:
        return made(stiffness), speed

    end = _duration(made(float(k.min()))) if duration is None else checks.number("duration", duration, low=1e-4, high=1e4)
    at_the_touch(made(float(k[0])), surface, axis, float(v[0]))  # what no speed or stiffness mends raises here
    times = np.linspace(0.0, end, SAMPLES)
    measure = partial(_measured, surface=surface, axis=axis, times=times, max_evaluations=max_evaluations)
    done = evaluated(case, {"stiffness": k.tolist(), "speed": v.tolist()}, measure, n_jobs, progress, "impact")
    shape, failed = (k.size, v.size), {}
    found: dict[str, Array] = {name: np.full(shape, np.nan) for name in ("peak", "bounces", "settling", "last", "scale")}
    found["force"] = np.full((*shape, times.size), np.nan)
    for where, (run, error) in zip(np.ndindex(shape), done, strict=True):
        if run is not None:
            for name, values in found.items():
                values[where] = run[name]
            error = str(run["message"])
        if error:
            failed[where] = error
    along = found["scale"][:, 0] if not np.isnan(found["scale"][:, 0]).any() else k
    bounces = np.nan_to_num(found["bounces"], nan=-1).astype(np.int64)
    return Impact(along, v, found["peak"], bounces, found["settling"], found["last"], times, found["force"], failed)


def _positive(argument: str, given: ArrayLike, high: float, unit: str) -> Array:
    takes = f"numbers > 0, up to {high:g} {unit}"
    out = checks.vector(argument, given, takes)
    if not out.size or np.any(out <= 0) or np.any(out > high):
        raise BadArgument(argument, given, takes)
    return out


def _touched(loop: ClosedLoop) -> tuple[int, int]:
    """The surface, and the axis of its compliance frame, that is touched."""
    some = [i for i, s in enumerate(loop.equations.surfaces) if s.one_sided and min(s.index) < 3]
    if len(some) != 1:
        takes = "a loop with exactly one surface of mfc.Environment(..., one_sided=True) that has a translation"
        raise BadArgument("loop", f"{len(some)} of them", takes)
    surface = loop.equations.surfaces[some[0]]
    moves = [j for j in surface.index if j < 3]
    return some[0], max(moves, key=lambda j: (abs(surface.f0[j]) > 0, -j))


def _duration(loop: ClosedLoop) -> float:
    """[s] of a run: time constants of the loop in contact."""
    slowest = -float(growth(loop.linearize().opened)[0])
    return float(np.clip(DECAYS / slowest, SHORTEST, LONGEST)) if slowest > 0 else UNSTABLE


def at_the_touch(loop: ClosedLoop, surface: int, axis: int, speed: float) -> Array:
    """(nx,) the state a microsecond before the touch. Raises BadArgument where the arm cannot move along the normal."""
    e = loop.equations
    wall = e.surfaces[surface]
    assert wall.pose is not None
    normal = wall.pose[:3, axis]
    q = np.array(loop.nominal([0.0]).q[0])
    for _ in range(50):
        along = _towards(loop, q, normal)
        elastic = float(e.touch({"q": q, "v": np.zeros(e.n)}).elastic[surface][axis])
        step = -elastic / float(wall.K[axis, axis]) - speed * BEFORE
        q = q + np.clip(step, -0.1, 0.1) * along
        if abs(step) < 1e-3 * speed * BEFORE:
            break
    else:
        raise BadArgument("environment", wall, "a surface within reach of the tool, along its normal")
    free, v = replace(loop, environment=None).equations, speed * _towards(loop, q, normal)
    if e.actuator == "torque":
        return start_state(free, 0.0, q=q, v=v, integral="trimmed")
    driven = bool(e.actuators.slots(loop.robot.joint_names))
    return _commanding(free, start_state(free, 0.0, q=q, integral="trimmed", actuator=v if driven else None), v)


def _commanding(e: Equations, x: Array, v: Array) -> Array:
    """The state x (nx,) with those states of a velocity law that are no integrals such that it commands v (n,), as it has done for a while."""
    slots = {name: np.array(part) for name, part in e.split(x).items()}
    for slot in e.law.slots(e.robot.joint_names):
        k = len(slot.channels)
        if slot.integral:
            continue
        seeded: dict[str, Any] = {**slots, slot.name: Dual(slots[slot.name], np.eye(k))}
        command = e.control(0.0, seeded, np.zeros(6), Wires(), Inputs())[0].command
        if isinstance(command, Dual):
            slots[slot.name] = slots[slot.name] + solve_command_for_slots(command.tangent, v - command.value)
            return np.asarray(value(e.join(slots)), float)
    raise BadArgument("loop", str(e.law), "a law with torque inputs, or one whose commanded velocity is a state, such as Admittance")


def _towards(loop: ClosedLoop, q: Array, normal: Array) -> Array:
    """(n,) joint velocity that moves the tool at 1 m/s along the normal (3,) [world], turning it and moving it aside as little as it can."""
    R = np.asarray(loop.robot.pose(q))[:3, :3]
    J = np.asarray(loop.robot.jacobian(q), float)
    v = np.linalg.pinv(J, rcond=1e-6) @ np.concatenate([R.T @ normal, np.zeros(3)])
    speed = float(normal @ R @ (J @ v)[:3])
    if not speed > 0.05:
        raise BadArgument("loop", str(loop), "an arm that can move its tool along the normal of the surface")
    return np.asarray(v / speed)


def _measured(case: tuple[ClosedLoop, float], *, surface: int, axis: int, times: Array, max_evaluations: int | None) -> dict[str, Any]:
    """One run."""
    loop, speed = case
    e = loop.equations
    run = simulate(e, times, at_the_touch(loop, surface, axis, speed), rtol=1e-8, atol=1e-11, max_evaluations=max_evaluations)
    name = e.surfaces[surface].axis_names[e.surfaces[surface].index.index(axis)]
    events = [event for event in run.events if event.surface == surface and event.axis == name]
    touches = [event.time for event in events if event.kind == "touch"]
    lifts = [event.time for event in events if event.kind == "lift"]
    force = np.full(times.size, np.nan)
    kept = times[times <= run.end]
    force[: kept.size] = _normal(e, run, kept, surface, axis)
    first = touches[0] if touches else 0.0
    peak = max([float(np.nanmax(force)), *(_peak(e, run, a, _until(a, lifts, run.end), surface, axis) for a in touches)])
    last = float(force[kept.size - 1])
    out = np.flatnonzero(np.abs(force[: kept.size] - last) > BAND * abs(last))
    settled = float(kept[out[-1] + 1]) - first if out.size and out[-1] + 1 < kept.size else 0.0
    settles = not run.diverged and last > 0 and settled + first < LAST * times[-1]
    return {
        "peak": peak, "bounces": float(len(lifts)), "settling": max(settled, 0.0) if settles else np.nan, "last": last, "force": force,
        "scale": float(e.surfaces[surface].K[axis, axis]), "message": run.message if run.diverged else "",
    }  # fmt: skip


def _normal(e: Equations, run: Simulation, t: Array, surface: int, axis: int) -> Array:
    """(k,) [N] the force along the normal at times t of the run."""
    return np.asarray(value(e.touch(e.split(run.state(t)), lose_contact=True).forces[surface])[..., axis], float)


def _until(touch: float, lifts: list[float], end: float) -> float:
    return min([t for t in lifts if t > touch], default=end)


def _peak(e: Equations, run: Simulation, start: float, end: float, surface: int, axis: int) -> float:
    """The largest force of one contact."""
    length = end - start
    if not length > 0:
        return 0.0
    t = np.union1d(start + np.geomspace(1e-9, 1.0, FINE) * length, start + np.linspace(0.0, 1.0, FINE) * length)
    t = t[t <= end]
    f = _normal(e, run, t, surface, axis)
    k = int(np.argmax(f))
    near = np.linspace(t[max(k - 1, 0)], t[min(k + 1, t.size - 1)], 51)
    return max(float(f[k]), float(_normal(e, run, near, surface, axis).max()))
