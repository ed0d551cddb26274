"""Hardware between the law and the joints: lag, servo, dead time, sampling, filters, elastic joints, limits. All off by default."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.coded import PRESENT, Rule
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, elementwise

SHORTEST, LONGEST = 1e-9, 1e9  #: [s] of a lag, a dead time, a filter or a sample time that is on
SMALLEST, LARGEST = 1e-12, 1e15  #: of a stiffness, a damping, an inertia or a torque limit that is on, in its unit
CHOICES = {"feedback": ("motor", "link"), "integral_rule": tuple(PRESENT), "derivative_rule": tuple(PRESENT)}  #: fields that are words
MOST_SAMPLES = 2000  #: largest dead time of a sampled loop, in samples


SLOWEST, FASTEST = 1e-9, 1e9  #: [rad/s] bandwidth of a servo


@dataclass(frozen=True, eq=False)
class Servo:
    r"""The arm's own servo under a law that commands joint velocities: a loop of second order for each joint.

    .. math:: \dot q = G(s)\,u, \qquad G(s) = \frac{w^2}{s^2 + 2 \zeta w s + w^2}

    G is 1 at low frequencies. It is a velocity servo, or a position servo whose command is the integral of u: the transfer from u to q, G/s, is
    the same. A force of the environment does not move it.

    Args:
        bandwidth: [rad/s] the frequency where G falls to -3 dB (1/sqrt 2), as the ``bandwidth`` of ``gains``; scalar or (n,), 1e-9 to 1e9.
            The natural frequency is w = bandwidth / sqrt(1 - 2 zeta^2 + sqrt((1 - 2 zeta^2)^2 + 1)): the same at zeta = 1/sqrt 2.
        damping: zeta, scalar or (n,), 0.001 to 1000.
        delay: [s] dead time of the commanded velocity on its way to the servo, the same for all joints; adds to ``Hardware.delay``.

    Raises:
        BadArgument: a number outside these ranges, or of another shape.
    """

    bandwidth: float | Array
    damping: float | Array = 0.5**0.5
    delay: float | None = None

    def __post_init__(self) -> None:
        for name, low, high, unit in (("bandwidth", SLOWEST, FASTEST, " rad/s"), ("damping", 1e-3, 1e3, "")):
            given = checks.array(f"servo.{name}", getattr(self, name))
            if given.ndim > 1 or given.size == 0 or np.any(given < low) or np.any(given > high):
                raise BadArgument(f"servo.{name}", getattr(self, name), f"a scalar or (n,) array, {low:g} to {high:g}{unit}")
            object.__setattr__(self, name, float(given) if given.ndim == 0 else given)
        if self.delay is not None:
            object.__setattr__(self, "delay", _positive_or_none("servo.delay", self.delay))

    @property
    def natural_frequency(self) -> float | Array:
        """w [rad/s], scalar or (n,)."""
        a = 1 - 2 * np.square(self.damping)
        root = np.hypot(a, 1.0)
        w = np.asarray(self.bandwidth / np.sqrt(np.where(a > 0, a + root, 1 / (root + np.abs(a)))), float)
        return float(w) if w.ndim == 0 else w


@dataclass(frozen=True, eq=False)
class Hardware:
    """Imperfections of a real control loop; None (or 0) turns one off.

    Lags act on the commanded torque (velocity), filters on the measured signals. Both are of first order: T y' = u - y.
    ``delay`` is the dead time of each commanded torque (velocity for velocity laws), ``force_delay`` that of the measured wrench. With
    ``sample_time`` the law runs once per sample, and the torque is held in between (zero-order hold). The law's own states
    (integrals, filters, LTI outer loops) then advance exactly, with their inputs held over the sample.

    Two rules describe a sampled controller as it is coded. ``integral_rule`` says how it sums its integrals: "forward" (the input held over
    the sample), "backward" or "tustin". With ``derivative_rule`` the velocity is the difference of the encoder over a sample, through
    ``velocity_filter`` by that rule; None: the velocity is measured. "forward" and "tustin" need the filter.

    Elastic joints (Spong's model): K (theta - q) + D (theta' - q') drives the link, the motor obeys
    B theta'' + K (theta - q) + D (theta' - q') = tau. ``feedback`` selects the encoder position.

    The limits and the dead band act in simulation; the linear model has their slope at the operating point, 1 or 0. The measured wrench, after its
    filter, is cut at ``force_limit`` and then moved towards 0 by ``force_deadband``: sign(F) max(min(abs(F), limit) - deadband, 0), per component.

    Raises:
        BadArgument: a field is negative, not finite, neither a scalar nor (n,), or out of range. Times that are on are 1e-9 to 1e9 s, other fields
            1e-12 to 1e15.
    """

    torque_lag: float | Array | None = None  #: [s] time constant of the torque loop, scalar or (n,)
    velocity_lag: float | Array | None = None  #: [s] time constant of the velocity loop under a velocity law, scalar or (n,)
    servo: Servo | None = None  #: the arm's own servo under a velocity law; after the velocity lag
    delay: float | None = None  #: [s] dead time of the commanded torque (velocity), the same for all joints
    force_delay: float | None = None  #: [s] dead time of the measured wrench
    sample_time: float | None = None  #: [s] of a sampled controller; None: a continuous one
    force_filter: float | None = None  #: [s] time constant of the filter of the measured wrench
    velocity_filter: float | Array | None = None  #: [s] time constant of the filter of the measured velocity, scalar or (n,)
    joint_stiffness: float | Array | None = None  #: [Nm/rad] of the gears of elastic joints, scalar or (n,)
    joint_damping: float | Array | None = None  #: [Nm s/rad] of the same, scalar or (n,)
    motor_inertia: float | Array | None = None  #: [kg m^2] on the link side of the gear, scalar or (n,)
    torque_limit: float | Array | None = None  #: [Nm] of the commanded torque, scalar or (n,)
    velocity_limit: float | Array | None = None  #: [rad/s] of the commanded velocity, scalar or (n,)
    force_limit: float | Array | None = None  #: [N, Nm] of the measured wrench, scalar or (6,)
    force_deadband: float | Array | None = None  #: [N, Nm] of the measured wrench, scalar or (6,); components may be 0
    feedback: Literal["motor", "link"] = "motor"  #: where the encoder of an elastic joint is
    integral_rule: Rule = "forward"  #: how a sampled controller sums its integrals: "forward", "backward" or "tustin"
    derivative_rule: Rule | None = None  #: of the velocity of a sampled controller from its encoder; None: measured

    def __post_init__(self) -> None:
        for f in fields(self):
            given = getattr(self, f.name)
            if f.name in CHOICES:
                if given is not None or f.default is not None:
                    checks.choice(f"hardware.{f.name}", given, CHOICES[f.name])
            elif f.name == "servo":
                if given is not None:
                    checks.instance("servo", given, Servo, "a Servo, such as mfc.Servo(bandwidth=50)")
            elif given is not None:
                object.__setattr__(self, f.name, _positive_or_none(f.name, given))
        if (self.joint_stiffness is None) != (self.motor_inertia is None):
            got = (self.joint_stiffness, self.motor_inertia)
            raise BadArgument("joint_stiffness, motor_inertia", got, "both or neither: an elastic joint needs both")
        if self.joint_damping is not None and self.joint_stiffness is None:
            raise BadArgument("joint_damping", self.joint_damping, "joint_stiffness= and motor_inertia= with it")
        if not self.sample_time and (self.integral_rule, self.derivative_rule) != ("forward", None):
            rules = (self.integral_rule, self.derivative_rule)
            raise BadArgument("hardware.integral_rule, hardware.derivative_rule", rules, "sample_time= with them: they are rules of sampled code")
        if self.derivative_rule not in (None, "backward") and self.velocity_filter is None:
            takes = "velocity_filter= with it; only the backward difference needs none"
            raise BadArgument("hardware.derivative_rule", self.derivative_rule, takes)
        for name, late in (("delay", self.command_delay), ("force_delay", self.force_delay)):
            if late and self.sample_time and late > MOST_SAMPLES * self.sample_time:
                takes = f"at most {MOST_SAMPLES} sample times of {self.sample_time:g} s: each delayed sample is a state of the discrete model"
                raise BadArgument(f"hardware.{name}", late, takes)

    @property
    def ideal(self) -> bool:
        """True if every imperfection is off."""
        return all(getattr(self, f.name) is None for f in fields(self) if f.name not in CHOICES)

    def every(self, sample_time: float | None) -> Hardware:
        """The same hardware with this ``sample_time`` [s]; None: continuous, without the rules of sampled code."""
        if not sample_time:
            return replace(self, sample_time=None, integral_rule="forward", derivative_rule=None)
        return replace(self, sample_time=sample_time)

    @property
    def elastic(self) -> bool:
        """True if the joints are elastic."""
        return self.joint_stiffness is not None

    @property
    def command_delay(self) -> float:
        """[s] dead time of the command: ``delay`` and that of the servo."""
        return (self.delay or 0.0) + ((self.servo.delay or 0.0) if self.servo is not None else 0.0)

    @property
    def dead_time(self) -> str:
        """The dead times that a linear model without them leaves out, in words; "" if there are none, or a sample time, which includes them."""
        late = ((self.command_delay, ""), (self.force_delay, " of the force sensor"))
        return "" if self.sample_time else " and ".join(f"{T:g} s{of}" for T, of in late if T)

    def for_joints(self, n: int) -> JointHardware:
        """The same hardware with one entry for each of n joints. Raises BadArgument where a field has another shape."""

        def each(name: str, given: float | Array | None) -> Array | None:
            return None if given is None else checks.per_joint(f"hardware.{name}", given, n)

        stiffness, inertia = each("joint_stiffness", self.joint_stiffness), each("motor_inertia", self.motor_inertia)
        damping = each("joint_damping", self.joint_damping)
        springs = None
        if stiffness is not None and inertia is not None:
            springs = Springs(stiffness, np.zeros(n) if damping is None else damping, inertia, self.feedback == "motor")
        sensor = (("force_limit", self.force_limit), ("force_deadband", self.force_deadband))
        servo = None
        if self.servo is not None:
            damping = checks.per_joint("hardware.servo.damping", self.servo.damping, n)
            checks.per_joint("hardware.servo.bandwidth", self.servo.bandwidth, n)
            servo = JointServo(checks.per_joint("hardware.servo", self.servo.natural_frequency, n), damping)
        return JointHardware(
            each("torque_lag", self.torque_lag),
            each("velocity_lag", self.velocity_lag),
            each("velocity_filter", self.velocity_filter),
            servo,
            each("torque_limit", self.torque_limit),
            each("velocity_limit", self.velocity_limit),
            springs,
            *(None if given is None else checks.per_joint(f"hardware.{name}", given, 6) for name, given in sensor),
        )


@dataclass(frozen=True, eq=False)
class Springs:
    """Elastic joints."""

    stiffness: Array  #: (n,) [Nm/rad]
    damping: Array  #: (n,) [Nm s/rad]
    motor_inertia: Array  #: (n,) [kg m^2]
    motor_encoder: bool  #: True: encoder on the motor; False: on the link


@dataclass(frozen=True, eq=False)
class JointServo:
    """Servos of the joints."""

    frequency: Array  #: (n,) [rad/s] natural
    damping: Array  #: (n,)


@dataclass(frozen=True, eq=False)
class JointHardware:
    """Hardware of each of n joints, and of the force sensor; None: off."""

    torque_lag: Array | None  #: (n,) [s]
    velocity_lag: Array | None  #: (n,) [s]
    velocity_filter: Array | None  #: (n,) [s]
    servo: JointServo | None
    torque_limit: Array | None  #: (n,) [Nm]
    velocity_limit: Array | None  #: (n,) [rad/s]
    springs: Springs | None
    force_limit: Array | None  #: (6,) [N, Nm]
    force_deadband: Array | None  #: (6,) [N, Nm]

    def sensed(self, F: Vector) -> Vector:
        """(..., 6) the measured wrench with its saturation and dead band."""
        if self.force_limit is None and self.force_deadband is None:
            return F
        low = np.zeros(6) if self.force_deadband is None else self.force_deadband
        high = np.full(6, np.inf) if self.force_limit is None else self.force_limit
        return elementwise(
            F,
            lambda f: np.sign(f) * np.maximum(np.minimum(np.abs(f), high) - low, 0.0),
            lambda f: np.where(((np.abs(f) > low) | (low == 0)) & (np.abs(f) < high), 1.0, 0.0),
        )


TIMES = ("torque_lag", "velocity_lag", "delay", "servo.delay", "force_delay", "sample_time", "force_filter", "velocity_filter")  #: [s]
SCALARS = ("delay", "servo.delay", "force_delay", "sample_time", "force_filter")  #: the same for all joints


def _positive_or_none(name: str, given: ArrayLike) -> Any:
    alone = name in SCALARS
    low, high, unit = (SHORTEST, LONGEST, " s") if name in TIMES else (SMALLEST, LARGEST, "")
    shape = "(6,)" if name.startswith("force_") else "(n,)"
    takes = f"{'one number' if alone else f'a scalar or {shape} array'}, positive, {low:g} to {high:g}{unit}; None or 0 turns it off"
    out = checks.array(f"hardware.{name}", given)
    low = 0.0 if name == "force_deadband" else low
    if out.ndim > (0 if alone else 1) or (out.any() and (np.any(out < low) or np.any(out > high))):
        raise BadArgument(f"hardware.{name}", given, takes)
    if not out.any():
        return None
    return float(out) if out.ndim == 0 else out
