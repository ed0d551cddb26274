"""The PDF: tagged and archival, hostile names as text, its rules enforced."""

from __future__ import annotations

import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from functools import partial

import pytest

from mfc_analysis import plots
from mfc_analysis.report.document import document as s
from mfc_analysis.report.render.pdf import STANDARDS
from mfc_analysis.report.render.write import rendered
from tests.report import samples
from tests.report.render.test_html import HOSTILE


@pytest.fixture(scope="module")
def hostile():
    return rendered(samples.chapter(hostile=HOSTILE), ("pdf",))["pdf"]


def words(pdf):
    """The text of a PDF; skips where there is no pdftotext."""
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext is not installed")
    return subprocess.run(["pdftotext", "-layout", "-", "-"], input=pdf, capture_output=True, check=True).stdout.decode()


def test_the_pdf_says_that_it_is_archival_and_accessible(hostile):
    assert STANDARDS == ["a-2a", "ua-1"]
    assert hostile.startswith(b"%PDF-") and b"/MarkInfo" in hostile and b"/StructTreeRoot" in hostile
    plain = hostile + b"".join(_streams(hostile))
    assert re.search(rb"pdfaid:part\W+2", plain) and re.search(rb"pdfuaid:part\W+1", plain)


def _streams(pdf):
    for found in re.finditer(rb"stream\r?\n(.*?)endstream", pdf, re.S):
        try:
            yield zlib.decompress(found[1].rstrip(b"\r\n"))
        except zlib.error:
            continue


def test_hostile_names_are_text(hostile):
    said = " ".join(words(hostile).split())
    for part in ("<script>alert(1)</script>", "$x$", "#eval(1)", "../../etc", "{{ 7*7 }}", "@ref", "*b*", "_i_", "`c`"):
        assert part in said


def test_the_pages_hold_the_numbers_of_the_checks():
    said = words(rendered(samples.document(), ("pdf",))["pdf"])
    assert "15.9 %" in said and "FAIL: 1 of 4 requirements is not met" in said and "Figure 1" in said


def test_a_date_is_an_input():
    one, two = (rendered(samples.chapter(), ("pdf",), timestamp=t)["pdf"] for t in (0, 86400 * 365))
    assert one != two


def test_sections_four_deep_still_compile_under_the_standards():
    document = samples.chapter()
    inner = document.sections[0]
    for level in range(3):
        inner = replace(document.sections[0], title=f"level {level}", sections=(inner,), body=(), checks=())
    assert rendered(replace(document, sections=(inner,)), ("pdf",))["pdf"].startswith(b"%PDF-")


def test_a_figure_stands_under_the_text_before_it_and_not_at_the_foot_of_the_page():
    figure = s.Figure(partial(plots.curves, [0.0, 1.0], [("one", [0.0, 1.0])], xlabel="t [s]", ylabel="y"), "captionword", "a line from 0 to 1")
    table = s.Table("rows", (s.Column("head"),), tuple((f"row {k}",) for k in range(12)))  # does not break: the rest of the first page stays free
    sections = (s.Section("First"), s.Section("One", "findingword", (figure,)), *(s.Section(f"Table {k}", body=(table,)) for k in range(3)))
    pdf = rendered(s.Document("t", "u", sections), ("pdf",))["pdf"]
    words(pdf)
    boxes = subprocess.run(["pdftotext", "-bbox", "-", "-"], input=pdf, capture_output=True, check=True).stdout.decode()
    page = next(page for page in boxes.split("<page ")[1:] if "findingword" in page)
    finding, caption = (float(re.search(rf'yMin="([\d.]+)"[^>]*>{word}<', page)[1]) for word in ("findingword", "captionword"))
    assert 0 < caption - finding < 240  # [pt]; the figure takes 200
