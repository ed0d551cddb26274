"""The neutral document: the contents of a report as values. HTML, PDF and JSON render the same values, so they cannot disagree.

::

    Document
    +-- Section (title, finding, status, body, checks, numbers, sources), nested at will
    |   +-- Paragraph, Bullets, Code, Callout, Equation, Table, Figure, Row, KeyFacts, Compare, Matrix, Scrubber
    +-- Scope, Provenance, Symbol ...

Banner, picture, matrix and worst case are computed from the sections' checks (``verdict.py``); they are never written by hand.
PASS, WATCH and FAIL judge a loop by its requirements. DEMO is what is shown to make a point, CONFIRMED is theory checked; neither counts.
Text is a string, or a tuple of strings and spans (``Math``, ``Mono``, ``Strong``, ``Link``). A string is always text, never markup.
Everything that makes a report imports this file. It raises MissingExtra where the libraries of reports are not installed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from mfc_analysis.errors import BadArgument, require
from mfc_analysis.requirements.line import Line, Status, worst

require("report")

# --- text --------------------------------------------------------------------------------------------------------

_FORBIDDEN = ("#", "$", "`", "//", "/*", "\\u")
_MARKUP = (  # Typst -> text
    (r"hat\((\w+)\)", r"\1^"),
    (r"dot\.double\((\w+)\)", r"\1''"),
    (r"dot\((\w+)\)", r"\1'"),
    (r"_\((\w) (\w)\)", r"_\1\2"),
    (r" slash ", " / "),
    (r"\"", ""),
)


@dataclass(frozen=True)
class Math:
    """Mathematics in Typst notation. A source that could leave math mode raises ``BadArgument``."""

    source: str  #: e.g. ``K_p dot(q)``; names of several letters in quotes
    alt: str = ""  #: spoken form; default: the source

    def __post_init__(self) -> None:
        for bad in _FORBIDDEN:
            if bad in self.source:
                raise BadArgument("source", self.source, f"Typst mathematics without {bad!r}")

    @property
    def words(self) -> str:
        """The spoken form, or else the source without its markup: ``hat(g)`` as ``g^``, ``k_"damp"`` as ``k_damp``, ``M_(j j)`` as ``M_jj``."""
        if self.alt:
            return self.alt
        text = self.source
        for pattern, plain in _MARKUP:
            text = re.sub(pattern, plain, text)
        return text


@dataclass(frozen=True)
class Mono:
    """Monospaced text: file names, code, commands."""

    text: str


@dataclass(frozen=True)
class Strong:
    """Emphasised text."""

    text: str


@dataclass(frozen=True)
class Link:
    """A link to a section of the same document, by its key."""

    text: str
    target: str


Span = str | Math | Mono | Strong | Link
Text = str | Math | Mono | Strong | Link | tuple[Span, ...]


@dataclass(frozen=True)
class Number:
    """A number with its unit. In JSON it stays a number; infinite and undefined values are words."""

    value: float
    unit: str = ""
    digits: int = 3  #: significant digits shown
    infinite: str = "no limit"  #: the word for inf
    undefined: str = "not defined"  #: the word for NaN
    sign: str = ""  #: "≥", "≤" or "<" before it
    exact: bool = False  #: a chosen number, written in its shortest form: "45", not "45.0"

    def __str__(self) -> str:
        said = written(self.value, self.digits, self.infinite, self.undefined, self.exact)
        shown = said if not math.isfinite(self.value) or not self.unit else said + ("" if self.unit == "°" else " ") + self.unit
        return f"{self.sign} {shown}" if self.sign else shown


DUST = 1e-9  #: a computed number below this is rounding error, and written as 0


def written(value: float, digits: int = 3, infinite: str = "no limit", undefined: str = "not defined", exact: bool = False) -> str:
    """A number as text with ``digits`` significant digits (``exact``: as given, up to 6 digits); words for inf and NaN, 0 for rounding error."""
    if math.isnan(value):
        return undefined
    if math.isinf(value):
        return infinite if value > 0 else "minus infinity"
    if value == 0:
        return "0"
    if exact:
        return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")
    if abs(value) < DUST:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < max(digits, 5):
        said = f"{value:.{max(digits - 1 - exponent, 0)}f}"
    else:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        said = f"{mantissa}e{int(power)}"
    return said.replace("-", "\N{MINUS SIGN}")


# --- checks ------------------------------------------------------------------------------------------------------


class Badge(StrEnum):
    """What is not judged by requirements, and does not count: shown to make a point, or theory checked."""

    DEMO = "DEMO"
    CONFIRMED = "CONFIRMED"


def found_of(line: Line) -> Number:
    """The value found."""
    return Number(line.found, line.unit, infinite=line.infinite, undefined=line.undefined)


def limit_of(line: Line) -> Number:
    """The required limit."""
    return Number(line.asked, line.unit, sign=line.sense, exact=True)


def distance_of(line: Line) -> Number:
    """The distance to the limit, positive if it is met; a dash where the value is infinite."""
    return Number(line.distance if math.isfinite(line.found) else math.nan, line.unit, undefined="–")


# --- blocks ------------------------------------------------------------------------------------------------------

Cell = Text | Number | Status | Badge | int | float | complex


@dataclass(frozen=True)
class Paragraph:
    """A paragraph."""

    text: Text


@dataclass(frozen=True)
class Bullets:
    """A list."""

    items: tuple[Text, ...]


@dataclass(frozen=True)
class Code:
    """Code to copy: a replay or a command."""

    text: str


@dataclass(frozen=True)
class Callout:
    """A framed remark with the colour, word and sign of a status or badge."""

    status: Status | Badge
    title: str
    text: Text = ""


@dataclass(frozen=True)
class Equation:
    """A displayed equation: Typst mathematics, the chapter's number, and the text that screen readers speak."""

    source: str
    alt: str
    number: str = ""

    def __post_init__(self) -> None:
        Math(self.source)


@dataclass(frozen=True)
class Column:
    """A column: its head, its unit, and whether its cells are numbers (right-aligned)."""

    head: Text
    unit: str = ""
    numeric: bool = True
    share: float = 0.0  #: of the width of the page, if a table of long texts shares it out


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns. The first column heads its row."""

    caption: Text
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise BadArgument("rows", f"a row of {len(row)} cells", f"{len(self.columns)} cells, one per column")


@dataclass(frozen=True, eq=False)
class Figure:
    """A drawing, finished or as a recipe.

    A recipe is a picklable callable without arguments that returns Axes or a matplotlib Figure: ``functools.partial(plots.poles, values)``.
    """

    draw: Callable[[], Any] | Any
    caption: Text
    alt: str  #: what it shows, with the numbers in it

    def __post_init__(self) -> None:
        if not self.alt.strip():
            raise BadArgument("alt", self.alt, "a sentence that says what the figure shows, with its numbers")


@dataclass(frozen=True, eq=False)
class Row:
    """Figures side by side, in proportion to their own widths, so that their text has the same size."""

    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Fact:
    """One key metric: its name, its value and a note."""

    name: Text
    value: Number | str
    note: Text = ""


@dataclass(frozen=True)
class KeyFacts:
    """The key metrics."""

    facts: tuple[Fact, ...]


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a comparison."""

    title: str
    badge: Badge | None
    body: tuple[Any, ...]
    note: str = ""  #: beside the title: "unstable"


@dataclass(frozen=True, eq=False)
class Compare:
    """Two forms side by side (printed and standard), and one sentence on the effect of the difference."""

    left: Side
    right: Side
    cost: Text


@dataclass(frozen=True)
class MatrixCell:
    """A verdict (or DEMO) in the matrix, with a link to the section that has the evidence."""

    status: Status | Badge
    text: str
    target: str


@dataclass(frozen=True)
class Matrix:
    """Loops x checks."""

    caption: Text
    columns: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[MatrixCell | None, ...]], ...]  #: (name, target, cells)


@dataclass(frozen=True, eq=False)
class Trace:
    """One metric along the path: its name, unit, values (m,), and the required limit, if any."""

    name: str
    unit: str
    values: Sequence[float]
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class Scrubber:
    """Poles and margins at a selectable time of the path: ``times`` (m,) [s], ``poles`` (m, nx) complex, traces of (m,).

    Without scripts it shows the worst time.
    """

    times: Sequence[float]
    poles: Any
    traces: tuple[Trace, ...]
    worst: int  #: index of the worst time
    caption: Text
    alt: str
    heading: str = "Poles"  #: of the map: what ``poles`` are


Block = Paragraph | Bullets | Code | Callout | Equation | Table | Figure | Row | KeyFacts | Compare | Matrix | Scrubber


# --- the document ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Section:
    """One result: a finding made from the numbers, then the evidence."""

    title: str
    finding: Text = ""
    body: tuple[Block, ...] = ()
    checks: tuple[Line, ...] = ()  #: requirements on its loop
    numbers: Mapping[str, Any] = field(default_factory=dict)  #: named numbers and arrays, for JSON
    sources: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    loop: str = ""  #: the loop it is about: a row of the matrix
    key: str = ""  #: for links; default: made from the title
    verdict: Status | None = None  #: a status that does not come from checks
    shown: str = ""  #: why it is shown for demonstration only ("open loop"): a DEMO, which does not count
    proofs: tuple[Line, ...] = ()  #: theory and the library's own tests: listed in one appendix, not counted
    folded: bool = False  #: the sections within are loops that share this page: one table of their checks instead of a page each
    origins: tuple[tuple[str, str], ...] = ()  #: (gain, where its value comes from) of its loop

    @property
    def badge(self) -> Status | Badge | None:
        """What stands beside its title: PASS, WATCH or FAIL of what is judged, else DEMO, else CONFIRMED, else None."""
        if self.judged is not Status.INFO:
            return self.judged
        if self.shown or any(s.badge is Badge.DEMO for s in self.sections):
            return Badge.DEMO
        return Badge.CONFIRMED if self.proofs or any(s.badge is Badge.CONFIRMED for s in self.sections) else None

    @property
    def judged(self) -> Status:
        """The worst of its checks, of its verdict, and of the sections within; demonstrations are left out."""
        if self.shown:
            return Status.INFO
        own = [c.status for c in self.checks] + [s.judged for s in self.sections] + [c.status for c in self.proofs if c.status is Status.FAIL]
        return worst([*own, self.verdict] if self.verdict is not None else own)

    def every_check(self) -> tuple[tuple[Section, Line], ...]:
        """Its checks and those of the sections within, each with its section."""
        inner = tuple(pair for s in self.sections for pair in s.every_check())
        return tuple((self, c) for c in self.checks) + inner

    def every_source(self) -> tuple[str, ...]:
        """Its sources and those of the sections within."""
        return (*self.sources, *(x for s in self.sections for x in s.every_source()))

    def every_proof(self) -> tuple[tuple[Section, Line], ...]:
        """Its proofs and those of the sections within, each with its section."""
        return tuple((self, c) for c in self.proofs) + tuple(pair for s in self.sections for pair in s.every_proof())


@dataclass(frozen=True)
class Scope:
    """The basis of a verdict, and what is not checked."""

    model: tuple[Text, ...]
    assumptions: tuple[Text, ...]
    operating_points: tuple[Text, ...]
    not_checked: tuple[Text, ...]


@dataclass(frozen=True)
class Symbol:
    """A symbol, its meaning and unit."""

    letter: Math
    meaning: str
    unit: str = ""


@dataclass(frozen=True)
class Provenance:
    """How to reproduce the report: versions, platform, inputs with their SHA-256, command, seed, tolerances. A date only if given."""

    items: tuple[tuple[str, str], ...]
    command: str = ""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Document:
    """A report. ``name`` is the name of its files."""

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    name: str = "report"
    scope: Scope | None = None
    provenance: Provenance | None = None
    symbols: tuple[Symbol, ...] = ()
    appendices: tuple[Section, ...] = ()
    matrix: bool = True  #: show loops x checks when there is more than one loop
    front: tuple[Section, ...] = ()  #: after the scope: what was analysed, such as the gains of all loops
    names: Mapping[str, str] = field(default_factory=dict)  #: name -> what the pages show in its place, such as a joint without its prefix
