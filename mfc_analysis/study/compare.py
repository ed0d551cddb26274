"""Two studies side by side: what changed between them, what it did to each requirement, and what each imperfection costs in both."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mfc_analysis.study.check import LoopCheck, check
from mfc_analysis.study.tables import Table

if TYPE_CHECKING:
    from mfc_analysis.design.attribution import Attribution
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.study.read import Study, StudyLoop

Progress = Callable[[str, int, int], None]

CHANGES = ("key", "first", "second")
REQUIREMENTS = ("requirement", "first", "second", "change", "first result", "second result", "where in the second")
#: tables whose keys make the loop; the others say what is asked of it
MAKES_THE_LOOP = ("robot", "controller_model", "law", "q_start", "q_start_deg", "reference", "environment", "hardware")


@dataclass(frozen=True, eq=False)
class Comparison:
    """One loop of the first study and one of the second."""

    first: LoopCheck
    second: LoopCheck
    changes: tuple[tuple[str, str, str], ...]  #: key, value in the first and in the second
    did: Attribution | None  #: what each change of the loop did, alone and on top of all the others; None: no such change, or not one at a time
    costs: tuple[Attribution, Attribution]  #: what each imperfection costs in the first and in the second

    @property
    def heading(self) -> str:
        """The two loops, in words."""
        return f"{self.first.loop.name} -> {self.second.loop.name}"

    def rows(self) -> list[tuple[str, ...]]:
        """Cells of the table of requirements, in the order of REQUIREMENTS."""
        before, after = ({line.name: line for line, _ in one.lines} for one in (self.first, self.second))
        out: list[tuple[str, ...]] = []
        for name in dict.fromkeys([*after, *before]):
            a, b = before.get(name), after.get(name)
            shown = [f"{x.found:.4g} {x.unit}".rstrip() if x else "" for x in (a, b)]
            change = f"{b.found - a.found:+.4g}" if a and b else ""
            line = b or a
            assert line is not None
            out.append((line.label, *shown, change, a.status.value if a else "", b.status.value if b else "", b.place if b else ""))
        return out


def compare(first: Study, second: Study, progress: Progress = lambda what, done, of: None) -> tuple[Comparison, ...]:
    """The loops of two studies, paired by name, else by their order. Raises StudyError if a loop cannot be checked."""
    one, other = check(first, progress), check(second, progress)
    named = {found.loop.name: found for found in other}
    by_name = all(found.loop.name in named for found in one)
    pairs = [(found, named[found.loop.name]) for found in one] if by_name else list(zip(one, other, strict=False))
    return tuple(_compared(a, b, progress) for a, b in pairs)


def _compared(a: LoopCheck, b: LoopCheck, progress: Progress) -> Comparison:
    from mfc_analysis.design.attribution import attribute

    one, other = a.loop, b.loop
    progress(f"{other.name}: what each change and each imperfection costs", 0, 1)
    costs = [attribute(loop.loop, loop.requirements, loop.times, at=loop.at) for loop in (one, other)]
    return Comparison(a, b, tuple(changed(one.table, other.table)), _did(one, other), (costs[0], costs[1]))


def changed(first: Table, second: Table, key: str = "") -> list[tuple[str, str, str]]:
    """The keys whose values differ, with both values in words; tables key by key."""
    out: list[tuple[str, str, str]] = []
    for name in type(second).model_fields:
        a, b = getattr(first, name, None), getattr(second, name)
        whole = f"{key}.{name}" if key else name
        if isinstance(a, Table) and type(a) is type(b):
            out += changed(a, b, whole)
        elif a != b and not (name == "name" and not key):
            out.append((whole, _words(a), _words(b)))
    return out


def _words(value: Any) -> str:
    if isinstance(value, Table):
        return "{" + ", ".join(f"{name} = {_words(x)}" for name, x in value.given().items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_words(x) for x in value) + "]"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _did(one: StudyLoop, other: StudyLoop) -> Attribution | None:
    """What each changed key of the loop did; None where a loop between the two cannot be built or analysed."""
    from mfc_analysis.design.attribution import attributed
    from mfc_analysis.errors import MfcError
    from mfc_analysis.requirements.requirements import Requirements

    keys = dict.fromkeys(".".join(key.split(".")[:2]) for key, _, _ in changed(one.table, other.table) if key.split(".")[0] in MAKES_THE_LOOP)
    if not keys:
        return None
    asked = Requirements.from_mapping({**one.requirements.asked(), **other.requirements.asked()})

    def between(on: Collection[str]) -> ClosedLoop:
        if len(on) == len(keys):
            return other.loop
        table = one.table
        for key in on:
            top, _, inner = key.partition(".")
            a, b = getattr(table, top), getattr(other.table, top)
            update: Mapping[str, Any] = {top: a.model_copy(update={inner: getattr(b, inner)}) if inner else b}
            table = table.model_copy(update=update)
        return replace(one.parts, table=table).loop() if on else one.loop

    try:
        return attributed(between, tuple(keys), asked, other.times, other.at, ("first", "second"))
    except MfcError:
        return None
