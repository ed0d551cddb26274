"""Hybrid motion/force control: equation 9.24."""

from __future__ import annotations

from dataclasses import field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.force import FORCE_INTEGRAL, FORCE_UNITS
from mfc_analysis.laws.gain import Gain
from mfc_analysis.laws.law import Action, Measured, Slot, Tap, ToolLaw, ToolReference, define
from mfc_analysis.laws.task_torque import tool_acceleration
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, matvec, times, value
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.tool_task import ToolTask


@define
class HybridMotionForce(ToolLaw):
    r"""Hybrid motion/force control: equation 9.24.

    .. math:: \tau = J_b^T\,(P\,\hat\Lambda(\tfrac{d}{dt}([Ad]V_d) + K_p X_e + K_i \int X_e + K_d V_e)
        + (1 - P)(F_d + K_{fp} F_e + K_{fi} \int F_e - K_{damp} V) + \hat\eta)

    The page has no damping in the force directions, so with kfi > 0 the loop on an undamped wall is unstable at any stiffness;
    ``kdamp`` adds damping. X_e is not projected first: an error along a constrained axis leaks into the motion.

    Args:
        F_d: (6,) [N, Nm] tool frame.
        kp: [1/s^2], ki: [1/s^3], kd: [1/s], kfp: [-], kfi: [1/s], kdamp: [Ns/m, Nm s/rad]; scalar, (6,) or (6, 6).
        constraints: (k, 6) rows A with A V_b = 0, constant in the tool frame, or a ``ConstraintSet``.
        projection: "dynamic": P = 1 - A^T (A Lambda^-1 A^T)^-1 A Lambda^-1; "selection": 1 - A^T A, orthonormal rows only.
        form: "standard"; "printed": eta inside (1 - P), V_d' and X_e' as on the page; "printed_eta": only eta misplaced.
        axes: the directions of the tool that the law controls, by motion or force; None: all six. For an arm that cannot move it along all six,
            such as "xyzrz" for a SCARA; see ``TaskComputedTorque``. The constraints are among them, and motion gains have one entry for each.

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
    axes: Any = None
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
        self.select()
        if self.selection is not None:
            S = self.selection.rows
            if np.abs(A - A @ S.T @ S).max() > 1e-9 * np.abs(A).max():
                raise BadArgument("constraints", A, f"rows within the selected directions, axes={self.selection.axes!r}")

    def check(self, n: int) -> None:
        """Raises BadArgument unless the gains fit and the arm has a joint for each direction: six, or those of ``axes``."""
        size = 6 if self.selection is None else len(self.selection.rows)
        for name, gain in self.gains().items():
            motion = name in ("kp", "ki", "kd")
            gain.check(size if motion else 6, "directions of motion" if motion else "components of the wrench")
        if n < size:
            takes = "a joint for each direction, as Lambda needs a J of full rank; axes= selects those that the arm can move"
            raise BadArgument("law", f"HybridMotionForce on {n} joints", takes)

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """z and z_f, where ki and kfi are given."""
        motion = (Slot("z", self.error_channels(joints)),) if self.ki else ()
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
        h, drift = model.bias(q, v), task.through(model.jacobian_dot(q, v))
        push = task.selected(f)
        if self.form == "standard":
            return Action(task.torque(self._split(task, c, push, minus=drift)) + h, rates, X_e)
        eta = task.mass(task.acceleration(h) - drift)
        return Action(task.torque(self._split(task, c, push + eta, minus=None)), rates, X_e)

    def _split(self, task: ToolTask, c: Vector, f: Vector, minus: Vector | None) -> Vector:
        """P Lambda c + (1 - P) f - Lambda minus, along the k directions of the task."""
        A = self.rows if self.selection is None else self.rows @ self.selection.rows.T
        moved = c if minus is None else c - minus
        if len(A) == task.size:  # P = 0: no motion is left to control
            return f if minus is None else f - task.mass(minus)
        if self.projection == "selection":
            S = A.T @ A
            held = f if minus is None else f - task.mass(minus)
            return matvec(np.eye(task.size) - S, task.mass(moved)) + matvec(S, held)
        # P Lambda c + (1 - P) f = Lambda c + A^T l with (A Lambda^-1 A^T) l = A (Lambda^-1 f - c)
        S = np.asarray(np.linalg.inv(A @ task.mobility @ A.T), float)
        held = times(S, matvec_plain(A, times(task.mobility, value(f)) - value(c)))
        multiplier: Vector = held
        if any(isinstance(x, Dual) for x in (task.q, c, f)):
            rest = matvec(A, task.acceleration(task.torque(f - held @ A)) - c)  # its value is 0; its tangent is that of the implicit rule
            multiplier = held + matvec(S, rest)
        return task.mass(moved) + matvec(A.T, multiplier)


def matvec_plain(A: Array, x: Array) -> Array:
    """A x for plain (..., 6)."""
    return x @ A.T
