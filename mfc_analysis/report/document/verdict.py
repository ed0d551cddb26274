"""Banner, picture, matrix and worst case of a document, computed from the checks of its sections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mfc_analysis.report.document.document import (
    Badge,
    Column,
    Document,
    Figure,
    Matrix,
    MatrixCell,
    Section,
    Table,
    distance_of,
    found_of,
    limit_of,
    written,
)
from mfc_analysis.requirements.line import Line, Status, worst

MOST_BARS = 5  #: margins in the picture of all loops
_ORDER = ("phase margin", "gain margin, down", "gain margin, up", "delay margin", "sensitivity peak")
RARE, MOST_COLUMNS = 0.2, 8  #: in a wide matrix, a check needs this fraction of the loops for its own column


@dataclass(frozen=True, eq=False)
class Verdict:
    """The banner: a status, one sentence, and the worst loop with its channel and time."""

    status: Status
    sentence: str
    detail: str
    check: Line | None  #: the worst one
    section: Section | None  #: the section of that check


def every_check(document: Document) -> tuple[tuple[Section, Line], ...]:
    """All checks of a document, each with its section, in page order."""
    return tuple(pair for section in (*document.sections, *document.appendices) for pair in section.every_check())


def verdict(document: Document) -> Verdict:
    """The banner of a document. A section's own verdict counts as well as its checks; without requirements: INFO.

    Demonstrations (``Section.shown``) and proofs do not count; the detail says how many there are. A proof that fails is a failure.
    """
    sections = (*document.sections, *document.appendices)
    status = worst([s.judged for s in sections])
    every = every_check(document)
    checks = [(s, c) for s, c in every if not s.shown]
    beside = _beside(document, [s for s, _ in every if s.shown])
    wrong = [c for s in sections for _, c in s.every_proof() if c.status is Status.FAIL]
    doubt = f"{len(wrong)} self-test{'s' * (len(wrong) != 1)} of the library failed: {wrong[0].label}" if wrong else ""
    if not checks:
        return Verdict(status, doubt or "No requirements were given", ("Without requirements there is nothing to pass or fail." + beside), None, None)
    section, check = max(checks, key=lambda pair: pair[1].severity)
    missed = [c for _, c in checks if c.status is Status.FAIL]
    watched = [c for _, c in checks if c.status is Status.WATCH]
    loops, bad = ({s.loop for s, c in pairs if s.loop} for pairs in (checks, [(s, c) for s, c in checks if c.status is Status.FAIL]))
    spread = f" Requirements are not met on {len(bad)} of {len(loops)} loops." if bad and len(loops) > 1 else ""
    if missed:
        sentence = f"{_count(len(missed), len(checks))} not met"
    elif watched:
        sentence = f"{_count(len(checks) - len(watched), len(checks))} met, {len(watched)} {'has' if len(watched) == 1 else 'have'} a warning"
    elif status is Status.PASS:
        sentence = f"All {len(checks)} requirements are met"
    else:
        sentence = f"All {len(checks)} requirements are met, but a section has a warning"
    sentence = f"{doubt}; {sentence[:1].lower()}{sentence[1:]}" if doubt else sentence
    lead = "Worst" if missed or watched else "Tightest"
    many = f" {len(loops)} loops are judged." if len(loops) > 1 else ""
    return Verdict(status, sentence, f"{lead}: {said(section, check)}.{spread}{many}{beside}", check, section)


def _beside(document: Document, shown: list[Section]) -> str:
    """A sentence about what does not count: demonstrations and proofs."""
    loops = len(dict.fromkeys(s.loop or s.title for s in shown))
    proofs = [c for s in (*document.sections, *document.appendices) for _, c in s.every_proof()]
    out = f" {loops} {'loop is' if loops == 1 else 'loops are'} shown for demonstration (DEMO) and not counted." if loops else ""
    good = sum(c.status is not Status.FAIL for c in proofs)
    return out + (f" {good} of {len(proofs)} checks of theory are confirmed." if proofs else "")


def said(section: Section, check: Line) -> str:
    """One check as text: name, value, requirement, where and when."""
    loop = section.loop or section.title
    if check.name == "stable" and check.note.startswith("unstable: "):
        return f"{loop} is not stable: {check.note.removeprefix('unstable: ')}"
    place = f" ({check.place})" if check.place else ""
    asked = {"≥": "at least", "≤": "at most", "<": "below"}.get(check.sense, check.sense)
    name = "rightmost root" if check.name == "stable" else check.label
    return f"{name} of {loop}: {found_of(check)}, required: {asked} {str(limit_of(check))[len(check.sense) :].strip()}{place}"


def by_loop(document: Document) -> dict[str, dict[str, tuple[Section, Line]]]:
    """The checks of each loop by their labels, the worst if several have one label."""
    out: dict[str, dict[str, tuple[Section, Line]]] = {}
    for top in document.sections:
        for section, check in top.every_check():
            loop = section.loop or top.loop
            row = out.setdefault(loop, {}) if loop else {}
            if check.label not in row or check.severity > row[check.label][1].severity:
                row[check.label] = (section, check)
    return out


def picture(document: Document) -> Figure | None:
    """Loops x margins as bars against their limits; None for fewer than two loops with margins."""
    from mfc_analysis import plots

    loops = by_loop(document)
    count = Counter(label for row in loops.values() for label, (_, c) in row.items() if c.asked > 0 and c.sense in ("≥", "≤"))
    labels = [label for label in sorted(count, key=_place_in_order) if count[label] >= len(loops) / 2]
    rows = {loop: row for loop, row in loops.items() if any(label in row for label in labels)}
    if len(rows) < 2 or not labels:
        return None
    labels = labels[:MOST_BARS]
    ratio = np.full((len(rows), len(labels)), np.nan)
    words = [["" for _ in labels] for _ in rows]
    marks = []
    for i, row in enumerate(rows.values()):
        marks.append(Badge.DEMO.value if any(s.shown for s, _ in row.values()) else worst([c.status for _, c in row.values()]).value)
        for j, label in enumerate(labels):
            if label in row:
                c = row[label][1]
                words[i][j] = str(replace(found_of(c), unit="", infinite="∞", undefined="–"))
                ratio[i, j] = (c.found / c.asked if c.sense == "≥" else c.asked / c.found if c.found else np.inf) if c.found >= 0 else 0.0
    units = {label: next(row[label][1].unit for row in rows.values() if label in row) for label in labels}
    heads = tuple(f"{label} [{units[label]}]" if units[label] else label for label in labels)
    low = np.nanmin(np.where(np.isfinite(ratio), ratio, np.nan)) if np.isfinite(ratio).any() else np.nan
    return Figure(
        partial(plots.overview, tuple(rows), heads, ratio, tuple(map(tuple, words)), tuple(marks)),
        "Margins of all loops against their limits. A bar is the value over its limit (of an upper limit: the limit over the value). "
        "It must reach the dashed line. Bars end at three times the limit. Loops marked DEMO are shown to make a point and do not count.",
        f"Bars of {len(labels)} margins of {len(rows)} loops against their limits; the smallest is {written(float(low))} times its limit.",
    )


def matrix(document: Document, keys: dict[int, str]) -> Matrix | None:
    """Loops x checks, one row per loop name, the worst check if several share a cell; None if no section names its loop.

    Rare checks share the last column. A unit shared by all cells of a column is in its head.
    """
    cells = by_loop(document)
    if not cells:
        return None
    count = Counter(label for row in cells.values() for label in row)
    rare = [name for name, some in count.items() if some < len(cells) * RARE] if len(count) > MOST_COLUMNS else []
    names = [name for name in count if name not in rare]
    units = {name: {row[name][1].unit for row in cells.values() if name in row} for name in names}
    shared = {name: found.copy().pop() for name, found in units.items() if len(found) == 1}
    rows = []
    for loop, every in cells.items():
        row = {k: pair for k, pair in every.items() if k == "stable" or not pair[0].shown}  # of a demonstration, only what it is
        others = max((row[name] for name in rare if name in row), key=lambda pair: pair[1].severity, default=None)
        last = (_cell(others, keys, others[1].label if others else ""),) if rare else ()
        found = (*(_cell(row.get(name), keys, unit=shared.get(name)) for name in names), *last)
        rows.append((loop, keys[id(next(iter(every.values()))[0])], found))
    heads = tuple(f"{_head(name)} [{shared[name]}]" if shared.get(name) else _head(name) for name in names) + (("other checks",) if rare else ())
    return Matrix("All loops and all requirements; a value without a word passes. Each cell links to its evidence.", heads, tuple(rows))


def requirements(section: Section) -> Table:
    """The checks of one section, failures first: check, value, limit, distance, where, result."""
    rows = sorted(section.checks, key=lambda c: c.severity, reverse=True)
    heads = ("Requirement", "Result", "Value", "Required", "Distance", "Where")
    columns = tuple(Column(head, numeric=head not in ("Requirement", "Result", "Where")) for head in heads)
    caption = "What was asked of this loop, the worst first" + ("; shown to make a point, not counted." if section.shown else ".")
    return Table(
        caption,
        columns,
        tuple((c.label, Badge.DEMO if section.shown else c.status, found_of(c), limit_of(c), distance_of(c), _place(c)) for c in rows),
    )


def folded(section: Section) -> Table:
    """The checks of the loops of a folded section: a row for each loop, with its result, values and places."""
    loops = [s for s in section.sections if s.checks]
    first: dict[str, Line] = {}
    for c in sorted((c for s in loops if not s.shown for c in s.checks), key=lambda c: _place_in_order(c.label)):
        first.setdefault(c.label, c)
    columns = [Column("Loop", numeric=False), Column("Result", numeric=False)]
    columns += [Column(f"{label} {limit_of(c)}" if c.asked else _head(label), "" if c.asked else c.unit, numeric=False) for label, c in first.items()]
    rows = []
    for one in loops:
        found = {c.label: c for c in one.checks if not one.shown or c.name == "stable"}
        cells = [_at(found[label]) if label in found else "" for label in first]
        rows.append((one.title, one.badge or Badge.DEMO, *cells))
    return Table("What was asked of these loops, and the worst value of each along its path.", tuple(columns), tuple(rows))


def _at(check: Line) -> str:
    """The value found with its place; without where there is no limit to it."""
    return f"{found_of(check)}{' ' + check.place if check.place and np.isfinite(check.found) else ''}"


def _head(label: str) -> str:
    """The head of a column: of stability, what its number is."""
    return "rightmost pole" if label == "stable" else label


def _place_in_order(label: str) -> int:
    order = ("stable", *_ORDER)
    return order.index(label) if label in order else len(order)


def proofs(document: Document) -> tuple[Section, ...]:
    """The appendix of theory checked and of the library's own tests; none without them."""
    every = [pair for section in (*document.sections, *document.appendices) for pair in section.every_proof()]
    if not every:
        return ()
    good = sum(c.status is not Status.FAIL for _, c in every)
    by_section: dict[int, list[tuple[Section, Line]]] = {}
    for s, c in every:
        by_section.setdefault(id(s), []).append((s, c))
    heads = (Column("Section", numeric=False, share=3), Column("Result", numeric=False, share=1.6), Column("What agrees", numeric=False, share=6))
    rows = []
    for some in by_section.values():
        wrong = any(c.status is Status.FAIL for _, c in some)
        agreed = "; ".join(f"{c.label}{f': {c.where}' if c.where else ''} ({found_of(c)}, {limit_of(c)})" for _, c in some)
        rows.append((some[0][0].title, Status.FAIL if wrong else Badge.CONFIRMED, agreed))
    caption = (
        "Closed forms, equivalent formulations and nonlinear simulations against the numbers of this report (found, limit); 0 is rounding error."
    )
    table = Table(caption, heads, tuple(rows))
    finding = f"{good} of {len(every)} checks of theory and of the library are confirmed. They do not judge a loop and do not count in the verdict."
    return (Section("Theory and self-tests", finding, (table,), key="self-tests"),)


def _cell(pair: tuple[Section, Line] | None, keys: dict[int, str], what: str = "", unit: str | None = None) -> MatrixCell | None:
    if pair is None:
        return None
    section, check = pair
    value = str(replace(found_of(check), unit="")) if unit is not None else str(found_of(check))
    value += f"; {check.elsewhere.partition(' (')[0]}" if check.elsewhere else ""  # the channel is beside the evidence
    return MatrixCell(Badge.DEMO if section.shown else check.status, f"{what}: {value}" if what else value, keys[id(section)])


def _place(check: Line) -> str:
    return check.place + (f"; smaller: {check.elsewhere}" if check.elsewhere else "")


def _count(some: int, of: int) -> str:
    return f"{some} of {of} requirements {'is' if some == 1 else 'are'}"
