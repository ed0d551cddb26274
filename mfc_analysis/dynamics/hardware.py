"""Hardware between the law and the joints: lag, dead time, sampling, filters, elastic joints, torque limits. All off by default."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.coded import PRESENT, Rule
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array

SHORTEST, LONGEST = 1e-9, 1e9  #: [s] of a lag, a dead time, a filter or a sample time that is on
SMALLEST, LARGEST = 1e-12, 1e15  #: of a stiffness, a damping, an inertia or a torque limit that is on, in its unit
CHOICES = {"feedback": ("motor", "link"), "integral_rule": tuple(PRESENT), "derivative_rule": tuple(PRESENT)}  #: fields that are words
MOST_SAMPLES = 2000  #: largest dead time of a sampled loop, in samples


@dataclass(frozen=True, eq=False)
class Hardware:
    """Imperfections of a real control loop; None (or 0) turns one off.

    Lags act on the commanded torque (velocity), filters on the measured signals. Both are of first order: T y' = u - y.
    ``delay`` is the dead time of each commanded torque (velocity for 9.1-9.5), ``force_delay`` that of the measured wrench. With
    ``sample_time`` the law runs once per sample: the torque is held in between (zero-order hold), and the law's own states
    (integrals, filters, LTI outer loops) advance exactly with their inputs held over the sample.

    A sampled controller as it is coded: ``integral_rule`` is the sum that its integrals are ("forward": the one that holds its input,
    "backward", "tustin"), and with ``derivative_rule`` the velocity is the difference of the encoder over a sample, through
    ``velocity_filter`` by that rule; None: the velocity is measured. "forward" and "tustin" need the filter.

    Elastic joints (Spong's model): K (theta - q) + D (theta' - q') drives the link, the motor obeys
    B theta'' + K (theta - q) + D (theta' - q') = tau. ``feedback`` selects the encoder position.

    Raises:
        BadArgument: a field is negative, not finite, of another shape than a scalar or (n,), or too small or too large to mean anything:
            times that are on are 1e-9 to 1e9 s, other fields 1e-12 to 1e15.
    """

    torque_lag: float | Array | None = None  #: [s] time constant of the torque loop, scalar or (n,)
    velocity_lag: float | Array | None = None  #: [s] time constant of the velocity loop of 9.1-9.5, scalar or (n,)
    delay: float | None = None  #: [s]
    force_delay: float | None = None  #: [s]
    sample_time: float | None = None  #: [s]
    force_filter: float | None = None  #: [s] time constant
    velocity_filter: float | Array | None = None  #: [s] time constant, scalar or (n,)
    joint_stiffness: float | Array | None = None  #: [Nm/rad], scalar or (n,)
    joint_damping: float | Array | None = None  #: [Nm s/rad], scalar or (n,)
    motor_inertia: float | Array | None = None  #: [kg m^2] on the link side of the gear, scalar or (n,)
    torque_limit: float | Array | None = None  #: [Nm], scalar or (n,); acts in simulation
    feedback: Literal["motor", "link"] = "motor"  #: encoder position of an elastic joint
    integral_rule: Rule = "forward"  #: of the integrals of a sampled controller
    derivative_rule: Rule | None = None  #: of the velocity of a sampled controller from its encoder; None: measured

    def __post_init__(self) -> None:
        for f in fields(self):
            given = getattr(self, f.name)
            if f.name in CHOICES:
                if given is not None or f.default is not None:
                    checks.choice(f"hardware.{f.name}", given, CHOICES[f.name])
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
        for name in ("delay", "force_delay"):
            late = getattr(self, name)
            if late and self.sample_time and late > MOST_SAMPLES * self.sample_time:
                takes = f"at most {MOST_SAMPLES} sample times of {self.sample_time:g} s: each delayed sample is a state of the discrete model"
                raise BadArgument(f"hardware.{name}", late, takes)

    @property
    def ideal(self) -> bool:
        """True if every imperfection is off."""
        return all(getattr(self, f.name) is None for f in fields(self) if f.name not in CHOICES)

    def every(self, sample_time: float | None) -> Hardware:
        """The same hardware with this sample time [s]; None: continuous, without the rules of sampled code."""
        if not sample_time:
            return replace(self, sample_time=None, integral_rule="forward", derivative_rule=None)
        return replace(self, sample_time=sample_time)

    @property
    def elastic(self) -> bool:
        """True if the joints are elastic."""
        return self.joint_stiffness is not None

    @property
    def dead_time(self) -> str:
        """The dead times that a linear model without them leaves out, in words; "" if there are none, or a sample time, which includes them."""
        late = ((self.delay, ""), (self.force_delay, " of the force sensor"))
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
        return JointHardware(
            each("torque_lag", self.torque_lag),
            each("velocity_lag", self.velocity_lag),
            each("velocity_filter", self.velocity_filter),
            each("torque_limit", self.torque_limit),
            springs,
        )


@dataclass(frozen=True, eq=False)
class Springs:
    """Elastic joints."""

    stiffness: Array  #: (n,) [Nm/rad]
    damping: Array  #: (n,) [Nm s/rad]
    motor_inertia: Array  #: (n,) [kg m^2]
    motor_encoder: bool  #: True: encoder on the motor; False: on the link


@dataclass(frozen=True, eq=False)
class JointHardware:
    """Hardware of each of n joints; None: off."""

    torque_lag: Array | None  #: (n,) [s]
    velocity_lag: Array | None  #: (n,) [s]
    velocity_filter: Array | None  #: (n,) [s]
    torque_limit: Array | None  #: (n,) [Nm]
    springs: Springs | None


TIMES = ("torque_lag", "velocity_lag", "delay", "force_delay", "sample_time", "force_filter", "velocity_filter")  #: [s]
SCALARS = ("delay", "force_delay", "sample_time", "force_filter")  #: the same for all joints


def _positive_or_none(name: str, given: ArrayLike) -> Any:
    alone = name in SCALARS
    low, high, unit = (SHORTEST, LONGEST, " s") if name in TIMES else (SMALLEST, LARGEST, "")
    takes = f"{'one number' if alone else 'a scalar or (n,) array'}, positive, {low:g} to {high:g}{unit}; None or 0 turns it off"
    out = checks.array(f"hardware.{name}", given)
    if out.ndim > (0 if alone else 1) or (out.any() and (np.any(out < low) or np.any(out > high))):
        raise BadArgument(f"hardware.{name}", given, takes)
    if not out.any():
        return None
    return float(out) if out.ndim == 0 else out
