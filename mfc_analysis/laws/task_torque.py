"""Motion control with torque inputs in tool space: equation 9.16."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.joint_torque import check_mass, mass_matrix
from mfc_analysis.laws.law import Action, Measured, Tap, ToolLaw, ToolReference, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.dual import Vector, matvec
from mfc_analysis.maths.se3 import Pose, bracket, log_rate
from mfc_analysis.robots.primitives import Primitives


def tool_acceleration(
    E: Pose, X_e: Vector, V: Vector, ref: ToolReference, kp: Gain, ki: Gain, kd: Gain, z: Vector | None, *, printed: bool
) -> Vector:
    r"""The commanded tool acceleration inside 9.16 and 9.24, (..., 6) in the tool frame, E = X^-1 X_d.

    Standard: d/dt([Ad_E] V_d) + Kp X_e + Ki z + Kd V_e with V_e = [Ad_E] V_d - V and
    d/dt([Ad_E] V_d) = [Ad_E] V_d' - ad(V) [Ad_E] V_d. Printed: V_d' and X_e' = d log6(E)/dt instead.
    """
    V_d = E.adjoint(ref.V)
    V_e = V_d - V
    if printed:
        X_e_dot = log_rate(X_e, E.inverse().adjoint(V_e))
        return ref.dV + kp @ X_e + ki @ z + kd @ X_e_dot
    return E.adjoint(ref.dV) - bracket(V, V_d) + kp @ X_e + ki @ z + kd @ V_e


@define
class TaskComputedTorque(ToolLaw):
    r"""Computed torque in tool space: equation 9.16.

    .. math:: \tau = J_b^T\,(\hat\Lambda(\tfrac{d}{dt}([Ad]V_d) + K_p X_e + K_i \int X_e + K_d V_e) + \hat\eta)

    computed as tau = M^ (J^#(command - J' v) + null-space damping) + h^, which is equal for a square J and also holds for
    redundant arms. ``form="printed"``: V_d' and X_e' as printed; on a moving path they differ at first (X_e') and second order.

    Args:
        kp: [1/s^2], ki: [1/s^3], kd: [1/s]; scalar, (6,) or (6, 6) on (linear, angular) in the tool frame.
        mass: a constant (n, n) joint mass matrix [kg m^2] instead of M^(q).
        null_damping: [1/s] on joint motion that does not move the tool (redundant arms).
        damping: [-] of the inverse of J; 0: raises NearSingular near a singularity.

    Closed form: with an exact model and scalar gains, six times s^3 + kd s^2 + kp s + ki in error coordinates (X_e, V_e, z).
    """

    kp: Gain
    ki: Gain = Gain()
    kd: Gain = Gain()
    form: Literal["standard", "printed"] = "standard"
    mass: ArrayLike | None = None
    null_damping: float = 0.0
    damping: float = 0.0
    equation = "9.16"
    opens_at = ("torque", "command", "position")
    forms = ("standard", "printed")
    typst = 'tau = J_b^top (hat(Lambda) (dif/(dif t)(["Ad"] "V"_d) + K_p X_e + K_i integral X_e dif t + K_d "V"_e) + hat(eta))'
    units = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s"}

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)
        checks.number("null_damping", self.null_damping, low=0.0)
        checks.number("damping", self.damping, low=0.0)
        if self.mass is not None:
            object.__setattr__(self, "mass", mass_matrix(self.mass))

    def check(self, n: int) -> None:
        """Raise BadArgument unless gains (6) and mass (n, n) fit."""
        super().check(n)
        check_mass(self.mass, n)

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """tau = M^ (J^#(A - J' v) - null_damping (1 - J^# J) v) + h^."""
        E = model.pose(now.q).inverse() @ ref.X
        X_e, V = E.log(), model.jacobian(now.q, now.v)
        command = tap("command", tool_acceleration(E, X_e, V, ref, self.kp, self.ki, self.kd, now["z"], printed=self.form == "printed"))
        a = model.solve_jacobian(now.q, command - model.jacobian_dot(now.q, now.v), self.damping)
        if self.null_damping:
            a = a - self.null_damping * (now.v - model.solve_jacobian(now.q, V, self.damping))
        rates = {"z": X_e} if self.ki else {}
        if self.mass is None:
            return Action(model.inverse_dynamics(now.q, now.v, a), rates, X_e)
        return Action(matvec(np.asarray(self.mass), a) + model.bias(now.q, now.v), rates, X_e)
