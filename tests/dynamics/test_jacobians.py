"""Exact Jacobians against differences, by order and by size, for each law in each form on every robot, in contact and out of it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.jacobians import closed_matrix, closed_system, external, matrix_at, open_system
from mfc_analysis.linearization.linearization import Linearization
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import exp6, inverse, log6
from mfc_analysis.trajectories import Hold, Sinusoid, ToolSinusoid
from tests.conftest import LAWS, ROBOTS, SIX, Case, arm, fits, loop_of, named, plant, regular_pose, seed, surfaces

TIMES = np.array([0.1, 0.9])
EVERY = [pytest.param(name, case, id=f"{name}-{case}") for name in ROBOTS for case in LAWS if fits(case, name)]


class Misfit(NamedTuple):
    """What a Jacobian lacks: its worst distance from differences, relative to the largest rate of each state, and the order of the remainder."""

    error: float
    order: float  #: NaN where there is no remainder above rounding: a linear loop


def misfit(loop: ClosedLoop, rng: np.random.Generator, *, lose_contact: bool = False) -> Misfit:
    """A of the closed loop against a ladder of 6th-order differences and against its own Taylor remainder, off the reference in every state."""
    e = loop.equations
    x = loop.linearize(TIMES).point.x
    x = x + 0.02 * rng.normal(size=x.shape)
    A = closed_matrix(e, TIMES, x, lose_contact=lose_contact)
    d = rng.normal(size=(2, *x.shape))
    exact = (A @ d[..., None])[..., 0]
    times = np.broadcast_to(TIMES, (2, 2))

    def at(h: float) -> np.ndarray:
        return e.rates(times, x + h * d, lose_contact=lose_contact)

    size = np.abs(exact).max(axis=(0, 1))
    size[size == 0] = 1.0
    error = np.inf
    for h in (1e-2, 2.5e-3, 6e-4):
        num = (45 * (at(h) - at(-h)) - 9 * (at(2 * h) - at(-2 * h)) + at(3 * h) - at(-3 * h)) / (60 * h)
        error = min(error, float((np.abs(num - exact).max(axis=(0, 1)) / size).max()))
        if error < 1e-10:
            break
    here = e.rates(TIMES, x)
    steps = (1e-3, 5e-4)
    large, small = (float(np.linalg.norm((at(h) - here - h * exact) / size)) for h in steps)
    assert large < 1e-3  # the remainder is small beside the rates: the two steps are in the range of the series
    return Misfit(error, np.log2(large / small) if small > 1e-10 else np.nan)


@pytest.mark.parametrize(("name", "case"), EVERY)
def test_the_jacobian_is_that_of_the_equations(name: str, case: Case) -> None:
    law = case.law(arm(name).n)
    limit = 1e-8 if law.space == "joint" and not hasattr(law, "F_d") else 1e-7
    for contact in (False, True) if law.plant == "torque" or law.senses_force else (False,):
        loop = loop_of(case, name, contact=contact)
        found = misfit(loop, seed(name, case.name, contact))
        assert found.error < limit
        if law.plant == "velocity" and law.space == "joint":
            assert np.isnan(found.order)  # these loops are linear, and the only ones that are
        else:
            assert abs(found.order - 2.0) <= 0.05


@pytest.mark.parametrize("which", [1, 2])
@pytest.mark.parametrize("name", ["panda", "xarm7"])
@pytest.mark.parametrize("case", named("9.16 standard", "9.16 null", "9.16 damped", "9.16 damped inertia", "9.16 null euclidean"), ids=str)
def test_the_jacobian_of_both_inverses_of_a_redundant_arm_is_exact_at_other_poses(case: Case, name: str, which: int) -> None:
    found = misfit(loop_of(case, name, contact=True, which=which), seed(case.name, name, which))
    assert found.error < 1e-7
    assert abs(found.order - 2.0) <= 0.05


@pytest.mark.parametrize("hardware", [
    Hardware(torque_lag=5e-3, velocity_filter=[2e-3, 3e-3, 2e-3, 2e-3, 1e-3, 1e-3]),
    Hardware(joint_stiffness=2e3, motor_inertia=0.3, feedback="link"),
    Hardware(joint_stiffness=2e3, motor_inertia=0.3, joint_damping=4.0, torque_lag=5e-3, velocity_filter=2e-3, torque_limit=1e4),
], ids=["lag and filter", "elastic", "all of them"])  # fmt: skip
@pytest.mark.parametrize("case", named("9.8", "9.9 printed", "9.10 printed", "9.11 LTI", "9.16 standard", "9.23", "9.24 dynamic standard"), ids=str)
def test_the_jacobian_stays_exact_behind_hardware(case: Case, hardware: Hardware) -> None:
    if case.law(6).senses_force:
        hardware = Hardware(**{**vars(hardware), "force_filter": 2e-3})
    found = misfit(loop_of(case, "ur5", contact=True, hardware=hardware), seed(case.name))
    assert found.error < 1e-7
    assert abs(found.order - 2.0) <= 0.05


def test_the_jacobian_of_surfaces_that_only_push_is_that_of_the_equations_on_either_side() -> None:
    case = named("9.23")[0]
    for preload, gone in ((8.0, False), (-8.0, True)):
        loop = loop_of(case, "ur5", contact=True)
        surfaces = [replace(s, one_sided=True, stiffness=np.asarray(s.stiffness) * 1e-3, preload=preload) for s in loop.environment]
        loop = ClosedLoop(loop.robot, loop.law, loop.ref, environment=surfaces)
        assert misfit_free_of_kink(loop) < 1e-7
        x = loop.linearize(TIMES).point.x
        free = closed_matrix(ClosedLoop(loop.robot, loop.law, loop.ref).equations, TIMES, x)
        assert np.allclose(closed_matrix(loop.equations, TIMES, x, lose_contact=True), free, rtol=0, atol=1e-9) == gone


def misfit_free_of_kink(loop: ClosedLoop) -> float:
    """The misfit of A by differences so small that no surface lets go."""
    e, x, rng = loop.equations, loop.linearize(TIMES).point.x, seed("kink")
    d, h = rng.normal(size=x.shape), 1e-4
    exact = (closed_matrix(e, TIMES, x, lose_contact=True) @ d[..., None])[..., 0]
    num = (8 * (e.rates(TIMES, x + h * d, lose_contact=True) - e.rates(TIMES, x - h * d, lose_contact=True))
           - (e.rates(TIMES, x + 2 * h * d, lose_contact=True) - e.rates(TIMES, x - 2 * h * d, lose_contact=True))) / (12 * h)  # fmt: skip
    return float(np.abs(num - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize(("name", "case"), [(n, c) for n in ("planar_2r", "z1", "panda") for c in LAWS if fits(c, n)], ids=str)
def test_the_open_loop_with_its_wires_closed_is_the_closed_loop(name: str, case: Case) -> None:
    loop = loop_of(case, name, contact=True)
    e, x = loop.equations, loop.linearize(TIMES).point.x
    closed = closed_matrix(e, TIMES, x)
    opened = open_system(e, TIMES, x)
    scale = np.abs(closed).max(axis=2, keepdims=True) + 1e-300
    assert np.max(np.abs(close_wires(opened)[0] - closed) / scale) < 1e-11  # the same sums in another order
    feedback = case.name not in ("9.1", "9.9 standard")
    assert np.allclose(opened.A, closed) != feedback  # something was cut
    for coordinates in ("state", "error") if fits_error(case, loop) else ("state",):
        cut, names = open_system(e, TIMES, x, coordinates), external(e, coordinates)
        assert (names.states, names.inputs, names.outputs) == (cut.state_names, cut.input_names, cut.output_names)
        for direct, shut in zip(closed_system(e, TIMES, x, coordinates), close_wires(cut), strict=True):
            assert_allclose(direct, shut, atol=1e-12 * max(1.0, float(np.abs(shut).max(initial=0.0))))


def fits_error(case: Case, loop: ClosedLoop) -> bool:
    """The error replaces the joint states."""
    return not case.tool or loop.equations.n == 6


@pytest.mark.parametrize("case", named("9.4", "9.5 no_adjoint", "9.8", "9.16 printed", "9.24 dynamic standard"), ids=str)
def test_external_inputs_and_outputs_are_differentiated_as_well(case: Case) -> None:
    """B and D against differences of the equations in the disturbance and F_d, C against differences in the state."""
    from mfc_analysis.dynamics.flow import Inputs
    from mfc_analysis.maths.dual import value

    loop = loop_of(case, "ur5", contact=True)
    lin = loop.linearize(TIMES, coordinates="state")
    e, x, h, rng = loop.equations, lin.point.x, 1e-4, seed(case.name)
    d = rng.normal(size=(2, 6))
    columns = [lin.input_names.index(f"disturbance_{j}") for j in loop.robot.joint_names]

    def pushed(s: float) -> np.ndarray:
        return value(e.join(e.flow(TIMES, x, None, Inputs(disturbance=s * d)).rates))

    num = (pushed(h) - pushed(-h)) / (2 * h)
    assert_allclose((lin.B[:, :, columns] @ d[..., None])[..., 0], num, atol=1e-8 * np.abs(num).max())
    move = rng.normal(size=x.shape)

    def seen(s: float) -> np.ndarray:
        flow = e.flow(TIMES, x + s * move)
        parts = [value(e.split(x + s * move)["q"]), value(flow.error), value(flow.command), value(flow.F_tip)]
        return np.concatenate(parts if e.surfaces else parts[:3], axis=-1)

    num = (8 * (seen(h) - seen(-h)) - seen(2 * h) + seen(-2 * h)) / (12 * h)
    assert_allclose((lin.C @ move[..., None])[..., 0], num, atol=1e-8 * np.abs(num).max())


def test_the_wrench_asked_for_is_an_input() -> None:
    loop = loop_of(named("9.24 dynamic printed_eta")[0], "ur5", contact=True)
    lin = loop.linearize(TIMES, coordinates="state")
    e, x, dF, h = loop.equations, lin.point.x, seed("F_d").normal(size=6), 0.5

    def rates(s: float) -> np.ndarray:
        other = ClosedLoop(loop.robot, replace(loop.law, F_d=loop.law.F_d + s * dF), loop.ref, loop.controller_model, loop.environment)
        return other.equations.rates(TIMES, x)

    columns = [lin.input_names.index(f"F_d_{c}") for c in ("fx", "fy", "fz", "mx", "my", "mz")]
    num = (rates(h) - rates(-h)) / (2 * h)  # the law is linear in F_d: no step is too large
    assert_allclose(lin.B[:, :, columns] @ dF, num, atol=1e-11 * np.abs(num).max())
    assert e.wire_sizes()["force"] == 6


# --- error coordinates -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SIX)
@pytest.mark.parametrize("case", [c for c in LAWS if c.tool and "damped" not in c.name and "null" not in c.name], ids=str)
def test_error_coordinates_are_the_linearised_rates_of_the_error_itself(name: str, case: Case) -> None:
    """Along the true flow d(X_e, V_e)/dt = A_error (X_e, V_e, ...) + f to first order: by differences of two runs' errors."""
    loop = loop_of(case, name, contact=case.law(6).plant == "torque")
    lin = loop.linearize(TIMES, coordinates="error")
    assert lin.state_names[:6] == ("X_e_vx", "X_e_vy", "X_e_vz", "X_e_wx", "X_e_wy", "X_e_wz")
    e, x = loop.equations, lin.point.x
    d, h = seed(name, case.name).normal(size=x.shape), 1e-4

    def errors(t: np.ndarray, x: np.ndarray) -> np.ndarray:
        """(X_e, V_e, the other states) at (t, x)."""
        s = e.split(x)
        q = np.ascontiguousarray(s["q"])
        ref = e.reference(t)
        E = inverse(loop.robot.pose(q)) @ ref.X.matrix
        X_e = log6(E)
        if loop.law.plant == "velocity":
            return np.concatenate([X_e, x[:, 6:]], axis=1)
        from mfc_analysis.maths.se3 import adjoint

        V_e = (adjoint(E) @ ref.V[..., None])[..., 0] - (loop.robot.jacobian(q) @ s["v"][..., None])[..., 0]
        return np.concatenate([X_e, V_e, x[:, 12:]], axis=1)

    def error_rates(x: np.ndarray) -> np.ndarray:
        rates, dt = e.rates(TIMES, x), 1e-4
        step = [errors(TIMES + k * dt, x + k * dt * rates) for k in (-2, -1, 1, 2)]
        return (step[0] - 8 * step[1] + 8 * step[2] - step[3]) / (12 * dt)

    change = (errors(TIMES, x + h * d) - errors(TIMES, x - h * d)) / (2 * h)
    num = (error_rates(x + h * d) - error_rates(x - h * d)) / (2 * h)
    scale = np.abs(num).max(axis=0) + 1.0
    # two differences, one inside the other: 1e-12 of rounding over 1e-8, and 1e-8 of truncation
    assert np.max(np.abs((lin.A @ change[..., None])[..., 0] - num) / scale) < 3e-4


@pytest.mark.parametrize("case", [c for c in LAWS if not c.tool and c.law(2).plant == "torque" and not hasattr(c.law(2), "F_d")], ids=str)
def test_for_joint_laws_both_coordinates_have_the_same_characteristic_polynomial(case: Case) -> None:
    loop = loop_of(case, "planar_2r")
    state, error = (loop.linearize(TIMES, coordinates=c) for c in ("state", "error"))
    for A, B in zip(state.A, error.A, strict=True):
        p, q = np.poly(A), np.poly(B)
        assert_allclose(p, q, atol=1e-10 * np.abs(p).max())
    assert error.state_names[:4] == ("e_joint1", "e_joint2", "e_dot_joint1", "e_dot_joint2")
    assert_allclose(transfer(error), transfer(state), atol=1e-9 * np.abs(transfer(state)).max())


def transfer(lin: Linearization, s: complex = 1j) -> np.ndarray:
    """(m, ny, nu) the closed loop at one complex frequency."""
    return lin.C @ np.linalg.solve(s * np.eye(lin.A.shape[-1]) - lin.A, lin.B + 0j) + lin.D


@pytest.mark.parametrize("case", [c for c in LAWS if c.tool and "damped" not in c.name and "null" not in c.name], ids=str)
def test_at_rest_a_tool_law_has_the_same_transfers_in_both_coordinates(case: Case) -> None:
    """From every input, the reference above all: a step of X_d is no step of the state X_e. (At rest: where something is left over, frames turn.)"""
    robot, q = arm("ur5"), regular_pose("ur5")
    law = case.law(6)
    if law.senses_force or not law.gains().get("ki"):  # nothing to push against: the reference is its rest point where the model is exact
        loop = ClosedLoop(robot, law if law.desired_wrench is None else replace(law, F_d=np.zeros(6)), Hold(q))
    else:
        loop = ClosedLoop(plant("ur5"), law, Hold(q), robot, surfaces("ur5", q) if law.plant == "torque" else None)
    state, error = (loop.linearize([0.0], coordinates=c) for c in ("state", "error"))
    assert np.abs(error.residual).max() < 1e-9
    found = transfer(state)
    assert_allclose(transfer(error), found, atol=1e-9 * np.abs(found).max())
    assert np.abs(found[:, :, [state.input_names.index("X_d_vx")]]).max() > 0.1


def test_frozen_roots_of_a_tool_law_depend_on_the_coordinates_on_a_moving_path_only() -> None:
    robot, q = arm("ur5"), regular_pose("ur5")
    law = L.TaskComputedTorque(90.0, 40.0, 18.0)
    moved = ClosedLoop(robot, law, ToolSinusoid(robot.pose(q), 0.05, 6.0, axis=(1, 0, 0), angle=0.3), q_start=q)
    still = ClosedLoop(robot, law, Sinusoid(q, 0.0, 1.0))
    for loop, same in ((moved, False), (still, True)):
        state, error = (np.poly(loop.linearize([0.1], coordinates=c).A[0]) for c in ("state", "error"))
        assert np.allclose(state, error, rtol=1e-6) == same


def test_columns_do_not_depend_on_which_points_are_linearised_together() -> None:
    loop = loop_of(named("9.16 standard")[0], "kinova", contact=True)
    t = np.linspace(0, 1, 7)
    together = loop.linearize(t).A
    for i in (0, 3, 6):
        assert_allclose(loop.linearize([t[i]]).A[0], together[i], rtol=0, atol=1e-11 * np.abs(together[i]).max())


@pytest.mark.parametrize(("name", "case"), EVERY)
def test_the_matrix_at_one_point_is_that_of_the_batch(name: str, case: Case) -> None:
    law = case.law(arm(name).n)
    for contact in (False, True) if law.plant == "torque" or law.senses_force else (False,):
        loop = loop_of(case, name, contact=contact)
        e = loop.equations
        x = loop.linearize(TIMES).point.x + 0.02 * seed(name, case.name).normal(size=(2, e.nx))
        A = closed_matrix(e, TIMES, x, lose_contact=contact)[1]
        assert_allclose(matrix_at(e, float(TIMES[1]), x[1], lose_contact=contact), A, rtol=0, atol=1e-10 * np.abs(A).max())


def test_a_small_pose_error_is_as_exact_as_a_large_one() -> None:
    """Pinocchio's Jlog6 loses up to 4e-5 between 1e-4 and 2e-3 rad; ours must not."""
    robot, q = plant("ur5"), regular_pose("ur5")
    for angle in (1e-5, 3e-4, 1.5e-3, 0.4, 3.0):
        X_d = robot.pose(q) @ exp6(np.array([0.01, 0.02, -0.01, *(angle * np.array([0.6, 0.0, 0.8]))]))
        twist = seed(angle).normal(size=6)
        from mfc_analysis.maths.se3 import Pose

        E = Pose.of(X_d, twist[:, None])
        h = 1e-5 if angle < 1 else 1e-4
        num = sum(w * log6(X_d @ exp6(k * h * twist)) for k, w in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12 * h)
        assert_allclose(E.log().tangent[:, 0], num, atol=2e-9)


def test_a_law_without_feedback_has_error_coordinates_too() -> None:
    ref = Sinusoid([0.1, 0.2], 0.1, 2.0)
    loop = ClosedLoop(robots.planar_2r(), L.VelocityFeedforward(), ref)
    lin = loop.linearize([0.0, 0.3], coordinates="error")
    assert not lin.A.any() and lin.A.shape == (2, 2, 2)
    assert_allclose(lin.B[..., :2], -loop.linearize([0.0, 0.3]).B[..., :2], atol=1e-12)
