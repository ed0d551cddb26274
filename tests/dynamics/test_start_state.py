"""Where a run starts: errors asked for are there, integrals and actuators as given, and hardware in its static balance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.start_state import start_state
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.trajectories import Hold, Sinusoid, ToolHold
from tests.conftest import arm, moving, plant, regular_pose

JOINT = robots.single_joint()


def start(loop: ClosedLoop, t: float = 0.0, **given: Any) -> dict[str, np.ndarray]:
    """The start by slots."""
    return loop.equations.split(start_state(loop.equations, t, **given))


def planar(*, ki: float | None = 40.0, **hardware: Any) -> ClosedLoop:
    return ClosedLoop(plant("planar_2r"), L.JointPID(300.0, ki, 50.0), moving("planar_2r"), hardware=Hardware(**hardware))


def tool_velocity() -> ClosedLoop:
    q = regular_pose("ur5")
    return ClosedLoop(arm("ur5"), L.TaskVelocity(3.0), ToolHold(arm("ur5").pose(q)), q_start=q)


# --- errors ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [0.0, 0.7])
@pytest.mark.parametrize("error", [0.1, [0.1, -0.2]])
def test_an_initial_error_is_that_of_the_joints_at_the_start(error: Any, t: float) -> None:
    loop = planar()
    found = start(loop, t, initial_error=error)
    assert_allclose(loop.ref(t).q - found["q"], np.broadcast_to(error, 2), atol=1e-12)
    assert_allclose(found["v"], loop.ref(t).v)


def test_an_initial_error_of_a_tool_law_is_its_pose_error() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(arm("ur5"), L.TaskComputedTorque(90.0, kd=18.0), ToolHold(arm("ur5").pose(q)), q_start=q)
    X_e = np.array([0.02, -0.01, 0.03, 0.2, -0.1, 0.3])
    found = start(loop, initial_error=X_e)
    assert_allclose(arm("ur5").pose(found["q"]) @ exp6(X_e), arm("ur5").pose(q), atol=1e-9)
    assert_allclose(loop.equations.flow(0.0, loop.equations.join(found)).error, X_e, atol=1e-9)


@pytest.mark.parametrize(("turn", "taken"), [(np.pi - 2e-3, True), (np.pi - 5e-4, False), (3.2, False)])
def test_a_pose_error_is_less_than_half_a_turn(turn: float, taken: bool) -> None:
    loop = tool_velocity()
    error = [0, 0, 0, 0, 0, turn]
    if taken:
        x = loop.equations.join(start(loop, initial_error=error))
        assert_allclose(loop.equations.flow(0.0, x).error, error, atol=1e-7)
        return
    with pytest.raises(BadArgument) as info:
        start(loop, initial_error=error)
    assert info.value.argument == "initial_error"


def test_a_pose_error_beyond_all_reach_is_refused() -> None:
    with pytest.raises(BadArgument) as info:
        start(tool_velocity(), initial_error=1e300)
    assert info.value.argument == "initial_error"


def test_a_position_given_takes_the_place_of_an_error() -> None:
    assert_allclose(start(planar(), q=[0.3, 0.4], initial_error=0.5)["q"], [0.3, 0.4])


# --- integrals and actuators -------------------------------------------------------------------------------------------------


def test_a_start_can_be_given_state_by_state() -> None:
    loop = planar(torque_lag=0.02, velocity_filter=0.01)
    given = {"q": [0.3, 0.4], "v": [0.5, -0.6], "integral": [1.0, 2.0], "actuator": [7.0, -8.0]}
    assert_allclose(start_state(loop.equations, 0.0, **given), [0.3, 0.4, 0.5, -0.6, 1.0, 2.0, 0.5, -0.6, 7.0, -8.0])
    force = ClosedLoop(robots.slider(), L.ForcePI([0, 0, 5.0, 0, 0, 0], 1.0, 2.0), Hold([0.0]))
    assert_allclose(start(force, force_integral=3.0)["z_f"], 3.0)


def test_an_actuator_starts_at_the_torque_commanded_as_far_as_it_can_give_it() -> None:
    loop = planar(torque_lag=0.02)
    found = start(loop, q=[0.3, 0.4])
    command = 300.0 * (loop.ref(0.0).q - found["q"]) + 50.0 * (loop.ref(0.0).v - found["v"])  # 9.8 with z = 0
    assert_allclose(found["lag"], command, rtol=1e-12)
    limit = 0.5 * np.abs(command).min()
    assert_allclose(start(planar(torque_lag=0.02, torque_limit=limit), q=[0.3, 0.4])["lag"], np.sign(command) * limit)


def test_a_trimmed_integral_is_that_of_the_operating_point() -> None:
    loop = planar()
    point = loop.equations.split(loop.linearize([0.4]).point.x[0])
    trimmed = start(loop, 0.4, integral="trimmed")
    for name in ("q", "v", "z"):
        assert_allclose(trimmed[name], point[name])
    assert np.abs(trimmed["z"]).min() > 0.01 and not start(loop, 0.4)["z"].any()


def test_a_run_begins_at_the_start_state() -> None:
    loop = planar(torque_lag=0.02)
    x = start_state(loop.equations, 0.0, 0.1, integral=2.0)
    assert_allclose(loop.simulate([0.0, 0.01], 0.1, integral=2.0).x[0], x)
    assert_allclose(loop.simulate([0.0, 0.01], x=x).q, loop.simulate([0.0, 0.01], 0.1, integral=2.0).q)


# --- hardware and contact ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_the_springs_of_elastic_joints_carry_the_weight_at_the_start(feedback: str) -> None:
    loop = ClosedLoop(
        plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), Hold(regular_pose("planar_2r")),
        hardware=Hardware(joint_stiffness=[800.0, 500.0], joint_damping=2.0, motor_inertia=0.2, velocity_filter=0.01, feedback=feedback),
    )  # fmt: skip
    found = start(loop, initial_error=0.1)
    assert_allclose((found["theta"] - found["q"]) * [800.0, 500.0], loop.robot.gravity(found["q"]), rtol=1e-9)
    rates = loop.equations.flow(0.0, loop.equations.join(found)).rates
    assert_allclose(rates["v"], 0.0, atol=1e-9)  # the links rest until the motors move
    assert_allclose(rates["v_filter"], 0.0, atol=1e-12)


def test_springs_carry_the_inertia_of_a_moving_reference_too() -> None:
    robot = robots.single_joint(gravity=0.0, damping=0.0)
    loop = ClosedLoop(robot, L.JointPID(30.0, kd=5.0), Sinusoid([0.1], 0.4, 2.0), hardware=Hardware(joint_stiffness=400.0, motor_inertia=0.1))
    found = start(loop, 0.5)
    assert_allclose(400.0 * (found["theta"] - found["q"]), robot.mass(found["q"])[0] * loop.ref(0.5).a, rtol=1e-9)
    assert_allclose(found["omega"], found["v"])


def test_a_filter_of_the_force_starts_at_the_force() -> None:
    wall = Environment(2000.0, 5.0, pose=np.eye(4), axes="z", preload=3.0)
    law = L.ForcePI([0, 0, 5.0, 0, 0, 0], 1.0, 2.0)
    loop = ClosedLoop(robots.slider(), law, Hold([0.0]), environment=wall, hardware=Hardware(force_filter=0.01))
    found = start(loop, q=[0.004], v=[0.2])
    assert_allclose(found["F_filter"], [0, 0, 2000.0 * 0.004 + 5.0 * 0.2 + 3.0, 0, 0, 0])


# --- what is refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("given", "argument"), [
    ({"initial_error": [1.0, 2.0, 3.0]}, "initial_error"), ({"initial_error": np.nan}, "initial_error"),
    ({"initial_error": np.ones((2, 2))}, "initial_error"),
    ({"q": [1.0]}, "q"), ({"v": [np.inf, 0]}, "v"), ({"integral": [1.0, 2.0, 3.0]}, "integral"), ({"integral": "full"}, "integral"),
    ({"actuator": [1.0, 2.0]}, "actuator"), ({"force_integral": 1.0}, "force_integral"),
])  # fmt: skip
def test_a_start_that_cannot_be_is_refused_by_name(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        start(planar(), **given)
    assert info.value.argument == argument


@pytest.mark.parametrize(("given", "argument"), [
    ({"integral": 1.0}, "integral"), ({"integral": np.nan}, "integral"), ({"integral": "full"}, "integral"),
    ({"force_integral": 1.0}, "force_integral"), ({"force_integral": np.nan}, "force_integral"),
])  # fmt: skip
def test_an_integral_that_the_law_does_not_have_starts_at_nothing_but_zero(given: dict, argument: str) -> None:
    loop = planar(ki=None)
    with pytest.raises(BadArgument) as info:
        start(loop, **given)
    assert info.value.argument == argument
    assert set(start(loop, integral="trimmed", force_integral=0.0)) == set(start(loop, integral=np.zeros(2))) == {"q", "v"}


def test_a_velocity_law_has_no_velocity_to_start_with() -> None:
    with pytest.raises(BadArgument) as info:
        start(ClosedLoop(JOINT, L.VelocityP(1.0), Hold([0.0])), v=[1.0])
    assert info.value.argument == "v" and "VelocityP" in info.value.takes
