"""Surfaces: force by hand in any frame, power, sums, one-sided contact, signs, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment, contact
from mfc_analysis.errors import BadArgument, NearPi
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.axes import AXES
from mfc_analysis.maths.se3 import Jlog6, exp6
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, regular_pose

NAME = "kinova"
TILTED = np.array([0.01, -0.02, 0.015, 0.5, -0.7, 0.9])


def place() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A joint position, a velocity, and the pose of a compliance frame near the tool, turned by more than 1 rad."""
    rng = np.random.default_rng(8)
    q = regular_pose(NAME)
    return q, rng.uniform(-1, 1, q.size), arm(NAME).pose(q) @ exp6(TILTED)


def force(surfaces: Environment | list[Environment], q: np.ndarray, v: np.ndarray, **more: bool) -> np.ndarray:
    given = surfaces if isinstance(surfaces, list) else [surfaces]
    return np.asarray(contact(given, Primitives(arm(NAME)), q, v, **more).wrench)


@pytest.mark.parametrize("axes", ["x", "y", "z", "xyz", "zx"])
def test_translations_press_along_the_axes_of_the_compliance_frame(axes: str) -> None:
    """By hand: f_world = sum of (k penetration + c rate + preload) along each axis, at the tool origin, without a moment."""
    q, v, X = place()
    k, c, f0 = (np.array(x[: len(axes)]) for x in ((900.0, 400.0, 2000.0), (3.0, 5.0, 7.0), (1.0, -2.0, 4.0)))
    found = force(Environment(k, c, pose=X, axes=axes, preload=f0), q, v)
    tool = arm(NAME).pose(q)
    speed = tool[:3, :3] @ (arm(NAME).jacobian(q) @ v)[:3]
    f_world = np.zeros(3)
    for i, axis in enumerate(axes):
        direction = X[:3, "xyz".index(axis)]
        f_world += direction * (k[i] * direction @ (tool[:3, 3] - X[:3, 3]) + c[i] * direction @ speed + f0[i])
    assert_allclose(found, np.r_[tool[:3, :3].T @ f_world, 0, 0, 0], atol=1e-10)


@pytest.mark.parametrize("axes", ["rx", "rz", "rxryrz"])
def test_rotations_press_by_the_rotation_vector_and_do_the_power_of_their_coordinate(axes: str) -> None:
    q, v, X = place()
    index = [AXES.index("r" + a) - 3 for a in axes.replace("r", "")]
    K, c = np.zeros((3, 3)), np.zeros((3, 3))
    K[index, index], c[index, index] = 30.0, 0.7
    found = force(Environment(30.0, 0.7, pose=X, axes=axes), q, v)
    w = Rotation.from_matrix(X[:3, :3].T @ arm(NAME).pose(q)[:3, :3]).as_rotvec()
    J = Jlog6(np.r_[0, 0, 0, w])[3:, 3:]
    rate = J @ (arm(NAME).jacobian(q) @ v)[3:]
    assert_allclose(found[:3], 0, atol=1e-12)
    assert_allclose(found[3:], J.T @ (K @ w + c @ rate), atol=1e-9)
    assert abs(found[3:] @ (arm(NAME).jacobian(q) @ v)[3:] - (K @ w + c @ rate) @ rate) < 1e-10


def test_a_frame_turned_by_nearly_pi_is_refused_where_its_rotations_resist_and_only_there() -> None:
    q, v, _ = place()
    over = arm(NAME).pose(q) @ exp6(np.array([0, 0, 0, np.pi - 1e-4, 0, 0]))
    upside = force(Environment(100.0, pose=over, axes="z", preload=2.0), q, v)
    assert_allclose(upside, [0, -2.0 * np.sin(1e-4), -2.0 * np.cos(1e-4), 0, 0, 0], atol=1e-9)
    for axes in ("rz", "xrx"):
        with pytest.raises(NearPi):
            force(Environment(100.0, pose=over, axes=axes), q, v)


def test_a_full_stiffness_stores_what_is_done_on_it() -> None:
    """F_tip . V is the rate of x^T K x / 2, along a motion, for a coupled (6, 6) stiffness."""
    q, v, X = place()
    B = np.random.default_rng(2).normal(size=(6, 6))
    K = 200 * (B @ B.T + np.eye(6))
    surface = Environment(K, pose=X)

    def energy(q: np.ndarray) -> float:
        E = np.linalg.inv(X) @ arm(NAME).pose(q)
        x = np.r_[E[:3, 3], Rotation.from_matrix(E[:3, :3]).as_rotvec()]
        return 0.5 * x @ K @ x

    h = 1e-5
    power = force(surface, q, v) @ (arm(NAME).jacobian(q) @ v)
    assert_allclose(power, (energy(q + h * v) - energy(q - h * v)) / (2 * h), rtol=1e-7)


def test_the_force_at_the_pose_is_the_preload_and_several_surfaces_add_up() -> None:
    q, v, X = place()
    here = arm(NAME).pose(q)
    assert_allclose(force(Environment(1e4, 20.0, pose=here, axes="z", preload=7.0), q, 0 * v), [0, 0, 7.0, 0, 0, 0], atol=1e-9)
    one, two = Environment(1e3, 2.0, pose=X, axes="zrx", preload=[1.0, 0.2]), Environment(500.0, 1.0, pose=here, axes="xyrz")
    assert_allclose(force([one, two], q, v), force(one, q, v) + force(two, q, v), atol=1e-12)


def test_each_axis_points_into_the_surface() -> None:
    """Deeper along +z of the frame: a larger, positive force, which a law's positive F_d asks for."""
    robot = robots.slider()
    P = Primitives(robot)
    wall = Environment(100.0, pose=np.eye(4), axes="z")
    deep, out = (np.asarray(contact([wall], P, np.array([d]), np.zeros(1)).wrench) for d in (0.1, -0.1))
    assert_allclose([deep[2], out[2]], [10.0, -10.0])
    upside = Environment(100.0, pose=exp6(np.array([0, 0, 0, np.pi / 2, 0, 0])) @ exp6(np.array([0, 0, 0, np.pi / 2, 0, 0])), axes="z")
    assert_allclose(np.asarray(contact([upside], P, np.array([-0.1]), np.zeros(1)).wrench), [0, 0, -10.0, 0, 0, 0], atol=1e-12)


def test_a_one_sided_surface_pushes_and_never_pulls_and_only_in_simulation() -> None:
    robot, P = robots.slider(), Primitives(robots.slider())
    wall = Environment(100.0, 5.0, pose=np.eye(4), axes="z", one_sided=True)

    def at(q: float, v: float, lose: bool) -> float:
        return float(np.asarray(contact([wall], P, np.array([q]), np.array([v]), lose_contact=lose).wrench)[2])

    assert at(-0.1, 0.0, True) == 0.0 and at(-0.1, 0.0, False) == -10.0
    assert at(0.1, 0.0, True) == at(0.1, 0.0, False) == 10.0
    assert at(0.1, -3.0, True) == 0.0  # a damper does not pull back
    assert at(-0.001, 3.0, True) == 0.0 and at(0.001, 3.0, True) == pytest.approx(15.1)  # and does not push before the touch
    held = [np.asarray(contact([wall], P, np.array([z]), np.array([3.0]), lose_contact=[np.arange(6) == 2]).wrench)[2] for z in (0.001, -0.001)]
    assert_allclose(held, [15.1, 14.9])  # an axis given as touched
    law = L.DampedForcePI([0, 0, 5.0, 0, 0, 0], 1.0, 2.0, 10.0)
    A = [ClosedLoop(robot, law, Hold([-0.2]), environment=Environment(100.0, pose=np.eye(4), one_sided=o)).linearize([0.0]).A for o in (True, False)]
    assert_allclose(A[0], A[1])


@pytest.mark.parametrize("axes", ["xyz", "rz", "zrxry", "full"])
def test_each_axis_of_a_one_sided_surface_pushes_where_its_own_elastic_force_does(axes: str) -> None:
    """f_i = max(0, p_i + (B d')_i) where p_i = (K d + f0)_i > 0; the elastic part is the force of the same surface without damping."""
    q, v, X = place()
    rng = np.random.default_rng(5)
    B = rng.normal(size=(6, 6))
    for sign in (1.0, -1.0, 3.0, -3.0):
        full = axes == "full"
        k, c, along = (300 * (B @ B.T + np.eye(6)), 9 * (B @ B.T + np.eye(6)), "z") if full else (300.0, 9.0, axes)
        surfaces = [Environment(k, d, pose=X, axes=along, preload=1.0, one_sided=o) for d, o in ((0.0 * c, False), (c, False), (c, True))]
        elastic, both, pushed = (np.asarray(contact([s], Primitives(arm(NAME)), q, sign * v, lose_contact=True).forces[0]) for s in surfaces)
        assert_allclose(pushed, np.where((elastic > 0) & (both > 0), both, 0.0), atol=1e-9)
        found = contact(surfaces[2:], Primitives(arm(NAME)), q, sign * v, lose_contact=True)
        assert_allclose(found.elastic[0], elastic, atol=1e-9)


def test_the_pose_is_the_tools_start_unless_given() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(arm("ur5"), L.OpenLoopForce(np.zeros(6)), Hold(q), environment=Environment(1e3, preload=2.0))
    assert_allclose(loop.equations.surfaces[0].pose, arm("ur5").pose(q))
    pushed_back = -arm("ur5").jacobian(q).T @ [0, 0, 2.0, 0, 0, 0]
    assert_allclose(loop.linearize([0.0]).residual[0], np.linalg.solve(arm("ur5").mass(q), pushed_back), atol=1e-8)


def test_values_are_taken_in_the_order_of_the_axes() -> None:
    one, two = Environment([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], axes="zxry"), Environment([2.0, 1.0, 3.0], [5.0, 4.0, 6.0], axes="xzry")
    assert_allclose(np.diag(one.K), [2.0, 0, 1.0, 0, 3.0, 0])
    assert_allclose(one.K, two.K)
    assert_allclose(one.B, two.B)
    assert one.axis_names == ("z", "x", "ry")


def test_another_stiffness_keeps_the_rest() -> None:
    soft = Environment(1e3, 5.0, pose=np.eye(4), axes="xz", preload=[1.0, 2.0], one_sided=True)
    hard = soft.with_stiffness(1e5)
    assert_allclose(np.diag(hard.K), [1e5, 0, 1e5, 0, 0, 0])
    assert_allclose(hard.f0, soft.f0)
    assert_allclose(hard.B, soft.B)
    assert hard.one_sided and hard.axes == "xz"


@pytest.mark.parametrize(("given", "argument"), [
    ({"stiffness": -1.0}, "stiffness"), ({"stiffness": np.nan}, "stiffness"), ({"stiffness": [1.0, 2.0]}, "stiffness"),
    ({"stiffness": "hard"}, "stiffness"),
    ({"stiffness": np.ones((3, 3))}, "stiffness"), ({"stiffness": -np.eye(6)}, "stiffness"), ({"stiffness": np.triu(np.ones((6, 6)))}, "stiffness"),
    ({"damping": -1.0}, "damping"), ({"damping": np.eye(6)}, "damping"), ({"damping": [1.0, 2.0]}, "damping"), ({"damping": np.inf}, "damping"),
    ({"axes": "w"}, "axes"), ({"axes": ""}, "axes"), ({"axes": "zz"}, "axes"), ({"axes": 3}, "axes"), ({"axes": "r"}, "axes"),
    ({"axes": "Z"}, "axes"),
    ({"preload": [1.0, 2.0]}, "preload"), ({"preload": np.nan}, "preload"),
    ({"pose": np.eye(3)}, "pose"), ({"pose": 2 * np.eye(4)}, "pose"), ({"one_sided": "yes"}, "one_sided"), ({"one_sided": 1}, "one_sided"),
])  # fmt: skip
def test_a_surface_that_cannot_be_is_refused_by_name(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        Environment(**{"stiffness": 1e3, **given})
    assert info.value.argument == argument


@pytest.mark.parametrize("environment", ["wall", 3.0, [1.0], [Environment(1.0), None], {"stiffness": 1.0}])
def test_what_is_no_surface_is_refused(environment: object) -> None:
    with pytest.raises(BadArgument) as info:
        ClosedLoop(robots.slider(), L.OpenLoopForce(np.zeros(6)), Hold([0.0]), environment=environment)
    assert info.value.argument == "environment"
