"""Banner, matrix and worst case of a document, computed from the checks of its sections."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mfc_analysis.report.document.document import Column, Document, Matrix, MatrixCell, Section, Table, distance_of, found_of, limit_of
from mfc_analysis.requirements.line import Line, Status, worst

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

    Demonstrations (``Section.shown``) do not count; the detail says how many there are and how many fail.
    """
    sections = (*document.sections, *document.appendices)
    status = worst([s.judged for s in sections])
    every = every_check(document)
    checks = [(s, c) for s, c in every if not s.shown]
    beside = _beside([(s, c) for s, c in every if s.shown])
    if not checks:
        return Verdict(status, "No requirements were given", ("Without requirements there is nothing to pass or fail." + beside), None, None)
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
        sentence = f"All {len(checks)} checks are met"
    else:
        sentence = f"All {len(checks)} checks are met, but a section has a warning"
    lead = "Worst" if missed or watched else "Tightest"
    return Verdict(status, sentence, f"{lead}: {said(section, check)}.{spread}{beside}", check, section)


def _beside(shown: list[tuple[Section, Line]]) -> str:
    """A sentence about the loops that are shown for demonstration."""
    loops = dict.fromkeys(s.loop or s.title for s, _ in shown)
    if not loops:
        return ""
    bad = dict.fromkeys(s.loop or s.title for s, c in shown if c.status is Status.FAIL)
    one = len(loops) == 1
    lead = f" {len(loops)} {'loop is' if one else 'loops are'} shown for demonstration and not counted"
    return f"{lead}: {len(bad)} of {len(loops)} {'does' if len(bad) == 1 else 'do'} not meet a requirement."


def said(section: Section, check: Line) -> str:
    """One check as text: name, value, requirement, where and when."""
    loop = section.loop or section.title
    if check.name == "stable" and check.note.startswith("unstable: "):
        return f"{loop} is not stable: {check.note.removeprefix('unstable: ')}"
    place = f" ({check.place})" if check.place else ""
    asked = {"≥": "at least", "≤": "at most", "<": "below"}.get(check.sense, check.sense)
    name = "rightmost root" if check.name == "stable" else check.label
    return f"{name} of {loop}: {found_of(check)}, required: {asked} {str(limit_of(check))[len(check.sense) :].strip()}{place}"


def matrix(document: Document, keys: dict[int, str]) -> Matrix | None:
    """Loops x checks, one row per loop name, the worst check if several share a cell; None if no section names its loop.

    Rare checks share the last column. A unit shared by all cells of a column is in its head.
    """
    cells: dict[str, dict[str, tuple[Section, Line]]] = {}
    first: dict[str, Section] = {}
    count: dict[str, int] = {}
    for top in document.sections:
        for section, check in top.every_check():
            loop = section.loop or top.loop
            if not loop:
                continue
            first.setdefault(loop, top if top.loop == loop else section)
            row = cells.setdefault(loop, {})
            if check.label not in row:
                count[check.label] = count.get(check.label, 0) + 1
            if check.label not in row or check.severity > row[check.label][1].severity:
                row[check.label] = (section, check)
    if not cells:
        return None
    rare = [name for name, some in count.items() if some < len(cells) * RARE] if len(count) > MOST_COLUMNS else []
    names = [name for name in count if name not in rare]
    units = {name: {row[name][1].unit for row in cells.values() if name in row} for name in names}
    shared = {name: found.copy().pop() for name, found in units.items() if len(found) == 1}
    shown = {section.loop for top in document.sections for section, _ in top.every_check() if section.shown}
    rows = []
    for loop, row in cells.items():
        others = max((row[name] for name in rare if name in row), key=lambda pair: pair[1].severity, default=None)
        last = (_cell(others, keys, others[1].label if others else ""),) if rare else ()
        found = (*(_cell(row.get(name), keys, unit=shared.get(name)) for name in names), *last)
        rows.append((f"{loop} (shown)" if loop in shown else loop, keys[id(first[loop])], found))
    heads = tuple(f"{name} [{shared[name]}]" if shared.get(name) else name for name in names) + (("other checks",) if rare else ())
    return Matrix("All loops and all checks. Each cell links to its evidence.", heads, tuple(rows))


def requirements(section: Section) -> Table:
    """The checks of one section, failures first: check, value, limit, distance, where, result."""
    rows = sorted(section.checks, key=lambda c: c.severity, reverse=True)
    columns = (
        Column("Check", numeric=False),
        Column("Value"),
        Column("Required"),
        Column("Result"),
        Column("Distance"),
        Column("Where", numeric=False),
    )
    return Table(
        "Checks of this section, the worst first.",
        columns,
        tuple((c.label, found_of(c), limit_of(c), c.status, distance_of(c), _place(c)) for c in rows),
    )


def _cell(pair: tuple[Section, Line] | None, keys: dict[int, str], what: str = "", unit: str | None = None) -> MatrixCell | None:
    if pair is None:
        return None
    section, check = pair
    value = str(replace(found_of(check), unit="")) if unit is not None else str(found_of(check))
    value += f"; {check.elsewhere.partition(' (')[0]}" if check.elsewhere else ""  # the channel is beside the evidence
    return MatrixCell(check.status, f"{what}: {value}" if what else value, keys[id(section)])


def _place(check: Line) -> str:
    return check.place + (f"; smaller: {check.elsewhere}" if check.elsewhere else "")


def _count(some: int, of: int) -> str:
    return f"{some} of {of} checks {'is' if some == 1 else 'are'}"
