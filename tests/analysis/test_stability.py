"""The verdict: stable, neutral and drifting on both sides of every boundary; dead time by its closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.stability import growth, stability
from tests.analysis.conftest import companion, from_matrix, mixed, open_system

s = control.tf("s")


def verdict(A, integrals=(), dt=0.0):
    s = stability(from_matrix(A, integrals, dt))
    return bool(s.stable[0]), int(s.neutral[0]), bool(s.drifts[0])


def test_a_triple_pole_on_the_left_is_stable_though_it_is_known_to_a_third_of_the_digits():
    w = 20.0
    assert verdict(companion(3 * w, 3 * w**2, w**3)) == (True, 0, False)


@pytest.mark.parametrize("w", [2e-2, 1.0, 1e3])
def test_an_undamped_pair_is_not_stable_even_where_it_is_computed_slightly_to_the_left(w, rng):
    for _ in range(20):
        assert verdict(mixed(np.array([[0, w, 0], [-w, 0, 0], [0, 0, -1.0]]), rng))[0] is False
    assert verdict(companion(2e-6 * w, w**2))[0] is True


def test_a_free_position_is_neutral_and_the_others_decide():
    assert verdict(np.diag([0.0, -1.0])) == (True, 1, False)
    assert verdict(np.array([[0, 1], [0, -2.0]])) == (True, 1, False)
    assert verdict(np.array([[0, 1], [0, 2.0]])) == (False, 1, False)


def test_nothing_but_neutral_roots_is_never_stable():
    assert verdict(np.zeros((3, 3))) == (False, 3, False)


def test_a_position_that_slides_and_a_speed_that_ramps_drift():
    assert verdict(np.array([[0, 1, 0], [0, 0, 0], [0, 0, -1.0]])) == (False, 0, True)
    assert verdict(np.eye(4, k=1) - np.diag([0, 0, 0, 1.0])) == (False, 0, True)
    assert verdict(np.block([[np.array([[0, 1], [0, 0.0]]), np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.0, -1.0])]])) == (False, 0, True)


def test_integrals_that_act_on_nothing_are_dropped_before_anything_is_judged():
    # position loop whose integral gain is zero on the second axis, which is itself free: its integral ramps, and does not matter
    A = np.zeros((4, 4))  # q1, q2, z1, z2
    A[0, 0], A[0, 2] = -3.0, -2.0
    A[2, 0], A[3, 1] = 1.0, 1.0
    assert verdict(A, integrals=(2, 3)) == (True, 1, False)
    assert verdict(A) == (False, 0, True)
    assert stability(from_matrix(A, (2, 3))).idle[0] == 1


def test_an_integral_gain_of_lower_rank_leaves_a_slow_root_that_stays():
    ki = np.array([[1.0, 2.0], [2.0, 4.0]])
    A = np.block([[-5 * np.eye(2), -ki], [np.eye(2), np.zeros((2, 2))]])
    s = stability(from_matrix(A, (2, 3)))
    assert (s.stable[0], s.neutral[0], s.idle[0]) == (True, 1, 0)


def test_a_sampled_loop_is_judged_against_the_unit_circle():
    assert verdict(np.diag([0.5, -0.9]), dt=0.01) == (True, 0, False)
    assert verdict(np.diag([0.5, 1.0]), dt=0.01) == (True, 1, False)
    assert verdict(np.array([[1.0, 0.01, 0], [0, 1, 0], [0, 0, 0.5]]), dt=0.01) == (False, 0, True)
    assert verdict(np.diag([0.5, -1.0]), dt=0.01)[0] is False
    c, s = np.cos(0.3), np.sin(0.3)
    assert verdict(np.array([[c, s], [-s, c]]), dt=0.01)[0] is False


def test_routh_bound_from_both_sides():
    for factor, expected in ((0.999, True), (1.001, False)):
        kp, kd = 7.0, 3.0
        assert verdict(companion(kd, kp, kd * kp * factor))[0] is expected


def test_points_are_judged_one_by_one():
    L = [control.tf([k], [1, 3, 2, 0]) for k in (5.9, 6.1)]
    assert stability(open_system(L)).stable.tolist() == [True, False]


@pytest.mark.parametrize("k", [0.3, 8.0])
def test_an_integrator_survives_a_dead_time_of_a_quarter_period(k):
    for factor, expected in ((0.999, True), (1.001, False)):
        assert stability(open_system(k / s, delay=factor * np.pi / (2 * k))).stable[0] == expected


@pytest.mark.parametrize("d", [0.2, 0.9, 2.5])
def test_the_growth_of_an_integrator_with_dead_time_is_lamberts_function(d):
    # s = -k e^(-s d): s d e^(s d) = -k d
    k = 1.3
    assert_allclose(growth(open_system(k / s, delay=d)), lambertw(-k * d).real / d, rtol=1e-8)
    assert_allclose(growth(open_system(k / s, delay=d)), delay_roots(open_system(k / s, delay=d))[:, 0].real, rtol=1e-8)


def test_the_growth_is_that_of_the_rightmost_pole_with_the_slow_ones_left_out():
    assert_allclose(growth(from_matrix(np.diag([-5.0, -0.2, -3.0]))), -0.2)
    assert_allclose(growth(from_matrix(np.diag([-5.0, 0.0, -3.0]))), -3.0)
    assert_allclose(growth(from_matrix(companion(-2.0, 26.0))), 1.0)
    assert np.isnan(growth(from_matrix(np.zeros((2, 2))))[0])  # nothing but slow roots: not stable, so not -inf


def test_the_growth_of_a_sampled_loop_is_in_rates_not_in_z():
    assert_allclose(growth(from_matrix(np.diag([np.exp(-0.2), -0.5]), dt=0.1)), -2.0)


def test_a_stable_loop_has_a_negative_growth_and_an_unstable_one_a_positive(rng):
    systems = [from_matrix(rng.normal(size=(4, 4)) - shift * np.eye(4)) for shift in np.linspace(0.5, 3.0, 20)]
    signs = [(stability(one).stable[0], growth(one)[0] < 0) for one in systems]
    assert all(a == b for a, b in signs) and {a for a, _ in signs} == {True, False}
