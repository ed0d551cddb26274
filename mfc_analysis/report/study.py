"""The report of a study: the pages of its loops, then sections for its ranges and its design limits."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.errors import MfcError
from mfc_analysis.report.document.document import Block, Bullets, Column, Document, Figure, Number, Paragraph, Section, Table
from mfc_analysis.study.check import LoopCheck, check as check_study
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.limits import COLUMNS, LoopLimits, limits, requirement_limits
from mfc_analysis.study.measured import compared
from mfc_analysis.study.tuned import tuned

if TYPE_CHECKING:
    from mfc_analysis.analysis.comparison import Comparison
    from mfc_analysis.analysis.frf import FrequencyResponse
    from mfc_analysis.design.searches import Limit
    from mfc_analysis.design.tuning import Tuned
    from mfc_analysis.requirements.line import Line
    from mfc_analysis.study.read import Study

Progress = Callable[[str, int, int], None]

MOST_ROWS = 40  #: cases shown on a page

#: sections of a loop that ``report.sections`` of a study can select, with their titles
PAGES: dict[str, tuple[str, ...]] = {
    "loop": ("The loop and its parameters",),
    "margins": ("Stability margins", "A second opinion by python-control"),
    "poles": ("Poles",),
    "path": ("Along the path",),
    "run": ("Step response, linear and nonlinear", "Nonlinear simulation"),
    "validation": ("Validity of the linear model",),
    "pose": ("Pose of the arm",),
}


def report(study: Study, out: str | os.PathLike[str], formats: Sequence[str], progress: Progress) -> tuple[Path, ...]:
    """Writes the report of a study into ``out`` and nowhere else; returns the files.

    Args:
        formats: some of "html", "pdf", "json"; empty: those of the study. progress: called with (what, done, of).
    """
    from mfc_analysis.report import render

    loops = study.loops
    analysed: list[str] = []

    def done(name: str) -> None:
        analysed.append(name)
        progress(f"analysing {name}", len(analysed), len(loops))

    found = document(study, done, progress)
    files = render(found, out, formats or study.formats, progress=lambda some, of: progress("writing", some, of))
    return tuple(files.values())


def document(study: Study, done: Callable[[str], None] | None = None, progress: Progress = lambda what, some, of: None) -> Document:
    """The report of a study as values. Raises StudyError if a loop cannot be analysed."""
    from mfc_analysis.report.loops.report import loop_document

    loops = study.loops
    try:
        made = loop_document(
            {one.name: one.loop for one in loops},
            {one.name: one.times for one in loops},
            {one.name: one.requirements for one in loops},
            at={one.name: one.at for one in loops},
            title=study.title,
            name=study.name,
            command=f"mfc-analysis report {study.file.name} --out out",
            inputs={path.name: path.read_bytes() for path in study.files()},
            done=done,
        )
    except MfcError as why:
        raise StudyError(str(study.file), "", str(why)) from why
    chosen = study.table.report.sections
    sections = list(made.sections)
    if chosen is not None:
        kept = {title for key in chosen for title in PAGES[key]}
        sections = [replace(s, sections=tuple(inner for inner in s.sections if inner.title in kept)) for s in sections]
    for one in loops:
        sections += [measured_section(one.name, *pair, many=len(loops) > 1) for pair in compared(one)]
    if any(one.table.ranges.model_fields_set for one in loops):
        sections += [ranges_section(found) for found in check_study(study, progress) if found.cases > 1]
    for one in loops:
        many = len(loops) > 1
        searched = limits(one, progress)
        if searched:
            sections.append(limits_section(one.name, searched, many=many))
        if one.table.design.limits:
            sections.append(would_pass_section(requirement_limits(one, progress), many=many))
        gains = tuned(one)
        if gains is not None:
            sections.append(tuned_section(one.name, gains, many=many))
    return replace(made, sections=tuple(sections), subtitle=study.text or made.subtitle)


def ranges_section(found: LoopCheck) -> Section:
    """The worst line of each requirement over the ranges with its case, and the result of each case."""
    from mfc_analysis.report.loops.checks import checks
    from mfc_analysis.requirements.line import Status

    worst, case = found.lines[0]
    lines = tuple(replace(line, where=", ".join(part for part in (line.where, said) if part)) for line, said in found.lines)
    ranked = sorted(found.verdicts, key=lambda pair: pair[1].worst.severity, reverse=True)[:MOST_ROWS]
    words = [Column(head, numeric=False) for head in ("Case", "Tightest requirement", "Where")]
    columns = (words[0], Column("Result"), words[1], Column("Value"), words[2])
    rows = tuple((said, Status(v.status.value), v.worst.label, _found(v.worst), v.worst.place) for said, v in ranked)
    which = f"the worst {len(rows)} of {found.cases} cases" if len(rows) < found.cases else f"all {found.cases} cases"
    table = Table(f"{which[:1].upper()}{which[1:]}, the worst first; the controller's model does not change.", columns, rows)
    finding = f"The worst of {found.cases} cases is {case}: {worst.label} ({worst.place or 'everywhere'})."
    numbers = {"cases": found.cases, "worst": {line.name: {"found": line.found, "case": said} for line, said in found.lines}}
    shown = checks(lines)
    return Section(f"{found.loop.name}: parameter ranges", finding, (table,), shown, numbers=numbers, loop=f"{found.loop.name}, over its ranges")


def _found(line: Line) -> str:
    return "undefined" if math.isnan(line.found) else f"{line.found:.4g} {line.unit}".rstrip()


def measured_section(name: str, found: FrequencyResponse, over: Comparison, *, many: bool) -> Section:
    """A measured loop over the model: the verdict, the picture, and the margins of both."""
    from mfc_analysis import plots

    rows = over.rows()
    said = f"{over.verdict[:1].upper()}{over.verdict[1:]}."
    alt = f"Gain and phase of the measured loop (dots) and of the model (line) over the frequency, and the misfit of the phase. {said}"
    caption = f"The loop at {over.at}, {over.channel}, t = {over.time:g} s: measured (dots; grey where its deviation exceeds 1 dB) and model (line)."
    columns = (Column("", numeric=False), Column("Measured"), Column("Model"), Column("Difference"))
    body = (
        Paragraph(f"Estimated by {found.method}. {str(found).splitlines()[-1].strip().capitalize()}."),
        Figure(partial(plots.comparison, over), caption, alt),
        Table("Margins of both. Those of the measured loop are read from the trusted data, and from nothing beyond them.", columns, tuple(rows)),
    )
    title = f"{name}: measured and model" if many else "Measured and model"
    numbers = {"at": over.at, "channel": over.channel, "verdict": over.verdict, "margins": over.numbers()}
    return Section(title, said, body, numbers=numbers)


def limits_section(name: str, searched: Sequence[Limit], *, many: bool) -> Section:
    """The limits found, and the requirement that fails beyond each."""
    columns = (Column("Limit", numeric=False), Column("Value"), Column("Limited by", numeric=False), Column("Loops evaluated"))
    rows = tuple(
        (limit.name, Number(float(limit), limit.unit, digits=5), "; ".join([limit.binds or limit.outcome.value, *limit.notes]), limit.evaluations)
        for limit in searched
    )
    first = searched[0]
    finding = f"{first.name[:1].upper()}{first.name[1:]}: {Number(float(first), first.unit, digits=4)}."
    title = f"{name}: design limits" if many else "Design limits"
    numbers = {limit.name: {"value": float(limit), "unit": limit.unit, "evaluations": limit.evaluations} for limit in searched}
    return Section(title, finding, (Table("Limits found by bisection on exact stability or on the requirements.", columns, rows),), numbers=numbers)


def would_pass_section(found: LoopLimits, *, many: bool) -> Section:
    """The limits at which the requirements are met, with what binds and its pose, and what each imperfection costs as a table and bars."""
    from mfc_analysis import plots

    name, costs = found.loop.name, found.costs
    head = tuple(Column(word[:1].upper() + word[1:], numeric=False) for word in COLUMNS)
    body: list[Block] = [
        Table("Limits at which the requirements are just met, each quantity varied alone from its value in the study.", head, tuple(found.rows()))
    ]
    said = found.sentences()
    body += [Bullets(tuple(f"{text[:1].upper()}{text[1:]}." for text in said))] if said else []
    if costs.factors:
        caption = "Cost of each imperfection, alone in the ideal loop and on top of all the others."
        body.append(Figure(lambda: costs.plot(ax=plots.axes_for("costs")), caption, f"Where the margin went: {costs.joint[costs.shown]:.3g} in all."))
        words, *rows = costs.rows()
        caption = "Cost of each imperfection alone (in brackets: on top of all the others); positive: worse."
        body.append(Table(caption, tuple(Column(word or "Imperfection", numeric=False) for word in words), tuple(rows)))
    first = found.found[0]
    value, start = found.rows()[0][1:3]
    finding = f"{'Met as given' if found.met else 'Not met as given'}; {first.name}: {value} (as given: {start})."
    numbers = {one.name: {"value": None if one.limit is None else float(one.limit), "as given": one.given, "unit": one.unit} for one in found.found}
    return Section(f"{name}: what would make it pass" if many else "What would make it pass", finding, tuple(body), numbers=numbers)


def tuned_section(name: str, found: Tuned, *, many: bool) -> Section:
    """The tuned gains, what binds, and what one more hertz would miss."""
    rows = tuple((gain, Number(value, digits=6)) for gain, value in found.gains.items())
    table = Table("Gains that meet the requirements over the path and the ranges.", (Column("Gain", numeric=False), Column("Value")), rows)
    lines = [line.strip() for line in str(found).splitlines()[1:]]
    finding = f"{lines[0][:1].upper()}{lines[0][1:]}."
    blocks = (table, Bullets(tuple(f"{line[:1].upper()}{line[1:]}." for line in lines[1:])))
    return Section(f"{name}: tuned gains" if many else "Tuned gains", finding, blocks, numbers={"gains": found.gains, "met": found.met})


def chapter(out: str | os.PathLike[str], formats: Sequence[str], progress: Progress, *, full: bool = False) -> tuple[Path, ...]:
    """Writes the report of the whole chapter into ``out``; ``full``: a page for each arm and misprint, and all pictures."""
    from mfc_analysis.plots.batch import second_process

    with second_process():
        from mfc_analysis.report.chapter.chapter import write_chapter

        files = write_chapter(out, formats or ("html", "pdf", "json"), lambda some, of: progress("the chapter", some, of), full=full)
    return tuple(files.values())
