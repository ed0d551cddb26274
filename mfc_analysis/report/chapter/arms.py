"""The arms, paths, gains and limits of the chapter's report: defined once, so that all sections use the same ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis import gains, laws
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.loops.view import View
from mfc_analysis.requirements.requirements import Requirements
from mfc_analysis.robots.catalogue import planar_2r, single_joint, ur5
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories.joint import JointPoint, JointReference, Quintic

POINTS = 41  #: times along each path
PAYLOAD = 2.0  #: [kg] payload of the UR5, unknown to its controller
LIMITS = Requirements(phase_deg=45.0, gain_increase_db=6.0, gain_reduction_db=6.0, delay=2e-3, sensitivity_peak=2.0)


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm on its path."""

    name: str
    robot: Robot
    model: Robot  #: the controller's model
    ref: JointReference
    speed: float  #: [rad/s] natural frequency that the torque loops are designed for

    @property
    def times(self) -> Array:
        """(POINTS,) [s] along the path."""
        assert self.ref.duration is not None
        return np.linspace(0.0, self.ref.duration, POINTS)

    @property
    def exact(self) -> bool:
        """Whether the controller's model is exact."""
        return self.model is self.robot


@cache
def arms() -> tuple[Arm, ...]:
    """The single joint, the planar two-link, and the UR5 with an unknown payload of 2 kg."""
    joint, planar, bare = single_joint(), planar_2r(), ur5()
    start = np.array([0.0, -1.2, 1.4, -0.7, 1.57, 0.0])
    move = np.array([0.8, 0.5, -0.6, 0.4, -0.3, 0.5])
    return (
        Arm("single joint", joint, joint, Quintic([-0.4], [1.2], 2.0), 8.0),
        Arm("planar 2R", planar, planar, Quintic([-1.0, 1.6], [0.2, 0.5], 2.0), 8.0),
        Arm("UR5 + 2 kg", bare.with_payload(PAYLOAD), bare, Quintic(start, start + move, 2.0), 8.0),
    )


def _velocity_gains() -> dict[str, dict[str, Any]]:
    k = 4.0
    return {"9.1": {}, "9.2": {"kp": k}, "9.3": {"kp": k, "ki": k * k / 4}, "9.4": {"kp": k, "ki": k * k / 4}}


@dataclass(frozen=True)
class Designs:
    """The gains of the chapter's loops. Torque gains follow from each arm's ``speed``, times ``scale`` of the equation.

    ``scale`` multiplies the gains of an equation ("9.8", "9.10", ...), e.g. {"9.10": {"ki": 20.0}} makes that loop unstable.
    """

    velocity: Mapping[str, Mapping[str, Any]] = field(default_factory=_velocity_gains)
    scale: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def law(self, equation: str, arm: Arm) -> laws.law.Law:
        """The law of one equation for one arm."""
        if equation in self.velocity:
            return laws.by_equation(equation)(**self._scaled(equation, self.velocity[equation]))
        if equation == "9.8":
            return laws.JointPID(**self._scaled(equation, gains.joint_pid(arm.model, arm.ref, natural_frequency=arm.speed)))
        if equation == "9.9":
            return laws.TorqueFeedforward()
        if equation == "9.10":
            return laws.ComputedTorque(**self._scaled(equation, gains.pid(natural_frequency=arm.speed)))
        if equation == "9.11":
            return laws.InverseDynamics(self._scaled(equation, gains.pd(natural_frequency=arm.speed)))
        raise KeyError(equation)

    def origins(self, equation: str, arm: Arm) -> tuple[tuple[str, str], ...]:
        """(gain, where its value comes from); the name "" stands for all gains."""
        w = f"{arm.speed:g} rad/s"
        said = {
            "9.2": "bandwidth of 4 rad/s: kp = 4",
            "9.3": "double pole at −2 1/s: kp = 4, ki = kp²/4",
            "9.4": "as in 9.3",
            "9.8": f"gains.joint_pid on the diagonal of the inertia, natural frequency {w}",
            "9.10": f"gains.pid: triple pole at −{w}: kp = 3w², ki = w³, kd = 3w",
            "9.11": f"gains.pd: double pole at −{w}: kp = w², kd = 2w",
        }.get(equation, "as given")
        return (("", said + (", scaled" if self.scale.get(equation) else "")),)

    def _scaled(self, equation: str, found: Mapping[str, Any]) -> dict[str, Any]:
        factors = self.scale.get(equation, {})
        return {name: np.asarray(value) * factors.get(name, 1.0) for name, value in found.items()}

    def loop(self, equation: str, arm: Arm) -> ClosedLoop:
        """The closed loop of one equation on one arm."""
        return ClosedLoop(arm.robot, self.law(equation, arm), arm.ref, controller_model=arm.model)

    def view(self, equation: str, arm: Arm) -> View:
        """The loop with the results that a report shows."""
        return View(f"{NAMES[equation]}, {arm.name}", self.loop(equation, arm), arm.times, LIMITS)


#: equation -> name of its loops
NAMES = {
    "9.1": "9.1 velocity feedforward",
    "9.2": "9.2 velocity P",
    "9.3": "9.3 velocity PI",
    "9.4": "9.4 feedforward + PI",
    "9.8": "9.8 independent PID",
    "9.9": "9.9 torque feedforward",
    "9.10": "9.10 computed torque",
    "9.11": "9.11 inverse dynamics + PD",
}


@dataclass(frozen=True, eq=False)
class Polynomial(JointReference):
    """q = c0 + c1 t + c2 t^2 / 2, all joints alike or (n,) each: a ramp, or a parabola of acceleration c2."""

    count: int
    c1: float = 0.0
    c2: float = 0.0

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.count

    def _at(self, t: Array) -> JointPoint:
        one = np.ones((*t.shape, self.count))
        s = t[..., None]
        return JointPoint((self.c1 * s + self.c2 * s**2 / 2) * one, (self.c1 + self.c2 * s) * one, self.c2 * one)


def triple_pole(w: float) -> tuple[float, float, float]:
    """(kp, ki, kd) of 9.12 with s^3 + kd s^2 + kp s + ki = (s + w)^3."""
    return 3 * w**2, w**3, 3 * w


def decibels(factor: ArrayLike) -> Any:
    """20 log10; -inf of 0."""
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.asarray(factor, float))


def per_joint(values: ArrayLike) -> str:
    """Range of some values, such as one per joint, as text: "3.2" or "3.2 to 5.4"."""
    from mfc_analysis.report.document.document import written

    x = np.ravel(np.asarray(values, float))
    low, high = float(x.min()), float(x.max())
    return written(low) if math.isclose(low, high, rel_tol=1e-3) else f"{written(low)} to {written(high)}"
