"""Admittance control with velocity inputs: an arm with a servo of its own moves as a mass, damper and spring would under the measured force."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.impedance import SOURCES, inertia_of
from mfc_analysis.laws.law import Action, Measured, Slot, Tap, ToolLaw, ToolReference, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import matvec
from mfc_analysis.robots.primitives import Primitives


@define
class Admittance(ToolLaw):
    r"""Admittance control in tool space on an arm that takes joint velocities.

    .. math:: M_d \dot w = F_d - F_{tip} - D w + K X_e, \quad V_b = [Ad_{X^{-1}X_d}] V_d + w, \quad \dot q = J^\# V_b

    The twist w that the tool makes beyond the reference's motion is a state of the law. The spring pulls the measured pose of the tool back to the
    reference, x_w = -X_e: it is the position loop of the directions where the tool is free, kp = K/D of 9.5 at low frequencies, so that the pose
    does not drift. Without a spring, along a direction, the tool goes where the force sends it. In contact the force settles at F_d + K X_e.

    Args:
        F_d: (6,) [N, Nm] wrench that the tool shall apply, tool frame.
        inertia: M_d [kg, kg m^2], damping: D [Ns/m, Nm s/rad], stiffness: K [N/m, Nm/rad]; scalar, (6,) or (6, 6) on (linear, angular) in the tool
            frame; (k,) or (k, k) on k selected directions. A stiffness of 0 along an axis controls the force there; None: no spring.
        inverse_damping: [-] of the inverse of J; 0: raises NearSingular near a singularity. As ``damping`` of 9.5.
        axes: the directions of the tool that are controlled, None: all six; as in 9.5. On an arm with more joints the others move as they happen to.

    Surfaces with a damper need the hardware to have velocity_lag or servo: the joints then have a velocity of their own.

    Closed forms, one direction on a spring k_e through a velocity lag T: M_d T s^3 + (M_d + D T) s^2 + D s + k_e + K, stable iff k_e + K < D/T +
    D^2/M_d. Through a servo (w, zeta): s (M_d s + D)(s^2 + 2 zeta w s + w^2) + (k_e + K) w^2.

    Raises BadArgument: an inertia that is not positive definite.
    """

    F_d: ArrayLike
    inertia: Gain
    damping: Gain
    stiffness: Gain = Gain()
    inverse_damping: float = 0.0
    axes: Any = None
    equation = "admittance"
    plant = "velocity"
    opens_at = ("velocity", "command", "position", "force")
    senses_force = True
    sources: ClassVar[tuple[str, ...]] = SOURCES
    typst = '"V"_b = ["Ad"_(X^(-1) X_d)] "V"_d + w, quad M_d dot(w) = "F"_d - F_"tip" - D w + K X_e'
    units = {"inertia": "kg", "damping": "Ns/m", "stiffness": "N/m"}

    def __post_init__(self) -> None:
        object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))
        checks.number("inverse_damping", self.inverse_damping, low=0.0)
        inertia_of(self.inertia)
        self.select()

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """w, the twist beyond the motion of the reference; 0 at an operating point on it."""
        return (Slot("w", self.error_channels(joints), integral=False),)

    @property
    def desired_wrench(self) -> Array:
        """(6,) F_d [N, Nm], tool frame."""
        return np.asarray(self.F_d, float)

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """q' = J^# ([Ad] V_d + w), w' = M_d^-1 (F_d - F + K X_e - D w)."""
        task, w = self.task(model, now.q, ref), now["w"]
        assert w is not None
        V = tap("command", task.carried + w)
        given = task.selected(ref.F_d - now.F) + self.stiffness @ task.error - self.damping @ w
        return Action(task.solve(V, self.inverse_damping), {"w": matvec(self.inertia.inverse(task.size), given)}, task.error)
