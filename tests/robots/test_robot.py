from __future__ import annotations

import pickle
import threading

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis import errors, robots
from mfc_analysis.maths.se3 import inverse, log6
from mfc_analysis.robots.robot import Robot
from tests.robots.arms import CONTINUOUS, TWO

EVERY = [robots.single_joint, robots.slider, robots.rp, robots.planar_2r, robots.ur5, lambda: robots.load("panda"), lambda: robots.load("kinova")]


@pytest.fixture(params=EVERY, ids=["single_joint", "slider", "rp", "planar_2r", "ur5", "panda", "kinova"])
def robot(request):
    return request.param()


def point(robot, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.2, 1.2, robot.n), rng.uniform(-1, 1, robot.n), rng.uniform(-1, 1, robot.n)


# --- dynamics ----------------------------------------------------------------------------------------------------------------


def test_mass_and_bias_make_up_the_inverse_dynamics(robot):
    q, v, a = point(robot)
    tau = pin.rnea(robot.model, robot.model.createData(), robot.configuration(q), v, a)
    assert_allclose(robot.mass(q) @ a + robot.bias(q, v), tau, atol=1e-12)
    assert_allclose(robot.bias(q, 0 * v), robot.gravity(q), atol=1e-12)
    assert_array_equal(robot.mass(q), robot.mass(q).T)


def test_the_power_of_the_coriolis_terms_is_that_of_the_changing_mass(robot):
    q, v, _ = point(robot, 1)
    h = 1e-5
    M_rate = (robot.mass(q + h * v) - robot.mass(q - h * v)) / (2 * h)
    assert_allclose(v @ (robot.bias(q, v) - robot.gravity(q)), 0.5 * v @ M_rate @ v, atol=1e-8)


def test_the_jacobian_is_the_body_twist_of_the_pose_and_its_rate_the_derivative(robot):
    q, v, _ = point(robot, 2)
    h = 1e-5
    twist = log6(inverse(robot.pose(q - h * v)) @ robot.pose(q + h * v)) / (2 * h)
    assert_allclose(robot.jacobian(q) @ v, twist, atol=1e-9)
    assert_allclose(robot.jacobian_rate(q, v), (robot.jacobian(q + h * v) - robot.jacobian(q - h * v)) / (2 * h), atol=1e-8)


def test_batches_keep_their_leading_axes(robot):
    rng = np.random.default_rng(3)
    q, v = rng.uniform(-1, 1, (2, 3, robot.n)), rng.uniform(-1, 1, (3, robot.n))
    n = robot.n
    for found, shape in (
        (robot.mass(q), (n, n)),
        (robot.gravity(q), (n,)),
        (robot.bias(q, v), (n,)),
        (robot.pose(q), (4, 4)),
        (robot.jacobian(q), (6, n)),
        (robot.jacobian_rate(q, v), (6, n)),
        (robot.friction(q), (n,)),
        (robot.joint_torques(q, np.ones(6)), (n,)),
    ):
        assert found.shape == (2, 3, *shape)
    assert_array_equal(robot.bias(q, v)[1, 2], robot.bias(q[1, 2], v[2]))
    assert_array_equal(robot.jacobian(q)[1, 2], robot.jacobian(q[1, 2]))
    assert robot.mass(q[:0, 0]).shape == (0, n, n)


def test_a_result_stays_what_it_was_at_the_next_call():
    robot = robots.ur5()
    q, v, _ = point(robot)
    kept = [robot.mass(q), robot.gravity(q), robot.jacobian(q), robot.bias(q, v), robot.pose(q)]
    copies = [x.copy() for x in kept]
    robot.mass(q + 1), robot.gravity(q + 1), robot.jacobian(q + 1), robot.bias(q + 1, v), robot.pose(q + 1)
    for x, y in zip(kept, copies, strict=True):
        assert_array_equal(x, y)


@pytest.mark.parametrize("name", ["ur5", "panda", "xarm7"])
def test_the_task_space_dynamics_give_the_joint_space_ones_back(name):
    robot = robots.load(name)
    q, v, a = point(robot, 4)
    J, M, h = robot.jacobian(q), robot.mass(q), robot.bias(q, v)
    Lambda, eta = robot.task_inertia(q), robot.task_bias(q, v)
    F = np.random.default_rng(5).normal(size=6)
    a = np.linalg.solve(M, J.T @ F - h)  # joints driven by a tool wrench alone
    dV = J @ a + robot.jacobian_rate(q, v) @ v
    assert_allclose(Lambda @ dV + eta, F, atol=1e-9)
    assert np.linalg.eigvalsh(Lambda)[0] > 0
    if robot.n == 6:
        a = np.ones(6)
        dV = J @ a + robot.jacobian_rate(q, v) @ v
        assert_allclose(J.T @ (Lambda @ dV + eta), M @ a + h, atol=1e-10)
        assert_allclose(Lambda, np.linalg.inv(J).T @ M @ np.linalg.inv(J), rtol=1e-8, atol=1e-9)


def test_a_nearly_singular_jacobian_warns_and_then_refuses():
    robot = robots.ur5()

    def near(x):  # wrist 2 straight is singular
        return np.array([0.1, -0.9, 1.6, -0.7, x, 0.3])

    conditions = [np.linalg.cond(robot.jacobian(near(x))) for x in (1e-3, 1e-5, 1e-7)]
    assert conditions[0] < 1e4 < conditions[1] < 1e6 < conditions[2]
    robot.task_inertia(near(1e-3))
    with pytest.warns(errors.MfcWarning, match="'tool0' is close to singular: smallest singular value"):
        robot.task_inertia(near(1e-5))
    with pytest.raises(errors.NearSingular, match="tool0") as info:
        robot.task_bias(near(1e-7), np.zeros(6))
    assert info.value.frame == "tool0" and 0 < info.value.sigma_min < 1e-6 and info.value.condition > 1e6


def test_fewer_than_six_joints_have_no_task_inertia():
    with pytest.raises(errors.NearSingular):
        robots.planar_2r().task_inertia([0.1, 0.2])


def test_joint_torques_do_the_work_of_the_wrench(robot):
    q, v, _ = point(robot, 6)
    F = np.array([1.0, -2, 3, 0.4, 0.5, -0.6])
    assert_allclose(robot.joint_torques(q, F) @ v, F @ (robot.jacobian(q) @ v), atol=1e-12)
    R = robot.pose(q)[:3, :3]
    world = np.concatenate([R @ F[:3], R @ F[3:]])
    assert_allclose(robot.joint_torques(q, world, frame="world"), robot.joint_torques(q, F), atol=1e-12)


def test_a_wrench_must_have_six_components_and_a_known_frame():
    robot = robots.rp()
    for wrench in ([3, 4], 1.0, [1, 2, 3, 4, 5, np.nan]):
        with pytest.raises(errors.BadArgument, match="wrench"):
            robot.joint_torques([0.1, 0.5], wrench)
    with pytest.raises(errors.BadArgument, match="'tool', 'world'"):
        robot.joint_torques([0.1, 0.5], np.zeros(6), frame="base")


# --- angles and order ---------------------------------------------------------------------------------------------------------


def test_continuous_joints_are_plain_angles():
    robot = robots.load("kinova")
    assert robot.n == 6 and robot.model.nq == 9
    q, v, _ = point(robot, 7)
    turns = q + 2 * np.pi * np.array([1, 0, 0, -2, 0, 3])
    assert_allclose(robot.mass(turns), robot.mass(q), atol=1e-12)
    assert_allclose(robot.bias(turns, v), robot.bias(q, v), atol=1e-12)
    x = robot.configuration(q)
    assert_allclose(pin.integrate(robot.model, x, v), robot.configuration(q + v), atol=1e-12)
    assert np.isinf(robot.limits.position[0]).all() and np.isfinite(robot.limits.position[1]).all()


def test_an_order_of_joints_permutes_everything():
    robot, other = Robot.from_urdf(CONTINUOUS), Robot.from_urdf(CONTINUOUS, joints=["j2", "j1"])
    q, v, _ = point(robot, 8)
    p = [1, 0]
    assert other.joint_names == ("j2", "j1")
    assert_allclose(other.mass(q[p]), robot.mass(q)[np.ix_(p, p)])
    assert_allclose(other.bias(q[p], v[p]), robot.bias(q, v)[p])
    assert_allclose(other.gravity(q[p]), robot.gravity(q)[p])
    assert_allclose(other.jacobian(q[p]), robot.jacobian(q)[:, p])
    assert_allclose(other.jacobian_rate(q[p], v[p]), robot.jacobian_rate(q, v)[:, p])
    assert_allclose(other.pose(q[p]), robot.pose(q))
    assert_allclose(other.with_armature([5.0, 0.0]).mass(q[p]) - other.mass(q[p]), np.diag([5.0, 0.0]), atol=1e-12)
    assert_array_equal(other.with_armature([5.0, 0.0]).armature, [5.0, 0.0])
    assert_array_equal(other.limits.lower, [-2.0, -np.inf])
    assert_array_equal(other.from_model(other.to_model(q)), q)


def test_an_order_of_three_joints_is_not_its_own_inverse():
    names = ["shoulder_lift_joint", "elbow_joint", "wrist_2_joint", "shoulder_pan_joint", "wrist_3_joint", "wrist_1_joint"]
    robot = robots.ur5()
    other = Robot.from_pinocchio(robot.model, joints=names)
    p = [robot.joint_names.index(name) for name in names]
    q, *_ = point(robot, 9)
    assert_allclose(other.mass(q[p]), robot.mass(q)[np.ix_(p, p)])
    assert_allclose(other.jacobian(q[p]), robot.jacobian(q)[:, p])
    assert_array_equal(other.limits.torque, robot.limits.torque[p])


@pytest.mark.parametrize("q", [[0.1], [0.1, 0.2, 0.3], 0.1, [[0.1], [0.2]], [0.1, np.nan], ["a", "b"], None])
def test_a_bad_configuration_is_refused_by_every_method(q):
    robot = robots.rp()
    for method in (robot.mass, robot.gravity, robot.pose, robot.jacobian, robot.configuration, robot.task_inertia):
        with pytest.raises(errors.BadArgument, match="q"):
            method(q)
    with pytest.raises(errors.BadArgument, match="v"):
        robot.bias([0.1, 0.2], q)


def test_leading_axes_that_do_not_go_together_are_refused():
    with pytest.raises(errors.BadArgument, match=r"v: .*leading axes"):
        robots.rp().bias(np.zeros((2, 2)), np.zeros((3, 2)))
    with pytest.raises(errors.BadArgument, match=r"wrench: .*leading axes"):
        robots.rp().joint_torques(np.zeros((2, 2)), np.zeros((3, 6)))
    assert robots.rp().joint_torques(np.zeros((2, 1, 2)), np.zeros((3, 6))).shape == (2, 3, 2)


# --- changed copies -----------------------------------------------------------------------------------------------------------


def test_the_users_model_is_copied_and_no_copy_changes_another():
    model = pin.buildModelFromXML(TWO)
    before = pin.Model(model)
    robot = Robot.from_pinocchio(model, tool="two", gravity=(0, -9.81, 0))
    q = [0.3, 0.5]
    M, g = robot.mass(q), robot.gravity(q)
    robot.with_payload(3.0), robot.with_armature(1.0), robot.with_inertia_scaled(2.0), robot.with_friction(1.0)
    assert model == before
    assert_array_equal(robot.mass(q), M)
    model.gravity = pin.Motion.Zero()
    assert_array_equal(robot.gravity(q), g)
    with pytest.raises(AttributeError):
        robot.tool = "one"
    with pytest.raises(ValueError, match="read-only"):
        robot.viscous[0] = 1.0


def test_a_payload_adds_its_kinetic_energy_and_weight():
    robot = robots.ur5()
    m, com, I = 2.0, np.array([0.01, -0.02, 0.05]), np.diag([0.01, 0.02, 0.015])
    loaded = robot.with_payload(m, com=com, inertia=I)
    q, v, _ = point(robot, 10)
    V = robot.jacobian(q) @ v
    at_com = V[:3] + np.cross(V[3:], com)
    energy = 0.5 * m * at_com @ at_com + 0.5 * V[3:] @ I @ V[3:]
    assert_allclose(0.5 * v @ (loaded.mass(q) - robot.mass(q)) @ v, energy, rtol=1e-10)
    R = robot.pose(q)[:3, :3]
    weight = R.T @ [0, 0, -m * 9.81]
    assert_allclose(loaded.gravity(q) - robot.gravity(q), -robot.joint_torques(q, np.concatenate([weight, np.cross(com, weight)])), atol=1e-10)
    assert loaded.total_mass == pytest.approx(robot.total_mass + 2.0)
    assert "payload 2 kg" in str(loaded)


def test_payloads_add_up_and_a_scalar_inertia_is_a_sphere():
    robot = robots.ur5()
    q, *_ = point(robot)
    assert_allclose(robot.with_payload(1).with_payload(2).mass(q), robot.with_payload(3.0).mass(q), atol=1e-12)
    assert_allclose(robot.with_payload(1, inertia=0.3).mass(q), robot.with_payload(1.0, inertia=0.3 * np.eye(3)).mass(q), atol=1e-12)
    assert_allclose(robot.with_payload(0).mass(q), robot.mass(q), atol=1e-12)
    assert_allclose(robot.with_payload(1, com=(0, 0, 1), inertia=0).mass(q), robot.with_payload(1, com=(0, 0, 1)).mass(q))


@pytest.mark.parametrize(
    "wrong",
    [
        {"mass": -1},
        {"mass": np.nan},
        {"mass": "2"},
        {"com": (0, 0)},
        {"com": (0, 0, np.inf)},
        {"com": (0, 0, 1e200)},
        {"inertia": -1},
        {"inertia": np.ones(3)},
        {"inertia": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]},
        {"inertia": np.diag([1, 1, -1])},
    ],
    ids=str,
)
def test_a_bad_payload_is_refused_by_name(wrong):
    with pytest.raises(errors.BadArgument, match=next(iter(wrong))):
        robots.ur5().with_payload(**{"mass": 1.0, **wrong})


def test_friction_is_viscous_by_the_urdf_unless_dropped():
    assert_array_equal(Robot.from_urdf(TWO).viscous, [0.3, 0.4])
    assert_array_equal(Robot.from_urdf(TWO).coulomb, [0.0, 0.0])
    assert_array_equal(Robot.from_urdf(TWO, friction="none").viscous, [0.0, 0.0])
    assert_array_equal(Robot.from_urdf(TWO, joints=["j2", "j1"]).viscous, [0.4, 0.3])
    with pytest.raises(errors.BadArgument, match="friction"):
        Robot.from_urdf(TWO, friction="some")


def test_friction_opposes_motion_and_is_in_neither_bias_nor_gravity():
    robot = Robot.from_urdf(TWO)
    rough = robot.with_friction(viscous=[1, 2], coulomb=0.5, coulomb_speed=0.1)
    v = np.array([0.2, -0.3])
    assert_allclose(rough.friction(v), [1, 2] * v + 0.5 * np.tanh(v / 0.1))
    assert_array_equal(rough.bias([0.1, 0.2], v), robot.bias([0.1, 0.2], v))
    assert_array_equal(rough.with_friction(coulomb=1).viscous, [1, 2])
    assert_array_equal(robot.with_friction(0).viscous, [0, 0])
    for bad in ({"viscous": -1}, {"coulomb": -1}, {"viscous": [1, 2, 3]}, {"coulomb_speed": 0}, {"coulomb": np.nan}):
        with pytest.raises(errors.BadArgument, match=next(iter(bad))):
            robot.with_friction(**bad)


def test_armature_adds_to_the_diagonal_and_replaces_what_there_was():
    robot = robots.ur5()
    q, *_ = point(robot)
    geared = robot.with_armature(1).with_armature([1, 2, 3, 4, 5, 6.0])
    assert_allclose(geared.mass(q) - robot.mass(q), np.diag([1, 2, 3, 4, 5, 6]), atol=1e-12)
    with pytest.raises(errors.BadArgument, match="armature"):
        robot.with_armature(-1)


def test_scaling_the_inertia_scales_mass_bias_and_gravity():
    robot = robots.planar_2r()
    q, v, _ = point(robot)
    more = robot.with_inertia_scaled(1.2)
    assert_allclose(more.mass(q), 1.2 * robot.mass(q))
    assert_allclose(more.bias(q, v), 1.2 * robot.bias(q, v))
    arm = Robot.from_urdf(TWO.replace('ixx="0.01"', 'ixx="-1e-9"'))  # a sloppy URDF: no reason to refuse a planar arm
    assert_allclose(arm.with_inertia_scaled(3).mass([0.1, 0.2]), 3 * arm.mass([0.1, 0.2]))
    for bad in (0, -1, np.nan, "2"):
        with pytest.raises(errors.BadArgument, match="factor"):
            robot.with_inertia_scaled(bad)


# --- the value ------------------------------------------------------------------------------------------------------------------


def test_gravity_is_an_argument_in_base_axes():
    assert_allclose(Robot.from_urdf(TWO).gravity([0.3, 0.1]), 0, atol=1e-12)  # axes are vertical
    down = Robot.from_urdf(TWO, gravity=(0, -9.81, 0)).gravity([0.0, 0.0])
    assert_allclose(down, [9.81 * (0.2 + 0.7), 9.81 * 0.2])
    assert_allclose(Robot.from_urdf(TWO, gravity=[0, 0, 0]).gravity([0.3, 0.1]), 0)
    for bad in ((0, 0), 9.81, (0, 0, np.nan)):
        with pytest.raises(errors.BadArgument, match="gravity"):
            Robot.from_urdf(TWO, gravity=bad)


def test_a_robot_survives_pickling_and_another_thread(robot):
    q, *_ = point(robot)
    again = pickle.loads(pickle.dumps(robot))
    assert_array_equal(again.mass(q), robot.mass(q))
    assert (again.tool, again.joint_names) == (robot.tool, robot.joint_names)
    found = []
    worker = threading.Thread(target=lambda: found.append(robot.mass(q)))
    worker.start()
    worker.join()
    assert_array_equal(found[0], robot.mass(q))


def test_a_robot_says_what_it_is():
    robot = robots.load("panda").with_payload(1.5).with_friction(coulomb=0.2).with_armature(0.1)
    assert repr(robot) == "Robot('panda', n=7, tool='panda_hand_tcp')"
    for words in (
        "7 joints",
        "panda_joint4",
        "tool panda_hand_tcp",
        "payload 1.5 kg",
        "viscous friction 0.003",
        "Coulomb friction 0.2",
        "armature 0.1",
    ):
        assert words in str(robot)


def test_only_a_pinocchio_model_is_taken_as_one():
    with pytest.raises(errors.BadArgument, match="model"):
        Robot.from_pinocchio("arm.urdf")


def test_payloads_are_scaled_and_taken_off_again():
    bare = robots.ur5()
    loaded = bare.with_payload(2.0, (0.01, 0.0, 0.05), 0.01).with_payload(1.0)
    half = bare.with_payload(1.0, (0.01, 0.0, 0.05), 0.005).with_payload(0.5)
    rng = np.random.default_rng(1)
    for q, v in rng.uniform(-2, 2, (3, 2, 6)):
        for one, other in ((loaded.with_payloads_scaled(0.0), bare), (loaded.with_payloads_scaled(0.5), half)):
            assert_allclose(one.mass(q), other.mass(q), rtol=1e-12, atol=1e-13)
            assert_allclose(one.bias(q, v), other.bias(q, v), rtol=1e-12, atol=1e-12)
    assert loaded.with_payloads_scaled(0.0).payloads == () and [p.mass for p in loaded.with_payloads_scaled(0.5).payloads] == [1.0, 0.5]
    alone = robots.slider(mass=2.0)
    assert alone.with_payload(3.0).with_payloads_scaled(0.0).total_mass == pytest.approx(2.0, rel=1e-12)
    with pytest.raises(errors.BadArgument, match="factor"):
        loaded.with_payloads_scaled(-1.0)
