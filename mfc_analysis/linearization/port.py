"""The port of a linearised loop: where an external wrench acts on the tool, or torques on the joints, and how they move."""

from __future__ import annotations

import numpy as np

from mfc_analysis.analysis.port import PortSystem
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import external
from mfc_analysis.laws.law import WRENCH
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array

PORTS = ("tool", "joints")


def port_system(equations: Equations, opened: OpenSystem, x: Array, at: str) -> PortSystem:
    """The port at the tool or at the joints of a loop opened in state coordinates at x (m, nx).

    A wrench F on the tool is the disturbance J^T F at the joints, and the force sensor, which measures what the robot applies, sees -F. The
    velocity of the port is that of the deviation: J q', at a Hold the body twist. Under a velocity law no force moves the plant: the force acts
    through the sensor only. Raises BadArgument for another port.
    """
    checks.choice("at", at, PORTS)
    one, n = opened if opened.held is None else opened.held, equations.n
    nu, ny, nw, m = one.nu, one.ny, one.nw, len(x)
    tool, torque = at == "tool", equations.actuator == "torque"
    if tool:
        J = np.asarray(equations.plant.at(np.ascontiguousarray(x[:, equations.parts["q"].where])).J, float)
    else:
        J = np.broadcast_to(np.eye(n), (m, n, n))
    first = external(equations).inputs.index(f"disturbance_{equations.robot.joint_names[0]}")
    push = slice(first, first + n)
    rates = equations.parts["q"].where
    J_T = np.swapaxes(J, 1, 2) if torque else np.zeros((m, n, J.shape[1]))
    B, D = one.B[:, :, push] @ J_T, one.D[:, ny:, push] @ J_T
    if tool and "force" in one.wires:
        D[:, one.wires["force"]] -= np.eye(6)
    names = WRENCH if tool else equations.robot.joint_names
    return PortSystem(opened, tuple(names), B, D, J @ one.A[:, rates], J @ one.B[:, rates, nu : nu + nw])
