"""Step responses: the linear one, the nonlinear one over it, and the torque below."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.plots import figure as sheet, responses, step
from tests.plots.drawn import legend, levels, lines, words

T = np.linspace(0, 1, 11)
Y = 1 - np.exp(-5 * T)


def test_both_responses_and_the_torque_are_drawn_as_given():
    fine = np.linspace(0, 1, 101)
    upper, lower = step(T, Y, nonlinear=(fine, fine**2), torque=(fine, -fine), index=2)
    assert_allclose(lines(upper, color=sheet.colour(2))[0], np.column_stack([T, Y]))
    assert_allclose(lines(upper, style="--")[0], np.column_stack([fine, fine**2]))
    assert_allclose(lines(lower, color=sheet.colour(2))[0], np.column_stack([fine, -fine]))
    assert legend(upper) == ["linear", "nonlinear"] and upper.get_xlim() == lower.get_xlim() == (0, 1)


def test_without_a_torque_there_is_one_panel():
    (ax,) = step(T, Y)
    assert ax.figure.axes == [ax] and not words(ax) and not legend(ax) and ax.get_xlabel() == "t [s]" and len(lines(ax)) == 1


def test_responses_along_a_path_are_grey_and_the_worst_has_a_colour():
    y = np.stack([Y, 0.5 * Y, 0 * Y])
    ax = responses(T, y, worst=1, worst_time=0.25)
    assert_allclose(np.array(lines(ax, color=sheet.GREY))[:, :, 1], y)
    assert_allclose(lines(ax, color=sheet.colour(0))[0][:, 1], y[1])
    assert legend(ax) == ["t = 0.25 s"]


def test_the_target_has_its_settling_band_and_the_torque_both_limits():
    upper, lower = step(T, Y, torque=(T, -T), target=1.0, band=0.02, torque_limit=40.0)
    assert levels(upper) == [1.0] and levels(lower) == [-40.0, 40.0]
    (band,) = upper.patches
    box = band.get_extents().transformed(upper.transData.inverted())
    assert_allclose([box.y0, box.y1], [0.98, 1.02])
    assert levels(step(T, Y, torque=(T, -T), torque_limit=np.inf)[1]) == []


def test_the_axes_say_quantity_and_unit():
    upper, lower = step(T, Y, torque=(T, T), quantity="X_e [m]", drive="u [rad/s]", title="Joint 3")
    assert (upper.get_ylabel(), lower.get_ylabel(), lower.get_xlabel()) == ("X_e [m]", "u [rad/s]", "t [s]")
    assert upper.get_title(loc="left") == "Joint 3"


def test_axes_of_ones_own_are_drawn_on():
    own = sheet.panels_for("step")
    assert step(T, Y, torque=(T, T), axes=own) == own and len(own[0].get_lines()) == 1
