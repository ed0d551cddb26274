"""The sections of the joint-space equations: their numbers, read back from the JSON, confirmed another way."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.report.chapter import arms as chapter, joint_torque
from tests.report.read import told

JOINT, PLANAR, UR5 = "single-joint", "planar-2r", "ur5-2-kg"
K, KI = 4.0, 4.0  # of 9.2 to 9.4
W = 8.0  # of the torque loops
I, B, MGR = 0.5, 0.1, 1.0 * 9.81 * 0.1  # the single joint: eq 9.6


def numbers(module: str, key: str) -> dict:
    return told(module)[key]["numbers"]


def as_complex(values: list) -> np.ndarray:
    return np.array([complex(z["re"], z["im"]) if isinstance(z, dict) else complex(z) for z in values])


def assert_same_roots(found: list, polynomial: list, digits: float = 1e-6) -> None:
    assert_allclose(np.poly(as_complex(found)), np.array(polynomial) / polynomial[0], rtol=digits, atol=digits)


# --- 9.1 to 9.4 ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("arm", "n"), [(JOINT, 1), (PLANAR, 2), (UR5, 6)])
def test_9_1_has_nothing_but_poles_at_zero_and_integrates_disturbances(arm, n):
    found = numbers("velocity", f"9-1-velocity-feedforward-{arm}")
    assert as_complex(found["poles"]).tolist() == [0] * n
    assert found["error_change"] < 1e-8
    assert_allclose(found["disturbance_error"], 0.01 * 2.0, rtol=1e-6)


@pytest.mark.parametrize(("arm", "n"), [(JOINT, 1), (PLANAR, 2), (UR5, 6)])
def test_9_2_has_the_pole_the_delay_margin_and_the_lag_of_the_closed_forms(arm, n):
    found = numbers("velocity", f"9-2-velocity-p-{arm}")
    assert_same_roots(found["poles"], np.poly([-K] * n))
    assert_allclose(found["delay"], [np.pi / (2 * K)] * n)
    assert_allclose(found["phase_deg"], [90.0] * n)
    assert_allclose(found["ramp_error"], 0.2 / K, rtol=1e-5)


@pytest.mark.parametrize(("arm", "n"), [(JOINT, 1), (PLANAR, 2), (UR5, 6)])
def test_9_3_has_python_controls_margins_and_the_errors_of_the_closed_forms(arm, n):
    found = numbers("velocity", f"9-3-velocity-pi-{arm}")
    _, phase, _, crossover = control.margin(control.tf([K, KI], [1, 0, 0]))
    assert_allclose(found["phase_deg"], [phase] * n)
    assert_allclose(found["crossover"], [crossover] * n)
    assert_same_roots(found["poles"], np.poly(np.tile(np.roots([1, K, KI]), n)), 1e-5)
    assert abs(found["ramp_error"]) < 1e-5
    assert_allclose(found["parabola_error"], 0.1 / KI, rtol=1e-4)


def test_9_4_tracks_without_the_error_that_9_2_and_9_3_have():
    errors = [numbers("velocity", f"{e}-{JOINT}")["tracking_error"] for e in ("9-2-velocity-p", "9-3-velocity-pi", "9-4-feedforward-pi")]
    # e' = v_d - k e from rest under 9.2: the lag by its own step-by-step solution
    t = np.linspace(0.0, 2.0, 20001)
    v = np.gradient(chapter.arms()[0].ref(t).q[:, 0], t)
    e, peak = 0.0, 0.0
    for rate in v[:-1]:
        e = e * np.exp(-K * 1e-4) + rate * (1 - np.exp(-K * 1e-4)) / K
        peak = max(peak, e)
    assert_allclose(errors[0], peak, rtol=1e-3)
    assert errors[0] > errors[1] > 1e3 * errors[2]


# --- 9.8 to 9.13 -----------------------------------------------------------------------------------------------------


def test_9_8_on_one_joint_has_the_chapters_polynomial_and_python_controls_margins():
    found = numbers("joint_torque", f"9-8-independent-pid-{JOINT}")
    kp, ki, kd = 3 * W**2 * I, W**3 * I, 3 * W * I
    theta = float(chapter.arms()[0].ref(found["worst"]["time"]).q[0])
    stiffness = kp - MGR * np.sin(theta)
    assert_same_roots(found["poles"], [I, B + kd, stiffness, ki])
    L = control.tf([kd, kp, ki], [I, B, -MGR * np.sin(theta), 0])
    low, phase, _, crossover = control.margin(L)
    assert_allclose(found["phase_deg"][0], phase, rtol=1e-6)
    assert_allclose(found["crossover"][0], crossover, rtol=1e-6)
    assert_allclose(found["gain_reduction"][0], low, rtol=1e-6)


def test_9_8_each_joint_alone_has_the_poles_of_the_diagonal_of_the_inertia():
    found = numbers("joint_torque", f"9-8-independent-pid-{PLANAR}")
    arm = chapter.arms()[1]
    q = arm.ref(found["worst"]["time"]).q
    M, h = arm.robot.mass(q), 1e-6
    g = [(arm.robot.gravity(q + h * e)[j] - arm.robot.gravity(q - h * e)[j]) / (2 * h) for j, e in enumerate(np.eye(2))]
    gains = chapter.Designs().law("9.8", arm).gains()
    for j in range(2):
        kp, ki, kd = (float(gains[name].array[j]) for name in ("kp", "ki", "kd"))
        assert_same_roots(found["decentralised_poles"][j], [M[j, j], arm.robot.viscous[j] + kd, kp + g[j], ki], 1e-5)


def test_9_8_relative_gain_is_that_of_the_inertia_matrix():
    found = numbers("joint_torque", f"9-8-independent-pid-{PLANAR}")
    arm = chapter.arms()[1]
    M = arm.robot.mass(arm.ref(arm.times).q)
    det = M[:, 0, 0] * M[:, 1, 1] - M[:, 0, 1] ** 2
    assert_allclose(found["relative_gain"], [(M[:, 0, 0] * M[:, 1, 1] / det).max()] * 2, rtol=1e-9)


@pytest.mark.parametrize(("arm", "n"), [(JOINT, 1), (PLANAR, 2)])
def test_9_10_with_an_exact_model_is_the_design_polynomial_at_the_command(arm, n):
    found = numbers("joint_torque", f"9-10-computed-torque-{arm}")
    assert_same_roots(found["poles"], np.poly([-W] * (3 * n)), 1e-5)
    _, phase, _, _ = control.margin(control.tf([3 * W, 3 * W**2, W**3], [1, 0, 0, 0]))
    assert_allclose(found["command_phase_deg"], [phase] * n, rtol=1e-6)
    assert_allclose(found["command_gain_reduction"], [1 / 9] * n, rtol=1e-6)


def test_9_12_is_stable_above_a_ninth_of_its_gain_only():
    found = numbers("joint_torque", "eq-9-12")
    assert_allclose(found["gain_reduction"], 1 / 9, rtol=1e-6)
    for side, stable in ((0.99, False), (1.01, True)):
        f = side * found["gain_reduction"]
        assert (np.roots([1, 3 * W * f, 3 * W**2 * f, W**3 * f]).real.max() < 0) == stable
    assert found["growth_below"] > 1 > found["growth_above"]


def test_9_11_leaves_the_double_integrator_where_the_model_is_exact():
    for arm in (JOINT, PLANAR):
        found = numbers("joint_torque", f"9-11-inverse-dynamics-pd-{arm}")
        assert found["double_integrator"] < 1e-9
        assert_same_roots(found["poles"], np.poly([-W] * (2 * len(found["channels"]))), 1e-5)
    wrong = numbers("joint_torque", f"9-11-inverse-dynamics-pd-{UR5}")
    assert wrong["double_integrator"] > 0.1


def test_the_linear_model_is_right_on_every_loop_with_feedback():
    pages = [s["numbers"]["validation"] for m in ("velocity", "joint_torque") for s in told(m).values() if "validation" in s["numbers"]]
    assert len(pages) == 18
    for found in pages:
        assert found["taylor_order"] == "infinite" or found["taylor_order"] == pytest.approx(2.0, abs=0.05)
        assert found["nrmse"] < 0.05


# --- misprints -------------------------------------------------------------------------------------------------------


def test_9_3_as_printed_has_the_identity_for_its_integral_gain():
    found = numbers("misprints", "misprint-9-3")
    assert_same_roots(found["printed"]["poles"], [1, K, 1])
    _, phase, _, _ = control.margin(control.tf([K, 1], [1, 0, 0]))
    assert_allclose(found["printed"]["phase_deg"], phase)


def test_9_9_as_printed_doubles_the_inertia():
    found = numbers("misprints", "misprint-9-9")
    top = float(chapter.arms()[0].ref(2.0).q[0])
    # the law's h^(q_d, v_d) feeds nothing back: friction and gravity of the plant remain, on twice the inertia
    assert_allclose(found["printed"]["rightmost"], np.roots([2 * I, B, -MGR * np.sin(top)]).real.max(), rtol=1e-6)
    assert_allclose(found["standard"]["rightmost"], np.roots([I, B, -MGR * np.sin(top)]).real.max(), rtol=1e-6)


def test_9_12_as_printed_needs_a_triple_pole_faster_than_gravity_pulls():
    found = numbers("misprints", "misprint-9-12")
    robot, q, h = chapter.arms()[1].robot, np.array([np.pi / 2, 0.0]), 1e-6
    K = np.stack([(robot.gravity(q + h * e) - robot.gravity(q - h * e)) / (2 * h) for e in np.eye(2)], axis=1)
    pull = np.linalg.eigvals(np.linalg.solve(robot.mass(q), K)).real.min()
    # s^3 + 3 w s^2 + (3 w^2 + pull) s + w^3 is stable iff 3 w (3 w^2 + pull) > w^3
    assert_allclose(found["slowest_printed"], np.sqrt(-3 * pull / 8), rtol=1e-3)
    assert found["printed"]["stable"] is False and found["standard"]["stable"] is True


def test_9_1_as_printed_moves_at_the_speed_of_its_own_angle():
    found = numbers("misprints", "misprint-9-1")
    arm = chapter.arms()[0]
    t = np.linspace(0.0, 4.0, 40001)
    q_d = arm.ref(t).q[:, 0]
    q = q_d[0] - 0.05 + np.concatenate([[0.0], np.cumsum((q_d[1:] + q_d[:-1]) / 2 * np.diff(t))])
    assert_allclose(found["printed"]["largest_error"], np.abs(q_d - q).max(), rtol=1e-5)


def test_9_10_as_printed_keeps_what_was_not_cancelled_in_the_loop():
    found = numbers("misprints", "misprint-9-10")
    arm = chapter.arms()[2]
    loop = chapter.Designs().loop("9.10", arm)
    printed = replace(loop, law=replace(loop.law, form="printed")).linearize(arm.times)
    assert_allclose(found["printed"]["rightmost"], np.linalg.eigvals(printed.A).real.max(), rtol=1e-6)
    assert found["printed"]["rightmost"] > found["standard"]["rightmost"]
    assert found["printed"]["gain_reduction"] > found["standard"]["gain_reduction"]


def test_the_largest_integral_gain_of_the_chapter_is_stable_below_and_not_above():
    block = joint_torque.limit_of_ki(chapter.Designs().view("9.8", chapter.arms()[0]))
    limit, _, sides = block.facts
    q = chapter.arms()[0].ref(chapter.arms()[0].times).q[:, 0]
    kp, kd = 3 * W**2 * I, 3 * W * I
    assert_allclose(limit.value.value, ((B + kd) * (kp - MGR * np.sin(q)) / I).min(), rtol=1e-6)
    assert sides.value == "stable, unstable"
