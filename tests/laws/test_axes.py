"""Tool laws on selected directions: 9.5 and 9.16 with ``axes``, on arms of four to seven joints."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis import laws as L
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, NearSingular, NotConverged, Unsupported
from mfc_analysis.linearization.tracking_steps import step_metrics
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.dual import value
from mfc_analysis.maths.se3 import exp6, inverse, log6
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import ToolHold, ToolLine, ToolSinusoid, from_tool_path
from tests.conftest import arm, each, full, regular_pose, seed
from tests.dynamics.test_jacobians import misfit
from tests.robots.arms import SCARA

ARMS = {"scara": Robot.from_urdf(SCARA), "so100": arm("so100"), "ur5": arm("ur5"), "panda": arm("panda")}
Q = {"scara": np.array([0.4, 0.9, -0.1, 0.3]), "so100": np.array([0.2, 1.5, -1.7, 0.3, 0.4])}
ROWS = [[0.6, 0.8, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]]
Z, PUSH = [[0, 0, 1.0, 0, 0, 0]], [0.0, 0.0, 8.0, 0.0, 0.0, 0.0]
TIMES = np.array([0.0, 0.37, 0.81])
KP, KI, KD = 90.0, 40.0, 18.0
PLACES = [("scara", "xyzrz"), ("scara", "xyz"), ("so100", "xyz"), ("ur5", "xyz"), ("ur5", ROWS), ("ur5", "xyzrz"), ("panda", "xyz")]


def start(name: str) -> np.ndarray:
    return Q[name] if name in Q else np.array(regular_pose(name))


def swing(name: str) -> ToolSinusoid:
    """A path that a SCARA can follow too: it turns about the axis of its tool."""
    return ToolSinusoid(ARMS[name].pose(start(name)), [0.01, 0.015, -0.01], 3.0, angle=0.1, phase=0.4)


def on(name: str, law: L.Law, ref: object = None, robot: Robot | None = None, **more: object) -> ClosedLoop:
    return ClosedLoop(ARMS[name] if robot is None else robot, law, swing(name) if ref is None else ref, q_start=start(name), **more)


# --- the closed form ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("inverse_", ["dynamic", "euclidean"])
def test_with_a_joint_for_each_direction_an_exact_model_leaves_the_design_along_the_path(inverse_: str) -> None:
    lin = on("scara", L.TaskComputedTorque(KP, KI, KD, axes="xyzrz", inverse=inverse_)).linearize(TIMES)
    assert lin.coordinates == "error" and lin.state_names[:8] == tuple(f"{e}_{c}" for e in ("X_e", "V_e") for c in ("vx", "vy", "vz", "wz"))
    o, one = np.zeros((4, 4)), np.eye(4)
    want = np.block([[o, one, o], [-KP * one, -KD * one, -KI * one], [one, o, o]])
    assert_allclose(lin.A, np.broadcast_to(want, lin.A.shape), atol=1e-9)


def test_of_velocities_the_error_of_each_direction_decays_at_its_gain() -> None:
    lin = on("scara", L.TaskVelocity(each(4, 6.0), axes="xyzrz")).linearize(TIMES)
    assert_allclose(lin.A, np.broadcast_to(-np.diag(each(4, 6.0)), lin.A.shape), atol=1e-10)


@pytest.mark.parametrize(("name", "axes"), PLACES, ids=str)
@pytest.mark.parametrize("inverse_", ["dynamic", "euclidean"])
def test_at_rest_the_design_stands_k_times_beside_the_damped_self_motion(name: str, axes: object, inverse_: str) -> None:
    """prod (s^3 + kd s^2 + kp s + ki)^k (s^2 + c s)^(n - k), also where the orientation of the reference is one that the tool does not have."""
    c, robot = 4.0, ARMS[name].with_friction(viscous=0.0)
    X = robot.pose(start(name)) @ exp6(np.array([0, 0, 0, 0.4, -0.5, 0.0 if axes == "xyzrz" else 0.3]))
    law = L.TaskComputedTorque(KP, KI, KD, axes=axes, null_damping=c, inverse=inverse_)
    lin = on(name, law, ToolHold(X), robot).linearize([0.0])
    k, n = len(law.selection.rows), robot.n
    want = np.array([1.0])
    for factor in [[1, KD, KP, KI]] * k + [[1, c, 0]] * (n - k):
        want = np.polymul(want, factor)
    A = lin.A[0]
    if n > k:  # one integral for each direction: the others do not exist
        assert lin.coordinates == "state" and A.shape == (2 * n + k, 2 * n + k)
    for s in (2.0 + 3.0j, -5.0 + 1.0j, 20.0):
        assert_allclose(np.linalg.det(s * np.eye(len(A)) - A), np.polyval(want, s), rtol=1e-6)
    assert lin.stable[0] and not lin.drifts[0]


@pytest.mark.parametrize(("name", "axes"), PLACES, ids=str)
def test_of_fewer_than_six_directions_a_nonlinear_run_is_the_design_along_a_moving_path(name: str, axes: object) -> None:
    """X_e'' + Kd X_e' + Kp X_e = 0 with full gain matrices, exactly, while the other directions do as they like."""
    k = len(L.TaskVelocity(1.0, axes=axes).selection.rows)
    kp, kd = full(k, KP), full(k, KD)
    loop = on(name, L.TaskComputedTorque(kp, kd=kd, axes=axes, null_damping=4.0), ToolSinusoid(
        ARMS[name].pose(start(name)) @ exp6(np.array([0, 0, 0, 0.2, 0.5, 0.1])), [0.01, 0.015, -0.01], 3.0, axis=(1, 0, 1), angle=0.2))  # fmt: skip
    with np.errstate(all="raise"):
        run = loop.simulate(np.linspace(0.0, 0.6, 7), initial_error=0.02, rtol=1e-10, atol=1e-12)
    e, v = loop.equations, run.v[0]
    task = loop.law.task(e.plant, run.q[0], e.reference(0.0))
    x0 = np.r_[run.error[0], value(task.carried) - value(task.through(e.plant.jacobian(run.q[0], v)))]
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-kp, -kd]])
    assert_allclose(run.error[0], 0.02, atol=1e-12)
    assert_allclose(run.error, [(expm(A * t) @ x0)[:k] for t in run.t], atol=1e-8)
    assert np.linalg.norm(log6(inverse(ARMS[name].pose(run.q[-1])) @ loop.ref(0.6).X)[3:]) > 0.1  # the orientation is another one


@pytest.mark.parametrize("name", ["so100", "panda"])
def test_of_positions_the_velocity_law_leaves_exponentials_along_a_moving_path(name: str) -> None:
    loop = on(name, L.TaskVelocity(5.0, axes="xyz"))
    run = loop.simulate(np.linspace(0.0, 0.8, 5), initial_error=[0.02, -0.01, 0.015], rtol=1e-10, atol=1e-12)
    assert_allclose(run.error, np.exp(-5.0 * run.t)[:, None] * [0.02, -0.01, 0.015], atol=1e-8)


# --- exactness ---------------------------------------------------------------------------------------------------------------


LAWS = {
    "9.5": lambda k: L.TaskVelocity(full(k, 4.0), each(k, 3.0)),
    "9.5 printed": lambda k: L.TaskVelocity(full(k, 4.0), each(k, 3.0), form="printed"),
    "9.5 no_adjoint": lambda k: L.TaskVelocity(full(k, 4.0), form="no_adjoint"),
    "9.16": lambda k: L.TaskComputedTorque(full(k, KP), KI, each(k, KD), null_damping=3.0),
    "9.16 printed": lambda k: L.TaskComputedTorque(full(k, KP), KI, each(k, KD), form="printed"),
    "9.16 euclidean": lambda k: L.TaskComputedTorque(KP, None, KD, null_damping=3.0, inverse="euclidean"),
    "9.16 damped": lambda k: L.TaskComputedTorque(KP, KI, KD, null_damping=3.0, damping=0.05),
    "9.24": lambda k: L.HybridMotionForce(PUSH, full(k, KP), each(k, KI), full(k, KD), 0.5, 2.0, 30.0, constraints=Z),
    "9.24 selection": lambda k: L.HybridMotionForce(PUSH, full(k, KP), None, KD, 0.5, constraints=Z, projection="selection"),
    "9.24 printed": lambda k: L.HybridMotionForce(PUSH, full(k, KP), each(k, KI), full(k, KD), constraints=Z, form="printed"),
}


@pytest.mark.parametrize("case", LAWS)
@pytest.mark.parametrize(("name", "axes"), [("scara", "xyzrz"), ("so100", "xyz"), ("ur5", "xyzrz"), ("panda", ROWS)], ids=str)
def test_the_jacobian_is_that_of_the_equations(case: str, name: str, axes: object) -> None:
    law = LAWS[case](len(L.TaskVelocity(1.0, axes=axes).selection.rows)).changed(axes=axes)
    heavier = ARMS[name].with_payload(0.3, com=(0.02, -0.01, 0.05), inertia=0.01).with_friction(viscous=0.3, coulomb=0.2, coulomb_speed=0.7)
    found = misfit(on(name, law, robot=heavier, controller_model=ARMS[name]), seed(case, name))
    assert found.error < 1e-7
    assert np.isnan(found.order) or abs(found.order - 2.0) <= 0.05


@pytest.mark.parametrize(("name", "axes"), [("scara", "xyzrz"), ("so100", "xyz")])
def test_the_linear_model_predicts_the_run_to_second_order_and_the_run_arrives(name: str, axes: str) -> None:
    loop = on(name, L.TaskComputedTorque(KP, KI, KD, axes=axes, null_damping=4.0), ToolHold(ARMS[name].pose(start(name))))
    assert loop.validate(0.3).taylor_order == pytest.approx(2.0, abs=0.1)
    run = loop.simulate(4.0, initial_error=0.03)
    assert np.abs(run.error[0]).min() > 0.029 and np.abs(run.error[-1]).max() < 5e-4  # the root of the integral decays as exp(-0.48 t), times 0.02


def test_a_scara_presses_while_it_moves_as_two_loops_of_their_own() -> None:
    """Three copies of s^2 + kd s + kp, and m s^3 + kdamp s^2 + k (1 + kfp) s + k kfi with m = 1/(A Lambda^-1 A^T)."""
    k, kfp, kfi, kdamp = 2e4, 0.8, 4.0, 150.0
    law = L.HybridMotionForce(np.zeros(6), KP, kd=KD, kfp=kfp, kfi=kfi * np.eye(6)[2], kdamp=kdamp * np.eye(6)[2], constraints=Z, axes="xyzrz")
    X = ARMS["scara"].pose(start("scara"))
    lin = on("scara", law, ToolHold(X), environment=Environment(k, pose=X, axes="z")).linearize([0.0])
    assert lin.coordinates == "error"
    kept = [*range(8), 10]  # the other integrals of the force act on nothing
    J, M = ARMS["scara"].jacobian(start("scara"))[[0, 1, 2, 5]], ARMS["scara"].mass(start("scara"))
    m = 1 / (J @ np.linalg.solve(M, J.T))[2, 2]
    want = np.array([1.0, kdamp / m, k * (1 + kfp) / m, k * kfi / m])
    for _ in range(3):
        want = np.polymul(want, [1, KD, KP])
    assert_allclose(np.poly(lin.A[0][np.ix_(kept, kept)]), want, rtol=1e-8)


def test_all_six_directions_selected_are_the_law_without_a_selection() -> None:
    rows = [[0, 0.6, 0.8, 0, 0, 0], np.eye(6)[3]]
    given = {"kp": full(6, KP), "ki": each(6, KI), "kd": full(6, KD), "kfp": 0.5, "kfi": 2.0, "kdamp": 30.0, "constraints": rows}
    wall = Environment(1e4, 20.0, pose=ARMS["ur5"].pose(start("ur5")), axes="z", preload=5.0)
    for more in ({}, {"projection": "selection"}, {"form": "printed_eta"}):
        one, other = (on("ur5", L.HybridMotionForce(PUSH, **given, **more, **axes), environment=wall) for axes in ({}, {"axes": "xyzrxryrz"}))
        assert_allclose(one.linearize(TIMES, coordinates="state").A, other.linearize(TIMES, coordinates="state").A, atol=1e-6)


def test_steps_of_a_hybrid_selection_move_the_tool_along_what_is_free_and_press_along_the_rest() -> None:
    X = ARMS["scara"].pose(start("scara"))
    law = L.HybridMotionForce(PUSH, KP, kd=KD, kfp=0.5, kfi=4.0, kdamp=150.0, constraints=Z, axes="xyzrz")
    loop = on("scara", law, ToolHold(X), environment=Environment(1e4, 20.0, axes="z", preload=8.0))
    lin = loop.linearize([0.0])
    assert lin.stability.nonzero_stable[0]
    assert step_metrics(lin).channels == ("X_vx", "X_vy", "X_wz", "F_fz")
    assert loop.validate(0.2).taylor_order == pytest.approx(2.0, abs=0.05)


def test_margins_at_the_command_are_those_of_the_design() -> None:
    """The PID on a double integrator in each direction: its gain reduction is ki/(kd kp), whatever the arm."""
    lin = on("so100", L.TaskComputedTorque(KP, KI, KD, axes="xyz", null_damping=4.0), ToolHold(ARMS["so100"].pose(start("so100")))).linearize()
    found = lin.margins(at="command")
    assert found.channels == ("vx", "vy", "vz")
    assert_allclose(found.gain_reduction, np.sqrt(KI / (KD * KP)) ** 2, rtol=1e-6)
    assert np.isinf(found.gain_increase).all()


@pytest.mark.parametrize(("name", "axes"), [("so100", "xyz"), ("ur5", "xrz")])
def test_a_step_of_the_reference_moves_the_tool_by_it_along_the_axes_of_the_tool(name: str, axes: str) -> None:
    """X_e/X_d = 1 - kp/(s^2 + kd s + kp) in each direction, also where the reference is turned from the tool by half a radian."""
    X = ARMS[name].pose(start(name)) @ exp6(np.array([0, 0, 0, 0.5, 0.2, 0.3 if axes == "xyz" else 0.0]))
    lin = on(name, L.TaskComputedTorque(KP, kd=KD, axes=axes, null_damping=4.0), ToolHold(X)).linearize()
    names = ("vx", "vy", "vz") if axes == "xyz" else ("vx", "wz")
    k = len(names)
    assert lin.input_names[:k] == tuple(f"X_d_{c}" for c in names)
    jw = 4.0j
    A, B, C, D = lin.A[0], lin.B[0][:, :k], lin.C[0], lin.D[0][:, :k]
    rows = [lin.output_names.index(f"X_e_{c}") for c in names]
    found = (C @ np.linalg.solve(jw * np.eye(len(A)) - A, B) + D)[rows]
    assert_allclose(np.eye(k) - found, KP / (jw**2 + KD * jw + KP) * np.eye(k), atol=1e-9)


@pytest.mark.parametrize(("name", "axes"), [("so100", "xyz"), ("ur5", "xrz"), ("ur5", "xyzrxryrz")])
def test_the_nonlinear_system_of_python_control_has_the_linear_model_as_its_slope(name: str, axes: str) -> None:
    X = ARMS[name].pose(start(name)) @ exp6(np.array([0, 0, 0, 0.3, 0.2, 0.0]))
    loop = on(name, L.TaskComputedTorque(KP, KI, KD, axes=axes, null_damping=4.0), ToolHold(X))
    lin, system, h = loop.linearize(coordinates="state"), loop.nlsys(), 1e-6
    x, u = lin.point.x[0], np.zeros(lin.B.shape[2])
    for i in range(len(loop.law.selection.rows)):
        moved = np.eye(u.size)[i] * h
        for ask, matrix in (("dynamics", lin.B), ("output", lin.D)):
            slope = (getattr(system, ask)(0.0, x, u + moved) - getattr(system, ask)(0.0, x, u - moved)) / (2 * h)
            assert_allclose(slope, matrix[0, :, i], atol=1e-6 * max(1.0, float(np.abs(matrix).max())))


# --- the reference -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "axes"), [("scara", "xyzrz"), ("so100", "xyz"), ("ur5", "xyz"), ("panda", "xyzrz")])
def test_the_joints_follow_the_selected_directions_of_a_tool_path(name: str, axes: str) -> None:
    """9.14: on the path, and q, v, a are derivatives of each other."""
    robot, t, h = ARMS[name], np.array([0.0, 0.5, 1.3]), 1e-3
    X0 = robot.pose(start(name))
    X1 = np.array(X0)
    X1[:3, 3] += [0.02, -0.03, 0.02]
    ref = ToolLine(X0, X1 @ exp6(np.array([0, 0, 0, 0, 0, 0.2])), 2.0)
    loop = on(name, L.TaskVelocity(1.0, axes=axes), ref)
    at = [loop.nominal(t[1:] + s * h) for s in (-2, -1, 0, 1, 2)]
    E = inverse(robot.pose(at[2].q)) @ ref(t[1:]).X
    assert_allclose(E[:, :3, 3] if axes == "xyz" else log6(E)[:, [0, 1, 2, 5]], 0.0, atol=1e-10)
    for low, high in (("q", "v"), ("v", "a")):
        x = [getattr(one, low) for one in at]
        assert_allclose(getattr(at[2], high), (x[0] - 8 * x[1] + 8 * x[3] - x[4]) / (12 * h), atol=2e-6)
    path = from_tool_path(robot, ref, start(name), t, axes=axes)
    assert_allclose(path(t).q, loop.nominal(t).q, atol=1e-7)


def test_a_path_that_an_arm_cannot_follow_says_that_axes_leave_directions_out() -> None:
    X1 = np.array(ARMS["so100"].pose(start("so100")))
    X1[:3, 3] += [0.02, -0.03, 0.02]
    for call in (lambda: on("so100", L.TaskVelocity(1.0), ToolHold(X1)).nominal([0.0]), lambda: from_tool_path(
            ARMS["so100"], ToolHold(X1), start("so100"), [0.0, 1.0])):  # fmt: skip
        with pytest.raises(NotConverged, match="axes="):
            call()


# --- what is refused ---------------------------------------------------------------------------------------------------------


def test_more_directions_than_joints_are_refused() -> None:
    with pytest.raises(BadArgument, match="at most 4 directions"):
        on("scara", L.TaskVelocity(1.0, axes="xyzrxrz"))


def test_gains_are_those_of_the_directions() -> None:
    with pytest.raises(BadArgument, match="3 selected directions"):
        on("so100", L.TaskVelocity(np.ones(6), axes="xyz"))
    on("so100", L.TaskVelocity(np.ones(3), np.eye(3), axes="xyz"))


def test_a_direction_that_the_arm_does_not_have_is_a_singularity() -> None:
    with pytest.raises(NearSingular, match="smallest singular value"):
        on("scara", L.TaskVelocity(1.0, axes="xyzrx"), ToolHold(ARMS["scara"].pose(start("scara")))).linearize()


def test_error_coordinates_need_a_joint_for_each_direction_and_no_more() -> None:
    with pytest.raises(Unsupported, match="3 selected directions"):
        on("so100", L.TaskVelocity(1.0, axes="xyz")).linearize(coordinates="error")


def test_hybrid_control_of_a_smaller_arm_says_what_to_use() -> None:
    with pytest.raises(BadArgument, match="axes= selects"):
        on("scara", L.HybridMotionForce(np.zeros(6), KP, constraints=Z))
    with pytest.raises(BadArgument, match="within the selected directions"):
        L.HybridMotionForce(np.zeros(6), KP, constraints=[[0, 0, 1.0, 1.0, 0, 0]], axes="xyzrz")


def test_an_initial_error_has_the_size_of_the_selection() -> None:
    loop = on("panda", L.TaskVelocity(1.0, axes="xyz"))
    for given in (0.01, [0.01, 0.0, -0.02]):
        assert_allclose(loop.simulate(1e-3, initial_error=given).error[0], given, atol=1e-12)
    with pytest.raises(BadArgument, match=r"X_e of shape \(3,\)"):
        loop.simulate(1.0, initial_error=np.ones(6))
    assert loop.simulate(1e-3, initial_error=0.01 * np.ones(7)).error.shape[1] == 3  # of the joints


def test_axes_are_told_and_changed() -> None:
    law = L.TaskComputedTorque(KP, axes="xyz")
    assert str(law) == "TaskComputedTorque(kp = 90, axes='xyz') [eq. 9.16]"
    assert "axes=[[0.6, 0.8" in str(law.changed(axes=ROWS)) and law.changed(axes=None).selection is None
    assert "axes" in L.TaskVelocity.parameters() and "selection" not in L.TaskVelocity.parameters()


def test_axes_run_sampled_late_and_behind_elastic_joints() -> None:
    law = L.TaskComputedTorque(KP, KI, KD, axes="xyz", null_damping=4.0)
    ref = ToolHold(ARMS["so100"].pose(start("so100")))
    for hardware in (Hardware(sample_time=2e-3, delay=1e-3), Hardware(joint_stiffness=2e3, motor_inertia=0.05, torque_lag=1e-3)):
        loop = on("so100", law, ref, hardware=hardware)
        assert np.isfinite(loop.linearize().A).all()
        run = loop.simulate(0.2, initial_error=0.005)
        assert not run.diverged and run.error.shape[1] == 3
