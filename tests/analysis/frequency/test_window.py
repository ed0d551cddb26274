"""The frequencies of a Bode plot."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.frequency.window import BEYOND, MOST_DECADES, window


def test_it_reaches_beyond_the_poles_and_the_crossings() -> None:
    w = window(np.array([-3 + 4j, -3 - 4j, 0.0]), np.array([2.0, np.inf, np.nan]), 2.0, count=7)
    assert_allclose(w, np.geomspace(2 / BEYOND, 5 * BEYOND, 7))
    assert_allclose(window(np.zeros(0, complex), np.zeros(0), np.inf)[[0, -1]], [1e-2, 1e2])


def test_a_sampled_loop_ends_at_half_its_rate_and_a_wide_one_is_cut_about_its_crossover() -> None:
    assert window(np.array([-5.0 + 0j]), np.array([30.0]), 30.0, dt=0.01)[-1] == pytest.approx(np.pi / 0.01, rel=1e-8)
    w = window(np.array([-1e-4 + 0j, -1e9]), np.array([10.0]), 10.0)
    assert_allclose(np.log10(w[[0, -1]] / 10.0), [-0.6 * MOST_DECADES, 0.4 * MOST_DECADES])
