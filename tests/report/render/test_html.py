"""The HTML page: one file, well formed, safe with hostile names, readable by everybody."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from itertools import pairwise

import pytest

from mfc_analysis.report.render.html import inline_svg, script_json
from mfc_analysis.report.render.write import rendered
from tests.report import samples

HOSTILE = "<script>alert(1)</script> \" ' $x$ #eval(1) ../../etc & {{ 7*7 }} \\u0041 ]]> @ref *b* _i_ `c`"


class Page(HTMLParser):
    """Elements of a page with their attributes, and the text within each."""

    VOID = frozenset(("meta", "input", "br", "hr", "link", "img"))

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.elements, self.open, self.text = [], [], {}
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        element = {"tag": tag, "in": tuple(e["tag"] for e in self.open), **dict(attrs), "text": ""}
        self.elements.append(element)
        if tag not in self.VOID:
            self.open.append(element)

    def handle_startendtag(self, tag, attrs):
        self.elements.append({"tag": tag, "in": tuple(e["tag"] for e in self.open), **dict(attrs), "text": ""})

    def handle_endtag(self, tag):
        assert self.open and self.open[-1]["tag"] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data):
        for element in self.open:
            element["text"] += data

    def all(self, *tags):
        return [e for e in self.elements if e["tag"] in tags]


def page(document):
    text = rendered(document, ("html",))["html"].decode()
    return text, Page(text)


@pytest.fixture(scope="module")
def loop():
    return page(samples.document())


@pytest.fixture(scope="module")
def chapter():
    return page(samples.chapter(float("nan")))


@pytest.fixture(scope="module")
def hostile():
    return page(samples.chapter(hostile=HOSTILE))


def test_every_element_is_closed_in_order_and_ids_are_unique(loop, chapter):
    for _, found in (loop, chapter):
        ids = [e["id"] for e in found.elements if "id" in e]
        assert not found.open and len(ids) == len(set(ids))


def test_every_link_and_reference_within_the_page_has_its_target(loop, chapter):
    for text, found in (loop, chapter):
        ids = {e["id"] for e in found.elements if "id" in e}
        links = {e["href"] for e in found.elements if "href" in e}
        assert links and all(x.startswith("#") and x[1:] in ids for x in links)
        assert set(re.findall(r"url\(#([^)]+)\)", text)) <= ids
        assert all(e["aria-labelledby"] in ids for e in found.elements if "aria-labelledby" in e)


def test_nothing_is_loaded_from_elsewhere(loop, chapter):
    for text, found in (loop, chapter):
        assert not found.all("link", "iframe", "img", "object")
        assert not [e for e in found.elements if "src" in e]
        assert not re.findall(r"url\((?!data:|#)", text)
        assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", text)


def test_headings_go_down_by_one_at_a_time(loop, chapter):
    for _, found in (loop, chapter):
        levels = [int(e["tag"][1]) for e in found.all("h1", "h2", "h3", "h4", "h5", "h6")]
        assert levels[0] == 1 and levels.count(1) == 1
        assert all(b - a <= 1 for a, b in pairwise(levels))


def test_every_drawing_is_an_image_with_a_title_that_has_numbers_in_it(loop, chapter):
    for _, found in (loop, chapter):
        drawings = found.all("svg")
        titles = {e["id"]: e["text"] for e in found.all("title") if "id" in e}
        assert drawings and all(e["role"] == "img" and re.search(r"\d", titles[e["aria-labelledby"]]) for e in drawings)


def test_tables_have_captions_and_scoped_headers(loop, chapter):
    for _, found in (loop, chapter):
        assert len(found.all("caption")) == len(found.all("table")) > 0
        assert all(e.get("scope") in ("row", "col") for e in found.all("th"))


def test_a_verdict_is_a_word_and_a_sign_and_not_only_a_colour(chapter):
    _, found = chapter
    badges = [e for e in found.elements if "badge" in e.get("class", "").split() or "cell" in e.get("class", "").split()]
    assert badges and all(re.search(r"pass|watch|fail|demo|confirmed", e["text"]) and re.search("[✓!✗▹=]", e["text"]) for e in badges)


def test_drawings_are_dark_and_light_without_black_of_their_own(loop):
    text, found = loop
    inside = "".join(str(e) for e in found.elements if "svg" in e["in"])
    assert "#000000" not in inside and "currentColor" in inside
    assert "<?xml" not in text and "<metadata" not in text and text.lower().count("<!doctype") == 1


def test_hostile_names_are_text(hostile):
    text, found = hostile
    assert "alert(1)" in text and "<script>alert" not in text
    assert not found.all("script")
    assert any(HOSTILE in e["text"] for e in found.all("h2"))
    assert any(HOSTILE in e["text"] for e in found.all("a"))
    assert "{{ 7*7 }}" in text


def test_data_of_a_script_cannot_close_it():
    made = script_json({"a": "</script><!-- <b> & \u2028"})
    assert not set("<>&\u2028") & set(made)
    assert json.loads(made) == {"a": "</script><!-- <b> & \u2028"}


def test_two_drawings_on_one_page_share_no_id():
    from mfc_analysis import plots

    text = plots.svg(lambda: plots.poles([-1.0]))
    a, b = (Page(inline_svg(text, key, "alt 1")["svg"]) for key in ("f1", "f2"))
    ids = [{e["id"] for e in x.elements if "id" in e} for x in (a, b)]
    assert ids[0] and not ids[0] & ids[1]


def test_the_script_is_about_a_kilobyte_and_only_there_with_a_scrubber(loop, chapter):
    scripts = [e for e in loop[1].all("script") if e.get("type") != "application/json"]
    assert len(scripts) == 1 and len(scripts[0]["text"]) < 1500
    assert not chapter[1].all("script")


def test_the_scrubber_shows_the_worst_time_without_scripts(loop):
    _, found = loop
    data = json.loads(next(e["text"] for e in found.all("script") if e.get("type") == "application/json"))
    poles = [e["transform"] for e in found.elements if e.get("class") == "pole"]
    assert poles == [f"translate({x:.1f} {y:.1f})" for x, y in zip(data["px"][data["worst"]], data["py"][data["worst"]], strict=True)]
    assert [e for e in found.elements if e.get("class") == "controls" and "hidden" in e]
