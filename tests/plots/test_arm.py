"""The arm as sticks: the view in which it moves most, the worst pose on top, a square window around all of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import arm, figure as sheet
from tests.plots.drawn import lines, words


def path(spread: tuple[float, float, float], m: int = 20) -> np.ndarray:
    """(m, 4, 3) positions that cover these lengths along x, y and z."""
    points = np.random.default_rng(0).uniform(0, 1, (m, 4, 3))
    points[0, 0], points[-1, -1] = 0.0, 1.0
    return points * np.array(spread)


@pytest.mark.parametrize(("spread", "plane"), [((1.0, 0.1, 0.5), "xz"), ((1.0, 0.6, 0.2), "xy"), ((0.1, 0.7, 0.9), "yz")])
def test_the_widest_view_is_the_plane_that_the_arm_covers_most(spread, plane):
    ax = arm(path(spread))
    assert (ax.get_xlabel(), ax.get_ylabel()) == (f"{plane[0]} [m]", f"{plane[1]} [m]")


def test_sticks_are_the_points_in_the_plane_asked_for_at_seven_times_with_both_ends():
    points = path((1.0, 1.0, 1.0), 31)
    sticks = lines(arm(points, view="yz"), color=sheet.GREY)
    assert len(sticks) == 7
    for stick, i in zip(sticks, range(0, 31, 5), strict=True):
        assert_allclose(stick, points[i][:, 1:])


def test_few_poses_are_all_drawn_and_the_tools_path_is_dotted():
    points = path((1.0, 1.0, 0.2), 3)
    ax = arm(points, view="xy")
    assert len(lines(ax, color=sheet.GREY)) == 3
    assert_allclose(lines(ax, style=":")[0], points[:, -1, :2])


def test_the_worst_pose_is_drawn_in_its_colour_with_its_time():
    points = path((1.0, 0.5, 1.0))
    ax = arm(points, worst=13, worst_time=1.25, view="xz")
    (stick,) = lines(ax, color=sheet.BAD)
    assert_allclose(stick, points[13][:, [0, 2]])
    assert words(ax) == ["worst: t = 1.25 s"]
    assert words(arm(points, worst=0)) == ["worst"] and words(arm(points)) == []


def test_nothing_of_the_arm_is_outside_the_window_and_both_axes_have_one_scale():
    points = path((2.0, 0.1, 0.3)) + np.array([5.0, 0, -3.0])
    ax = arm(points, view="xz")
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    assert left < points[..., 0].min() and points[..., 0].max() < right
    assert low < points[..., 2].min() and points[..., 2].max() < high
    assert_allclose((high - low) / (right - left), 1.06)  # room for the words above


@pytest.mark.parametrize(("given", "argument"), [({"origins": np.zeros((4, 3))}, "origins"), ({"origins": np.zeros((4, 3, 2))}, "origins"),
                                                 ({"origins": np.zeros((4, 3, 3)), "view": "zx"}, "view")])  # fmt: skip
def test_another_shape_or_view_is_refused(given, argument):
    with pytest.raises(BadArgument) as why:
        arm(**given)
    assert why.value.argument == argument
