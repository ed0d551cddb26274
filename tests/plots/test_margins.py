"""Margins against time: the unit of each metric, what was asked, the worst place, and words where there is no line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import plots
from mfc_analysis.errors import UnknownName
from mfc_analysis.plots import figure as sheet
from mfc_analysis.plots.margins import metric_values
from tests.plots.drawn import legend, levels, lines, marks, words
from tests.plots.kinds import UR5, Margins, history


def limitless(m: int = 5) -> Margins:
    infinite = np.full((m, 1), np.inf)
    return replace(history(m, 1), gain_increase=infinite, phase_deg=infinite)


def test_each_metric_is_drawn_in_its_own_unit():
    found = history(11)
    assert_allclose(metric_values(found, "gain_increase_db"), 20 * np.log10(found.gain_increase))
    assert_allclose(metric_values(found, "gain_reduction_db"), 20 * np.log10(9))  # 1/9, as a positive number of decibels
    assert_allclose(metric_values(found, "delay"), 1e3 * found.delay)
    assert metric_values(replace(found, gain_reduction=0 * found.delay), "gain_reduction_db").min() == np.inf
    with pytest.raises(UnknownName) as why:
        metric_values(found, "phase")
    assert "phase_deg" in why.value.known


def test_there_is_a_line_for_each_channel_with_its_values_and_name():
    found = history(21)
    ax = plots.margins(found)
    drawn = lines(ax, style="-")[:6]
    for j, line in enumerate(drawn):
        assert_allclose(line, np.column_stack([found.times, found.phase_deg[:, j]]))
    assert len(legend(ax)) == len(UR5)


@pytest.mark.parametrize(("metric", "asked", "level"), [("phase_deg", 45.0, 45.0), ("delay", 2e-3, 2.0)])
def test_what_was_asked_is_a_dashed_line_in_the_drawn_unit(metric, asked, level):
    assert levels(plots.margins(history(), metric=metric, asked=asked)) == [level]
    assert levels(plots.margins(history(), metric=metric)) == []


@pytest.mark.parametrize(("metric", "pick"), [("phase_deg", np.nanargmin), ("sensitivity_peak", np.nanargmax)])
def test_the_worst_place_is_marked_lowest_for_margins_and_highest_for_peaks(metric, pick):
    found = history(31)
    values = metric_values(found, metric)
    i, j = np.unravel_index(pick(values), values.shape)
    ax = plots.margins(found, metric=metric)
    assert_allclose(marks(ax, "o"), [[[found.times[i], values[i, j]]]])
    assert words(ax) == [sheet.written(values[i, j])]


def test_where_the_loop_is_unstable_the_time_is_shaded_and_said():
    found = history(101, unstable=True)
    ax = plots.margins(found)
    assert "unstable" in words(ax)
    (shade,) = [patch for patch in ax.patches if patch.get_facecolor()[:3] != (1, 1, 1)]
    bad = found.times[~found.stable]
    box = shade.get_extents().transformed(ax.transData.inverted())
    assert_allclose([box.x0, box.x1], [bad[0] - 0.01, bad[-1] + 0.01])
    assert not plots.margins(history()).patches


def test_no_limit_and_never_stable_are_two_answers():
    assert words(plots.margins(limitless())) == ["no limit at any time"]
    never = history(5, 1)
    never = replace(never, stable=np.zeros(5, bool), phase_deg=never.phase_deg * np.nan)
    assert words(plots.margins(never)) == ["unstable at every time"]
    some = history(5, 2)
    some.phase_deg[2:, 0] = np.inf
    assert "no line: no limit" in words(plots.margins(some))


@pytest.mark.parametrize(("up", "down", "label"), [(2.0, 0.1, "gain up [dB]"), (9.0, 0.5, "gain down [dB]")])
def test_a_history_shows_the_tighter_side_of_the_gain(up, down, label):
    found = history(5, 2)
    found = replace(found, gain_increase=np.full((5, 2), up), gain_reduction=np.full((5, 2), down))
    axes = plots.margin_history(found, {"phase_deg": 40.0, "delay": 1e-3})
    assert [ax.get_ylabel() for ax in axes] == ["phase [deg]", label, "delay [ms]", "Ms [-]"]
    assert [levels(ax) for ax in axes] == [[40.0], [], [1.0], []]
    assert [ax.get_xlabel() for ax in axes] == ["", "", "", "t [s]"]


def test_a_history_has_one_to_four_metrics():
    assert len(plots.margin_history(history(), metrics=("delay",))) == 1
    for metrics in ((), ("delay",) * 5):
        with pytest.raises(UnknownName):
            plots.margin_history(history(), metrics=metrics)
