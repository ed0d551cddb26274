"""A verdict of ``Requirements`` as checks of a section, in the units shown to the reader."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from mfc_analysis.requirements.line import Line, Status

_SHOWN = {
    "deg": ("°", 1.0),
    "delay": ("ms", 1e3),
    "overshoot": ("%", 100.0),
    "torque_fraction": ("%", 100.0),
}  #: by unit, or by the requirement's name
_INFINITE = {"gain_increase_db": "no limit", "gain_reduction_db": "no limit", "phase_deg": "no crossover", "delay": "no crossover"}


def checks(lines: Iterable[Line]) -> tuple[Line, ...]:
    """The lines of a verdict in their order (failures first), in the units shown to the reader."""
    return tuple(_shown(line) for line in lines)


def _shown(line: Line) -> Line:
    unit, scale = _SHOWN.get(line.name) or _SHOWN.get(line.unit) or (line.unit, 1.0)
    return replace(
        line,
        asked=line.asked * scale,
        found=line.found * scale,
        unit=unit,
        distance=line.distance * scale,
        infinite=_INFINITE.get(line.name, "unlimited"),
        undefined=_undefined(line),
    )


def _undefined(line: Line) -> str:
    """The word for a value that is not defined."""
    if "every root is slow" in line.note:
        return "every root is slow" if line.name == "stable" else "nothing holds it"
    return "unstable" if line.status is Status.FAIL else "not defined"
