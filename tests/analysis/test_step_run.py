"""A run between its samples: the continuous, the delayed and the sampled one against their closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.steps import delayed_runner
from mfc_analysis.analysis.steps import _runner
from tests.analysis.conftest import open_system

s = control.tf("s")


@pytest.mark.parametrize("ahead", [0.0, 0.13, 0.25])
def test_between_its_samples_a_run_is_the_exact_response_and_its_slope(ahead):
    k, steps = 2.0, 8
    run = _runner(open_system(k / s), 0, 0)(2.0, steps)  # y = 1 - e^(-k t), whatever the grid
    for i in range(steps):
        t = run.t[i] + ahead
        assert_allclose(run.between(i, ahead), [1 - np.exp(-k * t), k * np.exp(-k * t)], rtol=1e-12, atol=1e-12)
    assert_allclose([run.between(i, 0.0) for i in range(steps)], np.stack([run.y, run.slope], axis=1)[:steps], rtol=1e-12)


def test_a_delayed_run_is_known_between_its_samples_too():
    k, T = 1.5, 0.4
    run = delayed_runner(open_system(k / s, delay=T), 0, 0)(1.2, 10)
    ahead = 0.3 * (run.t[1] - run.t[0])
    for i in np.flatnonzero(run.t + ahead < 2 * T):  # y' = k (1 - y(t - T)): the first two steps of its series
        t = run.t[i] + ahead
        late = max(t - T, 0.0)
        assert_allclose(run.between(int(i), ahead), [k * t - (k * late) ** 2 / 2, k - k**2 * late], rtol=1e-9)


def test_a_sampled_run_holds_its_value_between_the_samples():
    run = _runner(open_system(control.tf([0.4], [1, -0.9], 0.01)), 0, 0)(0.05, 5)
    assert [run.between(2, d) for d in (0.0, 0.004, 0.0099)] == [(run.y[2], 0.0)] * 3
    assert not run.slope.any() and run.y[2] != run.y[3]
