"""Steps of every reference channel to its own coordinate: joints, tool axes, resisted force axes."""

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.linearization.tracking_steps import step_metrics
from mfc_analysis.requirements.requirements import Requirements
from tests.requirements.test_requirements import pressing, second_order

Q = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])


def test_tool_steps_of_an_exact_model_are_those_of_the_polynomial():
    q = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])
    robot = mfc.robots.ur5()
    law = mfc.laws.TaskComputedTorque(kp=100.0, kd=10.0)  # zeta 0.5, and the numerator kd s + kp
    loop = mfc.ClosedLoop(robot, law, mfc.trajectories.ToolHold(robot.pose(q)), q_start=q)
    tool = Requirements(overshoot=0.1, settling_time=1).check(loop, [0.0])
    joint = Requirements(overshoot=0.1, settling_time=1).check(second_order(0.5, 10.0), [0.0])
    for name in ("overshoot", "settling_time"):
        assert tool.line(name).found == pytest.approx(joint.line(name).found, rel=1e-6)
    assert tool.line("overshoot").where.startswith("X_")


def test_force_steps_are_taken_on_the_axes_that_a_surface_resists():
    verdict = Requirements(overshoot=1.0).check(pressing(), [0.0])
    assert verdict.line("overshoot").where == "F_fz"


def test_loop_steps_at_the_force_sensor_are_taken_on_the_axes_that_a_surface_resists():
    """fx and fy are sensed through the damping of the surface alone; the tool slides there, and their loops have no final value."""
    found = step_metrics(hybrid().linearize([0.0]), "loop", "force")
    assert found.channels == ("fz",) and np.isfinite(found.settling).all() and found.settling.shape == (1, 1)


def hybrid(**hardware):
    robot = mfc.robots.ur5()
    law = mfc.laws.HybridMotionForce([0, 0, 10, 0, 0, 0], kp=100.0, kd=20.0, kfp=1.0, kfi=2.0, kdamp=50.0, constraints=np.eye(6)[2:3])
    return mfc.ClosedLoop(
        robot.with_payload(1.0),
        law,
        mfc.trajectories.ToolHold(robot.pose(Q)),
        controller_model=robot,
        environment=mfc.Environment(1e4, damping=10.0, preload=10.0),
        q_start=Q,
        hardware=mfc.Hardware(**hardware) if hardware else None,
    )


HYBRID_HARDWARE = [
    {},
    {"delay": 2e-3},
    {"sample_time": 1e-3, "delay": 1e-3, "torque_lag": 2e-3, "velocity_filter": 1e-3},
]


@pytest.mark.parametrize("hardware", HYBRID_HARDWARE, ids=lambda h: ", ".join(h) or "ideal")
def test_hybrid_loops_step_in_their_motion_and_force_axes_and_their_idle_integrals_are_not_roots_that_slide(hardware):
    """Integrals of axes that nothing presses on lie at zero: with dead time they were judged, with sampling taken for a ramp."""
    verdict = Requirements(settling_time=1.0, overshoot=0.4, damping_ratio=0.3).check(hybrid(**hardware), [0.0])
    assert verdict.evidence.steps.channels == ("X_vx", "X_vy", "X_wx", "X_wy", "X_wz", "F_fz")
    assert verdict.line("stable").found == pytest.approx(-1.0, rel=0.05)
    for name in ("settling_time", "overshoot", "damping_ratio"):
        assert verdict.line(name).status == "PASS"
