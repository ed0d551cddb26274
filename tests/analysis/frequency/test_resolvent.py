"""Frequency responses of the sensitivities: by modes and by solving."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.resolvent import resolvent
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def test_modes_and_solutions_agree_on_value_and_slope(rng):
    found = resolvent(channels(random_loops(rng, 20, 6, 2), "torque"))
    assert found.modal.all()
    solved = replace(found, modal=np.zeros(20, bool))
    point, channel, w = rng.integers(0, 20, 50), rng.integers(0, 2, 50), rng.uniform(0, 20, 50)
    for a, b in zip(found.at(point, channel, w), solved.at(point, channel, w), strict=True):
        assert_allclose(a, b, rtol=1e-9, atol=1e-12)
    grid = np.tile(np.linspace(0.1, 9, 7), (20, 1))
    assert_allclose(found.on(grid), solved.on(grid), rtol=1e-9, atol=1e-12)


def test_the_slope_is_that_of_the_value(rng):
    found = resolvent(channels(random_loops(rng, 3, 6, 1), "torque"))
    point, channel, w = np.arange(3), np.zeros(3, int), np.array([0.3, 2.0, 7.0])
    h = 1e-5
    difference = (found.at(point, channel, w + h)[0] - found.at(point, channel, w - h)[0]) / (2 * h)
    assert_allclose(found.at(point, channel, w)[1], difference, rtol=1e-7)


def test_modes_of_a_triple_pole_are_not_used():
    found = resolvent(channels(open_system((15 * s**2 + 75 * s + 125) / s**3), "torque"))
    assert not found.modal[0]
    w = np.array([4.0])
    L = (15 * (4j) ** 2 + 75 * 4j + 125) / (4j) ** 3
    assert_allclose(found.at(np.zeros(1, int), np.zeros(1, int), w)[0], 1 / (1 + L) - 1, rtol=1e-12)


def test_the_units_of_the_states_do_not_matter(rng):
    system = random_loops(rng, 10, 6, 1)
    D = 10.0 ** rng.uniform(-5, 5, (10, 6))
    other = replace(system, A=system.A * D[:, :, None] / D[:, None, :], B=system.B * D[:, :, None], C=system.C / D[:, None, :])
    a, b = resolvent(channels(system, "torque")), resolvent(channels(other, "torque"))
    assert (a.modal == b.modal).all()
    assert a.modal.all()


def test_exactly_dependent_eigenvectors_fall_back_to_solving():
    found = resolvent(channels(open_system([1 / s**2, 1 / (s**2 + 1)]), "torque").at(np.array([0])))
    chain = replace(found.ch, A=np.eye(2, k=1)[None])
    again = resolvent(chain)
    assert again.modal.tolist() == [False]
    assert np.isfinite(again.on(np.array([[1.0]]))).all()


def test_empty_channels_are_known():
    one = channels(open_system(1 / (s + 1)), "torque")
    assert not one.empty.any()
    assert replace(one, B=np.zeros_like(one.B)).empty.all()
    with pytest.raises(ValueError):
        channels(open_system(1 / s), "rate")
