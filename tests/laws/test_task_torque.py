"""Equations 9.14 to 9.16: task-space dynamics, the error polynomial along a moving path, redundant arms, singular poses."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis import laws as L
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.dynamics.operating_point import trimmed
from mfc_analysis.errors import BadArgument, MfcWarning, NearPi, NearSingular, Unsupported
from mfc_analysis.laws.task_torque import TaskComputedTorque
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import ad, adjoint, exp6, inverse, log6
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import Hold, ToolHold, ToolLine, ToolSinusoid, from_tool_path
from tests.conftest import ARMS, SIX, arm, each, full, moving, plant, regular_pose, seed

TIMES = np.array([0.0, 0.37, 0.81])
REDUNDANT = [n for n in ARMS if n not in SIX]
INVERSES = ("dynamic", "euclidean")
EASY = np.array([0.1, -0.9, 1.6, -0.7, 1.2, 0.3])  # of the UR5, far from singular


def swing(name: str, frequency: float = 3.0) -> ToolSinusoid:
    """A tool path that moves and turns about a regular pose."""
    return ToolSinusoid(arm(name).pose(regular_pose(name)), [0.01, 0.015, -0.01], frequency, axis=(1, 0, 2), angle=0.1, phase=0.4)


def on(name: str, law: TaskComputedTorque, **more: object) -> ClosedLoop:
    return ClosedLoop(plant(name).with_friction(viscous=0.3), law, swing(name), q_start=regular_pose(name), **more)


# --- 9.15 --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SIX)
def test_a_tool_wrench_by_lambda_and_eta_is_the_joint_torque_of_the_joint_equations(name: str) -> None:
    robot, rng = plant(name), seed("9.15", name)
    q, v, a = regular_pose(name), rng.uniform(-1, 1, 6), rng.uniform(-2, 2, 6)
    J = robot.jacobian(q)
    dV = J @ a + robot.jacobian_rate(q, v) @ v
    tau = J.T @ (robot.task_inertia(q) @ dV + robot.task_bias(q, v))
    assert_allclose(tau, robot.mass(q) @ a + robot.bias(q, v), atol=1e-10)


@pytest.mark.parametrize("name", SIX)
@pytest.mark.parametrize("form", TaskComputedTorque.forms)
def test_the_law_is_the_page_in_lambda_form(name: str, form: str) -> None:
    """tau = J^T (Lambda^ (...) + eta^) by matrices of the robot, against the law's own form by inverse dynamics, far from the reference."""
    model, rng = arm(name), seed("9.16", name)
    Kp, Ki, Kd = full(6, 80.0), full(6, 30.0), full(6, 15.0)
    loop = on(name, TaskComputedTorque(Kp, Ki, Kd, form=form), controller_model=model)
    t, x = 0.6, None
    q, v, z = regular_pose(name) + rng.uniform(-0.05, 0.05, 6), rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.1, 0.1, 6)
    x = np.concatenate([q, v, z])
    ref = swing(name)(t)
    E = inverse(model.pose(q)) @ ref.X
    X_e, V, AdV = log6(E), model.jacobian(q) @ v, adjoint(E) @ ref.V
    if form == "standard":  # d/dt([Ad] V_d) by differences of the path itself
        h = 1e-5
        steps = [adjoint(inverse(model.pose(q + s * h * v)) @ swing(name)(t + s * h).X) @ swing(name)(t + s * h).V for s in (-1, 1)]
        feedforward, X_e_dot = (steps[1] - steps[0]) / (2 * h), AdV - V
    else:
        h = 1e-5
        steps = [log6(inverse(model.pose(q + s * h * v)) @ swing(name)(t + s * h).X) for s in (-1, 1)]
        feedforward, X_e_dot = ref.dV, (steps[1] - steps[0]) / (2 * h)
    command = feedforward + Kp @ X_e + Ki @ z + Kd @ X_e_dot
    viscous = model.viscous * v
    J = model.jacobian(q)
    tau = J.T @ (model.task_inertia(q) @ command + model.task_bias(q, v)) + viscous
    found = np.asarray(loop.equations.flow(t, x).command)
    scale = np.abs(model.task_inertia(q)).max()
    assert_allclose(found, tau, atol=1e-7 * scale)  # the rates above are differences of step 1e-5
    # and with the rate in closed form, to rounding
    if form == "standard":
        exact = adjoint(E) @ ref.dV - ad(V) @ AdV + Kp @ X_e + Ki @ z + Kd @ X_e_dot
        tau = J.T @ (model.task_inertia(q) @ exact + model.task_bias(q, v)) + viscous
        assert_allclose(found, tau, atol=1e-10 * max(1.0, scale))


# --- 9.16 with an exact model ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SIX)
@given(kp=st.floats(5, 500), ki=st.floats(1, 500), kd=st.floats(2, 60))
@settings(max_examples=4, deadline=None)
def test_an_exact_model_leaves_six_copies_of_the_design_polynomial(name: str, kp: float, ki: float, kd: float) -> None:
    lin = on(name, TaskComputedTorque(kp, ki, kd)).linearize(TIMES)
    assert lin.coordinates == "error"
    o, one = np.zeros((6, 6)), np.eye(6)
    # X_e' = V_e + ad(V_d) X_e .. is not so: V_e is measured in the tool's frame, and the first rows carry the moving frame
    design = np.polynomial.polynomial.polyfromroots(np.roots([1, kd, kp, ki]))
    for A in lin.A:
        single = np.poly(A)
        want = np.array([1.0])
        for _ in range(6):
            want = np.polymul(want, [1, kd, kp, ki])
        scale = np.cumprod(np.r_[1.0, np.full(18, np.abs(np.roots([1, kd, kp, ki])).max())])
        assert np.max(np.abs(single - want) / (scale * np.abs(want / scale).max())) < 1e-8
        assert_allclose(A[12:18, :6], one, atol=1e-12)
        assert_allclose(A[6:12], np.hstack([-kp * one, -kd * one, -ki * one]), atol=1e-8 * max(kp, ki, kd, 100))
        assert_allclose(A[:6, 6:12], one, atol=1e-9)
        assert_allclose(A[:6, 12:], o, atol=1e-12)
    assert design.size == 4


def test_the_period_map_along_the_path_has_the_eigenvalues_of_the_design() -> None:
    """Phi' = A(t) Phi in the coordinates of the state, integrated over one period: exp(s T), each six times."""
    name, kp, ki, kd = "ur5", 120.0, 150.0, 22.0
    loop = on(name, TaskComputedTorque(kp, ki, kd))
    T, n = loop.ref.period, 160
    h = T / n
    nodes = np.array([0.5 - np.sqrt(3) / 6, 0.5 + np.sqrt(3) / 6]) * h
    t = (np.arange(n) * h)[:, None] + nodes
    point = trimmed(loop.equations, t.ravel(), loop.nominal(t.ravel()))
    A = closed_matrix(loop.equations, t.ravel(), point.x).reshape(n, 2, 18, 18)
    Phi = np.eye(18)
    for a, b in A:  # Magnus, fourth order
        Phi = expm(0.5 * h * (a + b) + np.sqrt(3) / 12 * h * h * (b @ a - a @ b)) @ Phi
    found = np.linalg.eigvals(Phi)
    want = np.exp(np.roots([1, kd, kp, ki]) * T)
    distance = np.abs(found[:, None] - want)
    assert np.all(np.sum(distance.argmin(axis=1)[:, None] == np.arange(3), axis=0) == 6)
    assert distance.min(axis=1).max() < 2e-5 * np.abs(want).max() + 1e-9  # fourth order at 160 steps
    frozen = np.poly(A[0, 0])  # the frozen polynomial in these coordinates is another one
    assert not np.allclose(frozen / np.poly(np.repeat(np.roots([1, kd, kp, ki]), 6)), 1, rtol=1e-4)


def test_a_nonlinear_run_follows_the_error_equation_in_translation() -> None:
    """The reference at rest, a pure translation: X_e'' + kd X_e' + kp X_e = 0 exactly, however large."""
    robot, kp, kd = arm("ur5"), 30.0, 11.0  # poles -5 and -6
    loop = ClosedLoop(robot, TaskComputedTorque(kp, kd=kd), ToolHold(robot.pose(EASY)), q_start=EASY)
    X_e = np.array([0.1, -0.05, 0.08, 0, 0, 0])
    sim = loop.simulate(np.linspace(0, 1.5, 30), X_e, v=np.zeros(6), rtol=1e-10, atol=1e-12)
    assert_allclose(sim.error, (6 * np.exp(-5 * sim.t) - 5 * np.exp(-6 * sim.t))[:, None] * X_e, atol=1e-8)


def test_a_tool_path_and_its_joint_solution_are_the_same_reference() -> None:
    """9.14: the loop on the tool path, and on the joint trajectory that inverse kinematics makes of it."""
    law, name = TaskComputedTorque(90.0, 40.0, 18.0), "ur5"
    t = np.linspace(0, swing(name).period, 61)
    path = from_tool_path(arm(name), swing(name), regular_pose(name), t)
    one = ClosedLoop(plant(name), law, swing(name), q_start=regular_pose(name), controller_model=arm(name)).linearize(t[::20])
    two = ClosedLoop(plant(name), law, path, controller_model=arm(name)).linearize(t[::20])
    assert_allclose(two.A, one.A, atol=1e-6 * np.abs(one.A).max())


def test_as_printed_a_moving_path_changes_the_loop_and_a_rest_does_not() -> None:
    name = "ur5"
    laws = [TaskComputedTorque(90.0, 40.0, 18.0, form=form) for form in TaskComputedTorque.forms]
    rest = [ClosedLoop(arm(name), law, Hold(regular_pose(name))).linearize([0.0]).A for law in laws]
    assert_allclose(rest[0], rest[1], atol=1e-9)
    right, printed = (on(name, law).linearize(TIMES).A for law in laws)
    assert np.abs(right - printed).max() > 0.1


# --- redundant arms ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REDUNDANT)
def test_on_a_redundant_arm_the_elbow_drifts_unless_it_is_damped(name: str) -> None:
    robot, ref = arm(name).with_friction(viscous=0.0), Hold(regular_pose(name))
    design = np.poly(np.repeat(np.roots([1, 18.0, 90.0]), 6))
    for null, last in ((0.0, [1, 0, 0]), (3.0, [1, 3.0, 0])):
        lin = ClosedLoop(robot, TaskComputedTorque(90.0, kd=18.0, null_damping=null), ref).linearize([0.0])
        want = np.polymul(design, last)
        assert_allclose(np.poly(lin.A[0]), want, atol=1e-7 * np.abs(want).max())
        damped = null > 0
        assert (lin.neutral[0], lin.drifts[0], lin.stable[0]) == ((1, False, True) if damped else (0, True, False))


def test_on_a_redundant_arm_error_coordinates_do_not_determine_the_state() -> None:
    with pytest.raises(Unsupported, match="square Jacobian"):
        ClosedLoop(arm("panda"), TaskComputedTorque(90.0), Hold(regular_pose("panda"))).linearize([0.0], coordinates="error")


def torque(robot: Robot, law: TaskComputedTorque, q: np.ndarray, v: np.ndarray, X: np.ndarray) -> np.ndarray:
    """The law's torque at (q, v), holding the pose X with the integral at 0."""
    loop = ClosedLoop(robot, law, ToolHold(X), q_start=q)
    return np.asarray(loop.equations.flow(0.0, np.concatenate([q, v])).command)


@pytest.mark.parametrize("name", REDUNDANT)
@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("mass", [False, True], ids=["model", "constant"])
def test_on_a_redundant_arm_the_law_is_the_page_and_a_damped_null_space(name: str, which: int, mass: bool) -> None:
    """tau = J^T (Lambda^ (...) + eta^) + N^T (h^ - c M^ v) with N = 1 - M^^-1 J^T Lambda^ J, and M^ (J^# (...) - c (1 - J^# J) v) + h^."""
    robot, rng, kp, kd, c = arm(name), seed("redundant", name, which), 80.0, 15.0, 4.0
    q, v = np.array(regular_pose(name, which)), rng.uniform(-0.8, 0.8, 7)
    X = robot.pose(q) @ exp6(rng.uniform(-0.05, 0.05, 6))
    M = np.diag(np.linspace(0.5, 2.0, 7)) + 0.1 if mass else robot.mass(q)
    J, h = robot.jacobian(q), robot.bias(q, v) + robot.viscous * v
    J_dot_v, V = robot.jacobian_rate(q, v) @ v, J @ v
    Lambda = np.linalg.inv(J @ np.linalg.solve(M, J.T))
    N = np.eye(7) - np.linalg.solve(M, J.T @ Lambda @ J)
    command = kp * log6(inverse(robot.pose(q)) @ X) - kd * V
    eta = Lambda @ (J @ np.linalg.solve(M, h) - J_dot_v)
    page = J.T @ (Lambda @ command + eta) + N.T @ (h - c * M @ v)
    sharp = np.linalg.pinv(J)
    euclidean = M @ (sharp @ (command - J_dot_v) - c * (v - sharp @ V)) + h
    given = {"null_damping": c, "mass": M if mass else None}
    scale = max(np.abs(page).max(), np.abs(euclidean).max())
    assert_allclose(torque(robot, TaskComputedTorque(kp, kd=kd, **given), q, v, X), page, atol=1e-10 * scale)
    assert_allclose(torque(robot, TaskComputedTorque(kp, kd=kd, inverse="euclidean", **given), q, v, X), euclidean, atol=1e-10 * scale)
    assert np.abs(page - euclidean).max() > 1e-3 * scale
    # the null-space torque does not accelerate the tool
    damping = torque(robot, TaskComputedTorque(kp, kd=kd, **given), q, v, X) - torque(
        robot, TaskComputedTorque(kp, kd=kd, mass=given["mass"]), q, v, X
    )
    assert_allclose(damping, -c * N.T @ M @ v, atol=1e-10 * scale)
    assert_allclose(J @ np.linalg.solve(M, N.T), 0, atol=1e-9 * np.abs(J @ np.linalg.inv(M)).max())
    assert_allclose(J @ np.linalg.solve(M, damping), 0, atol=1e-9 * np.abs(np.linalg.solve(M, damping)).max())


@pytest.mark.parametrize("name", REDUNDANT)
def test_of_all_joint_accelerations_one_form_takes_the_least_energy_and_one_the_shortest(name: str) -> None:
    robot, q, rng = arm(name).with_friction(viscous=0.0), np.array(regular_pose(name)), seed("least", name)
    X = robot.pose(q) @ exp6(rng.uniform(-0.05, 0.05, 6))
    M, still = robot.mass(q), np.zeros(7)
    a = {
        inverse: np.linalg.solve(M, torque(robot, TaskComputedTorque(80.0, inverse=inverse), q, still, X) - robot.gravity(q)) for inverse in INVERSES
    }
    null = np.linalg.svd(robot.jacobian(q))[2][-1]
    assert_allclose(robot.jacobian(q) @ (a["dynamic"] - a["euclidean"]), 0, atol=1e-8)
    assert abs(null @ M @ a["dynamic"]) < 1e-9 * np.linalg.norm(a["dynamic"]) < np.linalg.norm(null @ M @ a["euclidean"])
    assert abs(null @ a["euclidean"]) < 1e-9 * np.linalg.norm(a["euclidean"]) < np.linalg.norm(null @ a["dynamic"])


@pytest.mark.parametrize("inverse", INVERSES)
@pytest.mark.parametrize("form", TaskComputedTorque.forms)
@pytest.mark.parametrize("name", REDUNDANT)
def test_on_a_redundant_arm_an_exact_model_gives_the_tool_the_commanded_acceleration(name: str, form: str, inverse: str) -> None:
    """dV/dt = command for any state on a moving path, whatever the null-space damping; and the self-motion decays at its rate."""
    robot, rng, c = arm(name), seed("exact", name), 5.0
    ref = ToolSinusoid(robot.pose(regular_pose(name)), [0.01, 0.015, -0.01], 3.0, axis=(1, 0, 2), angle=0.1, phase=0.4)
    q, v, z = regular_pose(name) + rng.uniform(-0.05, 0.05, 7), rng.uniform(-0.5, 0.5, 7), rng.uniform(-0.1, 0.1, 6)
    law, t = TaskComputedTorque(90.0, 40.0, 18.0, form=form, inverse=inverse, null_damping=c), 0.6
    J = robot.jacobian(q)

    def accelerations(law: TaskComputedTorque) -> tuple[np.ndarray, np.ndarray]:
        a = ClosedLoop(robot, law, ref, q_start=regular_pose(name)).equations.rates(t, np.concatenate([q, v, z]))[7:14]
        return a, J @ a + robot.jacobian_rate(q, v) @ v

    damped, free = accelerations(law), accelerations(law.changed(null_damping=0.0))
    assert_allclose(damped[1], free[1], atol=1e-8 * np.abs(free[1]).max())
    if form == "standard":
        at = ref(t)
        E = np.linalg.inv(robot.pose(q)) @ at.X
        V, V_d = J @ v, adjoint(E) @ at.V
        command = adjoint(E) @ at.dV - ad(V) @ V_d + 90.0 * log6(E) + 40.0 * z + 18.0 * (V_d - V)
        assert_allclose(free[1], command, atol=1e-8 * np.abs(command).max())
    null = np.linalg.svd(J)[2][-1]
    row = null @ robot.mass(q) if inverse == "dynamic" else null  # N v and (1 - J^# J) v measured along the null space
    assert_allclose(row @ (damped[0] - free[0]), -c * row @ v, atol=1e-8 * np.abs(row @ v))


@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize("mass", [None, np.diag(each(6, 1.5))], ids=["model", "constant"])
@pytest.mark.parametrize("name", SIX)
def test_for_a_square_jacobian_both_inverses_are_one(name: str, mass: np.ndarray | None, damping: float) -> None:
    law = TaskComputedTorque(90.0, 40.0, 18.0, mass=mass, damping=damping, null_damping=3.0)
    one, other = (on(name, law.changed(inverse=inverse)).linearize(TIMES, coordinates="state").A for inverse in INVERSES)
    assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(one).max())


@pytest.mark.parametrize("inverse", INVERSES)
@pytest.mark.parametrize("name", REDUNDANT)
def test_in_a_run_a_redundant_arm_follows_the_error_equation_and_its_elbow_comes_to_rest(name: str, inverse: str) -> None:
    robot, q, kp, kd = arm(name), np.array(regular_pose(name)), 30.0, 11.0  # poles -5 and -6
    law = TaskComputedTorque(kp, kd=kd, inverse=inverse, null_damping=6.0)
    loop = ClosedLoop(robot, law, ToolHold(robot.pose(q)), q_start=q)
    X_e = np.array([0.01, -0.006, 0.008, 0, 0, 0])
    null = np.linalg.svd(robot.jacobian(loop.simulate([0.0, 1e-3], X_e, v=np.zeros(7)).q[0]))[2][-1]
    sim = loop.simulate(np.linspace(0, 3.0, 61), X_e, v=0.5 * null, rtol=1e-9, atol=1e-11)
    assert_allclose(sim.error, (6 * np.exp(-5 * sim.t) - 5 * np.exp(-6 * sim.t))[:, None] * X_e, atol=1e-7)
    assert np.linalg.norm(sim.v[-1]) < 1e-4 < 0.4 < np.linalg.norm(sim.v[0])


@pytest.mark.parametrize("inverse", INVERSES)
def test_with_damping_a_redundant_arm_passes_a_singular_pose_and_a_heavier_arm_passes_it_alike(inverse: str) -> None:
    """The upper arm in line with the first joint: without damping it is refused. Lambda^ is damped relative to the arm's own inertia."""
    robot = arm("panda").with_friction(viscous=0.0)
    q = np.array([0.3, 0.0, np.pi / 2, -1.8, 0.0, 1.8, 0.2])
    assert np.linalg.svd(robot.jacobian(q), compute_uv=False)[-1] < 1e-9
    law = TaskComputedTorque(90.0, kd=18.0, null_damping=3.0, inverse=inverse)
    with pytest.raises(NearSingular):
        ClosedLoop(robot, law, Hold(q)).linearize([0.0])
    law = law.changed(damping=0.05)
    A = [ClosedLoop(r, law, Hold(q)).linearize([0.0]).A for r in (robot, robot.with_inertia_scaled(20.0))]
    assert np.isfinite(A[0]).all() and np.abs(A[0]).max() < 1e4
    assert_allclose(A[1], A[0], atol=1e-9 * np.abs(A[0]).max())
    sim = ClosedLoop(robot, law, Hold(q)).simulate(0.5, [0.005, 0, 0, 0, 0, 0.01], q=q + 0.02)
    assert not sim.diverged and np.isfinite(sim.q).all()


def test_an_unknown_inverse_is_refused() -> None:
    with pytest.raises(BadArgument, match=r"inverse: got 'moore'.*'dynamic'.*'euclidean'"):
        TaskComputedTorque(90.0, inverse="moore")


# --- singular poses and large errors -----------------------------------------------------------------------------------------


def near_singular(wrist: float) -> np.ndarray:
    return np.array([0.1, -0.9, 1.6, -0.7, wrist, 0.3])


@pytest.mark.parametrize("law", [L.TaskVelocity(3.0), TaskComputedTorque(90.0, kd=18.0),
                                 L.HybridMotionForce(np.zeros(6), 90.0, kd=18.0, constraints=np.eye(6)[[2]])], ids=str)  # fmt: skip
def test_near_a_singular_pose_the_loop_warns_and_then_refuses(law: L.Law) -> None:
    robot = arm("ur5")
    sigma = np.linalg.svd(robot.jacobian(near_singular(1e-5)), compute_uv=False)
    assert 1e4 < sigma[0] / sigma[-1] < 1e6
    with pytest.warns(MfcWarning, match=f"'tool0' is nearly singular at t = 0.5 s: smallest singular value {sigma[-1]:.3g}"):
        ClosedLoop(robot, law, Hold(near_singular(1e-5))).linearize([0.5])
    with pytest.raises(NearSingular, match=r"at t = 0\.5 s") as info:
        ClosedLoop(robot, law, Hold(near_singular(1e-8))).linearize([0.5])
    assert info.value.frame == "tool0" and info.value.time == 0.5 and info.value.condition > 1e6
    assert_allclose(info.value.sigma_min, np.linalg.svd(robot.jacobian(near_singular(1e-8)), compute_uv=False)[-1], rtol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ClosedLoop(robot, law, Hold(near_singular(1.2))).linearize([0.5])


def test_the_worst_of_several_times_is_named() -> None:
    from mfc_analysis.trajectories import Quintic

    ref = Quintic(near_singular(0.5), near_singular(-0.5), 2.0)
    with pytest.raises(NearSingular, match="at t = 1 s") as info:
        ClosedLoop(arm("ur5"), TaskComputedTorque(90.0, kd=18.0), ref).linearize([0.25, 1.0, 1.5])
    assert info.value.time == 1.0


@pytest.mark.parametrize("law", [L.TaskVelocity(3.0, damping=0.02), TaskComputedTorque(90.0, kd=18.0, damping=0.02)], ids=str)
def test_with_damping_a_singular_pose_is_passed(law: L.Law) -> None:
    loop = ClosedLoop(arm("ur5"), law, Hold(near_singular(1e-9)))
    assert np.isfinite(loop.linearize([0.0]).A).all()
    sim = loop.simulate(0.5, [0.01, 0, 0, 0, 0, 0.02], q=near_singular(0.02))
    assert not sim.diverged and np.isfinite(sim.q).all()


@pytest.mark.parametrize("hardware", [None, Hardware(sample_time=0.01)], ids=["ideal", "sampled"])
def test_a_run_into_a_singular_pose_stops_keeps_what_it_has_and_says_where(hardware: Hardware | None) -> None:
    """A line that leaves the workspace: the arm is stretched, and the law refuses, there or where it is thrown."""
    robot, X = arm("ur5"), arm("ur5").pose(EASY)
    away = X.copy()
    away[:3, 3] *= 2.5
    loop = ClosedLoop(robot, TaskComputedTorque(90.0, kd=18.0), ToolLine(X, away, 2.0), q_start=EASY, hardware=hardware)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim = loop.simulate(2.0)
    assert sum(issubclass(w.category, MfcWarning) for w in caught) <= 1  # not one for each step of the solver
    assert sim.diverged and 0.3 < sim.end < 2.0
    assert sim.t.size > 10 and all(np.isfinite(part).all() for part in (sim.q, sim.v, sim.tau, sim.error))
    assert f"at t = {sim.end:.4g} s" in sim.message


@pytest.mark.parametrize("hardware", [None, Hardware(sample_time=1e-3)], ids=["ideal", "sampled"])
def test_a_run_that_the_law_refuses_ends_at_that_time(hardware: Hardware | None) -> None:
    """Kp = -1 makes X_e grow as exp(t): from 1 rad it comes within 1e-3 of pi at ln(pi - 1e-3)."""
    loop = ClosedLoop(arm("ur5"), L.TaskVelocity(-1.0), ToolHold(arm("ur5").pose(EASY)), q_start=EASY, hardware=hardware)
    sim = loop.simulate(2.0, [0, 0, 0, 0, 0, 1.0])
    assert sim.diverged and sim.outcome.name == "REFUSED"
    assert_allclose(sim.end, np.log(np.pi - 1e-3), atol=5e-3)
    assert "3.14" in sim.message and "at t = 1.14" in sim.message
    assert np.isfinite(sim.q).all() and sim.error[-1, 5] > 3.1


def test_an_error_near_pi_is_refused_with_its_angle() -> None:
    robot, q = arm("ur5"), EASY
    X = robot.pose(q) @ exp6(np.array([0, 0, 0, 0, 0, np.pi - 1e-4]))
    loop = ClosedLoop(robot, TaskComputedTorque(90.0, kd=18.0), ToolHold(robot.pose(q)), q_start=q)
    other = ClosedLoop(robot, TaskComputedTorque(90.0, kd=18.0), ToolHold(X), q_start=q)
    x = np.concatenate([q, np.zeros(6)])
    with pytest.raises(NearPi, match=r"3\.141") as info:
        other.equations.flow(0.25, x)
    assert abs(info.value.angle - (np.pi - 1e-4)) < 1e-9 and info.value.time == 0.25
    assert np.abs(np.asarray(loop.equations.flow(0.25, x).error)).max() < 1e-12


def test_gains_act_on_linear_then_angular_parts_in_the_tool_frame() -> None:
    robot, q = arm("kinova"), regular_pose("kinova")
    K = np.array([50.0, 60, 70, 80, 90, 100])
    lin = ClosedLoop(robot, TaskComputedTorque(K, kd=20.0), moving("kinova")).linearize(TIMES)
    assert_allclose(lin.A[:, 6:12, :6], np.broadcast_to(-np.diag(K), (3, 6, 6)), atol=1e-8)
    assert q.shape == (6,)
