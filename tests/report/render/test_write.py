"""Writing: the same bytes for the same input, only inside the folder, JSON without NaN."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.report import render
from mfc_analysis.report.render.numbers import plain, to_json
from mfc_analysis.report.render.write import rendered
from tests.report import samples


def test_the_same_input_gives_the_same_bytes():
    assert rendered(samples.document()) == rendered(samples.document())


@pytest.mark.parametrize("name", ["../../up", "/etc/passwd", "a/b\\c", "..", "", "con: <x>|?*", "\x00nul", "ｕｎｉ ☃"])
def test_no_name_leads_out_of_the_folder(tmp_path, name):
    folder = tmp_path / "out"
    made = render(replace(samples.chapter(), name=name), folder, ("json",))
    assert [p.parent for p in made.values()] == [folder]
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted(["out", made["json"].name])


def test_formats_may_be_words_in_one_string_and_unknown_ones_are_named(tmp_path):
    assert set(render(samples.chapter(), tmp_path, "json,html")) == {"json", "html"}
    with pytest.raises(BadArgument, match="docx"):
        render(samples.chapter(), tmp_path, ("docx",))


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(BadArgument, match="folder"):
        render(samples.chapter(), tmp_path / "out", ("json",))


def test_json_has_words_for_what_is_not_a_number():
    text = rendered(samples.chapter(float("nan")), ("json",))["json"].decode()
    assert "NaN" not in text and "Infinity" not in text
    data = json.loads(text)
    assert data["sections"][1]["checks"][0]["found"] == "unstable"
    assert data["sections"][1]["numbers"]["poles"] == [1.0, -3.0]
    assert data["sections"][0]["numbers"]["poles"][0] == {"re": -3.0, "im": 4.0}


def test_json_holds_the_numbers_of_tables_facts_and_checks():
    data = json.loads(rendered(samples.document(), ("json",))["json"])
    sections = {x["title"]: x for x in data["sections"]}
    assert sections["Loop"]["facts"][0] == {"name": "Phase margin", "value": 66.0, "unit": "°"}
    assert sections["Loop"]["tables"][0]["rows"] == [[820.0, 1900.0, 62.0]]
    assert sections["Poles and time response"]["numbers"]["gain_increase"] == "infinite"
    assert data["provenance"]["command"] == "mfc-analysis report joint3.toml"


@pytest.mark.parametrize(
    "value", [np.float64("nan"), np.array([[1.0, np.inf], [np.nan, -np.inf]]), {"a": (complex(np.nan, 1),)}, [np.int64(3), True, None]]
)
def test_anything_becomes_plain_json(value):
    assert json.loads(to_json({"x": plain(value)}))["x"] == plain(value)


def test_a_nan_that_slipped_through_is_an_error_and_not_written():
    with pytest.raises(ValueError, match="JSON"):
        to_json({"x": float("nan")})


def test_the_pdf_is_made_while_the_html_is(monkeypatch, tmp_path):
    import threading

    from mfc_analysis.report.render import html, pdf

    printing, overlapped = threading.Event(), []
    monkeypatch.setattr(pdf, "pdf", lambda *given: printing.set() or b"printed")
    monkeypatch.setattr(html, "html", lambda *given: overlapped.append(printing.wait(5.0)) or "page")
    found = render(samples.document(), tmp_path, ("html", "pdf", "json"))
    assert overlapped == [True]
    assert list(found) == ["html", "pdf", "json"]
    assert [found[kind].read_bytes() for kind in ("pdf", "html")] == [b"printed", b"page"]
