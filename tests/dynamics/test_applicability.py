"""Hardware and surfaces that a loop has no place for are refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.errors import Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold


@pytest.mark.parametrize(("law", "hardware", "field"), [
    (L.VelocityP(1.0), {"torque_lag": 1e-3}, "torque_lag"), (L.VelocityP(1.0), {"velocity_filter": 1e-3}, "velocity_filter"),
    (L.VelocityP(1.0), {"joint_stiffness": 1e3, "motor_inertia": 1.0}, "joint_stiffness"), (L.VelocityP(1.0), {"torque_limit": 3.0}, "torque_limit"),
    (L.JointPID(1.0), {"velocity_lag": 1e-3}, "velocity_lag"), (L.JointPID(1.0), {"force_filter": 1e-3}, "force_filter"),
    (L.JointPID(1.0), {"force_delay": 1e-3}, "force_delay"), (L.OpenLoopForce(np.zeros(6)), {"force_delay": 1e-3}, "force_delay"),
    (L.JointPID(1.0), {"servo": Servo(50.0)}, "servo"), (L.JointPID(1.0), {"velocity_limit": 1.0}, "velocity_limit"),
    (L.JointPID(1.0), {"force_limit": 9.0}, "force_limit"), (L.JointImpedance(1.0, 1.0), {"force_deadband": 1.0}, "force_deadband"),
    (L.TorqueFeedforward("printed"), {"delay": 1e-3}, "hardware"), (L.TorqueFeedforward("printed"), {"sample_time": 1e-3}, "hardware"),
])  # fmt: skip
def test_hardware_that_a_loop_has_no_place_for_is_refused(law: L.Law, hardware: dict, field: str) -> None:
    with pytest.raises(Unsupported) as info:
        ClosedLoop(robots.single_joint(), law, Hold([0.4]), hardware=Hardware(**hardware))
    assert field in info.value.argument


def test_a_position_loop_that_no_force_reaches_has_no_wall() -> None:
    with pytest.raises(Unsupported, match="Admittance"):
        ClosedLoop(robots.slider(1.0), L.VelocityP(1.0), Hold([0.0]), environment=Environment(100.0), hardware=Hardware(servo=Servo(50.0)))
