"""Impedance control: one mass and six axes in closed form, both sides of the bound, shaped and unshaped, and 9.16 with the same gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, NearSingular, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import adjoint, exp6, inverse, log6
from mfc_analysis.trajectories import Hold, ToolSinusoid
from tests.conftest import F_D, arm, each, full, moving, regular_pose, seed, spd, surfaces
from tests.laws.gantry import AXES, INERTIAS, gantry

FEW = settings(max_examples=12, deadline=None)
masses, stiffnesses, dampings, walls, lags = st.floats(0.3, 5), st.floats(20, 2000), st.floats(1, 200), st.floats(100, 1e5), st.floats(1e-3, 0.05)


def slider(K: float, D: float, m: float, wall: float, lag: float | None = None, inertia: float | None = None) -> ClosedLoop:
    law = L.Impedance(K, D, inertia, axes="z")
    return ClosedLoop(robots.slider(m), law, Hold([0.0]), environment=Environment(wall), hardware=Hardware(torque_lag=lag))


def assert_polynomial(A: np.ndarray, want: np.ndarray) -> None:
    """The characteristic polynomial of A, to 1e-9 of its terms at the size of the roots."""
    want = np.asarray(want) / want[0]
    scale = np.abs(np.linalg.eigvals(A)).max() ** np.arange(len(want))
    assert np.max(np.abs(np.poly(A) - want) / scale) < 1e-9


# --- one mass ----------------------------------------------------------------------------------------------------------------


@FEW
@given(K=stiffnesses, D=dampings, m=masses, k=walls, T=lags)
def test_one_mass_on_a_spring_behind_a_lag_has_its_polynomial(K: float, D: float, m: float, k: float, T: float) -> None:
    assert_polynomial(slider(K, D, m, k).linearize().A[0], [m, D, K + k])
    assert_polynomial(slider(K, D, m, k, T).linearize().A[0], [m * T, m, D + k * T, K + k])


@FEW
@given(K=stiffnesses, D=dampings, m=masses, k=walls, M_d=masses, T=lags)
def test_a_shaped_mass_is_the_one_asked_for(K: float, D: float, m: float, k: float, M_d: float, T: float) -> None:
    """Without lag M_d s^2 + D s + K + k; with it m s^2 (T s + 1) = -(m/M_d)(D s + K + k) + k - k (T s + 1)."""
    assert_polynomial(slider(K, D, m, k, inertia=M_d).linearize().A[0], [M_d, D, K + k])
    assert_polynomial(slider(K, D, m, k, T, M_d).linearize().A[0], [m * T, m, m * D / M_d + k * T, m * (K + k) / M_d])


@FEW
@given(K=stiffnesses, m=masses, k=walls, T=lags)
def test_behind_a_lag_it_is_stable_with_more_damping_than_the_lag_takes_whatever_the_wall(K: float, m: float, k: float, T: float) -> None:
    for factor, stable in ((0.99, False), (1.01, True)):
        for wall in (k, 30 * k):
            assert bool(slider(K, factor * T * K, m, wall, T).linearize().stable[0]) == stable


@pytest.mark.parametrize("wall", [1e3, 4e3])
def test_simulations_on_both_sides_of_the_bound_decay_and_grow(wall: float) -> None:
    K, m, T = 800.0, 1.0, 0.02
    for factor, grows in ((0.5, True), (1.5, False)):
        run = slider(K, factor * T * K, m, wall, T).simulate(np.linspace(0, 1, 1001), 1e-4)
        early, late = np.abs(run.q[:300]).max(), np.abs(run.q[700:]).max()
        assert (late > early) == grows


# --- six axes ----------------------------------------------------------------------------------------------------------------


def on_gantry(law: L.Law, wall: np.ndarray, lag: float | None = None) -> ClosedLoop:
    surface = Environment(np.diag(wall))
    return ClosedLoop(gantry(), law, Hold(np.zeros(6)), environment=surface, hardware=Hardware(torque_lag=lag))


def axis_blocks(A: np.ndarray, names: tuple[str, ...]) -> list[np.ndarray]:
    """A as six blocks, the states of one axis each; nothing couples them."""
    blocks = [[i for i, name in enumerate(names) if name.endswith(f"_{axis}")] for axis in AXES]
    rest = A.copy()
    for index in blocks:
        rest[np.ix_(index, index)] = 0.0
    assert np.abs(rest).max() < 1e-9 * np.abs(A).max()
    return [A[np.ix_(index, index)] for index in blocks]


@pytest.mark.parametrize("shaped", [False, True])
def test_six_axes_with_a_diagonal_lambda_are_six_masses(shaped: bool) -> None:
    K, D, wall, M_d, T = each(6, 300.0), each(6, 20.0), each(6, 4000.0), each(6, 2.5), 0.01
    assert_allclose(gantry().task_inertia(np.zeros(6)), np.diag(INERTIAS), atol=1e-12)
    lin = on_gantry(L.Impedance(K, D, M_d if shaped else None), wall, T).linearize(coordinates="state")
    for A, m, k_d, d, k, m_d in zip(axis_blocks(lin.A[0], lin.state_names), INERTIAS, K, D, wall, M_d, strict=True):
        r = m / m_d if shaped else 1.0
        assert_polynomial(A, [m * T, m, r * d + k * T, r * (k_d + k) if shaped else k_d + k])


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_a_shaped_arm_shows_its_inertia_along_every_axis(name: str) -> None:
    """(M_d s^2 + D s + K + k)^6 with the chosen inertia, whatever Lambda is, at rest on a wall in all directions."""
    q, K, D, M_d, k = regular_pose(name), 300.0, 40.0, 3.0, 2000.0
    law = L.Impedance(K, D, M_d, null_damping=2.0)
    wall = Environment(k * np.eye(6))
    loop = ClosedLoop(arm(name).with_friction(viscous=0.0), law, Hold(q), environment=wall)
    poles = loop.linearize().poles()[0]
    want = np.roots([M_d, D, K + k])
    near = np.abs(poles[:, None] - want).min(axis=1)
    assert np.sort(near)[:12].max() < 1e-4  # a root of multiplicity six is known to a sixth of the digits at worst


# --- shaped and unshaped -----------------------------------------------------------------------------------------------------


def swing(name: str) -> ToolSinusoid:
    return ToolSinusoid(arm(name).pose(regular_pose(name)), [0.01, 0.015, -0.01], 3.0, axis=(1, 0, 2), angle=0.1, phase=0.4)


def state(loop: ClosedLoop, *words: object) -> np.ndarray:
    rng, n = seed("impedance", *words), loop.robot.n
    return np.concatenate([regular_pose(loop.robot.name) + 0.05 * rng.normal(size=n), 0.5 * rng.normal(size=n)])


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_with_the_inertia_of_the_arm_shaped_is_unshaped(name: str) -> None:
    """M_d = Lambda(q) and an exact model: the same torque apart from the compensation that the force feedback adds and takes away."""
    K, D = full(6, 300.0), each(6, 40.0)
    unshaped = L.Impedance(K, D, F_d=F_D, null_damping=3.0)
    where = {"environment": surfaces(name, regular_pose(name)), "q_start": regular_pose(name)}
    loop = ClosedLoop(arm(name), unshaped, swing(name), **where)
    x = state(loop, name)
    shaped = replace(loop, law=replace(unshaped, inertia=arm(name).task_inertia(x[: loop.robot.n])))
    assert shaped.law.senses_force and not unshaped.senses_force
    one, two = loop.equations.flow(0.3, x), shaped.equations.flow(0.3, x)
    assert np.abs(one.F_tip).max() > 1
    assert_allclose(two.command, one.command, atol=1e-9 * np.abs(one.command).max())


@pytest.mark.parametrize("name", ["ur5", "kinova"])
def test_with_the_gains_of_9_16_it_is_9_16(name: str) -> None:
    """K = Lambda Kp, D = Lambda Kd: 9.16 without integral. Shaped with M_d = 1: 9.16 with the force compensated, so out of contact the same."""
    Kp, Kd = full(6, 90.0), full(6, 18.0)
    ideal = ClosedLoop(arm(name), L.TaskComputedTorque(Kp, kd=Kd), swing(name), q_start=regular_pose(name))
    x = state(ideal, name)
    Lambda = arm(name).task_inertia(x[: ideal.robot.n])
    for law in (L.Impedance(Lambda @ Kp, Lambda @ Kd), L.Impedance(Lambda @ Kp, Lambda @ Kd, Lambda), L.Impedance(Kp, Kd, 1.0)):
        found = replace(ideal, law=law).equations.flow(0.3, x).command
        want = ideal.equations.flow(0.3, x).command
        assert_allclose(found, want, atol=1e-9 * np.abs(want).max())


def test_the_law_is_its_formula_by_matrices_of_the_robot() -> None:
    """On a redundant arm in contact, every term from Robot's matrices and the path by differences."""
    name, K, D, M_d, c = "panda", full(6, 300.0), full(6, 40.0), spd(6, 3.0), 2.0
    robot = arm(name)
    where = {"environment": surfaces(name, regular_pose(name)), "q_start": regular_pose(name)}
    loop = ClosedLoop(robot, L.Impedance(K, D, F_d=F_D, null_damping=c), swing(name), **where)
    x, t, h = state(loop, "matrices"), 0.3, 1e-5
    q, v = x[:7], x[7:]
    E, ref = inverse(robot.pose(q)) @ swing(name)(t).X, swing(name)(t)
    J, Lambda = robot.jacobian(q), robot.task_inertia(q)
    carried = [adjoint(inverse(robot.pose(q + s * v)) @ swing(name)(t + s).X) @ swing(name)(t + s).V for s in (-h, h)]
    rate = (carried[1] - carried[0]) / (2 * h)
    f = K @ log6(E) + D @ (adjoint(E) @ ref.V - J @ v) + F_D
    J_bar = np.linalg.solve(robot.mass(q), J.T) @ Lambda
    null = (np.eye(7) - J_bar @ J) @ v
    bias = robot.bias(q, v) + robot.viscous * v
    F = np.asarray(loop.equations.flow(t, x).F_tip)
    rest = -J.T @ Lambda @ (robot.jacobian_rate(q, v) @ v) + bias - c * robot.mass(q) @ null
    want = J.T @ (f + Lambda @ rate) + rest
    assert_allclose(loop.equations.flow(t, x).command, want, atol=1e-6 * np.abs(want).max())
    shaped = replace(loop, law=replace(loop.law, inertia=M_d))
    want = J.T @ (Lambda @ (rate + np.linalg.solve(M_d, f - F)) + F) + rest
    assert_allclose(shaped.equations.flow(t, x).command, want, atol=1e-6 * np.abs(want).max())


def test_in_joint_space_it_is_computed_torque_with_the_gains_of_the_arm() -> None:
    """K = M Kp, D = M Kd: 9.10 without integral; M_d = M(q): shaped is unshaped."""
    name, Kp, Kd = "ur5", full(6, 90.0), full(6, 18.0)
    loop = ClosedLoop(arm(name), L.ComputedTorque(Kp, kd=Kd), moving(name))
    x = state(loop, "joints")
    M = arm(name).mass(x[:6])
    want = loop.equations.flow(0.3, x).command
    for law in (L.JointImpedance(M @ Kp, M @ Kd), L.JointImpedance(Kp, Kd, 1.0)):
        assert_allclose(replace(loop, law=law).equations.flow(0.3, x).command, want, atol=1e-9 * np.abs(want).max())
    walls = replace(loop, law=L.JointImpedance(M @ Kp, M @ Kd), environment=surfaces(name, regular_pose(name)))
    shaped = replace(walls, law=L.JointImpedance(M @ Kp, M @ Kd, M))
    one, two = (each_.equations.flow(0.3, x).command for each_ in (walls, shaped))
    assert_allclose(two, one, atol=1e-9 * np.abs(one).max())


def test_a_shaped_joint_shows_its_inertia() -> None:
    """J = 1 on the slider: M_d s^2 + D s + K + k."""
    loop = ClosedLoop(robots.slider(2.0), L.JointImpedance(300.0, 20.0, 0.7), Hold([0.0]), environment=Environment(1500.0))
    assert_polynomial(loop.linearize().A[0], [0.7, 20.0, 1800.0])


def test_joint_by_joint_it_is_a_spring_and_a_damper_on_each_effective_inertia() -> None:
    K, D, q = each(6, 300.0), each(6, 20.0), regular_pose("ur5")
    robot = arm("ur5").with_friction(viscous=0.0)
    loop = ClosedLoop(robot, L.JointImpedance(K, D), Hold(q))
    found = loop.linearize().decentralised().poles()[0]
    for roots, m, d, k in zip(found, np.diag(robot.mass(q)), D, K, strict=True):  # the weight is compensated
        assert_allclose(np.poly(roots), [1, d / m, k / m], rtol=1e-9)
    with pytest.raises(Unsupported):
        replace(loop, law=L.JointImpedance(K, D, 2.0)).linearize().decentralised()


# --- statics and signs -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("inertia", [None, 4.0])
def test_at_rest_the_wall_takes_the_share_of_its_stiffness_and_the_wrench_that_presses(inertia: float | None) -> None:
    """The spring K of the law, its end 10 mm inside, and the wall k share: F = k (K 0.01 + F_d) / (K + k)."""
    K, k, depth, pressed = 500.0, 2000.0, 0.01, 3.0
    law = L.Impedance(K, 30.0, inertia, F_d=[0, 0, pressed, 0, 0, 0], axes="z")
    loop = ClosedLoop(robots.slider(1.0), law, Hold([depth]), environment=Environment(k, pose=robots.slider(1.0).pose([0.0])))
    rest = loop.equilibrium()
    assert_allclose(rest.force[2], k * (K * depth + pressed) / (K + k), rtol=1e-9)
    assert rest.stable


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_pushed_by_hand_the_tool_gives_way_by_its_compliance(name: str) -> None:
    """tau_ext = J^T F: the tool moves by K^-1 F (to first order in F)."""
    q, K = regular_pose(name), spd(6, 400.0)
    F = 1e-3 * F_D
    loop = ClosedLoop(arm(name), L.Impedance(K, 80.0, null_damping=5.0), Hold(q))
    lin = loop.linearize(coordinates="state")
    n, J = arm(name).n, arm(name).jacobian(q)
    B = lin.system(0).B[:, [i for i, one in enumerate(lin.input_names) if one.startswith("disturbance")]]
    still = np.linalg.lstsq(lin.A[0], -B @ J.T @ F, rcond=1e-12)[0]
    assert_allclose(J @ still[:n], np.linalg.solve(K, F), atol=1e-9)


def test_the_arm_follows_a_moving_reference_exactly_only_with_feedforward() -> None:
    name = "panda"
    loop = ClosedLoop(arm(name), L.Impedance(400.0, 60.0, null_damping=3.0), swing(name), q_start=regular_pose(name))
    lagging = replace(loop, law=replace(loop.law, feedforward=False))
    errors = [np.abs(one.simulate(np.linspace(0, 1, 21)).error).max() for one in (loop, lagging)]
    assert errors[0] < 1e-5 < 1e-3 < errors[1]


# --- what is refused ---------------------------------------------------------------------------------------------------------


def test_without_lambda_it_works_where_j_loses_rank_and_on_fewer_joints() -> None:
    straight = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])  # the UR5 stretched out
    x = np.r_[straight, np.zeros(6)]
    with pytest.raises(NearSingular):
        ClosedLoop(arm("ur5"), L.Impedance(300.0, 30.0), Hold(straight)).equations.flow(0.0, x)
    plain = L.Impedance(300.0, 30.0, feedforward=False)
    assert_allclose(ClosedLoop(arm("ur5"), plain, Hold(straight)).equations.flow(0.0, x).command, arm("ur5").gravity(straight), atol=1e-9)
    few = ClosedLoop(arm("planar_2r"), plain, Hold([0.3, 0.9]))
    assert few.equations.nx == 4
    for law in (L.Impedance(300.0, 30.0), L.Impedance(300.0, 30.0, 1.0, feedforward=False)):
        with pytest.raises(BadArgument, match="feedforward=False"):
            ClosedLoop(arm("planar_2r"), law, Hold([0.3, 0.9]))


@pytest.mark.parametrize("inertia", [0.0, -1.0, [1.0, 1, 1, 1, 1, 0], -np.eye(6), np.eye(6) + np.eye(6, k=1)])
def test_an_inertia_that_no_mass_has_is_refused(inertia: object) -> None:
    for law in (L.Impedance, L.JointImpedance):
        with pytest.raises(BadArgument, match="inertia"):
            law(1.0, 1.0, inertia)


def test_the_force_is_a_point_of_the_loop_only_where_it_is_fed_back() -> None:
    q = regular_pose("ur5")
    for law in (L.Impedance(300.0, 30.0), L.JointImpedance(300.0, 30.0)):
        loop = ClosedLoop(arm("ur5"), law, Hold(q), environment=surfaces("ur5", q))
        assert loop.law.opens_at == ("torque", "command", "position") and "force" not in loop.equations.wire_sizes()
        with pytest.raises(Unsupported, match="force_filter"):
            replace(loop, hardware=Hardware(force_filter=1e-3))
        shaped = replace(loop, law=replace(law, inertia=2.0), hardware=Hardware(force_filter=1e-3, force_delay=1e-3))
        assert shaped.law.opens_at[-1] == "force" and shaped.linearize().margins(at="force").channels[0] == "fx"
    assert L.Impedance(1.0, 1.0).command_channels(()) == ("fx", "fy", "fz", "mx", "my", "mz")
    assert L.Impedance(1.0, 1.0, 1.0).command_channels(())[0] == "vx"
    assert L.Impedance(1.0, 1.0, axes="z").command_channels(()) == ("vz",)


@pytest.mark.parametrize(("name", "value"), [("feedforward", "no"), ("F_d", [1.0, 2.0]), ("null_damping", -1.0), ("inverse_damping", np.nan)])
def test_a_bad_feedforward_wrench_or_damping_is_refused(name: str, value: object) -> None:
    with pytest.raises(BadArgument, match=name):
        L.Impedance(1.0, 1.0, **{name: value})


def test_a_small_rotation_of_the_reference_is_a_torque_of_the_spring() -> None:
    """K X_e with X_e = log6(X^-1 X_d): a reference turned by 0.1 rad about the tool's z axis pulls with K 0.1 Nm about it."""
    q, turn = regular_pose("ur5"), np.array([0, 0, 0, 0, 0, 0.1])
    loop = ClosedLoop(arm("ur5"), L.Impedance(200.0, 10.0), Hold(q))
    turned = replace(loop, ref=ToolSinusoid(arm("ur5").pose(q) @ exp6(turn), 0.0, 1.0), q_start=q)
    pulled = [np.asarray(one.equations.flow(0.0, np.r_[q, np.zeros(6)]).command) for one in (loop, turned)]
    assert_allclose(pulled[1] - pulled[0], arm("ur5").jacobian(q).T @ (200.0 * turn), atol=1e-9)
