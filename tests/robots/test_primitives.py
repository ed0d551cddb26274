"""Every primitive and its derivative on every robot, and a tree, a reordered and a continuous arm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.dual import Dual
from mfc_analysis.maths.se3 import exp6, inverse, log6
from mfc_analysis.robots.catalogue import ur5_urdf
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.robot import Robot
from tests.conftest import ROBOTS, arm, plant, regular_pose, seed
from tests.robots.arms import CONTINUOUS, FORK

Call = Callable[..., object]

#: of (q, v, a, f): joint position, velocity, acceleration (or torque), tool twist or wrench
PRIMITIVES: dict[str, Callable[[Primitives], Call]] = {
    "rnea": lambda P: lambda q, v, a, f: P.rnea(q, v, a),
    "inverse_dynamics": lambda P: lambda q, v, a, f: P.inverse_dynamics(q, v, a),
    "bias": lambda P: lambda q, v, a, f: P.bias(q, v),
    "aba": lambda P: lambda q, v, a, f: P.aba(q, v, a),
    "mass": lambda P: lambda q, v, a, f: P.mass(q, a),
    "solve_mass": lambda P: lambda q, v, a, f: P.solve_mass(q, a),
    "gravity": lambda P: lambda q, v, a, f: P.gravity(q),
    "friction": lambda P: lambda q, v, a, f: P.friction(v),
    "jacobian": lambda P: lambda q, v, a, f: P.jacobian(q, a),
    "jacobian_transpose": lambda P: lambda q, v, a, f: P.jacobian_transpose(q, f),
    "jacobian_dot": lambda P: lambda q, v, a, f: P.jacobian_dot(q, v),
    "solve_jacobian": lambda P: lambda q, v, a, f: P.solve_jacobian(q, f),
    "solve_jacobian damped": lambda P: lambda q, v, a, f: P.solve_jacobian(q, f, 0.1),
    "mobility": lambda P: lambda q, v, a, f: P.mobility(q, f),
    "task_mass": lambda P: lambda q, v, a, f: P.task_mass(q, f),
    "task_mass damped": lambda P: lambda q, v, a, f: P.task_mass(q, f, 0.1),
    "task_mass constant": lambda P: lambda q, v, a, f: P.task_mass(q, f, 0.1, constant_mass(P.n)),
}
REORDERED = Robot.from_urdf(ur5_urdf(), tool="tool0", joints=list(arm("ur5").joint_names)[::-1])
TURNING = Robot.from_urdf(CONTINUOUS, tool="two")
BRANCHED = Robot.from_urdf(FORK, tool="right")  # a joint that does not move the tool
EVERY = {**{name: plant(name) for name in ROBOTS}, "reordered": REORDERED, "continuous": TURNING, "branched": BRANCHED}
CENTRES = {"reordered": regular_pose("ur5")[::-1], "continuous": np.array([0.4, 0.3]), "branched": np.array([0.4, 0.3, -0.7])}


def constant_mass(n: int) -> np.ndarray:
    """(n, n) a full mass matrix."""
    return np.diag(np.linspace(0.5, 2.0, n)) + 0.1


def point(name: str) -> tuple[np.ndarray, ...]:
    """(q, v, a, f), two points each, about a regular pose."""
    n, rng = EVERY[name].n, seed("primitives", name)
    centre = CENTRES[name] if name in CENTRES else regular_pose(name)
    return centre + rng.uniform(-0.05, 0.05, (2, n)), rng.uniform(-1, 1, (2, n)), rng.uniform(-1, 1, (2, n)), rng.normal(size=(2, 6))


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("which", PRIMITIVES)
def test_a_primitive_carries_its_exact_derivative(name: str, which: str) -> None:
    robot = EVERY[name]
    if (which == "task_mass" and robot.n < 6) or (which == "solve_jacobian" and name == "branched"):
        with pytest.raises(NearSingular):
            PRIMITIVES[which](Primitives(robot))(*point(name))
        return
    f = PRIMITIVES[which](Primitives(robot))
    at, rng = point(name), seed(name, which)
    along = [rng.normal(size=x.shape) for x in at]
    found = f(*(Dual(x, d[..., None]) for x, d in zip(at, along, strict=True)))

    def moved(s: float) -> np.ndarray:
        return np.asarray(f(*(x + s * d for x, d in zip(at, along, strict=True))))

    assert_allclose(found.value, moved(0.0), rtol=1e-12, atol=1e-10)
    size = np.abs(found.tangent).max() + 1e-3
    error = np.inf
    for h in (1e-2, 2e-3, 5e-4):
        num = (45 * (moved(h) - moved(-h)) - 9 * (moved(2 * h) - moved(-2 * h)) + moved(3 * h) - moved(-3 * h)) / (60 * h)
        error = min(error, float(np.abs(found.tangent[..., 0] - num).max() / size))
    assert error < 1e-8
    h = 1e-3  # and the remainder is of second order, where there is one
    remainder = [np.linalg.norm(moved(s * h) - found.value - s * h * found.tangent[..., 0]) for s in (1.0, 0.5)]
    if remainder[1] > 1e-9 * np.abs(found.value).max():
        assert abs(np.log2(remainder[0] / remainder[1]) - 2.0) < 0.05
    else:
        assert robot.n <= 3 or (which == "friction" and not robot.coulomb.any())


@pytest.mark.parametrize("name", EVERY)
def test_values_are_those_of_the_robot(name: str) -> None:
    robot, P = EVERY[name], Primitives(EVERY[name])
    q, v, a, f = (x[0] for x in point(name))
    assert_allclose(P.mass(q, a), robot.mass(q) @ a, atol=1e-10)
    assert_allclose(P.rnea(q, v, a), robot.mass(q) @ a + robot.bias(q, v), atol=1e-9)
    assert_allclose(P.bias(q, v), robot.bias(q, v) + robot.viscous * v, atol=1e-10)
    assert_allclose(P.rnea(q, v, P.aba(q, v, a)), a, atol=1e-9)
    assert_allclose(P.mass(q, P.solve_mass(q, a)), a, atol=1e-10)
    assert_allclose(P.gravity(q), robot.gravity(q), atol=1e-12)
    assert_allclose(P.friction(v), robot.friction(v), atol=1e-12)
    assert_allclose(P.jacobian(q, v), robot.jacobian(q) @ v, atol=1e-12)
    assert_allclose(P.jacobian_transpose(q, f), robot.jacobian(q).T @ f, atol=1e-12)
    assert_allclose(P.jacobian_dot(q, v), robot.jacobian_rate(q, v) @ v, atol=1e-10)
    assert_allclose(P.pose(q).matrix, robot.pose(q), atol=1e-12)
    if name != "branched":
        assert_allclose(P.jacobian(q, P.solve_jacobian(q, P.jacobian(q, v))), P.jacobian(q, v), atol=1e-9)
    if robot.n >= 6:
        assert_allclose(P.task_mass(q, f), robot.task_inertia(q) @ f, atol=1e-7)
        assert_allclose(P.mobility(q, P.task_mass(q, f)), f, atol=1e-9)


@pytest.mark.parametrize("name", EVERY)
def test_the_pose_moves_with_the_body_twist_and_the_twist_with_its_rate(name: str) -> None:
    """J in the tool's own axes: a mix of LOCAL and WORLD fails here."""
    P = Primitives(EVERY[name])
    q, v, _, _ = (x[0] for x in point(name))
    h = 1e-4
    X = [P.pose(q + s * h * v).matrix for s in (-1, 1)]
    assert_allclose(log6(inverse(X[0]) @ X[1]) / (2 * h), P.jacobian(q, v), atol=1e-7)
    assert_allclose((P.jacobian(q + h * v, v) - P.jacobian(q - h * v, v)) / (2 * h), P.jacobian_dot(q, v), atol=1e-6)


def test_a_continuous_joint_lives_in_its_covering_angle() -> None:
    P = Primitives(TURNING)
    q = np.array([0.4, 0.3])
    assert_allclose(P.gravity(q + np.array([2 * np.pi, 0])), P.gravity(q), atol=1e-12)
    assert_allclose(P.pose(q + np.array([4 * np.pi, 0])).matrix, P.pose(q).matrix, atol=1e-12)
    assert TURNING.model.nq == 3


def test_the_pseudo_inverse_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    for name in ("planar_2r", "panda"):
        P, q, x = Primitives(arm(name)), regular_pose(name), rng.normal(size=6)
        assert_allclose(P.solve_jacobian(q, x), np.linalg.pinv(arm(name).jacobian(q)) @ x, atol=1e-9)
    J = arm("ur5").jacobian(regular_pose("ur5"))
    damped = J.T @ np.linalg.solve(J @ J.T + 0.01 * np.eye(6), x)
    assert_allclose(Primitives(arm("ur5")).solve_jacobian(regular_pose("ur5"), x, 0.1), damped, atol=1e-10)


def test_the_task_inertia_takes_another_mass_matrix_and_damping() -> None:
    P, q, x, m = Primitives(arm("panda")), regular_pose("panda"), np.random.default_rng(1).normal(size=6), constant_mass(7)
    J, M = arm("panda").jacobian(q), arm("panda").mass(q)
    assert_allclose(P.mobility(q, P.task_mass(q, x, 0.0, m), m), x, atol=1e-10)
    assert_allclose(P.task_mass(q, x, 0.0, m), np.linalg.solve(J @ np.linalg.solve(m, J.T), x), atol=1e-10)
    for given, mass in ((None, M), (m, m)):
        damped = J @ np.linalg.solve(mass, J.T) + 0.01 * 7 / np.trace(mass) * np.eye(6)
        assert_allclose(P.task_mass(q, x, 0.1, given), np.linalg.solve(damped, x), atol=1e-10)
    # with a mass matrix that is a multiple of 1 it is the damped inverse of J
    assert_allclose(J.T @ P.task_mass(q, x, 0.1, 3.0 * np.eye(7)), 3.0 * P.solve_jacobian(q, x, 0.1), atol=1e-10)


def test_a_singular_jacobian_is_told_refused_and_yields_to_damping() -> None:
    P = Primitives(arm("ur5"))
    near = np.array([0.1, -0.9, 1.6, -0.7, 1e-5, 0.3])
    assert 1e4 < P.at(near).nearest_singular.condition < 1e6
    assert_allclose(P.jacobian(near, P.solve_jacobian(near, np.ones(6))), np.ones(6), rtol=1e-9)
    straight = near * [1, 1, 1, 1, 0, 1]
    for call in (P.solve_jacobian, P.task_mass):
        with pytest.raises(NearSingular, match="tool0") as info:
            call(straight, np.ones(6))
        assert info.value.frame == "tool0" and info.value.sigma_min < 1e-12
    with pytest.raises(NearSingular, match="tool0"):
        P.task_mass(straight, np.ones(6), mass=np.eye(6))
    assert np.isfinite(P.solve_jacobian(straight, np.ones(6), 0.05)).all()
    assert np.isfinite(P.task_mass(straight, np.ones(6), 0.05)).all()


def test_a_payload_at_the_tool_is_a_body_there() -> None:
    """g, M and the kinetic energy by the payload's own pose and twist."""
    bare, m, com, I = arm("panda"), 2.0, np.array([0.02, -0.03, 0.1]), np.diag([0.01, 0.02, 0.03])
    loaded, q = bare.with_payload(m, com, I), regular_pose("panda")
    X = bare.pose(q) @ exp6(np.r_[com, 0, 0, 0])
    J = bare.jacobian(q)
    J_com = J[:3] - np.array([[0, -com[2], com[1]], [com[2], 0, -com[0]], [-com[1], com[0], 0]]) @ J[3:]
    assert_allclose(loaded.mass(q) - bare.mass(q), m * J_com.T @ J_com + J[3:].T @ I @ J[3:], atol=1e-10)
    assert_allclose(loaded.gravity(q) - bare.gravity(q), m * 9.81 * J_com.T @ X[:3, :3].T @ [0, 0, 1], atol=1e-10)


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("which", PRIMITIVES)
def test_one_point_gives_what_a_batch_gives(name: str, which: str) -> None:
    """One point goes to Pinocchio as it is, where the arm allows it."""
    P, rng = Primitives(EVERY[name]), seed(name, which)
    q, v, a, f = rng.uniform(-1, 1, (3, P.n)), rng.normal(size=(3, P.n)), rng.normal(size=(3, P.n)), rng.normal(size=(3, 6))
    if name in ROBOTS:
        q += regular_pose(name)
    call = PRIMITIVES[which](P)
    try:
        batch = call(q, v, a, f)
    except NearSingular:
        with pytest.raises(NearSingular):
            for i in range(3):
                call(q[i], v[i], a[i], f[i])
        return
    single = [call(q[i], v[i], a[i], f[i]) for i in range(3)]
    assert_allclose(np.stack(single), batch, rtol=1e-9, atol=1e-12 * np.abs(batch).max())
