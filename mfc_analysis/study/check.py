"""The requirements of a study, checked on its loops and over its ranges: the worst line of each, with joint and time."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mfc_analysis.robots.coupling import lacks_armature
from mfc_analysis.study.limits import limits, number
from mfc_analysis.study.tuned import tuned

if TYPE_CHECKING:
    from mfc_analysis.design.searches import Limit
    from mfc_analysis.design.tuning import Tuned
    from mfc_analysis.requirements.line import Line
    from mfc_analysis.requirements.requirements import Verdict
    from mfc_analysis.study.read import Study, StudyLoop

COLUMNS = ("result", "requirement", "required", "value", "where", "when", "case")

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class LoopCheck:
    """The result of one loop of a study: the worst line of each requirement over its cases."""

    loop: StudyLoop
    lines: tuple[tuple[Line, str], ...]  #: line and case ("" without ranges), failures first
    verdicts: tuple[tuple[str, Verdict], ...]  #: case and verdict, in the order of the ranges
    notes: tuple[str, ...]
    limits: tuple[Limit, ...] = ()  #: of the ``[design]`` table
    tuned: Tuned | None = None  #: its gains

    @property
    def cases(self) -> int:
        """Number of cases checked."""
        return len(self.verdicts)

    @property
    def status(self) -> str:
        """PASS, WATCH or FAIL: the worst of the lines."""
        return max((line.status for line, _ in self.lines), key=lambda s: s.rank).value

    @property
    def heading(self) -> str:
        """The loop as text."""
        over = f", {self.cases} cases" if self.cases > 1 else ""
        t = self.loop.times
        when = f"t = {t[0]:g} s" if len(t) == 1 else f"{len(t)} times from {t[0]:g} to {t[-1]:g} s"
        return f"{self.loop.name}: {self.loop.loop}; {when}{over}"

    def rows(self) -> list[tuple[str, ...]]:
        """Cells of the table, in the order of COLUMNS."""
        out: list[tuple[str, ...]] = []
        for line, case in self.lines:
            status, label, _, asked, *_ = line.cells()
            found = "undefined" if math.isnan(line.found) else f"{line.found:.4g} {line.unit}".rstrip()
            out.append((status, label, asked, found, line.where, "" if line.when is None else f"{line.when:.4g} s", case))
        return out

    def sentences(self) -> list[str]:
        """The verdict as sentences: each requirement that is not met, with joint and time, then notes and limits."""
        out = []
        for line, case in self.lines:
            if line.status != "PASS":
                status, label, found, asked, _, place, note = line.cells()
                where = "; ".join(part for part in (place, case, note) if part)
                out.append(f"{status}: {self.loop.name}: {label}: found {found}, required {asked}{f' ({where})' if where else ''}")
        out += [f"note: {note}" for note in self.notes]
        out += [f"limit: {limit}" for limit in self.limits]
        out += [f"tuned: {self.tuned}"] if self.tuned is not None else []
        return [*out, f"{self.status}: {self.loop.name}"]


def check(study: Study, progress: Progress = lambda what, done, of: None, *, search: bool = False) -> tuple[LoopCheck, ...]:
    """Checks every loop of the study against its requirements, over its ranges; ``search``: finds its design limits too.

    Raises StudyError if a loop cannot be checked.
    """
    found = tuple(_check(loop, progress) for loop in study.loops)
    return tuple(replace(one, limits=limits(one.loop, progress), tuned=tuned(one.loop)) for one in found) if search else found


def _check(one: StudyLoop, progress: Progress) -> LoopCheck:
    cases = list(one.cases())
    progress(one.name, 0, len(cases) or 1)
    requirements = one.requirements
    found: list[tuple[str, Verdict]] = []
    with one.parts.within(""):
        for i, case in enumerate(cases):
            found.append((str(case), requirements.check(case.loop, one.times, one.at)))
            progress(one.name, i + 1, len(cases))
        if not cases:
            found.append(("", requirements.check(one.loop, one.times, one.at)))
    worst: dict[str, tuple[Line, str]] = {}
    for case_said, verdict in found:
        for line in verdict.lines:
            if line.name not in worst or line.severity > worst[line.name][0].severity:
                worst[line.name] = (line, case_said)
    lines = sorted(worst.values(), key=lambda pair: pair[0].severity, reverse=True)
    notes = dict.fromkeys(note for _, verdict in found for note in verdict.notes)
    if one.loop.law.plant == "torque" and (lacking := lacks_armature(one.loop.robot, one.loop.nominal(one.times).q)):
        notes[lacking] = None
    return LoopCheck(one, tuple(lines), tuple(found), tuple(notes))


def as_json(checks: Sequence[LoopCheck]) -> str:
    """The lines as JSON; infinite and undefined values are words."""
    out = []
    for one in checks:
        lines = [
            {
                "requirement": line.name, "status": line.status.value, "asked": number(line.asked), "found": number(line.found), "unit": line.unit,
                "where": line.where, "when": line.when, "case": case, "note": line.note,
            }
            for line, case in one.lines
        ]  # fmt: skip
        limits = {limit.name: {"value": number(float(limit)), "unit": limit.unit, "binds": limit.binds} for limit in one.limits}
        gains = {} if one.tuned is None else {"tuned": {"gains": one.tuned.gains, "met": one.tuned.met, "case": one.tuned.case}}
        notes = list(one.notes)
        out.append({"loop": one.loop.name, "status": one.status, "cases": one.cases, "lines": lines, "notes": notes, "limits": limits, **gains})
    return json.dumps(out, indent=2, ensure_ascii=False)
