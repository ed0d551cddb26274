"""A sampled response that can be evaluated between its samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mfc_analysis.maths.arrays import Array


@dataclass(frozen=True, eq=False)
class Run:
    """A sampled response that can be evaluated between its samples."""

    t: Array  #: (k,) [s]
    y: Array  #: (k,)
    slope: Array  #: (k,) [1/s]
    between: Callable[[int, float], tuple[float, float]]  #: (k, d): y and its slope at t[k] + d
