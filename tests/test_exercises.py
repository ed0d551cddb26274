"""The chapter's practice questions: closed forms, what a run shows, and the same answer by prompts and by options."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import exercises
from mfc_analysis.cli.exercise import QUESTIONS, answered
from mfc_analysis.errors import BadArgument, UnknownName


def test_the_poles_are_those_of_the_closed_form_of_9_8():
    link, target, kp, ki, kd = exercises.Link(), math.radians(40), 20.0, 10.0, 5.0
    run = exercises.pid(40, kp, ki, kd)
    slope = link.mass * exercises.GRAVITY * link.com_distance * math.sin(target)
    assert_allclose(np.poly(run.poles) * link.inertia, [link.inertia, link.damping + kd, kp - slope, ki], rtol=1e-9)
    assert run.stable and not run.advice and run.rests_at == target


def test_inverse_dynamics_leaves_the_design_polynomial_and_follows_without_error():
    run = exercises.pid_with_inverse_dynamics(60, 100, 200, 20, velocity_deg=90)
    assert_allclose(np.poly(run.poles), [1, 20, 100, 200], rtol=1e-9)
    assert abs(run.steady_error) < 1e-6 and np.abs(run.simulation.error).max() < 1e-5
    assert_allclose(run.peak_velocity, math.radians(90), rtol=1e-3)


def test_the_link_starts_at_its_original_position_at_rest_every_time():
    for run in (exercises.pid(-30, 50, 100, 10), exercises.pid_with_inverse_dynamics(30, 100, 0, 20)):
        assert (run.simulation.q[0, 0], run.simulation.v[0, 0]) == (0.0, 0.0)


def test_without_an_integral_gravity_leaves_the_steady_error_of_the_balance():
    run = exercises.pid(45, 20, 0, 5)
    link = exercises.Link()
    q = run.simulation.q[-1, 0]
    assert_allclose(20 * (run.target - q), link.mass * exercises.GRAVITY * link.com_distance * math.cos(q), rtol=1e-6)
    assert_allclose(run.rests_at, q, atol=1e-7)
    assert abs(exercises.pid(45, 20, 20, 5, duration=20).steady_error) < 1e-4


def test_a_joint_too_soft_to_hold_the_link_at_its_target_is_judged_where_it_rests():
    """kp (q_d - q) = m g r cos q has one root for 0.3 Nm/rad and 70 deg, and the link falls to it."""
    run = exercises.pid(70, 0.3, 0, 5, duration=100)
    link = exercises.Link()
    q = run.rests_at
    assert_allclose(0.3 * (run.target - q), link.mass * exercises.GRAVITY * link.com_distance * math.cos(q), rtol=1e-9)
    assert run.stable and not run.advice and q < 0
    assert_allclose(run.simulation.q[-1, 0], q, atol=1e-6)


@pytest.mark.parametrize(("factor", "stable"), [(0.99, True), (1.01, False)])
def test_the_run_grows_beyond_the_bound_of_the_integral_gain_and_only_there(factor, stable):
    link = exercises.Link(inertia=1.0, mass=0.0)
    bound = (link.damping + 10.0) * 49.0 / link.inertia
    run = exercises.pid(30, 49.0, factor * bound, 10.0, link=link, duration=60.0)
    late = np.abs(run.simulation.error[-200:, 0]).max()
    early = np.abs(run.simulation.error[200:400, 0]).max()
    assert run.stable is stable
    assert bool(late < early) is stable


UNSTABLE = [(20.0, 1000.0, 5.0), (20.0, 10.0, -1.0), (-5.0, 10.0, 5.0), (20.0, -3.0, 5.0)]


@pytest.mark.parametrize(("kp", "ki", "kd"), UNSTABLE)
def test_an_unstable_loop_comes_with_what_to_change_and_the_change_helps(kp, ki, kd):
    run = exercises.pid(70, kp, ki, kd)
    assert not run.stable
    what, gain, _, *rest = run.advice.split()  # "raise kp above 0.97 N m/rad: ..."
    if what == "make":
        ki = 1.0
    elif what == "lower":
        ki = 0.99 * float(rest[0])
    else:
        kp, kd = (float(rest[0]) + 20.0, kd) if gain == "kp" else (kp, float(rest[0]) + 5.0)
    assert exercises.pid(70, kp, ki, kd).stable


@pytest.mark.parametrize("seed", range(3))
def test_the_advice_is_empty_exactly_where_the_polynomial_is_stable(seed):
    rng = np.random.default_rng(seed)
    for _ in range(200):
        a = rng.uniform(-1, 4, size=4) * [0, 1, 1, 1] + [1, 0, 0, 0]
        a[3] = rng.choice([0.0, a[3]])
        roots = np.roots(a if a[3] else a[:3])
        assert (exercises.routh_advice(*a, 1.0, 1.0, "N m") == "") == bool(roots.real.max() < 0)


def test_both_laws_are_compared_on_the_same_motion():
    both = exercises.compare(60, 100, 200, 20)
    assert_allclose(both.plain.loop.law.kp.array, 0.5 * 100)
    assert_allclose(both.plain.loop.ref(0.5).q, both.inverse.loop.ref(0.5).q)
    assert both.plain.overshoot > both.inverse.overshoot
    assert "inverse dynamics overshoots" in both.finding
    assert "no comparison is possible" in exercises.compare(60, 100, 1e5, 20).finding
    names = [row[0] for row in both.rows()]
    assert {"overshoot", "settling time (2 %)", "error at the end", "largest torque", "largest velocity"} <= set(names)


def test_the_graph_shows_position_velocity_and_torque_of_both():
    both = exercises.compare(60, 100, 200, 20, duration=1.0)
    axes = exercises.graph([both.plain, both.inverse])
    assert [ax.get_ylabel() for ax in axes] == ["position [deg]", "velocity [deg/s]", "torque [N m]"]
    assert_allclose(axes[1].lines[0].get_ydata(), np.degrees(both.plain.simulation.v[:, 0]))


@pytest.mark.parametrize(("theta", "d", "force"), [(0.0, 1.0, (3.0, 4.0)), (90.0, 0.5, (3.0, 4.0)), (30.0, 0.7, (-2.0, 5.0))])
def test_the_torques_of_the_rp_arm_are_the_transposed_jacobian_times_the_force(theta, d, force):
    t = math.radians(theta)
    Fx, Fy = force
    answer = exercises.rp_torques(theta, d, force)
    assert_allclose(answer.torques, [d * (-math.sin(t) * Fx + math.cos(t) * Fy), math.cos(t) * Fx + math.sin(t) * Fy], atol=1e-12)
    assert_allclose(answer.torques, answer.jacobian.T @ np.array(force), atol=1e-12)


def test_power_at_the_joints_is_power_at_the_tool():
    answer = exercises.rp_torques(25, 0.8, (3, 4))
    rates = np.array([0.3, -0.2])
    h = 1e-6

    def tip(s: float) -> np.ndarray:
        theta, d = answer.theta + s * rates[0], answer.d + s * rates[1]
        return d * np.array([math.cos(theta), math.sin(theta)])

    assert_allclose(answer.torques @ rates, np.array([3, 4]) @ ((tip(h) - tip(-h)) / (2 * h)), rtol=1e-8)


@pytest.mark.parametrize("bad", [{"target_deg": 0.0}, {"target_deg": math.nan}, {"kp": math.inf}, {"duration": 0.0}, {"velocity_deg": -1.0}])
def test_bad_answers_are_named(bad):
    with pytest.raises(BadArgument):
        exercises.pid_with_inverse_dynamics(**({"target_deg": 45.0, "kp": 100.0, "kd": 20.0} | bad))


def test_answers_that_an_exercise_does_not_ask_are_refused_and_the_others_have_defaults():
    assert answered("9.4", {"d": 2.0}) == {"theta_deg": 45.0, "d": 2.0, "fx": 3.0, "fy": 4.0}
    with pytest.raises(BadArgument, match="--kp"):
        answered("9.4", {"kp": 1.0})
    with pytest.raises(UnknownName, match=r"9\.1"):
        answered("9.5", {})
    assert "velocity_deg" in [key for key, _, _ in QUESTIONS["9.2"]]


ANSWERS = {"9.1": ["60", "40", "80", "8"], "9.4": ["30", "0.5", "3", "4"]}


def through_options(number: str) -> str:
    options = [f"--{key.replace('_', '-')}={answer}" for (key, _, _), answer in zip(QUESTIONS[number], ANSWERS[number], strict=True)]
    command = [sys.executable, "-m", "mfc_analysis", "exercise", number, *options]
    return subprocess.run(command, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL).stdout


def through_a_terminal(number: str) -> str:
    import pty

    child, terminal = pty.fork()
    if child == 0:
        os.execv(sys.executable, [sys.executable, "-m", "mfc_analysis", "exercise", number])
    shown, answers, end = b"", list(ANSWERS[number]), time.monotonic() + 60
    while time.monotonic() < end:
        try:
            new = os.read(terminal, 4096)
        except OSError:  # the other end is closed
            break
        if not new:
            break
        shown += new
        if answers and shown.rstrip().endswith(b"]:"):
            os.write(terminal, answers.pop(0).encode() + b"\n")
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, shown.decode()
    return shown.decode().replace("\r\n", "\n")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
@pytest.mark.parametrize("number", ANSWERS)
def test_prompts_on_a_terminal_and_options_give_the_same_answer(number):
    by_options, by_prompts = through_options(number), through_a_terminal(number)
    assert by_prompts.endswith(by_options)
    for _, question, _ in QUESTIONS[number]:
        assert f"{question} [" in by_prompts[: -len(by_options)]


@pytest.mark.parametrize("gains", [{"kp": 1e30}, {"kp": -1e30}, {"kp": 1e30, "kd": 1e30}, {"kp": 1e12, "kd": 1.0}], ids=str)
def test_a_run_with_gains_that_no_solver_follows_stops_and_says_how_far_it_came(gains: dict[str, float]) -> None:
    """Radau took minutes, and for kp = -1e30 repeated one step without end."""
    for run in (exercises.pid(60.0, velocity_deg=90.0, **gains), exercises.pid_with_inverse_dynamics(60.0, velocity_deg=90.0, **gains)):
        found = run.simulation
        assert found.diverged and found.evaluations < 31_000
        assert f"at t = {found.end:.4g} s" in found.message
