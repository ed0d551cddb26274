"""Pieces of a response: their extremes and crossings, the metrics, and the runs with dead time and samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.steps import delayed_runner
from mfc_analysis.analysis.step_run import Piece, metrics
from tests.analysis.conftest import control, open_system

s = control.tf("s")


def test_extremes_inside_a_section_are_nodes_and_crossings_lie_between_them() -> None:
    # on 0..2: theta = t / 2, y = 4 theta (1 - theta), at most 1 at t = 1
    hill = Piece(np.array([0.0, 2.0]), np.array([[0.0, 4.0, -4.0]]))
    time, y, section, theta = hill.nodes
    assert_allclose(time, [0, 1, 2], atol=1e-12)
    assert_allclose(y, [0, 1, 0], atol=1e-12)
    assert section.tolist() == [0, 0, 0] and theta[0] == 0 and theta[-1] == 1
    assert_allclose([hill.crossing(0, 0.75), hill.crossing(1, 0.75)], [0.5, 1.5], rtol=1e-12)
    assert_allclose(hill.samples, [[0, 2], [0, 0]], atol=1e-12)


def test_a_held_piece_steps_at_its_samples() -> None:
    stairs = Piece(np.array([0.0, 1.0, 2.0, 3.0]), np.array([[0.0], [0.5], [1.0]]))
    found = metrics([stairs, Piece(np.array([3.0, 4.0]), np.array([[1.0]]))], 1.0)
    assert (found["rise"], found["settling"], found["overshoot"], found["peak"]) == (1.0, 2.0, 0.0, 1.0)
    assert np.isinf(found["peak_time"])


def test_a_hill_on_the_way_to_zero_has_a_peak_and_no_overshoot() -> None:
    hill = Piece(np.array([0.0, 2.0]), np.array([[0.0, 4.0, -4.0]]))
    found = metrics([hill], 0.0)
    assert_allclose([found["peak"], found["peak_time"]], [1.0, 1.0], rtol=1e-9)
    assert np.isnan(found["overshoot"]) and np.isnan(found["rise"])
    assert found["settling"] == pytest.approx(1 + np.sqrt(1 - 0.02), rel=1e-9)  # 4 theta (1 - theta) = 0.02


@pytest.mark.parametrize("steady", [1.0, -1.0])
def test_pieces_out_of_reach_are_not_looked_at(steady: float) -> None:
    class Late(list):  # type: ignore[type-arg]
        def __getitem__(self, i):
            assert i == 0
            return super().__getitem__(i)

    over = Piece(np.array([0.0, 1.0]), steady * np.array([[0.0, 2.8, -1.8]]))  # up to 1.0888..., back to 1
    found = metrics(Late([over, over]), steady, np.array([np.inf, 0.01]))
    assert found["overshoot"] == pytest.approx(2.8**2 / 7.2 - 1, rel=1e-9)


def test_a_delayed_run_is_known_between_its_samples() -> None:
    k, T = 1.5, 0.4
    run = delayed_runner(open_system(k / s, delay=T), 0, 0)(1.2, 10)
    for theta in (0.0, 0.3, 1.0):
        for i in np.flatnonzero(run.t[1:] < 2 * T):  # y' = k (1 - y(t - T)): the first two steps of its series
            t = run.t[i] + theta * (run.t[i + 1] - run.t[i])
            late = max(t - T, 0.0)
            assert_allclose(np.polynomial.polynomial.polyval(theta, run.c[i]), k * t - (k * late) ** 2 / 2, rtol=1e-9, atol=1e-12)
