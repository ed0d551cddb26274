"""Pieces of a response: their extremes and crossings, the metrics, and the runs with dead time and samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.steps import delayed_runner
from mfc_analysis.analysis.step_run import Piece, metrics, metrics_of
from tests.analysis.conftest import control, open_system

s = control.tf("s")


def polynomial(t: list[float], c: list[list[float]]) -> Piece:
    """One response by its coefficients, a row for each section."""
    return Piece(np.array(t), np.array(c).T[:, None], np.eye(len(c[0])))


HILL = polynomial([0.0, 2.0], [[0.0, 4.0, -4.0]])  # theta = t / 2, y = 4 theta (1 - theta), at most 1 at t = 1
ONE = np.ones(1)


def test_extremes_inside_a_section_are_seen_and_crossings_lie_between_them() -> None:
    first = np.zeros(1, int)
    assert_allclose(HILL.bounds, [[[1.0]], [[0.0]]], atol=1e-12)
    assert_allclose(HILL.extreme(first, first, ONE), 1.0, rtol=1e-12)
    assert_allclose(HILL.first(first, first, 0.75 * ONE, ONE), 0.5, rtol=1e-12)
    assert_allclose(HILL.last(first, first, 0 * ONE, 0.75 * ONE), 1.5, rtol=1e-12)
    assert_allclose(HILL.values(np.array([0.0, 0.5, 1.0, 2.0])), [[0.0, 0.75, 1.0, 0.0]], atol=1e-12)
    t, y = HILL.samples
    assert_allclose(t, [0, 2])
    assert_allclose(y, [[0, 0]], atol=1e-12)


def test_a_held_response_steps_at_its_samples() -> None:
    stairs = polynomial([0.0, 1.0, 2.0, 3.0, 4.0], [[0.0], [0.5], [1.0], [1.0]])
    found = metrics_of(stairs, ONE)
    assert (found["rise"], found["settling"], found["overshoot"], found["peak"]) == (1.0, 2.0, 0.0, 1.0)
    assert np.isinf(found["peak_time"])


def test_a_hill_on_the_way_to_zero_has_a_peak_and_no_overshoot() -> None:
    found = metrics_of(HILL, 0 * ONE)
    assert_allclose([found["peak"], found["peak_time"]], [[1.0], [1.0]], rtol=1e-9)
    assert np.isnan(found["overshoot"]) and np.isnan(found["rise"])
    assert_allclose(found["settling"], 1 + np.sqrt(1 - 0.02), rtol=1e-9)  # 4 theta (1 - theta) = 0.02


def test_many_responses_have_the_metrics_that_each_has_alone() -> None:
    """Overshoot up and down, a swing into the wrong direction first, no final value: polynomials drawn at random, which end at c(1)."""
    rng = np.random.default_rng(7)
    ends = rng.normal(size=(6, 40, 5))
    ends[0, :, 1:] = ends.sum(axis=0)[:, :1]
    basis = np.eye(6)
    for k in range(1, 5):  # continuous
        ends[0, :, k] = ends[:, :, k - 1].sum(axis=0)
    steady = ends[:, :, -1].sum(axis=0)
    steady[::7] = 0.0
    run = Piece(np.array([0.0, 1.0, 1.5, 3.0, 7.0, 8.0]), ends, basis)
    every = metrics_of(run, steady)
    dense = np.linspace(0.0, 8.0, 80_001)
    samples = run.values(dense)
    for p in range(40):
        alone = metrics_of(run.of(np.array([p])), steady[[p]])
        for name, values in every.items():
            assert_allclose(values[p], alone[name][0], rtol=1e-12, err_msg=name)
        y = samples[p]
        assert every["peak"][p] == pytest.approx(max(np.abs(y).max(), abs(steady[p])), rel=1e-6)
        band = 0.02 * (abs(steady[p]) or every["peak"][p])
        outside = dense[np.abs(y - steady[p]) > band]
        assert every["settling"][p] == pytest.approx(outside[-1] if outside.size else 0.0, abs=2e-4)


@pytest.mark.parametrize("steady", [1.0, -1.0])
def test_pieces_out_of_reach_are_not_looked_at(steady: float) -> None:
    over = polynomial([0.0, 1.0], (steady * np.array([[0.0, 2.8, -1.8]])).tolist())  # up to 1.0888..., back to 1

    def piece(i, which):
        assert i == 0
        return over.of(which)

    found = metrics(piece, steady * ONE, np.array([[np.inf], [0.01]]))
    assert_allclose(found["overshoot"], 2.8**2 / 7.2 - 1, rtol=1e-9)


def test_a_delayed_run_is_known_between_its_samples() -> None:
    k, T = 1.5, 0.4
    run = delayed_runner(open_system(k / s, delay=T))(1.2, 10)
    t = np.linspace(0.0, 2 * T, 33)  # y' = k (1 - y(t - T)): the first two steps of its series
    assert_allclose(run.values(t)[0], k * t - (k * np.maximum(t - T, 0.0)) ** 2 / 2, rtol=1e-9, atol=1e-12)
