"""Measured responses drawn: every point at its place, the grey ones not trusted, the deciding band shaded."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.analysis import Comparison, FrequencyResponse
from mfc_analysis.analysis.plain import margins
from mfc_analysis.plots import comparison, figure as sheet, response
from tests.plots.drawn import legend, lines, marks

W = np.geomspace(0.1, 100.0, 60)
L = 4 / (1j * W)


def compared() -> Comparison:
    import control

    deviation = np.where(W > 20, 0.5, 0.01)
    return Comparison("torque", "elbow", 0.0, W, L * np.exp(-0.05j * W), L, deviation, margins(control.tf([4.0], [1.0, 0.0])))


def test_a_response_has_gain_phase_and_coherence():
    found = FrequencyResponse(W, L, np.linspace(1, 0, 60), np.full(60, 8.0), "test")
    gain, phase, coherence = response(found)
    assert_allclose(lines(gain)[0], np.column_stack([W, 20 * np.log10(4 / W)]))
    assert_allclose(lines(phase)[0][:, 1], -90.0)
    assert_allclose(lines(coherence)[0][:, 1], np.linspace(1, 0, 60))
    assert coherence.get_xlabel() == "ω [rad/s]" and response(found, axes=(gain, phase, coherence))[0] is gain


def test_the_misfit_of_a_dead_time_falls_and_what_is_not_trusted_is_grey():
    found = compared()
    gain, phase, misfit = comparison(found)
    grey, good = (lines(misfit, color=c)[0] for c in (sheet.GREY, sheet.colour(1)))
    assert_allclose(good[:, 1], -np.degrees(0.05 * good[:, 0]))
    assert_allclose(good[:, 0], W[found.trusted])
    assert set(grey[:, 0]) == set(W[~found.trusted])
    assert_allclose(lines(phase, color=sheet.colour(0))[0][:, 1], -90.0)
    assert legend(gain) == ["model", "not trusted", "measured"] and len(marks(gain, ".")) == 2
    assert gain.patches and comparison(found, axes=(gain, phase, misfit))[2] is misfit


def test_a_result_draws_itself_with_pyplot_or_in_the_axes_given():
    from matplotlib import pyplot

    found = compared()
    try:
        upper = found.plot()
        assert pyplot.gcf() is upper.figure and len(upper.figure.axes) == 3
        given = sheet.panels_for("three histories")
        assert found.plot(ax=given) is given[0] and pyplot.get_fignums() == [upper.figure.number]
        assert FrequencyResponse(W, L, np.ones(60), np.full(60, 8.0), "test").plot(ax=given) is given[0]
    finally:
        pyplot.close("all")
