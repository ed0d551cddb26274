"""Margins against closed forms, against python-control where it is right, and against loops that really go unstable."""

from __future__ import annotations

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.analysis.margins import Margins, margins
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import HORIZON, OpenSystem
from mfc_analysis.errors import UnknownPoint
from tests.analysis.conftest import from_matrix, mixed, open_system, random_loops, scaled

s = control.tf("s")
METRICS = ("gain_reduction", "gain_increase", "phase_deg", "delay", "sensitivity_peak", "crossover")


def of(L, horizon: float = HORIZON) -> dict[str, float]:
    found = margins(replace(open_system(L), horizon=horizon), "torque")
    return {name: float(getattr(found, name)[0, 0]) for name in METRICS}


def test_a_conditionally_stable_loop_has_a_lower_end():
    found = of((s + 0.1) ** 2 / (s**3 * (s + 1)))
    assert_allclose([found["phase_deg"], found["gain_reduction"]], [37.17, 0.0625], rtol=2e-4)
    assert found["gain_increase"] == np.inf
    assert_allclose(found["gain_reduction"], 1 / 16, rtol=1e-10)


def test_the_three_margins_of_a_third_order_loop():
    found = of(25 / (s**3 + 10 * s**2 + 10 * s + 10))
    assert_allclose(found["gain_increase"], 3.6, rtol=1e-11)
    assert_allclose([found["phase_deg"], found["delay"]], [29.11, 0.2847], rtol=2e-4)
    assert found["gain_reduction"] == 0


def test_an_unstable_pid_on_a_double_integrator_has_no_margins():
    found = margins(open_system((2 * s**2 + 2 * s + 10) / s**3), "torque")
    assert not found.stable[0]
    assert all(np.isnan(getattr(found, name)).all() for name in METRICS)


def test_a_good_pid_on_a_double_integrator_fails_only_when_its_gain_falls():
    found = of((20 * s**2 + 100 * s + 200) / s**3)
    assert_allclose(found["gain_reduction"], 0.1, rtol=1e-10)
    assert found["gain_increase"] == np.inf
    assert found["sensitivity_peak"] == 1.0


@pytest.mark.parametrize("w", [0.01, 1.0, 400.0])
def test_the_triple_pole_design_loses_stability_at_a_ninth_of_its_gain(w):
    found = of((3 * w * s**2 + 3 * w**2 * s + w**3) / s**3, np.inf)
    assert_allclose(found["gain_reduction"], 1 / 9, rtol=1e-9)
    # |L| = 1 is 3 W^2 - ... : with W = (w_c / w)^2, W^3 = 9 W^2 + 3 W + 1
    W = np.roots([1, -9, -3, -1]).real.max()
    assert_allclose(found["crossover"], w * np.sqrt(W), rtol=1e-9)


@pytest.mark.parametrize("k", [1e-3, 2.0, 1e4])
def test_an_integrator_has_ninety_degrees_and_a_quarter_period(k):
    found = of(k / s, np.inf)
    assert_allclose([found["phase_deg"], found["delay"], found["crossover"]], [90, np.pi / (2 * k), k], rtol=1e-12)
    assert (found["gain_reduction"], found["gain_increase"], found["sensitivity_peak"]) == (0, np.inf, 1)


def test_a_zero_order_hold_costs_phase_and_gain():
    found = of(control.c2d(control.ss(2 / (s**3 + 3 * s**2 + 2 * s)), 0.05))
    assert_allclose([found["gain_increase"], found["phase_deg"]], [2.793, 31.54], rtol=2e-4)


def test_a_resonance_with_three_crossovers_gives_the_delay_of_the_last():
    L = control.tf(3 / (s * (s + 1))) * (1 + 0.2 * s * 40 / (s**2 + 0.8 * s + 1600))
    found = margins(open_system(L), "torque")
    grid = np.linspace(0.1, 100, 2_000_001)
    size = np.abs(L(1j * grid))
    at = grid[np.flatnonzero(np.diff(np.sign(size - 1)))]
    lag = np.angle(-L(1j * at)) % (2 * np.pi)
    assert_allclose(found.delay[0, 0], (lag / at).min(), rtol=1e-4)
    assert_allclose(found.sensitivity_peak[0, 0], np.abs(1 / (1 + L(1j * grid))).max(), rtol=1e-6)


def test_every_metric_is_the_largest_perturbation_a_random_loop_survives(rng):
    system = random_loops(rng, m=60, nx=5, n=1)
    found = margins(system, "torque")
    assert found.stable.sum() > 15
    eps = 1e-5
    for i in np.flatnonzero(found.stable):
        one = system.at(np.array([i]))
        up, down = found.gain_increase[i, 0], found.gain_reduction[i, 0]
        if np.isfinite(up):
            assert stable(scaled(one, up * (1 - eps))) and not stable(scaled(one, up * (1 + eps)))
        if down > 0:
            assert stable(scaled(one, down * (1 + eps))) and not stable(scaled(one, down * (1 - eps)))
        for g in np.geomspace(max(down, 1e-3) * 1.001, min(up, 1e3) * 0.999, 12):
            assert stable(scaled(one, g))


def test_turning_the_loop_by_the_phase_margin_puts_a_pole_on_the_axis(rng):
    system = replace(random_loops(rng, m=60, nx=5, n=1), horizon=np.inf)
    found = margins(system, "torque")
    seen = 0
    for i in np.flatnonzero(found.stable & np.isfinite(found.phase_deg[:, 0])):
        phi = np.radians(found.phase_deg[i, 0])
        inside = [turned(system, i, sign * phi * (1 - 1e-6)).real.max() < 0 for sign in (-1, 1)]
        outside = [turned(system, i, sign * phi * (1 + 1e-6)).real.max() > 0 for sign in (-1, 1)]
        assert all(inside) and any(outside)
        seen += 1
    assert seen > 5


def test_metrics_equal_those_of_python_control_where_it_is_right(rng):
    system = replace(random_loops(rng, m=40, nx=4, n=1), horizon=np.inf)
    found = margins(system, "torque")
    compared = 0
    for i in np.flatnonzero(found.stable):
        L = control.ss(system.A[i], system.B[i][:, 1:], -system.C[i][1:], -system.D[i][1:, 1:])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            gm, pm, _, _, wc, _ = control.stability_margins(L)
        if np.isfinite(pm):
            compared += 1
            assert_allclose([found.phase_deg[i, 0], found.crossover[i, 0]], [abs(pm), wc], rtol=1e-6)
        if np.isfinite(gm):
            nearest = min((found.gain_increase[i, 0], found.gain_reduction[i, 0]), key=lambda g: abs(g - gm))
            assert_allclose(nearest, gm, rtol=1e-6)
    assert compared > 5


def test_each_of_several_loops_is_that_of_the_others_closed(rng):
    system = random_loops(rng, m=30, nx=6, n=3)
    found = margins(system, "torque")
    assert found.stable.sum() > 3 and found.channels == ("j0", "j1", "j2")
    for i in np.flatnonzero(found.stable):
        for k in range(3):
            one = system.at(np.array([i]))
            for g, inside in ((found.gain_increase[i, k], 1 - 1e-5), (found.gain_reduction[i, k], 1 + 1e-5)):
                if 0 < g < np.inf:
                    assert stable(scaled(one, g * inside, k)) and not stable(scaled(one, g / inside, k))


def test_the_peak_is_that_of_a_fine_grid(rng):
    system = replace(random_loops(rng, m=30, nx=6, n=2), horizon=np.inf)
    found = margins(system, "torque")
    for i in np.flatnonzero(found.stable):
        for k in range(2):
            grid = np.geomspace(1e-3, 1e3, 40001)
            S = sensitivity(system, i, k, np.concatenate([[0.0], grid]))
            top = max(1.0, np.abs(S).max())
            assert found.sensitivity_peak[i, k] >= top * (1 - 1e-9)
            assert_allclose(found.sensitivity_peak[i, k], top, rtol=1e-5)  # the grid's own error


def test_stiff_loops_keep_their_digits():
    m, b, k, T, kp, ki = 1.0, 600.0, 1e6, 2e-3, 0.2, 2e-3
    L = k * (kp * s + ki) / (s * (m * s**2 + b * s + k) * (T * s + 1))
    found = of(L, np.inf)
    assert_allclose(found["crossover"], _bisect_crossover(L, 1e-4, 10), rtol=1e-8)
    assert stable(scaled(open_system(L), found["gain_increase"] * (1 - 1e-6)))
    assert not stable(scaled(open_system(L), found["gain_increase"] * (1 + 1e-6)))


def test_a_loop_that_is_not_there_is_not_a_number_at_force_and_unlimited_elsewhere():
    plain = open_system([25 / (s**3 + 10 * s**2 + 10 * s + 10)])
    two = replace(
        plain,
        B=np.concatenate([plain.B, np.zeros((1, 3, 1))], axis=2),
        C=np.concatenate([plain.C, np.zeros((1, 1, 3))], axis=1),
        D=np.pad(plain.D, ((0, 0), (0, 1), (0, 1))),
        wires={"torque": slice(0, 2), "force": slice(0, 2)},
        wire_names=("fz", "mz"),
        wire_delay=np.zeros(2),
        points=("torque", "force"),
    )
    at_torque, at_force = margins(two, "torque"), margins(two, "force")
    assert at_torque.gain_increase[0, 1] == at_torque.phase_deg[0, 1] == at_torque.delay[0, 1] == np.inf
    assert at_torque.sensitivity_peak[0, 1] == 1
    assert np.isnan(at_force.phase_deg[0, 1]) and np.isnan(at_force.sensitivity_peak[0, 1])
    assert_allclose(at_force.gain_increase[0, 0], 3.6)


def test_an_encoder_is_cut_with_its_rate():
    kp, kd, m = 9.0, 4.0, 2.0  # q'' = (-kp q - kd v) / m with q and v cut together: L = (kp + kd s) / (m s^2)
    system = OpenSystem(
        times=np.zeros(1),
        A=np.array([[[0, 1], [0, 0.0]]]),
        B=np.array([[[0, 0], [-kp / m, -kd / m]]]),
        C=np.eye(2)[None],
        D=np.zeros((1, 2, 2)),
        state_names=("q", "v"),
        input_names=(),
        output_names=(),
        wires={"position": slice(0, 1), "rate": slice(1, 2)},
        wire_names=("q", "v"),
        wire_delay=np.zeros(2),
        points=("position",),
    )
    found, expected = margins(system, "position"), margins(open_system((kp + kd * s) / (m * s**2)), "torque")
    for name in METRICS:
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-10)


def test_an_unknown_point_lists_the_known_ones():
    with pytest.raises(UnknownPoint) as why:
        margins(open_system(1 / s), "elbow")
    assert why.value.known == ("torque",)
    with pytest.raises(ValueError, match="'torque'"):
        margins(open_system(1 / s), "rate")


def test_the_worst_metrics_come_with_their_time_and_channel():
    found = margins(open_system([k / (s**3 + 3 * s**2 + 2 * s) for k in (1.0, 3.0, 2.0, 7.0)]), "torque")
    worst = found.worst()
    assert worst.gain_increase[1:] == (1.0, "joint")
    assert_allclose(worst.gain_increase[0], 2.0)
    assert worst.unstable == (3.0,)
    assert "phase" in str(found) and "not stable at 1 time, first t = 3 s; where defined: phase" in str(worst)
    assert_allclose(found.gain_increase_db[0, 0], 20 * np.log10(6))
    assert found.gain_reduction_db[0, 0] == np.inf


def test_the_worst_of_unlimited_margins_is_unlimited_though_another_point_is_unstable():
    worst = margins(open_system([-1 / s, 1 / s, 2 / s]), "torque").worst()  # nanargmin takes the NaN before an inf
    assert worst.gain_increase == (np.inf, 1.0, "joint")
    assert worst.phase_deg[0] == pytest.approx(90)
    assert worst.unstable == (0.0,)


def test_a_notebook_shows_a_table_with_names_escaped():
    found = margins(replace(open_system([25 / (s**3 + 10 * s**2 + 10 * s + 10)]), wire_names=("<b>elbow",)), "torque")
    page = found._repr_html_()
    assert "&lt;b&gt;elbow" in page and "29.1 deg" in page and "3.6" in page


def stable(system: OpenSystem) -> bool:
    return bool(stability(system).nonzero_stable[0])


def turned(system: OpenSystem, i: int, angle: float) -> np.ndarray:
    """Closed-loop poles with the wire multiplied by e^(j angle)."""
    A, B, C, D = system.A[i], system.B[i][:, 1:], system.C[i][1:], system.D[i][1:, 1:]
    turn = np.exp(1j * angle)
    return np.linalg.eigvals(A + turn * B @ C / (1 - turn * D[0, 0]))


def sensitivity(system: OpenSystem, i: int, k: int, w: np.ndarray) -> np.ndarray:
    """1/(1 + L_k) from the definition: cut wire k, close the others, solve."""
    n = system.nw
    nu = system.nu
    others = [j for j in range(n) if j != k]
    A, B, C = system.A[i], system.B[i][:, nu:], system.C[i][system.ny :]
    closed = A + B[:, others] @ C[others]
    x = np.linalg.solve(1j * w[:, None, None] * np.eye(len(A)) - closed, B[:, [k]].astype(complex))
    return 1 / (1 - (C[[k]] @ x)[:, 0, 0])


def _bisect_crossover(L, low: float, high: float) -> float:
    for _ in range(200):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if abs(L(1j * middle)) > 1 else (low, middle)
    return low


def test_results_hold_arrays_of_points_by_channels():
    found = margins(open_system(1 / s), "torque")
    assert isinstance(found, Margins)
    assert all(getattr(found, name).shape == (1, 1) for name in METRICS)


HORIZONS = st.floats(-1, 4).map(lambda x: 10**x)
RATES = st.floats(-3, 3).map(lambda x: 10**x)


def with_root(factor: float, angle: float, horizon: float, fast: float, seed: int) -> np.ndarray:
    """A real matrix with a root (or a pair) at factor/horizon e^(j angle) and a root at -fast, in other coordinates."""
    size = factor / horizon
    if angle in (0.0, np.pi):
        A = np.diag([size * np.cos(angle), -fast])
    else:
        re, im = size * np.cos(angle), size * np.sin(angle)
        A = np.array([[re, im, 0.0], [-im, re, 0.0], [0.0, 0.0, -fast]])
    return mixed(A, np.random.default_rng(seed))


@settings(max_examples=80)
@given(
    horizon=HORIZONS,
    fast=st.floats(2, 1e3),
    angle=st.one_of(st.sampled_from((0.0, np.pi)), st.floats(0.02, np.pi / 2 - 0.02), st.floats(np.pi / 2 + 0.02, np.pi - 0.02)),
    sampled=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_a_root_outside_the_disc_is_judged_and_one_inside_is_slow(horizon, fast, angle, sampled, seed):
    dt = 0.02 * horizon / fast if sampled else 0.0
    for factor in (1.01, 0.99):
        A = with_root(factor, angle, horizon, fast / horizon, seed)
        if sampled:
            A = expm(A * dt)
        found = stability(replace(from_matrix(A, dt=dt), horizon=horizon))
        count = 1 if angle in (0.0, np.pi) else 2
        assert found.slow[0] == (count if factor < 1 else 0)
        assert bool(found.nonzero_stable[0]) == (factor < 1 or angle > np.pi / 2)
        assert_allclose(np.abs(found.slow_roots[0]), np.full(found.slow[0], factor / horizon), rtol=1e-6)
        without = stability(replace(from_matrix(A, dt=dt), horizon=np.inf))
        assert without.slow[0] == 0 and bool(without.stable[0]) == (angle > np.pi / 2)


@settings(max_examples=80)
@given(seed=st.integers(0, 100_000), nx=st.integers(2, 7), scale=RATES)
def test_without_a_horizon_the_verdict_is_the_sign_of_every_root(seed, nx, scale):
    system = random_loops(np.random.default_rng(seed), 6, nx, 1)
    system = replace(system, A=scale * system.A, B=scale * system.B, horizon=np.inf)
    found = stability(system)
    roots = np.linalg.eigvals(system.A + system.B[:, :, 1:] @ system.C[:, 1:])
    clear = (np.abs(roots.real) > 1e-7 * np.abs(roots)).all(axis=1)
    assert (found.stable == (roots.real < 0).all(axis=1))[clear].all()
    assert not found.slow.any() and not found.drifts.any()


@settings(max_examples=60)
@given(
    seed=st.integers(0, 100_000),
    nx=st.integers(2, 6),
    scale=RATES,
    horizon=HORIZONS,
    delay=st.sampled_from((0.0, 0.0, 0.05, 1.0)),
    free=st.booleans(),
)
def test_the_verdict_and_the_margins_agree(seed, nx, scale, horizon, delay, free):
    assume(horizon >= 0.05 * delay / scale)
    system = random_loops(np.random.default_rng(seed), 4, nx, 1)
    system = replace(system, A=scale * system.A, B=scale * system.B, wire_delay=np.array([delay / scale]), horizon=horizon)
    if free:  # the first state is a position that nothing holds
        system.A[:, :, 0], system.C[:, :, 0] = 0.0, 0.0
    verdict, found = stability(system), margins(system, "torque")
    assert (found.stable == verdict.nonzero_stable).all() and (found.drifts == verdict.drifts).all()
    for name in METRICS:
        assert (np.isnan(getattr(found, name)[:, 0]) == ~verdict.nonzero_stable).all()
    assert (found.gain_reduction[verdict.nonzero_stable] <= 1).all() and (found.gain_increase[verdict.nonzero_stable] >= 1).all()
    assert (verdict.stable <= verdict.nonzero_stable).all()


@settings(max_examples=40)
@given(seed=st.integers(0, 100_000), nx=st.integers(2, 5), horizon=HORIZONS)
def test_the_gain_interval_ends_where_the_verdict_over_the_horizon_changes(seed, nx, horizon):
    system = replace(random_loops(np.random.default_rng(seed), 4, nx, 1), horizon=horizon)
    found = margins(system, "torque")
    eps = 1e-5
    for i in np.flatnonzero(~np.isnan(found.gain_increase[:, 0])):
        one, up, down = system.at(np.array([i])), found.gain_increase[i, 0], found.gain_reduction[i, 0]
        assume(up > 1 + 1e-3 and down < 1 - 1e-3)
        for g in np.geomspace(max(down, 1e-3) * (1 + eps), min(up, 1e3) * (1 - eps), 15):
            held = stability(scaled(one, g))
            assert held.nonzero_stable[0] or not held.held[0]
        for g in (up * (1 + eps), down * (1 - eps)):
            if 1e-6 < g < 1e6:
                assert not stable(scaled(one, g))
