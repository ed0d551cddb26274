"""The family of errors. Every one that an argument can cause is also a ``ValueError``; data are attributes, the message is a sentence.

::

    MfcError
    +-- BadArgument          an argument has the wrong shape, type, sign or is not finite     (ValueError)
    |   +-- UnknownName      an unknown frame, joint, robot, law or axis; lists the known ones
    |   +-- UnknownPoint     the loop cannot be opened at this analysis point; lists those where it can
    |   +-- Unsupported      an argument is understood but does not apply to this loop
    +-- BadRobot             a model that cannot be analysed: no mass, floating base, joints with nv != 1  (ValueError)
    +-- NearSingular         a Jacobian is nearly singular: time, frame, smallest singular value (ValueError)
    +-- NotConverged         an inverse kinematics, equilibrium or shooting search does not converge (ValueError)
    +-- NearPi               a pose error within 1e-3 rad of pi, where log6 jumps (ValueError)
    +-- MissingExtra         libraries of an extra are not installed; names it                (ImportError)

Warnings: ``MfcWarning`` (a ``UserWarning``) for suspicious input that still has a result.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.util import find_spec
from typing import Any

__all__ = [
    "BadArgument",
    "BadRobot",
    "MfcError",
    "MfcWarning",
    "MissingExtra",
    "NearPi",
    "NearSingular",
    "NotConverged",
    "UnknownName",
    "UnknownPoint",
    "Unsupported",
]

MOST_NAMES = 40  #: names that a message lists; a whole humanoid has hundreds of frames
LONGEST_NAME = 200  #: characters of a name that is compared with the known ones
#: optional extra -> what needs it, and the libraries that this imports
EXTRAS: dict[str, tuple[str, tuple[str, ...]]] = {
    "report": ("reports", ("jinja2", "typst")),
    "study": ("studies", ("pydantic", "ruamel.yaml")),
    "sweep": ("sweeps", ("xarray",)),
}


def __dir__() -> list[str]:
    return __all__


class MfcError(Exception):
    """Base class of all errors of this package. They pickle, so that the error of a worker reaches its parent process."""

    def __reduce__(self) -> Any:
        return _restored, (type(self), self.args, vars(self))


def _restored(kind: type[MfcError], args: tuple[Any, ...], data: dict[str, Any]) -> MfcError:
    error = kind.__new__(kind, *args)
    vars(error).update(data)
    return error


class MfcWarning(UserWarning):
    """Suspicious input that still has a result."""


class BadArgument(MfcError, ValueError):
    """An argument has the wrong shape, type or sign, or is not finite: the ``argument``, the value it ``got``, and what it ``takes``."""

    def __init__(self, argument: str, got: Any, takes: str) -> None:
        self.argument, self.got, self.takes = argument, got, takes
        super().__init__(f"{argument}: got {short(got)}; takes {takes}")


class UnknownName(BadArgument):
    """An unknown name. ``known`` lists all known names; the message lists the nearest, at most ``MOST_NAMES``."""

    def __init__(self, argument: str, got: Any, known: Iterable[str]) -> None:
        self.known = tuple(known)
        near = get_close_matches(got, self.known, n=MOST_NAMES) if isinstance(got, str) and len(got) < LONGEST_NAME else []
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        listed, others = self.known, 0
        if len(self.known) > MOST_NAMES:
            listed = tuple(dict.fromkeys((*near, *self.known)))[:MOST_NAMES]
            others = len(self.known) - len(listed)
        more = f" and {others} more" if others else ""
        super().__init__(argument, got, f"one of {', '.join(map(repr, listed)) or 'none'}{more}{hint}")


class UnknownPoint(BadArgument):
    """The loop of this ``law`` cannot be opened at the analysis point ``at``, but at those ``known``."""

    def __init__(self, at: object, law: str, known: Sequence[str]) -> None:
        self.at, self.law, self.known = at, law, tuple(known)
        super().__init__("at", at, f"for {law} one of {', '.join(map(repr, known))}")


class Unsupported(BadArgument):
    """The argument is understood, but does not apply to this loop."""


class BadRobot(MfcError, ValueError):
    """A robot model that cannot be analysed."""


class NearSingular(MfcError, ValueError):
    """The Jacobian of a ``frame`` is too close to singular to be inverted.

    ``sigma_min``: its smallest singular value; ``condition``: its condition number; ``time`` [s], where it is known; ``index`` of the configuration.
    """

    def __init__(self, frame: str, sigma_min: float, condition: float, time: float | None = None, index: int = 0) -> None:
        self.frame, self.sigma_min, self.condition, self.time = frame, sigma_min, condition, time
        self.index = index  #: flat index of the configuration
        when = "" if time is None else f" at t = {time:.4g} s"
        super().__init__(
            f"the Jacobian of frame {frame!r} is nearly singular{when}: smallest singular value {sigma_min:.3g}, condition number {condition:.3g}; "
            "move the path away from the singularity, or give the law damping= (an impedance or admittance: inverse_damping=)"
        )

    def at(self, time: float | None) -> NearSingular:
        """The same error with a time [s], if it has none."""
        return NearSingular(self.frame, self.sigma_min, self.condition, time if self.time is None else self.time, self.index)


class NotConverged(MfcError, ValueError):
    """A search (inverse kinematics, equilibrium, periodic orbit, roots) does not converge: ``what`` was looked for, and the ``reason``."""

    def __init__(self, what: str, reason: str = "") -> None:
        super().__init__(f"{what}: {reason}" if reason else what)


class NearPi(MfcError, ValueError):
    """The rotation ``angle`` [rad] of a pose error is within 1e-3 rad of pi, where the logarithm jumps.

    ``time`` [s], where it is known; ``index`` of the configuration.
    """

    def __init__(self, angle: float, time: float | None = None, index: int = 0) -> None:
        self.angle, self.time = angle, time
        self.index = index  #: flat index of the configuration
        when = "" if time is None else f" at t = {time:.4g} s"
        super().__init__(
            f"pose error{when}: its rotation angle is {angle:.6f} rad, within 1e-3 of pi, where the logarithm jumps; start closer to the reference"
        )

    def at(self, time: float | None) -> NearPi:
        """The same error with a time [s], if it has none."""
        return NearPi(self.angle, time if self.time is None else self.time, self.index)


class MissingExtra(MfcError, ImportError):
    """Libraries of an optional extra are not installed: ``extra`` is its name, ``missing`` are the libraries."""

    def __init__(self, extra: str, missing: Sequence[str]) -> None:
        self.extra, self.missing = extra, tuple(missing)
        what, libraries = EXTRAS[extra]
        super().__init__(f'{what} need {" and ".join(libraries)}: pip install "mfc-analysis[{extra}]"')


def require(extra: str) -> None:
    """Raises MissingExtra where a library of an extra is not installed. Loads none of them."""
    missing = [name for name in EXTRAS[extra][1] if not _installed(name)]
    if missing:
        raise MissingExtra(extra, missing)


def _installed(library: str) -> bool:
    try:
        return find_spec(library) is not None
    except ImportError:  # the package that it is part of
        return False


def short(value: Any, most: int = 120) -> str:
    """A value on one line of at most ``most`` characters; the name of its type where Python cannot write it."""
    try:
        text = value if isinstance(value, str) and value.startswith("shape (") else repr(value)
    except (RecursionError, ValueError):  # lists in thousands of lists; whole numbers of thousands of digits
        text = f"one of type {type(value).__name__} that is too deep or too long to show"
    text = " ".join(text.split())
    return text if len(text) <= most else text[: most - 3] + "..."
