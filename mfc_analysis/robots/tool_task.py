r"""What a tool law controls: the tool's pose in all six directions, or in selected ones.

The error X_e, its velocity V_e and the maps between joints and these directions, for plain and dual arrays. With E = X^-1 X_d:

- All six: X_e = log6(E), V_e = [Ad_E] V_d - V, whose rates agree to first order.
- Some rows S (k, 6): X_e = S log6(E), and V_e is its rate, exactly. It is S ([Ad_E] V_d - V) where the directions that no row selects have no error,
  as on a SCARA, whose tool cannot tilt.
- Rows that only translate: X_e = S p_e with p_e = R^T (p_d - p), whatever the orientation, and V_e is its rate, exactly:

  .. math:: V_e = S (R_E v_d - v + p_e \times \omega)

With A the (k, n) map from joint velocities to these directions (S J where X_e = 0), V_e' = feedforward - A a - bias.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.axes import selected_rows
from mfc_analysis.maths.dual import Dual, Vector, chain, concatenate, matvec, times, value
from mfc_analysis.maths.se3 import (
    Jlog6,
    Pose,
    angular,
    bracket,
    cross_product,
    hat,
    linear,
    log_rate,
    log_rate_transposed,
    log_slope,
)
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.robots.singularity import REFUSE_CONDITION, nearest_singular


@dataclass(frozen=True, eq=False)
class Selection:
    """The directions of a tool law: ``axes`` as "xyz", "xyzrz", or (k, 6) orthonormal rows on the twist (linear, angular) in the tool frame.

    Raises BadArgument.
    """

    axes: Any
    rows: Array = field(init=False)  #: S (k, 6)
    names: tuple[str, ...] = field(init=False)  #: k: "vx" ... "wz", or "row1" ... of rows along no axis

    def __post_init__(self) -> None:
        rows, names = selected_rows(self.axes)
        for name, content in (("rows", rows), ("names", names), ("axes", self.axes if isinstance(self.axes, str) else rows)):
            object.__setattr__(self, name, content)

    @property
    def translates(self) -> bool:
        """True where no row has a rotation: the orientation of the reference is not used."""
        return not self.rows[:, 3:].any()

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each direction: "m", "rad", or "m, rad" of rows with both."""
        kinds = [(bool(row[:3].any()), bool(row[3:].any())) for row in self.rows]
        return tuple("m, rad" if moves and turns else "m" if moves else "rad" for moves, turns in kinds)


class ToolTask:
    """All six directions at a joint position q, with the reference pose X_d, its body twist V_d and the rate of that."""

    def __init__(self, model: Primitives, q: Vector, X_d: Pose, V_d: Vector, dV_d: Vector) -> None:
        self.model, self.q, self.V_d, self.dV_d = model, q, V_d, dV_d
        self.E = model.pose(q).inverse() @ X_d

    @property
    def size(self) -> int:
        """Number of directions."""
        return 6

    @cached_property
    def error(self) -> Vector:
        """X_e (..., k). Raises NearPi where a rotation of the reference from the tool is taken and close to pi."""
        return self.E.log()

    @cached_property
    def carried(self) -> Vector:
        """(..., k) the twist of the reference in the tool frame: V_e = carried - through(V)."""
        return self.E.adjoint(self.V_d)

    def through(self, V: Vector) -> Vector:
        """(..., k) these directions of a twist (..., 6) of the tool, or of J a or J' v."""
        return V

    def selected(self, V: Vector) -> Vector:
        """(..., k) the components of a vector (..., 6) themselves."""
        return V

    def feedforward(self, V: Vector) -> Vector:
        """(..., k) the rate of ``carried``: d/dt([Ad_E] V_d) at the twist V of the tool."""
        return self.E.adjoint(self.dV_d) - bracket(V, self.carried)

    def error_rate(self, V: Vector) -> Vector:
        """(..., k) X_e' at the twist V of the tool."""
        return log_rate(self.error, self.E.inverse().adjoint(self.carried - V))

    def torque(self, f: Vector) -> Vector:
        """(..., n) joint torques of a force f (..., k) along these directions."""
        return self.model.jacobian_transpose(self.q, f)

    def solve(self, x: Vector, damping: float = 0.0) -> Vector:
        """(..., n) the smallest joint velocity that moves the tool by x (..., k); as ``Primitives.solve_jacobian``."""
        return self.model.solve_jacobian(self.q, x, damping)

    def acceleration(self, tau: Vector) -> Vector:
        """(..., k) A M^-1 tau: the acceleration along these directions under joint torques alone."""
        return self.through(self.model.jacobian(self.q, self.model.solve_mass(self.q, tau)))

    @cached_property
    def mobility(self) -> Array:
        """(..., k, k) Lambda^-1 = A M^-1 A^T, plain."""
        return np.asarray(np.linalg.inv(self.model.at(value(self.q)).Lambda), float)

    def mass(self, x: Vector, damping: float = 0.0, mass: Array | None = None) -> Vector:
        """(..., k) Lambda x; as ``Primitives.task_mass``."""
        return self.model.task_mass(self.q, x, damping, mass)


class SelectedTask(ToolTask):
    """The directions of a selection of six rows: S X_e and S V_e."""

    def __init__(self, selection: Selection, model: Primitives, q: Vector, X_d: Pose, V_d: Vector, dV_d: Vector) -> None:
        super().__init__(model, q, X_d, V_d, dV_d)
        self.S = selection.rows

    @property
    def size(self) -> int:
        """Number of directions."""
        return len(self.S)

    def selected(self, V: Vector) -> Vector:
        """S V."""
        return matvec(self.S, V)

    @cached_property
    def _whole(self) -> Vector:
        """X_e of all six directions."""
        return self.E.log()

    @cached_property
    def error(self) -> Vector:
        """X_e (..., k)."""
        return self.selected(self._whole)

    @cached_property
    def _turned(self) -> Vector:
        """(..., 6) the twist of the reference in the tool frame."""
        return self.E.adjoint(self.V_d)

    @cached_property
    def carried(self) -> Vector:
        """(..., k) the twist of the reference in the tool frame."""
        return self.selected(self._turned)

    def through(self, V: Vector) -> Vector:
        """S V."""
        return self.selected(V)

    def feedforward(self, V: Vector) -> Vector:
        """(..., k) the rate of ``carried``."""
        return self.selected(self.E.adjoint(self.dV_d) - bracket(V, self._turned))

    def error_rate(self, V: Vector) -> Vector:
        """(..., k) X_e'."""
        return self.selected(log_rate(self._whole, self.E.inverse().adjoint(self._turned - V)))

    # --- between joints and directions ---------------------------------------------------------------------------

    @cached_property
    def T(self) -> Array:
        """(..., k, 6) or (k, 6): ``through`` as a matrix."""
        return self.S

    def T_rate(self, V: Array) -> Array | float:
        """T' at the twist V (..., 6) of the tool."""
        return 0.0

    def reference_twists(self) -> Array:
        """(..., 6, k) body twists of X_d that move the error by 1 each, plain."""
        return np.broadcast_to(self.S.T, (*self.E.p.shape[:-1], *self.S.T.shape))

    def wrench(self, f: Vector) -> Vector:
        """T^T f (..., 6)."""
        return matvec(self.S.T, f)

    @cached_property
    def A(self) -> Array:
        """(..., k, n) joint velocities to these directions."""
        return np.asarray(self.T @ self.model.at(value(self.q)).J)

    def rate_matrix(self, V: Array, J_rate: Array) -> Array:
        """A' (..., k, n) at the twist V (..., 6) of the tool and the rate J' of its Jacobian, plain."""
        turning = self.T_rate(V)
        out = self.T @ J_rate
        return np.asarray(out if isinstance(turning, float) else out + turning @ self.model.at(value(self.q)).J)

    def torque(self, f: Vector) -> Vector:
        """A^T f."""
        return self.model.jacobian_transpose(self.q, self.wrench(f))

    def forward(self, x: Vector) -> Vector:
        """A x."""
        return self.through(self.model.jacobian(self.q, x))

    @cached_property
    def mobility(self) -> Array:
        """(..., k, k) Lambda^-1 = A M^-1 A^T, plain."""
        M = self.model.at(value(self.q)).M
        return np.asarray(self.A @ np.linalg.solve(M, np.swapaxes(self.A, -1, -2)), float)

    def check_regular(self) -> None:
        """Raises NearSingular where the condition number of A exceeds 1e6."""
        found = nearest_singular(self.model.robot.tool, np.asarray(np.linalg.svd(self.A, compute_uv=False), float))
        if found.condition > REFUSE_CONDITION:
            raise found

    def solve(self, x: Vector, damping: float = 0.0) -> Vector:
        """A^-1 x, or A^T (A A^T + damping^2)^-1 x. Raises NearSingular as ``check_regular`` (unless damped)."""
        A, xs = self.A, value(x)
        k, n = A.shape[-2:]
        if damping == 0.0:
            self.check_regular()
        if k == n and damping == 0.0:
            inverse = np.asarray(np.linalg.inv(A), float)
            y = times(inverse, xs)
            return _implicit(y, inverse, x, self.forward(y))
        A_T = np.swapaxes(A, -1, -2)
        W = np.asarray(np.linalg.inv(A @ A_T + damping**2 * np.eye(k)), float)
        u = times(W, xs)
        pulled = self.torque(u)  # A^T u with u held
        rest = _implicit(u, W, x, self.forward(pulled))
        return chain(value(pulled), (lambda: np.eye(n), pulled), (lambda: A_T, rest))

    def mass(self, x: Vector, damping: float = 0.0, mass: Array | None = None) -> Vector:
        """Lambda x with Lambda = (A M^-1 A^T + damping^2 n / trace(M))^-1; as ``Primitives.task_mass``. Raises NearSingular."""
        model, A = self.model, self.A
        at = model.at(value(self.q))
        if damping == 0.0:
            self.check_regular()
        M = at.M if mass is None else mass
        soft, softening = model.softness(self.q, damping, mass)
        Lambda = np.asarray(np.linalg.inv(A @ np.linalg.solve(M, np.swapaxes(A, -1, -2)) + soft * np.eye(len(self.S))), float)
        y = times(Lambda, value(x))
        pushed = self.torque(y)
        back = self.forward(model.solve_mass(self.q, pushed) if mass is None else matvec(np.asarray(np.linalg.inv(mass), float), pushed))
        if softening is not None:
            assert isinstance(back, Dual)
            back = Dual(back.value, back.tangent - y[..., None] * softening)
        return _implicit(y, Lambda, x, back)


class PositionTask(SelectedTask):
    """Rows that only translate: X_e = S p_e with p_e = R^T (p_d - p), and V_e its rate."""

    @cached_property
    def p(self) -> Vector:
        """p_e (..., 3)."""
        return self.E.p if self.E.twist is None else Dual(self.E.p, self.E.R @ self.E.twist[..., :3, :])

    @cached_property
    def error(self) -> Vector:
        """X_e (..., k)."""
        return matvec(self.S[:, :3], self.p)

    @cached_property
    def _turned(self) -> Vector:
        """(..., 6) R_E v_d, R_E w_d."""
        return _rotation(self.E).adjoint(self.V_d)

    def through(self, V: Vector) -> Vector:
        """S (v - p_e x w)."""
        return matvec(self.S[:, :3], linear(V) - cross_product(self.p, angular(V)))

    def _p_rate(self, V: Vector) -> Vector:
        return linear(self._turned) - linear(V) + cross_product(self.p, angular(V))

    def feedforward(self, V: Vector) -> Vector:
        """(..., k) the rate of ``carried`` and of p_e x w, apart from p_e x w'."""
        v_d, w_d, w = linear(self._turned), angular(self._turned), angular(V)
        a_d = linear(_rotation(self.E).adjoint(self.dV_d)) + cross_product(w_d - w, v_d)
        return matvec(self.S[:, :3], a_d + cross_product(self._p_rate(V), w))

    def error_rate(self, V: Vector) -> Vector:
        """(..., k) X_e' = V_e."""
        return self.carried - self.through(V)

    @cached_property
    def T(self) -> Array:
        """(..., k, 6)."""
        S, p = self.S[:, :3], value(self.p)
        return np.concatenate([np.broadcast_to(S, (*p.shape[:-1], *S.shape)), -S @ hat(p)], axis=-1)

    def T_rate(self, V: Array) -> Array:
        """T'."""
        turning = -self.S[:, :3] @ hat(value(self._p_rate(V)))
        return np.concatenate([np.zeros_like(turning), turning], axis=-1)

    def reference_twists(self) -> Array:
        """(..., 6, k): along the axes of the tool."""
        move = np.swapaxes(self.E.R, -1, -2) @ self.S[:, :3].T
        return np.concatenate([move, np.zeros_like(move)], axis=-2)

    def wrench(self, f: Vector) -> Vector:
        """A force at the desired position of the tool."""
        push = matvec(self.S[:, :3].T, f)
        return concatenate([push, cross_product(self.p, push)])


class PartialTask(SelectedTask):
    """Rows with some of the rotations: X_e = S log6(E), and V_e its rate, S (Jlog6(X_e) V_d - Jlog6(-X_e) V)."""

    @cached_property
    def carried(self) -> Vector:
        """(..., k)."""
        return self.selected(log_rate(self._whole, self.V_d))

    def through(self, V: Vector) -> Vector:
        """(..., k)."""
        return self.selected(log_rate(-self._whole, V))

    def _whole_rate(self, V: Vector) -> Vector:
        return log_rate(self._whole, self.V_d) - log_rate(-self._whole, V)

    def feedforward(self, V: Vector) -> Vector:
        """(..., k) the rate of ``carried`` and of Jlog6(-X_e)."""
        xi, rate = self._whole, self._whole_rate(V)
        return self.selected(log_rate(xi, self.dV_d) + log_slope(xi, rate, self.V_d) + log_slope(-xi, rate, V))

    def error_rate(self, V: Vector) -> Vector:
        """(..., k) X_e' = V_e."""
        return self.carried - self.through(V)

    @cached_property
    def T(self) -> Array:
        """(..., k, 6)."""
        return np.asarray(self.S @ Jlog6(-value(self._whole)))

    def T_rate(self, V: Array) -> Array:
        """T'."""
        xi, rate = value(self._whole), value(self._whole_rate(V))
        columns = log_slope(-xi[..., None, :], -rate[..., None, :], np.broadcast_to(np.eye(6), (*xi.shape[:-1], 6, 6)))
        return np.asarray(self.S @ np.swapaxes(value(columns), -1, -2))

    def reference_twists(self) -> Array:
        """(..., 6, k)."""
        return np.asarray(np.linalg.solve(Jlog6(value(self._whole)), super().reference_twists()), float)

    def wrench(self, f: Vector) -> Vector:
        """T^T f."""
        return log_rate_transposed(-self._whole, matvec(self.S.T, f))


def tool_task(selection: Selection | None, model: Primitives, q: Vector, X_d: Pose, V_d: Vector, dV_d: Vector) -> ToolTask:
    """The task of a law with this selection (None: all six directions) at q."""
    return ToolTask(model, q, X_d, V_d, dV_d) if selection is None else selected_task(selection, model, q, X_d, V_d, dV_d)


def selected_task(selection: Selection, model: Primitives, q: Vector, X_d: Pose, V_d: Vector, dV_d: Vector) -> SelectedTask:
    """The task of these directions at q."""
    kind = SelectedTask if len(selection.rows) == 6 else PositionTask if selection.translates else PartialTask
    return kind(selection, model, q, X_d, V_d, dV_d)


def task_singular_values(selection: Selection | None, model: Primitives, q: Array) -> Array:
    """(..., k) singular values of J, or of S J, at joint positions q (..., n), largest first."""
    at = model.at(q)
    return at.sigma if selection is None else np.asarray(np.linalg.svd(selection.rows @ at.J, compute_uv=False), float)


def _implicit(y: Array, inverse: Array, x: Vector, back: Vector) -> Vector:
    """y = inverse x with the tangent of the implicit rule: ``back`` is the inverse's inverse applied to y, with y held."""
    tangent = -back.tangent if isinstance(back, Dual) else None
    if isinstance(x, Dual):
        tangent = x.tangent if tangent is None else x.tangent + tangent
    return y if tangent is None else Dual(y, inverse @ tangent)


def _rotation(E: Pose) -> Pose:
    """The pose without its position."""
    if E.twist is None:
        return Pose(E.R, np.zeros_like(E.p))
    twist = np.array(E.twist)
    twist[..., :3, :] = 0.0
    return Pose(E.R, np.zeros_like(E.p), twist)
