"""Impedance control with torque inputs: the arm answers a force like a spring, a damper and, if asked, a mass of its own."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import WRENCH, Action, JointLaw, JointReference, Law, Measured, Tap, ToolLaw, ToolReference, define
from mfc_analysis.laws.task_torque import tool_torque
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, matvec
from mfc_analysis.robots.primitives import Primitives

SOURCES = (
    "Hogan, Impedance Control: An Approach to Manipulation, Journal of Dynamic Systems, Measurement, and Control, 1985",
    "Lynch & Park, Modern Robotics, section 11.7",
    "Siciliano et al., Robotics: Modelling, Planning and Control, sections 9.2 and 9.3",
)


def inertia_of(gain: Gain) -> None:
    """Raises BadArgument unless an inertia that is given is positive (definite)."""
    M = gain.array
    if M is not None and (np.any(M <= 0) if M.ndim < 2 else np.abs(M - M.T).max() > 1e-9 * np.abs(M).max() or np.linalg.eigvalsh(M)[0] <= 0):
        raise BadArgument(gain.name, M, "positive numbers, or a symmetric positive definite matrix")


def without_sensor(law: Law) -> None:
    """For ``__post_init__``: a law that does not feed the force back, and cannot be opened there."""
    object.__setattr__(law, "senses_force", False)
    object.__setattr__(law, "opens_at", tuple(point for point in law.opens_at if point != "force"))


@define
class Impedance(ToolLaw):
    r"""Impedance control in tool space, with the inertia of the arm or a chosen one.

    .. math:: \tau = J_b^T\,(K X_e + D V_e + F_d + \hat\Lambda\,(\tfrac{d}{dt}([Ad]V_d) - \dot J v)) + \hat h

    With ``inertia`` M_d the inertia is shaped, and the measured force fed back:

    .. math:: \tau = J_b^T\,(\hat\Lambda\,(V'_c - \dot J v) + F) + \hat h, \quad
        V'_c = \tfrac{d}{dt}([Ad]V_d) + M_d^{-1}(K X_e + D V_e - (F - F_d))

    X_e, V_e = [Ad] V_d - V and F_tip are in the tool frame, as in 9.16 and 9.19: F_tip is the wrench that the robot applies.

    Args:
        stiffness: K [N/m, Nm/rad], damping: D [Ns/m, Nm s/rad], inertia: M_d [kg, kg m^2]; scalar, (6,) or (6, 6) on (linear, angular) in the tool
            frame; (k,) or (k, k) on k selected directions. None: that of the arm, Lambda(q), and no force sensor.
        F_d: (6,) [N, Nm] a wrench that the tool presses with on top of the spring, tool frame; None: none.
        feedforward: False: without the terms of Lambda^, which need a J of full rank. The arm then does not follow a moving reference exactly.
        null_damping: c >= 0 [1/s] on joint motion that does not move the tool (redundant arms), as in 9.16.
        inverse_damping: [-] of the inverse of J in Lambda^; 0: raises NearSingular near a singularity. As ``damping`` of 9.16.
        axes: the directions of the tool that have the impedance, None: all six; as in 9.16.

    The wire "command" carries the wrench K X_e + D V_e + F_d, or V'_c with ``inertia``.

    Closed forms, with an exact model: Lambda V_e' + D V_e + K X_e = F_tip - F_d, and with inertia M_d V_e' + D V_e + K X_e = F_tip - F_d.
    One mass m on a spring k_e through a torque lag T: m T s^3 + m s^2 + (D + k_e T) s + K + k_e, stable iff D > T K, whatever the spring.

    Raises BadArgument: an inertia that is not positive definite, or an arm of fewer joints than directions where Lambda^ is needed.
    """

    stiffness: Gain
    damping: Gain
    inertia: Gain = Gain()
    F_d: ArrayLike | None = None
    feedforward: bool = True
    null_damping: float = 0.0
    inverse_damping: float = 0.0
    axes: Any = None
    equation = "impedance"
    opens_at = ("torque", "command", "position", "force")
    senses_force = True
    sources: ClassVar[tuple[str, ...]] = SOURCES
    typst = 'tau = J_b^top (K X_e + D "V"_e + "F"_d + hat(Lambda) (dif/(dif t)(["Ad"] "V"_d) - dot(J) v)) + hat(h)'
    units = {"stiffness": "N/m", "damping": "Ns/m", "inertia": "kg"}

    def __post_init__(self) -> None:
        if self.F_d is not None:
            object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))
        if not isinstance(self.feedforward, (bool, np.bool_)):
            raise BadArgument("feedforward", self.feedforward, "True or False")
        checks.number("null_damping", self.null_damping, low=0.0)
        checks.number("inverse_damping", self.inverse_damping, low=0.0)
        inertia_of(self.inertia)
        self.select()
        if not self.inertia:
            without_sensor(self)

    def check(self, n: int) -> None:
        """Raises BadArgument unless the gains fit and the arm has the joints that Lambda^ needs."""
        super().check(n)
        if n < 6 and self.selection is None and (self.feedforward or self.inertia):
            takes = "an arm of six joints or more, as Lambda needs a J of full rank; with fewer: axes=, or feedforward=False without an inertia"
            raise BadArgument("law", f"Impedance on {n} joints", takes)

    def command_channels(self, joints: tuple[str, ...]) -> tuple[str, ...]:
        """The components of the wrench, or with ``inertia`` the directions of the tool."""
        return self.error_channels(joints) if self.inertia or self.selection is not None else WRENCH

    @property
    def desired_wrench(self) -> Array | None:
        """(6,) F_d [N, Nm], tool frame."""
        return None if self.F_d is None else np.asarray(self.F_d, float)

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """tau = J^T (K X_e + D V_e + F_d) + J^T Lambda^ (d/dt([Ad] V_d) - J' v) + h^, or J^T (Lambda^ (V'_c - J' v) + F) + h^."""
        q, v = now.q, now.v
        task, V = self.task(model, q, ref), model.jacobian(q, v)
        c = self.null_damping if model.n > task.size else 0.0
        f = self.stiffness @ task.error + self.damping @ (task.carried - task.through(V)) + task.selected(ref.F_d)
        if self.inertia:
            given = matvec(self.inertia.inverse(task.size), f - task.selected(now.F))
            command = tap("command", task.feedforward(V) + given)
            pushed: Vector = model.jacobian_transpose(q, now.F)
        else:
            pushed = task.torque(tap("command", f))
            if not (self.feedforward or c):
                return Action(pushed + model.bias(q, v), {}, task.error)
            command = task.feedforward(V) if self.feedforward else task.through(model.jacobian_dot(q, v))
        return Action(tool_torque(model, task, v, V, command, self.inverse_damping, c) + pushed, {}, task.error)


@define
class JointImpedance(JointLaw):
    r"""Impedance control in joint space, with the inertia of the arm or a chosen one.

    .. math:: \tau = K e + D \dot e + \hat M(q)\,a_d + \hat h

    With ``inertia`` M_d the inertia is shaped, and the measured force of the tool fed back:

    .. math:: \tau = \hat M(q)\,(a_d + M_d^{-1}(K e + D \dot e - J^T F)) + J^T F + \hat h

    Args:
        stiffness: K [Nm/rad], damping: D [Nm s/rad], inertia: M_d [kg m^2]; scalar, (n,) or (n, n). None: that of the arm, M(q), and no
            force sensor.

    The wire "command" carries the torque K e + D e', or with ``inertia`` the acceleration a_d + M_d^-1 (...).

    Closed forms, with an exact model: M e'' + D e' + K e = J^T F_tip, and with inertia M_d e'' + D e' + K e = J^T F_tip.
    Raises BadArgument: an inertia that is not positive definite.
    """

    stiffness: Gain
    damping: Gain
    inertia: Gain = Gain()
    equation = "joint impedance"
    opens_at = ("torque", "command", "position", "force")
    senses_force = True
    sources: ClassVar[tuple[str, ...]] = SOURCES
    typst = "tau = K e + D dot(e) + hat(M)(q) dot.double(q)_d + hat(h)(q, dot(q))"
    units = {"stiffness": "Nm/rad", "damping": "Nm s/rad", "inertia": "kg m^2"}

    def __post_init__(self) -> None:
        inertia_of(self.inertia)
        if not self.inertia:
            without_sensor(self)

    @property
    def joint_by_joint(self) -> bool:
        """False with an inertia: the measured force reaches all joints."""
        return not self.inertia

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = K e + D e' + M^ a_d + h^, or M^ (a_d + M_d^-1 (K e + D e' - J^T F)) + J^T F + h^."""
        q, v, e = now.q, now.v, ref.q - now.q
        f = self.stiffness @ e + self.damping @ (ref.v - v)
        if not self.inertia:
            return Action(tap("command", f) + model.inverse_dynamics(q, v, ref.a), {}, e)
        pushed = model.jacobian_transpose(q, now.F)
        a = tap("command", ref.a + matvec(self.inertia.inverse(model.n), f - pushed))
        return Action(model.inverse_dynamics(q, v, a) + pushed, {}, e)
