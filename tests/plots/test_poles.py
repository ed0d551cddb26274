"""Pole maps: every pole at its place, colours by side, rays of equal damping, all of it inside the window."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.plots import figure as sheet, poles
from tests.plots.drawn import lines, marks


def coloured(ax, color: str) -> np.ndarray:
    found = [x for x in ax.get_lines() if x.get_marker() == "x" and x.get_color() == color]
    return np.concatenate([np.column_stack([x.get_xdata(), x.get_ydata()]) for x in found])


def test_poles_on_the_two_sides_have_two_colours_and_the_axis_counts_as_unstable():
    ax = poles(np.array([-2.0, -1 + 3j, -1 - 3j, 0.5, 2j, -2j]), index=1)
    assert_allclose(coloured(ax, sheet.colour(1)), [[-2, 0], [-1, 3], [-1, -3]])
    assert_allclose(coloured(ax, sheet.BAD), [[0.5, 0], [0, 2], [0, -2]])


def test_sampled_poles_are_judged_by_the_unit_circle():
    ax = poles(np.array([0.9, -1.1, 1.0, 0.6 + 0.7j]), discrete=True)
    assert_allclose(coloured(ax, sheet.colour(0)), [[0.9, 0], [0.6, 0.7]])
    assert_allclose(coloured(ax, sheet.BAD), [[-1.1, 0], [1, 0]])
    circle = lines(ax, color=sheet.INK)[0]
    assert_allclose(np.hypot(*circle.T), 1)
    assert ax.get_xlabel() == "Re z" and poles([-1.0]).get_xlabel() == "Re s [1/s]"


@pytest.mark.parametrize("damping", [0.2, 0.5, 1.0])
def test_a_required_damping_is_a_dashed_ray_on_which_poles_of_it_lie(damping):
    rays = lines(poles([-1 + 1j, -1 - 1j], damping=damping), style="--")
    assert len(rays) == 2
    for ray in rays:
        out = ray[1:]
        assert_allclose(-out[:, 0] / np.hypot(*out.T), damping, rtol=1e-12)
    assert len(lines(poles([-1.0]), style=":")) == 4 and not lines(poles([-1.0]), style="--")


@pytest.mark.parametrize("values", [[-3.0], [-1e-6, -1e6 + 1e6j, -1e6 - 1e6j], [40.0, -0.01], [0.0, 0.0], [-2 + 500j, -2 - 500j]])
def test_every_pole_lies_in_the_window(values):
    s = np.asarray(values, complex)
    ax = poles(s)
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert (left < s.real).all() and (s.real < right).all() and (low < s.imag).all() and (s.imag < high).all()
    assert left < 0 < right and low < 0 < high


def test_poles_of_other_times_are_small_points_and_widen_the_window():
    path = np.array([[-1.0, -2.0], [-300.0, 5.0]])
    ax = poles([-1.0, -2.0], path=path)
    assert_allclose(marks(ax, ".")[0][:, 0], path.ravel())
    assert ax.get_xlim()[0] < -300 and ax.get_xlim()[1] > 5


def test_tick_labels_are_few_and_have_zero():
    ticks = poles([-1e-5, -1.0, -1e6 + 2e6j, -1e6 - 2e6j]).get_xticks()
    assert 0.0 in ticks and 2 <= len(ticks) <= 6
