"""Checks at the public door."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mfc_analysis.errors import BadArgument, MfcError
from mfc_analysis.maths import checks


def test_arrays_are_copied_read_only_floats() -> None:
    given = np.array([1, 2])
    out = checks.array("x", given)
    given[0] = 7
    assert out.dtype == float and out[0] == 1.0 and not out.flags.writeable


NOT_NUMBERS = [None, "a", "3", [1, None], [[1], [2, 3]], np.nan, [np.inf], {}, object(), 2j, b"1"]


@pytest.mark.parametrize("value", NOT_NUMBERS, ids=lambda given: type(given).__name__ if type(given) is object else repr(given))
def test_what_is_not_finite_numbers_is_refused_with_its_data(value: object) -> None:
    with pytest.raises(BadArgument) as info:
        checks.array("x", value)
    assert info.value.argument == "x" and info.value.got is value and info.value.takes
    assert isinstance(info.value, ValueError) and isinstance(info.value, MfcError)
    assert str(info.value).startswith("x: got ")


def test_a_wrong_shape_is_refused_and_none_leaves_an_axis_open() -> None:
    assert checks.array("x", np.ones((4, 3)), (None, 3)).shape == (4, 3)
    for shape in ((3,), (3, None), (None, 4), (None, 3, 1)):
        with pytest.raises(BadArgument, match=r"shape \(4, 3\)"):
            checks.array("x", np.ones((4, 3)), shape)


@pytest.mark.parametrize(("value", "more"), [
    (-1, {"low": 0}), (0, {"low": 0, "strict": True}), (3, {"high": 2}), (np.inf, {}), (np.nan, {"allow_inf": True}), (-np.inf, {"allow_inf": True}),
    (True, {}), ("1", {}), (1j, {}), (None, {}), ([1, 2], {}),
])  # fmt: skip
def test_a_number_out_of_bounds_is_refused(value: object, more: dict) -> None:
    with pytest.raises(BadArgument) as info:
        checks.number("x", value, **more)
    assert info.value.argument == "x"


def test_numbers_on_their_bounds_are_taken() -> None:
    assert checks.number("x", 0, low=0) == 0.0 and checks.number("x", 2, high=2) == 2.0
    assert checks.number("x", np.inf, allow_inf=True) == np.inf
    assert isinstance(checks.number("x", np.float32(1)), float)


@pytest.mark.parametrize("value", [[], [0.0, 0.0], [1.0, 0.5], [[0.0, 1.0]], [0.0, np.nan], "now", None])
def test_times_that_do_not_increase_are_refused(value: object) -> None:
    with pytest.raises(BadArgument, match="strictly increasing") as info:
        checks.times(value)
    assert info.value.argument == "times"


def test_one_time_is_a_list_of_one() -> None:
    assert checks.times(0.5).tolist() == [0.5] and checks.times([-1, 2]).tolist() == [-1.0, 2.0]


def test_values_per_joint_are_spread_or_taken_one_by_one() -> None:
    assert checks.per_joint("b", 2, 3).tolist() == [2, 2, 2]
    assert checks.per_joint("b", [1, 2, 3], 3).tolist() == [1, 2, 3]
    for value in ([1, 2], np.ones((3, 1)), -1):
        with pytest.raises(BadArgument):
            checks.per_joint("b", value, 3, low=0.0)


def test_a_choice_lists_what_there_is() -> None:
    assert checks.choice("about", "reference", ("reference", "equilibrium")) == "reference"
    for value in ("Reference", None, 3, ["reference"]):
        with pytest.raises(BadArgument, match="'reference', 'equilibrium'"):
            checks.choice("about", value, ("reference", "equilibrium"))


def test_a_long_value_is_shortened_in_the_message() -> None:
    with pytest.raises(BadArgument) as info:
        checks.array("x", np.full(500, np.nan))
    assert len(str(info.value)) < 250 and "\n" not in str(info.value)


def test_numbers_in_ragged_rows_are_told_from_other_bad_values() -> None:
    with pytest.raises(BadArgument, match="takes finite numbers, in rows of equal length"):
        checks.array("x", [[1], [1, 2]])


def test_a_list_that_hides_booleans_words_or_complex_numbers_is_refused() -> None:
    for value in ([1.0, True], [1, "3"], [1.0, 1j], np.array([True]), np.array(["3"], dtype=object), [np.True_, 2.0]):
        with pytest.raises(BadArgument):
            checks.array("x", value)
    assert checks.array("x", [1, 10**30, np.float32(2)]).tolist() == [1.0, 1e30, 2.0]


def test_what_cannot_be_written_is_named_by_its_type() -> None:
    deep: list = []
    for _ in range(100_000):  # Python 3.13 writes thousands
        deep = [deep]
    for value, word in ((deep, "list"), (10**5000, "int")):
        with pytest.raises(BadArgument, match=f"x: got one of type {word} that is too deep or too long to show"):
            checks.array("x", value)


def test_a_vector_is_a_list_or_one_number() -> None:
    assert checks.vector("x", 2).tolist() == [2.0] and checks.vector("x", []).size == 0
    assert not checks.vector("x", 2).flags.writeable
    with pytest.raises(BadArgument, match=r"shape \(1, 2\)"):
        checks.vector("x", [[1, 2]])


def test_whole_numbers_names_objects_and_paths() -> None:
    assert checks.whole("k", np.int64(3), 1, 3) == 3 and checks.names("joints", ("a", "b"), ("b", "a")) == ("a", "b")
    assert checks.instance("x", 1.5, float, "a float") == 1.5 and checks.path("file", Path("a/b")) == Path("a/b")
    for call in (
        lambda: checks.whole("k", True, 0, 3),
        lambda: checks.whole("k", 1.0, 0, 3),
        lambda: checks.whole("k", 4, 0, 3),
        lambda: checks.names("k", "a", ("a",)),
        lambda: checks.names("k", [["a"]], ("a",)),
        lambda: checks.instance("k", 1, float, "a float"),
        lambda: checks.path("k", 1),
        lambda: checks.path("k", b"a"),
        lambda: checks.path("k", "a\0b"),
    ):
        with pytest.raises(BadArgument, match=r"^k: got "):
            call()


def test_a_text_is_a_number_in_plain_decimals_only() -> None:
    for text in ("2", "-2.50", "+.5", "7.", "1e-3", "1E+2", "007", "-0", "1" * 50):
        assert checks.decimal(text) == float(text)
    for text in ("", " 2", "2 ", "2\n", "2_0", "\uff12", "\u0662", "1,5", "nan", "inf", "-inf", "0x10", "1e", "e5", ".", "+", "1e400", "--1", "1d3"):
        assert checks.decimal(text) is None


def test_frequencies_are_finite_and_not_negative():
    assert checks.frequencies([0, 2.5]).tolist() == [0.0, 2.5]
    for wrong in ([-1.0], [np.inf], [[1.0, 2.0]], "fast"):
        with pytest.raises(BadArgument, match="frequencies"):
            checks.frequencies(wrong)
