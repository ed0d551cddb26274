"""Independent joints on the arm: the coupled loop against the loop of the whole library, and dead time in all joints at once."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, MfcWarning
from mfc_analysis.gains.joints import STRIDE, coupled_loop, motion
from mfc_analysis.laws import JointPID
from mfc_analysis.robots import planar_2r, single_joint, ur5
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import Hold, Quintic, Sinusoid, ToolHold
from mfc_analysis.units import hertz
from tests.conftest import arm, plant, regular_pose

FOLDED = np.array([-2.2, 0.6, 0.9, -1.2, -0.7, 2.5, 2.5])  # of the Panda: M_jj (M^-1)_jj reaches 14


def quiet(robot: Robot, q: object, **asked: float) -> mfc.gains.Gains:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MfcWarning)
        return mfc.gains.joint_pid(robot, q, **asked)


def loop(robot: Robot, q: np.ndarray, g: mfc.gains.Gains, **hardware: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(robot, JointPID(**g), Hold(q), hardware=mfc.Hardware(**hardware) if hardware else None)


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 2e-3}, {"delay": 1e-3}, {"torque_lag": 1e-3, "delay": 2e-3}], ids=str)
@pytest.mark.parametrize("name", ["ur5", "panda", "kinova", "single_joint"])
def test_at_a_pose_the_margins_are_those_of_the_closed_loop_of_9_8(name: str, hardware: dict[str, float]) -> None:
    robot, q = plant(name), regular_pose(name)
    g = quiet(robot, q, bandwidth=hertz(4), **hardware)
    found, want = g.coupled.margins, loop(robot, q, g, **hardware).linearize([0.0]).margins()
    assert found.channels == want.channels and found.at == "torque" and bool(found.stable[0]) == bool(want.stable[0]) == g.coupled.stable
    for metric in ("phase_deg", "delay", "gain_increase", "gain_reduction", "sensitivity_peak"):
        assert_allclose(getattr(found, metric), getattr(want, metric), rtol=1e-6)


@pytest.mark.parametrize("name", ["ur5", "planar_2r"])
def test_along_a_trajectory_the_loop_is_linearised_about_the_moving_arm(name: str) -> None:
    robot, q = plant(name), regular_pose(name)
    ref = Quintic(q, q + 0.5, 0.6)
    g = quiet(robot, ref, natural_frequency=12.0)
    times = np.linspace(0, 0.6, 401)[::STRIDE]
    want = mfc.ClosedLoop(robot, JointPID(**g), ref).linearize(times).margins()
    assert_allclose(g.coupled.margins.times, times)
    for metric in ("phase_deg", "delay", "gain_reduction"):
        assert_allclose(getattr(g.coupled.margins, metric), getattr(want, metric), rtol=1e-6)
    still = quiet(robot, ref(times).q, natural_frequency=12.0).coupled.margins
    assert np.abs(still.phase_deg - want.phase_deg).max() > 1e-3  # the speed matters
    assert "t = " in str(g) and "pose 4" in str(quiet(robot, np.array([q, q, q, q, q + 0.4]), natural_frequency=12.0).coupled).replace(
        "pose 0", "pose 4"
    )


@pytest.mark.parametrize("lag", [0.0, 1e-3])
@pytest.mark.parametrize(("name", "q"), [("panda", FOLDED), ("ur5", [0.1, -1.2, 1.4, -0.8, 1.3, 0.2]), ("planar_2r", [0.2, 0.5])])
def test_the_arm_is_stable_just_below_the_common_dead_time_and_unstable_just_above(name: str, q: list[float], lag: float) -> None:
    robot, q = arm(name), np.asarray(q)
    g = quiet(robot, q, bandwidth=hertz(4), torque_lag=lag)
    (limit,) = g.coupled.common_delay
    more = {"torque_lag": lag} if lag else {}
    for share, stable in ((0.999, True), (1.001, False)):
        assert bool(loop(robot, q, g, delay=share * limit, **more).linearize([0.0]).stable[0]) is stable
        again = quiet(robot, q, bandwidth=hertz(4), torque_lag=lag, delay=share * limit)
        assert again.coupled.stable is stable and ("UNSTABLE" in str(again)) is not stable
        assert np.isnan(again.coupled.common_delay[0]) == (not stable)
    part = quiet(robot, q, bandwidth=hertz(4), torque_lag=lag, delay=0.4 * limit).coupled.common_delay
    assert_allclose(part, 0.6 * limit, rtol=1e-6)


def test_four_hertz_on_an_arm_without_rotors_is_unstable_with_four_milliseconds_of_dead_time_and_with_rotors_stable() -> None:
    """Each joint alone has 71 degrees; the coupled arm's margins of one joint at a time don't tell either."""
    robot = arm("panda")
    with pytest.warns(MfcWarning, match="lacks rotor inertia; give armature"):
        g = mfc.gains.joint_pid(robot, FOLDED, bandwidth=hertz(4), delay=4e-3)
    assert_allclose(g.achieved.phase_deg, 71.25, atol=0.01)
    assert not g.coupled.stable
    assert "UNSTABLE with the loops of all joints closed (dead time 4 ms)\n          joints 1 (panda_joint1) and 3 (panda_joint3): root +" in str(
        g
    ) and "alone:    bandwidth 25.13" in str(g)
    without = quiet(robot, FOLDED, bandwidth=hertz(4)).coupled
    assert without.stable and without.common_delay[0] < 4e-3 < without.margins.delay.min()
    geared = quiet(robot.with_armature(0.3), FOLDED, bandwidth=hertz(4), delay=4e-3)
    assert geared.coupled.stable and geared.coupled.common_delay[0] > 8e-3
    run = loop(robot, FOLDED, g, delay=4e-3).simulate(0.5, np.full(7, 1e-4))
    assert np.abs(run.error[-1]).max() > 10 * np.abs(run.error[0]).max() or run.diverged


def test_one_joint_has_its_own_dead_time_and_the_same_figures_alone_and_coupled() -> None:
    robot = single_joint(inertia=0.5, damping=0.1)
    g = mfc.gains.joint_pid(robot, [np.pi / 2], bandwidth=20.0)
    assert_allclose(g.coupled.common_delay, g.coupled.margins.delay[:, 0], rtol=1e-9)
    assert "Ms" in str(g.coupled) and "pose" not in str(g.coupled)


def test_the_motion_says_where_the_inertia_is_largest() -> None:
    robot = planar_2r()
    ref = Sinusoid(center=[0.0, 1.0], amplitude=[0.0, 1.5], frequency=2.0)  # the elbow passes 0
    along, at, over = motion(robot, ref), motion(robot, [0.0, 1.0]), motion(robot, np.array([[0.0, 1.0], [0.0, 0.0]]))
    straight = np.diag(robot.mass(np.zeros(2)))
    assert_allclose(along.largest, straight, rtol=1e-9)
    assert_allclose(over.largest, straight, rtol=1e-12)
    assert_allclose(at.largest, at.smallest)
    assert along.moving and np.abs(along.v).max() == pytest.approx(3.0, rel=1e-4) and not over.v.any()
    assert (at.place(0), over.place(1)) == ("", "pose 1") and along.place(0) == "t = 0 s"
    assert motion(robot, Hold([0.0, 1.0])).q.shape == (1, 2)
    with pytest.raises(BadArgument, match="from_tool_path"):
        motion(ur5(), ToolHold(np.eye(4)))


@pytest.mark.parametrize(("what", "given"), [("delay", -1e-3), ("torque_lag", np.nan)])
def test_bad_hardware_is_named(what: str, given: float) -> None:
    with pytest.raises(BadArgument, match=what):
        mfc.gains.joint_pid(planar_2r(), [0.2, 0.5], bandwidth=5.0, **{what: given})


def test_the_gains_with_their_loop_pickle() -> None:
    g = mfc.gains.joint_pid(planar_2r(), [0.2, 0.5], bandwidth=5.0)
    assert str(pickle.loads(pickle.dumps(g))) == str(g)
    made = coupled_loop(planar_2r(), g, motion(planar_2r(), [0.2, 0.5]))
    assert made.system.state_names[:2] == ("q_joint1", "q_joint2") and repr(made) == str(g.coupled)
