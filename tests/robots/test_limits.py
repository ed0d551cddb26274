from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_array_equal

from mfc_analysis.errors import BadRobot
from mfc_analysis.robots.limits import limits_of
from mfc_analysis.robots.robot import Robot
from tests.robots.arms import CONTINUOUS, TWO


def test_limits_are_the_urdfs_and_infinite_where_it_has_none():
    limits = Robot.from_urdf(CONTINUOUS).limits
    assert_array_equal(limits.position, [[-np.inf, np.inf], [-2, 1.5]])
    assert_array_equal(limits.velocity, [3, 3])
    assert_array_equal(limits.torque, [10, 10])
    assert_array_equal(Robot.from_urdf(CONTINUOUS.replace('effort="10"', 'effort="0"')).limits.torque, [np.inf, np.inf])
    assert_array_equal(Robot.from_urdf(TWO.replace('lower="-2" upper="1.5"', "")).limits.lower, [-np.inf, -np.inf])


def test_the_limit_that_a_continuous_joint_lacks_is_infinite():
    limit = 'lower="-2" upper="1.5" effort="10" velocity="3"'
    limits = Robot.from_urdf(CONTINUOUS.replace(limit, 'velocity="4"', 1)).limits
    assert_array_equal([limits.velocity, limits.torque], [[4, 3], [np.inf, 10]])
    limits = Robot.from_urdf(CONTINUOUS.replace(limit, 'effort="5"', 1)).limits
    assert_array_equal([limits.velocity, limits.torque], [[np.inf, 3], [5, 10]])


def test_limits_come_in_the_users_order_and_read_only():
    found = limits_of(pin.buildModelFromXML(CONTINUOUS), np.array([1, 0]))
    assert_array_equal(found.position, [[-2, 1.5], [-np.inf, np.inf]])
    with pytest.raises(ValueError, match="read-only"):
        found.torque[0] = 1.0


@pytest.mark.parametrize(
    ("limit", "value", "says"),
    [
        ("lowerPositionLimit", 2.0, "joint 'j2': its lower limit 2 is not below its upper limit 1.5"),
        ("upperPositionLimit", np.nan, "joint 'j2': its lower limit -2 is not below its upper limit nan"),
        ("upperVelocityLimit", -1.0, "joint 'j2': its velocity limit -1 is not a number >= 0"),
        ("upperEffortLimit", np.nan, "joint 'j2': its effort limit nan is not a number >= 0"),
    ],
)
def test_a_model_with_an_impossible_limit_is_refused_by_joint(limit, value, says):
    model = pin.buildModelFromXML(TWO)
    values = np.array(getattr(model, limit))
    values[1] = value
    setattr(model, limit, values)
    with pytest.raises(BadRobot, match=says):
        Robot.from_pinocchio(model)
    assert Robot.from_pinocchio(model, tool="one", locked=["j2"]).n == 1
