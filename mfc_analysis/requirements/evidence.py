"""The metrics of a loop: for each, the worst value along the path, with its joint and time. ``requirements`` compares them with the limits.

Linear metrics come from the loop linearised about its reference; tracking error and torque from one nonlinear run along the
reference, which starts on it with integrals at zero. Each is computed once, at first use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.analysis.loop_step import SettlingStep
from mfc_analysis.analysis.participation import Root, located, rightmost
from mfc_analysis.analysis.slow import parts
from mfc_analysis.analysis.spectrum import UNDAMPED, Spectrum, spectrum
from mfc_analysis.analysis.stability import roots
from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.dynamics.operating_point import nominal
from mfc_analysis.dynamics.start_state import start_state
from mfc_analysis.errors import NotConverged, UnknownName, UnknownPoint
from mfc_analysis.linearization.linearization import linearize
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex
from mfc_analysis.maths.dual import value
from mfc_analysis.simulation.simulation import simulate

if TYPE_CHECKING:
    from mfc_analysis.analysis.disk import DiskMargin
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.analysis.stability import Stability
    from mfc_analysis.linearization.linearization import Linearization
    from mfc_analysis.linearization.tracking_steps import StepMetrics
    from mfc_analysis.simulation.simulation import Simulation


ROUNDING = 1e-9  #: fraction of the acceleration scale below which a residual is rounding error
RUN_POINTS = 400  #: fewest samples of the nonlinear run
TOOL_UNITS = (*("m",) * 3, *("rad",) * 3)  #: of X_e
GRAVITY = 10.0  #: [m/s^2] the acceleration scale of an arm at rest
SLIDES = 1e-8  #: fraction of its terms below which a slow displacement is rounding error
EDGE = 1e-3  #: fraction of 1/horizon within which a root that was judged to grow is looked for among the slow ones
HOLD_RUN = 2.0  #: [s] duration of the nonlinear run where neither the times nor the reference define one


class Found(NamedTuple):
    """The worst value of a metric, with its joint or channel and time."""

    value: float  #: NaN where it is not defined, with the reason in ``note``
    where: str = ""  #: joint or channel
    when: float | None = None  #: [s]
    note: str = ""
    unit: str = ""  #: of a displacement: that of its joint or channel


@dataclass(frozen=True, eq=False)
class Evidence:
    """The metrics of one loop at m times.

    Args:
        equations: those of a ``ClosedLoop``.
        times: (m,) [s], strictly increasing, or one number.
        at: analysis point of margins, disk margin and loop steps; None: the plant input.
        horizon: [s] of the verdict.
        step: whose settling and overshoot, "reference" or "loop".

    Raises BadArgument, UnknownPoint for ``at``.
    """

    equations: Equations
    times: Array
    at: str | None = None
    horizon: float = HORIZON
    step: SettlingStep = "reference"
    _cache: dict[str, Found] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", checks.times(self.times))
        law = self.equations.law
        if self.at is not None and (not isinstance(self.at, str) or self.at not in law.opens_at):
            raise UnknownPoint(self.at, type(law).__name__, law.opens_at)
        object.__setattr__(self, "at", self.equations.actuator if self.at is None else self.at)

    # --- computed once -------------------------------------------------------------------------------------------

    @cached_property
    def linearization(self) -> Linearization:
        """The loop linearised about its reference at the times."""
        return linearize(self.equations, self.times, horizon=self.horizon)

    @cached_property
    def stability(self) -> Stability:
        """The stability verdict, dead time included."""
        return self.linearization.stability

    @property
    def judged(self) -> Bools:
        """(m,) True where there are roots that are not slow and all of them decay, so that the metrics are defined."""
        return self.stability.nonzero_stable

    @property
    def nothing_else(self) -> bool:
        """True where every root is slow, at all times."""
        return not self.stability.held.any()

    @cached_property
    def margins(self) -> Margins:
        """One-loop margins at ``at``."""
        return self.linearization.margins(self.at)

    @cached_property
    def disk(self) -> DiskMargin:
        """Disk margin at ``at``."""
        return self.linearization.disk_margin(self.at)

    @cached_property
    def steps(self) -> StepMetrics:
        """Settling and overshoot of the steps from every reference channel to its coordinate, or of every loop at ``at``."""
        from mfc_analysis.linearization.tracking_steps import step_metrics

        return step_metrics(self.linearization, self.step, self.at)

    @cached_property
    def run(self) -> Simulation:
        """The nonlinear run along the reference: over the times, or its duration, period, or 2 s where one time is given."""
        first, last = float(self.times[0]), float(self.times[-1])
        if last == first:
            ref = self.equations.reference_source
            last = first + float(ref.duration or ref.period or HOLD_RUN)
        grid = np.union1d(np.linspace(first, last, RUN_POINTS), self.times)
        return simulate(self.equations, grid, start_state(self.equations, first))

    @cached_property
    def spectrum(self) -> Spectrum:
        return spectrum(self.linearization.reduced)

    # --- metrics -------------------------------------------------------------------------------------------------

    def found(self, metric: str) -> Found:
        """A metric by the name of its requirement (``METRICS``). Raises UnknownName."""
        if metric not in METRICS:
            raise UnknownName("metric", metric, METRICS)
        if metric not in self._cache:
            self._cache[metric] = METRICS[metric](self)
        return self._cache[metric]

    def slowest_root(self) -> Found:
        """Rightmost real part [1/s] of the roots that are not slow, dead time included; -inf where there is none."""
        root = self.rightmost
        return Found(root.value.real, root.where, root.time)

    @cached_property
    def rightmost(self) -> Root:
        """The rightmost root that is not slow, dead time included, with its time and the joints or tool axes that take part in it.

        Of an unstable loop it grows: a root on the edge of the disc of the slow ones may be judged outside it and be found inside, to rounding.
        """
        found, slow = self.roots
        if not (self.judged.all() or (found.real[~slow] > 0).any()):
            slow = slow & ~((np.abs(found) > (1 - EDGE) / self.horizon) & (found.real > 0))
        return rightmost(self.linearization.judged, (found, slow))

    @property
    def unstable(self) -> str:
        """The root that makes the loop unstable, in words: joint or tool axis, time and value; "" where the roots that are not slow decay."""
        root = self.rightmost
        if self.judged.all() or self.nothing_else:
            return ""
        if root.value.real < -UNDAMPED * abs(root.value):  # an infinite chain of roots, or one that is only counted
            return f"t = {self.times[np.argmin(self.judged)]:.4g} s: a root in the right half plane, not located"
        return str(root)

    @cached_property
    def roots(self) -> tuple[Complex, Bools]:
        """Roots [1/s] and which of them are slow, (m, k) each: the poles (a sampled loop: ln(z)/dt), or with dead time the rightmost exact ones."""
        lin = self.linearization
        late = bool(lin.delay or lin.force_delay)
        return roots(lin.opened, None, self.spectrum, self.stability) if late else roots(lin.reduced, known=self.spectrum)

    def implied_error(self) -> Found:
        """Steady displacement [rad, m] of the joints due to the residual: |A^-1 r| of the linear loop; 0: rounding error only.

        r is the residual of every rate at the operating point. The slow part counts with what it moves within the horizon.
        """
        e, lin = self.equations, self.linearization
        asked = nominal(e, self.times)
        left = _left_over(e, lin.point.x, self.times, asked.v, asked.a)
        if np.abs(left).max(initial=0.0) <= ROUNDING * (GRAVITY + np.abs(asked.a).max(initial=0.0)):
            return Found(0.0)
        A = closed_matrix(e, self.times, lin.point.x, "state")
        where = e.parts["q"].where
        moved = np.stack([_displacement(A[i], left[i], where, self.horizon) for i in range(len(self.times))])
        i, j = np.unravel_index(int(np.argmax(moved)), moved.shape)
        return Found(float(moved[i, j]), e.robot.joint_names[j], float(self.times[i]), unit=e.robot.joint_units[j])

    def _unstable(self) -> Found:
        bad = np.flatnonzero(~self.judged)
        if self.nothing_else:
            return Found(np.nan, "", float(self.times[bad[0]]), "every root is slow, nothing holds the loop within the horizon: no metric is defined")
        return Found(np.nan, self.rightmost.where, self.rightmost.time, f"unstable: {self.unstable}")


# --- one function for each metric ------------------------------------------------------------------------------------


def _margin(name: str, largest: bool = False) -> Callable[[Evidence], Found]:
    def found(e: Evidence) -> Found:
        if not e.judged.all():
            return e._unstable()
        values = getattr(e.margins, name)
        sensed = ~np.isnan(values).all(axis=0)
        if e.at == "force" and sensed.any():
            values = np.where(sensed, values, -np.inf if largest else np.inf)
        return _worst(values, e.margins.channels, e.times, largest)

    return found


def _worst(values: Array, channels: tuple[str, ...], times: Array, largest: bool) -> Found:
    bad = np.isnan(values)
    flat = int(np.argmax(bad)) if bad.any() else int(np.argmax(values) if largest else np.argmin(values))
    i, k = np.unravel_index(flat, values.shape)
    return Found(float(values[i, k]), channels[k], float(times[i]), "not defined" if bad.any() else "")


def _disk(e: Evidence) -> Found:
    if not e.judged.all():
        return e._unstable()
    alpha = e.disk.alpha
    i = int(np.argmax(np.isnan(alpha)) if np.isnan(alpha).any() else np.argmin(alpha))
    return Found(float(alpha[i]), f"all channels, {e.disk.frequency[i]:.4g} rad/s", float(e.times[i]), "" if np.isfinite(alpha[i]) else "not defined")


def _damping(e: Evidence) -> Found:
    roots, slow = e.roots
    size = np.abs(roots)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(np.isneginf(roots.real), 1.0, -roots.real / size)
    ratio = np.where(slow, np.inf, ratio)
    i, k = np.unravel_index(int(np.argmin(ratio)), ratio.shape)
    if slow.all():
        return e._unstable()
    note = f"of the {roots.shape[1]} rightmost roots" if e.linearization.delay or e.linearization.force_delay else f"{size[i, k]:.4g} rad/s"
    return Found(float(ratio[i, k]), located(e.linearization.judged, int(i), complex(roots[i, k])).where, float(e.times[i]), note)


def _settling(e: Evidence) -> Found:
    return _step(e, "settling")


def _overshoot(e: Evidence) -> Found:
    return _step(e, "overshoot")


def _step(e: Evidence, name: str) -> Found:
    if not e.judged.all():
        return e._unstable()
    values = getattr(e.steps, name)
    looped = e.step == "loop"
    if values.size == 0:
        return Found(np.nan, "", None, f"no loop goes through {e.at!r}" if looped else "no reference channel has a coordinate that follows it")
    found = _worst(values, e.steps.channels, e.times, True)
    if np.isnan(found.value):
        what = "T = L/(1 + L) does not reach a steady value" if looped else "the coordinate does not follow its reference to a steady value"
        return found._replace(note=what)
    return found._replace(note="does not settle within the horizon: a slow root integrates the step") if np.isinf(found.value) else found


def _tracking(e: Evidence) -> Found:
    run = e.run
    if run.diverged:
        return Found(np.nan, "", run.end, run.message)
    law, robot = e.equations.law, e.equations.robot
    names = tuple(f"X_e_{c}" if law.space == "tool" else c for c in law.error_channels(robot.joint_names))
    of_tool = TOOL_UNITS if law.selection is None else law.selection.units
    units = dict(zip(names, robot.joint_units if law.space == "joint" else of_tool, strict=True))
    found = _worst(np.abs(run.error), names, run.t, True)
    return found._replace(unit=units.get(found.where, ""))


def _torque(e: Evidence) -> Found:
    run, equations = e.run, e.equations
    if run.diverged:
        return Found(np.nan, "", run.end, run.message)
    torque = equations.actuator == "torque"
    limit = np.array(equations.robot.limits.torque if torque else equations.robot.limits.velocity)
    if equations.actuators.limit is not None:
        limit = np.minimum(limit, equations.actuators.limit)
    known = np.isfinite(limit)
    if not known.any():
        return Found(np.nan, "", None, f"the robot has no {'torque' if torque else 'velocity'} limits to compare with")
    found = _worst(np.where(known, np.abs(run.command) / limit, 0.0), equations.robot.joint_names, run.t, True)
    what = "" if torque else "commanded velocity relative to its limit"
    missing = [j for j, there in zip(equations.robot.joint_names, known, strict=True) if not there]
    return found._replace(note=what or (f"no known limit for {', '.join(missing)}" if missing else ""))


#: metric (a field of ``Requirements``) -> the function that computes it
METRICS: dict[str, Callable[[Evidence], Found]] = {
    "gain_increase_db": _margin("gain_increase_db"),
    "gain_reduction_db": _margin("gain_reduction_db"),
    "phase_deg": _margin("phase_deg"),
    "delay": _margin("delay"),
    "sensitivity_peak": _margin("sensitivity_peak", largest=True),
    "damping_ratio": _damping,
    "disk_margin": _disk,
    "settling_time": _settling,
    "overshoot": _overshoot,
    "tracking_error": _tracking,
    "torque_fraction": _torque,
}


# --- residual at an operating point ----------------------------------------------------------------------------------


def _left_over(equations: Equations, x: Array, times: Array, v: Array, a: Array) -> Array:
    """(m, nx) residual: rates at the operating points minus those of the reference motion."""
    slots = equations.split(np.array(value(equations.rates(times, x))))
    torque = equations.actuator == "torque"
    for name, moving in (("q", v), ("theta", v), *((("v", a), ("omega", a)) if torque else ())):
        if name in slots:
            slots[name] = value(slots[name]) - moving
    return np.array(value(equations.join(slots)))


def _displacement(A: Array, left: Array, where: slice, horizon: float) -> Array:
    """(n,) |positions| of x' = A x + left from zero: steady, and of the slow part those reached within the horizon."""
    both = parts(A, 1 / horizon)
    try:
        steady = -both.fast_right @ np.linalg.solve(both.fast, both.fast_left @ left) if len(both.fast) else np.zeros(len(A))
    except np.linalg.LinAlgError as why:
        raise NotConverged("the steady state of the linear loop has no digits: its coefficients differ by more than 16 decades") from why
    if not both.slow.block.size:
        return np.abs(steady[where])
    push = both.slow.left @ left
    slid = (both.slow.right @ both.slow.integral(horizon) @ push)[where]
    rounding = np.abs(both.slow.right[where]) @ np.abs(both.slow.integral(horizon)) @ (np.abs(both.slow.left) @ np.abs(left))
    return np.abs(steady[where] + np.where(np.abs(slid) > SLIDES * rounding, slid, 0.0))
