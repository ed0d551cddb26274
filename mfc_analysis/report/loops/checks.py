"""A verdict of ``Requirements`` as checks of a section, in the units that a reader expects."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mfc_analysis.report.document.document import Check, Status

if TYPE_CHECKING:
    from mfc_analysis.requirements.requirements import Line, Verdict

_SHOWN = {
    "deg": ("°", 1.0),
    "delay": ("ms", 1e3),
    "overshoot": ("%", 100.0),
    "torque_fraction": ("%", 100.0),
}  #: by unit, or by the requirement's name
_INFINITE = {"gain_increase_db": "no limit", "gain_reduction_db": "no limit", "phase_deg": "no crossover", "delay": "no crossover"}


def checks(verdict: Verdict) -> tuple[Check, ...]:
    """One check for each line of a verdict, in its order (failures first)."""
    return tuple(_check(line) for line in verdict.lines)


def _check(line: Line) -> Check:
    unit, scale = _SHOWN.get(line.name) or _SHOWN.get(line.unit) or (line.unit, 1.0)
    return Check(
        line.label,
        line.asked * scale,
        line.found * scale,
        unit,
        line.distance * scale,
        Status(line.status.value),
        line.where,
        line.when,
        line.sense,
        infinite=_INFINITE.get(line.name, "infinite"),
        undefined="neutral" if _neutral(line) else "unstable" if line.status == "FAIL" else "not defined",
    )


def _neutral(line: Line) -> bool:
    """Whether nothing is defined because every root is at zero."""
    return "at zero" in line.note or line.note.startswith("neutral")
