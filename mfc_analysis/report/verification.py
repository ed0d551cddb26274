"""The report of a test run: every loop that the tests assert on, with the requirements, the evidence, the verdict and the test's name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mfc_analysis.errors import MfcError
from mfc_analysis.report.document.document import (
    Block,
    Bullets,
    Code,
    Column,
    Document,
    Figure,
    Mono,
    Number,
    Paragraph,
    Scope,
    Section,
    Table,
    found_of,
    limit_of,
    written,
)
from mfc_analysis.report.document.provenance import provenance
from mfc_analysis.report.loops.checks import checks
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import Requirements

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.design.searches import Limit
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.requirements.requirements import Verdict
    from mfc_analysis.testing import Asserted

POLES = 8  #: number of poles shown, slowest first


@dataclass(frozen=True)
class Relief:
    """A quantity whose change alone would make a failed assertion pass."""

    name: str
    given: str
    limit: str  #: the value at which the requirements are just met
    why: str  #: what is missed beyond it, or why there is no value


@dataclass(frozen=True)
class Origin:
    """Who made a verification report, of what revision and when; "" where nothing was given."""

    author: str = ""
    revision: str = ""
    date: str = ""


@dataclass(frozen=True, eq=False)
class Record:
    """One assertion, as values that can be sent from one process to another."""

    test: str  #: id of the test
    number: int  #: of the assertion within its test, from 0
    what: str  #: "assert_margins", ...
    loop: str  #: as text
    checks: tuple[Line, ...]
    passed: bool
    notes: tuple[str, ...]
    replay: str
    at: str  #: analysis point; empty where there is none
    times: Any  #: (m,) [s]
    asked: Mapping[str, float]
    margins: Margins | None
    poles: Any  #: (k,) slowest poles [1/s] (or z) at the worst time, with dead time the rightmost roots; None where there are none
    late: bool  #: whether these are the roots with dead time
    numbers: Mapping[str, float]
    outcome: str = ""  #: of the test: "passed", "failed", ...; empty while it runs
    requirement: str = ""  #: its id, if the test gives one
    rationale: str = ""  #: why it is required, if the test says so
    relief: tuple[Relief, ...] = ()  #: of a failure: what would make it pass


def record(asserted: Asserted, test: str, number: int) -> Record:
    """The record of an assertion made in ``test``. Margins and poles are added to the evidence."""
    verdict = asserted.verdict
    found = cast("Verdict", asserted)  # has the lines
    if verdict is None:
        v = asserted.validation
        assert v is not None
        numbers = {"taylor_order": v.taylor_order, "nrmse": v.nrmse, "radius": v.radius, "size": v.size, "time": v.time}
        return Record(
            test,
            number,
            asserted.what,
            str(asserted.loop),
            checks(found.lines),
            asserted.passed,
            (),
            asserted.replay,
            "",
            asserted.times,
            {},
            None,
            None,
            False,
            numbers,
        )
    evidence = verdict.evidence
    try:
        margins = evidence.margins
    except MfcError:
        margins = None
    when = next((line.when for line in asserted.lines if line.when is not None), float(verdict.times[0]))
    i = int(np.argmin(np.abs(verdict.times - when)))
    asked = {line.name: line.asked for line in asserted.lines if line.name not in ("stable", "residual")}
    lin = evidence.linearization
    late = bool(lin.delay or lin.force_delay)
    poles = np.array((evidence.roots[0] if late else lin.poles())[i][:POLES])
    return Record(
        test, number, asserted.what, str(asserted.loop), checks(found.lines), asserted.passed, verdict.notes, asserted.replay,
        verdict.at, np.array(verdict.times), asked, margins, poles[np.isfinite(poles)], late, {},
    )  # fmt: skip


def with_outcomes(records: Sequence[Record], outcomes: Mapping[str, str]) -> list[Record]:
    """The records with the outcomes of their tests, in an order that does not depend on how the tests ran."""
    done = [replace(r, outcome=outcomes.get(r.test, "")) for r in records]
    return sorted(done, key=lambda r: (r.test, r.number))


def relief(asserted: Asserted) -> tuple[Relief, ...]:
    """What would make a failed assertion pass: the limits of payload, dead time, sample rate, wall and gains at which it just does.

    Each is varied alone, from its value in the loop towards easier ones; what the loop does not have is not varied. Empty for an assertion
    without requirements.
    """
    from mfc_analysis import design
    from mfc_analysis.design.edges import Judge, requirement_limit

    verdict, loop = asserted.verdict, asserted.loop
    if verdict is None or asserted.passed:
        return ()
    asked = {line.name: line.asked for line in asserted.lines if line.name not in ("stable", "residual")}
    requirements = Requirements.from_mapping(asked | {"horizon": verdict.evidence.horizon})
    hardware, held = loop.equations.hardware, sum(float(p.mass) for p in loop.robot.payloads)
    how: dict[str, Any] = {"requirements": requirements, "at": verdict.at, "times": verdict.times}
    tries: list[tuple[str, str, Callable[[], Limit]]] = []
    if held:
        tries.append(("payload", f"{held:.4g} kg", lambda: design.max_payload(loop, **how)))
    if hardware.delay:
        tries.append(("dead time", f"{hardware.delay:.4g} s", lambda: design.max_delay(loop, **how)))
    if hardware.sample_time:
        tries.append(("sample rate", f"{1 / hardware.sample_time:.4g} 1/s", lambda: design.min_sample_rate(loop, **how)))
    if loop.equations.surfaces:
        tries.append(("stiffness of the wall", "as given", lambda: design.max_stiffness(loop, **how)))
    force = loop.law.desired_wrench is not None
    powers = _FORCE if force else _POWERS.get(loop.law.plant, {})
    gains = {name: gain.array for name, gain in loop.law.gains().items() if gain and name in powers}
    if gains and (force or set(gains) == {name for name, gain in loop.law.gains().items() if gain}) and set(gains) <= set(loop.law.parameters()):

        def scaled(x: float) -> ClosedLoop:
            return replace(loop, law=loop.law.changed(**{name: array * x ** powers[name] for name, array in gains.items()}))

        judge = Judge(requirements, verdict.times, verdict.at)
        varied = "gains of the force error" if force else "bandwidth of the gains"
        tries.append((varied, "1 (as given)", lambda: requirement_limit(scaled, "bandwidth", 1.0, judge, lower=0.02, upper=50.0)))
    out = []
    for name, given, search in tries:
        try:
            found = search()
        except MfcError as why:
            out.append(Relief(name, given, "not found", str(why)))
            continue
        value = held + float(found) if name == "payload" else float(found)
        unit = "times" if given.startswith("1 (") else found.unit
        limit = f"{value:.4g} {unit}" if found.outcome.name == "FOUND" else "no value" if found.outcome.name == "NOWHERE" else "no limit"
        out.append(Relief(name, given, limit, found.binds))
    return tuple(out)


#: power of the natural frequency in each gain, by what the law commands
_POWERS: dict[str, dict[str, float]] = {"torque": {"kp": 2.0, "ki": 3.0, "kd": 1.0}, "velocity": {"kp": 1.0, "ki": 2.0}}
_FORCE = {"kfp": 1.0, "kfi": 1.0}  #: of a force law: the loop gain at the sensor is linear in both


def verification_document(records: Sequence[Record], lost: Sequence[str] = (), command: str = "", origin: Origin | None = None) -> Document:
    """The document of a test run: failures first, then the others in the order of the tests' names.

    An assertion that failed in a test that passed (an expected failure) is shown as a DEMO, and does not count.

    Args:
        records: of all assertions. lost: names of processes that did not report their assertions. command: for the provenance.
        origin: author, revision and date, where they are given.
    """
    records = sorted(records, key=lambda r: (r.passed or not _counts(r), r.test, r.number))
    several = {r.test for r in records if r.number > 0}
    sections = tuple(_section(r, f"{r.test}, assertion {r.number + 1}" if r.test in several else r.test) for r in records)
    if lost:
        said = f"{', '.join(lost)} did not report the assertions made there. This report is incomplete."
        sections = (Section("Missing evidence", said, verdict=Status.FAIL), *sections)
    tests = len({r.test for r in records})
    failed = sum(not r.passed for r in records)
    subtitle = f"{len(records)} assertion{'s' * (len(records) != 1)} on loops in {tests} test{'s' * (tests != 1)}; {failed} failed"
    given = origin or Origin()
    settings = {name: said for name, said in (("author", given.author), ("revision", given.revision)) if said}
    said = ", ".join(x for x in (f"by {given.author}" if given.author else "", given.revision, given.date) if x)
    made = provenance(command, settings=settings, date=given.date)
    title = f"{subtitle}; {said}" if said else subtitle
    return Document("Verification report", title, sections, "verification", _scope(records), made, front=_traced(records))


def _counts(r: Record) -> bool:
    """Whether a failure counts: not where its test passed, because it was expected."""
    return r.outcome != "passed"


def _traced(records: Sequence[Record]) -> tuple[Section, ...]:
    """Requirement by requirement: id, rationale, tests and result; none without ids."""
    by_id: dict[str, list[Record]] = {}
    for r in records:
        if r.requirement:
            by_id.setdefault(r.requirement, []).append(r)
    if not by_id:
        return ()
    rows = []
    for name, some in by_id.items():
        missed = any(not r.passed and _counts(r) for r in some)
        why = "; ".join(dict.fromkeys(r.rationale for r in some if r.rationale))
        rows.append((name, Status.FAIL if missed else Status.PASS, why, "; ".join(dict.fromkeys(r.test for r in some))))
    heads = (("Requirement", 2.0), ("Result", 1.2), ("Rationale", 4.0), ("Tests", 5.0))
    columns = tuple(Column(head, numeric=False, share=share) for head, share in heads)
    return (Section("Requirements and their tests", body=(Table("Every requirement with an id.", columns, tuple(rows)),), key="traced"),)


def _section(r: Record, name: str) -> Section:
    unexpected = not r.passed and _counts(r)
    body: list[Block] = [Paragraph(("Loop: ", Mono(r.loop)))]
    if r.requirement:
        body.append(Paragraph(f"Requirement {r.requirement}{': ' + r.rationale if r.rationale else ''}."))
    if unexpected and r.relief:
        heads = ("Varied alone", "As given", "Would pass up to", "Why")
        columns = tuple(Column(head, numeric=False) for head in heads)
        body.append(
            Table(
                "What would make it pass: the limits at which the requirements are just met.",
                columns,
                tuple(tuple(asdict(x).values()) for x in r.relief),
            )
        )
    if r.notes:
        body.append(Bullets(tuple(note[:1].upper() + note[1:] + "." for note in r.notes)))
    body += _margins(r)
    body += _poles(r)
    if r.numbers:
        rows = tuple((key.replace("_", " "), Number(x)) for key, x in r.numbers.items())
        body.append(Table("Linear prediction compared with nonlinear simulation.", (Column("Metric", numeric=False), Column("Value")), rows))
    body += [Paragraph("Code that reproduces the assertion:"), Code(r.replay)]
    numbers: dict[str, Any] = {"test": r.test, "assertion": r.what, "passed": r.passed, "outcome": r.outcome, "times": r.times, "at": r.at}
    numbers |= {"asked": dict(r.asked), **r.numbers} | _numbers(r.margins)
    numbers |= {"requirement": r.requirement, "rationale": r.rationale} if r.requirement else {}
    numbers |= {"would_pass": [asdict(x) for x in r.relief]} if r.relief else {}
    return Section(
        name, _finding(r), tuple(body), r.checks, numbers=numbers, loop=name, shown="" if r.passed or unexpected else "the test expects this failure"
    )


def _finding(r: Record) -> str:
    worst = max(r.checks, key=lambda c: c.severity)
    place = f" ({worst.place})" if worst.place else ""
    came = "holds" if r.passed else "failed"
    test = f"; the test {r.outcome}" if r.outcome in ("failed", "skipped") and r.passed else ""
    expected = "; the test passed, so this failure was expected and does not count" if not r.passed and r.outcome == "passed" else ""
    return f"{r.what} {came}. Tightest: {worst.label} {found_of(worst)}, required: {limit_of(worst)}{place}{test}{expected}."


def _margins(r: Record) -> list[Block]:
    if r.margins is None:
        return []
    from mfc_analysis import plots

    worst = str(r.margins.worst())
    said = f"margins at {r.at!r}: {worst}"
    out: list[Block] = [Paragraph(said[:1].upper() + said[1:] + ".")]
    if len(r.times) > 1 and r.margins.stable.any():
        asked = {k: v for k, v in r.asked.items() if k in ("phase_deg", "gain_increase_db", "gain_reduction_db", "delay", "sensitivity_peak")}
        draw = partial(plots.margin_history, r.margins, asked or None)
        span = f"from {written(float(r.times[0]), exact=True)} to {written(float(r.times[-1]), exact=True)} s"
        out.append(Figure(draw, f"Margins at {r.at} {span}, one line per channel; dashed: required limit.", f"Margins against time {span}: {worst}"))
    return out


def _poles(r: Record) -> list[Block]:
    if r.poles is None or not len(r.poles):
        return []
    once = [complex(p) for p in r.poles if p.imag >= 0 or not np.isclose(r.poles, np.conj(p)).any()]  # a pair once
    rows = tuple((k + 1, p) for k, p in enumerate(once))
    what = "rightmost characteristic roots, dead time included exactly," if r.late else "slowest closed-loop poles"
    head = Column("Root", "1/s") if r.late else Column("Pole", "1/s or z")
    return [Table(f"The {len(rows)} {what} at the worst time; a pair once.", (Column("No."), head), rows)]


def _numbers(m: Margins | None) -> dict[str, Any]:
    if m is None:
        return {}
    names = ("stable", "gain_reduction", "gain_increase", "phase_deg", "delay", "sensitivity_peak")
    return {"channels": m.channels} | {name: getattr(m, name) for name in names}


def _scope(records: Sequence[Record]) -> Scope:
    loops = tuple(dict.fromkeys(r.loop for r in records))
    points = {r.at for r in records if r.at}
    model = (*loops[:8], f"and {len(loops) - 8} more loops") if len(loops) > 8 else loops
    return Scope(
        model,
        ("each loop is exactly linearised about its reference", "margins are of one loop at a time, the others closed"),
        (f"the times given in each test; margins at {', '.join(map(repr, sorted(points)))}",) if points else (),
        ("anything that no test asserts; tests that failed before their assertion are not listed",),
    )
