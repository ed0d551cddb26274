"""The matrices of a robot at a joint position: M, J, X and their inverses."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import pinocchio as pin

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.brackets import bracketed
from mfc_analysis.robots.calls import Calls, symmetric
from mfc_analysis.robots.singularity import REFUSE_CONDITION, nearest_singular


class Configuration:
    """M, J, X and their inverses at q (..., n), each computed at first use."""

    def __init__(self, calls: Calls, q: Array, like: Callable[[Array], Configuration] | None = None) -> None:
        """``like``: the configuration of another robot, whose J and X are the same."""
        self.q = q
        self._of, self._like = calls, like
        self._held: tuple[Array, Array] | None = None

    @cached_property
    def kinematics(self) -> tuple[Array, Array, Array]:
        """J, R and p, by this robot's own model."""
        of = self._of
        model, data, frame = of.model, of.data, of.robot.frame_id
        if self.q.ndim == 1 and of.plain:  # one point, in half the time
            pin.computeJointJacobians(model, data, np.ascontiguousarray(self.q))
            J = np.array(pin.getFrameJacobian(model, data, frame, pin.LOCAL), order="C").reshape(6, of.n)
            X = np.array(pin.updateFramePlacement(model, data, frame).homogeneous, order="C")
            return J, X[:3, :3], X[:3, 3]
        points = of.configurations(self.q)
        J, X = np.empty((len(points), 6, of.n)), np.empty((len(points), 4, 4))
        each = J if of.n > 1 else J[..., 0]  # as Pinocchio gives it
        for i, at in enumerate(points):
            pin.computeJointJacobians(model, data, at)
            each[i] = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            X[i] = pin.updateFramePlacement(model, data, frame).homogeneous
        lead = self.q.shape[:-1]
        X = X.reshape(*lead, 4, 4)
        return of.unordered(J).reshape(*lead, 6, of.n), X[..., :3, :3], X[..., :3, 3]

    @property
    def J(self) -> Array:
        """Body Jacobian (..., 6, n)."""
        same = self._same
        return same.kinematics[0] if "kinematics" in vars(same) else same._J

    @cached_property
    def _same(self) -> Configuration:
        """The configuration that computes J and X of this one."""
        return self if self._like is None else self._like(self.q)

    @cached_property
    def _J(self) -> Array:
        """J where the pose is not needed: two thirds of the time."""
        of = self._of
        model, data, frame = of.model, of.data, of.robot.frame_id
        points = of.configurations(self.q)
        J = np.empty((len(points), 6, of.n))
        each = J if of.n > 1 else J[..., 0]  # as Pinocchio gives it
        jacobian, local = pin.computeFrameJacobian, pin.LOCAL
        for i, at in enumerate(points):
            each[i] = jacobian(model, data, at, frame, local)
        return of.unordered(J).reshape(*self.q.shape[:-1], 6, of.n)

    def bracketed(self, x: Array) -> Array:
        """d(J x)/dq with x held, (..., 6, n); kept for a repeated call with the same array, as J v and J' v make it."""
        if self._held is None or self._held[0] is not x:
            self._held = x, bracketed(self._of, self.J, x)
        return self._held[1]

    @property
    def R(self) -> Array:
        """Tool rotation (..., 3, 3)."""
        return self._same.kinematics[1]

    @property
    def p(self) -> Array:
        """Tool position (..., 3)."""
        return self._same.kinematics[2]

    @cached_property
    def J_T(self) -> Array:
        """J^T, (..., n, 6)."""
        return np.ascontiguousarray(np.swapaxes(self.J, -1, -2))

    @cached_property
    def M(self) -> Array:
        """Mass matrix (..., n, n), armature included."""
        of = self._of
        if of.plain and self.q.ndim == 1:
            return symmetric(np.array(pin.crba(of.model, of.data, self.q)))
        (M,) = of.collect(pin.crba, of.model, of.data, (of.data.M,), self.q)
        return symmetric(M)

    @cached_property
    def M_inverse(self) -> Array:
        """M^-1, (..., n, n)."""
        return np.asarray(np.linalg.inv(self.M), float)

    @cached_property
    def J_inverse(self) -> Array:
        """J^-1 of a six-joint arm; call ``check_regular`` first."""
        return np.asarray(np.linalg.inv(self.J), float)

    @cached_property
    def Lambda(self) -> Array:
        """(J M^-1 J^T)^-1, (..., 6, 6). Raises NearSingular, always for fewer than six joints."""
        if self._of.n < 6:
            raise NearSingular(self._of.robot.tool, 0.0, float("inf"))
        self.check_regular()
        if self._of.n == 6:
            inverse = self.J_inverse
            return np.asarray(np.swapaxes(inverse, -1, -2) @ self.M @ inverse, float)
        return np.asarray(np.linalg.inv(self.J @ self.M_inverse @ self.J_T), float)

    @cached_property
    def sigma(self) -> Array:
        """Singular values of J, largest first, (..., min(6, n))."""
        return np.asarray(np.linalg.svd(self.J, compute_uv=False), float)

    @cached_property
    def nearest_singular(self) -> NearSingular:
        """The configuration nearest to singular, as a NearSingular error (not raised)."""
        return nearest_singular(self._of.robot.tool, self.sigma)

    def check_regular(self) -> None:
        """Raises NearSingular where the condition number of J exceeds 1e6 (or the rank is below min(6, n))."""
        if self._surely_regular or not np.any(self.sigma[..., 0] >= REFUSE_CONDITION * self.sigma[..., -1]):
            return
        if self.nearest_singular.condition > REFUSE_CONDITION:
            raise self.nearest_singular

    @cached_property
    def _surely_regular(self) -> bool:
        """True where the Frobenius norms of J and J^-1, which bound the condition number, show it without singular values."""
        if self._of.n != 6:
            return False
        try:
            inverse = self.J_inverse
        except np.linalg.LinAlgError:
            return False
        J = self.J
        if J.ndim == 2:
            return float(np.vdot(J, J)) * float(np.vdot(inverse, inverse)) < REFUSE_CONDITION**2
        with np.errstate(all="ignore"):
            bound = np.square(J).sum(axis=(-2, -1)) * np.square(inverse).sum(axis=(-2, -1))
        return bool(np.all(bound < REFUSE_CONDITION**2))
