"""The JSON of a document: each section beside its own key, words for text, numbers for numbers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from mfc_analysis.report.document import document as s
from mfc_analysis.report.document.tree import tree
from mfc_analysis.report.render.numbers import numbers, plain, to_json, words
from mfc_analysis.requirements.line import Line, Status

INF, NAN = float("inf"), float("nan")


def data(*sections: s.Section, **more: object) -> dict:
    made = s.Document("t", "u", sections, **more)
    return json.loads(to_json(numbers(made, tree(made), "1.2")))


def test_sections_keep_the_keys_of_the_page_whatever_stands_around_them() -> None:
    line = Line("x", 1.0, 2.0, "", 1.0, Status.PASS)
    own = (s.Section("a", checks=(line,), loop="a", sections=(s.Section("in"),)), s.Section("a", checks=(line,), loop="b"))
    found = data(*own, appendices=(s.Section("end", numbers={"n": 1}),), symbols=(s.Symbol(s.Math("q"), "positions", "rad"),))
    assert [x["id"] for x in found["sections"]] == ["a", "b-a", "end"]
    assert [x["id"] for x in found["sections"][0]["sections"]] == ["in"]
    assert found["sections"][2]["numbers"] == {"n": 1} and found["version"] == "1.2"


def test_a_check_and_a_fact_have_their_own_words_for_what_is_no_number() -> None:
    line = Line("gain", 6.0, INF, "dB", NAN, Status.PASS, "elbow", 0.5, "≥", "no limit", "unstable")
    facts = s.KeyFacts(
        (s.Fact("a", s.Number(NAN, "°", undefined="unstable")), s.Fact("b", "text"), s.Fact(("c ", s.Math("M_s")), s.Number(1.5, "dB")))
    )
    (section,) = data(s.Section("one", body=(facts,), checks=(line,)))["sections"]
    (check,) = section["checks"]
    assert (check["found"], check["distance"], check["asked"], check["where"], check["when"]) == ("no limit", "unstable", 6.0, "elbow", 0.5)
    assert section["facts"] == [
        {"name": "a", "value": "unstable", "unit": "°"}, {"name": "b", "value": "text", "unit": ""}, {"name": "c M_s", "value": 1.5, "unit": "dB"}
    ]  # fmt: skip


def test_cells_of_a_table_stay_numbers_and_text_loses_its_markup() -> None:
    row = (("with ", s.Math("K_p", "gain")), s.Number(-INF, "s", infinite="never"), -1 + 2j, Status.WATCH, 3, True, s.Mono("x"))
    table = s.Table("c", tuple(s.Column(f"{i}") for i in range(len(row))), (row,))
    (section,) = data(s.Section("one", body=(table,)))["sections"]
    assert section["tables"][0]["rows"] == [
        ["with gain", {"value": "minus infinity", "unit": "s"}, {"re": -1.0, "im": 2.0}, "WATCH", 3, True, "x"]
    ]  # fmt: skip
    assert words((s.Strong("a"), " ", s.Math("b"), s.Link("c", "d"))) == "a bc"


class Kind(Enum):
    ONE = "the first"


@dataclass(frozen=True)
class Pair:
    x: float
    y: np.ndarray


def test_values_of_our_own_become_plain_data_all_the_way_down() -> None:
    given = {1: Pair(INF, np.array([1.0, NAN])), "e": Kind.ONE, "n": (np.int64(3), np.bool_(True)), "o": object}
    found = plain(given)
    assert found["1"] == {"x": "infinite", "y": [1.0, "not defined"]} and found["e"] == "the first" and found["n"] == [3, True]
    assert isinstance(found["o"], str) and json.loads(to_json(found)) == found


@pytest.mark.parametrize("title", ["Scope", "The worst case", "All loops at a glance", "Symbols"])
def test_a_loop_may_have_the_name_of_a_section_of_the_pages(title: str) -> None:
    """Sections were matched by their titles, and this one met the page's own: the JSON could not be written."""
    line = Line("x", 1.0, 0.5, "", -0.5, Status.FAIL)
    own = s.Section(title, "A finding.", checks=(line,), numbers={"here": 1.0}, loop=title)
    other = s.Section("Other", "Another.", checks=(line,), numbers={"here": 2.0}, loop="Other")
    found = data(own, other, scope=s.Scope(("a model",), ("an assumption",), ("a point",), ("all else",)))["sections"]
    assert [(x["title"], x["numbers"]["here"]) for x in found] == [(title, 1.0), ("Other", 2.0)]
