"""The functions that laws are written in: rnea, aba, M x, g, J x, J^T f, J^-1 x, Lambda x, for plain and dual arrays, in batches.

Each primitive acts on vectors and has an exact derivative: Pinocchio's analytic derivatives for the dynamics, brackets of the
columns of the body Jacobian for the kinematics (d J_i / d q_j is [J_i, J_j] for j after i on the chain), and the implicit rule
for inverses (y = S^-1 b has tangent S^-1 (db - dS y)). Values are ``(..., n)`` in the user's joint order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, chain, elementwise, matvec, times, value
from mfc_analysis.maths.se3 import Pose
from mfc_analysis.robots.brackets import bracketed, jacobian_dot_derivatives, transposed_derivative
from mfc_analysis.robots.calls import Calls, one_point, symmetric
from mfc_analysis.robots.configuration import Configuration

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
        self._calls = Calls(robot)
        self._model = self._calls.model
        self._data = self._calls.data
        self._plain = self._calls.plain
        self._of_rnea = (self._data.tau, self._data.dtau_dq, self._data.dtau_dv, self._data.M)  # views of what the derivatives of rnea and
        self._of_aba = (self._data.ddq, self._data.ddq_dq, self._data.ddq_dv, self._data.Minv)  # aba leave in Pinocchio's Data
        self._still = robot.model.copy()  # the same arm without gravity: M x = rnea(q, 0, x)
        self._still.gravity = pin.Motion.Zero()
        self._still_data = self._still.createData()
        self._viscous = robot.viscous if np.any(robot.viscous) else None
        self._coulomb = robot.coulomb if np.any(robot.coulomb) else None
        self.rubs = self._viscous is not None or self._coulomb is not None  #: True where the robot has joint friction
        self._seen: list[Configuration] = []
        self._like: Primitives | None = None
        self._like = like if like is not None and self._moves_like(like) else None

    def __reduce__(self) -> tuple[type[Primitives], tuple[Robot, Primitives | None]]:  # without Pinocchio's Data and what is cached
        return type(self), (self.robot, self._like)

    def at(self, q: Array) -> Configuration:
        """M, J, X at the configurations q (..., n), cached for repeated calls with the same array."""
        for known in self._seen:
            if known.q is q:
                return known
        new = Configuration(self._calls, q, None if self._like is None else self._like.at)
        self._seen = [new, *self._seen[:2]]
        return new

    def _moves_like(self, other: Primitives) -> bool:
        """True where J and X are the same at all q: by the product of exponentials they are, if they are at one."""
        one, two = self._model, other._model
        if self.n != other.n or list(one.parents) != list(two.parents) or not np.array_equal(self._calls.back, other._calls.back):
            return False
        q = np.full(self.n, 0.3)
        return all(np.array_equal(a, b) for a, b in zip(self.at(q).kinematics, other.at(q).kinematics, strict=True))

    # --- dynamics ------------------------------------------------------------------------------------------------

    def rnea(self, q: Vector, v: Vector, a: Vector) -> Array | Dual:
        """M(q) a + C(q, v) v + g(q) [Nm or N], without friction: equation 9.7."""
        if self._plain and one_point(q, v, a):
            return np.array(pin.rnea(self._model, self._data, q, v, a))
        qs, vs, accelerations = value(q), value(v), value(a)
        if not (isinstance(q, Dual) or isinstance(v, Dual) or isinstance(a, Dual)):
            return self._calls.each(pin.rnea, qs, vs, accelerations)
        if not isinstance(q, Dual) and not isinstance(v, Dual):
            M = self.at(qs).M
            return chain(self._calls.each(pin.rnea, qs, vs, accelerations), (lambda: M, a))
        tau, dq, dv, da = self._calls.collect(pin.computeRNEADerivatives, self._model, self._data, self._of_rnea, qs, vs, accelerations)
        return chain(tau, (lambda: dq, q), (lambda: dv, v), (lambda: symmetric(da), a))

    def inverse_dynamics(self, q: Vector, v: Vector, a: Vector) -> Array | Dual:
        """M(q) a + h(q, v) with the viscous friction of the model in h, as a controller computes it."""
        return self._with_viscous(self.rnea(q, v, a), v)

    def bias(self, q: Vector, v: Vector) -> Array | Dual:
        """h(q, v) = C(q, v) v + g(q) + viscous friction of this model, as a controller computes it."""
        return self.inverse_dynamics(q, v, np.zeros(self.n))

    def aba(self, q: Vector, v: Vector, tau: Vector) -> Array | Dual:
        """q'' = M(q)^-1 (tau - C v - g), without friction: equation 9.7 solved."""
        if self._plain and one_point(q, v, tau):
            return np.array(pin.aba(self._model, self._data, q, v, tau))
        qs, vs, taus = value(q), value(v), value(tau)
        if not (isinstance(q, Dual) or isinstance(v, Dual) or isinstance(tau, Dual)):
            return self._calls.each(pin.aba, qs, vs, taus)
        a, dq, dv, inverse = self._calls.collect(pin.computeABADerivatives, self._model, self._data, self._of_aba, qs, vs, taus)
        return chain(a, (lambda: dq, q), (lambda: dv, v), (lambda: symmetric(inverse), tau))

    def mass(self, q: Vector, x: Vector) -> Array | Dual:
        """M(q) x."""
        if isinstance(q, Dual):
            data = self._still_data
            views = (data.tau, data.dtau_dq, data.M)
            tau, dq, M = self._calls.collect(pin.computeRNEADerivatives, self._still, data, views, q.value, None, value(x))
            return chain(tau, (lambda: dq, q), (lambda: symmetric(M), x))
        M = self.at(value(q)).M
        return chain(times(M, value(x)), (lambda: M, x))

    def solve_mass(self, q: Vector, f: Vector) -> Array | Dual:
        """M(q)^-1 f."""
        if isinstance(q, Dual):
            data = self._still_data
            views = (data.ddq, data.ddq_dq, data.Minv)
            a, dq, inverse = self._calls.collect(pin.computeABADerivatives, self._still, data, views, q.value, None, value(f))
            return chain(a, (lambda: dq, q), (lambda: symmetric(inverse), f))
        inverse = self.at(value(q)).M_inverse
        return chain(times(inverse, value(f)), (lambda: inverse, f))

    def gravity(self, q: Vector) -> Array | Dual:
        """g(q)."""
        if isinstance(q, Dual):
            data = self._data
            g, dq = self._calls.collect(pin.computeRNEADerivatives, self._model, data, (data.tau, data.dtau_dq), q.value, None, None)
            return Dual(g, dq @ q.tangent)
        return self._calls.each(pin.computeGeneralizedGravity, value(q))

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
        return chain(times(at.J_T, fs), (lambda: transposed_derivative(self._calls, at.J, fs), q), (lambda: at.J_T, f))

    def jacobian_dot(self, q: Vector, v: Vector) -> Array | Dual:
        """(dJ_b/dt) v at velocity v: the tool acceleration minus J a."""
        qs, vs = value(q), value(v)
        if not isinstance(q, Dual) and not isinstance(v, Dual):
            return self._calls.each(self._drift, qs, vs, size=6)
        at = self.at(qs)
        K = at.bracketed(vs)
        dq, dv = jacobian_dot_derivatives(self._calls, at.J, K, vs)
        return chain(times(K, vs), (lambda: dq, q), (lambda: dv, v))

    def _drift(self, model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
        pin.forwardKinematics(model, data, q, v, self._calls.zero)  # without joint accelerations the frame has this one
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
            return chain(y, (lambda: -inverse @ bracketed(self._calls, at.J, y), q), (lambda: inverse, x))
        W: Array = np.asarray(np.linalg.inv(at.J @ at.J_T + damping**2 * np.eye(6)), float)
        u = times(W, xs)
        y = times(at.J_T, u)

        def dq() -> Array:
            turned = transposed_derivative(self._calls, at.J, u)  # d(J^T) u
            return turned - at.J_T @ (W @ (bracketed(self._calls, at.J, y) + at.J @ turned))

        return chain(y, (dq, q), (lambda: at.J_T @ W, x))

    def _solve_tall(self, at: Configuration, q: Vector, x: Vector) -> Array | Dual:
        """Least squares for arms with fewer than six joints: (J^T J)^-1 J^T x."""
        at.check_regular()
        W = np.linalg.inv(at.J_T @ at.J)
        y = times(W @ at.J_T, value(x))
        rest = value(x) - times(at.J, y)

        def dq() -> Array:
            return W @ (transposed_derivative(self._calls, at.J, rest) - at.J_T @ bracketed(self._calls, at.J, y))

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

    def _with_viscous(self, tau: Array | Dual, v: Vector) -> Array | Dual:
        return tau if self._viscous is None else tau + v * self._viscous
