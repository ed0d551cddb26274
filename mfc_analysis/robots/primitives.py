"""The functions that laws are written in: rnea, aba, M x, g, J x, J^T f, J^-1 x, Lambda x, for plain and dual arrays, in batches.

Each primitive acts on vectors and has an exact derivative: Pinocchio's analytic derivatives for the dynamics, brackets of the
columns of the body Jacobian for the kinematics (d J_i / d q_j is [J_i, J_j] for j after i on the chain), and the implicit rule
for inverses (y = S^-1 b has tangent S^-1 (db - dS y)). Values are ``(..., n)`` in the user's joint order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache, cached_property
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.dual import Dual, Vector, chain, elementwise, matvec, spread, times, value
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.singularity import REFUSE_CONDITION, nearest_singular

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


class Primitives:
    """Dynamics and kinematics of one robot. Not thread-safe: every call overwrites its Pinocchio Data.

    ``like``: another robot, whose kinematics at a configuration are taken where they are the same (the plant with its payload).
    In its methods ``q``, ``v``, ``a`` (..., n) are position, velocity and acceleration of the joints, plain or dual arrays; ``mass`` is a constant
    (n, n) matrix in place of M(q).
    """

    def __init__(self, robot: Robot, like: Primitives | None = None) -> None:
        self.robot = robot
        self.n = robot.n
        self._model = robot.model
        self._data = robot.model.createData()
        self._still = robot.model.copy()  # the same arm without gravity: M x = rnea(q, 0, x)
        self._still.gravity = pin.Motion.Zero()
        self._still_data = self._still.createData()
        back = np.asarray(robot.order)  # x_user = x_pinocchio[back]
        self._order = None if np.array_equal(back, np.arange(self.n)) else np.argsort(back)
        self._back = back
        self._plain = self._order is None and robot.model.nq == robot.model.nv
        self._viscous = robot.viscous if np.any(robot.viscous) else None
        self._coulomb = robot.coulomb if np.any(robot.coulomb) else None
        self.rubs = self._viscous is not None or self._coulomb is not None  #: True where the robot has joint friction
        self._zero = np.zeros(self.n)
        self._seen: list[Configuration] = []
        self._like = like if like is not None and self._moves_like(like) else None

    def __reduce__(self) -> tuple[type[Primitives], tuple[Robot, Primitives | None]]:  # without Pinocchio's Data and what is cached
        return type(self), (self.robot, self._like)

    def at(self, q: Array) -> Configuration:
        """M, J, X at the configurations q (..., n), cached for repeated calls with the same array."""
        for known in self._seen:
            if known.q is q:
                return known
        new = Configuration(self, q)
        self._seen = [new, *self._seen[:2]]
        return new

    def _moves_like(self, other: Primitives) -> bool:
        """True where J and X are the same at all q: by the product of exponentials they are, if they are at one."""
        one, two = self._model, other._model
        if self.n != other.n or list(one.parents) != list(two.parents) or not np.array_equal(self._back, other._back):
            return False
        q = np.full(self.n, 0.3)
        return all(np.array_equal(a, b) for a, b in zip(self.at(q)._kinematics, other.at(q)._kinematics, strict=True))

    # --- dynamics ------------------------------------------------------------------------------------------------

    def rnea(self, q: Vector, v: Vector, a: Vector) -> Array | Dual:
        """M(q) a + C(q, v) v + g(q) [Nm or N], without friction: equation 9.7."""
        if self._single(q, v, a):
            return np.array(pin.rnea(self._model, self._data, q, v, a))
        qs, vs, accelerations = value(q), value(v), value(a)
        if not (isinstance(q, Dual) or isinstance(v, Dual) or isinstance(a, Dual)):
            return self._each(pin.rnea, qs, vs, accelerations)
        if not isinstance(q, Dual) and not isinstance(v, Dual):
            M = self.at(qs).M
            return chain(self._each(pin.rnea, qs, vs, accelerations), (lambda: M, a))
        data = self._data
        views = (data.tau, data.dtau_dq, data.dtau_dv, data.M)
        tau, dq, dv, da = self._collect(pin.computeRNEADerivatives, self._model, data, views, qs, vs, accelerations)
        return chain(tau, (lambda: dq, q), (lambda: dv, v), (lambda: symmetric(da), a))

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Array | Dual:
        """M(q) a + h(q, v) with the viscous friction of the model in h, as a controller computes it."""
        return self._with_viscous(self.rnea(q, v, a), v)

    def bias(self, q: Vector, v: Vector) -> Array | Dual:
        """h(q, v) = C(q, v) v + g(q) + viscous friction of this model, as a controller computes it."""
        return self.inverse_dynamics(q, v, np.zeros(self.n))

    def aba(self, q: Vector, v: Vector, tau: Vector) -> Array | Dual:
        """q'' = M(q)^-1 (tau - C v - g), without friction: equation 9.7 solved."""
        if self._single(q, v, tau):
            return np.array(pin.aba(self._model, self._data, q, v, tau))
        qs, vs, taus = value(q), value(v), value(tau)
        if not (isinstance(q, Dual) or isinstance(v, Dual) or isinstance(tau, Dual)):
            return self._each(pin.aba, qs, vs, taus)
        data = self._data
        views = (data.ddq, data.ddq_dq, data.ddq_dv, data.Minv)
        a, dq, dv, inverse = self._collect(pin.computeABADerivatives, self._model, data, views, qs, vs, taus)
        return chain(a, (lambda: dq, q), (lambda: dv, v), (lambda: symmetric(inverse), tau))

    def mass(self, q: Vector, x: Vector) -> Array | Dual:
        """M(q) x."""
        if isinstance(q, Dual):
            data = self._still_data
            views = (data.tau, data.dtau_dq, data.M)
            tau, dq, M = self._collect(pin.computeRNEADerivatives, self._still, data, views, q.value, None, value(x))
            return chain(tau, (lambda: dq, q), (lambda: symmetric(M), x))
        M = self.at(value(q)).M
        return chain(times(M, value(x)), (lambda: M, x))

    def solve_mass(self, q: Vector, f: Vector) -> Array | Dual:
        """M(q)^-1 f."""
        if isinstance(q, Dual):
            data = self._still_data
            views = (data.ddq, data.ddq_dq, data.Minv)
            a, dq, inverse = self._collect(pin.computeABADerivatives, self._still, data, views, q.value, None, value(f))
            return chain(a, (lambda: dq, q), (lambda: symmetric(inverse), f))
        inverse = self.at(value(q)).M_inverse
        return chain(times(inverse, value(f)), (lambda: inverse, f))

    def gravity(self, q: Vector) -> Array | Dual:
        """g(q)."""
        if isinstance(q, Dual):
            data = self._data
            g, dq = self._collect(pin.computeRNEADerivatives, self._model, data, (data.tau, data.dtau_dq), q.value, None, None)
            return Dual(g, dq @ q.tangent)
        return self._each(pin.computeGeneralizedGravity, value(q))

    def friction(self, v: Vector) -> Array | Dual:
        """Joint friction of the plant: viscous v + coulomb tanh(v / coulomb_speed)."""
        robot = self.robot
        out = v * robot.viscous
        if self._coulomb is None:
            return out
        slope = 1 / robot.coulomb_speed
        return out + robot.coulomb * elementwise(v, lambda x: np.tanh(slope * x), lambda x: slope / np.cosh(np.clip(slope * x, -300, 300)) ** 2)

    # --- kinematics ----------------------------------------------------------------------------------------------

    def pose(self, q: Vector) -> Pose:
        """Tool pose X; its tangent is the body twist J dq."""
        at = self.at(value(q))
        return Pose(at.R, at.p, at.J @ q.tangent if isinstance(q, Dual) else None)

    def jacobian(self, q: Vector, x: Vector) -> Array | Dual:
        """J_b(q) x: for x = v the body twist of the tool (linear, angular)."""
        at = self.at(value(q))
        xs = value(x)
        return chain(times(at.J, xs), (lambda: at.bracketed(xs), q), (lambda: at.J, x))

    def jacobian_transpose(self, q: Vector, f: Vector) -> Array | Dual:
        """J_b(q)^T f: joint torques of a tool wrench, equation 9.19."""
        at = self.at(value(q))
        fs = value(f)
        return chain(times(at.J_T, fs), (lambda: self._transposed_derivative(at.J, fs), q), (lambda: at.J_T, f))

    def jacobian_dot(self, q: Vector, v: Vector) -> Array | Dual:
        """(dJ_b/dt) v at velocity v: the tool acceleration minus J a."""
        qs, vs = value(q), value(v)
        if not isinstance(q, Dual) and not isinstance(v, Dual):
            return self._each(self._drift, qs, vs, size=6)
        at = self.at(qs)
        K = at.bracketed(vs)
        dq, dv = self._jacobian_dot_derivatives(at.J, K, vs)
        return chain(times(K, vs), (lambda: dq, q), (lambda: dv, v))

    def _drift(self, model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
        pin.forwardKinematics(model, data, q, v, self._zero)  # without joint accelerations the frame has this one
        return np.asarray(pin.getFrameAcceleration(model, data, self.robot.frame_id, pin.LOCAL).vector)

    def solve_jacobian(self, q: Vector, x: Vector, damping: float = 0.0) -> Array | Dual:
        """The joint velocity of a body twist x: J^-1 x, or by the pseudo-inverse; with damping [-] by J^T (J J^T + damping^2)^-1.

        Raises NearSingular above condition number 1e6 (unless damped).
        """
        at = self.at(value(q))
        xs = value(x)
        if self.n < 6 and damping == 0.0:
            return self._solve_tall(at, q, x)
        if damping == 0.0:
            at.check_regular()
        if self.n == 6 and damping == 0.0:
            inverse = at.J_inverse
            y = times(inverse, xs)
            return chain(y, (lambda: -inverse @ self._bracketed(at.J, y), q), (lambda: inverse, x))
        W: Array = np.asarray(np.linalg.inv(at.J @ at.J_T + damping**2 * np.eye(6)), float)
        u = times(W, xs)
        y = times(at.J_T, u)

        def dq() -> Array:
            turned = self._transposed_derivative(at.J, u)  # d(J^T) u
            return turned - at.J_T @ (W @ (self._bracketed(at.J, y) + at.J @ turned))

        return chain(y, (dq, q), (lambda: at.J_T @ W, x))

    def _solve_tall(self, at: Configuration, q: Vector, x: Vector) -> Array | Dual:
        """Least squares for arms with fewer than six joints: (J^T J)^-1 J^T x."""
        at.check_regular()
        W = np.linalg.inv(at.J_T @ at.J)
        y = times(W @ at.J_T, value(x))
        rest = value(x) - times(at.J, y)

        def dq() -> Array:
            return W @ (self._transposed_derivative(at.J, rest) - at.J_T @ self._bracketed(at.J, y))

        return chain(y, (dq, q), (lambda: W @ at.J_T, x))

    def mobility(self, q: Vector, f: Vector, mass: Array | None = None) -> Array | Dual:
        """Lambda(q)^-1 f = J M^-1 J^T f. ``mass``: a constant (n, n) matrix in place of M(q)."""
        tau = self.jacobian_transpose(q, f)
        return self.jacobian(q, self.solve_mass(q, tau) if mass is None else matvec(np.asarray(np.linalg.inv(mass), float), tau))

    def task_mass(self, q: Vector, x: Vector, damping: float = 0.0, mass: Array | None = None) -> Array | Dual:
        """Lambda(q) x with Lambda = (J M^-1 J^T)^-1: equation 9.15. ``mass``: a constant (n, n) matrix in place of M(q).

        With damping [-] (J M^-1 J^T + damping^2 n / trace(M))^-1, which also exists at a singularity. Raises NearSingular as ``solve_jacobian``.
        """
        at = self.at(value(q))
        softening = None
        if mass is None and damping == 0.0:
            Lambda = at.Lambda
        else:
            if damping == 0.0:
                at.check_regular()
            soft, softening = self.softness(q, damping, mass)
            Lambda = np.asarray(np.linalg.inv(at.J @ np.linalg.solve(at.M if mass is None else mass, at.J_T) + soft * np.eye(6)), float)
        y = times(Lambda, value(x))
        if not isinstance(q, Dual):
            return chain(y, (lambda: Lambda, x))
        back = self.mobility(q, y, mass)  # Lambda^-1 y with y held: its tangent is d(Lambda^-1) y
        assert isinstance(back, Dual)
        tangent = x.tangent - back.tangent if isinstance(x, Dual) else -back.tangent
        if softening is not None:
            tangent = tangent + y[..., None] * softening
        return Dual(y, Lambda @ tangent)

    def softness(self, q: Vector, damping: float, mass: Array | None = None) -> tuple[Array, Array | None]:
        """d = damping^2 n / trace(M) (..., 1, 1), and minus its tangent (..., 1, N); None where d is constant."""
        M = self.at(value(q)).M if mass is None else mass
        trace = np.trace(M, axis1=-2, axis2=-1)[..., None, None]
        soft = damping**2 * self.n / trace
        if mass is not None or not damping or not isinstance(q, Dual):
            return soft, None
        diagonal = [self.mass(q, axis)[i : i + 1] for i, axis in enumerate(np.eye(self.n))]
        rates = [part.tangent for part in diagonal if isinstance(part, Dual)]
        return soft, np.asarray(soft / trace * sum(rates))

    # --- loops over Pinocchio calls ------------------------------------------------------------------------------

    def _with_viscous(self, tau: Array | Dual, v: Vector) -> Array | Dual:
        return tau if self._viscous is None else tau + v * self._viscous

    def _single(self, q: Vector, v: Vector, a: Vector) -> bool:
        """True for plain vectors (n,) of one point that Pinocchio takes as they are."""
        one = np.ndarray
        return self._plain and type(q) is one and type(v) is one and type(a) is one and q.ndim == v.ndim == a.ndim == 1

    def _configurations(self, q: Array) -> Array:
        return np.ascontiguousarray(q if self._plain else self.robot.configuration(q)).reshape(-1, self._model.nq)

    def _each(self, call: Callable[..., Array], q: Array, *more: Array, size: int | None = None) -> Array:
        """A function of (model, data, q, ...) with Pinocchio, at every point: its values (n,), or ``size`` of them that belong to no joint."""
        model, data = self._model, self._data
        if q.ndim == 1 and self._order is None and all(x.ndim == 1 for x in more):
            return np.array(call(model, data, q if self._plain else self.robot.configuration(q), *more))
        lead, columns = self._columns(q, more)
        out = np.empty((math.prod(lead), size or self.n))
        for i, at in enumerate(zip(*columns, strict=False)):
            out[i] = call(model, data, *at)
        return (out if self._order is None or size else out[:, self._back]).reshape(*lead, out.shape[-1])

    def _columns(self, q: Array, more: tuple[Array | None, ...]) -> tuple[tuple[int, ...], list[Iterable[Array]]]:
        """The leading axes of all arguments together, and each of them point by point (None: zeros)."""
        if self._plain and q.ndim == 2 and all(x is not None and x.shape == q.shape for x in more):  # what the rest would come to
            return q.shape[:1], [q, *(x for x in more if x is not None)]
        lead = _lead(q, more)
        columns: list[Iterable[Array]] = [self._configurations(spread(q, lead))]
        for x in more:
            if x is None:
                columns.append(repeat(self._zero))
                continue
            x = spread(x, lead).reshape(-1, self.n)
            columns.append(np.ascontiguousarray(x if self._order is None else x[:, self._order]))
        return lead, columns

    def _collect(
        self, call: Callable[..., object], model: pin.Model, data: pin.Data, views: tuple[Array, ...], q: Array, *more: Array | None
    ) -> list[Array]:
        """Calls at every point (None: zeros) and copies Pinocchio's arrays, which each call overwrites, into batches."""
        if q.ndim == 1 and self._plain and all(x is None or x.ndim == 1 for x in more):
            call(model, data, q, *[self._zero if x is None else x for x in more])
            return [view.copy() for view in views]
        lead, columns = self._columns(q, more)
        outs = [np.empty((math.prod(lead), *view.shape)) for view in views]
        pairs = list(zip(outs, views, strict=True))
        for i, at in enumerate(zip(*columns, strict=False)):
            call(model, data, *at)
            for out, view in pairs:
                out[i] = view
        if self._order is not None:
            outs = [out[:, self._back] if out.ndim == 2 else out[:, self._back[:, None], self._back] for out in outs]
        return [out.reshape(*lead, *out.shape[1:]) for out in outs]

    # --- derivatives of the Jacobian by brackets -----------------------------------------------------------------

    def _along(self, J: Array, *more: Array) -> list[Array]:
        """Into chain order, in which brackets are sums over earlier joints."""
        return [x if self._order is None else x[..., self._order] for x in (J, *more)]

    def _unordered(self, columns: Array) -> Array:
        return columns if self._order is None else columns[..., self._back]

    def _bracketed(self, J: Array, x: Array) -> Array:
        """d(J x)/dq with x held: column j is [sum over i < j of J_i x_i, J_j], (..., 6, n)."""
        J, x = self._along(J, x)
        parts = J * x[..., None, :]
        return self._unordered(bracket_columns(np.cumsum(parts, axis=-1) - parts, J))

    def _transposed_derivative(self, J: Array, f: Array) -> Array:
        """d(J^T f)/dq with f held: entry (i, j) is [J_i, J_j] . f for j after i, (..., n, n)."""
        (J,) = self._along(J)
        G = np.empty(np.broadcast_shapes(J.shape, (*f.shape, J.shape[-1])))
        fv, fm = f[..., :3, None], f[..., 3:, None]
        v, w = J[..., :3, :], J[..., 3:, :]
        G[..., :3, :] = cross_columns(w, fv)
        G[..., 3:, :] = cross_columns(v, fv) + cross_columns(w, fm)
        out = np.triu(np.swapaxes(J, -1, -2) @ G, 1)
        return out if self._order is None else out[..., self._back[:, None], self._back]

    def _jacobian_dot_derivatives(self, J: Array, K: Array, v: Array) -> tuple[Array, Array]:
        """d(J' v)/dq and d(J' v)/dv, (..., 6, n) each."""
        J, K, v = self._along(J, K, v)
        Jv, Kv = J * v[..., None, :], K * v[..., None, :]
        before = np.cumsum(Kv, axis=-1) - Kv  # acceleration of the joints before joint k
        after = np.sum(Jv, axis=-1, keepdims=True) - np.cumsum(Jv, axis=-1)  # twist of the joints after joint k
        dq = bracket_columns(before, J) + bracket_columns(K, Jv + after)
        dv = K + bracket_columns(J, after)
        return self._unordered(dq), self._unordered(dv)


class Configuration:
    """M, J, X and their inverses at q (..., n), each computed at first use."""

    def __init__(self, primitives: Primitives, q: Array) -> None:
        self.q = q
        self._of = primitives
        self._held: tuple[Array, Array] | None = None

    @cached_property
    def _kinematics(self) -> tuple[Array, Array, Array]:
        of = self._of
        model, data, frame = of._model, of._data, of.robot.frame_id
        if self.q.ndim == 1 and of._plain:  # one point, in half the time
            pin.computeJointJacobians(model, data, np.ascontiguousarray(self.q))
            J = np.array(pin.getFrameJacobian(model, data, frame, pin.LOCAL), order="C").reshape(6, of.n)
            X = np.array(pin.updateFramePlacement(model, data, frame).homogeneous, order="C")
            return J, X[:3, :3], X[:3, 3]
        points = of._configurations(self.q)
        J, X = np.empty((len(points), 6, of.n)), np.empty((len(points), 4, 4))
        each = J if of.n > 1 else J[..., 0]  # as Pinocchio gives it
        for i, at in enumerate(points):
            pin.computeJointJacobians(model, data, at)
            each[i] = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            X[i] = pin.updateFramePlacement(model, data, frame).homogeneous
        lead = self.q.shape[:-1]
        X = X.reshape(*lead, 4, 4)
        return of._unordered(J).reshape(*lead, 6, of.n), X[..., :3, :3], X[..., :3, 3]

    @property
    def J(self) -> Array:
        """Body Jacobian (..., 6, n)."""
        same = self._same
        return same._kinematics[0] if "_kinematics" in vars(same) else same._J

    @cached_property
    def _same(self) -> Configuration:
        """The configuration that computes J and X of this one."""
        like = self._of._like
        return self if like is None else like.at(self.q)

    @cached_property
    def _J(self) -> Array:
        """J where the pose is not needed: two thirds of the time."""
        of = self._of
        model, data, frame = of._model, of._data, of.robot.frame_id
        points = of._configurations(self.q)
        J = np.empty((len(points), 6, of.n))
        each = J if of.n > 1 else J[..., 0]  # as Pinocchio gives it
        for i, at in enumerate(points):
            each[i] = pin.computeFrameJacobian(model, data, at, frame, pin.LOCAL)
        return of._unordered(J).reshape(*self.q.shape[:-1], 6, of.n)

    def bracketed(self, x: Array) -> Array:
        """d(J x)/dq with x held, (..., 6, n); kept for a repeated call with the same array, as J v and J' v make it."""
        if self._held is None or self._held[0] is not x:
            self._held = x, self._of._bracketed(self.J, x)
        return self._held[1]

    @property
    def R(self) -> Array:
        """Tool rotation (..., 3, 3)."""
        return self._same._kinematics[1]

    @property
    def p(self) -> Array:
        """Tool position (..., 3)."""
        return self._same._kinematics[2]

    @cached_property
    def J_T(self) -> Array:
        """J^T, (..., n, 6)."""
        return np.ascontiguousarray(np.swapaxes(self.J, -1, -2))

    @cached_property
    def M(self) -> Array:
        """Mass matrix (..., n, n), armature included."""
        of = self._of
        if of._plain and self.q.ndim == 1:
            return symmetric(np.array(pin.crba(of._model, of._data, self.q)))
        (M,) = of._collect(pin.crba, of._model, of._data, (of._data.M,), self.q)
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


def _lead(q: Array, more: tuple[Array | None, ...]) -> tuple[int, ...]:
    """The leading axes of vectors (..., n) together."""
    lead = q.shape[:-1]
    if all(x is None or x.ndim == 1 or x.shape[:-1] == lead for x in more):
        return lead
    return np.broadcast_shapes(lead, *(x.shape[:-1] for x in more if x is not None))


@cache
def _below(n: int) -> tuple[Ints, Ints]:
    """Places of the entries below the diagonal and of those that mirror them, in a matrix (n, n) row by row."""
    i, j = np.tril_indices(n, -1)
    return i * n + j, j * n + i


def symmetric(upper: Array) -> Array:
    """The full symmetric matrices (..., n, n) from the upper triangle that Pinocchio fills."""
    n = upper.shape[-1]
    below, above = _below(n)
    full = np.ascontiguousarray(upper)
    rows = full.reshape(*full.shape[:-2], n * n)  # a view
    rows[..., below] = rows[..., above]
    return full


def cross_columns(a: Array, b: Array) -> Array:
    """Cross products of the columns of (..., 3, n) arrays."""
    ax, ay, az = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    bx, by, bz = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    x = ay * bz - az * by
    out = np.empty((*x.shape[:-1], 3, x.shape[-1]))
    out[..., 0, :], out[..., 1, :], out[..., 2, :] = x, az * bx - ax * bz, ax * by - ay * bx
    return out


def bracket_columns(V: Array, W: Array) -> Array:
    """[V_j, W_j] for the columns of (..., 6, n) twists."""
    v, w, x, y = V[..., :3, :], V[..., 3:, :], W[..., :3, :], W[..., 3:, :]
    return np.concatenate([cross_columns(w, x) + cross_columns(v, y), cross_columns(w, y)], axis=-2)
