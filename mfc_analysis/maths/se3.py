"""Rigid motions: exponential, logarithm and its derivative, adjoint; poses, for plain and dual arrays.

Twists and wrenches are (linear, angular). A pose is a 4x4 matrix, ``(..., 4, 4)``, or a ``Pose`` with derivatives, whose
tangent is a body twist. ``Jlog6`` is a closed form with a series below 0.5 rad: at the small angles of a tracking error it is
exact to rounding (Bullo & Murray, "Proportional derivative (PD) control on the Euclidean group", 1995, give the four-bracket
form).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.errors import BadArgument, NearPi
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, chain, concatenate, elementwise, matvec, times, total, value

#: (y/2) cot(y/2) = 1 - sum a_k y^(2k): Bernoulli numbers over factorials, k = 1..8
_A = np.array([1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600, 3617 / 10670622842880000])
_A_DOWN = _A[::-1].tolist()
_FAR = np.array([2 * sum(n ** (-2.0 * k) for n in range(1, 40)) / (2 * np.pi) ** (2 * k) for k in range(9, 41)])  #: the same for k = 9..40
MOST = np.pi - 1e-3  #: [rad] largest angle of which a logarithm is taken in a loop
_FIRST, _SECOND = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])  #: components of the factors of a cross product
_SMALL = 0.25  # theta^2 below which the series is used


def hat(w: Array) -> Array:
    """(..., 3) -> skew matrix (..., 3, 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def cross(a: Array, b: Array) -> Array:
    """Plain cross product of (..., 3) arrays (faster than numpy's for small arrays)."""
    if a.ndim == b.ndim == 1:
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    products = a[..., _FIRST] * b[..., _SECOND]
    return np.asarray(products[..., :3] - products[..., 3:])


def cross_product(a: Vector, b: Vector) -> Array | Dual:
    """a x b of (..., 3) vectors, plain or dual."""
    return chain(cross(value(a), value(b)), (lambda: -hat(value(b)), a), (lambda: hat(value(a)), b))


def coadjoint(V: Vector, F: Vector) -> Array | Dual:
    """ad(V)^T F of a twist and a wrench, plain or dual (..., 6)."""
    v, w, f, m = (part(x) for x in (V, F) for part in (linear, angular))
    return concatenate([cross_product(f, w), cross_product(f, v) + cross_product(m, w)])


def linear(V: Vector) -> Vector:
    """(..., 3) the first half of a twist or wrench, plain or dual."""
    return V[:3] if isinstance(V, Dual) else np.asarray(V)[..., :3]


def angular(V: Vector) -> Vector:
    """(..., 3) the second half."""
    return V[3:] if isinstance(V, Dual) else np.asarray(V)[..., 3:]


def ad(V: Array) -> Array:
    """(..., 6) -> (..., 6, 6) with ad(V) W = [V, W]."""
    out = np.zeros((*V.shape[:-1], 6, 6))
    w = hat(V[..., 3:])
    out[..., :3, :3] = out[..., 3:, 3:] = w
    out[..., :3, 3:] = hat(V[..., :3])
    return out


def bracket(V: Vector, W: Vector) -> Array | Dual:
    """[V, W] = ad(V) W of two twists, plain or dual (..., 6)."""
    v, w = value(V), value(W)
    out = np.concatenate([cross(v[..., 3:], w[..., :3]) + cross(v[..., :3], w[..., 3:]), cross(v[..., 3:], w[..., 3:])], axis=-1)
    return chain(out, (lambda: -ad(w), V), (lambda: ad(v), W))


def adjoint(X: Array) -> Array:
    """Ad of poses (..., 4, 4) -> (..., 6, 6)."""
    out = np.zeros((*X.shape[:-2], 6, 6))
    R = X[..., :3, :3]
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = hat(X[..., :3, 3]) @ R
    return out


def inverse(X: Array) -> Array:
    """Inverse of poses (..., 4, 4)."""
    out = np.zeros_like(X)
    Rt = np.swapaxes(X[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -times(Rt, X[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def transform(R: Array, p: Array) -> Array:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and positions (..., 3)."""
    lead = np.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    out = np.zeros((*lead, 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = R, p, 1.0
    return out


def exp3(w: Array) -> Array:
    """Rotation vectors (..., 3) -> rotations (..., 3, 3)."""
    w = np.asarray(w, float)
    s = np.sum(w * w, axis=-1)[..., None, None]
    theta = np.sqrt(s)
    W = hat(w)
    return np.asarray(np.eye(3) + np.sinc(theta / np.pi) * W + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * (W @ W), float)


def exp6(V: Array) -> Array:
    """Twists (..., 6) -> poses (..., 4, 4)."""
    V = np.asarray(V, float)
    v, w = V[..., :3], V[..., 3:]
    s = np.sum(w * w, axis=-1)
    theta = np.sqrt(s)
    b = 0.5 * np.sinc(theta / (2 * np.pi)) ** 2
    safe = np.where(s < _SMALL, 1.0, s)
    c = np.where(s < _SMALL, 1 / 6 - s / 120 + s**2 / 5040 - s**3 / 362880 + s**4 / 39916800, (1 - np.sinc(theta / np.pi)) / safe)
    wv = cross(w, v)
    return transform(exp3(w), v + b[..., None] * wv + c[..., None] * cross(w, wv))


def log3(R: Array) -> Array:
    """Rotations (..., 3, 3) -> rotation vectors (..., 3), angle below pi."""
    axis, theta = _axis_and_angle(R)
    return np.asarray(axis / np.sinc(theta / np.pi)[..., None], float)


def _axis_and_angle(R: Array) -> tuple[Array, Array]:
    """(..., 3) the axis times the sine of the angle, and the angle (...,) [rad]."""
    entries = R.reshape(*R.shape[:-2], 9)
    axis = 0.5 * (entries[..., [7, 2, 3]] - entries[..., [5, 6, 1]])
    return axis, np.arctan2(np.sqrt((axis * axis).sum(axis=-1)), 0.5 * (entries[..., [0, 4, 8]].sum(axis=-1) - 1))


def rotation_vector(R: Array) -> Array:
    """``log3``. Raises ``NearPi`` within 1e-3 rad of pi."""
    if R.ndim == 2:
        x, y, z, angle = _log3_of_one(R)
        if angle > MOST:
            raise NearPi(angle)
        return np.array([x, y, z])
    axis, theta = _axis_and_angle(R)
    if np.any(theta > MOST):
        raise NearPi(float(np.max(theta)), index=int(np.argmax(theta)))
    return np.asarray(axis / np.sinc(theta / np.pi)[..., None], float)


def Jlog3(w: Array) -> Array:
    """d log3(R exp3(d)) / d d at log3(R) = w: (..., 3) -> (..., 3, 3), I + hat(w) / 2 + c hat(w)^2."""
    if w.ndim == 1:
        x, y, z = w.tolist()
        c = _factor_of_one(x * x + y * y + z * z)
        xy, xz, yz, xx, yy, zz = c * x * y, c * x * z, c * y * z, c * x * x, c * y * y, c * z * z
        x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
        return np.array([[1 - yy - zz, xy - z, xz + y], [xy + z, 1 - xx - zz, yz - x], [xz - y, yz + x, 1 - xx - yy]])
    W = hat(w)
    return np.eye(3) + 0.5 * W + _one_minus_alpha_over_s(np.sum(w * w, axis=-1))[..., None, None] * (W @ W)


def Jlog3_slope(w: Array, y: Array) -> Array:
    """d (Jlog3(w) y) / d w of a constant y: (..., 3), (..., 3) -> (..., 3, 3)."""
    s = np.sum(w * w, axis=-1)[..., None, None]
    A, B, dA, dB = _coefficients(s)
    wy = cross(w, y)
    turned = cross(w, wy)[..., :, None] * w[..., None, :]
    return np.asarray(-0.5 * hat(y) - (A - s * B) * (hat(wy) + hat(w) @ hat(y)) + 2 * (dA - B - s * dB) * turned, float)


def log6(X: Array) -> Array:
    """Poses (..., 4, 4) -> twists (..., 6), exact for rotation angles below pi."""
    if X.ndim == 2:
        return _log6_of_one(X[:3, :3], X[:3, 3])[0]
    return _with_rotation(log3(X[..., :3, :3]), X[..., :3, 3])


def _with_rotation(w: Array, p: Array) -> Array:
    """``log6`` of poses with positions p, whose rotations have the logarithms w."""
    wp = cross(w, p)
    c = _one_minus_alpha_over_s(np.sum(w * w, axis=-1))
    return np.concatenate([p - 0.5 * wp + c[..., None] * cross(w, wp), w], axis=-1)


def _log6_of_one(R: Array, p: Array) -> tuple[Array, float]:
    """``log6`` of one pose, and its angle: the same formulas on numbers, in a tenth of the time."""
    x, y, z, angle = _log3_of_one(R)
    factor = _factor_of_one(x * x + y * y + z * z)
    u, v, w = p.tolist()
    m, n, o = y * w - z * v, z * u - x * w, x * v - y * u
    return np.array([
        u - 0.5 * m + factor * (y * o - z * n), v - 0.5 * n + factor * (z * m - x * o), w - 0.5 * o + factor * (x * n - y * m), x, y, z,
    ]), angle  # fmt: skip


def _log3_of_one(R: Array) -> tuple[float, float, float, float]:
    """``log3`` of one rotation, and its angle, likewise."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    theta = math.atan2(math.sqrt(x * x + y * y + z * z), 0.5 * (a + e + i - 1.0))
    k = theta / math.sin(theta) if theta > 1e-150 else 1.0
    return k * x, k * y, k * z, theta


def _factor_of_one(s: float) -> float:
    """``_one_minus_alpha_over_s`` of one number."""
    if s < _SMALL:
        factor = 0.0
        for a_k in _A_DOWN:
            factor = factor * s + a_k
        return factor
    half = 0.5 * math.sqrt(s)
    return (1 - half / math.tan(half)) / s


def Jlog6(xi: Array) -> Array:
    """d log(X exp(d)) / d d at log X = xi: (..., 6) -> (..., 6, 6), a body twist in, the rate of the logarithm out."""
    A, B, _, _ = _coefficients(np.sum(xi[..., 3:] ** 2, axis=-1))
    a = ad(xi)
    a2 = a @ a
    return np.eye(6) + 0.5 * a + A[..., None, None] * a2 + B[..., None, None] * (a2 @ a2)


def log_rate(xi: Vector, V: Vector) -> Array | Dual:
    """The rate of log X when X moves with body twist V: Jlog6(xi) V; both arguments plain or dual."""
    if not isinstance(xi, Dual):
        return matvec(Jlog6(np.asarray(xi)), V)
    A, B = log_coefficients(xi)
    a1 = bracket(xi, V)
    a2 = bracket(xi, a1)
    a4 = bracket(xi, bracket(xi, a2))
    return V + 0.5 * a1 + A * a2 + B * a4


def log_rate_transposed(xi: Vector, F: Vector) -> Vector:
    """Jlog6(xi)^T F; both arguments plain or dual."""
    A, B = log_coefficients(xi)
    f1 = coadjoint(xi, F)
    f2 = coadjoint(xi, f1)
    return F + 0.5 * f1 + A * f2 + B * coadjoint(xi, coadjoint(xi, f2))


def log_slope(xi: Vector, eta: Vector, V: Vector) -> Vector:
    """d/dh of Jlog6(xi + h eta) V at h = 0, V held; all arguments plain or dual (..., 6). Rotations up to pi."""
    a, b = _series()
    w = angular(xi)
    square = total(w * w)
    ds = 2.0 * total(w * angular(eta))
    A, B, dA, dB = (elementwise(square, *_polynomial(np.asarray(p, float))) for p in (a, b, np.polyder(a), np.polyder(b)))
    a1, e1 = bracket(xi, V), bracket(eta, V)
    a2, e2 = bracket(xi, a1), bracket(eta, a1) + bracket(xi, e1)
    a3 = bracket(xi, a2)
    e4 = bracket(eta, a3) + bracket(xi, bracket(eta, a2) + bracket(xi, e2))
    return 0.5 * e1 + (dA * ds) * a2 + A * e2 + (dB * ds) * bracket(xi, a3) + B * e4


def _series() -> tuple[Array, Array]:
    """A and B of ``_coefficients`` as polynomials in theta^2, highest power first, exact to rounding up to an angle of pi."""
    whole = np.concatenate([_A, _FAR])
    k = np.arange(1, whole.size + 1)
    a, b = (np.asarray((j - k) * whole, float) for j in (2, 1))
    return a[::-1], b[:0:-1]


def _polynomial(p: Array) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """A polynomial and its derivative, as functions of an array."""
    slope = np.polyder(p)
    return lambda s: np.asarray(np.polyval(p, s), float), lambda s: np.asarray(np.polyval(slope, s), float)


def log_coefficients(xi: Vector) -> tuple[Vector, Vector]:
    """The two scalar functions of the rotation angle in Jlog6, as (..., 1), plain or dual."""
    w = value(xi)[..., 3:]
    A, B, dA, dB = _coefficients(np.sum(w * w, axis=-1, keepdims=True))
    if isinstance(xi, Dual):
        ds = 2 * (w[..., None, :] @ xi.tangent[..., 3:, :])
        return Dual(A, dA[..., None] * ds), Dual(B, dB[..., None] * ds)
    return A, B


def _one_minus_alpha_over_s(s: Array) -> Array:
    small = s < _SMALL
    if np.all(small):
        return np.asarray(np.polyval(_A[::-1], s), float)
    safe = np.where(small, 1.0, s)
    y = np.sqrt(safe)
    return np.where(small, np.polyval(_A[::-1], s), (1 - 0.5 * y / np.tan(0.5 * y)) / safe)


def _coefficients(s: Array) -> tuple[Array, Array, Array, Array]:
    """A, B of Jlog6 = 1 + ad/2 + A ad^2 + B ad^4 and their derivatives in s = theta^2."""
    k = np.arange(1, _A.size + 1)
    a, b = (2 - k) * _A, ((1 - k) * _A)[1:]
    if np.all(s < _SMALL):
        A, B, dA, dB = (np.asarray(np.polyval(p, s), float) for p in (a[::-1], b[::-1], np.polyder(a[::-1]), np.polyder(b[::-1])))
        return A, B, dA, dB
    small = s < _SMALL
    safe = np.where(small, 1.0, s)
    y = np.sqrt(safe)
    alpha = 0.5 * y / np.tan(0.5 * y)
    beta = safe / (4 * np.sin(0.5 * y) ** 2)
    alpha_s, beta_s = (alpha - beta) / (2 * safe), beta / safe * (1 - alpha)
    A = (2 * (1 - alpha) + 0.5 * (alpha - beta)) / safe
    B = (1 - alpha + 0.5 * (alpha - beta)) / safe**2
    dA = (-2 * alpha_s + 0.5 * (alpha_s - beta_s)) / safe - A / safe
    dB = (-alpha_s + 0.5 * (alpha_s - beta_s)) / safe**2 - 2 * B / safe
    series = (np.polyval(a[::-1], s), np.polyval(b[::-1], s), np.polyval(np.polyder(a[::-1]), s), np.polyval(np.polyder(b[::-1]), s))
    A, B, dA, dB = (np.where(small, few, many) for few, many in zip(series, (A, B, dA, dB), strict=True))
    return A, B, dA, dB


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose with the body twists of its tangent directions (None: a constant)."""

    R: Array  #: (..., 3, 3)
    p: Array  #: (..., 3)
    twist: Array | None = None  #: (..., 6, N)

    @property
    def matrix(self) -> Array:
        """(..., 4, 4)."""
        return transform(self.R, self.p)

    @staticmethod
    def of(X: Array, twist: Array | None = None) -> Pose:
        """From a 4x4 matrix."""
        return Pose(X[..., :3, :3], X[..., :3, 3], twist)

    def inverse(self) -> Pose:
        """X^-1."""
        Rt = np.swapaxes(self.R, -1, -2)
        return Pose(Rt, -times(Rt, self.p), None if self.twist is None else -self.Ad() @ self.twist)

    def Ad(self) -> Array:
        """Adjoint matrix (..., 6, 6) of the value."""
        return adjoint(self.matrix)

    def __matmul__(self, other: Pose) -> Pose:
        """Composition; the tangent of A B is Ad(B^-1) a + b."""
        twist = other.twist
        if self.twist is not None:
            moved = adjoint(inverse(other.matrix)) @ self.twist
            twist = moved if twist is None else moved + twist
        return Pose(self.R @ other.R, times(self.R, other.p) + self.p, twist)

    def adjoint(self, V: Vector) -> Array | Dual:
        """Ad(X) V, with the tangent of the pose: Ad(X) (dV - ad(V) twist)."""
        v = value(V)
        if self.twist is None and not isinstance(V, Dual):
            moved = v.reshape(*v.shape[:-1], 2, 3) @ np.swapaxes(self.R, -1, -2)
            moved[..., 0, :] += cross(self.p, moved[..., 1, :])
            return moved.reshape(*moved.shape[:-2], 6)
        Ad = self.Ad()
        out = times(Ad, v)
        dV = V.tangent if isinstance(V, Dual) else None
        if self.twist is not None:
            moved = -ad(v) @ self.twist
            dV = moved if dV is None else dV + moved
        return out if dV is None else Dual(out, Ad @ dV)

    def log(self) -> Array | Dual:
        """log6 with the exact tangent. Raises ``NearPi`` within 1e-3 rad of pi."""
        if self.R.ndim == 2 and self.twist is None:
            xi, angle = _log6_of_one(self.R, self.p)
            if angle > MOST:
                raise NearPi(angle)
            return xi
        xi = _with_rotation(rotation_vector(self.R), self.p)
        return xi if self.twist is None else Dual(xi, Jlog6(xi) @ self.twist)


def pose_matrix(argument: str, X: object) -> Array:
    """Checks a 4x4 rigid transform: an array or an object with ``homogeneous`` (a Pinocchio SE3). Raises BadArgument."""
    takes = "a rigid transform: a 4x4 array (rotation, position, last row 0 0 0 1) or a Pinocchio SE3"
    raw = getattr(X, "homogeneous", X)
    out = checks.array(argument, raw, (4, 4), takes)
    R = out[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0 or np.abs(out[3] - [0, 0, 0, 1]).max() > 1e-12:
        raise BadArgument(argument, X, takes)
    return out
