"""A verdict of ``Requirements`` as checks of a section, in the units shown to the reader."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import isfinite, isnan

from mfc_analysis.analysis.loop_step import STEPS
from mfc_analysis.report.document.document import found_of
from mfc_analysis.report.loops.points import METRICS, PEAK, Smallest
from mfc_analysis.requirements.line import Line, Status

_SHOWN = {
    "deg": ("°", 1.0),
    "delay": ("ms", 1e3),
    "overshoot": ("%", 100.0),
    "torque_fraction": ("%", 100.0),
}  #: by unit, or by the requirement's name
_INFINITE = {"gain_increase_db": "no limit", "gain_reduction_db": "no limit", "phase_deg": "no crossover", "delay": "no crossover"}


def checks(lines: Iterable[Line], point: str = "", least: Mapping[str, Smallest] | None = None) -> tuple[Line, ...]:
    """The lines of a verdict in their order (failures first), in the units shown to the reader.

    ``point``: the analysis point of its margins, named in the lines. ``least``: the smallest margins of the loop; a smaller one at another
    point is named too.
    """
    return tuple(_shown(_placed(line, point, least or {})) for line in lines)


def everywhere(lines: Iterable[Line], least: Mapping[str, Smallest]) -> tuple[Line, ...]:
    """The lines of a verdict with the smallest margins over all analysis points, each with its point, in place of those at one point."""
    return tuple(_smallest(line, least) for line in lines)


def _smallest(line: Line, least: Mapping[str, Smallest]) -> Line:
    found = least.get(line.name)
    if found is None or isnan(found.value) or isnan(line.found):
        return line
    distance = line.asked - found.value if line.name == PEAK else found.value - line.asked
    status = Status.PASS if distance >= 0 else Status.FAIL
    when = None if line.when is None else found.when
    return replace(line, found=found.value, distance=distance, status=status, where=found.where, when=when)


def _placed(line: Line, point: str, least: Mapping[str, Smallest]) -> Line:
    """The line with its analysis point where it has one (margins, loop steps), and with a smaller margin at another one."""
    if not (line.name in METRICS or line.label.endswith(f"({STEPS['loop']})")) or not line.where or not point:
        return line
    line = replace(line, where=f"{line.where} at “{point}”")
    other = least.get(line.name)
    if other is None or other.point == point or not isfinite(other.value):
        return line
    value = found_of(_shown(replace(line, found=other.value)))
    if str(value) == str(found_of(_shown(line))):
        return line  # the same to the digits shown
    missed = other.value > line.asked if line.name == PEAK else other.value < line.asked
    return replace(line, elsewhere=f"{value} at “{other.point}” ({other.channel}){', beyond the limit' if missed else ''}")


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
