"""References of the tool in SE(3), as values: ``ref(t)`` gives ``ToolPoint(X, V, dV)`` for t of shape (...), [s].

V is the body twist of the reference, (linear, angular) in its own frame X; dV is the rate of those components.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import hat, log3, pose_matrix
from mfc_analysis.trajectories.joint import LONGEST, SHORTEST, quintic, time_array


class ToolPoint(NamedTuple):
    """A tool reference at one or many times."""

    X: Array  #: (..., 4, 4) pose in the base
    V: Array  #: (..., 6) body twist [m/s, rad/s] in the frame X
    dV: Array  #: (..., 6) rate of the components of V [m/s^2, rad/s^2]


class _Motion(NamedTuple):
    """A motion as arrays: position and its derivatives in base axes, and an angle about a fixed tool axis with its derivatives."""

    p: Array
    dp: Array
    ddp: Array
    angle: Array
    dangle: Array
    ddangle: Array


@dataclass(frozen=True, eq=False)
class _Turning:
    """R0 exp(axis angle) for a unit axis in the tool frame, by R0 + sin(angle) R0 W + (1 - cos(angle)) R0 W^2."""

    R0: Array
    axis: Array
    W: Array
    R0W: Array
    R0W2: Array

    @staticmethod
    def about(R0: Array, axis: Array) -> _Turning:
        W = hat(axis)
        return _Turning(R0, axis, W, R0 @ W, R0 @ W @ W)

    def point(self, m: _Motion) -> ToolPoint:
        if not m.angle.ndim:
            return self._one(m)
        X = np.zeros((*m.angle.shape, 4, 4))
        angle, rate = m.angle[..., None, None], m.dangle[..., None]
        X[..., :3, :3] = R = self.R0 + np.sin(angle) * self.R0W + (1.0 - np.cos(angle)) * self.R0W2
        X[..., :3, 3], X[..., 3, 3] = m.p, 1.0
        V, dV = np.empty((*m.angle.shape, 6)), np.empty((*m.angle.shape, 6))
        V[..., :3] = v = (m.dp[..., None, :] @ R)[..., 0, :]
        V[..., 3:] = rate * self.axis
        dV[..., :3] = (m.ddp[..., None, :] @ R)[..., 0, :] + rate * (v @ self.W)  # v @ W = v x axis
        dV[..., 3:] = m.ddangle[..., None] * self.axis
        return ToolPoint(X, V, dV)

    def _one(self, m: _Motion) -> ToolPoint:
        """The same at one time, as in a simulation."""
        X, V, dV = np.zeros((4, 4)), np.empty(6), np.empty(6)
        X[:3, :3] = R = self.R0 + math.sin(m.angle) * self.R0W + (1.0 - math.cos(m.angle)) * self.R0W2
        X[:3, 3], X[3, 3] = m.p, 1.0
        V[:3] = v = m.dp @ R
        V[3:] = m.dangle * self.axis
        dV[:3] = m.ddp @ R + m.dangle * (v @ self.W)
        dV[3:] = m.ddangle * self.axis
        return ToolPoint(X, V, dV)


class ToolReference(ABC):
    """Base class of tool references."""

    space: ClassVar[Literal["tool"]] = "tool"

    @property
    def period(self) -> float | None:
        """Period [s]; None where it is not periodic."""
        return None

    @property
    def duration(self) -> float | None:
        """End time [s]; None where it has none."""
        return None

    @property
    def is_hold(self) -> bool:
        """Whether it is at rest at all times."""
        return False

    def __call__(self, t: ArrayLike) -> ToolPoint:
        """X, V, dV at t [s]: (4, 4) and (6,) for a number, with a leading axis for (m,) times."""
        return self._at(time_array(t))

    @abstractmethod
    def _at(self, t: Array) -> ToolPoint: ...


@dataclass(frozen=True, eq=False)
class ToolHold(ToolReference):
    """A pose X that is held: 4x4 or a Pinocchio SE3."""

    X: Any

    def __post_init__(self) -> None:
        _set(self, X=pose_matrix("X", self.X))

    @property
    def is_hold(self) -> bool:
        """True: it is at rest at all times."""
        return True

    def _at(self, t: Array) -> ToolPoint:
        zero = np.zeros((*t.shape, 6))
        return ToolPoint(np.array(np.broadcast_to(self.X, (*t.shape, 4, 4))), zero, zero.copy())


@dataclass(frozen=True, eq=False)
class ToolLine(ToolReference):
    """From rest at X0 to rest at X1 in ``duration`` [s], timed as ``Quintic``; held after.

    The origin moves on a straight line, the orientation turns about a fixed axis: R = R0 exp(s log(R0^T R1)), by less than pi.
    """

    X0: Any
    X1: Any
    duration: float = 2.0  # [s]  # pyright: ignore[reportIncompatibleMethodOverride]  # a field for the property
    _step: Array = field(init=False, repr=False)
    _angle: float = field(init=False, repr=False)
    _turning: _Turning = field(init=False, repr=False)

    def __post_init__(self) -> None:
        X0, X1 = pose_matrix("X0", self.X0), pose_matrix("X1", self.X1)
        R = X0[:3, :3].T @ X1[:3, :3]
        angle = float(np.arccos(np.clip(0.5 * (np.trace(R) - 1.0), -1.0, 1.0)))
        if angle > np.pi - 1e-3:
            raise BadArgument(
                "X1",
                f"a rotation of {angle:.6f} rad from X0",
                "a rotation below pi - 1e-3 rad, beyond which the axis is not defined: use two lines",
            )
        w = log3(R)
        angle = float(np.linalg.norm(w))
        axis = w / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
        duration = checks.number("duration", self.duration, low=SHORTEST, high=LONGEST)
        _set(self, X0=X0, X1=X1, duration=duration, _step=X1[:3, 3] - X0[:3, 3], _angle=angle, _turning=_Turning.about(X0[:3, :3], axis))

    @property
    def is_hold(self) -> bool:
        """True where X0 equals X1."""
        return self._angle == 0 and not self._step.any()

    def _at(self, t: Array) -> ToolPoint:
        s, ds, dds = quintic(t, self.duration)
        p0, step, angle = self.X0[:3, 3], self._step, self._angle
        motion = _Motion(p0 + s[..., None] * step, ds[..., None] * step, dds[..., None] * step, s * angle, ds * angle, dds * angle)
        return self._turning.point(motion)


@dataclass(frozen=True, eq=False)
class ToolSinusoid(ToolReference):
    """p = p0 + amplitude sin(frequency t + phase), R = R0 exp(axis angle sin(frequency t + phase)).

    Args:
        X0: the centre pose. amplitude: (3,) [m] in base axes (a scalar: the same on x, y and z). frequency: [rad/s] > 0.
        axis: (3,) in the tool frame, normalised. angle: [rad]. phase: [rad].
    """

    X0: Any
    amplitude: ArrayLike
    frequency: float
    axis: ArrayLike = (0.0, 0.0, 1.0)
    angle: float = 0.0
    phase: float = 0.0
    _amplitude: Array = field(init=False, repr=False)
    _turning: _Turning = field(init=False, repr=False)

    def __post_init__(self) -> None:
        X0, amplitude = pose_matrix("X0", self.X0), checks.per_joint("amplitude", self.amplitude, 3)
        axis = _unit("axis", self.axis)
        _set(
            self,
            X0=X0,
            amplitude=amplitude,
            _amplitude=amplitude,
            axis=axis,
            frequency=checks.number("frequency", self.frequency, low=0.0, strict=True),
        )
        _set(self, angle=checks.number("angle", self.angle), phase=checks.number("phase", self.phase), _turning=_Turning.about(X0[:3, :3], axis))

    @property
    def period(self) -> float | None:
        """Period [s]; None where nothing moves."""
        return None if self.is_hold else 2.0 * np.pi / self.frequency

    @property
    def is_hold(self) -> bool:
        """Whether amplitude and angle are zero."""
        return self.angle == 0 and not self._amplitude.any()

    def _at(self, t: Array) -> ToolPoint:
        w = self.frequency
        s, ds = np.sin(w * t + self.phase), w * np.cos(w * t + self.phase)
        dds, p0, along = -(w * w) * s, self.X0[:3, 3], self._amplitude
        motion = _Motion(p0 + s[..., None] * along, ds[..., None] * along, dds[..., None] * along, s * self.angle, ds * self.angle, dds * self.angle)
        return self._turning.point(motion)


@dataclass(frozen=True, eq=False)
class ToolCircle(ToolReference):
    """A circle that starts at X0 and keeps its orientation, counterclockwise about ``normal`` at a constant speed.

    The direction u from the centre to the start is the base x axis minus its part along the normal (the y axis where the normal is x):
    the centre lies at p0 - radius u.

    Args:
        X0: the pose at t = 0. radius: [m] > 0. frequency: [rad/s] > 0. normal: (3,) in base axes, normalised.
    """

    X0: Any
    radius: float
    frequency: float
    normal: ArrayLike = (0.0, 0.0, 1.0)
    _u: Array = field(init=False, repr=False)
    _w: Array = field(init=False, repr=False)
    _turning: _Turning = field(init=False, repr=False)

    def __post_init__(self) -> None:
        X0, normal = pose_matrix("X0", self.X0), _unit("normal", self.normal)
        start = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        u = _unit("normal", start - (start @ normal) * normal)
        radius, frequency = (checks.number(name, getattr(self, name), low=0.0, strict=True) for name in ("radius", "frequency"))
        _set(self, X0=X0, radius=radius, frequency=frequency, normal=normal, _u=u, _w=np.cross(normal, u))
        _set(self, _turning=_Turning.about(X0[:3, :3], np.array([0.0, 0.0, 1.0])))

    @property
    def period(self) -> float:
        """Period [s]."""
        return 2.0 * np.pi / self.frequency

    def _at(self, t: Array) -> ToolPoint:
        w, r = self.frequency, self.radius
        angle = (w * t)[..., None]
        cos, sin = np.cos(angle), np.sin(angle)
        out, round_ = cos * self._u + sin * self._w, cos * self._w - sin * self._u
        still = np.zeros(t.shape)
        return self._turning.point(_Motion(self.X0[:3, 3] + r * (out - self._u), r * w * round_, -r * w * w * out, still, still, still))


def _unit(argument: str, value: ArrayLike) -> Array:
    axis = checks.array(argument, value, (3,))
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        raise BadArgument(argument, value, "a direction of three numbers, not all zero")
    axis = axis / length
    axis.setflags(write=False)
    return axis


def _set(value: object, **fields: object) -> None:
    for name, content in fields.items():
        object.__setattr__(value, name, content)
