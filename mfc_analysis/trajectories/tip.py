"""How the joints follow a tool path: the error of the pose, its Jacobian, and the velocity and acceleration that the path asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.maths.se3 import Pose, adjoint, inverse, log6
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.tool_task import SelectedTask, Selection, selected_task
from mfc_analysis.trajectories.tool import ToolPoint

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


class Tip:
    """All six directions. q, v: (..., n)."""

    size = 6

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def error(self, q: Array, X: Array) -> Array:
        """(..., k) what the tool is away from the pose X (..., 4, 4) [m, rad]."""
        return log6(inverse(self.robot.pose(q)) @ X)

    def jacobian(self, q: Array, X: Array) -> Array:
        """(..., k, n) A: joint velocities to these directions."""
        return self.robot.jacobian(q)

    def velocity(self, q: Array, point: ToolPoint) -> Array:
        """(..., k) that the path asks for, with the tool on it."""
        return point.V

    def transported(self, q: Array, point: ToolPoint) -> Array:
        """(..., k) the same with the tool near the path."""
        V: Array = adjoint(inverse(self.robot.pose(q)) @ point.X) @ point.V[..., None]
        return V[..., 0]

    def acceleration(self, q: Array, v: Array, point: ToolPoint) -> tuple[Array, Array]:
        """(..., k) the joints' part A a of what the path asks for, and A' (..., k, n)."""
        J_rate = self.robot.jacobian_rate(q, v)
        return (point.dV[..., None] - J_rate @ v[..., None])[..., 0], J_rate


class SelectedTip(Tip):
    """The directions of a selection."""

    def __init__(self, robot: Robot, selection: Selection) -> None:
        super().__init__(robot)
        self.selection, self.size = selection, len(selection.rows)
        self.model = Primitives(robot)

    def _task(self, q: Array, X: Array, V: Array, dV: Array) -> SelectedTask:
        return selected_task(self.selection, self.model, np.ascontiguousarray(q), Pose.of(X), V, dV)

    def error(self, q: Array, X: Array) -> Array:
        """(..., k)."""
        return value(self._task(q, X, np.zeros(6), np.zeros(6)).error)

    def jacobian(self, q: Array, X: Array) -> Array:
        """(..., k, n)."""
        return self._task(q, X, np.zeros(6), np.zeros(6)).A

    def velocity(self, q: Array, point: ToolPoint) -> Array:
        """(..., k)."""
        return value(self._task(q, *point).carried)

    transported = velocity

    def acceleration(self, q: Array, v: Array, point: ToolPoint) -> tuple[Array, Array]:
        """(..., k) and (..., k, n)."""
        task, J_rate = self._task(q, *point), self.robot.jacobian_rate(q, v)
        V, bias = self.model.jacobian(task.q, v), (J_rate @ v[..., None])[..., 0]
        return value(task.feedforward(V)) - value(task.through(bias)), task.rate_matrix(value(V), J_rate)
