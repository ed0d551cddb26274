"""Motion control with torque inputs in tool space: equation 9.16."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.joint_torque import acceleration_of, check_mass, mass_matrix
from mfc_analysis.laws.law import Action, Measured, Tap, ToolLaw, ToolReference, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, matvec
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.tool_task import ToolTask


def tool_acceleration(task: ToolTask, V: Vector, kp: Gain, ki: Gain, kd: Gain, z: Vector | None, *, printed: bool) -> Vector:
    r"""The commanded tool acceleration inside 9.16 and 9.24 at the twist V of the tool, (..., 6) in the tool frame, or its selected directions.

    Standard: d/dt([Ad_E] V_d) + Kp X_e + Ki z + Kd V_e with V_e = [Ad_E] V_d - V and
    d/dt([Ad_E] V_d) = [Ad_E] V_d' - ad(V) [Ad_E] V_d. Printed: V_d' and X_e' = d log6(E)/dt instead.
    """
    if printed:
        return task.selected(task.dV_d) + kp @ task.error + ki @ z + kd @ task.error_rate(V)
    return task.feedforward(V) + kp @ task.error + ki @ z + kd @ (task.carried - task.through(V))


def tool_torque(
    model: Primitives, task: ToolTask, v: Vector, V: Vector, command: Vector, damping: float, null_damping: float, mass: Array | None = None,
    inverse: str = "dynamic",
) -> Vector:  # fmt: skip
    """(..., n) the torque for the tool acceleration ``command`` (..., k) at joint velocity v and twist V: A^T Lambda^ (...) + h^ of 9.16."""
    wanted = command - task.through(model.jacobian_dot(task.q, v)) + null_damping * task.through(V)
    a = -null_damping * v
    pushed: Vector = 0.0
    if inverse == "dynamic" and model.n > task.size:
        pushed = task.torque(task.mass(wanted, damping, mass))
    else:
        a = a + task.solve(wanted, damping)
    return (model.inverse_dynamics(task.q, v, a) if mass is None else matvec(mass, a) + model.bias(task.q, v)) + pushed


@define
class TaskComputedTorque(ToolLaw):
    r"""Computed torque in tool space: equation 9.16.

    .. math:: \tau = J_b^T\,(\hat\Lambda(\tfrac{d}{dt}([Ad]V_d) + K_p X_e + K_i \int X_e + K_d V_e) + \hat\eta)
        + N^T(\hat h - c\,\hat M v), \quad N = 1 - \bar J J, \quad \bar J = \hat M^{-1} J^T \hat\Lambda

    The last term is 0 for a square J. On a redundant arm, and with ``axes`` on an arm of more joints than selected directions (J is then S J),
    it is what the page leaves open: the self-motion N v. Its bias is compensated, so that all of h^ is, and it is damped by c = ``null_damping``.

    Args:
        kp: [1/s^2], ki: [1/s^3], kd: [1/s]; scalar, (6,) or (6, 6) on (linear, angular) in the tool frame; (k,) or (k, k) on k selected directions.
        form: "standard"; "printed": V_d' and X_e' as on the page, which on a moving path differ at first (X_e') and second order.
        mass: a constant (n, n) joint mass matrix [kg m^2] as M^ instead of M^(q).
        null_damping: c >= 0 [1/s] on joint motion that does not move the tool (redundant arms). With an exact model that motion
            decays as exp(-c t) at rest; 0: it has no damping and drifts.
        damping: [-] of the inverse of J; 0: raises NearSingular near a singularity. See ``inverse``.
        inverse: how a redundant arm shares a tool acceleration among its joints; without effect where it has a joint for each direction and no more.
            "dynamic": as above, with the least kinetic energy; J (M^)^-1 N^T = 0, so no null-space torque accelerates the tool.
            "euclidean": tau = M^ (J^# (command - J' v) - c (1 - J^# J) v) + h^ with the Moore-Penrose J^#, the least squares of joint accelerations
            (radians and metres alike).
        axes: the directions of the tool that are controlled, None: all six. "xyz", "xyzrz", or orthonormal rows S (k, 6) that select components
            of the twist V_b and of X_e, (linear, angular) in the tool frame; k is at most the number of joints. Rows without rotations control the
            position alone, X_e = S R^T (p_d - p), whatever the orientation. Of fewer than six directions V_e is the rate of X_e.
        anti_windup: time constant T [s] of back-calculation, where a torque limit of the hardware cuts the torque: z' = X_e + Ki^-1 J (M^)^-1 lost
            / T, lost = sat(tau) - tau. None: the integral winds up. It acts only while a torque saturates, so not in the linear model of a loop
            whose torques do not.

    With ``damping`` the inverse of J is J^T (J J^T + damping^2)^-1; in the dynamic form of a redundant arm Lambda^ is (J (M^)^-1 J^T + damping^2 n
    / trace(M^))^-1. The two are the same where M^ is a multiple of 1, and the damping does not change if the arm is heavier by a factor.
    It weakens the command everywhere: by the factor s^2 / (s^2 + damping^2) along a direction of J with the singular value s.

    Closed form, with an exact model and scalar gains: six times s^3 + kd s^2 + kp s + ki in error coordinates (X_e, V_e, z), with ``axes`` k times.
    Of fewer than six directions X_e'' + Kd X_e' + Kp X_e + Ki z = 0 exactly, however large the error is.
    """

    kp: Gain
    ki: Gain = Gain()
    kd: Gain = Gain()
    form: Literal["standard", "printed"] = "standard"
    mass: ArrayLike | None = None
    null_damping: float = 0.0
    damping: float = 0.0
    inverse: Literal["dynamic", "euclidean"] = "dynamic"
    axes: Any = None
    anti_windup: float | None = None
    equation = "9.16"
    opens_at = ("torque", "command", "position")
    forms = ("standard", "printed")
    typst = 'tau = J_b^top (hat(Lambda) (dif/(dif t)(["Ad"] "V"_d) + K_p X_e + K_i integral X_e dif t + K_d "V"_e) + hat(eta))'
    units = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s"}

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)
        checks.number("null_damping", self.null_damping, low=0.0)
        object.__setattr__(self, "inverse_damping", checks.number("damping", self.damping, low=0.0))
        checks.choice("inverse", self.inverse, ("dynamic", "euclidean"))
        if self.mass is not None:
            object.__setattr__(self, "mass", mass_matrix(self.mass))
        self.select()
        self.check_anti_windup()

    def lost_command(self, model: Primitives, now: Measured, ref: ToolReference, lost: Vector) -> Vector:
        """J (M^)^-1 lost: the acceleration of the tool that is lost."""
        a = acceleration_of(model, now.q, lost, self.mass)
        return self.task(model, now.q, ref).through(model.jacobian(now.q, a))

    def check(self, n: int) -> None:
        """Raises BadArgument unless gains (6, or one for each selected direction) and mass (n, n) fit."""
        super().check(n)
        check_mass(self.mass, n)

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """tau = J^T Lambda^ (A - J' v + c V) + h^ - c M^ v, or M^ (J^# (A - J' v + c V) - c v) + h^; A the command, c the null-space damping."""
        q, v, mass = now.q, now.v, None if self.mass is None else np.asarray(self.mass)
        task, V = self.task(model, q, ref), model.jacobian(q, v)
        command = tap("command", tool_acceleration(task, V, self.kp, self.ki, self.kd, now["z"], printed=self.form == "printed"))
        tau = tool_torque(model, task, v, V, command, self.damping, self.null_damping, mass, self.inverse)
        return Action(tau, {"z": task.error} if self.ki else {}, task.error)
