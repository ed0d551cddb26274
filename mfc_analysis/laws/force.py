"""Force control: equations 9.21 to 9.23."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from numpy.typing import ArrayLike

from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import WRENCH, Action, JointReference, Law, Measured, Slot, Tap, ToolReference
from mfc_analysis.maths import checks
from mfc_analysis.maths.dual import Vector
from mfc_analysis.robots.primitives import Primitives

FORCE_UNITS = {"kfp": "-", "kfi": "1/s", "kdamp": "Ns/m", "F_d": "N"}


class ForceLaw(Law):
    """What the force laws share: F_d, force gains of six components, the force integral."""

    equation = "9.21"
    opens_at: ClassVar[tuple[str, ...]] = ("torque", "position", "force")
    senses_force = True
    sources = ("Lynch & Park, Modern Robotics, ch. 11.5", "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9")
    units = FORCE_UNITS

    def check(self, n: int) -> None:
        """Raise BadArgument unless the force gains have six components."""
        for gain in self.gains().values():
            gain.check(6, "components of the wrench")

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """z_f, the integral of F_e, where kfi is given."""
        return (Slot("z_f", WRENCH),) if getattr(self, "kfi", None) else ()

    def _act(self, model: Primitives, now: Measured, ref: JointReference | ToolReference, F_d: Vector, kfp: Gain, kfi: Gain, kdamp: Gain) -> Action:
        assert isinstance(ref, JointReference)
        F = F_d
        rates: dict[str, Vector] = {}
        if now.F is not None and (kfp or kfi):
            F_e = F_d - now.F
            F = F_d + kfp @ F_e + kfi @ now["z_f"]
            rates = {"z_f": F_e} if kfi else {}
        if kdamp:
            F = F - kdamp @ model.jacobian(now.q, now.v)
        return Action(model.gravity(now.q) + model.jacobian_transpose(now.q, F), rates, ref.q - now.q)


@dataclass(frozen=True, eq=False)
class OpenLoopForce(ForceLaw):
    r"""Open-loop force: equation 9.21, :math:`\tau = \hat g(q) + J^T F_d`.

    Args:
        F_d: (6,) [N, Nm] wrench that the tool shall apply, tool frame.

    A payload error makes a steady force error; nothing measures it.
    """

    F_d: ArrayLike
    equation = "9.21"
    opens_at = ("torque", "position")
    senses_force = False
    typst = 'tau = hat(g)(q) + J^top "F"_d'

    def __post_init__(self) -> None:
        object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))

    def act(self, model: Primitives, now: Measured, ref: JointReference | ToolReference, tap: Tap) -> Action:
        """tau = g^ + J^T F_d."""
        none = Gain("kfp", None)
        return self._act(model, now, ref, self.F_d, none, none, none)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class ForcePI(ForceLaw):
    r"""PI force control: equation 9.22, :math:`\tau = \hat g(q) + J^T(F_d + K_{fp} F_e + K_{fi} \int F_e)`.

    Args:
        F_d: (6,) [N, Nm] in the tool frame; kfp: [-], kfi: [1/s]; scalar, (6,) or (6, 6).

    With nothing to push against the arm accelerates away.
    """

    F_d: ArrayLike
    kfp: Gain | ArrayLike
    kfi: Gain | ArrayLike | None = None
    equation = "9.22"
    typst = 'tau = hat(g)(q) + J^top ("F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t)'

    def __post_init__(self) -> None:
        object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))
        self._coerce("kfp", "kfi")

    def act(self, model: Primitives, now: Measured, ref: JointReference | ToolReference, tap: Tap) -> Action:
        """tau = g^ + J^T (F_d + Kfp F_e + Kfi z_f)."""
        assert isinstance(self.kfp, Gain) and isinstance(self.kfi, Gain)
        return self._act(model, now, ref, self.F_d, self.kfp, self.kfi, Gain("kdamp", None))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class DampedForcePI(ForceLaw):
    r"""PI force control with velocity damping: equation 9.23,
    :math:`\tau = \hat g(q) + J^T(F_d + K_{fp} F_e + K_{fi} \int F_e - K_{damp} V)`.

    Args:
        F_d: (6,) [N, Nm] in the tool frame; kfp: [-], kfi: [1/s], kdamp: [Ns/m, Nms/rad]; scalar, (6,) or (6, 6).

    Closed form, one mass on a spring k_e (damper c_e), friction b:
    m s^3 + (b + kdamp + c_e (1 + kfp)) s^2 + (k_e (1 + kfp) + c_e kfi) s + k_e kfi.
    """

    F_d: ArrayLike
    kfp: Gain | ArrayLike
    kfi: Gain | ArrayLike | None = None
    kdamp: Gain | ArrayLike = 0.0
    equation = "9.23"
    typst = 'tau = hat(g)(q) + J^top ("F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t - K_"damp" "V")'

    def __post_init__(self) -> None:
        object.__setattr__(self, "F_d", checks.array("F_d", self.F_d, (6,)))
        self._coerce("kfp", "kfi", "kdamp")

    def act(self, model: Primitives, now: Measured, ref: JointReference | ToolReference, tap: Tap) -> Action:
        """tau = g^ + J^T (F_d + Kfp F_e + Kfi z_f - Kdamp V)."""
        assert isinstance(self.kfp, Gain) and isinstance(self.kfi, Gain) and isinstance(self.kdamp, Gain)
        return self._act(model, now, ref, self.F_d, self.kfp, self.kfi, self.kdamp)  # type: ignore[arg-type]
