"""The numbers of a document as JSON: the sections, checks and tables of the pages. Infinity and NaN are words."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from mfc_analysis.report.document import document as s
from mfc_analysis.report.document.tree import Tree, clean, every_block
from mfc_analysis.requirements.line import Line


def numbers(document: s.Document, tree: Tree, version: str) -> dict[str, Any]:
    """The document's verdict, sections, checks, named numbers, tables and figures' descriptions as plain data without NaN."""
    given = document.provenance
    root = tree.root
    out = {
        "title": document.title,
        "subtitle": document.subtitle,
        "version": version,
        "verdict": root["verdict"],
        "sections": [_section(found, tree.keys) for found in (*document.front, *document.sections, *document.appendices)],
        "figures": [
            {"id": b["id"], "number": b["number"], "alt": b["alt"]} for b in every_block(root["sections"]) if b["k"] in ("figure", "scrubber")
        ],
        "provenance": {} if given is None else {"items": dict(given.items), "command": given.command},
    }
    return out


def to_json(data: Mapping[str, Any]) -> str:
    """JSON text with a final newline; raises ``ValueError`` if a NaN or infinity is left."""
    return json.dumps(data, allow_nan=False, ensure_ascii=False, indent=1) + "\n"


def plain(value: Any, infinite: str = "infinite", undefined: str = "not defined") -> Any:
    """Numbers, arrays, dataclasses and mappings as JSON values: inf and NaN become words, a complex number {"re", "im"}."""
    if value is None or isinstance(value, (bool, str)):
        return str(value) if isinstance(value, str) else value
    if isinstance(value, s.Number):
        return {"value": plain(value.value, value.infinite, value.undefined), "unit": value.unit}
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, (np.generic, np.ndarray)):
        return plain(value.tolist(), infinite, undefined)
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        if math.isnan(value):
            return undefined
        return value if math.isfinite(value) else infinite if value > 0 else "minus infinity"
    if isinstance(value, complex):
        return {"re": plain(value.real, infinite, undefined), "im": plain(value.imag, infinite, undefined)}
    if isinstance(value, Mapping):
        return {str(k): plain(v, infinite, undefined) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v, infinite, undefined) for v in value]
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value), infinite, undefined)
    return str(value)


def _section(section: s.Section, keys: Mapping[int, str]) -> dict[str, Any]:
    return {
        "id": keys[id(section)],
        "title": section.title,
        "loop": section.loop,
        "status": section.badge or "INFO",
        "shown": section.shown,
        "finding": clean(words(section.finding)),
        "checks": [_check(c) for c in section.checks],
        "proofs": [_check(c) for c in section.proofs],
        "numbers": plain(section.numbers),
        "facts": _facts(section),
        "tables": _tables(section),
        "sources": list(section.sources),
        "sections": [_section(x, keys) for x in section.sections],
    }


def _check(c: Line) -> dict[str, Any]:
    return {
        "name": c.label,
        "sense": c.sense,
        "unit": c.unit,
        "asked": plain(c.asked),
        "found": plain(c.found, c.infinite, c.undefined),
        "distance": plain(c.distance, "infinite", c.undefined),
        "status": c.status.value,
        "where": c.where,
        "when": plain(c.when),
    }


def _facts(section: s.Section) -> list[dict[str, Any]]:
    blocks = [b for b in section.body if isinstance(b, s.KeyFacts)]
    return [
        {"name": words(f.name), **({"value": f.value, "unit": ""} if isinstance(f.value, str) else plain(f.value))} for b in blocks for f in b.facts
    ]


def _tables(section: s.Section) -> list[dict[str, Any]]:
    out = []
    for block in section.body:
        if isinstance(block, s.Table):
            columns = [{"head": words(c.head), "unit": c.unit} for c in block.columns]
            out.append({"caption": words(block.caption), "columns": columns, "rows": [[_cell(c) for c in row] for row in block.rows]})
    return out


def _cell(cell: Any) -> Any:
    return words(cell) if isinstance(cell, (str, tuple, s.Math, s.Mono, s.Strong, s.Link)) and not isinstance(cell, Enum) else plain(cell)


def words(text: s.Text) -> str:
    """A text without its markup."""
    spans = text if isinstance(text, tuple) else (text,)
    return "".join(x if isinstance(x, str) else x.words if isinstance(x, s.Math) else x.text for x in spans)
