"""The port of a robot's loop, against the closed loop's own matrices, and between its two ends."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument
from tests.conftest import LAWS, Case, arm, loop_of, named, regular_pose

W = np.array([0.1, 3.0, 50.0, 2000.0])


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 3e-3, "joint_stiffness": 1e4, "joint_damping": 5.0, "motor_inertia": 0.3}], ids=["", "soft"])
@pytest.mark.parametrize("case", [case for case in LAWS if case.law(6).plant == "torque"], ids=str)
def test_at_the_joints_it_is_the_rate_under_the_disturbance(case: Case, hardware: dict[str, float]) -> None:
    """jw times the q that the closed loop makes of its disturbance: its A, B, C, whatever the law, on a moving path and in contact."""
    if hardware and case.law(6).needs_acceleration:
        hardware = {"torque_lag": 3e-3}
    lin = loop_of(case, "ur5", contact=True, hardware=mfc.Hardware(**hardware)).linearize([0.0, 0.4], coordinates="state")
    pushed, moved = (
        [i for i, name in enumerate(names) if name.startswith(start)] for names, start in ((lin.input_names, "disturbance"), (lin.output_names, "q_"))
    )
    s = 1j * W[:, None, None]
    x = np.linalg.solve(s * np.eye(lin.A.shape[1]) - lin.A[:, None], lin.B[:, None, :, pushed].astype(complex))
    found = lin.port(W, at="joints").admittance
    assert_allclose(found, s * (lin.C[:, None, moved] @ x), rtol=1e-6, atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize("late", [{}, {"delay": 2e-3}, {"sample_time": 2e-3, "delay": 1e-3}], ids=["", "delay", "sampled"])
@pytest.mark.parametrize("name", ["planar_2r", "ur5", "panda"])
def test_without_a_force_sensor_the_tool_is_the_joints_seen_through_the_jacobian(name: str, late: dict[str, float]) -> None:
    robot, q = arm(name), regular_pose(name)
    lin = mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(90.0, 40.0, 18.0), mfc.trajectories.Hold(q), hardware=mfc.Hardware(**late)).linearize()
    J = robot.jacobian(q)
    assert_allclose(lin.port(W).admittance[0], J @ lin.port(W, at="joints").admittance[0] @ J.T, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("case", named("9.16 standard", "9.24 dynamic standard"), ids=str)
@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_it_does_not_depend_on_the_coordinates(case: Case, sample_time: float | None) -> None:
    loop = mfc.ClosedLoop(arm("ur5"), case.law(6), mfc.trajectories.Hold(regular_pose("ur5")), hardware=mfc.Hardware(sample_time=sample_time))
    error, state = (loop.linearize(coordinates=c).port(W).admittance for c in ("error", "state"))
    assert_allclose(error, state, rtol=1e-9)


def test_an_arm_whose_velocity_is_commanded_does_not_give_way() -> None:
    lin = mfc.ClosedLoop(arm("ur5"), mfc.laws.VelocityP(4.0), mfc.trajectories.Hold(regular_pose("ur5"))).linearize()
    for at in ("tool", "joints"):
        assert not lin.port(W, at=at).admittance.any()


@pytest.mark.parametrize("given", [[0.0], [1.0, -1.0], [np.nan], "1"])
def test_frequencies_are_positive(given: object) -> None:
    lin = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(1.0, None, 1.0), mfc.trajectories.Hold([0.0])).linearize()
    with pytest.raises(BadArgument, match="frequencies"):
        lin.port(given)  # type: ignore[arg-type]


def test_another_port_is_named() -> None:
    lin = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(1.0, None, 1.0), mfc.trajectories.Hold([0.0])).linearize()
    with pytest.raises(BadArgument, match="'tool', 'joints'"):
        lin.port([1.0], at="torque")
