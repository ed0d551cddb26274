"""Step responses to the reference: the linear prediction and the nonlinear simulation of the same step.

The nonlinear response is the difference of two simulations from the operating point, with and without the step. On a moving
path the linear model is frozen at the time of the step, so the two responses differ.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.analysis.steps import Step, step
from mfc_analysis.dynamics.equations import reference_channels, reference_moves
from mfc_analysis.errors import MfcError, MfcWarning
from mfc_analysis.laws.law import WRENCH, ToolReference
from mfc_analysis.linearization.tracking_steps import followed
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import adjoint, exp6
from mfc_analysis.trajectories.joint import JointPoint
from mfc_analysis.trajectories.tool import ToolPoint

if TYPE_CHECKING:
    from mfc_analysis.dynamics.equations import Equations
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.report.loops.view import View


JOINT, PRISMATIC, LINEAR, ANGULAR = 0.05, 0.01, 0.005, 0.02  #: [rad], [m], [m], [rad] sizes of the steps
FORCE = 0.05  #: fraction of the desired force; at least 1 N (Nm)
LONGEST, SAMPLES, SEGMENTS = 4.0, 300, 300  #: longest run [s]; points kept; most dead-time segments or samples of a run
GROWTH = 4.0  #: length of an unstable step response in time constants of the fastest growth


@dataclass(frozen=True, eq=False)
class Shifted:
    """A reference moved by a constant: joint positions by (n,) [rad, m], or the tool by exp(delta), delta (6,) in its own frame."""

    source: Any
    delta: Array

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def __call__(self, t: ArrayLike) -> JointPoint | ToolPoint:
        """The moved reference at t [s]."""
        point = self.source(t)
        if self.source.space == "joint":
            return JointPoint(point.q + self.delta, point.v, point.a)
        move, back = exp6(self.delta), adjoint(exp6(-self.delta))
        return ToolPoint(np.asarray(point.X) @ move, point.V @ back.T, point.dV @ back.T)


@dataclass(frozen=True, eq=False)
class ToolOf:
    """The tool motion of a joint reference, as input of a tool law."""

    source: Any
    equations: Equations
    space: ClassVar[str] = "tool"

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def __call__(self, t: ArrayLike) -> ToolPoint:
        """Pose, twist and its rate at t [s]."""
        now = self.equations.reference(np.asarray(t, float))
        assert isinstance(now, ToolReference)
        return ToolPoint(now.X.matrix, np.asarray(now.V), np.asarray(now.dV))


@dataclass(frozen=True, eq=False)
class StepRun:
    """One step, linear and nonlinear."""

    linear: Step
    size: float  #: of the step
    unit: str
    channel: str
    t: Array  #: (k,) [s] since the step
    predicted: Array  #: (k,) the linear response to the step of this size
    nonlinear: Array  #: (k,) the nonlinear response; shorter than t if it diverged
    drive: Array  #: (k,) change of the torque [Nm] (velocity laws: velocity) of the joint that works hardest
    whole: Array  #: (k,) that torque itself, what holds the arm included; its limits apply to it
    joint: int  #: that joint
    said: str  #: why the nonlinear simulation stopped early; empty otherwise

    @property
    def misfit(self) -> float:
        """Largest |nonlinear - linear| as a fraction of the step; NaN if the simulation diverged."""
        k = self.nonlinear.size
        return float("nan") if self.said or not k else float(np.abs(self.nonlinear - self.predicted[:k]).max() / abs(self.size))


def step_run(view: View) -> StepRun | None:
    """Step response of the reference channel in the worst case; None if the loop follows no reference."""
    system, pairs = followed(view.lin)
    if not pairs or not view.fed_back.any():
        return None
    i = view.worst.row
    source, target, channel = next((p for p in pairs if p[2] == view.worst.name), pairs[0])
    linear = step(system, i, source, target)
    try:
        duration = view.calm(_duration(view, linear))
    except MfcError:
        return None
    linear = step(system, i, source, target, duration)
    size, unit = _size(view.loop, source, channel)
    runs = [_run(loop, view, i, duration) for loop in (view.loop, _stepped(view, i, source, size))]
    if runs[0] is None or runs[1] is None:
        return None
    k = min(len(r.t) for r in runs)
    t = runs[1].t[:k] - runs[1].t[0]
    out = [_output(r, target, view.loop)[:k] for r in runs]
    moved = out[1] - out[0]
    if target.startswith("X_"):
        moved = size - moved
    work = runs[1].tau[:k] - runs[0].tau[:k]
    joint = int(np.argmax(np.abs(work).max(axis=0)))
    predicted = size * np.interp(t, linear.t, linear.y)
    said = next((r.message for r in runs if r.diverged), "")
    return StepRun(linear, size, unit, channel, t, predicted, moved, work[:, joint], np.asarray(runs[1].tau[:k, joint]), joint, said)


def _duration(view: View, linear: Step) -> float:
    if linear.outcome is Outcome.SETTLES and np.isfinite(linear.settling) and linear.settling > 0:
        longest = min(1.6 * linear.settling, LONGEST)
    else:
        growth = view.growth
        longest = float(np.clip(GROWTH / growth, 0.05, LONGEST / 2)) if growth > 0 else LONGEST / 2
    hardware = view.loop.equations.hardware
    grain = min((float(x) for x in (hardware.sample_time, hardware.command_delay, hardware.force_delay) if x), default=0.0)
    return min(longest, SEGMENTS * grain) if grain else longest


def _size(loop: ClosedLoop, source: str, channel: str) -> tuple[float, str]:
    if source.startswith("F_d"):
        asked = float(np.linalg.norm(wrench_asked(loop)))
        return max(FORCE * asked, 1.0), "N" if channel[2] == "f" else "Nm"
    if source.startswith("X_d"):
        selection = loop.law.selection
        turns = channel[2] == "w" if selection is None else "rad" in selection.units[selection.names.index(channel[2:])]
        return (ANGULAR, "rad") if turns else (LINEAR, "m")
    unit = loop.robot.joint_units[loop.robot.joint_names.index(channel)]
    return (PRISMATIC, "m") if unit == "m" else (JOINT, "rad")


def wrench_asked(loop: ClosedLoop) -> Array:
    """(6,) the desired wrench of a force law; a copy."""
    return np.zeros(6) if loop.law.desired_wrench is None else np.array(loop.law.desired_wrench)


def _stepped(view: View, i: int, source: str, size: float) -> ClosedLoop:
    """The loop with this reference channel moved by ``size``, as seen from operating point i."""
    loop = view.loop
    surfaces = list(loop.equations.surfaces) or None
    if source.startswith("F_d_"):
        F_d = wrench_asked(loop)
        F_d[WRENCH.index(source.removeprefix("F_d_"))] += size
        return replace(loop, law=loop.law.changed(F_d=F_d), environment=surfaces)
    tool = source.startswith("X_d_")
    point = view.lin.point
    delta = size * reference_moves(loop.equations, point.times[i : i + 1], point.x[i : i + 1])[0, :, reference_channels(loop.equations).index(source)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MfcWarning)
        if tool and loop.ref.space == "joint":
            start = np.asarray(loop.ref(0.0).q)
            return replace(loop, ref=Shifted(ToolOf(loop.ref, loop.equations), delta), environment=surfaces, q_start=start)
        return replace(loop, ref=Shifted(loop.ref, delta), environment=surfaces)


def _run(loop: ClosedLoop, view: View, i: int, duration: float) -> Any:
    t = float(view.times[i]) + np.linspace(0.0, duration, SAMPLES + 1)
    try:
        return loop.simulate(t, x=view.lin.point.x[i], rtol=1e-7, atol=1e-9)
    except MfcError:
        return None


def _output(run: Any, target: str, loop: ClosedLoop) -> Array:
    if target.startswith("F_tip_"):
        return np.asarray(run.force[:, WRENCH.index(target.removeprefix("F_tip_"))])
    if target.startswith("X_"):
        return np.asarray(run.error[:, loop.law.error_channels(loop.robot.joint_names).index(target.removeprefix("X_"))])
    return np.asarray(run.q[:, loop.robot.joint_names.index(target.removeprefix("q_"))])
