"""Steps under a held input against closed forms."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.zero_order_hold import zero_order_hold


@pytest.mark.parametrize("h", [0.0, 0.3, 1e16])
def test_a_double_integrator_falls_as_galilei_says(h):
    Phi, Gamma = zero_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), h)
    assert_allclose(Phi, [[1, h], [0, 1]], rtol=1e-14)
    assert_allclose(Gamma[:, 0], [h**2 / 2, h], rtol=1e-14)


def test_each_matrix_of_a_batch_has_its_own_answer():
    rate = np.array([1e-6, 1.0, 4.0, 40.0])
    Phi, Gamma = zero_order_hold(-rate[:, None, None], np.ones((4, 1, 2)), 0.5)
    assert_allclose(Phi[:, 0, 0], np.exp(-rate / 2), rtol=1e-12)
    assert_allclose(Gamma, np.broadcast_to((-np.expm1(-rate / 2) / rate)[:, None, None], (4, 1, 2)), rtol=1e-14)


def test_a_rotation_turns_and_its_integral_is_the_chord():
    A, t = np.array([[0.0, -1.0], [1.0, 0.0]]), 20.0
    Phi, Gamma = zero_order_hold(A, np.eye(2), t)
    assert_allclose(Phi, [[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]], atol=5e-14)
    assert_allclose(Gamma, [[np.sin(t), np.cos(t) - 1], [1 - np.cos(t), np.sin(t)]], atol=5e-14)


def test_nothing_to_step_gives_nothing():
    for A, B, states, inputs in (((0, 3, 3), (0, 3, 1), (0, 3, 3), (0, 3, 1)), ((2, 0, 0), (2, 0, 1), (2, 0, 0), (2, 0, 1))):
        Phi, Gamma = zero_order_hold(np.zeros(A), np.zeros(B), 0.1)
        assert Phi.shape == states and Gamma.shape == inputs


def test_growth_beyond_all_numbers_is_not_finite_and_warns_nobody():
    A = np.array([[1.0, 2.0, 1.0], [0.5, 3.0, 1.0], [1.0, 1.0, 1.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for h in (1e3, 1e10, 1e300):
            Phi, _ = zero_order_hold(A, np.ones((3, 1)), h)
            assert not np.isfinite(Phi).all()


@pytest.mark.parametrize(("A", "h"), [(np.nan, 1.0), (np.inf, 1.0), (1e200, 1e200)])
def test_a_step_that_is_not_finite_is_refused(A, h):
    with pytest.raises(BadArgument, match="finite"):
        zero_order_hold(np.full((2, 2), A), np.ones((2, 1)), h)
