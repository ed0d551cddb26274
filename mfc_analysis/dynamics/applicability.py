"""What hardware and surfaces apply to a law: the others are refused with a reason."""

from __future__ import annotations

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.errors import Unsupported

TORQUE_ONLY = ("torque_lag", "velocity_filter", "joint_stiffness", "torque_limit", "derivative_rule")
#: field -> what to do instead
VELOCITY_ONLY = {"velocity_lag": "use torque_lag", "servo": "the arm has no inner servo there, use torque_lag", "velocity_limit": "use torque_limit"}
FORCE_ONLY = ("force_delay", "force_filter", "force_deadband", "force_limit")


def refuse_what_does_not_apply(equations: Equations) -> None:
    """Raises Unsupported for hardware or surfaces that do not apply to this loop."""
    hardware, law = equations.hardware, equations.law
    name = type(law).__name__

    def refuse(fields: tuple[str, ...], takes: str) -> None:
        for field in fields:
            if getattr(hardware, field) is not None:
                raise Unsupported(f"hardware.{field}", getattr(hardware, field), takes)

    if law.plant == "velocity":
        refuse(TORQUE_ONLY, f"a law with torque inputs; {name} commands joint velocities (velocity_lag, servo, delay, sample_time apply)")
        if equations.surfaces and not law.senses_force:
            takes = f"a law with torque inputs, or Admittance; under {name} the joints follow the commanded velocity at any contact force"
            raise Unsupported("environment", equations.surfaces[0], takes)
        if equations.actuators.lag is None and equations.actuators.servo is None and any(s.B.any() for s in equations.surfaces):
            takes = "no damping without velocity_lag or servo: the joints then jump to the commanded velocity, and a damper's force with them"
            raise Unsupported("environment.damping", next(s.damping for s in equations.surfaces if s.B.any()), takes)
    else:
        for field, instead in VELOCITY_ONLY.items():
            refuse((field,), f"a law with velocity inputs (9.1-9.5, Admittance); {name} commands torques: {instead}")
    if law.sample_time is not None and hardware.sample_time != law.sample_time:
        takes = f"{law.sample_time:g} s, at which the outer loop of {name} is a difference equation"
        raise Unsupported("hardware.sample_time", hardware.sample_time, takes)
    if law.anti_windup is not None and hardware.sample_time and law.anti_windup < hardware.sample_time:
        takes = f"at least the sample time of {hardware.sample_time:g} s: the integral is taken back once per sample"
        raise Unsupported("law.anti_windup", law.anti_windup, takes)
    if not law.senses_force:
        refuse(FORCE_ONLY, f"a law that measures the force (9.22-9.24, Admittance, an impedance with an inertia); {name} does not")
    if law.needs_acceleration and (hardware.delay is not None or hardware.sample_time is not None):
        takes = f"no delay or sample_time for {name} in this form: its algebraic loop is solved with q'' at the same instant"
        raise Unsupported("hardware", hardware, takes)
