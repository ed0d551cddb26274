"""Contact: a spring-damper surface fixed in the world, in chosen directions of a compliance frame (equation 9.19).

Coordinates in the frame ``pose``: translations R^T (p_tool - p), rotations log3(R^T R_tool). Each axis points into the
surface: force = stiffness x penetration + damping x rate + preload, positive in compression. The wrench acts at the tool
origin; the moment of a rotation is power-conjugate to its coordinate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.maths.axes import AXES, parse_axes
from mfc_analysis.maths.dual import Dual, Vector, times, value
from mfc_analysis.maths.se3 import Jlog3, Jlog3_slope, Pose, hat, log3, pose_matrix, rotation_vector
from mfc_analysis.robots.primitives import Primitives

STIFFEST = 1e15  #: [N/m, Nm/rad] largest stiffness of a search

#: one-sided surfaces: False: stick; True: push where they are penetrated; (6,) bool of each surface: push along the axes that are touched
LoseContact = bool | Sequence[Bools]


@dataclass(frozen=True, eq=False)
class Environment:
    r"""A spring-damper environment, fixed in the world: equation 9.19.

    Args:
        stiffness: [N/m, Nm/rad] scalar, one per axis in the order of ``axes``, or (6, 6) in the compliance frame (then ``axes`` is not used).
        damping: [Ns/m, Nm s/rad] likewise.
        pose: 4x4 pose of the compliance frame in the world; None: the tool's start pose.
        axes: directions of the compliance frame, "z", "xyz", "rz", "xyrz", ...
        preload: [N, Nm] the force at ``pose``, scalar or one per axis ((6,) with a (6, 6) stiffness).
        one_sided: in simulation only: the surface pushes, never pulls, and does nothing before it is touched; contact made and lost is logged.

    A one-sided surface resists along each of its axes by itself (several translations: the faces of a corner; a rotation: a stop):

    .. math:: f_i = \max(0,\; p_i + (B \dot d)_i) \quad \text{where} \quad p_i = (K d + f_0)_i > 0, \qquad f_i = 0 \text{ elsewhere}

    with d (6,) the tool in the compliance frame: R^T (p_tool - p) and log3(R^T R_tool). p_i is the elastic force, penetration times stiffness:
    along one axis the surface begins at d = -preload/stiffness, before the pose where the preload presses. A damper acts while p > 0 only: an axis
    without stiffness and preload does nothing. At the touch the force jumps to damping x speed (Kelvin-Voigt); where it would pull it is 0, until
    the lift at p = 0.

    Raises:
        BadArgument: a negative or non-finite number, a shape that does not fit the axes, an unknown axis, not a pose.
    """

    stiffness: float | Array
    damping: float | Array = 0.0
    pose: Array | None = None
    axes: str = "z"
    preload: float | Array = 0.0
    one_sided: bool = False
    index: tuple[int, ...] = field(init=False, repr=False)  #: the compliant directions among x, y, z, rx, ry, rz
    K: Array = field(init=False, repr=False)  #: (6, 6) stiffness in the compliance frame
    B: Array = field(init=False, repr=False)  #: (6, 6) damping in the same frame
    f0: Array = field(init=False, repr=False)  #: (6,) preload in the same frame

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        stiffness = checks.array("stiffness", self.stiffness)
        full = stiffness.shape == (6, 6)
        index = tuple(range(6)) if full else parse_axes(self.axes)
        set_(self, "index", index)
        set_(self, "K", _matrix("stiffness", self.stiffness, index, full))
        set_(self, "B", _matrix("damping", self.damping, index, full))
        preload = np.zeros(6)
        preload[list(index)] = checks.per_joint("preload", self.preload, len(index))
        set_(self, "f0", preload)
        if self.pose is not None:
            set_(self, "pose", pose_matrix("pose", self.pose))
        if not isinstance(self.one_sided, (bool, np.bool_)):
            raise BadArgument("one_sided", self.one_sided, "True or False")

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The compliant directions."""
        return tuple(AXES[i] for i in self.index)

    def with_stiffness(self, stiffness: ArrayLike) -> Environment:
        """The same surface with another stiffness [N/m, Nm/rad]."""
        return replace(self, stiffness=checks.array("stiffness", stiffness))


def _matrix(argument: str, given: ArrayLike, index: tuple[int, ...], full: bool) -> Array:
    raw = checks.array(argument, given)
    if raw.shape == (6, 6):
        if not full:
            raise BadArgument(argument, "shape (6, 6)", "a scalar or one number per axis, unless the stiffness is (6, 6) too")
        if np.abs(raw - raw.T).max() > 1e-9 * max(1.0, np.abs(raw).max()) or np.linalg.eigvalsh(raw)[0] < -1e-9 * max(1.0, np.abs(raw).max()):
            raise BadArgument(argument, given, "a symmetric positive semidefinite (6, 6) matrix")
        return raw
    out = np.zeros((6, 6))
    out[list(index), list(index)] = checks.per_joint(argument, given, len(index), low=0.0)
    out.setflags(write=False)
    return out


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact forces: the wrench of the tool on all surfaces (tool frame), and the force on each axis of each surface."""

    wrench: Vector  #: F_tip (..., 6)
    forces: tuple[Vector, ...]  #: one per surface: (..., 6) in its compliance frame
    elastic: tuple[Array, ...]  #: their part K d + f0 without damping, (..., 6): a one-sided axis is touched where it is positive


def contact(surfaces: Sequence[Environment], model: Primitives, q: Vector, v: Vector, *, lose_contact: LoseContact = False) -> Contact:
    """F_tip of all surfaces at (q, v), plain or dual. With axes given as touched the equations have no jump: those between two events."""
    X = model.pose(q)
    V = model.jacobian(q, v)
    found = []
    for i, surface in enumerate(surfaces):
        lose = surface.one_sided and (lose_contact if isinstance(lose_contact, bool) else lose_contact[i])
        found.append(_press(surface, X, V, lose))
    wrench = found[0][0]
    for part, _, _ in found[1:]:
        wrench = wrench + part
    return Contact(wrench, tuple(force for _, force, _ in found), tuple(pressed for _, _, pressed in found))


def _press(surface: Environment, X: Pose, V: Vector, lose_contact: bool | Bools) -> tuple[Vector, Vector, Array]:
    """F_tip of one surface, its force in the compliance frame and the elastic part.

    A moment is power-conjugate to the rotation vector: J^T of its rate J w.
    """
    assert surface.pose is not None
    Re, pe = surface.pose[:3, :3], surface.pose[:3, 3]
    size = 6 if max(surface.index) > 2 else 3  # without rotations no logarithm is needed, and any angle is allowed
    K, B = surface.K[:size, :size], surface.B[:size, :size]
    C = Re.T @ X.R  # from the tool to the compliance frame
    Ct = np.swapaxes(C, -1, -2)
    twist = value(V)
    v, w = twist[..., :3], twist[..., 3:]
    depth, rate = (X.p - pe) @ Re, times(C, v)
    angle = J = moment = np.zeros(w.shape)
    if size == 6:
        angle = rotation_vector(C)
        J = Jlog3(angle)
        depth, rate = np.concatenate([depth, angle], axis=-1), np.concatenate([rate, times(J, w)], axis=-1)
    elastic = depth @ K + surface.f0[:size]
    f, pushes = elastic + rate @ B, None
    if lose_contact is not False:
        touched = elastic > 0 if lose_contact is True else np.asarray(lose_contact)[:size]
        pushes = np.where((f > 0) & touched, 1.0, 0.0)
        f = f * pushes
    g, force = times(Ct, f[..., :3]), f
    if size == 6:
        moment = times(np.swapaxes(J, -1, -2), f[..., 3:])
    else:
        force, elastic = np.concatenate([f, moment], axis=-1), np.concatenate([elastic, moment], axis=-1)
    wrench = np.concatenate([g, moment], axis=-1)
    if X.twist is None:
        return wrench, force, elastic
    linear, turn = X.twist[..., :3, :], X.twist[..., 3:, :]
    dV = V.tangent if isinstance(V, Dual) else np.zeros_like(X.twist)
    depths, rates = C @ linear, C @ (dV[..., :3, :] - hat(v) @ turn)
    angles = J @ turn if size == 6 else turn
    if size == 6:
        depths = np.concatenate([depths, angles], axis=-2)
        rates = np.concatenate([rates, J @ dV[..., 3:, :] + Jlog3_slope(angle, w) @ angles], axis=-2)
    df = K @ depths + B @ rates
    df = df if pushes is None else pushes[..., None] * df
    dg, dm = Ct @ df[..., :3, :] + hat(g) @ turn, np.zeros_like(turn)
    if size == 6:
        dm = np.swapaxes(J, -1, -2) @ df[..., 3:, :] - Jlog3_slope(-angle, f[..., 3:]) @ angles
    none = np.zeros((*df.shape[:-2], 6 - size, df.shape[-1]))
    return Dual(wrench, np.concatenate([dg, dm], axis=-2)), Dual(force, np.concatenate([df, none], axis=-2)), elastic


def stiffest(surface: Environment) -> float:
    """Largest translational stiffness [N/m] of a surface; of one that only turns, the rotational one [Nm/rad]."""
    diagonal = np.diag(surface.K)
    return float(diagonal[:3].max()) or float(diagonal[3:].max())


def stiffened(surface: Environment, stiffness: float, X: ArrayLike) -> Environment:
    """The surface scaled to this stiffness [N/m] with the same force where the tool is at pose X (4, 4)."""
    assert surface.pose is not None
    K = surface.K
    largest = stiffest(surface)
    if largest > 0:
        new = K * (stiffness / largest)
    else:
        new = np.zeros((6, 6))
        new[list(surface.index), list(surface.index)] = stiffness
    X = np.asarray(X, float)
    Re, pe = surface.pose[:3, :3], surface.pose[:3, 3]
    depth = np.concatenate([(X[:3, 3] - pe) @ Re, np.asarray(log3(Re.T @ X[:3, :3]))])
    preload = surface.f0 + (K - new) @ depth
    if np.asarray(surface.stiffness).shape == (6, 6):
        return replace(surface, stiffness=new, preload=preload)
    index = list(surface.index)
    return replace(surface, stiffness=np.diag(new)[index], preload=preload[index])
