"""Bode and Nyquist plots: the curve is L, and the margins stand where they are on it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import plots
from mfc_analysis.plots import figure as sheet
from mfc_analysis.plots.frequency import _crossing, frequencies_of, of_channel, phase_deg
from tests.plots.drawn import lines, marks, uprights, words

W = np.geomspace(0.01, 100, 3000)
S = 1j * W
L = 25 / (S**3 + 10 * S**2 + 10 * S + 10)  # gain margin 3.6 at sqrt(10) rad/s
KNOWN = {"crossover": 1.78, "phase_margin": 29.1, "gain_increase": 3.6}


@pytest.mark.parametrize("lag_turns", [0, 1, 2, -1])
def test_the_phase_is_normalised_at_the_crossover_whatever_its_turns_before(lag_turns):
    w = np.geomspace(1e-2, 1e3, 2000)
    L = 1 / (1j * w) ** 2 * (1 + 1j * w) * 2  # PD on a double integrator: phase margin at its crossover
    crossover = w[np.argmin(np.abs(np.abs(L) - 1))]
    margin = 180 + np.degrees(np.angle(L[np.argmin(np.abs(np.abs(L) - 1))]))
    turned = L * np.exp(2j * np.pi * lag_turns)
    at = np.interp(np.log(crossover), np.log(w), phase_deg(turned, w, crossover))
    assert at == pytest.approx(-180 + margin, abs=0.1)


def test_a_phase_that_falls_past_minus_540_before_its_crossover_still_meets_its_arrow():
    w = np.geomspace(1e-2, 1e3, 4000)
    L = 30 / (1 + 1j * w / 0.1) ** 2 * np.exp(-1j * w * 3)
    at = int(np.argmin(np.abs(np.abs(L) - 1)))
    assert abs(phase_deg(L, w, w[at])[at] + 180) <= 180


def test_gain_arrows_stand_where_the_drawn_curve_crosses_the_negative_real_axis():
    w = np.geomspace(0.01, 100, 3000)
    L = 25 / ((1j * w) ** 3 + 10 * (1j * w) ** 2 + 10 * 1j * w + 10)  # crosses at w = sqrt(10): L = 25/(10 - 100) = -1/3.6
    assert _crossing(w, L, 3.6) == pytest.approx(np.sqrt(10), rel=1e-4)
    assert _crossing(w, L, 50.0) is None


def test_the_curves_are_decibels_and_degrees_of_the_loop():
    upper, lower = plots.bode(W, L, index=3)
    (gain,), (phase,) = (lines(ax, color=sheet.colour(3)) for ax in (upper, lower))
    assert_allclose(gain, np.column_stack([W, 20 * np.log10(np.abs(L))]), rtol=1e-12)
    assert_allclose(np.exp(1j * np.radians(phase[:, 1])), L / np.abs(L), atol=1e-9)
    assert np.abs(np.diff(phase[:, 1])).max() < 5  # no jumps
    assert upper.get_ylabel() == "|L| [dB]" and lower.get_xlabel() == "ω [rad/s]"


def test_margins_stand_at_their_frequencies_with_their_numbers():
    upper, lower = plots.bode(W, L, **KNOWN)
    for ax in (upper, lower):
        assert_allclose(uprights(ax), [1.78, np.sqrt(10)], rtol=1e-4)
    assert words(upper) == ["GM 11.1 dB"] and words(lower) == ["PM 29.1°"]
    given, _ = plots.bode(W, L, gain_increase=3.6, increase_frequency=50.0)
    assert uprights(given) == [50.0]


def test_arrows_reach_from_the_line_of_reference_to_the_curve():
    upper, lower = plots.bode(W, L, **KNOWN)
    (gain,), (phase,) = ([text for text in ax.texts if not text.get_text()] for ax in (upper, lower))
    assert_allclose(gain.xy, [np.sqrt(10), -20 * np.log10(3.6)], rtol=1e-4)
    assert_allclose(phase.xy, [1.78, np.degrees(np.interp(1.78, W, np.unwrap(np.angle(L))))], rtol=1e-4)
    assert (gain.xyann[1], phase.xyann[1]) == (0, -180)


@pytest.mark.parametrize("nothing", [{}, {"gain_increase": np.inf}, {"gain_reduction": 0.0}, {"gain_increase": 3.6, "increase_frequency": 1e3}])
def test_margins_that_are_not_there_or_not_in_the_window_are_not_drawn(nothing):
    for ax in plots.bode(W, L, **nothing):
        assert uprights(ax) == [] and words(ax) == []


def test_a_nyquist_plot_has_both_halves_and_keeps_out_of_its_disc():
    peak = np.abs(1 / (1 + L)).max()
    ax = plots.nyquist(W, L, sensitivity_peak=peak, **KNOWN)
    above, below = (line for line in lines(ax, color=sheet.colour(0)))
    assert_allclose(above, np.column_stack([L.real, L.imag]))
    assert_allclose(below, above * [1, -1])
    assert_allclose(np.hypot(above[:, 0] + 1, above[:, 1]).min(), 1 / peak)
    circle = next(line for line in lines(ax, color=sheet.INK) if np.allclose(np.hypot(line[:, 0] + 1, line[:, 1]), 1 / peak))
    assert len(circle) > 100
    assert marks(ax, "|")[0].tolist() == [[-1 / 3.6, 0]] and marks(ax, "+")[0].tolist() == [[-1, 0]]


def test_a_loop_far_away_is_left_out_of_the_nyquist_plot():
    ax = plots.nyquist(W, 1 / S)
    shown = lines(ax, color=sheet.colour(0))[0][:, 0]
    assert np.isnan(shown[W < 1 / 40]).all() and np.isfinite(shown[W > 1 / 39]).all()


def test_the_keywords_of_a_channel_are_taken_at_its_time_and_channel():
    table = {name: np.arange(6.0).reshape(2, 3) + 10 * k for k, name in enumerate(
        ("crossover", "phase_deg", "gain_increase", "gain_reduction", "increase_frequency", "reduction_frequency"))}  # fmt: skip
    found = SimpleNamespace(**table)
    assert of_channel(found, 1, 2) == {"crossover": 5.0, "phase_margin": 15.0, "gain_increase": 25.0, "gain_reduction": 35.0}
    assert frequencies_of(found, 0, 1) == {"increase_frequency": 41.0, "reduction_frequency": 51.0}
