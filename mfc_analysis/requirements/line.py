"""One requirement on one loop: the limit, the value found and the status. Verdicts, reports and the command line show these lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite, isnan


class Status(StrEnum):
    """Result of a check; compares with its word: ``verdict.status == "PASS"``. INFO: no requirement was set."""

    PASS = "PASS"
    WATCH = "WATCH"
    FAIL = "FAIL"
    INFO = "INFO"

    @property
    def rank(self) -> int:
        """0 (INFO) to 3 (FAIL); larger is worse."""
        return ("INFO", "PASS", "WATCH", "FAIL").index(self.value)


def worst(statuses: Sequence[Status]) -> Status:
    """The worst status; INFO for an empty list."""
    return max(statuses, key=lambda s: s.rank, default=Status.INFO)


@dataclass(frozen=True)
class Line:
    """A requirement: its limit and the worst value found."""

    name: str  #: field of ``Requirements``, or "stable", "residual"; any name in a report
    asked: float  #: the limit, in ``unit``
    found: float  #: in ``unit``; NaN where it is not defined (the loop is unstable, ...)
    unit: str  #: of all numbers
    distance: float  #: distance to the limit, in ``unit``; negative: limit missed; NaN: not defined
    status: Status  #: met or not
    where: str = ""  #: joint or channel
    when: float | None = None  #: [s]
    sense: str = "≥"  #: "≥" at least, "≤" at most, "<" below
    infinite: str = "no limit"  #: the word for an infinite ``found``
    undefined: str = "unstable"  #: the word for a NaN
    label: str = ""  #: the name in words; omitted: the name itself
    note: str = ""  #: a reservation
    elsewhere: str = ""  #: a smaller margin at another analysis point, in words

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", self.name)

    @property
    def severity(self) -> tuple[int, float]:
        """Sort key, worst last: by status, then by the relative distance to the limit. An unstable loop is the worst of all."""
        if self.name == "stable" and self.status is Status.FAIL:
            return self.status.rank + 1, inf
        if isnan(self.distance):
            return self.status.rank, inf
        scale = abs(self.asked) if self.asked and isfinite(self.asked) else 1.0
        return self.status.rank, -self.distance / scale

    @property
    def place(self) -> str:
        """Joint or channel, and time, in words; empty if neither is known."""
        at = "" if self.when is None else f"t = {round(self.when, 4):.6g} s"
        return ", ".join(part for part in (self.where, at) if part)

    def __str__(self) -> str:
        return "  ".join(cell for cell in self.cells() if cell)

    def cells(self) -> tuple[str, ...]:
        """Status, label, found, asked, distance, place, note: the row of the table."""
        unit = f" {self.unit}" if self.unit else ""
        found = "undefined" if isnan(self.found) else f"{self.found:.6g}{unit}"
        asked = "" if isnan(self.asked) else f"{self.sense} {self.asked:.6g}{unit}"
        distance = "" if isnan(self.distance) else f"{self.distance:+.3g}{unit}"
        return self.status.value, self.label, found, asked, distance, self.place, self.note
