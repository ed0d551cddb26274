"""Checks of public arguments: each returns the coerced, read-only value or raises ``BadArgument``, which names the argument."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array


def array(argument: str, value: Any, shape: tuple[int | None, ...] | None = None, takes: str | None = None) -> Array:
    """A finite float array of the given shape (None: any length on that axis), copied and read-only."""
    said = takes or ("finite numbers" if shape is None else f"finite numbers of shape {_shape(shape)}")
    try:
        if np.asarray(value).dtype.kind in "USmM":  # numpy would read the text "3" as a number
            raise TypeError
        out = np.array(value, dtype=float)
    except (TypeError, ValueError) as why:
        raise BadArgument(argument, value, said) from why
    if shape is not None and (out.ndim != len(shape) or any(s is not None and s != d for s, d in zip(shape, out.shape, strict=True))):
        raise BadArgument(argument, f"shape {out.shape}", said)
    if not np.isfinite(out).all():
        raise BadArgument(argument, value, said)
    out.setflags(write=False)
    return out


def at_least_1d(argument: str, value: Any) -> Any:
    """A single number as a list of one; other values unchanged. Raises BadArgument for ragged sequences."""
    try:
        return [value] if np.ndim(value) == 0 else value
    except ValueError as why:
        raise BadArgument(argument, value, "numbers in a regular array") from why


def number(argument: str, value: Any, *, low: float = -np.inf, high: float = np.inf, strict: bool = False, allow_inf: bool = False) -> float:
    """A finite float in [low, high] (``strict``: low is excluded)."""
    bounds = f"a number {'>' if strict else '>='} {low:g}" if high == np.inf and low > -np.inf else f"a number in [{low:g}, {high:g}]"
    said = "a finite number" if low == -np.inf and high == np.inf else bounds
    try:
        if isinstance(value, (str, bytes, bool, complex)):
            raise TypeError
        out = float(value)
    except (TypeError, ValueError) as why:
        raise BadArgument(argument, value, said) from why
    ok = (np.isfinite(out) or (allow_inf and out == np.inf)) and out <= high and (out > low if strict else out >= low)
    if not ok:
        raise BadArgument(argument, value, said)
    return out


def times(value: Any, argument: str = "times") -> Array:
    """A strictly increasing 1-D array of at least one time [s]; a single number becomes one time."""
    out = array(argument, at_least_1d(argument, value), (None,), "finite, strictly increasing times [s]")
    if out.size == 0 or np.any(np.diff(out) <= 0):
        raise BadArgument(argument, value, "finite, strictly increasing times [s], at least one")
    return out


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
