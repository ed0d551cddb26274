"""The words of a study file: what is a number, units of keys, and tables that take their keys and no other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import TypeAdapter, ValidationError

from mfc_analysis.study.tables import (
    REFERENCES,
    HoldTable,
    Number,
    Pose,
    PoseTable,
    QuinticTable,
    ReferenceTable,
    SinusoidTable,
    Three,
    ToolCircleTable,
    ToolLineTable,
    ToolSinusoidTable,
    Values,
    Vector,
    WaypointsTable,
    is_number,
    scaled,
    tables_of,
)


def refusal(kind: Any, value: Any) -> str:
    with pytest.raises(ValidationError) as why:
        TypeAdapter(kind).validate_python(value)
    return str(why.value.errors()[0]["msg"])


@pytest.mark.parametrize(
    ("value", "number"),
    [(1, True), (-2.5, True), (1e308, True), (True, False), (np.inf, False), (np.nan, False), ("1", False), (None, False), ([1], False)],
)
def test_only_a_finite_number_is_a_number(value, number):
    assert is_number(value) is number
    if number:
        assert TypeAdapter(Number).validate_python(value) == float(value)
    else:
        assert refusal(Number, value) == "a finite number"


@pytest.mark.parametrize(("kind", "good", "bad"), [
    (Values, [2, [1, 2], [[1, 2], [3, 4]]], [[], [[1, 2], [3]], [[]], [1, [2]], ["a"], [True], "a", {}, [[1, np.nan]]]),
    (Vector, [[1], [1, 2.5]], [[], 1, [[1]], [np.inf], [False]]),
    (Three, [[1, 2, 3]], [[1, 2], [1, 2, 3, 4], 3, [1, 2, "z"]]),
])  # fmt: skip
def test_lists_hold_numbers_in_their_shape(kind, good, bad):
    for value in good:
        assert_allclose(TypeAdapter(kind).validate_python(value), value)
    for value in bad:
        assert refusal(kind, value)


def test_whole_numbers_become_the_same_as_decimal_ones():
    assert repr(TypeAdapter(Values).validate_python([[1, 2]])) == "[[1.0, 2.0]]"


@pytest.mark.parametrize(
    ("table", "key", "factor"),
    [
        (HoldTable, "q_deg", np.pi / 180),
        (QuinticTable, "q1_deg", np.pi / 180),
        (SinusoidTable, "frequency_hz", 2 * np.pi),
        (SinusoidTable, "phase_deg", np.pi / 180),
        (ToolCircleTable, "frequency_hz", 2 * np.pi),
        (ToolSinusoidTable, "angle_deg", np.pi / 180),
        (PoseTable, "turn_deg", np.pi / 180),
    ],
)
def test_a_key_with_a_unit_is_the_one_without_times_its_factor(table, key, factor):
    value = 30.0 if table in (ToolCircleTable, ToolSinusoidTable) else [30.0, -60.0, 5.0]
    plain, _, unit = key.rpartition("_")
    made = table.model_construct(**{key: value})
    assert_allclose(made.si(plain), factor * np.asarray(value), rtol=1e-15)
    assert made.in_degrees() == (key if unit == "deg" else None)
    assert table.model_construct(**{plain: value}).si(plain) == value and table.model_construct().si(plain) is None


def test_a_quantity_is_given_in_one_unit_only():
    assert refusal(HoldTable, {"kind": "Hold", "q": [1.0], "q_deg": [1.0]}) == "q or q_deg, not both"
    assert (
        refusal(ToolCircleTable, {"kind": "ToolCircle", "radius": 1.0, "frequency": 1.0, "frequency_hz": 1.0})
        == "frequency or frequency_hz, not both"
    )


def test_numbers_in_lists_are_scaled_at_any_depth():
    assert scaled(3.0, 2) == 6.0 and scaled([1.0, [2.0, [3.0]]], -2) == [-2.0, [-4.0, [-6.0]]]


@pytest.mark.parametrize(
    ("table", "given", "missing"),
    [
        (QuinticTable, {"kind": "Quintic"}, "q1 or q1_deg"),
        (SinusoidTable, {"kind": "Sinusoid", "amplitude": 1.0}, "frequency or frequency_hz"),
        (SinusoidTable, {"kind": "Sinusoid", "frequency": 1.0}, "amplitude or amplitude_deg"),
        (WaypointsTable, {"kind": "Waypoints", "times": [0.0]}, "positions"),
        (ToolSinusoidTable, {"kind": "ToolSinusoid"}, "frequency"),
        (ToolCircleTable, {"kind": "ToolCircle", "radius": 1.0}, "frequency"),
    ],
)
def test_what_a_reference_cannot_do_without_is_named_with_both_units(table, given, missing):
    assert missing in refusal(table, given)


@pytest.mark.parametrize(("given", "taken"), [
    ({}, True), ({"q": [1.0]}, True), ({"position": [0, 0, 1], "rpy": [0, 0, 1]}, True), ({"shift": [0, 0, 1]}, True),
    ({"q": [1.0], "position": [0, 0, 1]}, False), ({"rpy": [0, 0, 1]}, False), ({"q": [1.0], "rpy": [0, 0, 1]}, False),
    ({"position": [0, 0, 1], "rpy": [0, 0, 1], "quaternion_xyzw": [0, 0, 0, 1]}, False), ({"position": [0, 0, 1], "yaw": 1.0}, False),
])  # fmt: skip
def test_a_pose_has_one_base_and_one_orientation(given, taken):
    if taken:
        assert PoseTable.model_validate(given).given() == given
    else:
        assert refusal(PoseTable, given)


def test_a_matrix_alone_is_a_pose():
    assert TypeAdapter(Pose).validate_python(np.eye(4).tolist()) == PoseTable(matrix=np.eye(4).tolist())


def test_what_was_given_is_told_from_what_is_a_default():
    assert QuinticTable(kind="Quintic", q1=[1.0]).given() == {"kind": "Quintic", "q1": [1.0]}
    assert QuinticTable(kind="Quintic", q1=[1.0]).duration == 2.0
    with pytest.raises(ValidationError):
        QuinticTable(kind="Quintic", q1=[1.0]).duration = 3.0


def test_the_kind_of_a_reference_picks_its_table():
    read = TypeAdapter(ReferenceTable).validate_python
    assert type(read({"kind": "Hold"})) is HoldTable and type(read({"kind": "ToolLine", "X1": {}})) is ToolLineTable
    for wrong in ({"kind": "Line"}, {}, {"kind": ["Hold"]}, "Hold"):
        assert refusal(ReferenceTable, wrong)
    assert set(tables_of(ReferenceTable)) == set(REFERENCES.values())


def test_the_tables_among_the_types_of_a_field_are_found_however_deep():
    assert tables_of(list[HoldTable] | dict[str, PoseTable] | None) == [HoldTable, PoseTable]
    assert tables_of(float | None) == []
