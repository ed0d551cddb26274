"""Errors: what their messages say, and the data they carry."""

from __future__ import annotations

import pickle

import pytest

from mfc_analysis import errors
from mfc_analysis.errors import NotConverged


def test_a_short_list_of_names_is_said_whole_and_in_its_order():
    why = errors.UnknownName("tool", "tol0", ("base", "tool0"))
    assert str(why) == "tool: got 'tol0'; takes one of 'base', 'tool0' (did you mean 'tool0'?)"


@pytest.mark.parametrize("count", [errors.MOST_NAMES, errors.MOST_NAMES + 1, 300])
def test_a_long_list_of_names_is_cut_but_not_its_data(count):
    names = tuple(f"link_{i}" for i in range(count))
    why = errors.UnknownName("tool", f"lnk_{count - 1}", names)
    assert why.known == names
    assert str(why).count("'link_") == errors.MOST_NAMES + 1
    assert f"(did you mean 'link_{count - 1}'?)" in str(why)
    assert (f" and {count - errors.MOST_NAMES} more" in str(why)) == (count > errors.MOST_NAMES)


def test_the_nearest_names_come_first_where_not_all_fit():
    names = (*(f"frame_{i}" for i in range(100)), "l_gripper")
    assert "takes one of 'l_gripper', 'frame_0', " in str(errors.UnknownName("tool", "l_griper", names))


def test_no_names_at_all_are_said():
    assert str(errors.UnknownName("tool", "x", ())) == "tool: got 'x'; takes one of none"


def test_a_shape_is_no_quotation():
    assert str(errors.BadArgument("kp", "shape (3,)", "shape (6,)")) == "kp: got shape (3,); takes shape (6,)"
    assert str(errors.BadArgument("kp", "many", "a number")) == "kp: got 'many'; takes a number"


def test_what_does_not_converge_says_why_in_one_sentence_after_a_pickle_too():
    one = NotConverged("the number of roots is not settled", "a root lies on the circle")
    assert str(one) == str(pickle.loads(pickle.dumps(one))) == "the number of roots is not settled: a root lies on the circle"
    assert str(NotConverged("no orbit")) == "no orbit"
