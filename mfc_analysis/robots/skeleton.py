"""The arm as a chain of points (base, joints and tool), for drawings."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.robot import Robot


def skeleton(robot: Robot, q: ArrayLike) -> Array:
    """(..., n + 2, 3) [m] world positions of the base, of each joint in Pinocchio's order, and of the tool, at angles q (..., n).

    Raises BadArgument for another shape.
    """
    x = robot.configuration(q)
    data = robot.model.createData()
    out = np.zeros((*x.shape[:-1], robot.n + 2, 3))
    for i in np.ndindex(x.shape[:-1]):
        pin.forwardKinematics(robot.model, data, x[i])
        for j in range(1, robot.n + 1):
            out[i][j] = data.oMi[j].translation
        out[i][-1] = pin.updateFramePlacement(robot.model, data, robot.frame_id).translation
    return out
