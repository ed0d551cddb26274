"""What several sections are made of: limits on both sides, NaN fails, words."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.report.chapter.pieces import agreement, at_least, at_most, in_words, pole_map, poles_table, slowest, verdict_of
from mfc_analysis.requirements.line import Status


def test_checks_pass_on_the_limit_and_fail_beyond_it() -> None:
    assert at_least("phase margin", 45.0, 45.0).status is Status.PASS
    assert at_least("phase margin", 45.0, 44.9).status is Status.FAIL
    assert at_most("peak", 2.0, 2.0).status is Status.PASS
    assert at_most("peak", 2.0, 2.1).distance == pytest.approx(-0.1)


def test_what_is_not_a_number_fails() -> None:
    assert at_least("phase margin", 45.0, float("nan")).status is Status.FAIL
    assert at_most("peak", 2.0, float("nan")).status is Status.FAIL


def test_an_agreement_is_in_percent_of_the_closed_form() -> None:
    check = agreement("speed", 1.01, 1.0, 0.5)
    assert (check.found, check.unit, check.status) == (pytest.approx(1.0), "%", Status.FAIL)


def test_stable_drifting_and_unstable_are_three_words() -> None:
    assert [in_words(True), in_words(False, True), in_words(False)] == ["stable", "drifts", "unstable"]
    assert [verdict_of(True), verdict_of(False, True), verdict_of(False)] == [Status.PASS, Status.WATCH, Status.FAIL]


def test_roots_at_zero_are_left_out_and_pairs_shown_once() -> None:
    poles = np.array([0, -1 + 2j, -1 - 2j, -5.0])
    assert slowest(poles) == -1 + 2j
    table = poles_table([("loop", poles)], 3, "Poles.")
    assert table.rows == (("loop", -1 + 2j, -5 + 0j, ""),)
    assert "-1" in pole_map(poles, "the loop").alt.replace("\N{MINUS SIGN}", "-")
