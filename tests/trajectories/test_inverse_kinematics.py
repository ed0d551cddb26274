from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis import errors, robots
from mfc_analysis.maths.se3 import exp6, inverse, log6, transform
from mfc_analysis.trajectories import Hold, ToolCircle, ToolHold, ToolLine, ToolSinusoid, follow, from_tool_path, solve_pose

PLANAR = """<robot name="one"><link name="base"/><link name="tip"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="{length} 0 0"/></joint></robot>"""
START = {
    "ur5": [0, -0.9, 1.6, -0.7, 1.57, 0.3],
    "panda": [0, -0.4, 0.1, -2.2, 0, 2, 0.7],
    "kinova": [0.2, 2.9, 1.3, 4.2, 1.4, 0],
    "xarm7": [0.1, -0.5, 0.2, 0.9, 0.1, 1.2, 0.3],
}


def paths(X):
    return {
        "line": ToolLine(X, X @ exp6(np.array([0.06, 0.05, -0.08, 0.3, -0.2, 0.4])), 2),
        "sinusoid": ToolSinusoid(X, [0.03, 0.05, 0.02], 3, axis=[1, 1, 0], angle=0.2),
        "circle": ToolCircle(X, 0.05, 2.0),
    }


def misses(robot, motion, ref, t):
    """How far pose, twist and its rate of joint motion at times t are from the reference's."""
    q, v, a = motion
    J, asked = robot.jacobian(q), ref(t)
    V = (J @ v[..., None])[..., 0]
    dV = (J @ a[..., None] + robot.jacobian_rate(q, v) @ v[..., None])[..., 0]
    return [np.abs(x).max() for x in (log6(inverse(robot.pose(q)) @ asked.X), V - asked.V, dV - asked.dV)]


@pytest.mark.parametrize("path", ["line", "sinusoid", "circle"])
@pytest.mark.parametrize("name", START)
def test_the_joint_trajectory_carries_the_tool_along_the_path(name, path):
    robot = robots.load(name)
    q0 = np.array(START[name])
    ref = paths(robot.pose(q0))[path]
    t = np.linspace(0, ref.period or 2.0, 21)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", errors.MfcWarning)
        joint = from_tool_path(robot, ref, q0 + 0.01, t)
    assert max(misses(robot, joint(t), ref, t)) < 1e-10
    between = np.linspace(0.013, t[-1] - 0.011, 17)
    pose, twist, rate = misses(robot, joint(between), ref, between)
    assert pose < 1e-8 and twist < 1e-6 and rate < 1e-4
    h = 1e-4
    left, now, right = joint(between - h), joint(between), joint(between + h)
    assert_allclose((right.q - left.q) / (2 * h), now.v, atol=1e-6)
    assert_allclose((right.v - left.v) / (2 * h), now.a, atol=1e-4)
    # the tool is exact; a redundant arm's self-motion is integrated, here over 24 and there over 60 nodes a period
    assert_allclose(follow(robot, ref, joint(0).q, t).q, joint(t).q, atol=1e-6 if robot.n > 6 else 1e-11)


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_many_times_are_followed_exactly(name):
    robot = robots.load(name)
    q0 = np.array(START[name])
    ref = paths(robot.pose(q0))["sinusoid"]
    t = np.linspace(0.5, 3, 101)
    motion = follow(robot, ref, q0, t)
    assert max(misses(robot, motion, ref, t)) < 1e-11
    alone = follow(robot, ref, q0, [t[40]])
    assert_allclose(alone.q[0], motion.q[40], atol=1e-5 if robot.n > 6 else 1e-11)


def test_the_velocity_of_a_redundant_arm_has_no_self_motion_and_its_derivative_is_the_acceleration():
    robot = robots.load("panda")
    q0 = np.array(START["panda"])
    ref = paths(robot.pose(q0))["sinusoid"]
    h = 1e-3
    q, v, a = follow(robot, ref, q0, [0.7 - h, 0.7, 0.7 + h])
    assert_allclose(v[1], np.linalg.pinv(robot.jacobian(q[1])) @ ref(0.7).V, atol=1e-12)
    assert_allclose((v[2] - v[0]) / (2 * h), a[1], atol=1e-4)


def test_a_closed_path_of_a_six_joint_arm_is_periodic_and_repeats():
    robot = robots.ur5()
    ref = ToolCircle(robot.pose(START["ur5"]), 0.05, 2.0)
    closed = from_tool_path(robot, ref, START["ur5"], np.linspace(0, ref.period, 31))
    assert closed.period == pytest.approx(np.pi) and closed.duration is None
    for a, b in zip(closed(0.4), closed(0.4 + 3 * np.pi), strict=True):
        assert_allclose(a, b, atol=1e-8)
    part = from_tool_path(robot, ref, START["ur5"], [0.0, 1.0])
    assert part.period is None and part.duration == 1.0
    assert_array_equal(part(5.0).q, part(1.0).q)


def test_a_held_pose_is_one_solution_at_all_times():
    robot = robots.ur5()
    q0 = np.array(START["ur5"])
    joint = from_tool_path(robot, ToolHold(robot.pose(q0)), q0 + 0.1, [0, 5])
    assert_allclose(joint(2).q, q0, atol=1e-11)
    assert joint.is_hold
    assert_allclose(follow(robot, ToolHold(robot.pose(q0)), q0 + 0.1, [0, 5]).q, [q0, q0], atol=1e-11)


def test_a_pose_is_solved_near_the_start_even_from_afar():
    robot = robots.ur5()
    q0 = np.array(START["ur5"])
    q = solve_pose(robot, robot.pose(q0), q0 + 0.5)
    assert_allclose(robot.pose(q), robot.pose(q0), atol=1e-11)
    with pytest.raises(errors.NotConverged, match=r"out of reach, or q_start"):
        solve_pose(robot, transform(np.eye(3), np.array([2.0, 0, 0])), q0)
    with pytest.raises(errors.BadArgument, match="q_start"):
        solve_pose(robot, robot.pose(q0), q0[:3])


def test_a_path_that_leaves_the_workspace_says_when():
    robot = robots.ur5()
    X = robot.pose(START["ur5"])
    away = X.copy()
    away[:3, 3] += [2.0, 0, 0]
    with pytest.raises((errors.NotConverged, errors.NearSingular), match=r"t = 0\.\d+ s"):
        from_tool_path(robot, ToolLine(X, away, 2), START["ur5"], [0, 2])


def test_a_singular_pose_is_refused_with_time_frame_and_singular_value_unless_damped():
    robot = robots.ur5()
    q = np.array([0, -0.9, 1.6, -0.7, 0.0, 0.3])
    ref = ToolSinusoid(robot.pose(q), [0, 0, 0.01], 1.0)
    with pytest.raises(errors.NearSingular, match="'tool0' is nearly singular at t = 0 s") as info:
        from_tool_path(robot, ref, q, [0, 1])
    assert info.value.time == 0.0 and info.value.sigma_min < 1e-9
    motion = follow(robot, ref, q, [0.0], damping=0.05)
    J, V = robot.jacobian(q), ref(0.0).V
    assert_allclose(motion.v[0], J.T @ np.linalg.solve(J @ J.T + 0.05**2 * np.eye(6), V), atol=1e-10)


def test_a_nearly_singular_path_warns():
    robot = robots.ur5()
    q = np.array([0, -0.9, 1.6, -0.7, 1e-5, 0.3])
    path = ToolSinusoid(robot.pose(q), [0, 0, 1e-9], 1.0)
    for _ in range(2):  # also where its motion is known already
        with pytest.warns(errors.MfcWarning, match="close to singular at t = "):
            follow(robot, path, q, [0.0, 0.1])


def test_fewer_joints_follow_what_they_can_and_say_when_they_cannot():
    arm = robots.rp()
    X = arm.pose([0.3, 0.5])
    joint = from_tool_path(arm, ToolLine(X, arm.pose([0.3, 0.8]), 2), [0.3, 0.5], [0, 1, 2])
    assert_allclose(joint(2).q, [0.3, 0.8], atol=1e-10)
    with pytest.raises(errors.NotConverged, match="2 joints cannot follow the tool path at t = 0 s"):
        from_tool_path(arm, ToolCircle(X, 0.1, 2), [0.3, 0.5], [0, 1])


def test_leaving_joint_limits_warns_with_the_joint():
    robot = robots.load("panda")
    q0 = np.array(START["panda"])
    turned = q0.copy()
    turned[6] += 2.8  # about the hand's own axis
    ref = ToolLine(robot.pose(q0), robot.pose(turned), 5)
    with pytest.warns(errors.MfcWarning, match="limits of joint 'panda_joint7'"):
        from_tool_path(robot, ref, q0, [0, 5])


def test_a_path_long_over_still_is_followed():
    robot = robots.ur5()
    q0 = np.array(START["ur5"])
    ref = paths(robot.pose(q0))["line"]
    short = ToolLine(ref.X0, ref.X1, 0.05)
    end = follow(robot, ref, q0, [2.0]).q[0]
    assert_allclose(follow(robot, short, q0, [0.01, 1e5]).q[1], end, atol=1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", errors.MfcWarning)  # fast, so beyond the velocity limits
        assert_allclose(from_tool_path(robot, short, q0, [-1, 0.01, 1e5])(1e5).q, end, atol=1e-10)


@pytest.mark.parametrize(
    ("ref", "q_start", "times", "names"),
    [
        (Hold(START["ur5"]), START["ur5"], [0, 1], "tool_ref"),
        (None, START["ur5"], [0, 1], "tool_ref"),
        (ToolHold(np.eye(4)), START["ur5"][:5], [0, 1], "q_start"),
        (ToolHold(np.eye(4)), [np.nan] * 6, [0, 1], "q_start"),
        (ToolHold(np.eye(4)), START["ur5"], [0], "times"),
        (ToolHold(np.eye(4)), START["ur5"], [1, 0], "times"),
    ],
)
def test_bad_arguments_are_refused_by_name(ref, q_start, times, names):
    with pytest.raises(errors.BadArgument) as info:
        from_tool_path(robots.ur5(), ref, q_start, times)
    assert info.value.argument == names


def test_a_path_is_followed_once_for_arms_that_differ_in_load_only():
    robot = robots.ur5()
    q_start = np.array([0.3, -1.2, 1.5, -0.8, -1.4, 0.2])
    path = ToolSinusoid(robot.pose(q_start), [0.05, 0, 0.05], 2.0)
    times = np.linspace(0, 2, 7)
    first = follow(robot, path, q_start, times)
    for loaded in (robot, robot.with_payload(3.0), robot.with_armature(0.1)):
        assert follow(loaded, path, q_start, times).q is first.q
    with pytest.raises(ValueError, match="read-only"):
        first.q[0] = 0
    for start, at, damping in ((q_start + 1e-3, times, 0.0), (q_start, times + 0.1, 0.0), (q_start, times, 0.1)):
        assert follow(robot, path, start, at, damping=damping).q is not first.q
    assert_array_equal(follow(robot, ToolSinusoid(robot.pose(q_start), [0.05, 0, 0.05], 2.0), q_start, times).q, first.q)
    for k in range(9):  # only a few are kept
        follow(robot, path, q_start, times + 0.01 * k)
    assert follow(robot, path, q_start, times).q is not first.q


def test_arms_of_other_geometry_follow_the_same_path_by_themselves():
    short, long = (robots.Robot.from_urdf(PLANAR.format(length=x), tool="tip") for x in (1.0, 1.1))
    path = ToolHold(short.pose([0.3]))
    assert follow(short, path, [0.3], [0.0]).q[0] == 0.3
    with pytest.raises(errors.NotConverged):
        follow(long, path, [0.3], [0.0])
