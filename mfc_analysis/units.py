"""Conversion of common units to SI and radians."""

from __future__ import annotations

import math

from mfc_analysis.maths import checks


def hertz(f: float) -> float:
    """A frequency of ``f`` cycles per second in rad/s: 2 pi f. Raises ``BadArgument`` for anything but a finite number >= 0."""
    return 2.0 * math.pi * checks.number("f", f, low=0.0)
