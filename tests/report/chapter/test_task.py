"""The sections on tool space, contact and hybrid control: what they say, confirmed another way."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.chapter import force, hybrid, task
from tests.report.read import statuses, told

G = 9.81


# --- 9.5, 9.14-9.16 ----------------------------------------------------------------------------------------------


def test_9_5_decays_by_the_exponential_and_has_the_integrators_margins() -> None:
    n = told("task")["tool-velocity"]["numbers"]
    error, t = np.array(n["error"]), np.array(n["times"])
    assert_allclose(error[-1], error[0] * np.exp(-4.0 * t[-1]), atol=1e-8)
    _, phase, _, crossover = control.margin(control.tf([4.0], [1, 0]))
    assert_allclose(n["phase_deg"], phase)
    assert_allclose(n["delay"], np.radians(phase) / crossover)


def test_the_true_orbit_decides_between_the_coordinates() -> None:
    n = told("task")["coordinates"]["numbers"]
    slowest = float(np.roots([1, 20, 100, 100]).real.max())
    assert n["9.16"]["floquet_exponent"] == pytest.approx(slowest, rel=1e-6)
    assert_allclose(n["9.16"]["error"], slowest, rtol=1e-6)
    assert max(n["9.5"]["state"]) > -0.75 > n["9.5"]["floquet_exponent"]  # the frozen roots in (q) are wrong by a third


def test_the_joint_path_gives_the_twist_that_differences_of_the_pose_give() -> None:
    n = told("task")["joint-path"]["numbers"]
    q, v = np.array(n["q"]), np.array(n["v"])
    robot, h = mfc.robots.ur5(), 1e-6
    X, later, before = robot.pose(q[7]), robot.pose(q[7] + h * v[7]), robot.pose(q[7] - h * v[7])
    rate = np.linalg.inv(X) @ (later - before) / (2 * h)
    twist = np.array([*rate[:3, 3], rate[2, 1], rate[0, 2], rate[1, 0]])
    t = np.linspace(0, task.path().period, 61)[7]
    assert_allclose(twist, task.path()(t).V, atol=1e-8)


def test_the_mass_seen_from_the_tool_is_that_of_the_inverse_mobility() -> None:
    weight = np.array(told("task")["tool-dynamics"]["numbers"]["task_mass"])
    q = force.POSE
    J, M = mfc.robots.ur5().jacobian(q), mfc.robots.ur5().mass(q)
    assert_allclose(weight[0], np.linalg.eigvalsh(np.linalg.inv(J @ np.linalg.solve(M, J.T))[:3, :3]), rtol=1e-9)


def test_phase_margins_of_9_16_with_a_payload_are_python_controls() -> None:
    n = told("task")["tool-torque"]["numbers"]
    loop = mfc.ClosedLoop(
        mfc.robots.ur5().with_payload(2.0), mfc.laws.TaskComputedTorque(100.0, 100.0, 20.0), task.path(), controller_model=mfc.robots.ur5(),
        q_start=force.POSE, hardware=mfc.Hardware(torque_lag=2e-3),
    )  # fmt: skip
    for point, channel in (("torque", 1), ("command", 0)):
        phase = control.margin(loop.linearize([0.0]).loop(0, at=point, channel=channel))[1]
        assert n["phase_deg"][point][0][channel] == pytest.approx(phase, rel=1e-6)


def test_seven_joints_leave_one_neutral_posture() -> None:
    found = told("task")["redundant"]
    if "Left out" in found["finding"]:
        pytest.skip(found["finding"])
    assert found["numbers"]["neutral"] == [0, 1, 1]
    assert found["numbers"]["drifts"] == [True, False, False]
    poles = [p if isinstance(p, float) else p["re"] for p in found["numbers"]["poles"]]
    assert min(abs(p + 10.0) for p in poles) < 1e-9  # the null space decays at its own rate


# --- 9.19-9.23 ---------------------------------------------------------------------------------------------------


def test_the_quasi_static_model_departs_where_two_transfer_functions_do() -> None:
    n = told("force")["contact"]["numbers"]
    m, d, k, kfp, kfi = force.MASS, force.KDAMP, 1e4, force.KFP, force.KFI
    top = [k * (1 + kfp), k * kfi]
    s = 1j * np.array(n["frequencies"])
    dynamic = np.polyval(top, s) / np.polyval([m, d, *top], s)
    static = np.polyval(top, s) / np.polyval([d, *top], s)
    assert_allclose(n["departure"]["slider"], np.abs(dynamic - static), rtol=1e-6, atol=1e-9)


def test_an_unknown_payload_costs_its_weight_and_the_integral_takes_it_away() -> None:
    n = told("force")["payload"]["numbers"]
    down = mfc.robots.ur5().pose(force.POSE)[2, 2]
    assert_allclose(n["errors"]["9.21"], np.array(n["payload"]) * G * down, rtol=1e-9)
    assert_allclose(n["errors"]["9.23, kfp = 1"], 0.5 * np.array(n["errors"]["9.21"]), rtol=1e-7)  # Newton stops at 1e-8 N
    assert np.abs(n["errors"]["9.23, kfp = 1, kfi = 5"]).max() < 1e-6


def test_free_space_gives_the_speeds_of_the_integrated_equation() -> None:
    n = told("force")["free-space"]["numbers"]
    assert n["speed"]["slider, 9.22"] == pytest.approx(10 * (2 * 1 + 5 / 2), rel=1e-6)
    d, kfi = force.KDAMP, force.KFI  # v' = 10 (2 + 5 t) - d v
    t = 2.0
    ramp = 10 * kfi / d
    v = ramp * t + (20 / d - ramp / d) * (1 - np.exp(-d * t))
    assert n["speed"]["slider, 9.23"] == pytest.approx(v, rel=1e-6)
    assert sum(n["drifts"].values()) == 3  # the damped UR5 has a pair at 0.015 rad/s, faster than the horizon, that grows


def test_force_margins_of_the_slider_are_python_controls() -> None:
    n = told("force")["slider-force"]["numbers"]["force"]
    k, T = 2e3, 2e-3
    L = control.tf([k * force.KFP, k * force.KFI], [1, 0]) * control.tf([1], [force.MASS * T, force.MASS, force.KDAMP + k * T, k])
    gain, phase, _, crossover = control.margin(L)
    assert n["gain_increase"] == pytest.approx(gain, rel=1e-6)
    assert n["phase_deg"] == pytest.approx(phase, rel=1e-6)
    assert n["delay"] == pytest.approx(np.radians(phase) / crossover, rel=1e-6)


def test_force_margins_of_the_arm_are_python_controls() -> None:
    n = told("force")["arm-force"]["numbers"]
    lin = force.arm_loop(1e4, hardware=mfc.Hardware(torque_lag=2e-3)).linearize()
    gain, phase, _, crossover = control.margin(lin.loop(0, at="force", channel="fz"))
    assert tuple(n["force"][name] for name in ("gain_increase", "phase_deg", "crossover")) == pytest.approx((gain, phase, crossover), rel=1e-5)
    assert n["verdicts"]["9.22"] == "unstable"
    run = force.arm_loop(1e4, mfc.laws.ForcePI(20 * force.Z, force.Z, 5 * force.Z), hardware=mfc.Hardware(torque_lag=2e-3)).simulate(
        np.linspace(0, 0.4, 100), v=np.linalg.solve(mfc.robots.ur5().jacobian(force.POSE), 1e-3 * force.Z), rtol=1e-4, atol=1e-7
    )
    swing = np.abs(run.force[:, 2] - 20)
    assert swing[80:].max() > swing[20:40].max()  # it does grow


# --- 9.17, 9.18, 9.24 --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("key", "free"), [("peg-in-hole", 2), ("surface-sliding", 3)])
def test_constraint_tables_span_six_reciprocal_directions(key: str, free: int) -> None:
    n = told("constraints")[key]["numbers"]
    A = np.array(n["rows"])
    assert (n["rank_free"], n["rank_constraint"], np.linalg.matrix_rank(A)) == (free, 6 - free, 6 - free)
    names = ("vx", "vy", "vz", "wx", "wy", "wz")
    for i, name in enumerate(names):
        assert (np.linalg.norm(A[:, i]) == 0) == (name not in n["natural"])
    assert n["projector"]["rank of P"] == free


def test_work_is_the_same_in_every_frame() -> None:
    n = told("constraints")["reciprocity"]["numbers"]
    assert n["change_of_work"] < 1e-12 < 0.1 < n["change_of_twist_product"]
    assert n["reciprocity"] < 1e-12


def test_hybrid_margins_are_python_controls() -> None:
    n = told("hybrid")["hybrid"]["numbers"]
    lin = hybrid.hybrid_loop(hardware=mfc.Hardware(torque_lag=2e-3)).linearize()
    assert n["force"]["phase_deg"] == pytest.approx(control.margin(lin.loop(0, at="force", channel="fz"))[1], rel=1e-5)
    assert n["motion_phase_deg"][0] == pytest.approx(control.margin(lin.loop(0, at="command", channel="vx"))[1], rel=1e-5)


def test_without_damping_the_root_on_a_hard_wall_is_the_closed_form_whatever_the_wall() -> None:
    n = told("hybrid")["hybrid-damping"]["numbers"]
    assert min(n["growth_without"]) > 0 > max(n["growth_with"])
    assert n["growth_without"][-1] == pytest.approx(force.KFI / (2 * (1 + force.KFP)), rel=1e-4)
    direct = hybrid.hybrid_loop(kdamp=0.0).linearize().poles()[0]
    assert np.interp(np.log(1e4), np.log(n["stiffness"]), n["growth_without"]) == pytest.approx(direct.real.max(), rel=1e-3)


def test_the_leak_is_that_of_the_inverse_task_inertia() -> None:
    n = told("hybrid")["hybrid-leak"]["numbers"]
    mobility = np.linalg.inv(mfc.robots.ur5().task_inertia(force.POSE))
    assert_allclose(np.delete(n["leak"]["dynamic"], 2), np.delete(-mobility[:, 2] / mobility[2, 2], 2), rtol=1e-2, atol=1e-4)  # at a pose 0.1 mm away
    Lambda = mfc.robots.ur5().task_inertia(force.POSE)
    flat = Lambda[:, 2] * np.array([1, 1, 0, 1, 1, 1])
    expected = np.linalg.solve(Lambda, flat)
    expected[2] = 0.0
    assert_allclose(n["leak"]["selection"], expected, rtol=1e-2, atol=1e-4)


def test_coupling_at_one_frequency_is_that_of_python_control() -> None:
    n = told("hybrid")["hybrid-coupling"]["numbers"]
    lin = hybrid.hybrid_loop(projector="selection").linearize()
    j = 20
    w = n["frequencies"][j]
    columns = [lin.input_names.index(x) for x in ("X_d_vx", "X_d_vy")]
    H = lin.system(0)(1j * w)[lin.output_names.index("F_tip_fz"), columns]
    assert n["selection"]["motion_to_force"][j] == pytest.approx(np.linalg.norm(H), rel=1e-6)
    assert max(n["exact"]["motion_to_force"]) < 1e-6 < 10 < max(n["2 kg unknown"]["motion_to_force"])


# --- misprints ---------------------------------------------------------------------------------------------------


def test_the_printed_difference_takes_the_time_of_its_tangent_law() -> None:
    took = told("errata")["misprint-9-5"]["numbers"]["time_to_1_percent"]
    start, k = 2.9, 4.0
    assert took["standard"] == pytest.approx(np.log(100) / k, rel=1e-3)  # interpolated between samples of 20 ms
    assert took["printed"] == pytest.approx(np.log(np.tan(start / 2) / np.tan(0.005 * start)) / k, rel=1e-3)


def test_without_the_adjoint_the_poles_turn_at_the_tools_angular_speed() -> None:
    n = told("errata")["misprint-9-5-adjoint"]["numbers"]
    assert n["imaginary"] == pytest.approx(0.4 * 6.0, rel=1e-4)  # angle x frequency of the path
    assert n["position_error_mm"]["no_adjoint"] > 1e3 * n["position_error_mm"]["standard"]
    assert n["exponent"]["no_adjoint"] == pytest.approx(-1.0, rel=1e-6)


def test_the_printed_hybrid_law_rests_where_gravity_and_gains_balance() -> None:
    n = told("errata")["misprint-9-24"]["numbers"]
    X_e = np.array(n["error"]["printed_eta"])
    loop = hybrid.hybrid_loop(form="printed_eta")
    run = loop.simulate([0.0, 6.0], initial_error=X_e * 0.9, rtol=1e-5)
    assert_allclose(run.error[-1], X_e, atol=1e-4)  # the run comes to rest there
    assert n["off_mm"]["standard"] < 1e-6 < 10 < n["off_mm"]["printed"] == pytest.approx(1e3 * np.linalg.norm(X_e[:3]), rel=1e-6)


def test_the_missing_term_is_the_drift_of_the_jacobian() -> None:
    n = told("errata")["misprint-9-15"]["numbers"]
    q, v = (np.array(told("task")["joint-path"]["numbers"][x]) for x in "qv")
    robot, h, worst = mfc.robots.ur5(), 1e-6, 0.0
    for a, b in zip(q, v, strict=True):
        drift = (robot.jacobian(a + h * b) - robot.jacobian(a - h * b)) @ b / (2 * h)
        worst = max(worst, float(np.abs(robot.mass(a) @ np.linalg.solve(robot.jacobian(a), drift)).max()))
    assert n["torque"] == pytest.approx(worst, rel=1e-5)


def test_slips_that_can_be_computed_are() -> None:
    n = told("errata")["slips"]["numbers"]
    m2, theta = 1.0, 0.4
    assert n["mass"] == 0
    assert n["gravity"] == pytest.approx(m2 * G * np.cos(theta), rel=1e-6)
    assert n["quadratic"] == pytest.approx(4.0)


@pytest.mark.parametrize("module", ["task", "force", "constraints", "hybrid", "errata"])
def test_every_check_of_these_sections_is_met(module: str) -> None:
    assert statuses(told(module)) == {"PASS"}


@pytest.mark.parametrize(("module", "key"), [("task", "tool-velocity"), ("task", "tool-torque"), ("force", "arm-force"), ("hybrid", "hybrid")])
def test_linear_models_miss_by_the_square_of_the_disturbance(module: str, key: str) -> None:
    found = told(module)[key]["numbers"]["validation"]
    assert found["taylor_order"] == pytest.approx(2.0, abs=0.05)
    assert found["nrmse"] < 0.05 <= 5 * found["radius"]  # 5 % is not yet reached at 0.01


def test_without_example_robot_data_the_seven_joint_arm_is_left_out_by_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.metadata

    from mfc_analysis.robots import catalogue

    def nowhere(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(catalogue.importlib.metadata, "distribution", nowhere)
    monkeypatch.setattr(catalogue.importlib.metadata, "files", nowhere)
    section = task.redundant_section()
    assert str(section.finding).startswith("Left out: ")
    assert "example-robot-data" in str(section.finding)
    assert section.body == ()
