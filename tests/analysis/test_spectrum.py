"""Stable, neutral, drifting: by rank, on both sides of every boundary."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.spectrum import pole_table, poles, spectrum
from mfc_analysis.analysis.stability import stability
from tests.analysis.conftest import from_matrix, open_system


def companion(*coefficients: float) -> np.ndarray:
    """s^n + c[0] s^(n-1) + ... + c[n-1]; states are derivatives of rising order."""
    n = len(coefficients)
    A = np.eye(n, k=1)
    A[-1] = -np.asarray(coefficients, float)[::-1]
    return A


def verdict(A, integrals=(), dt=0.0):
    s = stability(from_matrix(A, integrals, dt))
    return bool(s.stable[0]), int(s.neutral[0]), bool(s.drifts[0])


def mixed(A: np.ndarray, rng: np.random.Generator, spread: float = 1.0) -> np.ndarray:
    """The same roots in other coordinates."""
    T = np.linalg.qr(rng.normal(size=A.shape))[0] * 10.0 ** rng.uniform(-spread, spread, len(A))
    return T @ A @ np.linalg.inv(T)


def test_a_triple_pole_on_the_left_is_stable_though_it_is_known_to_a_third_of_the_digits():
    w = 20.0
    assert verdict(companion(3 * w, 3 * w**2, w**3)) == (True, 0, False)


@pytest.mark.parametrize("w", [1e-3, 1.0, 1e3])
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
    assert verdict(np.block([[np.array([[0, 1], [0, 0.0]]), np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.0, -1.0])]])) == (False, 1, True)


def test_chains_are_told_in_any_coordinates(rng):
    chain = np.zeros((6, 6))
    chain[0, 1] = chain[1, 2] = 1.0
    chain[4:, 4:] = [[-3.0, 100.0], [-100.0, -3.0]]
    for _ in range(20):
        s = spectrum(from_matrix(mixed(chain, rng)))
        assert (s.roots.neutral[0], bool(s.roots.drifts[0]), s.roots.count[0]) == (1, True, 4)
        assert_allclose(s.poles[0, 4:], [-3 + 100j, -3 - 100j], rtol=1e-9)
        assert np.all(s.poles[0, :4] == 0)


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("slow", [2e-3, 1e-5])
def test_a_slow_root_beside_stiff_ones_is_not_a_root_at_zero(stiffness, slow):
    # a mass on a wall with torque lag, force integral gain so small that the slow root is `slow`
    m, b, T = 1.0, 50.0, 2e-3
    A = np.array([[0, 1, 0, 0], [-stiffness / m, -b / m, 1 / m, 0], [0, 0, -1 / T, slow / T], [-stiffness, 0, 0, 0]])
    s = spectrum(from_matrix(A))
    assert s.roots.count[0] == 0
    assert_allclose(s.poles[0, 0], -slow, rtol=1e-2)


def test_integrals_that_act_on_nothing_are_dropped_before_anything_is_judged():
    # position loop whose integral gain is zero on the second axis, which is itself free: its integral ramps, and does not matter
    A = np.zeros((4, 4))  # q1, q2, z1, z2
    A[0, 0], A[0, 2] = -3.0, -2.0
    A[2, 0], A[3, 1] = 1.0, 1.0
    assert verdict(A, integrals=(2, 3)) == (True, 1, False)
    assert verdict(A) == (False, 0, True)
    assert stability(from_matrix(A, (2, 3))).idle[0] == 1


def test_an_integral_gain_of_lower_rank_drops_directions_not_entries():
    ki = np.array([[1.0, 2.0], [2.0, 4.0]])
    A = np.block([[-5 * np.eye(2), -ki], [np.eye(2), np.zeros((2, 2))]])
    s = stability(from_matrix(A, (2, 3)))
    assert (s.stable[0], s.neutral[0], s.idle[0]) == (True, 0, 1)


def test_a_sampled_loop_is_judged_against_the_unit_circle():
    assert verdict(np.diag([0.5, -0.9]), dt=0.01) == (True, 0, False)
    assert verdict(np.diag([0.5, 1.0]), dt=0.01) == (True, 1, False)
    assert verdict(np.array([[1.0, 0.01, 0], [0, 1, 0], [0, 0, 0.5]]), dt=0.01) == (False, 0, True)
    assert verdict(np.diag([0.5, -1.0]), dt=0.01)[0] is False
    c, s = np.cos(0.3), np.sin(0.3)
    assert verdict(np.array([[c, s], [-s, c]]), dt=0.01)[0] is False


def test_poles_are_slowest_first_with_zeros_before_all_and_in_one_order():
    A = np.zeros((6, 6))
    A[0, 0], A[1:3, 1:3], A[4, 4], A[5, 5] = -5.0, [[-1, 3], [-3, -1]], -0.1, 2.0
    assert_allclose(poles(from_matrix(A))[0], [0, -0.1, -1 + 3j, -1 - 3j, 2, -5])


def test_routh_bound_from_both_sides():
    for factor, expected in ((0.999, True), (1.001, False)):
        kp, kd = 7.0, 3.0
        assert verdict(companion(kd, kp, kd * kp * factor))[0] is expected


def test_the_table_gives_frequency_damping_and_time_constant():
    first, second = pole_table(from_matrix(companion(2 * 0.3 * 5, 25.0)), 0)
    assert_allclose([first.frequency, first.damping, first.time_constant], [5.0, 0.3, 1 / 1.5], rtol=1e-12)
    assert second.value == first.value.conjugate()
    z = pole_table(from_matrix(np.diag([np.exp(-0.2), 0.0]), dt=0.1), 0)
    assert_allclose([z[0].frequency, z[0].time_constant], [2.0, 0.5], rtol=1e-12)
    assert z[1].time_constant == 0
    assert [p.kind for p in pole_table(from_matrix(np.array([[0, 2.0, 0, 0], [-2, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]])), 0)] == [
        "zero",
        "undamped",
        "undamped",
        "unstable",
    ]


def test_points_are_judged_one_by_one():
    L = [control.tf([k], [1, 3, 2, 0]) for k in (5.9, 6.1)]
    assert stability(open_system(L)).stable.tolist() == [True, False]
