"""Sections read back from the JSON that a reader gets: what the pages say, as plain data."""

from __future__ import annotations

import json
from functools import cache
from importlib import import_module
from typing import Any

from mfc_analysis.report.document.document import Document
from mfc_analysis.report.render.write import rendered


@cache
def told(module: str) -> dict[str, Any]:
    """The sections of ``report/sections/<module>.py`` by key, those within included."""
    found = import_module(f"mfc_analysis.report.chapter.{module}").sections()
    data = json.loads(rendered(Document("Sections", "for a test", found, "sections"), ("json",))["json"])
    return dict(flat(data["sections"]))


def flat(sections: list[dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    """(key, section) of all sections, those within after their own."""
    return [pair for s in sections for pair in ((s["id"], s), *flat(s["sections"]))]


def statuses(sections: dict[str, Any]) -> set[str]:
    """The verdicts of all requirements and proofs."""
    return {c["status"] for s in sections.values() for c in (*s["checks"], *s["proofs"])}
