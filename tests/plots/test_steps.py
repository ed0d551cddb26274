"""Step responses: the linear one, the nonlinear one over it, and the torque below."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.plots import figure as sheet, step
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


def test_a_torque_that_is_not_recorded_is_said_not_drawn():
    upper, lower = step(T, Y)
    assert words(lower) == ["not recorded"] and not lines(lower) and legend(upper) == ["linear"]


def test_the_target_has_its_settling_band_and_the_torque_both_limits():
    upper, lower = step(T, Y, target=1.0, band=0.02, torque_limit=40.0)
    assert levels(upper) == [1.0] and levels(lower) == [-40.0, 40.0]
    (band,) = upper.patches
    box = band.get_extents().transformed(upper.transData.inverted())
    assert_allclose([box.y0, box.y1], [0.98, 1.02])
    assert levels(step(T, Y, torque_limit=np.inf)[1]) == []


def test_the_axes_say_quantity_and_unit():
    upper, lower = step(T, Y, quantity="X_e [m]", drive="u [rad/s]", title="Joint 3")
    assert (upper.get_ylabel(), lower.get_ylabel(), lower.get_xlabel()) == ("X_e [m]", "u [rad/s]", "t [s]")
    assert upper.get_title(loc="left") == "Joint 3"


def test_axes_of_ones_own_are_drawn_on():
    own = sheet.panels_for("step")
    assert step(T, Y, axes=own) == own and len(own[0].get_lines()) == 1
