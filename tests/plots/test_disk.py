"""Floquet multipliers in the unit circle, and the disc of gains and phases."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.plots import disk, figure as sheet, multipliers
from tests.plots.drawn import lines, marks, uprights, words


def test_multipliers_inside_and_outside_the_circle_have_two_colours():
    values = np.array([0.5, 0.3 + 0.2j, 0.3 - 0.2j, -1.01, 1.0])
    ax = multipliers(values)
    inside, outside = marks(ax, "x")
    assert_allclose(inside, [[0.5, 0], [0.3, 0.2], [0.3, -0.2]])
    assert_allclose(outside, [[-1.01, 0], [1.0, 0]])  # on the circle nothing decays
    assert len(lines(ax, color=sheet.BAD)[0]) == 2


def test_the_largest_multiplier_is_named_with_its_angle_and_inside_the_window():
    ax = multipliers([0.2, 3.0j])
    assert words(ax) == ["largest 3 at 90°"]
    assert ax.get_ylim()[1] > 3.0 and ax.texts[0].get_color() == sheet.BAD
    assert multipliers([0.2, 0.4]).texts[0].get_color() == sheet.INK
    assert words(multipliers([])) == []


@pytest.mark.parametrize("alpha", [0.3, 0.9, 1.6])
def test_the_disc_has_its_ends_on_the_real_axis_and_its_phase_on_the_unit_circle(alpha):
    low, high = (2 - alpha) / (2 + alpha), (2 + alpha) / (2 - alpha)  # the symmetric disk margin
    phase = 2 * np.degrees(np.arctan(alpha / 2))
    ax = disk((low, high), phase, alpha=alpha)
    edge = ax.patches[0].get_xy()
    assert_allclose([edge[:, 0].min(), edge[:, 0].max()], [low, high], rtol=1e-3)
    rays = [line[1] for line in lines(ax, color=sheet.INK) if len(line) == 2]
    centre, radius = (low + high) / 2, (high - low) / 2
    assert_allclose(np.hypot(*(np.array(rays) - [centre, 0]).T), radius, rtol=1e-9)  # circle, ray and unit circle meet
    assert words(ax)[0].startswith(f"α = {alpha:g}: gain ")


def test_a_disc_without_upper_end_is_all_to_the_right():
    ax = disk((0.0, np.inf), 90.0, alpha=2.0)
    assert "gain 0 to any, ±90°" in words(ax)[0]
    assert uprights(ax) == [0.0]
