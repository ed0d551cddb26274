"""A document flattened into plain dictionaries: numbered, formatted, keyed. Both the HTML and the Typst template read it.

Every text is a list of spans ``{"k": kind, "t": text}``: kind "text", "mono", "strong", "link" (with "to"), "math" (with "id").
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from mfc_analysis.report.document import document as s, verdict as judged
from mfc_analysis.report.document.provenance import MACHINE, PACKAGES
from mfc_analysis.requirements.line import Status

LONG_ROWS, LONG_WORDS = 12, 1200  #: rows, letters of a table that may be broken across pages
SIGNS = {"PASS": "✓", "WATCH": "!", "FAIL": "✗", "INFO": "i", "DEMO": "▹", "CONFIRMED": "="}


@dataclass
class Tree:
    """The input of the renderers: ``root`` (plain data), the equations by id, and the figures by id."""

    root: dict[str, Any]
    equations: dict[str, tuple[str, bool]] = field(default_factory=dict)  #: id -> (Typst source, display?)
    figures: dict[str, s.Figure] = field(default_factory=dict)
    scrubbers: dict[str, s.Scrubber] = field(default_factory=dict)
    keys: dict[int, str] = field(default_factory=dict)  #: id() of each section -> its key


def tree(document: s.Document) -> Tree:
    """The document as plain data."""
    return _Builder(document).build()


class _Builder:
    def __init__(self, document: s.Document) -> None:
        self.document = document
        self.long = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, sorted(document.names, key=len, reverse=True)))})(?!\w)")
        self.out = Tree({})
        self.ids: dict[tuple[str, bool], str] = {}
        self.tables = self.pictures = 0
        self.keys: dict[int, str] = {}
        self.taken: set[str] = {"top", "verdict", "contents", "data"}
        self.front = self._front()
        for section in (*self.front, *document.sections, *self._back()):
            self._key(section)

    def build(self) -> Tree:
        document = self.document
        found = judged.verdict(document)
        shown = (*self._glance(found), *self.front, *self._all_requirements(), *document.sections, *self._back())
        sections = [self._section(x, 1) for x in shown]
        self.out.keys = self.keys
        target = self.keys.get(id(found.section), "") if found.section is not None else ""
        self.out.root = {
            "title": document.title,
            "subtitle": document.subtitle,
            "name": document.name,
            "verdict": {
                "status": found.status.value,
                "sign": SIGNS[found.status.value],
                "sentence": self._clean(found.sentence),
                "detail": self._clean(found.detail),
                "to": target,
            },
            "sections": sections,
        }
        return self.out

    # --- sections ------------------------------------------------------------------------------------------------

    def _front(self) -> tuple[s.Section, ...]:
        scope = self.document.scope
        if scope is None:
            return self.document.front
        parts = (
            ("Model", scope.model),
            ("Assumptions", scope.assumptions),
            ("Operating points", scope.operating_points),
            ("Not checked", scope.not_checked),
        )
        rows = tuple((s.Strong(name), _joined(items)) for name, items in parts if items)
        table = s.Table(
            "Basis of the verdict, and what is not checked.", (s.Column("Item", numeric=False), s.Column("Description", numeric=False)), rows
        )
        return (s.Section("What was analysed", body=(table,), key="scope"), *self.document.front)

    def _back(self) -> tuple[s.Section, ...]:
        if not hasattr(self, "_after"):
            out: list[s.Section] = []
            given = self.document.provenance
            if given is not None:
                versions = [(name, value) for name, value in given.items if name in (*PACKAGES, *MACHINE)]
                rows: tuple[tuple[s.Cell, ...], ...] = (
                    (("software", s.Mono(", ".join(f"{name} {value}" for name, value in versions))),) if versions else ()
                )
                rows += tuple((name, s.Mono(value)) for name, value in given.items if (name, value) not in versions)
                rows += (("To reproduce", s.Mono(given.command)),) if given.command else ()
                heads = (s.Column("Item", numeric=False), s.Column("Value", numeric=False))
                body: list[s.Block] = [s.Table("How this report was made.", heads, rows)]
                if given.note:
                    body.append(s.Paragraph(given.note))
                out.append(s.Section("Provenance", body=tuple(body), key="provenance"))
            out += self.document.appendices
            if self.document.symbols:
                columns = (s.Column("Symbol", numeric=False), s.Column("Meaning", numeric=False), s.Column("Unit", numeric=False))
                letters = tuple((x.letter, x.meaning, x.unit) for x in self.document.symbols)
                out.append(s.Section("Symbols", body=(s.Table("Symbols used in this report.", columns, letters),), key="symbols"))
            out = [*judged.proofs(self.document), *out]
            cited = cited_once(x for section in self.document.sections for x in section.every_source())
            if cited:
                out.append(s.Section("Sources", body=(s.Bullets(cited),), key="sources"))
            self._after = tuple(out)
        return self._after

    def _glance(self, found: judged.Verdict) -> tuple[s.Section, ...]:
        """Page 1: the picture of all loops, and the worst case."""
        drawn = judged.picture(self.document) if self.document.matrix else None
        body: list[s.Block] = [] if drawn is None else [drawn]
        check, section = found.check, found.section
        if check is not None and section is not None:
            name = "Tightest requirement" if check.status is Status.PASS else "Worst case"
            facts = (
                s.Fact(name, check.label, section.loop or section.title),
                s.Fact("Value", s.found_of(check)),
                s.Fact("Required", s.limit_of(check)),
                s.Fact("Where", check.place or "everywhere"),
            )
            body.append(s.KeyFacts(facts))
        made = s.Section("All loops at a glance" if drawn is not None else "The worst case", body=tuple(body), key="worst-case")
        self._key(made)
        return (made,) if body else ()

    def _all_requirements(self) -> tuple[s.Section, ...]:
        """The table of loops and requirements, for more than one loop."""
        table = judged.matrix(self.document, self.keys) if self.document.matrix else None
        if table is None or len(table.rows) < 2:
            return ()
        made = s.Section("All requirements", body=(table,), key="matrix")
        self._key(made)
        return (made,)

    def _key(self, section: s.Section) -> None:
        if id(section) in self.keys:
            return
        stem = slug(section.key or (f"{section.loop} {section.title}" if section.loop and section.loop not in section.title else section.title))
        key, k = stem, 2
        while key in self.taken:
            key, k = f"{stem}-{k}", k + 1
        self.taken.add(key)
        self.keys[id(section)] = key
        for inner in section.sections:
            if section.folded:
                self.keys[id(inner)] = key
            else:
                self._key(inner)

    def _section(self, section: s.Section, level: int) -> dict[str, Any]:
        key = self.keys[id(section)]
        asked: tuple[s.Block, ...] = (judged.requirements(section),) if section.checks else ()
        if section.folded and any(x.checks and not x.shown for x in section.sections):
            asked = (*asked, judged.folded(section))
        blocks = [self._block(b) for b in (*asked, *section.body)]
        badge = section.badge
        return {
            "id": key,
            "level": level,
            "title": section.title,
            "status": "" if badge is None else badge.value,
            "sign": "" if badge is None else SIGNS[badge.value],
            "finding": self._text(section.finding),
            "blocks": blocks,
            "sections": [] if section.folded else [self._section(x, level + 1) for x in section.sections],
        }

    # --- text ----------------------------------------------------------------------------------------------------

    def _clean(self, text: str) -> str:
        """Text as the pages show it: without control characters, long names shortened."""
        return self.long.sub(lambda found: self.document.names[found[0]], clean(text)) if self.document.names else clean(text)

    def _text(self, text: s.Text) -> list[dict[str, str]]:
        spans = text if isinstance(text, tuple) else (text,)
        return [self._span(x) for x in spans if x != ""]

    def _span(self, x: s.Span) -> dict[str, str]:
        if isinstance(x, s.Math):
            return {"k": "math", "id": self._equation(x.source, False), "t": x.words}
        if isinstance(x, s.Mono):
            return {"k": "mono", "t": clean(x.text)}
        if isinstance(x, s.Strong):
            return {"k": "strong", "t": self._clean(x.text)}
        if isinstance(x, s.Link):
            return {"k": "link", "t": self._clean(x.text), "to": x.target if x.target in self.taken else ""}
        return {"k": "text", "t": self._clean(str(x))}

    def _equation(self, source: str, display: bool) -> str:
        key = self.ids.setdefault((source, display), f"m{len(self.ids)}")
        self.out.equations[key] = (source, display)
        return key

    def _cell(self, cell: s.Cell) -> dict[str, Any]:
        if isinstance(cell, (Status, s.Badge)):
            return {"spans": [{"k": "text", "t": cell.value}], "status": cell.value, "sign": SIGNS[cell.value], "bare": False}
        if isinstance(cell, s.Number):
            cell = str(cell)
        elif isinstance(cell, complex):
            cell = complex_written(cell)
        elif isinstance(cell, (int, float)) and not isinstance(cell, bool):
            cell = s.written(cell) if isinstance(cell, float) else str(cell).replace("-", "\N{MINUS SIGN}")
        spans = self._text(cell if isinstance(cell, (str, tuple, s.Math, s.Mono, s.Strong, s.Link)) else str(cell))
        return {"spans": spans, "status": "", "sign": "", "bare": all(x["k"] == "math" for x in spans)}

    # --- blocks --------------------------------------------------------------------------------------------------

    def _block(self, block: s.Block) -> dict[str, Any]:
        make: Callable[[Any], dict[str, Any]] = getattr(self, f"_make_{type(block).__name__.lower()}")
        return {"k": type(block).__name__.lower()} | make(block)

    def _make_paragraph(self, b: s.Paragraph) -> dict[str, Any]:
        return {"spans": self._text(b.text)}

    def _make_bullets(self, b: s.Bullets) -> dict[str, Any]:
        return {"items": [self._text(x) for x in b.items]}

    def _make_code(self, b: s.Code) -> dict[str, Any]:
        return {"text": clean(b.text, newlines=True)}

    def _make_callout(self, b: s.Callout) -> dict[str, Any]:
        return {"status": b.status.value, "sign": SIGNS[b.status.value], "title": self._clean(b.title), "spans": self._text(b.text)}

    def _make_equation(self, b: s.Equation) -> dict[str, Any]:
        return {"id": self._equation(b.source, True), "alt": self._clean(b.alt), "number": b.number}

    def _make_table(self, b: s.Table) -> dict[str, Any]:
        self.tables += 1
        columns = [{"spans": self._text(c.head), "unit": c.unit, "numeric": c.numeric, "share": c.share} for c in b.columns]
        rows = [[self._cell(c) for c in row] for row in b.rows]
        words = sum(len(span["t"]) for row in rows for cell in row for span in cell["spans"])
        return {
            "long": len(rows) > LONG_ROWS or words > LONG_WORDS,
            "number": self.tables,
            "caption": self._text(b.caption),
            "columns": columns,
            "result": next((k for k, c in enumerate(b.columns) if c.head == "Result"), -1),
            "rows": rows,
        }

    def _make_figure(self, b: s.Figure) -> dict[str, Any]:
        self.pictures += 1
        key = f"f{self.pictures}"
        self.out.figures[key] = b
        return {"id": key, "number": self.pictures, "caption": self._text(b.caption), "alt": self._clean(b.alt)}

    def _make_row(self, b: s.Row) -> dict[str, Any]:
        return {"figures": [self._make_figure(f) | {"k": "figure"} for f in b.figures]}

    def _make_keyfacts(self, b: s.KeyFacts) -> dict[str, Any]:
        return {"facts": [{"name": self._text(f.name), "value": self._clean(str(f.value)), "note": self._text(f.note)} for f in b.facts]}

    def _make_compare(self, b: s.Compare) -> dict[str, Any]:
        sides = [
            {
                "title": self._clean(x.title),
                "status": x.badge or "",
                "sign": SIGNS[x.badge] if x.badge else "",
                "note": x.note,
                "blocks": [self._block(y) for y in x.body],
            }
            for x in (b.left, b.right)
        ]
        return {"sides": sides, "cost": self._text(b.cost)}

    def _make_matrix(self, b: s.Matrix) -> dict[str, Any]:
        self.tables += 1
        rows = [
            {
                "name": self._clean(name),
                "to": to,
                "cells": [
                    None if c is None else {"status": c.status.value, "sign": SIGNS[c.status.value], "text": c.text, "to": c.target} for c in cells
                ],
            }
            for name, to, cells in b.rows
        ]
        return {"number": self.tables, "caption": self._text(b.caption), "columns": [self._clean(c) for c in b.columns], "rows": rows}

    def _make_scrubber(self, b: s.Scrubber) -> dict[str, Any]:
        self.pictures += 1
        key = f"f{self.pictures}"
        self.out.scrubbers[key] = b
        return {"id": key, "number": self.pictures, "caption": self._text(b.caption), "alt": self._clean(b.alt)}


def every_block(sections: Iterable[dict[str, Any]]) -> Iterable[dict[str, Any]]:
    """All blocks of a tree's sections, those within comparisons and rows included, in page order."""
    for section in sections:
        yield from _blocks(section["blocks"])
        yield from every_block(section["sections"])


def _blocks(blocks: Iterable[dict[str, Any]]) -> Iterable[dict[str, Any]]:
    for block in blocks:
        yield block
        yield from _blocks(block.get("figures", ()))
        for side in block.get("sides", ()):
            yield from _blocks(side["blocks"])


def cited_once(sources: Iterable[str]) -> tuple[str, ...]:
    """Each work once, with all its chapters or equations."""
    works: dict[tuple[str, str], list[str]] = {}
    for source in sources:
        work, mark, part = next((source.rpartition(m) for m in (", ch. ", ", eq. ") if m in source), (source, "", ""))
        parts = works.setdefault((work, mark), [])
        parts += [part] if part and part not in parts else []
    return tuple(f"{work}{mark}{', '.join(parts)}" for (work, mark), parts in works.items())


def _joined(items: tuple[s.Text, ...]) -> tuple[s.Span, ...]:
    out: list[s.Span] = []
    for item in items:
        out += [*(["; "] if out else []), *(item if isinstance(item, tuple) else (item,))]
    return tuple(out)


def complex_written(z: complex) -> str:
    """A pole in a table: ``−3.00 ± 4.00 j`` for the member of a pair with positive imaginary part."""
    real = s.written(z.real)
    if abs(z.imag) <= 1e-9 * max(abs(z), 1e-300):
        return real
    return f"{real} {'±' if z.imag > 0 else '∓'} {s.written(abs(z.imag))}j"


def slug(text: str) -> str:
    """A key made of a-z, 0-9 and hyphens: safe as an anchor and as a file name."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    words = "".join(c if c.isalnum() else " " for c in plain).split()
    return "-".join(words)[:60].strip("-") or "section"


def clean(text: str, newlines: bool = False) -> str:
    """Text without control characters (and, unless ``newlines``, on one line); lone surrogates become U+FFFD."""
    kept = "".join(c if c >= " " or (newlines and c == "\n") else " " for c in text.replace("\x7f", " "))
    kept = "".join("\N{REPLACEMENT CHARACTER}" if 0xD800 <= ord(c) <= 0xDFFF or ord(c) in (0xFFFE, 0xFFFF) else c for c in kept)
    return kept
