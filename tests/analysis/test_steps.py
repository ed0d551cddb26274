"""Step responses: closed forms, python-control, and what isn't defined."""

from __future__ import annotations

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.steps import Outcome, step
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.errors import BadArgument, UnknownName
from tests.analysis.conftest import open_system, random_loops
from tests.soak.steps import wrong
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
