"""The sensitivity peak and the frequencies it is looked for on."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.grid import on_grid
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, sensitivity_peak, thinned
from mfc_analysis.analysis.frequency.resolvent import resolvent
from mfc_analysis.analysis.margins import margins
from tests.analysis.conftest import open_system

s = control.tf("s")


@pytest.mark.parametrize("zeta", [1e-5, 1e-3, 0.1, 0.6])
def test_the_peak_of_a_narrow_resonance_is_exact(zeta):
    # T = w^2 / (s^2 + 2 zeta w s + w^2): S = s (s + 2 zeta w) / (...)
    w = 30.0
    found = margins(open_system(w**2 / (s * (s + 2 * zeta * w))), "torque")
    x = np.linspace(max(0, 1 - 20 * zeta), 1 + 20 * zeta, 2_000_001)
    S = np.sqrt(x**2 * (x**2 + 4 * zeta**2) / ((1 - x**2) ** 2 + 4 * zeta**2 * x**2))
    assert_allclose(found.sensitivity_peak[0, 0], S.max(), rtol=1e-9)
    assert_allclose(found.peak_frequency[0, 0], w * x[S.argmax()], rtol=1e-4)


def test_the_two_of_two_resonances_that_is_higher_wins():
    L = control.tf(1.0 / (s + 1)) + 0.02 * s / (s**2 + 0.01 * s + 25) - 0.03 * s / (s**2 + 0.05 * s + 4e4)
    found = margins(open_system(L), "torque")
    grid = np.concatenate([np.linspace(4.9, 5.1, 400_001), np.linspace(199, 201, 400_001)])
    assert_allclose(found.sensitivity_peak[0, 0], np.abs(1 / (1 + L(1j * grid))).max(), rtol=1e-8)


def test_frequencies_rise_and_reach_beyond_all_poles():
    poles = np.array([[-1 + 5j, -1 - 5j, -1e3, -0.02]])
    w = frequencies_of_interest(poles, 0.0)
    assert (np.diff(w, axis=1) >= 0).all() and (w[:, 1:] > 0).all()
    assert w[0, 0] == 0 and w[0, 1] < 1e-3 and w[0, -1] > 5e4
    above = frequencies_of_interest(poles, 0.5)
    assert above[0, 0] == 0.5 and (np.diff(above, axis=1) >= 0).all() and above[0, -1] > 5e4


def test_poles_on_one_spot_need_few_frequencies():
    poles = np.full((2, 18), -10.0 + 0j)
    w = frequencies_of_interest(poles, 0.0)
    few = thinned(w, poles)
    assert few.shape[1] < w.shape[1] / 2
    assert (np.diff(few, axis=1) >= 0).all() and few[0, -1] == w[0, -1] and few[0, 0] == w[0, 0]


def test_a_pole_on_the_lowest_frequency_leaves_the_others_their_frequencies():
    poles = np.array([[0.0, -1e-3 + 20j, -1e-3 - 20j, -3.0]])
    few = thinned(frequencies_of_interest(poles, 0.0), poles)[0]
    assert (np.abs(few - 20) < 5e-3).sum() >= 5 and few.size > 20


@pytest.mark.parametrize("w", [np.array([[0.01, 1.0, 100.0, 1e4]]), np.array([[0.01, *[3.0] * 6, 3000.0, 1e6]])])
def test_a_narrow_peak_between_the_frequencies_is_not_missed(w):
    # the higher of two resonances, 0.1 % damped, at 200 rad/s: no frequency near it, or only a repeated one at its left
    L = control.tf(1.0 / (s + 1)) + 0.02 * s / (s**2 + 0.01 * s + 25) - 0.03 * s / (s**2 + 0.05 * s + 4e4)
    found = resolvent(channels(open_system(L), "torque"))
    peak, at = sensitivity_peak(on_grid(found, w))
    fine = np.linspace(199, 201, 400_001)
    S = np.abs(1 / (1 + L(1j * fine)))
    assert_allclose(peak, S.max(), rtol=1e-8)
    assert_allclose(at, fine[S.argmax()], rtol=1e-7)
