"""What a study may say: every field of the library has its key, spans have their points, tables say which kind they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError

import mfc_analysis as mfc
from mfc_analysis import laws, trajectories
from mfc_analysis.requirements.requirements import KINDS
from mfc_analysis.study.limits import SEARCHES
from mfc_analysis.study.schema import (
    BodyTable,
    ConstraintsTable,
    DesignTable,
    EnvironmentTable,
    HardwareTable,
    LawTable,
    LoopTable,
    OuterTable,
    RequirementsTable,
    RobotTable,
    SpanTable,
    StudyTable,
    TimesTable,
)
from mfc_analysis.study.tables import REFERENCES, Table

LEAST = {"robot": {"name": "ur5"}, "law": {"equation": "9.10", "kp": 1.0}, "reference": {"kind": "Hold"}}


def refusal(table: type[Table], given: dict) -> str:
    with pytest.raises(ValidationError) as why:
        table.model_validate(given)
    return str(why.value.errors()[0]["msg"])


def test_every_law_requirement_hardware_field_and_reference_can_be_said():
    from dataclasses import fields

    said = set(LawTable.model_fields)
    for law in laws.LAWS.values():
        assert {f.name for f in fields(law) if f.init} <= said
    assert set(RequirementsTable.model_fields) == {*KINDS, "step"}
    assert set(HardwareTable.model_fields) == {f.name for f in fields(mfc.Hardware)}
    shown = {name for name in dir(trajectories) if isinstance(getattr(trajectories, name), type)}
    abstract_or_result = {"JointReference", "ToolReference", "JointPoint", "ToolPoint", "JointPath"}
    assert shown - abstract_or_result == set(REFERENCES) - {"csv"}


def test_every_search_that_a_study_may_wish_for_is_there():
    assert set(DesignTable.model_fields) == {*SEARCHES, "limits", "tune"}
    assert all(callable(getattr(mfc.design, name)) for name in (*SEARCHES, "tune"))


@pytest.mark.parametrize("table", [TimesTable, SpanTable])
def test_points_of_a_span_are_even_and_end_where_they_should(table):
    ends = ("start", "stop") if table is TimesTable else ("low", "high")
    for count in (2, 5, 101):
        points = table.model_validate({ends[0]: 0.2, ends[1]: 1.7, "count": count}).points()
        assert_allclose(points, np.linspace(0.2, 1.7, count), rtol=1e-14)
    assert table.model_validate({"values": [3.0, 1.0]}).points() == [3.0, 1.0]
    assert "a list of" in refusal(table, {"values": [1.0], ends[1]: 2.0, ends[0]: 1.0})
    assert "a list of" in refusal(table, {})
    assert "greater than or equal to 2" in refusal(table, {ends[0]: 0.0, ends[1]: 1.0, "count": 1})


def test_a_list_is_short_for_a_table_with_values():
    loop = LoopTable.model_validate({**LEAST, "times": [0.0, 0.5], "ranges": {"payload": [1.0, 2.0]}})
    assert loop.times is not None and loop.times.points() == [0.0, 0.5]
    assert loop.ranges.payload is not None and loop.ranges.payload.points() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("table", "good", "bad"),
    [
        (
            RobotTable,
            [{"name": "ur5"}, {"load": "panda"}, {"urdf": "a.urdf"}],
            [{}, {"name": "ur5", "urdf": "a.urdf"}, {"urdf": "a", "parameters": {"a": 1.0}}],
        ),
        (LawTable, [{"equation": "9.1"}, {"name": "VelocityP"}], [{}, {"equation": "9.1", "name": "VelocityP"}]),
        (OuterTable, [{"kp": 1.0}, {"num": [1.0], "den": [1.0, 1.0]}], [{}, {"kp": 1.0, "num": [1.0], "den": [1.0]}, {"num": [1.0], "A": 1.0}]),
        (
            ConstraintsTable,
            [{"set": "peg_in_hole"}, {"natural": ["vz = 0"]}, {"rows": [[0, 0, 1, 0, 0, 0]]}],
            [{}, {"set": "peg_in_hole", "rows": [[0, 0, 1, 0, 0, 0]]}, {"set": "peg"}],
        ),
    ],
)
def test_a_table_says_what_it_is_in_exactly_one_way(table, good, bad):
    for given in good:
        assert table.model_validate(given).given() == given
    for given in bad:
        assert refusal(table, given)


def test_short_forms_become_the_tables_they_stand_for():
    body = BodyTable.model_validate({"payload": {"mass": 2.0}, "friction": "none", "locked": ["a"]})
    assert [p.mass for p in body.payload] == [2.0] and body.payload[0].com == [0.0, 0.0, 0.0]
    assert body.friction is not None and body.friction.given() == {"viscous": 0.0} and body.locked == ["a"]
    assert BodyTable.model_validate({"payload": False}).payload == []
    assert BodyTable.model_validate({"friction": "urdf"}).friction.given() == {}
    assert BodyTable.model_validate({"locked": {"a": 1}}).locked == {"a": 1.0}
    law = LawTable.model_validate({"equation": "9.24", "constraints": "surface_sliding"})
    assert law.constraints is not None and law.constraints.set == "surface_sliding"
    rows = LawTable.model_validate({"equation": "9.24", "constraints": [[0, 0, 1, 0, 0, 0]]})
    assert rows.constraints is not None and rows.constraints.rows == [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]
    surface = {"stiffness": 1e4}
    one, two = (LoopTable.model_validate({**LEAST, "environment": given}).environment for given in (surface, [surface, surface]))
    assert one == [EnvironmentTable(stiffness=1e4)] and len(two) == 2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"payload": True}, "false for none"),
        ({"friction": "some"}, "'urdf', 'none'"),
        ({"locked": "a"}, "a list of joint names"),
        ({"locked": [1]}, "a list of joint names"),
        ({"gravity": [0, 0]}, "3 finite numbers"),
    ],
)
def test_what_a_body_cannot_take_says_what_it_takes(given, said):
    assert said in refusal(BodyTable, given)


def test_what_a_study_asks_is_nothing_until_it_says_so():
    table = StudyTable.model_validate(LEAST)
    assert table.requirements.given() == table.ranges.given() == table.design.given() == {}
    assert table.report.formats == ["html", "pdf", "json"] and not table.design.max_delay
