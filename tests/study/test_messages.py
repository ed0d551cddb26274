"""What is wrong with a study in words: key, what the file has, what it may have."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from mfc_analysis.study.messages import explained, has
from mfc_analysis.study.schema import LawTable, StudyTable
from mfc_analysis.study.tables import REFERENCES
from tests.study.samples import BASE, Q, refused

LEAST = {"robot": {"name": "ur5"}, "law": {"equation": "9.10"}, "reference": {"kind": "Hold"}}

WRONG = {
    "a misspelt key names the nearest": ("mass = 2.0", "masss = 2.0", "robot.payload.masss", "did you mean 'mass'?"),
    "a misspelt key at the top": ('title = "a study"', 'titel = "a study"', "titel", "did you mean 'title'?"),
    "a misspelt table": ("[hardware]", "[hardwear]", "hardwear", "did you mean 'hardware'?"),
    "a misspelt requirement": ("phase_deg", "phase_dg", "requirements.phase_dg", "did you mean 'phase_deg'?"),
    "a missing table": ("[law]", "[times2]", "times2", "no such key"),
    "a missing key": ("[reference]\nkind", "[reference]\n#", "reference.kind", "is missing"),
    "another kind of reference": ('"Quintic"', '"Quintc"', "reference.kind", "did you mean 'Quintic'?"),
    "no number": ("kp = 100", "kp = 'large'", "law.kp", "a finite number"),
    "true is no number": ("kp = 100", "kp = true", "law.kp", "a finite number"),
    "not finite": ("kp = 100", "kp = nan", "law.kp", "a finite number"),
    "a word for a table": ("[times]", "[[loop]]\nhardware = 'fast'\n[times]", "loop[0].hardware", "takes a table"),
    "a list for a kind": ('"Quintic"', "[1]", "reference.kind", "takes one of 'Hold'"),
    "a number for a name": ('name = "ur5"', "name = 5", "robot.name", "takes a text"),
    "two units": ("[robot]", f"q_start_deg = {Q}\n[robot]", "", "not both"),
    "two sources": ('name = "ur5"', 'name = "ur5"\nload = "panda"', "robot", "exactly one of name, load, urdf and mjcf"),
    "one time": ("count = 5", "count = 1", "times.count", "greater than or equal to 2"),
    "a range of words": ("[times]", "[ranges]\npayload = ['a']\n[times]", "ranges.payload", "a list of finite numbers"),
    "a section that is not one": ("[times]", "[report]\nsections = ['poels']\n[times]", "report.sections[0]", "'poles'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_by_file_and_key_with_what_is_allowed(tmp_path, what):
    old, new, key, said = WRONG[what]
    assert old in BASE
    why = refused(tmp_path, BASE.replace(old, new, 1))
    assert why.key == key
    assert said in str(why)


def words(raw: dict) -> tuple[str, str, tuple[str, ...]]:
    """Key, sentence and allowed keys of the first thing that is wrong."""
    with pytest.raises(ValidationError) as why:
        StudyTable.model_validate(raw)
    return explained(why.value.errors(include_url=False)[0], raw)


def test_a_misspelt_key_lists_all_of_its_table_and_the_nearest_only_where_one_is_near():
    key, said, allowed = words({**LEAST, "law": {"equation": "9.10", "kpp": 1}})
    assert key == "law.kpp" and allowed == tuple(LawTable.model_fields) and "did you mean 'kp'?" in said
    assert "did you mean" not in words({**LEAST, "law": {"equation": "9.10", "zzzz": 1}})[1]


def test_a_place_in_a_list_is_named_by_its_number():
    environment = [{"stiffness": 1e3}, {"stiffness": 1e3, "axis": "z"}]
    assert words({**LEAST, "environment": environment})[0] == "environment[1].axis"
    assert words({**LEAST, "robot": {"name": "ur5", "payload": [{"mass": 1.0}, {"mass": "heavy"}]}})[0] == "robot.payload[1].mass"


def test_a_key_of_a_reference_is_looked_for_among_those_of_its_kind():
    key, said, allowed = words({**LEAST, "reference": {"kind": "Quintic", "q1": [0.0], "durration": 2.0}})
    assert key == "reference.durration" and allowed == tuple(REFERENCES["Quintic"].model_fields) and "'duration'" in said
    assert words({**LEAST, "reference": {"kind": "ToolLine", "X1": {"shft": [0, 0, 1]}}})[0] == "reference.X1.shft"


def test_a_kind_that_is_missing_or_unknown_lists_the_kinds():
    assert words({**LEAST, "reference": {}}) == ("reference.kind", "is missing", tuple(REFERENCES))
    key, said, allowed = words({**LEAST, "reference": {"kind": "hold"}})
    assert key == "reference.kind" and allowed == tuple(REFERENCES) and "got 'hold'" in said and "did you mean 'Hold'?" in said


def test_a_long_value_is_shown_by_its_beginning():
    _, said, _ = words({**LEAST, "title": ["long"] * 100})
    assert said.startswith("got ['long', 'long', ") and said.endswith("...; takes a text") and len(said) < 110


@pytest.mark.parametrize(("key", "there"), [
    ("a", True), ("a.b", True), ("a.b[1]", True), ("a.b[2]", False), ("a.c", False), ("a.b[1].d", False),
    ("a.b[0].d", True), ("b", False), ("a.b.d", False),
])  # fmt: skip
def test_a_key_is_there_or_not(key, there):
    assert has({"a": {"b": [{"d": 1}, 2]}}, key) is there
