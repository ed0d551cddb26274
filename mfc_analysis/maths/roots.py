"""A real root between two points, by Brent's method of scipy."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast


def root_between(f: Callable[[float], float], left: float, right: float, *, xtol: float = 2e-12, rtol: float = 1e-14) -> float:
    """The point between left and right where f changes sign. Raises ValueError where f has the same sign at both."""
    from scipy.optimize import brentq

    return cast(float, brentq(f, left, right, xtol=xtol, rtol=rtol))  # pyright: ignore[reportArgumentType]  # scipy has no types
