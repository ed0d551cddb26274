r"""Natural and artificial constraints in a compliance frame, and the projection of 9.24: equations 9.17-9.18.

A contact task is a table of six rows. Along each axis of the compliance frame the environment fixes either the motion or
the force (the *natural* constraint, always zero), and the controller chooses the other one (the *artificial* constraint):

==========================  ===========================================
peg in hole, z along it     natural                       artificial
==========================  ===========================================
v_x, v_y, w_x, w_y          0 (the wall of the hole)      f_x, f_y, m_x, m_y
f_z, m_z                    0 (nothing holds the peg)     v_z, w_z
==========================  ===========================================

Twists the environment allows do no work on wrenches it can bear: V . F = v . f + w . m = 0 (9.17), in any frame.

Sources: chapter, eqs. 9.17, 9.18, 9.24 and section 9.4.1; Lynch & Park, Modern Robotics, section 11.6;
Siciliano et al., Robotics: Modelling, Planning and Control, section 9.4 (natural and artificial constraints).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import adjoint, inverse, pose_matrix

MOTION = ("vx", "vy", "vz", "wx", "wy", "wz")
FORCE = ("fx", "fy", "fz", "mx", "my", "mz")

_RECIPROCAL = 1e-9  # work of unit twists on unit wrenches below which they are reciprocal: rounding of user input in double precision


class ConstraintSet:
    r"""A table of natural and artificial constraints, checked at construction: equations 9.17-9.18.

    .. math:: V \cdot F = V^T F = v^T f + w^T m = 0, \qquad A V_b = 0

    Args:
        natural: what the environment fixes, as ``{"vx": 0, ..., "fz": 0}`` over vx vy vz wx wy wz fx fy fz mx my mz of the
            compliance frame: six components, each 0 (or only their names). General form: a (6, r) matrix whose columns span
            the twists left free.
        artificial: reference values of the other six [m/s, rad/s, N, Nm], 0 where omitted. General form: a (6, 6 - r)
            matrix whose columns span the wrenches the environment bears; omitted: all that are reciprocal to the twists.
        frame: (4, 4) pose of the compliance frame in the tool frame, or a Pinocchio SE3; default: the tool frame.

    Raises:
        BadArgument: an axis of which both or neither of motion and force are natural constraints, or a natural value that is not 0. Also twists and
            wrenches that are not reciprocal or do not add up to rank 6, and a ``frame`` that is not a pose.
        UnknownName: a component that is not one of the twelve.
    """

    #: natural constraints by name, all 0 (empty in the general form)
    natural: Mapping[str, float]
    #: reference values of the artificial constraints by name (empty in the general form)
    artificial: Mapping[str, float]
    #: (4, 4) pose of the compliance frame in the tool frame
    frame: Array
    #: (6, r) twists the environment leaves free, columns, compliance frame
    twists: Array
    #: (6, k) wrenches the environment bears, columns, compliance frame
    wrenches: Array

    def __init__(self, natural: Any, artificial: Any = None, frame: object = None) -> None:
        self.frame = _frozen(np.eye(4) if frame is None else np.array(pose_matrix("frame", frame)))
        if isinstance(natural, Mapping) or _is_names(natural):
            self.natural, self.artificial = _table(natural, artificial)
            free = np.array([f in self.natural for f in FORCE])
            self.twists, self.wrenches = _frozen(np.eye(6)[:, free]), _frozen(np.eye(6)[:, ~free])
        else:
            self.natural, self.artificial = MappingProxyType({}), MappingProxyType({})
            self.twists, self.wrenches = _bases(natural, artificial)

    @property
    def rank_free(self) -> int:
        """Dimension of the space of free twists."""
        return int(self.twists.shape[1])

    @property
    def rank_constraint(self) -> int:
        """Dimension of the space of constraint wrenches; with ``rank_free`` it adds up to 6."""
        return int(self.wrenches.shape[1])

    @property
    def reciprocity(self) -> float:
        """Largest work of a free twist on a constraint wrench, both of unit length: 0 when V . F = 0 holds (9.17)."""
        return _work(self.twists, self.wrenches)

    @property
    def rows(self) -> Array:
        """A of 9.24: (k, 6) orthonormal rows with A V_b = 0 for every free twist V_b, in tool coordinates (linear, angular).

        With a compliance frame away from the tool origin the rows mix metres and radians. The dynamic projection of 9.24 does not depend on that;
        the selection I - A^T A does.
        """
        A = self.wrenches.T @ adjoint(inverse(self.frame))
        U, _, Vt = np.linalg.svd(A, full_matrices=False)
        return _frozen(U @ Vt)  # the orthonormal rows nearest to A: rows that are already orthonormal do not change

    @property
    def V_d(self) -> Array:
        """(6,) desired twist of the artificial constraints, in tool coordinates [m/s, rad/s]."""
        return _frozen(adjoint(self.frame) @ np.array([self.artificial.get(name, 0.0) for name in MOTION]))

    @property
    def F_d(self) -> Array:
        """(6,) desired wrench of the artificial constraints, in tool coordinates at the tool origin [N, Nm]."""
        return _frozen(adjoint(inverse(self.frame)).T @ np.array([self.artificial.get(name, 0.0) for name in FORCE]))

    def __repr__(self) -> str:
        if self.natural:
            return f"ConstraintSet(natural={dict(self.natural)}, artificial={dict(self.artificial)})"
        return f"ConstraintSet(rank_free={self.rank_free}, rank_constraint={self.rank_constraint})"

    def __str__(self) -> str:
        lines = [f"{self.rank_free} free directions, {self.rank_constraint} constrained, reciprocity {self.reciprocity:.3g}"]
        if self.natural:
            lines.append("natural:    " + ", ".join(f"{name} = 0" for name in self.natural))
            lines.append("artificial: " + ", ".join(f"{name} = {value:g}" for name, value in self.artificial.items()))
        return "\n".join(lines)


def peg_in_hole(frame: object = None, insertion_speed: float = 0.0) -> ConstraintSet:
    """The chapter's peg in a hole, z of the compliance frame along its axis: eq. 9.18 and the text after it.

    Natural: v_x = v_y = w_x = w_y = 0 and f_z = m_z = 0. Artificial: v_z = ``insertion_speed`` [m/s], w_z = 0, and
    f_x = f_y = m_x = m_y = 0. ``frame``: (4, 4) pose of the compliance frame in the tool frame, default the tool frame.
    Raises ``BadArgument`` for a speed that is not finite or a frame that is not a pose.
    """
    speed = checks.number("insertion_speed", insertion_speed)
    natural = dict.fromkeys(("vx", "vy", "fz", "wx", "wy", "mz"), 0.0)
    return ConstraintSet(natural, {"fx": 0.0, "fy": 0.0, "vz": speed, "mx": 0.0, "my": 0.0, "wz": 0.0}, frame)


def surface_sliding(frame: object = None, force: float = 0.0) -> ConstraintSet:
    """A flat face sliding on a plane, z of the compliance frame along the normal, without friction.

    Natural: v_z = w_x = w_y = 0 and f_x = f_y = m_z = 0. Artificial: f_z = ``force`` [N], m_x = m_y = 0, v_x = v_y = w_z = 0.
    ``frame``: (4, 4) pose of the compliance frame in the tool frame, default the tool frame. Raises ``BadArgument`` for a
    force that is not finite or a frame that is not a pose. Source: Siciliano et al., section 9.4.
    """
    pressed = checks.number("force", force)
    natural = dict.fromkeys(("fx", "fy", "vz", "wx", "wy", "mz"), 0.0)
    return ConstraintSet(natural, {"vx": 0.0, "vy": 0.0, "fz": pressed, "mx": 0.0, "my": 0.0, "wz": 0.0}, frame)


def projection(A: ArrayLike | ConstraintSet, Lambda: ArrayLike) -> Array:
    r"""The dynamically consistent projector of 9.24: the part of a wrench that accelerates the tool along its free directions.

    .. math:: P = I - A^T (A \Lambda^{-1} A^T)^{-1} A \Lambda^{-1}

    P P = P, P A^T = 0 and A Lambda^-1 P = 0: no acceleration along the rows of A. It does not depend on the scale of the rows.

    Args:
        A: (k, 6) independent rows with A V_b = 0, or a ``ConstraintSet``; k = 0 gives I.
        Lambda: (..., 6, 6) task inertia, symmetric positive definite.

    Returns: (..., 6, 6).

    Raises ``BadArgument``: wrong shape, dependent rows, or Lambda not symmetric positive definite.
    Source: chapter, eq. 9.24; Lynch & Park, Modern Robotics, section 11.6.
    """
    rows = checked_rows(A, "A")
    takes = "symmetric positive definite matrices of shape (..., 6, 6)"
    inertia = checks.array("Lambda", Lambda, takes=takes)
    if inertia.shape[-2:] != (6, 6):
        raise BadArgument("Lambda", f"shape {inertia.shape}", takes)
    skew = np.abs(inertia - np.swapaxes(inertia, -1, -2)).max()
    if skew > 1e-9 * np.abs(inertia).max() or np.any(np.linalg.eigvalsh(inertia) <= 0):
        raise BadArgument("Lambda", Lambda, takes)
    across = np.linalg.solve(inertia, np.broadcast_to(rows.T, (*inertia.shape[:-2], 6, rows.shape[0])))  # Lambda^-1 A^T
    return np.eye(6) - rows.T @ np.linalg.solve(rows @ across, np.swapaxes(across, -1, -2))


def selection(A: ArrayLike | ConstraintSet) -> Array:
    """The selection I - A^T A, (6, 6): the orthogonal projector onto the free directions, for orthonormal rows.

    A: (k, 6) orthonormal rows, or a ``ConstraintSet``. Raises ``BadArgument`` when the rows are not orthonormal (to 1e-9).
    """
    rows = checked_rows(A, "A")
    if not np.allclose(rows @ rows.T, np.eye(rows.shape[0]), rtol=0, atol=1e-9):
        raise BadArgument("A", A, "orthonormal rows for a selection (A A^T = I); use projection='dynamic' for others")
    return np.eye(6) - rows.T @ rows


def checked_rows(A: ArrayLike | ConstraintSet, argument: str = "constraints") -> Array:
    """(k, 6) linearly independent rows, 0 <= k <= 6, from rows or a ``ConstraintSet`` A; otherwise ``BadArgument``, which names ``argument``."""
    if isinstance(A, ConstraintSet):
        return A.rows
    rows = checks.array(argument, A, (None, 6), "(k, 6) linearly independent rows A with A V_b = 0, or a ConstraintSet")
    if rows.size and np.linalg.matrix_rank(rows) < rows.shape[0]:  # older numpy has no rank of no rows
        raise BadArgument(argument, A, "(k, 6) linearly independent rows A with A V_b = 0, or a ConstraintSet")
    return rows


def _table(natural: Any, artificial: Any) -> tuple[Mapping[str, float], Mapping[str, float]]:
    """The table form: natural and artificial constraints, each in the order motion, force."""
    given = _values("natural", natural)
    for name, value in given.items():
        if value != 0:
            raise BadArgument("natural", f"{name} = {value:g}", "zeros: a natural constraint has the value 0 in the compliance frame")
    for v, f in zip(MOTION, FORCE, strict=True):
        if (v in given) == (f in given):
            got = f"both {v} and {f}" if v in given else f"neither {v} nor {f}"
            raise BadArgument("natural", got, "exactly one of motion and force on each of the six axes, so that V . F = 0 and the ranks add up to 6")
    complement = tuple(name for name in MOTION + FORCE if name not in given)
    chosen = dict.fromkeys(complement, 0.0) | _values("artificial", {} if artificial is None else artificial)
    for name in chosen:
        if name in given:
            raise BadArgument("artificial", name, f"only components that the environment leaves free: {', '.join(complement)}")
    return MappingProxyType({name: 0.0 for name in MOTION + FORCE if name in given}), MappingProxyType({name: chosen[name] for name in complement})


def _values(argument: str, given: Any) -> dict[str, float]:
    if not isinstance(given, Mapping) and not _is_names(given):
        raise BadArgument(argument, given, "a mapping from components (vx..wz, fx..mz) to values, or a sequence of their names")
    table = given if isinstance(given, Mapping) else dict.fromkeys(given, 0.0)
    for name in table:
        if name not in MOTION + FORCE:
            raise UnknownName(argument, name, MOTION + FORCE)
    return {str(name): checks.number(f"{argument}[{name!r}]", value) for name, value in table.items()}


def _is_names(value: Any) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, (str, bytes, np.ndarray)) and all(isinstance(name, str) for name in value)


def _bases(twists: Any, wrenches: Any) -> tuple[Array, Array]:
    """The general form: free twists (6, r) and bearable wrenches (6, 6 - r), reciprocal and of full rank."""
    T = checks.array("natural", twists, (6, None), "a mapping of components to 0, or a (6, r) matrix whose columns span the free twists")
    if np.linalg.matrix_rank(T) < T.shape[1]:
        raise BadArgument("natural", twists, "linearly independent columns (the free twists)")
    if wrenches is None:
        U = np.linalg.svd(T, full_matrices=True)[0] if T.shape[1] else np.eye(6)
        return T, _frozen(U[:, T.shape[1] :])
    W = checks.array("artificial", wrenches, (6, None), "a (6, 6 - r) matrix whose columns span the wrenches that the environment bears")
    if np.linalg.matrix_rank(W) < W.shape[1] or T.shape[1] + W.shape[1] != 6:
        raise BadArgument("artificial", wrenches, f"{6 - T.shape[1]} linearly independent wrenches: ranks of twists and wrenches add up to 6")
    if _work(T, W) > _RECIPROCAL:
        raise BadArgument("artificial", wrenches, f"wrenches reciprocal to the free twists (V . F = 0); their largest work is {_work(T, W):.3g}")
    return T, W


def _work(T: Array, W: Array) -> float:
    if not T.size or not W.size:
        return 0.0
    return float(np.abs((T / np.linalg.norm(T, axis=0)).T @ (W / np.linalg.norm(W, axis=0))).max())


def _frozen(value: Array) -> Array:
    value.setflags(write=False)
    return value
