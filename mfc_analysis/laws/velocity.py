"""Motion control with velocity inputs, q' = u: equations 9.1 to 9.5."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import Action, JointLaw, JointReference, Measured, Tap, ToolLaw, ToolReference, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.dual import Dual, Vector, concatenate
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.primitives import Primitives


class _JointVelocity(JointLaw):
    plant = "velocity"
    opens_at = ("velocity", "position")


@define
class VelocityFeedforward(_JointVelocity):
    r"""Open-loop velocity: equation 9.1, :math:`u = \dot q_d`.

    The page prints q_d for its derivative. The error is a pure integrator: it stays constant, and a velocity disturbance integrates.
    """

    equation = "9.1"
    typst = "u = dot(q)_d"

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """u = v_d."""
        return Action(ref.v + np.zeros(model.n), {}, ref.q - now.q)


@define
class VelocityP(_JointVelocity):
    r"""Proportional velocity feedback: equation 9.2, :math:`u = K_p e`, e = q_d - q.

    Args:
        kp: [1/s] scalar, (n,) or (n, n).

    Closed forms: pole -k, phase margin 90 deg, delay margin pi/(2k), error v/k on a ramp of slope v.
    """

    kp: Gain
    equation = "9.2"
    typst = "u = K_p e"
    units = {"kp": "1/s"}

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """u = Kp e."""
        e = ref.q - now.q
        return Action(np.zeros(model.n) + self.kp @ e, {}, e)


@define
class VelocityPI(_JointVelocity):
    r"""Proportional-integral velocity feedback: equation 9.3, :math:`u = K_p e + K_i \int e`.

    The page prints the integral without Ki (as if it were the identity).

    Args:
        kp: [1/s], ki: [1/s^2]; scalar, (n,) or (n, n).
        form: "standard", or "printed" as on the page.

    Closed forms: s^2 + kp s + ki; critical damping at ki = kp^2/4; error 0 on a ramp, a/ki on a parabola.
    """

    kp: Gain
    ki: Gain
    form: Literal["standard", "printed"] = "standard"
    equation = "9.3"
    forms = ("standard", "printed")
    typst = "u = K_p e + K_i integral e dif t"
    units = {"kp": "1/s", "ki": "1/s^2"}

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """u = Kp e + Ki z (printed: u = Kp e + z)."""
        e = ref.q - now.q
        ki = Gain("ki", 1.0) if self.form == "printed" else self.ki
        return Action(np.zeros(model.n) + self.kp @ e + ki @ now["z"], {"z": e} if ki else {}, e)


@define
class VelocityFeedforwardPI(_JointVelocity):
    r"""Feedforward with proportional-integral feedback: equation 9.4, :math:`u = \dot q_d + K_p e + K_i \int e`.

    Args:
        kp: [1/s], ki: [1/s^2]; scalar, (n,) or (n, n); None: no integral.

    Closed form: e'' + kp e' + ki e = 0 for any q_d.
    """

    kp: Gain
    ki: Gain = Gain()
    equation = "9.4"
    typst = "u = dot(q)_d + K_p e + K_i integral e dif t"
    units = {"kp": "1/s", "ki": "1/s^2"}

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """u = v_d + Kp e + Ki z."""
        e = ref.q - now.q
        return Action(ref.v + self.kp @ e + self.ki @ now["z"], {"z": e} if self.ki else {}, e)


@define
class TaskVelocity(ToolLaw):
    r"""Tool-space velocity control: equation 9.5, :math:`V_b = [Ad_{X^{-1}X_d}] V_d + K_p X_e + K_i \int X_e`.

    Joint rates by the inverse (pseudo-inverse) of J_b. X_e = log6(X^-1 X_d).

    Args:
        kp: [1/s], ki: [1/s^2]; scalar, (6,) or (6, 6), on (linear, angular) in the tool frame; (k,) or (k, k) on k selected directions.
        form: "standard"; "printed"; "no_adjoint". "printed": X_e = X_d - X as the page writes it, taken in the tool frame: the (linear, angular)
            part of X^-1 (X_d - X). Its angular part is sin(angle) times the axis. "no_adjoint": V_d without [Ad], a common mistake, which couples
            the error by -ad(V_d) X_e at first order.
        damping: [-] of the inverse of J; 0: raises NearSingular near a singularity.
        axes: the directions of the tool that are controlled, None: all six. "xyz", "xyzrz", or orthonormal rows S (k, 6) that select components
            of the twist V_b and of X_e, (linear, angular) in the tool frame; k is at most the number of joints. On an arm with more than k
            joints, the joint rates are the smallest ones. Rows without rotations control the position alone, X_e = S R^T (p_d - p).

    Closed form: for Kp = k I and no Ki, X_e' = -k X_e exactly, for any rotation below pi; of fewer than six directions for any Kp.
    """

    kp: Gain
    ki: Gain = Gain()
    form: Literal["standard", "printed", "no_adjoint"] = "standard"
    damping: float = 0.0
    axes: Any = None
    equation = "9.5"
    plant = "velocity"
    opens_at = ("velocity", "command", "position")
    forms = ("standard", "printed", "no_adjoint")
    typst = '"V"_b = ["Ad"_(X^(-1) X_d)] "V"_d + K_p X_e + K_i integral X_e dif t'
    units = {"kp": "1/s", "ki": "1/s^2"}

    def __post_init__(self) -> None:
        checks.choice("form", self.form, self.forms)
        object.__setattr__(self, "inverse_damping", checks.number("damping", self.damping, low=0.0))
        self.select()

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """q' = J^# (Ad V_d + Kp X_e + Ki z)."""
        task = self.task(model, now.q, ref)
        X_e = task.selected(difference(task.E)) if self.form == "printed" else task.error
        V_d = task.selected(ref.V) if self.form == "no_adjoint" else task.carried
        V = tap("command", V_d + self.kp @ X_e + self.ki @ now["z"])
        return Action(task.solve(V, self.damping), {"z": X_e} if self.ki else {}, X_e)


def difference(E: Pose) -> Vector:
    """The printed X_d - X in tool coordinates: the se(3) part of E - 1 with E = X^-1 X_d, (position, sin(angle) axis)."""
    R = E.R
    axis = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    if E.twist is None:
        return concatenate([E.p, axis])
    trace = np.trace(R, axis1=-2, axis2=-1)[..., None, None]
    return Dual(
        np.concatenate([E.p, axis], axis=-1),
        np.concatenate([R @ E.twist[..., :3, :], 0.5 * (trace * np.eye(3) - np.swapaxes(R, -1, -2)) @ E.twist[..., 3:, :]], axis=-2),
    )
