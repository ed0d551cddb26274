"""Selected directions of the tool: their error, its rates, and the maps to the joints, by differences and against all six."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.dual import Dual, value
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.robot import Robot
from mfc_analysis.robots.tool_task import SelectedTask, Selection, ToolTask, task_singular_values, tool_task
from mfc_analysis.trajectories import ToolSinusoid
from tests.conftest import arm, plant, regular_pose, seed
from tests.robots.arms import SCARA

MIXED = [[0.6, 0, 0, 0, 0.8, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1]]
ARMS = {"scara": Robot.from_urdf(SCARA), "so100": arm("so100"), "ur5": plant("ur5"), "panda": plant("panda")}
Q = {"scara": np.array([0.4, 0.9, -0.1, 0.3]), "so100": np.array([0.2, 1.5, -1.7, 0.3, 0.4])}
CASES = [
    ("scara", "xyzrz"), ("scara", "xyz"), ("scara", "xy"), ("so100", "xyz"), ("so100", "z"), ("ur5", "xyz"), ("ur5", MIXED), ("ur5", "xyzrxryrz"),
    ("panda", "xyz"), ("panda", "xyzrz"), ("ur5", "xyrxryrz"),
]  # fmt: skip


def place(name: str) -> tuple[np.ndarray, np.ndarray, ToolSinusoid]:
    """(q, v) of two points, and a path that passes near the tool but not through it, also turned."""
    rng = seed("task", name)
    q = Q[name] if name in Q else regular_pose(name)
    at = q + rng.uniform(-0.05, 0.05, (2, q.size))
    tilt = 0.0 if name == "scara" else 0.3
    return at, rng.uniform(-0.6, 0.6, at.shape), ToolSinusoid(ARMS[name].pose(q), [0.02, 0.03, -0.01], 2.0, axis=(tilt, 0, 1), angle=0.2, phase=0.4)


def task_at(name: str, axes: object, q: object, t: float = 0.3) -> SelectedTask:
    point = place(name)[2](t)
    made = tool_task(Selection(axes), Primitives(ARMS[name]), q, Pose.of(point.X), point.V, point.dV)
    assert isinstance(made, SelectedTask)
    return made


@pytest.mark.parametrize(("name", "axes"), CASES, ids=str)
def test_the_rates_of_the_error_and_of_its_velocity_are_those_of_differences(name: str, axes: object) -> None:
    """q, v and the reference move on; X_e' by differences, and (carried - through V)' = feedforward - through(J a + J' v)."""
    (q, v, _), a = place(name), seed("acceleration", name).uniform(-1, 1, (2, ARMS[name].n))
    model, h = Primitives(ARMS[name]), 1e-4

    def moved(s: float) -> tuple[np.ndarray, np.ndarray]:
        at, speed = q + s * v + 0.5 * s * s * a, v + s * a
        task = task_at(name, axes, at, 0.3 + s)
        return value(task.error), value(task.carried) - value(task.through(model.jacobian(at, speed)))

    def slope(which: int) -> np.ndarray:
        one, two = ((moved(s * h)[which] - moved(-s * h)[which]) / (2 * s * h) for s in (1, 2))
        return (4 * one - two) / 3

    task, V = task_at(name, axes, q), model.jacobian(q, v)
    assert_allclose(value(task.error_rate(V)), slope(0), atol=1e-9)
    V_dot = model.jacobian(q, a) + model.jacobian_dot(q, v)
    assert_allclose(value(task.feedforward(V)) - value(task.through(V_dot)), slope(1), atol=1e-8)
    if len(task.S) < 6:  # V_e is the rate of X_e, however large
        assert_allclose(value(task.carried) - value(task.through(V)), slope(0), atol=1e-9)
    J_rate = ARMS[name].jacobian_rate(q, v)
    turning = (task_at(name, axes, q + h * v, 0.3 + h).A - task_at(name, axes, q - h * v, 0.3 - h).A) / (2 * h)
    assert_allclose(task.rate_matrix(value(V), J_rate), turning, atol=1e-7)


MAPS: dict[str, Callable[[SelectedTask, object, object], object]] = {
    "error": lambda task, x, f: task.error,
    "carried": lambda task, x, f: task.carried,
    "through": lambda task, x, f: task.forward(x),
    "torque": lambda task, x, f: task.torque(f),
    "solve": lambda task, x, f: task.solve(f),
    "solve damped": lambda task, x, f: task.solve(f, 0.1),
    "mass": lambda task, x, f: task.mass(f),
    "mass damped": lambda task, x, f: task.mass(f, 0.1),
    "mass constant": lambda task, x, f: task.mass(f, 0.1, np.diag(np.linspace(0.5, 2.0, task.model.n)) + 0.1),
}


@pytest.mark.parametrize("what", MAPS)
@pytest.mark.parametrize(("name", "axes"), [("scara", "xyzrz"), ("so100", "xyz"), ("ur5", MIXED), ("panda", "xyzrz"), ("ur5", "xyzrxryrz")], ids=str)
def test_every_map_has_its_exact_derivative(what: str, name: str, axes: object) -> None:
    """Against differences, and its remainder of second order."""
    q = place(name)[0]
    n, k, rng = ARMS[name].n, len(Selection(axes).rows), seed(what, name)
    x, f, d = rng.normal(size=(2, n)), rng.normal(size=(2, k)), rng.normal(size=(2, 2 * n + k))
    seeds = np.broadcast_to(np.eye(2 * n + k), (2, 2 * n + k, 2 * n + k))
    duals = [Dual(part, seeds[:, i : i + part.shape[1]]) for part, i in ((q, 0), (x, n), (f, 2 * n))]
    found = MAPS[what](task_at(name, axes, duals[0]), duals[1], duals[2])
    assert isinstance(found, Dual)

    def at(h: float) -> np.ndarray:
        dq, dx, df = h * d[:, :n], h * d[:, n : 2 * n], h * d[:, 2 * n :]
        return value(MAPS[what](task_at(name, axes, q + dq), x + dx, f + df))

    exact, h = (found.tangent @ d[..., None])[..., 0], 1e-3
    numeric = (45 * (at(h) - at(-h)) - 9 * (at(2 * h) - at(-2 * h)) + at(3 * h) - at(-3 * h)) / (60 * h)
    assert_allclose(exact, numeric, atol=1e-8 * max(1.0, float(np.abs(exact).max())))
    left = [float(np.linalg.norm(at(s) - at(0.0) - s * exact)) for s in (1e-3, 5e-4)]
    assert left[1] < 1e-11 or abs(np.log2(left[0] / left[1]) - 2.0) < 0.05


def test_all_six_directions_by_name_are_those_without_a_selection() -> None:
    q, v, ref = place("ur5")
    model, point = Primitives(ARMS["ur5"]), ref(0.3)
    whole = tool_task(None, model, q, Pose.of(point.X), point.V, point.dV)
    assert type(whole) is ToolTask
    chosen, V = task_at("ur5", "xyzrxryrz", q), model.jacobian(q, v)
    f = seed("six").normal(size=(2, 6))
    for one, other in (
        (whole.error, chosen.error), (whole.carried, chosen.carried), (whole.feedforward(V), chosen.feedforward(V)),
        (whole.error_rate(V), chosen.error_rate(V)), (whole.solve(f), chosen.solve(f)), (whole.mass(f), chosen.mass(f)),
        (whole.torque(f), chosen.torque(f)),
    ):  # fmt: skip
        assert_allclose(value(other), value(one), rtol=1e-8, atol=1e-9)


def test_the_smallest_joint_velocity_moves_the_tool_as_asked_and_lambda_is_the_inertia_met() -> None:
    q, _, _ = place("panda")
    task, f = task_at("panda", "xyz", q), seed("panda least").normal(size=(2, 3))
    A, M = task.A, task.model.at(q).M
    assert_allclose(value(task.forward(task.solve(f))), f, atol=1e-12)
    assert_allclose(value(task.solve(f)), (np.linalg.pinv(A) @ f[..., None])[..., 0], atol=1e-12)
    mobility = A @ np.linalg.solve(M, np.swapaxes(A, -1, -2))
    assert_allclose((mobility @ value(task.mass(f))[..., None])[..., 0], f, atol=1e-10)


def test_a_direction_that_no_joint_moves_is_a_singular_selection() -> None:
    q = place("scara")[0]
    for call in (SelectedTask.solve, SelectedTask.mass):
        with pytest.raises(NearSingular, match="'hand'"):
            call(task_at("scara", "xyzrx", q), np.ones(4))
    assert value(task_at("scara", "xyzrx", q).solve(np.ones(4), 0.1)).shape == (2, 4)  # damped: as far as it can
    sigma = task_singular_values(Selection("xyzrx"), Primitives(ARMS["scara"]), q)
    assert sigma[..., -1].max() < 1e-12 and task_singular_values(None, Primitives(ARMS["scara"]), q).shape == (2, 4)


def test_a_selection_knows_its_units_and_whether_it_turns() -> None:
    assert Selection("xrz").units == ("m", "rad") and Selection(MIXED).units == ("m, rad", "m", "rad")
    assert Selection("xz").translates and not Selection("xrz").translates
