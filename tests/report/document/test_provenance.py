"""Provenance and symbols."""

from __future__ import annotations

import hashlib

from mfc_analysis.report.document.document import Document, Section
from mfc_analysis.report.document.provenance import provenance
from mfc_analysis.report.document.symbols import symbols
from mfc_analysis.report.render.write import rendered


def test_an_input_is_named_with_its_hash_and_a_date_only_if_given():
    found = dict(provenance("mfc-analysis report a.toml", {"a.toml": b"x = 1"}, {"rtol": 1e-6}).items)
    assert found["SHA-256 of a.toml"] == hashlib.sha256(b"x = 1").hexdigest()
    assert found["rtol"] == "1e-06" and "numpy" in found and "date" not in found
    assert dict(provenance(date="2026-11-22").items)["date"] == "2026-11-22"


def test_all_symbols_compile_for_both_pages():
    document = Document("t", "s", (Section("a"),), symbols=symbols(tool=True, force=True), provenance=provenance())
    made = rendered(document, ("html", "pdf"))
    assert made["html"].decode().count("<math") == len(document.symbols)


def test_progress_ends_at_its_total():
    told = []
    rendered(Document("t", "s", (Section("a"),)), ("html", "json"), progress=lambda done, of: told.append((done, of)))
    assert told == [(1, 2), (2, 2)]
