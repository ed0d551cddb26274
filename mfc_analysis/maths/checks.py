"""Checks of public arguments: each returns the coerced, read-only value or raises ``BadArgument``, which names the argument."""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths.arrays import Array

Kind = TypeVar("Kind")

#: kinds of Python and numpy objects that numpy would read as real numbers
_NOT_REAL = (str, bytes, bool, np.bool_, complex, np.complexfloating, np.datetime64, np.timedelta64)

MOST_JOBS = 10_000

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def array(argument: str, value: Any, shape: tuple[int | None, ...] | None = None, takes: str | None = None) -> Array:
    """A finite float array of the given shape (None: any length on that axis), copied and read-only."""
    said = takes or ("finite numbers" if shape is None else f"finite numbers of shape {_shape(shape)}")
    out = _real(argument, value, said)
    if shape is not None and (out.ndim != len(shape) or any(s is not None and s != d for s, d in zip(shape, out.shape, strict=True))):
        raise BadArgument(argument, f"shape {out.shape}", said)
    if not np.isfinite(out).all():
        raise BadArgument(argument, value, said)
    out.setflags(write=False)
    return out


def vector(argument: str, value: Any, takes: str = "finite numbers of shape (any,)") -> Array:
    """A finite 1-D float array, read-only; a single number becomes one entry."""
    out = array(argument, value, takes=takes)
    if out.ndim > 1:
        raise BadArgument(argument, f"shape {out.shape}", takes)
    return out.reshape(-1)


def number(argument: str, value: Any, *, low: float = -np.inf, high: float = np.inf, strict: bool = False, allow_inf: bool = False) -> float:
    """A finite float in [low, high] (``strict``: low is excluded)."""
    bounds = f"a number {'>' if strict else '>='} {low:g}" if high == np.inf and low > -np.inf else f"a number in [{low:g}, {high:g}]"
    said = "a finite number" if low == -np.inf and high == np.inf else bounds
    given = _real(argument, value, said)
    if given.ndim:
        raise BadArgument(argument, value, said)
    out = float(given)
    ok = (np.isfinite(out) or (allow_inf and out == np.inf)) and out <= high and (out > low if strict else out >= low)
    if not ok:
        raise BadArgument(argument, value, said)
    return out


def whole(argument: str, value: Any, low: int, high: int, takes: str | None = None) -> int:
    """An integer in [low, high]; a boolean or a float is none."""
    if isinstance(value, _NOT_REAL) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise BadArgument(argument, value, takes or f"a whole number from {low} to {high}")
    return int(value)


def jobs(n_jobs: int | None) -> int | None:
    """A number of processes, -1 for one on each core, None: set by ``joblib.parallel_config``, else one. Raises BadArgument."""
    if n_jobs is not None and whole("n_jobs", n_jobs, -MOST_JOBS, MOST_JOBS) == 0:
        raise BadArgument("n_jobs", n_jobs, "a number of processes, or -1 for one on each core")
    return n_jobs


def decimal(text: str) -> float | None:
    """The finite number of a text in plain decimals: digits 0 to 9, a point, an exponent. None for ``1_0``, ``1,5``, full-width digits, ``nan``."""
    value = float(text) if _DECIMAL.fullmatch(text) else np.inf
    return value if np.isfinite(value) else None


def names(argument: str, value: Any, known: Collection[str]) -> tuple[str, ...]:
    """Several of the known names, in a list, a tuple or a set."""
    if not isinstance(value, (list, tuple, set, frozenset)):
        raise BadArgument(argument, value, f"a list of names among {', '.join(map(repr, known)) or 'none'}")
    for name in value:
        if not isinstance(name, str) or name not in known:
            raise UnknownName(argument, name, known)
    return tuple(value)


def instance(argument: str, value: Any, kind: type[Kind], takes: str) -> Kind:
    """The value itself, if it is of this class."""
    if not isinstance(value, kind):
        raise BadArgument(argument, value, takes)
    return value


def path(argument: str, value: Any, takes: str = "a path") -> Path:
    """The path of a file or folder, given as text or as an object with ``__fspath__``."""
    if not isinstance(value, (str, os.PathLike)) or not isinstance(given := os.fspath(value), str) or "\0" in given:
        raise BadArgument(argument, value, takes)
    return Path(given)


def _real(argument: str, value: Any, said: str) -> Array:
    """A new float array of real numbers, finite or not. Raises BadArgument: not numbers, or a list with rows of different lengths."""
    try:
        given = np.asarray(value)
    except ValueError as why:
        raise BadArgument(argument, value, f"{said}, in rows of equal length") from why
    try:
        if given.dtype.kind not in "iufO":
            raise TypeError
        hidden = given.dtype.kind == "O" or not isinstance(value, (np.ndarray, float, int))  # numpy would read [1.0, True] as numbers
        if hidden and any(isinstance(one, _NOT_REAL) for one in np.asarray(value, dtype=object).flat):
            raise TypeError
        return np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as why:  # OverflowError: an integer beyond the largest float
        raise BadArgument(argument, value, said) from why


def times(value: Any, argument: str = "times") -> Array:
    """A strictly increasing 1-D array of at least one time [s]; a single number becomes one time."""
    out = vector(argument, value, "finite, strictly increasing times [s]")
    if out.size == 0 or np.any(np.diff(out) <= 0):
        raise BadArgument(argument, value, "finite, strictly increasing times [s], at least one")
    return out


def frequencies(value: Any) -> Array:
    """(k,) finite frequencies >= 0 [rad/s]."""
    takes = "finite frequencies >= 0 [rad/s]"
    w = vector("frequencies", value, takes)
    if np.any(w < 0):
        raise BadArgument("frequencies", value, takes)
    return w


def per_joint(argument: str, value: Any, n: int, *, low: float = -np.inf) -> Array:
    """A scalar or (n,) array, broadcast to (n,), finite and >= low."""
    out = array(argument, value)
    if out.ndim > 1 or (out.ndim == 1 and out.size != n):
        raise BadArgument(argument, f"shape {out.shape}", f"a scalar or shape ({n},)")
    if np.any(out < low):
        raise BadArgument(argument, value, f"values >= {low:g}")
    out = np.array(np.broadcast_to(out, (n,)))
    out.setflags(write=False)
    return out


def choice(argument: str, value: Any, known: tuple[str, ...]) -> str:
    """One of the known words."""
    if not isinstance(value, str) or value not in known:
        raise BadArgument(argument, value, "one of " + ", ".join(map(repr, known)))
    return value


def _shape(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
