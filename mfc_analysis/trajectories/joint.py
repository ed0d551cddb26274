"""References in joint space, as values: ``ref(t)`` gives ``JointPoint(q, v, a)``, each (..., n) for t of shape (...), [s].

Before its first and after its last time a finite reference is at rest: q is held, v = a = 0.
"""

from __future__ import annotations

import csv
import math
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument, MfcWarning
from mfc_analysis.maths import checks, files
from mfc_analysis.maths.arrays import Array
from mfc_analysis.trajectories.piecewise import Piecewise

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


SHORTEST, LONGEST = 1e-6, 1e12  #: [s] of a motion
LARGEST = 100_000_000  #: bytes of a CSV file
LATE, LATE_FACTOR = 1e4, 100.0  #: a first time above this many seconds and this many times the motion's length is a reading of a clock
PERIOD_TOLERANCE = 1e-9  #: relative, within which a ratio of frequencies counts as rational
PERIOD_DENOMINATOR = 1000  #: largest numerator or denominator of such a ratio


class JointPoint(NamedTuple):
    """A joint reference at one or many times: position, velocity and acceleration, each (..., n)."""

    q: Array  #: [rad or m]
    v: Array  #: [rad/s or m/s]
    a: Array  #: [rad/s^2 or m/s^2]


class JointReference(ABC):
    """Base class of joint references."""

    space: ClassVar[Literal["joint"]] = "joint"

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

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

    def __call__(self, t: ArrayLike) -> JointPoint:
        """q, v, a at t [s]: (n,) for a number, (m, n) for (m,) times."""
        return self._at(time_array(t))

    @abstractmethod
    def _at(self, t: Array) -> JointPoint: ...


@dataclass(frozen=True, eq=False)
class Hold(JointReference):
    """A joint position that is held: q (n,) [rad or m]."""

    q: ArrayLike
    _q: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _set(self, _q=_position("q", self.q))
        _set(self, q=self._q)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._q.size

    @property
    def is_hold(self) -> bool:
        """True: it is at rest at all times."""
        return True

    def _at(self, t: Array) -> JointPoint:
        zero = np.zeros((*t.shape, self._q.size))
        return JointPoint(zero + self._q, zero, zero.copy())


@dataclass(frozen=True, eq=False)
class Quintic(JointReference):
    """From rest at q0 to rest at q1, each (n,) [rad or m], by the quintic 10 s^3 - 15 s^4 + 6 s^5 of s = t / duration; held after.

    The duration is 1e-6 to 1e12 s. Velocity and acceleration are zero at both ends.
    """

    q0: ArrayLike
    q1: ArrayLike
    duration: float = 2.0  # [s]  # pyright: ignore[reportIncompatibleMethodOverride]  # a field for the property
    _q0: Array = field(init=False, repr=False)
    _step: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        q0 = _position("q0", self.q0)
        q1 = _position("q1", self.q1)
        if q1.size != q0.size:
            raise BadArgument("q1", f"shape {q1.shape}", f"the shape of q0, {q0.shape}")
        _set(self, q0=q0, q1=q1, duration=checks.number("duration", self.duration, low=SHORTEST, high=LONGEST), _q0=q0, _step=q1 - q0)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._q0.size

    @property
    def is_hold(self) -> bool:
        """True where q0 equals q1."""
        return not self._step.any()

    def _at(self, t: Array) -> JointPoint:
        s, ds, dds = quintic(t, self.duration)
        return JointPoint(self._q0 + s[..., None] * self._step, ds[..., None] * self._step, dds[..., None] * self._step)


@dataclass(frozen=True, eq=False)
class Sinusoid(JointReference):
    """q = center + amplitude sin(frequency t + phase).

    Args:
        center: (n,) [rad or m]. amplitude: [rad or m], scalar or (n,). frequency: [rad/s] >= 0, scalar or (n,). phase: [rad], scalar or (n,).
    """

    center: ArrayLike
    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0
    _center: Array = field(init=False, repr=False)
    _amplitude: Array = field(init=False, repr=False)
    _frequency: Array = field(init=False, repr=False)
    _phase: Array | None = field(init=False, repr=False)  #: None: 0
    _speed: Array = field(init=False, repr=False)  #: largest v
    _minus_square: Array = field(init=False, repr=False)  #: a for each unit of the swing

    def __post_init__(self) -> None:
        center = _position("center", self.center)
        n = center.size
        amplitude, phase = checks.per_joint("amplitude", self.amplitude, n), checks.per_joint("phase", self.phase, n)
        frequency = checks.per_joint("frequency", self.frequency, n, low=0.0)
        _set(self, center=center, amplitude=amplitude, frequency=frequency, phase=phase)
        _set(self, _center=center, _amplitude=amplitude, _frequency=frequency, _phase=phase if phase.any() else None)
        _set(self, _speed=amplitude * frequency, _minus_square=-(frequency**2))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._center.size

    @property
    def is_hold(self) -> bool:
        """Whether no joint moves."""
        return not np.any(self._amplitude * self._frequency)

    @property
    def period(self) -> float | None:
        """The least common period of the moving joints [s]. Raises ``BadArgument`` where their frequencies have none."""
        return least_common_period(self._frequency[self._amplitude * self._frequency != 0])

    def _at(self, t: Array) -> JointPoint:
        angle = (t[..., None] if t.ndim else t) * self._frequency
        if self._phase is not None:
            angle = angle + self._phase
        swing = self._amplitude * np.sin(angle)
        return JointPoint(self._center + swing, self._speed * np.cos(angle), self._minus_square * swing)


@dataclass(frozen=True, eq=False)
class Waypoints(JointReference):
    """Motion through positions (m, n) [rad or m] at times (m,) [s], m >= 2, that starts and ends at rest.

    The interpolation is the quintic spline (four times continuously differentiable) with zero velocity and acceleration at both ends;
    between two positions it is ``Quintic``. Positions (m,) are those of one joint.

    Raises ``BadArgument``, also for times that are readings of a clock, such as seconds since 1970: a first time above 1e4 s and above 100 times
    the length of the motion. Through the times of a simulation such a motion would stay at its first position.
    """

    times: ArrayLike
    positions: ArrayLike
    _path: Piecewise = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = checks.times(self.times)
        if times.size < 2:
            raise BadArgument("times", self.times, "at least two times [s]")
        _check_start("times", times)
        positions = checks.array("positions", self.positions)
        if positions.ndim == 1:
            positions = positions[:, None]
        if positions.ndim != 2 or positions.shape[0] != times.size or positions.shape[1] == 0:
            raise BadArgument("positions", f"shape {np.shape(self.positions)}", f"shape ({times.size}, n): a row for each of the {times.size} times")
        _set(self, times=times, positions=positions, _path=Piecewise.spline(times, positions))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self._path.n

    @property
    def duration(self) -> float:
        """The last time [s]."""
        return float(self._path.breaks[-1])

    @property
    def is_hold(self) -> bool:
        """Whether all positions are the same."""
        return bool(np.ptp(np.asarray(self.positions), axis=0).max() == 0)

    def _at(self, t: Array) -> JointPoint:
        return JointPoint(*self._path.at(t))


def from_csv(path: str | os.PathLike[str]) -> Waypoints:
    """The ``Waypoints`` of a table in the file ``path``: time [s] in the first column, one joint [rad or m] in each other column.

    A header line is optional, as are lines that are empty or start with ``#``; columns are separated by commas, semicolons, tabs or blanks.
    Times start near 0: readings of a clock, such as seconds since 1970, are refused, not shifted, as in ``Waypoints``.

    Raises ``BadArgument``, which names the file and line.
    """
    takes = "the path of a CSV file that can be read"
    try:
        text = files.read(checks.path("path", path, takes), LARGEST).decode("utf-8-sig")
    except (OSError, UnicodeError) as why:
        raise BadArgument("path", str(path), f"{takes} ({getattr(why, 'strerror', None) or 'it is not UTF-8 text'})") from why
    rows: list[list[float]] = []
    header_allowed = True
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = _cells(line)
        values = [checks.decimal(cell) for cell in cells]
        bad = [cell for cell, value in zip(cells, values, strict=True) if value is None]
        if header_allowed and all(value is None for value in values) and not all(map(_meant_as_number, cells)):
            header_allowed = False
            continue
        header_allowed = False
        if bad:
            raise BadArgument(f"{path}, line {number}", bad[0], "finite numbers: a time [s], then a position for each joint")
        if len(values) < 2 or (rows and len(values) != len(rows[0])):
            raise BadArgument(
                f"{path}, line {number}", f"{len(values)} columns", f"{len(rows[0])} columns, as above" if rows else "a time and at least one joint"
            )
        row = [value for value in values if value is not None]
        if rows and row[0] <= rows[-1][0]:
            raise BadArgument(f"{path}, line {number}", f"time {row[0]:g} after {rows[-1][0]:g}", "times that increase from line to line")
        rows.append(row)
    if len(rows) < 2:
        raise BadArgument("path", str(path), f"a table of at least two times; the file has {len(rows)}")
    table = np.array(rows)
    _check_start(f"{path}, column 1", table[:, 0])
    return Waypoints(table[:, 0], table[:, 1:])


def warn_outside_limits(robot: Robot, ref: JointReference, times: ArrayLike) -> tuple[str, ...]:
    """Warns (``MfcWarning``) for each joint of ``robot`` whose reference ``ref`` leaves its position or velocity limits at times (m,) [s].

    Also returns the messages. Raises BadArgument for bad times.
    """
    t = checks.times(times)
    point, limits = ref(t), robot.limits
    found = []
    for j, name in enumerate(robot.joint_names):
        low, high, speed = limits.lower[j], limits.upper[j], limits.velocity[j]
        outside = np.maximum(low - point.q[:, j], point.q[:, j] - high)
        k = int(np.argmax(outside))
        if outside[k] > 1e-9:
            found.append(
                f"the reference leaves the limits of joint {name!r} at t = {t[k]:.4g} s: {point.q[k, j]:.4g} is outside [{low:.4g}, {high:.4g}]"
            )
        k = int(np.argmax(np.abs(point.v[:, j])))
        if abs(point.v[k, j]) > speed + 1e-9:
            found.append(f"the reference moves joint {name!r} at {abs(point.v[k, j]):.4g} at t = {t[k]:.4g} s, above its limit {speed:.4g}")
    for text in found:
        warnings.warn(text, MfcWarning, stacklevel=2)
    return tuple(found)


def least_common_period(frequencies: Iterable[float]) -> float | None:
    """The least T > 0 [s] that is a whole number of periods of each frequency [rad/s]; None for no frequency.

    Ratios count as rational within 1e-9, with numerator and denominator up to 1000. Raises ``BadArgument`` for other ratios.
    """
    w = [float(x) for x in dict.fromkeys(map(float, frequencies))]
    if not w:
        return None
    ratios = []
    for x in w:
        ratio = x / w[0]
        near = Fraction(ratio).limit_denominator(PERIOD_DENOMINATOR)
        if near.numerator == 0 or near.numerator > PERIOD_DENOMINATOR or abs(float(near) - ratio) > PERIOD_TOLERANCE * ratio:
            raise BadArgument(
                "frequency",
                tuple(w),
                f"frequencies with a common period: {x:g} / {w[0]:g} is not a ratio of whole numbers up to {PERIOD_DENOMINATOR}",
            )
        ratios.append(near)
    bottom = math.lcm(*(r.denominator for r in ratios))
    common = Fraction(math.gcd(*(int(r * bottom) for r in ratios)), bottom)
    return 2 * math.pi / (w[0] * float(common))


def quintic(t: Array, duration: float) -> tuple[Array, Array, Array]:
    """10 s^3 - 15 s^4 + 6 s^5 of s = t / duration in [0, 1], and its first two derivatives in t."""
    s = np.minimum(np.maximum(t / duration, 0.0), 1.0)
    r = 1.0 - s
    return s * s * s * (10.0 - s * (15.0 - 6.0 * s)), (30.0 / duration) * (s * r) ** 2, (60.0 / duration**2) * s * r * (r - s)


def time_array(t: ArrayLike) -> Array:
    """Times [s] as a float array. Raises ``BadArgument`` where one is not finite."""
    if type(t) is float and math.isfinite(t):  # of a simulation
        return np.asarray(t)
    return checks.array("t", t, takes="finite times [s]")


def _position(argument: str, value: ArrayLike) -> Array:
    takes = "shape (n,): a position for each joint [rad or m]"
    out = checks.vector(argument, value, takes)
    if out.size == 0:
        raise BadArgument(argument, f"shape {out.shape}", takes)
    return out


def _set(value: object, **fields: object) -> None:
    for name, content in fields.items():
        object.__setattr__(value, name, content)


def _cells(line: str) -> list[str]:
    for mark in (";", "\t", ","):
        if mark in line:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=mark))]
    return line.split()


def _meant_as_number(cell: str) -> bool:
    return cell.lstrip("+-.")[:1].isnumeric() or cell.lstrip("+-").lower() in ("nan", "inf")


def _check_start(argument: str, times: Array) -> None:
    first, length = float(times[0]), float(times[-1] - times[0])
    if first > max(LATE, LATE_FACTOR * length):
        takes = f"times [s] from about 0: these are readings of a clock; subtract the first, {first!r}, from each"
        raise BadArgument(argument, f"{length:g} s of motion that start at {first:g} s", takes)
