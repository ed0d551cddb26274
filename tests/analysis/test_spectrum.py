"""Poles: the slow ones told by size in any coordinates, their order, and the table of frequencies and dampings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.slow import parts
from mfc_analysis.analysis.spectrum import pole_table, poles, root_rows, spectrum
from mfc_analysis.errors import NotConverged
from tests.analysis.conftest import companion, from_matrix, mixed


def test_chains_are_slow_in_any_coordinates(rng):
    chain = np.zeros((6, 6))
    chain[0, 1] = chain[1, 2] = 1.0
    chain[4:, 4:] = [[-3.0, 100.0], [-100.0, -3.0]]
    for _ in range(20):
        s = spectrum(from_matrix(mixed(chain, rng)))
        assert s.slow[0].tolist() == [True] * 4 + [False] * 2
        assert_allclose(s.poles[0, 4:], [-3 + 100j, -3 - 100j], rtol=1e-9)
        assert np.abs(s.poles[0, :4]).max() < 1e-3


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("slow", [2e-3, 1e-5])
def test_a_slow_root_beside_stiff_ones_keeps_its_value(stiffness, slow):
    # a mass on a wall with torque lag, force integral gain so small that the slow root is `slow`
    m, b, T = 1.0, 50.0, 2e-3
    A = np.array([[0, 1, 0, 0], [-stiffness / m, -b / m, 1 / m, 0], [0, 0, -1 / T, slow / T], [-stiffness, 0, 0, 0]])
    s = spectrum(from_matrix(A))
    assert s.slow[0].tolist() == [True, False, False, False]
    assert_allclose(s.poles[0, 0], -slow, rtol=1e-2)
    assert not spectrum(replace(from_matrix(A), horizon=2 / slow)).slow.any()  # outside a smaller disc


def test_poles_need_no_schur_form_where_some_are_slow(monkeypatch):
    A = np.diag([0.0, -1e-3, -2.0])
    known = spectrum(from_matrix(A))
    monkeypatch.setattr("mfc_analysis.analysis.spectrum.parts", lambda *_: pytest.fail("the slow part is not asked for"))
    assert_allclose(poles(from_matrix(A))[0], [0, -1e-3, -2])
    assert known.slow[0].tolist() == [True, True, False]


def test_a_slow_part_without_digits_does_not_hide_an_unstable_root():
    """Friction of 1e30 Nm s/rad: sorting the slow roots apart from those of 1e31 1/s moves them by decades; others are at +1e14 1/s."""
    robot = mfc.robots.ur5().with_friction(viscous=1e30, coulomb=0.1)
    law, lag = mfc.laws.ComputedTorque(100.0, 10.0, 20.0), mfc.Hardware(torque_lag=2e-3)
    lin = mfc.ClosedLoop(robot, law, mfc.trajectories.Quintic([0.1, -1.0, 1.0, 0.3, 0.4, 0.5], [0.3] * 6, 1.0), hardware=lag).linearize([0.5])
    with pytest.raises(NotConverged, match="no digits"):
        parts(lin.A[0], 0.01)
    assert spectrum(lin.reduced).parts(0) is None
    assert lin.slow == 14 and not lin.stable


def test_poles_are_slowest_first_with_zeros_before_all_and_in_one_order():
    A = np.zeros((6, 6))
    A[0, 0], A[1:3, 1:3], A[4, 4], A[5, 5] = -5.0, [[-1, 3], [-3, -1]], -0.1, 2.0
    assert_allclose(poles(from_matrix(A))[0], [0, -0.1, -1 + 3j, -1 - 3j, 2, -5])


def test_the_table_gives_frequency_damping_and_time_constant():
    first, second = pole_table(from_matrix(companion(2 * 0.3 * 5, 25.0)), 0)
    assert_allclose([first.frequency, first.damping, first.time_constant], [5.0, 0.3, 1 / 1.5], rtol=1e-12)
    assert second.value == first.value.conjugate()
    z = pole_table(from_matrix(np.diag([np.exp(-0.2), 0.0]), dt=0.1), 0)
    assert_allclose([z[0].frequency, z[0].time_constant], [2.0, 0.5], rtol=1e-12)
    assert z[1].time_constant == 0
    assert [p.kind for p in pole_table(from_matrix(np.array([[0, 2.0, 0, 0], [-2, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]])), 0)] == [
        "slow",
        "undamped",
        "undamped",
        "unstable",
    ]


def test_a_root_that_is_zero_but_for_rounding_has_no_time_constant():
    rows = root_rows(np.array([5e-17 + 0j, -3e-18 + 0j, -1e-3 + 0j, 2e-3 + 0j]), 100.0)
    assert [row.kind for row in rows] == ["slow"] * 4
    assert_allclose([row.time_constant for row in rows], [np.inf, np.inf, 1000.0, -500.0])
