"""The error of a study file: a sentence, and its data as attributes."""

from __future__ import annotations

import pickle

import pytest

from mfc_analysis.errors import MfcError
from mfc_analysis.study.errors import StudyError


@pytest.mark.parametrize(("key", "said"), [("law.kp", "a.toml: law.kp: is missing"), ("", "a.toml: is missing")])
def test_the_sentence_names_the_file_and_the_key_where_there_is_one(key, said):
    why = StudyError("a.toml", key, "is missing", ["kp", "ki"])
    assert str(why) == said
    for one in (why, pickle.loads(pickle.dumps(why))):
        assert (one.file, one.key, one.problem, one.allowed) == ("a.toml", key, "is missing", ("kp", "ki"))


def test_it_is_an_error_of_the_package_and_of_a_value():
    assert issubclass(StudyError, MfcError) and issubclass(StudyError, ValueError)
    assert StudyError("a", "b", "c").allowed == ()
