from __future__ import annotations

import importlib.metadata
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import errors, robots
from mfc_analysis.robots import catalogue


def test_the_single_joint_is_equation_9_6():
    rng = np.random.default_rng(0)
    for _ in range(5):
        I, m, r, b = rng.uniform(1, 3), rng.uniform(0, 2), rng.uniform(0, 0.7), rng.uniform(0, 1)
        joint = robots.single_joint(inertia=I, mass=m, com_distance=r, damping=b)
        theta = rng.uniform(-3, 3, 1)
        assert_allclose(joint.mass(theta), [[I]], rtol=1e-14)
        assert_allclose(joint.bias(theta, [1.7]), m * 9.81 * r * np.cos(theta), atol=1e-12)
        assert_allclose(joint.friction([1.7]), [b * 1.7])
    assert_allclose(robots.single_joint().mass([0.3]), [[0.5]], rtol=1e-14)


def test_an_inertia_that_no_body_has_warns_and_still_is_the_equation():
    with pytest.warns(errors.MfcWarning, match="less than mass"):
        joint = robots.single_joint(inertia=0.5, mass=1, com_distance=1)
    assert_allclose(joint.mass([0.3]), [[0.5]], rtol=1e-12)
    assert_allclose(joint.gravity([0.3]), [9.81 * np.cos(0.3)], rtol=1e-12)


def test_the_slider_is_one_mass_without_gravity():
    slider = robots.slider(mass=3, friction=0.4)
    assert_allclose(slider.mass([0.2]), [[3.0]])
    assert_allclose(slider.bias([0.2], [1.0]), [0.0])
    assert_allclose(slider.friction([2.0]), [0.8])
    assert_allclose(slider.pose([0.2])[:3, 3], [0, 0, 0.2])
    assert_allclose(slider.jacobian([0.2])[:, 0], [0, 0, 1, 0, 0, 0])


def test_the_rp_arm_has_its_tool_at_d_along_theta_and_a_diagonal_mass_matrix():
    arm = robots.rp(masses=(4, 1), inertias=(0.1, 0.02), com_distance=0.3)
    theta, d = 0.7, 0.9
    assert_allclose(arm.pose([theta, d])[:3, 3], [d * np.cos(theta), d * np.sin(theta), 0], atol=1e-15)
    assert_allclose(arm.mass([theta, d]), np.diag([0.1 + 4 * 0.09 + 0.02 + d * d, 1.0]), atol=1e-14)
    g = 9.81 * np.array([(4 * 0.3 + d) * np.cos(theta), np.sin(theta)])
    assert_allclose(arm.gravity([theta, d]), g, atol=1e-13)
    assert_allclose(arm.bias([theta, d], [0.5, 0.2]) - g, [2 * d * 0.5 * 0.2, -d * 0.25], atol=1e-13)
    assert_allclose(robots.rp(gravity=0).gravity([theta, d]), 0)


def test_exercise_9_4_force_on_the_rp_arm():
    theta, d = 0.6, 1.5
    J = np.array([[-d * np.sin(theta), np.cos(theta)], [d * np.cos(theta), np.sin(theta)]])
    tau = robots.rp().joint_torques([theta, d], [3, 4, 0, 0, 0, 0], frame="world")
    assert_allclose(tau, J.T @ [3, 4], atol=1e-14)


def test_the_planar_arm_is_sicilianos_with_its_motors():
    a1, l1, l2, m_l1, m_l2, I_l1, I_l2 = 1.0, 0.5, 0.5, 50.0, 50.0, 10.0, 10.0
    k1, k2, m_m2, I_m1, I_m2, g = 100.0, 100.0, 5.0, 0.01, 0.01, 9.81
    arm = robots.planar_2r()
    for q, v in (([0.3, 0.8], [0.4, -1.1]), ([-1.0, 2.5], [1.3, 0.2])):
        c2, s2 = np.cos(q[1]), np.sin(q[1])
        b11 = I_l1 + m_l1 * l1**2 + k1**2 * I_m1 + I_l2 + m_l2 * (a1**2 + l2**2 + 2 * a1 * l2 * c2) + I_m2 + m_m2 * a1**2
        b12 = I_l2 + m_l2 * (l2**2 + a1 * l2 * c2) + k2 * I_m2
        b22 = I_l2 + m_l2 * l2**2 + k2**2 * I_m2
        assert_allclose(arm.mass(q), [[b11, b12], [b12, b22]], rtol=1e-13)
        h = -m_l2 * a1 * l2 * s2
        coriolis = [h * v[1] * (2 * v[0] + v[1]), -h * v[0] ** 2]
        weight = [(m_l1 * l1 + m_m2 * a1 + m_l2 * a1) * g * np.cos(q[0]) + m_l2 * l2 * g * np.cos(sum(q)), m_l2 * l2 * g * np.cos(sum(q))]
        assert_allclose(arm.gravity(q), weight, rtol=1e-12, atol=1e-11)
        assert_allclose(arm.bias(q, v), np.add(coriolis, weight), rtol=1e-12, atol=1e-11)


def dh(a, alpha, d, theta):
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def test_the_ur5_has_the_published_denavit_hartenberg_kinematics():
    """d4 = 0.13585 - 0.1197 + 0.093 m is the table's 0.10915."""
    table = [(0, np.pi / 2, 0.089159), (-0.425, 0, 0), (-0.39225, 0, 0), (0, np.pi / 2, 0.10915), (0, -np.pi / 2, 0.09465), (0, 0, 0.0823)]
    rng = np.random.default_rng(2)
    base = np.diag([-1.0, -1.0, 1.0, 1.0])  # the controller's base is turned by pi about z
    for _ in range(3):
        q = rng.uniform(-3, 3, 6)
        X = base.copy()
        for (a, alpha, d), theta in zip(table, q, strict=True):
            X = X @ dh(a, alpha, d, theta)
        assert_allclose(robots.ur5().pose(q), X, atol=1e-12)


def test_the_embedded_ur5_equals_the_one_of_example_robot_data():
    ours, theirs = robots.ur5(), robots.load("ur5")
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-3, 3, (4, 6)), rng.uniform(-1, 1, (4, 6))
    assert (ours.joint_names, ours.tool) == (theirs.joint_names, theirs.tool)
    for a, b in ((ours.mass(q), theirs.mass(q)), (ours.bias(q, v), theirs.bias(q, v)), (ours.pose(q), theirs.pose(q))):
        assert_allclose(a, b, atol=1e-9)  # the file rounds pi / 2 to 12 digits
    for name in ("lower", "upper", "velocity", "torque"):
        assert_allclose(getattr(ours.limits, name), getattr(theirs.limits, name), rtol=1e-11)


@pytest.mark.parametrize("name", robots.names())
def test_every_named_robot_is_a_serial_arm_with_a_tool_that_all_joints_move(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = robots.load(name)
    q = np.random.default_rng(0).uniform(-1, 1, robot.n)
    assert robot.name == name
    assert np.linalg.eigvalsh(robot.mass(q))[0] > 0
    assert (np.abs(robot.jacobian(q)).max(axis=0) > 1e-3).all()
    assert robot.n <= 7
    if robot.n >= 6:
        assert np.linalg.cond(robot.jacobian(q)) < 1e3


def test_the_arms_of_the_acceptance_list_have_the_joints_expected():
    assert {name: robots.load(name).n for name in ("panda", "xarm7", "z1", "talos_left_arm", "kinova")} == {
        "panda": 7,
        "xarm7": 7,
        "z1": 6,
        "talos_left_arm": 6,
        "kinova": 6,
    }


def test_tool_and_locked_joints_can_be_chosen():
    robot = robots.load("panda", tool="panda_link8", locked={"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02, "panda_joint7": 0.5})
    assert robot.n == 6 and robot.tool == "panda_link8"
    assert robots.load("z1", locked=[]).n == 7
    assert robots.load("z1", locked="jointGripper").n == 6
    assert robots.load("rp", locked=["theta"]).joint_names == ("d",)
    assert_allclose(robots.load("single_joint", tool="joint").viscous, [0.1])


def test_an_unknown_robot_lists_the_known_ones():
    with pytest.raises(errors.UnknownName, match="did you mean 'panda'") as info:
        robots.load("pandas")
    assert "ur5" in info.value.known and isinstance(info.value, ValueError)
    with pytest.raises(errors.UnknownName):
        robots.load(5)
    with pytest.raises(errors.UnknownName):
        robots.load("panda", tool="nose")


def test_without_example_robot_data_the_error_says_what_to_install(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(catalogue.importlib.metadata, "files", missing)
    with pytest.raises(ValueError, match=r'pip install "mfc-analysis\[robots\]"'):
        robots.load("panda")
    assert robots.load("planar_2r").n == 2
    assert "panda" in robots.names()


@pytest.mark.parametrize(
    ("make", "wrong"),
    [
        (robots.single_joint, {"inertia": 0}),
        (robots.single_joint, {"mass": -1}),
        (robots.single_joint, {"damping": -1}),
        (robots.single_joint, {"gravity": np.nan}),
        (robots.slider, {"mass": 0}),
        (robots.slider, {"friction": -1}),
        (robots.rp, {"masses": (1, 0)}),
        (robots.rp, {"masses": 1}),
        (robots.rp, {"inertias": (1, np.nan)}),
    ],
    ids=lambda given: getattr(given, "__name__", str(given)),
)
def test_bad_numbers_for_an_embedded_robot_are_refused(make, wrong):
    with pytest.raises(ValueError):
        make(**wrong)
