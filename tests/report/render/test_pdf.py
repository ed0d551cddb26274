"""The PDF: tagged and archival, hostile names as text, its rules enforced."""

from __future__ import annotations

import re
import shutil
import subprocess
import zlib
from dataclasses import replace

import pytest

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
