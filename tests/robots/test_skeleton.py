"""The arm as a chain of points: closed forms, the tool's pose, and lengths that no motion changes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument
from mfc_analysis.robots import planar_2r, rp
from mfc_analysis.robots.skeleton import skeleton
from tests.conftest import arm, regular_pose, seed


def test_a_planar_arm_has_its_elbow_and_hand_where_trigonometry_says() -> None:
    robot = planar_2r()
    straight = skeleton(robot, [0.0, 0.0])
    upper, fore = (float(np.linalg.norm(straight[i + 1] - straight[i])) for i in (1, 2))
    a, b = 0.4, -1.1
    elbow = upper * np.array([np.cos(a), np.sin(a)])
    hand = elbow + fore * np.array([np.cos(a + b), np.sin(a + b)])
    assert upper > 0.1 and fore > 0.1
    assert_allclose(skeleton(robot, [a, b])[:, :2], [[0, 0], [0, 0], elbow, hand], atol=1e-12)


def test_the_tool_of_the_rp_arm_slides_along_its_turned_axis() -> None:
    theta, d = 0.7, 1.3
    assert_allclose(skeleton(rp(), [theta, d])[-1], [d * np.cos(theta), d * np.sin(theta), 0.0], atol=1e-12)


@pytest.mark.parametrize("name", ["planar_2r", "ur5"])
def test_the_chain_begins_at_the_base_and_ends_at_the_tool(name: str) -> None:
    robot, q = arm(name), regular_pose(name)
    points = skeleton(robot, q)
    assert points.shape == (robot.n + 2, 3) and not points[0].any()
    assert_allclose(points[-1], robot.pose(q)[:3, 3], atol=1e-12)


def test_turning_joints_change_no_length_between_neighbours() -> None:
    poses = np.stack([regular_pose("ur5", i) for i in range(5)])
    lengths = np.linalg.norm(np.diff(skeleton(arm("ur5"), poses), axis=1), axis=2)
    assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-12)


def test_many_poses_at_once_are_those_one_by_one_in_any_shape() -> None:
    q = seed("skeleton").uniform(-1, 1, (2, 3, 2))
    many = skeleton(planar_2r(), q)
    assert many.shape == (2, 3, 4, 3)
    for i in np.ndindex(2, 3):
        assert np.array_equal(many[i], skeleton(planar_2r(), q[i]))


@pytest.mark.parametrize("wrong", [[0.0], [0.0, 0.0, 0.0], [0.0, np.nan]])
def test_a_position_of_another_shape_or_not_finite_is_refused(wrong: list[float]) -> None:
    with pytest.raises(BadArgument) as why:
        skeleton(planar_2r(), wrong)
    assert why.value.argument == "q"
