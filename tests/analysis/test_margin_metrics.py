"""From crossings to margins: factors, phases and delays of crossings made by hand, the ends at zero and infinity, slow roots taken out."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import Channels
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.margin_metrics import FARTHEST, MarginMetrics, assembled, frequency, put
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.conftest import open_system

s = control.tf("s")
METRICS = ("gain_reduction", "gain_increase", "phase_deg", "delay", "sensitivity_peak", "crossover")
NONE = np.zeros((1, 1))  # S - 1 where L vanishes: no crossing


def of(L) -> dict[str, float]:
    found = margins(open_system(L), "torque")
    return {name: float(getattr(found, name)[0, 0]) for name in METRICS}


def crossings_at(w: list[float], L: list[complex]) -> Crossings:
    """Crossings of one point and channel where the loop has these values."""
    values = np.asarray(L, complex)
    zero = np.zeros(len(w), int)
    return Crossings(zero, zero, np.asarray(w, float), -values / (1 + values))


def made(gain: Crossings, phase: Crossings, at_zero: np.ndarray = NONE, at_infinity: np.ndarray = NONE) -> dict[str, float]:
    zero = np.zeros(1, int)
    arc = Crossings(zero, zero, np.zeros(1), at_zero[0].astype(complex))
    return {name: float(values[0, 0]) for name, values in assembled(gain, phase, arc, at_infinity, lambda w: w).items()}


# --- from crossings ----------------------------------------------------------------------------------------------------------


def test_the_gain_interval_ends_at_the_nearest_crossings_on_both_sides_of_minus_one():
    found = made(crossings_at([], []), crossings_at([1.0, 2.0, 3.0, 4.0, 5.0], [-0.5, -0.25, -4.0, -2.5, 7.0]))
    assert_allclose([found["gain_increase"], found["increase_frequency"]], [2.0, 1.0])
    assert_allclose([found["gain_reduction"], found["reduction_frequency"]], [0.4, 4.0])


def test_without_crossings_nothing_is_limited():
    found = made(crossings_at([], []), crossings_at([], []))
    assert found.pop("gain_reduction") == 0.0
    assert set(found.values()) == {np.inf}


def test_the_phase_margin_counts_both_ways_and_the_delay_margin_only_lag():
    lag, lead = -np.exp(0.5j), -np.exp(-0.2j)  # 0.5 rad above -180 degrees; 0.2 rad beyond them
    found = made(crossings_at([2.0, 3.0], [lag, lead]), crossings_at([], []))
    assert_allclose([found["phase_deg"], found["crossover"]], [np.degrees(0.2), 3.0])
    assert_allclose([found["delay"], found["delay_frequency"]], [0.25, 2.0])  # the other one needs (2 pi - 0.2) / 3


def test_the_ends_at_zero_and_infinity_count_as_crossings():
    S = 1 / (1 + np.array([[-0.8]]))
    at_zero, at_infinity = (made(crossings_at([], []), crossings_at([], []), **{end: S - 1}) for end in ("at_zero", "at_infinity"))
    assert_allclose([at_zero["gain_increase"], at_zero["increase_frequency"]], [1.25, 0.0])
    assert_allclose(at_infinity["gain_increase"], 1.25)
    assert at_infinity["increase_frequency"] == np.inf


@pytest.mark.parametrize(("size", "limited"), [(0.99, True), (1.01, False)])
def test_gains_beyond_the_farthest_count_as_infinite_and_zero(size, limited):
    up = made(crossings_at([], []), crossings_at([1.0], [-1 / (size * FARTHEST)]))
    assert_allclose(up["gain_increase"], size * FARTHEST if limited else np.inf, rtol=1e-6)
    down = made(crossings_at([], []), crossings_at([1.0], [-size * FARTHEST]))
    assert_allclose(down["gain_reduction"], 1 / (size * FARTHEST) if limited else 0.0, rtol=1e-6)


def test_a_place_in_the_w_plane_becomes_a_frequency_up_to_nyquist():
    w = np.array([0.0, np.tan(0.3), np.inf])
    assert_allclose(frequency(w, 0.01), [0.0, 60.0, np.pi / 0.01])
    assert frequency(w, 0.0) is w


def test_metrics_are_put_where_their_points_belong():
    whole = MarginMetrics(*(np.full((3, 2), np.nan) for _ in range(10)))
    put(whole, np.array([2, 0]), MarginMetrics(*(np.array([[1.0, 2.0], [3.0, 4.0]]) + k for k in range(10))))
    assert_allclose(whole.gain_reduction, [[3, 4], [np.nan, np.nan], [1, 2]])
    assert_allclose(whole.peak_frequency, [[12, 13], [np.nan, np.nan], [10, 11]])


# --- at zero frequency -------------------------------------------------------------------------------------------------------


def free_beside(B: float, C: float) -> Channels:
    """S - 1 = -1 / (s + 2) of one state, and a root at zero that the wire drives by B and reads by C."""
    return Channels(("j",), np.array([[[-2.0, 0], [0, 0]]]), np.array([[[1.0], [B]]]), np.array([[[-1.0, C]]]), np.zeros((1, 1)), 0.0)


def test_a_root_through_zero_ends_the_interval():
    below = of(2 / (1 - s / 3))  # L(0) = 2 ... an unstable plant with the wrong sign: L = -6 / (s - 3)
    assert np.isnan(below["phase_deg"])
    above = of(6 / (s - 3))  # s - 3 + 6 k: k > 1/2
    assert_allclose(above["gain_reduction"], (3 - 1 / 100) / 6, rtol=1e-12)  # the root leaves the disc of slow roots to the right
    falling = of(-0.8 / (s + 1))  # s + 1 - 0.8 k: k < 1.25, and up to 1.2625 the root stays within the disc
    assert_allclose([falling["gain_increase"], falling["sensitivity_peak"]], [1.01 / 0.8, abs((0.01j + 1) / (0.01j + 0.2))], rtol=1e-12)
    assert falling["phase_deg"] == falling["delay"] == np.inf


def test_a_root_from_infinity_ends_the_interval():
    found = of(-0.5 * (s + 3) / (s + 1))  # s (1 - k/2) + 1 - 3 k / 2: k < 2/3 < 1, unstable
    assert np.isnan(found["gain_increase"])
    found = of(-0.5 * (s + 1) / (s + 3))  # s (1 - k/2) + 3 - k/2: k < 2
    assert_allclose(found["gain_increase"], 2.0, rtol=1e-12)


def test_a_sampled_loop_may_fail_at_minus_one():
    k, a = 0.4, 0.9  # L = k / (z - a): z = a - k g reaches -1 at g = (1 + a) / k, and 1 never
    found = of(control.tf([k], [1, -a], 0.01))
    assert_allclose(found["gain_increase"], (1 + a) / k, rtol=1e-10)


def test_lead_and_lag_both_count_and_the_smallest_of_several_crossovers_wins():
    L = (s + 1) * 3 / (s - 2) * 1 / (0.01 * s + 1)
    found = margins(open_system(L), "torque")
    w = found.crossover[0, 0]
    assert_allclose(abs(L(1j * w)), 1, rtol=1e-9)
    assert_allclose(found.phase_deg[0, 0], abs(np.degrees(np.angle(-L(1j * w)))), rtol=1e-9)


def test_a_drifting_loop_keeps_the_metrics_of_its_other_roots():
    L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    plain = open_system(L)
    drifting = with_zeros(plain, np.array([[0, 1], [0, 0.0]]), driven=0.0)
    neutral = with_zeros(plain, np.zeros((1, 1)), driven=1.0)
    expected = margins(plain, "torque")
    for other, drifts in ((drifting, True), (neutral, False)):
        found = margins(other, "torque")
        assert found.drifts[0] == drifts and found.stable[0]
        for name in METRICS:
            assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9)


def test_a_sampled_drifting_loop_keeps_its_metrics():
    plain = open_system(control.c2d(control.ss(2 / (s**3 + 3 * s**2 + 2 * s)), 0.05))
    found, expected = margins(with_zeros(plain, np.eye(1), driven=1.0), "torque"), margins(plain, "torque")
    assert found.stable[0]
    for name in METRICS:
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-8)


def with_zeros(system: OpenSystem, chain: np.ndarray, driven: float) -> OpenSystem:
    """The same loop with more states: a chain of integrators driven by the first state."""
    m, nx, k = len(system.A), system.nx, len(chain)
    A = np.zeros((m, nx + k, nx + k))
    A[:, :nx, :nx], A[:, nx:, nx:] = system.A, chain
    A[:, -1, 0] = driven
    return replace(
        system,
        A=A,
        B=np.pad(system.B, ((0, 0), (0, k), (0, 0))),
        C=np.pad(system.C, ((0, 0), (0, 0), (0, k))),
        state_names=(*system.state_names, *(f"free{i}" for i in range(k))),
    )


@pytest.mark.parametrize(("direct", "tolerates"), [(1.5, False), (-5.0, False), (0.8, True)])
def test_a_direct_gain_of_one_or_more_tolerates_no_dead_time_at_all(direct, tolerates):
    """With e^(-sT) round it, however short, the roots of 1 + L(inf) e^(-sT) = 0 lie at ln|L(inf)| / T > 0."""
    L = direct * (s + 1) / (s + 4)
    found = margins(open_system(L), "torque")
    assert found.stable[0]
    assert bool(found.delay[0, 0] > 0) is tolerates
    for T in (1e-6, 1e-3):
        assert bool(stability(open_system(L, delay=T)).nonzero_stable[0]) is tolerates


def test_the_direct_gain_of_a_sampled_loop_is_no_feedthrough_round_a_dead_time():
    found = margins(open_system(control.tf([1.5, 0], [1, 0.2], 0.01)), "torque")
    assert found.stable[0] and found.delay[0, 0] > 0
