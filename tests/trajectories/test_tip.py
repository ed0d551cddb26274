"""The directions of a tool path that joints follow: all six, or those of a selection."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.maths.se3 import inverse, log6
from mfc_analysis.robots.robot import Robot
from mfc_analysis.robots.tool_task import Selection
from mfc_analysis.trajectories.tip import SelectedTip, Tip
from mfc_analysis.trajectories.tool import ToolSinusoid
from tests.conftest import arm, regular_pose
from tests.robots.arms import SCARA

Q = np.array([0.4, 0.9, -0.1, 0.3])


@pytest.mark.parametrize("axes", ["xyz", "xyzrz"])
def test_a_tip_has_the_error_of_its_directions_and_the_rates_of_its_path(axes: str) -> None:
    robot, q, h = arm("ur5"), regular_pose("ur5") + 0.02, 1e-5
    ref = ToolSinusoid(robot.pose(regular_pose("ur5")), [0.02, 0.01, 0.03], 2.0, angle=0.1)
    tip, selection = SelectedTip(robot, Selection(axes)), Selection(axes)
    E = inverse(robot.pose(q)) @ ref(0.3).X
    assert_allclose(tip.error(q, ref(0.3).X), E[:3, 3] if axes == "xyz" else log6(E)[[0, 1, 2, 5]], atol=1e-14)
    assert tip.size == len(selection.rows) == tip.jacobian(q, ref(0.3).X).shape[0]
    still = (tip.error(q, ref(0.3 + h).X) - tip.error(q, ref(0.3 - h).X)) / (2 * h)  # with the joints at rest
    assert_allclose(tip.velocity(q, ref(0.3)), still, atol=1e-9)
    v = np.linalg.pinv(tip.jacobian(q, ref(0.3).X)) @ tip.velocity(q, ref(0.3))
    wanted, rate = tip.acceleration(q, v, ref(0.3))
    ahead, behind = (tip.jacobian(q + s * v, ref(0.3 + s).X) for s in (h, -h))
    assert_allclose(rate, (ahead - behind) / (2 * h), atol=1e-7)
    speeds = [tip.velocity(q + s * v, ref(0.3 + s)) for s in (h, -h)]
    assert_allclose(wanted + rate @ v, (speeds[0] - speeds[1]) / (2 * h), atol=1e-6)  # what is left after A' v is A a


def test_the_whole_tip_of_an_arm_is_its_jacobian_and_log() -> None:
    robot = Robot.from_urdf(SCARA)
    tip, X = Tip(robot), robot.pose(Q + 0.1)
    assert_allclose(tip.error(Q, X), log6(inverse(robot.pose(Q)) @ X))
    assert tip.size == 6
    assert_allclose(tip.jacobian(Q, X), robot.jacobian(Q))
