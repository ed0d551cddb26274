"""Traces over time and curves over a parameter: what is drawn are the values, limits and events given."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import Panel, curves, figure as sheet, traces
from tests.plots.drawn import legend, levels, lines, uprights, words

T = np.linspace(0, 2, 21)
Q = np.stack([np.sin(T), np.cos(T)], axis=1)


def test_solid_lines_are_the_values_and_dashed_ones_the_comparison_in_the_same_colours():
    (ax,) = traces(T, [Panel("q [rad]", Q, beside=2 * Q)], ("a", "b"), first=3)
    for j in range(2):
        solid, dashed = lines(ax, color=sheet.colour(3 + j))
        assert_allclose(solid, np.column_stack([T, Q[:, j]]))
        assert_allclose(dashed, np.column_stack([T, 2 * Q[:, j]]))
    assert legend(ax) == ["a", "b"] and ax.get_ylabel() == "q [rad]"


@pytest.mark.parametrize(("values", "found"), [(Q, [-5, 5]), (Q + 3, [5]), (0 * Q, [5])])
def test_a_limit_has_two_signs_where_the_values_have(values, found):
    assert levels(traces(T, [Panel("tau [Nm]", values, limit=5.0)])[0]) == found
    assert levels(traces(T, [Panel("tau [Nm]", values, limit=np.inf)])[0]) == []


def test_events_stand_in_every_panel_and_their_words_in_the_lowest():
    axes = traces(T, [Panel("q [rad]", Q), Panel("v [rad/s]", Q[:, 0])], events=((0.4, "touch"), (1.9, "lift")))
    assert [uprights(ax) for ax in axes] == [[0.4, 1.9]] * 2
    assert [words(ax) for ax in axes] == [[], ["touch", "lift"]]
    assert [ax.get_xlabel() for ax in axes] == ["", "t [s]"]


def test_the_two_kinds_of_line_are_named_in_the_legend_or_below_where_it_is_full():
    few = traces(T, [Panel("q", Q)], ("a", "b"), said=("nonlinear", "linear"))[0]
    assert legend(few) == ["a", "b", "nonlinear", "linear"]
    many = traces(T, [Panel("q", np.tile(Q, 2))], ("a", "b", "c", "d"), said=("nonlinear", "linear"))[0]
    assert legend(many) == ["a", "b", "c", "d"] and words(many) == ["solid: nonlinear, dashed: linear"]


@pytest.mark.parametrize("count", [0, 5])
def test_no_panel_or_more_than_four_are_refused(count):
    with pytest.raises(BadArgument) as why:
        traces(T, [Panel("q", Q)] * count)
    assert (why.value.argument, why.value.got) == ("panels", count)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_panels_stand_one_above_the_other_and_only_what_is_asked_is_logarithmic(count):
    axes = traces(T, [Panel("q", Q + 2, log=i == 1) for i in range(count)])
    assert len(axes) == count and [ax.get_yscale() == "log" for ax in axes] == [i == 1 for i in range(count)]
    heights = [ax.get_position().y0 for ax in axes]
    assert heights == sorted(heights, reverse=True)


def test_curves_are_drawn_by_name_over_the_parameter_with_their_limit():
    x = np.geomspace(1, 1e4, 9)
    ax = curves(x, (("torque", 1 / x), ("force", 2 / x)), xlabel="stiffness [N/m]", ylabel="phase [deg]", log="x", limit=0.5)
    for j, y in enumerate((1 / x, 2 / x)):
        assert_allclose(lines(ax, color=sheet.colour(j))[0], np.column_stack([x, y]))
    assert levels(ax) == [0.5] and legend(ax) == ["torque", "force"]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
