r"""The practice questions of the chapter, 9.1 to 9.4, on Pinocchio's dynamics instead of a CoppeliaSim scene.

One revolute joint in a vertical plane (equation 9.6), with the angle measured from the horizontal. Every run starts at the original
position, q = 0 (horizontal), at rest. Without a target velocity the target is a step; with one the joint follows a quintic whose top
speed is the target velocity, which takes 1.875 |target| / velocity.

9.4: the RP manipulator q = (theta, d) with its tool at d (cos theta, sin theta, 0) and tau = J^T F for F in base axes,
J = [[-d sin theta, cos theta], [d cos theta, sin theta]].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.plots.figure import Axes
    from mfc_analysis.simulation.simulation import Simulation


QUINTIC_TOP_SPEED = 1.875  #: top speed of a quintic over its mean speed
SLOWEST, FASTEST = 1e-2, 1e6  #: [deg/s] target velocities
LONGEST = 1e4  #: [s] of a run
LARGEST = 1e12  #: [m, N] of exercise 9.4
MOST = 20_000  #: evaluations of a run: about half a second
SETTLED = 0.02  #: settling band, a fraction of the motion
GRAVITY = 9.81  #: [m/s^2]


@dataclass(frozen=True)
class Link:
    """The joint of equation 9.6: I th'' + m g r cos th + b th' = tau. Raises BadArgument for a number that is negative or not finite."""

    inertia: float = 0.5  #: I [kg m^2]
    mass: float = 1.0  #: m [kg]
    com_distance: float = 0.1  #: r [m]
    damping: float = 0.1  #: b [N m s/rad]

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", checks.number("inertia", self.inertia, low=0.0, strict=True))
        for name in ("mass", "com_distance", "damping"):
            object.__setattr__(self, name, checks.number(name, getattr(self, name), low=0.0))

    def __str__(self) -> str:
        return (
            f"I = {self.inertia:g} kg m^2, m = {self.mass:g} kg, r = {self.com_distance:g} m, b = {self.damping:g} N m s/rad; "
            "starts at q = 0 deg (horizontal), at rest"
        )


@dataclass(frozen=True, eq=False)
class JointRun:
    """One law on the link: the run, its metrics, and whether its loop is stable."""

    name: str
    loop: ClosedLoop = field(repr=False)
    simulation: Simulation = field(repr=False)
    target: float  #: [rad]
    poles: Array  #: of the loop linearised about the target, or about the rest position of the joint
    rests_at: float  #: [rad] position of the linearisation
    stable: bool
    advice: str  #: recommended change; empty where the loop is stable

    @property
    def overshoot(self) -> float:
        """Overshoot beyond the target, as a fraction of the motion; NaN for a run that diverged."""
        past = math.copysign(1.0, self.target) * (self.simulation.q[:, 0] - self.target)
        return math.nan if self.simulation.diverged else max(0.0, float(past.max())) / abs(self.target)

    @property
    def settling_time(self) -> float:
        """[s] after which the joint stays within 2 % of the motion around the target; inf where it does not, NaN for a run that diverged."""
        outside = np.flatnonzero(np.abs(self.simulation.q[:, 0] - self.target) > SETTLED * abs(self.target))
        if self.simulation.diverged:
            return math.nan
        if outside.size == 0:
            return 0.0
        last = int(outside[-1])
        return math.inf if last + 1 >= len(self.simulation.t) else float(self.simulation.t[last + 1])

    @property
    def steady_error(self) -> float:
        """[rad] target minus position at the end of the run."""
        return math.nan if self.simulation.diverged else float(self.target - self.simulation.q[-1, 0])

    @property
    def peak_torque(self) -> float:
        """[N m] largest commanded torque."""
        return float(np.abs(self.simulation.tau).max())

    @property
    def peak_velocity(self) -> float:
        """[rad/s] largest speed of the joint."""
        return float(np.abs(self.simulation.v).max())

    def rows(self) -> tuple[tuple[str, str], ...]:
        """Results of the run, in words and numbers with units."""
        rest = "the target" if math.isclose(self.rests_at, self.target, abs_tol=1e-12) else f"rest at {math.degrees(self.rests_at):.4g} deg"
        verdict = "stable" if self.stable else "NOT STABLE"
        return (
            ("law", str(self.loop.law)),
            ("loop", f"{verdict} about {rest}: poles {', '.join(map(_pole, self.poles))} 1/s"),
            *((("what to change", self.advice),) if self.advice else ()),
            ("run", str(self.simulation.message)),
            ("overshoot", _said(round(100 * self.overshoot, 2), "% of the way")),
            ("settling time (2 %)", _said(self.settling_time, "s", "not within the run")),
            ("error at the end", _said(round(math.degrees(self.steady_error), 4), "deg")),
            ("largest torque", _said(self.peak_torque, "N m")),
            ("largest velocity", _said(math.degrees(self.peak_velocity), "deg/s")),
        )


def pid(
    target_deg: float, kp: float, ki: float = 0.0, kd: float = 0.0, velocity_deg: float = 0.0, link: Link | None = None, duration: float = 5.0
) -> JointRun:
    """Exercise 9.1: PID (9.8) moves the link to the target.

    Args:
        target_deg: [deg], not 0. kp [N m/rad], ki [N m/(rad s)], kd [N m s/rad]; ki = 0: no integral.
        velocity_deg: target velocity [deg/s]; 0: a step. duration: [s] of the run after the end of the motion.

    Raises BadArgument for a number that is not finite or a target of 0.
    """
    from mfc_analysis.laws import JointPID

    link = Link() if link is None else checks.instance("link", link, Link, "a Link")
    kp, ki, kd = (checks.number(name, given) for name, given in (("kp", kp), ("ki", ki), ("kd", kd)))
    law = JointPID(kp, ki or None, kd)
    slope = link.mass * GRAVITY * link.com_distance

    def advice(at: float) -> str:
        return routh_advice(link.inertia, link.damping + kd, kp - slope * math.sin(at), ki, kp, kd, "N m")

    return _run("PID", law, target_deg, velocity_deg, link, duration, advice)


def pid_with_inverse_dynamics(
    target_deg: float, kp: float, ki: float = 0.0, kd: float = 0.0, velocity_deg: float = 90.0, link: Link | None = None, duration: float = 5.0
) -> JointRun:
    """Exercise 9.2: PID with inverse dynamics (9.12) moves the link to the target, at the target velocity.

    Args:
        target_deg: [deg], not 0. kp [1/s^2], ki [1/s^3], kd [1/s]; ki = 0: no integral.
        velocity_deg: target velocity [deg/s], the top speed; 0: a step. duration: [s] of the run after the end of the motion.

    Raises BadArgument for a number that is not finite or a target of 0.
    """
    from mfc_analysis.laws import ComputedTorque

    link = Link() if link is None else checks.instance("link", link, Link, "a Link")
    kp, ki, kd = (checks.number(name, given) for name, given in (("kp", kp), ("ki", ki), ("kd", kd)))
    law = ComputedTorque(kp, ki or None, kd)

    def advice(at: float) -> str:
        return routh_advice(1.0, kd, kp, ki, kp, kd, "")

    return _run("PID + inverse dynamics", law, target_deg, velocity_deg, link, duration, advice)


def _run(name: str, law: Any, target_deg: float, velocity_deg: float, link: Link, duration: float, advice: Callable[[float], str]) -> JointRun:
    from mfc_analysis.laws import JointPID
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.robots import single_joint
    from mfc_analysis.trajectories import Hold, Quintic

    target = math.radians(checks.number("target_deg", target_deg))
    if target == 0:
        raise BadArgument("target_deg", target_deg, "an angle other than 0 deg, where the link starts")
    speed = math.radians(checks.number("velocity_deg", velocity_deg, low=0.0, high=FASTEST))
    if 0 < velocity_deg < SLOWEST:
        raise BadArgument("velocity_deg", velocity_deg, f"0 for a step, or {SLOWEST:g} to {FASTEST:g} deg/s")
    duration = checks.number("duration", duration, low=0.0, high=LONGEST, strict=True)
    robot = single_joint(link.inertia, link.mass, link.com_distance, link.damping)
    moving = QUINTIC_TOP_SPEED * abs(target) / speed if speed else 0.0
    loop = ClosedLoop(robot, law, Quintic([0.0], [target], moving) if speed else Hold([target]))
    at_rest = ClosedLoop(robot, law, Hold([target]))
    lin, rests_at = at_rest.linearize(), target
    if isinstance(law, JointPID) and not law.ki:  # no integral: the joint sags and rests below the target
        try:
            rests_at = float(at_rest.equilibrium().q[0])
            lin = at_rest.linearize(about="equilibrium")
        except NotConverged:
            rests_at = target
    simulation = loop.simulate(np.linspace(0.0, moving + duration, 1001), q=[0.0], v=[0.0], max_evaluations=MOST)
    poles = lin.poles()[0]
    poles = poles[np.argsort(-poles.real, kind="stable")]
    stable = bool(lin.stable[0])
    return JointRun(name, loop, simulation, target, poles, rests_at, stable, "" if stable else advice(rests_at))


def routh_advice(a3: float, a2: float, a1: float, a0: float, kp: float, kd: float, unit: str) -> str:
    """Change of gains that makes a3 s^3 + a2 s^2 + a1 s + a0 stable: kp and kd enter a1 and a2, ki is a0 (0: none).

    Stable iff all coefficients are positive and a3 a0 < a2 a1.
    """
    per = f" {unit}/rad" if unit else " 1/s^2"
    rate = f" {unit} s/rad" if unit else " 1/s"
    integral = f" {unit}/(rad s)" if unit else " 1/s^3"
    if a2 <= 0:
        return f"raise kd above {kd - a2:.4g}{rate}: the joint has no damping"
    if a1 <= 0:
        return f"raise kp above {kp - a1:.4g}{per}: the joint diverges from the target"
    if a0 < 0:
        return "make ki positive: a negative integral gain is unstable"
    if a3 * a0 >= a2 * a1:
        lower, higher = f"{a2 * a1 / a3:.4g}{integral}", f"{kd - a2 + a3 * a0 / a1:.4g}{rate}"
        return f"lower ki below {lower}, or raise kd above {higher}: the integral acts faster than the damping"
    return ""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Exercise 9.3: both laws on the same motion."""

    plain: JointRun
    inverse: JointRun

    def rows(self) -> tuple[tuple[str, str, str], ...]:
        """The metrics side by side: metric, PID, PID + inverse dynamics."""
        left, right = dict(self.plain.rows()), dict(self.inverse.rows())
        return tuple((key, left.get(key, "-"), right.get(key, "-")) for key in dict.fromkeys([*left, *right]))

    @property
    def finding(self) -> str:
        """Comparison of both laws, in a sentence from the metrics."""
        bad = [run.name for run in (self.plain, self.inverse) if run.simulation.diverged or not run.stable]
        if bad:
            return f"{' and '.join(bad)}: not stable with these gains, so no comparison is possible."
        metrics: tuple[tuple[str, float, float, Callable[[float], str]], ...] = (
            ("overshoots", self.plain.overshoot, self.inverse.overshoot, lambda x: f"{round(100 * x, 2):.3g} %"),
            ("settles in", self.plain.settling_time, self.inverse.settling_time, lambda x: _said(x, "s", "no time within the run")),
            ("needs", self.plain.peak_torque, self.inverse.peak_torque, lambda x: f"{x:.3g} N m"),
        )
        parts = []
        for what, plain, inverse, said in metrics:
            names = ("PID", "inverse dynamics") if plain <= inverse else ("inverse dynamics", "PID")
            low, high = said(min(plain, inverse)), said(max(plain, inverse))
            parts.append(f"both: {what} {low}" if low == high else f"{names[0]} {what} {low}, {names[1]} {high}")
        return "; ".join(parts) + "."


def compare(
    target_deg: float,
    kp: float,
    ki: float = 0.0,
    kd: float = 0.0,
    velocity_deg: float = 90.0,
    link: Link | None = None,
    duration: float = 5.0,
    pid_gains: tuple[float, float, float] | None = None,
) -> Comparison:
    """Exercise 9.3: PID and PID with inverse dynamics on the same motion.

    Args:
        kp [1/s^2], ki [1/s^3], kd [1/s] of the inverse dynamics. pid_gains: (kp, ki, kd) of the plain PID [N m ...]; None: inertia times
            these gains, so that without gravity and friction both loops have the same poles.
        target_deg, velocity_deg, duration: as in ``pid_with_inverse_dynamics``.
    """
    link = Link() if link is None else checks.instance("link", link, Link, "a Link")
    inverse = pid_with_inverse_dynamics(target_deg, kp, ki, kd, velocity_deg, link, duration)
    plain = link.inertia * np.array([kp, ki, kd]) if pid_gains is None else checks.array("pid_gains", pid_gains, (3,))
    return Comparison(pid(target_deg, float(plain[0]), float(plain[1]), float(plain[2]), velocity_deg, link, duration), inverse)


def graph(runs: Sequence[JointRun]) -> tuple[Axes, ...]:
    """Joint position, joint velocity and torque over time. A second run is dashed, at the times of the first."""
    from mfc_analysis import plots

    first = runs[0].simulation
    other = runs[1].simulation if len(runs) > 1 else None

    def beside(values: Array, t: Array, scale: float) -> Array:
        out: Array = np.interp(first.t, t, scale * values, right=np.nan)
        return out

    degrees = 180 / math.pi
    q_d = degrees * np.array(runs[0].loop.ref(first.t).q)
    panels = [
        plots.Panel("position [deg]", np.hstack([degrees * first.q, q_d]), beside=None if other is None else beside(other.q[:, 0], other.t, degrees)),
        plots.Panel("velocity [deg/s]", degrees * first.v, beside=None if other is None else beside(other.v[:, 0], other.t, degrees)),
        plots.Panel("torque [N m]", first.tau, beside=None if other is None else beside(other.tau[:, 0], other.t, 1.0)),
    ]
    said = None if other is None else (runs[0].name, runs[1].name)
    return plots.traces(first.t, panels, ("joint", "reference"), said=said)


# --- 9.4 -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ForceAnswer:
    """Exercise 9.4: the joint torques of the RP manipulator that produce a force at its tool."""

    theta: float  #: [rad]
    d: float  #: [m]
    force: Array  #: (2,) [N] in base axes
    jacobian: Array  #: (2, 2) [m, 1], base axes
    torques: Array  #: (2,) [N m], [N]

    def rows(self) -> tuple[tuple[str, str], ...]:
        """The answer in words and numbers with units."""
        J, tau = (np.round(x, 12) + 0.0 for x in (self.jacobian, self.torques))  # no -0, and no rounding of a right angle
        return (
            ("geometry", "revolute theta, then prismatic d along the arm; tool at d (cos theta, sin theta, 0); F in base axes (x, y)"),
            ("configuration", f"theta = {math.degrees(self.theta):.6g} deg, d = {self.d:.6g} m"),
            ("force", f"F = [{self.force[0]:.6g}, {self.force[1]:.6g}] N"),
            ("Jacobian", f"J = [[{J[0, 0]:.6g}, {J[0, 1]:.6g}], [{J[1, 0]:.6g}, {J[1, 1]:.6g}]]"),
            ("torques", f"tau = J^T F = [{tau[0]:.6g} N m, {tau[1]:.6g} N]"),
        )


def rp_torques(theta_deg: float = 45.0, d: float = 1.0, force: Sequence[float] = (3.0, 4.0)) -> ForceAnswer:
    """Exercise 9.4: tau = J^T F on the RP manipulator.

    Args:
        theta_deg: [deg]. d: [m]. force: (Fx, Fy) [N] in base axes, exerted by the tool.

    Raises BadArgument for numbers that are not finite, or above 1e12.
    """
    from mfc_analysis.robots import rp

    theta, d = math.radians(checks.number("theta_deg", theta_deg)), checks.number("d", d, low=-LARGEST, high=LARGEST)
    F = checks.array("force", force, (2,))
    if np.abs(F).max() > LARGEST:
        raise BadArgument("force", force, f"forces up to {LARGEST:g} N")
    torques = rp().joint_torques([theta, d], [F[0], F[1], 0, 0, 0, 0], frame="world")
    s, c = math.sin(theta), math.cos(theta)
    return ForceAnswer(theta, d, F, np.array([[-d * s, c], [d * c, s]]), np.asarray(torques) + 0.0)


def _pole(pole: complex) -> str:
    if abs(pole.imag) < 1e-9 * max(1.0, abs(pole)):
        return f"{pole.real:.4g}"
    return f"{pole.real:.4g}{pole.imag:+.4g}j"


def _said(value: float, unit: str, infinite: str = "no limit") -> str:
    if math.isnan(value):
        return "not defined: the run diverged"
    if math.isinf(value):
        return infinite
    return f"{value + 0.0:.4g} {unit}"
