"""Hybrid motion/force control: equation 9.24."""

from __future__ import annotations

from dataclasses import field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.force import FORCE_INTEGRAL, FORCE_UNITS
from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import TWIST, Action, Measured, Slot, Tap, ToolLaw, ToolReference, define
from mfc_analysis.laws.task_torque import tool_acceleration
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, matvec, times, value
from mfc_analysis.robots.primitives import Primitives


@define
class HybridMotionForce(ToolLaw):
    r"""Hybrid motion/force control: equation 9.24.

    .. math:: \tau = J_b^T\,(P\,\hat\Lambda(\tfrac{d}{dt}([Ad]V_d) + K_p X_e + K_i \int X_e + K_d V_e)
        + (1 - P)(F_d + K_{fp} F_e + K_{fi} \int F_e - K_{damp} V) + \hat\eta)

    The page has no damping in the force directions, so with kfi > 0 the loop on an undamped wall is unstable at any stiffness;
    ``kdamp`` adds damping. X_e is not projected first: an error along a constrained axis leaks into the motion.

    Args:
        F_d: (6,) [N, Nm] tool frame. kp [1/s^2], ki [1/s^3], kd [1/s], kfp [-], kfi [1/s], kdamp [Ns/m, Nms/rad]: scalar, (6,) or (6, 6).
        constraints: (k, 6) rows A with A V_b = 0, constant in the tool frame, or a ``ConstraintSet``.
        projection: "dynamic": P = 1 - A^T (A Lambda^-1 A^T)^-1 A Lambda^-1; "selection": 1 - A^T A, orthonormal rows only.
        form: "standard"; "printed": eta inside (1 - P), V_d' and X_e' as on the page; "printed_eta": only eta misplaced.

    On a redundant arm all of h^ is compensated (J^T eta = h - J^T Lambda J' v), so the null space has the damping of the plant only.
    """

    F_d: ArrayLike
    kp: Gain
    ki: Gain = Gain()
    kd: Gain = Gain()
    kfp: Gain = Gain(given=0.0)
    kfi: Gain = Gain()
    kdamp: Gain = Gain(given=0.0)
    constraints: Any = None
    projection: Literal["dynamic", "selection"] = "dynamic"
    form: Literal["standard", "printed", "printed_eta"] = "standard"
    rows: Array = field(init=False, repr=False)  #: (k, 6) the constraints as rows A
    equation = "9.24"
    opens_at = ("torque", "command", "position", "force")
    senses_force = True
    forms = ("standard", "printed", "printed_eta")
    typst = (
        'tau = J_b^top (P hat(Lambda) (dif/(dif t)(["Ad"] "V"_d) + K_p X_e + K_i integral X_e dif t + K_d "V"_e) '
        '+ (1 - P) ("F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t) + hat(eta))'
    )
    units = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s", **FORCE_UNITS}

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "F_d", checks.array("F_d", self.F_d, (6,)))
        checks.choice("form", self.form, self.forms)
        checks.choice("projection", self.projection, ("dynamic", "selection"))
        takes = "rows A of shape (k, 6), 1 <= k <= 6, of full rank, with A V_b = 0 in the tool frame, or a ConstraintSet"
        if self.constraints is None:
            raise BadArgument("constraints", None, takes)
        A = checks.array("constraints", getattr(self.constraints, "rows", self.constraints))
        if A.ndim != 2 or A.shape[1] != 6 or not 1 <= A.shape[0] <= 6 or np.linalg.matrix_rank(A) < A.shape[0]:
            raise BadArgument("constraints", f"shape {A.shape}" if A.ndim != 2 or A.shape[1] != 6 else A, takes)
        if self.projection == "selection" and np.abs(A @ A.T - np.eye(len(A))).max() > 1e-9:
            raise BadArgument("constraints", A, 'orthonormal rows for projection="selection"')
        set_(self, "rows", A)

    def check(self, n: int) -> None:
        """Raise BadArgument unless all gains have six components and the arm has six joints or more."""
        super().check(n)
        if n < 6:
            takes = "an arm of six joints or more, as Lambda needs a J of full rank; with fewer, DampedForcePI (9.23) presses and"
            raise BadArgument("law", f"HybridMotionForce on {n} joints", f"{takes} TaskComputedTorque(axes=) (9.16) moves the tool")

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """z and z_f, where ki and kfi are given."""
        motion = (Slot("z", TWIST),) if self.ki else ()
        return (*motion, FORCE_INTEGRAL) if self.kfi else motion

    @property
    def desired_wrench(self) -> Array:
        """(6,) F_d [N, Nm], tool frame."""
        return np.asarray(self.F_d, float)

    @property
    def force_directions(self) -> Array:
        """(k, 6) the constraint rows A."""
        return self.rows

    def act(self, model: Primitives, now: Measured, ref: ToolReference, tap: Tap) -> Action:
        """tau = J^T (P Lambda^ c + (1 - P) f + eta^), with J^T eta = h - J^T Lambda J' v."""
        q, v = now.q, now.v
        task, V = self.task(model, q, ref), model.jacobian(q, v)
        X_e = task.error
        c = tap("command", tool_acceleration(task, V, self.kp, self.ki, self.kd, now["z"], printed=self.form == "printed"))
        F_e = ref.F_d - now.F
        f = ref.F_d + self.kfp @ F_e + self.kfi @ now["z_f"] - self.kdamp @ V
        rates = ({"z": X_e} if self.ki else {}) | ({"z_f": F_e} if self.kfi else {})
        h = model.bias(q, v)
        if self.form == "standard":
            wrench = self._split(model, q, c, f, minus=model.jacobian_dot(q, v))
            return Action(model.jacobian_transpose(q, wrench) + h, rates, X_e)
        eta = model.task_mass(q, model.jacobian(q, model.solve_mass(q, h)) - model.jacobian_dot(q, v))
        return Action(model.jacobian_transpose(q, self._split(model, q, c, f + eta, minus=0.0)), rates, X_e)

    def _split(self, model: Primitives, q: Vector, c: Vector, f: Vector, minus: Vector) -> Vector:
        """P Lambda c + (1 - P) f - Lambda minus."""
        A = self.rows
        if len(A) == 6:  # P = 0: no motion is left to control
            return f if isinstance(minus, float) else f - model.task_mass(q, minus)
        if self.projection == "selection":
            S = A.T @ A
            if isinstance(minus, float):
                return matvec(np.eye(6) - S, model.task_mass(q, c)) + matvec(S, f)
            return matvec(np.eye(6) - S, model.task_mass(q, c - minus)) - matvec(S, model.task_mass(q, minus) - f)
        # P Lambda c + (1 - P) f = Lambda c + A^T l with (A Lambda^-1 A^T) l = A (Lambda^-1 f - c)
        inertia = np.asarray(np.linalg.inv(model.at(value(q)).Lambda), float)
        S = np.asarray(np.linalg.inv(A @ inertia @ A.T), float)
        held = times(S, matvec_plain(A, times(inertia, value(f)) - value(c)))
        multiplier: Vector = held
        if any(isinstance(x, Dual) for x in (q, c, f)):
            rest = matvec(A, model.mobility(q, f - held @ A) - c)  # its value is 0; its tangent is that of the implicit rule
            multiplier = held + matvec(S, rest)
        return model.task_mass(q, c - minus) + matvec(A.T, multiplier)


def matvec_plain(A: Array, x: Array) -> Array:
    """A x for plain (..., 6)."""
    return x @ A.T
