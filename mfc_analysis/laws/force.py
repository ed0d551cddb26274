"""Force control: equations 9.21 to 9.23."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import WRENCH, Action, JointLaw, JointReference, Measured, Slot, Tap, define
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.primitives import Primitives

FORCE_INTEGRAL = Slot("z_f", WRENCH, trim=np.zeros((6, 0)))  #: the integral of F_e; it is 0 at an operating point
FORCE_UNITS = {"kfp": "-", "kfi": "1/s", "kdamp": "Ns/m", "F_d": "N"}


class ForceLaw(JointLaw):
    """Common part of the force laws: F_d, force gains of six components, the force integral."""

    F_d: ArrayLike
    opens_at: ClassVar[tuple[str, ...]] = ("torque", "position", "force")
    senses_force = True
    follows_motion = False
    sources = ("Lynch & Park, Modern Robotics, ch. 11.5", "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9")
    units = FORCE_UNITS

    def __post_init__(self) -> None:
        object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))

    def check(self, n: int) -> None:
        """Raises BadArgument unless the force gains have six components."""
        for gain in self.gains().values():
            gain.check(6, "components of the wrench")

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """z_f, the integral of F_e, where kfi is given; it starts at 0 at an operating point."""
        return (FORCE_INTEGRAL,) if self.gains().get("kfi") else ()

    @property
    def desired_wrench(self) -> Array:
        """(6,) F_d [N, Nm], tool frame."""
        return np.asarray(self.F_d, float)


@define
class OpenLoopForce(ForceLaw):
    r"""Open-loop force: equation 9.21, :math:`\tau = \hat g(q) + J^T F_d`.

    Args:
        F_d: (6,) [N, Nm] wrench that the tool shall apply, tool frame.

    There is no force feedback: a payload error causes a steady force error.
    """

    F_d: ArrayLike
    equation = "9.21"
    opens_at = ("torque", "position")
    senses_force = False
    typst = 'tau = hat(g)(q) + J^top "F"_d'

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = g^ + J^T F_d."""
        return Action(model.gravity(now.q) + model.jacobian_transpose(now.q, ref.F_d), {}, ref.q - now.q)


@define
class ForcePI(ForceLaw):
    r"""PI force control: equation 9.22, :math:`\tau = \hat g(q) + J^T(F_d + K_{fp} F_e + K_{fi} \int F_e)`.

    Args:
        F_d: (6,) [N, Nm] in the tool frame; kfp: [-], kfi: [1/s]; scalar, (6,) or (6, 6).

    In free space the arm accelerates without bound.
    """

    F_d: ArrayLike
    kfp: Gain
    kfi: Gain = Gain()
    equation = "9.22"
    typst = 'tau = hat(g)(q) + J^top ("F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t)'

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = g^ + J^T (F_d + Kfp F_e + Kfi z_f)."""
        F_e = ref.F_d - now.F
        F = ref.F_d + self.kfp @ F_e + self.kfi @ now["z_f"]
        return Action(model.gravity(now.q) + model.jacobian_transpose(now.q, F), {"z_f": F_e} if self.kfi else {}, ref.q - now.q)


@define
class DampedForcePI(ForceLaw):
    r"""PI force control with velocity damping: equation 9.23,
    :math:`\tau = \hat g(q) + J^T(F_d + K_{fp} F_e + K_{fi} \int F_e - K_{damp} V)`.

    Args:
        F_d: (6,) [N, Nm] in the tool frame; kfp: [-], kfi: [1/s], kdamp: [Ns/m, Nm s/rad]; scalar, (6,) or (6, 6).

    Closed form, one mass on a spring k_e (damper c_e), friction b:
    m s^3 + (b + kdamp + c_e (1 + kfp)) s^2 + (k_e (1 + kfp) + c_e kfi) s + k_e kfi.
    """

    F_d: ArrayLike
    kfp: Gain
    kfi: Gain = Gain()
    kdamp: Gain = Gain(given=0.0)
    equation = "9.23"
    typst = 'tau = hat(g)(q) + J^top ("F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t - K_"damp" "V")'

    def act(self, model: Primitives, now: Measured, ref: JointReference, tap: Tap) -> Action:
        """tau = g^ + J^T (F_d + Kfp F_e + Kfi z_f - Kdamp V)."""
        F_e = ref.F_d - now.F
        F = ref.F_d + self.kfp @ F_e + self.kfi @ now["z_f"] - self.kdamp @ model.jacobian(now.q, now.v)
        return Action(model.gravity(now.q) + model.jacobian_transpose(now.q, F), {"z_f": F_e} if self.kfi else {}, ref.q - now.q)
