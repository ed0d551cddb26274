"""How near a Jacobian is to singular: the condition number of the worst point, and what the laws make of it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.errors import MfcWarning, NearSingular
from mfc_analysis.maths.roots import root_between
from mfc_analysis.robots.singularity import REFUSE_CONDITION, WARN_CONDITION, check_regular, nearest_singular
from tests.conftest import arm, regular_pose


def test_the_worst_point_is_that_of_the_largest_condition_number_not_of_the_smallest_singular_value() -> None:
    sigma = np.array([[1.0, 0.01], [1000.0, 0.1], [3.0, 2.0]])  # condition numbers 100, 10000, 1.5
    found = nearest_singular("tool", sigma)
    assert (found.index, found.frame, found.time) == (1, "tool", None)
    assert (found.sigma_min, found.condition) == (0.1, pytest.approx(1e4))


def test_points_are_counted_through_whatever_their_shape() -> None:
    sigma = np.ones((2, 3, 4))
    sigma[1, 2, -1] = 0.5
    found = nearest_singular("tool", sigma)
    assert (found.index, found.condition) == (5, 2.0)
    assert nearest_singular("tool", sigma[1, 2]).index == 0


def test_a_singular_point_has_an_infinite_condition_number_and_is_the_worst() -> None:
    with np.errstate(all="raise"):
        found = nearest_singular("tool", np.array([[1.0, 1e-12], [0.0, 0.0], [1.0, 1.0]]))
    assert (found.index, found.sigma_min, found.condition) == (1, 0.0, np.inf)


def test_a_robot_tells_the_condition_number_that_numpy_has_of_its_jacobian() -> None:
    robot, q = arm("ur5"), regular_pose("ur5")
    J = robot.jacobian(q)
    assert nearest_singular(robot.tool, np.linalg.svd(J, compute_uv=False)).condition == pytest.approx(np.linalg.cond(J), rel=1e-9)


def test_a_jacobian_warns_above_one_condition_number_and_is_refused_above_another() -> None:
    def of(condition: float) -> np.ndarray:
        return np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1.0 / condition])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_regular("tool", of(0.99 * WARN_CONDITION))
        check_regular("tool", np.zeros((0, 6, 6)))
    with pytest.warns(MfcWarning, match="frame 'tool' is close to singular"):
        check_regular("tool", of(1.01 * WARN_CONDITION))
    with pytest.raises(NearSingular), warnings.catch_warnings(action="ignore"):
        check_regular("tool", np.stack([np.eye(6), of(1.01 * REFUSE_CONDITION)]))
    with pytest.raises(NearSingular):
        check_regular("tool", np.eye(6)[:, :5])


def wrist_at(condition: float) -> np.ndarray:
    """A pose of the UR5 whose wrist is so nearly straight that its Jacobian has this condition number."""
    q = regular_pose("ur5")

    def bent(log_q5: float) -> np.ndarray:
        return np.array([*q[:4], np.exp(log_q5), q[5]])

    return bent(root_between(lambda x: float(np.log(np.linalg.cond(arm("ur5").jacobian(bent(x))) / condition)), np.log(1e-8), np.log(0.1)))


def linearized(condition: float) -> mfc.Linearization:
    robot, q = arm("ur5"), wrist_at(condition)
    return mfc.ClosedLoop(robot, mfc.laws.TaskVelocity(4.0), mfc.trajectories.ToolHold(robot.pose(q)), q_start=q).linearize([0.0])


def test_a_loop_warns_between_the_two_limits_and_is_refused_above_the_second() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linearized(0.9 * WARN_CONDITION)
    for condition in (1.1 * WARN_CONDITION, 0.9 * REFUSE_CONDITION):
        with pytest.warns(MfcWarning):
            linearized(condition)
    with pytest.raises(NearSingular) as caught:
        linearized(1.1 * REFUSE_CONDITION)
    assert caught.value.condition == pytest.approx(1.1 * REFUSE_CONDITION, rel=1e-3)  # of a number that is the difference of two near ones
