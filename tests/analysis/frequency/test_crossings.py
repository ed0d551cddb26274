"""Every crossing of a loop, against the roots of its polynomials and python-control."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.crossings import Crossings, crossings
from mfc_analysis.analysis.frequency.grid import on_grid
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest
from mfc_analysis.analysis.frequency.resolvent import resolvent
from mfc_analysis.analysis.margin_metrics import FARTHEST
from tests.analysis.conftest import open_system

s = control.tf("s")
LOOPS = {
    "third order": 25 / (s**3 + 10 * s**2 + 10 * s + 10),
    "conditionally stable": (s + 0.1) ** 2 / (s**3 * (s + 1)),
    "three crossovers": control.tf(3 / (s * (s + 1))) * (1 + 0.2 * s * 40 / (s**2 + 0.8 * s + 1600)),
    "unstable plant": 6 * (s + 4) / ((s - 3) * (0.01 * s + 1)),
    "direct term": 2 * (s + 1) / (s + 5),
}


def found(L, modal: bool = True) -> tuple[Crossings, Crossings]:
    """Gain and phase crossings; ``modal=False``: by the eigenvalue problem alone."""
    known = resolvent(channels(open_system(L), "torque"))
    known = known if modal else replace(known, modal=np.zeros(1, bool))
    w = frequencies_of_interest(known.poles, 1e-4)
    gain, phase = crossings(on_grid(known, w))
    near = np.abs(phase.L) < FARTHEST  # in front of an integrator S vanishes, and L is known no further
    return gain, Crossings(phase.point[near], phase.channel[near], phase.w[near], phase.H[near])


def positive_roots(polynomial: np.ndarray) -> np.ndarray:
    """Rising square roots of the roots w^2 of a polynomial in w that are real and positive."""
    w = np.roots(polynomial)
    return np.sort(w[(np.abs(w.imag) < 1e-6 * np.abs(w)) & (w.real > 1e-9)].real)


def on_axis(polynomial: np.ndarray) -> np.ndarray:
    """Coefficients in w of the polynomial at s = j w."""
    return polynomial * 1j ** np.arange(len(polynomial) - 1, -1, -1)


@pytest.mark.parametrize("modal", [True, False], ids=["exclusion", "eigenvalues"])
@pytest.mark.parametrize("name", LOOPS)
def test_crossings_are_the_roots_of_the_loops_polynomials(name, modal):
    L = LOOPS[name]
    num, den = on_axis(L.num[0][0]), on_axis(L.den[0][0])
    gain, phase = found(L, modal)
    size = np.polysub(np.polymul(num, num.conj()), np.polymul(den, den.conj())).real  # |num|^2 = |den|^2
    assert_allclose(np.sort(gain.w), positive_roots(size), rtol=1e-7)
    turn = np.polymul(num, den.conj()).imag  # Im(num den*) = 0
    assert_allclose(np.sort(phase.w), positive_roots(turn), rtol=1e-7)


@pytest.mark.parametrize("name", LOOPS)
def test_a_crossing_carries_the_value_of_the_loop(name):
    L = LOOPS[name]
    for which, condition in zip(found(L), (lambda v: np.abs(v) - 1, lambda v: v.imag / np.abs(v)), strict=True):
        assert_allclose(which.L, L(1j * which.w), rtol=1e-8)
        assert_allclose(condition(which.L), 0, atol=1e-9)


def test_the_crossings_are_those_of_python_control():
    gain, phase = found(LOOPS["third order"])
    gm, pm, wg, wp = control.margin(LOOPS["third order"])
    assert_allclose([phase.w[0], gain.w[0]], [wg, wp], rtol=1e-8)
    assert_allclose(-1 / phase.L[0].real, gm, rtol=1e-8)
    assert_allclose(180 + np.degrees(np.angle(gain.L[0])), pm, rtol=1e-8)
    assert_allclose([phase.w[0], phase.L[0].real], [np.sqrt(10), -1 / 3.6], rtol=1e-12)


@pytest.mark.parametrize(("k", "count"), [(0.99, 0), (1.01, 1)])
def test_a_first_order_loop_crosses_one_only_if_its_gain_is_above_one(k, count):
    gain, phase = found(k / (s + 1))
    assert gain.w.size == count and phase.w.size == 0
    assert_allclose(gain.w**2, [k**2 - 1] * count, rtol=1e-9)


def test_a_channel_that_nothing_enters_has_no_crossings():
    ch = channels(open_system([4 / (s * (s + 1)), 4 / (s * (s + 1))]), "torque")
    ch = replace(ch, B=ch.B * np.array([1.0, 0.0])[:, None, None])
    known = resolvent(ch)
    w = frequencies_of_interest(known.poles, 1e-4)
    gain, _ = crossings(on_grid(known, w))
    assert gain.point.tolist() == [0]
