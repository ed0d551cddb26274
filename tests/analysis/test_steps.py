"""Step responses: closed forms, python-control, and what isn't defined."""

from __future__ import annotations

import tracemalloc
import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import mfc_analysis as mfc
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.analysis.steps import step, steps
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, NotConverged, UnknownName
from tests.analysis.conftest import open_system, random_loops
from tests.soak.steps import drawn, wrong
from tests.test_arms import loops

s = control.tf("s")


def test_a_first_order_loop_rises_and_settles_as_the_exponential_says():
    found = step(open_system(4 / s), 0, "d", "y")
    assert found.outcome is Outcome.SETTLES
    assert_allclose([found.steady_state, found.rise, found.settling], [1, np.log(9) / 4, np.log(50) / 4], rtol=1e-9)
    assert (found.overshoot, found.undershoot) == (0, 0)
    assert_allclose(found.y, 1 - np.exp(-4 * found.t), atol=1e-12)


@pytest.mark.parametrize("zeta", [0.05, 0.3, 0.7])
def test_a_second_order_loop_overshoots_as_its_damping_says(zeta):
    w = 7.0
    found = step(open_system(w**2 / (s * (s + 2 * zeta * w))), 0, 0, 0)
    wd = w * np.sqrt(1 - zeta**2)
    assert_allclose(found.overshoot, np.exp(-zeta * np.pi / np.sqrt(1 - zeta**2)), rtol=1e-8)
    assert_allclose([found.peak_time, found.peak], [np.pi / wd, 1 + found.overshoot], rtol=1e-6)
    t = np.linspace(0, found.t[-1], 400_001)
    y = 1 - np.exp(-zeta * w * t) * (np.cos(wd * t) + zeta * w / wd * np.sin(wd * t))
    assert_allclose(found.settling, t[np.flatnonzero(np.abs(y - 1) > 0.02)[-1]], atol=2 * t[1])


def test_the_metrics_do_not_depend_on_the_duration_asked_for():
    system = open_system(49 / (s * (s + 3)))
    short, long = step(system, 0, "d", "y", duration=0.1), step(system, 0, "d", "y", duration=100.0)
    assert short.t[-1] == pytest.approx(0.1) and long.t[-1] == pytest.approx(100.0)
    assert short.settling == long.settling and short.overshoot == long.overshoot


def test_responses_equal_those_of_python_control(rng):
    system = random_loops(rng, 30, 5, 2)
    A, B, C, D = close_wires(system)
    compared = 0
    for i in np.flatnonzero(stability(system).stable):
        found = step(system, i, "d", "y")
        model = control.ss(A[i], B[i], C[i], D[i])
        truth = control.step_response(model, found.t)
        assert_allclose(found.y, truth.y[0, 0], atol=1e-9 * np.abs(found.y).max())
        info = control.step_info(truth.y[0, 0], T=truth.t, yfinal=found.steady_state, SettlingTimeThreshold=0.02)
        grid = found.t[1]
        assert_allclose(found.settling, info["SettlingTime"], atol=2 * grid)
        assert_allclose(100 * found.overshoot, max(0.0, info["Overshoot"]), rtol=1e-3, atol=1e-2)
        compared += 1
    assert compared > 3


def test_a_response_that_returns_to_zero_settles_within_its_peak_and_has_no_rise():
    found = step(open_system(3 * s / (s + 1) ** 2), 0, "d", "y")
    assert found.steady_state == 0
    assert np.isnan(found.rise) and np.isnan(found.overshoot) and found.settling > 0 and found.peak > 0
    assert "returns to zero, peak " in str(found) and "nan" not in str(found)


def test_an_unstable_loop_has_no_metrics_but_samples():
    found = step(open_system(10 / (s**3 + 3 * s**2 + 2 * s)), 0, "d", "y")
    assert found.outcome is Outcome.GROWS
    assert all(np.isnan(x) for x in (found.steady_state, found.rise, found.settling, found.overshoot))
    assert np.isfinite(found.y).all() and "unstable" in str(found)


@pytest.mark.parametrize("duration", [1e4, 1e10, 1e100])
def test_samples_of_an_unstable_loop_beyond_all_numbers_warn_nobody(duration):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = step(open_system(10 / (s**3 + 3 * s**2 + 2 * s)), 0, "d", "y", duration=duration)
    assert found.outcome is Outcome.GROWS and found.y[0] == 0 and not np.isfinite(found.y[-1])


@pytest.mark.parametrize("duration", [1e4, 1e14, 1e30])
def test_samples_of_a_settled_loop_stay_at_its_final_value_however_long(duration):
    found = step(open_system(4 / s), 0, "d", "y", duration=duration)
    assert_allclose(found.y[1:], 1.0, rtol=1e-3)


def test_an_integrator_behind_the_loop_ramps():
    system = driven_integrator()
    found = step(system, 0, "d", "y")
    assert found.outcome is Outcome.RAMPS
    assert found.steady_state == np.inf and found.settling == np.inf and np.isnan(found.rise)


@pytest.mark.parametrize(("delay", "dt"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.01)])
@pytest.mark.parametrize(("order", "y"), [(1, 8.0), (2, 32.0)])
def test_a_bare_integrator_ramps_and_does_not_grow(order, y, delay, dt):
    """Every root is slow: y = t^order / order! of a unit step, no root grows."""
    one = control.ss(1 / s**order)
    plain = open_system(control.c2d(one, dt) if dt else one, delay)
    loose = replace(plain, C=plain.C * [[[1.0], [0.0]]], D=plain.D * [[[1.0], [0.0]]])  # the wire reads nothing
    found = step(loose, 0, "d", "y", duration=8.0)
    assert found.outcome is Outcome.RAMPS and found.steady_state == np.inf and found.settling == np.inf
    assert_allclose(found.y[-1], y, rtol=1e-9)
    assert "grows" not in str(found)


def driven_integrator():
    """x' = -3 x + d, y = its integral: a neutral root that the input drives."""
    plain = open_system(1 / (s + 1))
    return replace(
        plain,
        A=np.array([[[-3.0, 0], [1, 0]]]),
        B=np.array([[[1.0, 0], [0, 0]]]),
        C=np.array([[[0, 1.0], [0, 0]]]),
        D=np.zeros((1, 2, 2)),
        state_names=("x", "z"),
    )


def test_fast_and_slow_poles_together_keep_their_metrics():
    found = step(open_system(1e4 / (s * (s + 1e6))), 0, "d", "y")  # poles at -0.01 and -1e6
    assert_allclose(found.settling, np.log(50) / 0.01, rtol=1e-6)


def test_a_fast_response_beside_an_unseen_slow_pole_is_resolved():
    fast = open_system(1e3 / s)
    A = np.array([[[0.0, 0], [0, -1e-2]]])
    slow = replace(fast, A=A, B=np.pad(fast.B, ((0, 0), (0, 1), (0, 0))), C=np.pad(fast.C, ((0, 0), (0, 0), (0, 1))), state_names=("x", "unseen"))
    assert_allclose(step(slow, 0, "d", "y").settling, np.log(50) / 1e3, rtol=1e-8)


def test_a_sampled_loop_steps_from_sample_to_sample():
    L = control.tf([0.4], [1, -0.9], 0.01)
    found = step(open_system(L), 0, "d", "y", duration=0.3)
    truth = control.step_response(L / (1 + L), np.arange(31) * 0.01)
    assert_allclose(found.y, truth.y[0, 0] if truth.y.ndim > 1 else truth.y, atol=1e-12)
    assert_allclose(found.t, np.arange(31) * 0.01)
    assert_allclose(found.steady_state, 0.8)


def test_unknown_names_and_bad_numbers_are_refused():
    system = open_system(4 / s)
    with pytest.raises(UnknownName, match="'d'"):
        step(system, 0, "disturbance", "y")
    with pytest.raises(UnknownName, match="output"):
        step(system, 0, "d", 3)
    for bad in (0.0, -1.0, np.nan, "long"):
        with pytest.raises(BadArgument, match="duration"):
            step(system, 0, "d", "y", duration=bad)
    with pytest.raises(BadArgument, match="index"):
        step(system, 7, "d", "y")


@pytest.mark.parametrize(("kp", "ki"), [(10.0, 1.5), (1.0, 0.001), (5.0, 0.25)])
def test_an_overshoot_that_comes_long_after_settling_is_found(kp, ki):
    """PI velocity control: 1 - y = (p1 exp(-p1 t) - p2 exp(-p2 t)) / (p1 - p2), largest overshoot at 2 ln(p2 / p1) / (p2 - p1)."""
    p1, p2 = np.sort(-np.roots([1, kp, ki]).real)
    t = 2 * np.log(p2 / p1) / (p2 - p1)
    found = step(open_system((kp * s + ki) / s**2), 0, "d", "y")
    assert_allclose(found.overshoot, (p2 * np.exp(-p2 * t) - p1 * np.exp(-p1 * t)) / (p1 - p2), rtol=1e-6)
    assert_allclose(found.peak_time, t, rtol=1e-6)


def test_the_peak_of_a_monotone_response_is_its_final_value():
    found = step(open_system(4 / s), 0, "d", "y")
    assert found.peak == pytest.approx(1.0, rel=1e-12) and np.isinf(found.peak_time)


def test_a_slow_root_that_decays_counts_and_where_it_keeps_the_response_outside_the_band_it_ramps():
    """1 / (1 + s / 0.005) beside a fast mode: settled in 4 s where it moves half a percent, not within the horizon where it moves half."""
    for part, outcome in ((0.005, Outcome.SETTLES), (0.5, Outcome.RAMPS)):
        L = (1 - part) * 1 / (s + 1) + part * 0.005 / (s + 0.005)
        found = step(open_system(control.tf(control.minreal(L / (1 - L), verbose=False))), 0, "d", "y")
        assert found.outcome is outcome
        if outcome is Outcome.SETTLES:
            settled = brentq(lambda t, p=part: (1 - p) * np.exp(-t) + p * np.exp(-0.005 * t) - 0.02, 1, 10)
            assert_allclose([found.steady_state, found.settling], [1.0, settled], rtol=1e-9)


def test_a_free_direction_that_keeps_moving_within_the_horizon_ramps_whatever_its_path():
    """Arms on one smooth wall slide under a torque: slow roots of which rounding splits several at zero; nothing raised, nothing "settles"."""
    for arm, seed, force in (("panda", 3, "9.23 on z"), ("ur10", 4, "9.23 on z"), ("kinova", 5, "9.22 on xz")):
        for kind in ("ideal", "lag", "sampled"):
            loop = next(loop for name, _, loop in loops(arm, seed, [kind]) if name == force)
            lin = loop.linearize()
            j = lin.opened.input_names.index(f"disturbance_{loop.robot.joint_names[1]}")
            outcomes = {step(lin.opened, 0, j, f"q_{one}").outcome for one in loop.robot.joint_names}
            assert outcomes <= {Outcome.RAMPS, Outcome.SETTLES, Outcome.GROWS}
            if lin.stability.nonzero_stable[0]:
                assert Outcome.RAMPS in outcomes


@pytest.mark.parametrize("seed", range(12))
def test_metrics_are_those_of_the_modal_sum_in_extended_precision(seed):
    said, _ = wrong(seed)
    assert said == ""


METRICS = ("steady_state", "rise", "settling", "overshoot", "undershoot", "peak", "peak_time")
Q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
LOOPS = {
    "wrong model": (2.0, {}),
    "exact model, A defective": (0.0, {}),
    "dead time": (2.0, {"delay": 2e-3, "torque_lag": 20e-3}),
    "sampled": (2.0, {"sample_time": 2e-3, "delay": 2e-3}),
}


def ur5(payload, hardware, times):
    robot = mfc.robots.ur5()
    law, path = mfc.laws.ComputedTorque(100.0, 80.0, 20.0), mfc.trajectories.Sinusoid(Q, 0.3, 1.5)
    hardware = mfc.Hardware(**hardware) if hardware else None
    return mfc.ClosedLoop(robot.with_payload(payload), law, path, controller_model=robot, hardware=hardware).linearize(times)


@pytest.mark.parametrize("name", LOOPS)
def test_every_response_of_a_batch_is_the_one_that_is_computed_alone(name):
    lin = ur5(*LOOPS[name], [0.3, 2.0])
    t = np.linspace(0.0, 1.0, 21)
    found = lin.steps(t, inputs=[2, "disturbance_elbow_joint"], outputs=["q_elbow_joint", 1, "tau_wrist_1_joint"])
    assert found.y.shape == (2, 3, 2, 21) and found.outcome.shape == found.rise.shape == (2, 3, 2)
    for i, out, into in ((0, 0, 0), (1, 2, 0), (1, 1, 1)):
        one = lin.step(i, found.inputs[into], found.outputs[out], times=t)
        of_batch = found[i, out, found.inputs[into]]
        assert (of_batch.input, of_batch.output, of_batch.time, of_batch.outcome) == (one.input, one.output, one.time, one.outcome)
        size = max(one.peak, np.abs(one.y).max())
        assert_allclose(found.y[i, out, into], one.y, rtol=0, atol=1e-9 * size)
        assert_allclose(of_batch.y, one.y, rtol=0, atol=1e-9 * size)
        for metric in METRICS:
            assert_allclose(getattr(found, metric)[i, out, into], getattr(one, metric), rtol=1e-7 if metric == "peak_time" else 1e-9, atol=1e-12)
            assert getattr(of_batch, metric) == getattr(found, metric)[i, out, into] or np.isnan(getattr(of_batch, metric))


@pytest.mark.parametrize("name", ["wrong model", "exact model, A defective"])
def test_all_responses_of_a_point_are_those_of_python_control_and_their_metrics_those_of_a_dense_solution(name):
    lin = ur5(*LOOPS[name], [0.3])
    t = np.linspace(0.0, 4.0, 301)
    found, model = lin.steps(t), lin.system(0)
    truth = control.step_response(model, t).y
    size = np.maximum(np.abs(truth).max(axis=2), 1e-9)
    assert (np.abs(found.y[0] - truth).max(axis=2) < 1e-9 * size).all()
    dense = np.linspace(0.0, 20.0, 100_001)
    y = lin.steps(dense, inputs=range(6), outputs=range(6)).y[0]
    step_ = dense[1]
    for o, i in np.ndindex(6, 6):
        final = found.steady_state[0, o, i]
        if np.abs(y[o, i]).max() < 1e-9:  # joints that an exact model decouples
            continue
        turn = np.abs(y[o, i]).argmax()
        left, top, right = np.abs(y[o, i][[turn - 1, turn, (turn + 1) % dense.size]])
        vertex = top + (left - right) ** 2 / (8 * (2 * top - left - right)) if 0 < turn < dense.size - 1 else top
        assert found.peak[0, o, i] == pytest.approx(max(vertex, abs(final)), rel=1e-6)
        band = 0.02 * (abs(final) if abs(final) > 1e-9 * vertex else vertex)
        apart = np.abs(y[o, i] - final) - band
        k = np.flatnonzero(apart > 0)[-1]
        assert found.settling[0, o, i] == pytest.approx(dense[k] + step_ * apart[k] / (apart[k] - apart[k + 1]), rel=1e-6)


def test_a_coupled_batch_keeps_each_outcome():
    """One output that settles, one that ramps; and a point that grows."""
    plain, A = driven_integrator(), np.array([[[-3.0, 0], [1, 0]], [[3, 0], [1, 0]]])
    C = np.array([[[1.0, 0], [0, 1.0], [0, 0]]])
    two = replace(plain, times=np.zeros(2), A=A, B=plain.B.repeat(2, axis=0), C=C.repeat(2, axis=0), D=np.zeros((2, 3, 2)), output_names=("v", "x"))
    found = steps(two, [0.0, 1.0])
    assert found.outcome[:, :, 0].tolist() == [[Outcome.SETTLES, Outcome.RAMPS], [Outcome.GROWS, Outcome.GROWS]]
    assert_allclose(found.settling[:, :, 0], [[np.log(50) / 3, np.inf], [np.nan, np.nan]], rtol=1e-9)
    assert_allclose(found.steady_state[:, :, 0], [[1 / 3, np.inf], [np.nan, np.nan]], rtol=1e-12)
    assert "1 of 2" in str(found) and "<table>" in found._repr_html_() and len(found) == 2


@pytest.mark.parametrize("seed", [1, 4, 5, 8, 13])
def test_responses_of_many_time_scales_do_not_disturb_each_other(seed):
    """A stiff system with four outputs: together they share sections, alone each has its own; the metrics are those of the modal sum either way."""
    A, b, c, d = drawn(seed)
    rng, n = np.random.default_rng(seed), len(A)
    C = np.stack([c, *(c * rng.normal(size=(3, n)))])
    names = [tuple(f"{x}{i}" for i in range(k)) for x, k in (("x", n), ("u", 1), ("y", 4))]
    system = OpenSystem(np.zeros(1), A[None], b[None, :, None], C[None], np.full((1, 4, 1), d), *names, {}, (), np.zeros(0), (), horizon=np.inf)
    found = steps(system, [0.0])
    for out in range(4):
        alone = step(system, 0, 0, out, times=[0.0])
        assert found.outcome[0, out, 0] is alone.outcome is Outcome.SETTLES
        for name in ("steady_state", "overshoot", "undershoot", "peak"):
            scale = alone.peak if name in ("peak", "steady_state") else 1 + alone.peak / abs(alone.steady_state)
            assert_allclose(getattr(found, name)[0, out, 0], getattr(alone, name), rtol=0, atol=1e-8 * scale)
        assert_allclose([found.rise[0, out, 0], found.settling[0, out, 0]], [alone.rise, alone.settling], rtol=1e-6)


def test_times_of_samples_are_checked():
    system = open_system(4 / s)
    t = np.array([0.0, 0.1, 0.7])
    assert_allclose(step(system, 0, "d", "y", times=t).y, 1 - np.exp(-4 * t), atol=1e-12)
    for bad in ([-0.1, 0.2], [0.2, 0.1], [np.nan], []):
        with pytest.raises(BadArgument, match="times"):
            steps(system, bad)
    with pytest.raises(BadArgument, match="duration"):
        step(system, 0, "d", "y", duration=1.0, times=t)
    with pytest.raises(UnknownName, match="inputs"):
        steps(system, t, inputs=["disturbance"])
    with pytest.raises(BadArgument, match="outputs"):
        steps(system, t, outputs=[])
    with pytest.raises(UnknownName, match="output"):
        steps(system, t)[0, "x", 0]
    with pytest.raises(BadArgument, match="index"):
        steps(system, t)[1, 0, 0]


def test_many_points_keep_their_metrics_in_little_memory():
    one = random_loops(np.random.default_rng(2), 1, 4, 2)
    many = replace(one, times=np.zeros(100), **{k: np.repeat(getattr(one, k), 100, axis=0) for k in "ABCD"})
    found = steps(many, [0.0, 1.0])
    tracemalloc.start()
    settling = found.settling
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert settling.shape == (100, one.ny, one.nu) and most < 10e6
    assert_allclose(settling, np.broadcast_to(settling[:1], settling.shape), rtol=1e-12)


def test_a_response_with_dead_time_is_shown_as_far_as_its_steps_go(monkeypatch):
    from mfc_analysis.analysis.delay import steps as module

    system = open_system(100 / (control.tf("s") ** 2 + 2 * control.tf("s")), delay=1e-3)
    whole = step(system, 0, "d", "y")
    monkeypatch.setattr(module, "MOST_STEPS", int(1.5 * whole.settling / 1e-3))
    short = step(system, 0, "d", "y")
    assert short.settling == pytest.approx(whole.settling, rel=1e-9)
    assert whole.settling < short.t[-1] < whole.t[-1]
    monkeypatch.setattr(module, "MOST_STEPS", int(0.5 * whole.settling / 1e-3))
    says = r"step d -> y: not settled after .* s, as far as \d+ steps go with a dead time of 0.001 s; the slowest root has a time constant of 1.053 s"
    with pytest.raises(NotConverged, match=says):
        step(system, 0, "d", "y")


@pytest.mark.parametrize("where", [0, (0, 0), (0, 0, 0, 0)])
def test_an_index_that_is_not_three_numbers_is_refused_by_name(where):
    found = ur5(*LOOPS["wrong model"], [0.3]).steps(np.linspace(0.0, 1.0, 3))
    with pytest.raises(BadArgument, match="index"):
        found[where]


@pytest.mark.parametrize("law", [mfc.laws.ComputedTorque(kp=1e-300), mfc.laws.VelocityP(1e-300)])
def test_gains_that_are_next_to_nothing_ramp_as_none_do(law):
    found = mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(np.full(6, 0.3))).linearize().steps([0.0, 0.1], inputs=[6])
    assert set(found.outcome[0, :6, 0]) <= {Outcome.RAMPS, Outcome.SETTLES} and np.isinf(found.settling[0, 0, 0])
