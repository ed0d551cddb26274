"""The lines of a verdict in the units that a reader expects."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from mfc_analysis.report.document.document import found_of, limit_of
from mfc_analysis.report.loops.checks import checks
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import KINDS, Requirements
from tests.report.loops.views import open_loop


@pytest.mark.parametrize(
    ("line", "found", "limit"),
    [
        (Line("phase_deg", 45.0, 66.04, "deg", 21.04, Status.PASS, "elbow", 0.5, label="phase margin"), "66.0°", "≥ 45°"),
        (Line("delay", 0.002, 0.0239, "s", 0.0219, Status.PASS), "23.9 ms", "≥ 2 ms"),
        (Line("overshoot", 0.1, 0.159, "", -0.059, Status.FAIL, sense="≤"), "15.9 %", "≤ 10 %"),
        (Line("gain_increase_db", 6.0, inf, "dB", inf, Status.PASS), "no limit", "≥ 6 dB"),
        (Line("delay", 0.002, nan, "s", nan, Status.FAIL), "unstable", "≥ 2 ms"),
    ],
)
def test_a_line_is_shown_in_a_readers_units(line: Line, found: str, limit: str) -> None:
    (shown,) = checks([line])
    assert (str(found_of(shown)), str(limit_of(shown))) == (found, limit)
    assert (shown.status, shown.place, shown.label) == (line.status, line.place, line.label)


def test_a_loop_step_names_its_analysis_point_and_a_step_of_the_reference_has_none() -> None:
    for step, where in (("reference", "elbow"), ("loop", "elbow at “torque”")):
        label = KINDS["settling_time"].said(step)
        (shown,) = checks([Line("settling_time", 0.5, 0.4, "s", 0.1, Status.PASS, "elbow", 0.0, "≤", label=label)], "torque")
        assert (shown.where, shown.label) == (where, f"settling time ({step} step)")


def test_without_a_fast_root_a_line_says_that_nothing_holds_the_loop() -> None:
    found = replace(open_loop(), requirements=Requirements(phase_deg=45.0)).checks
    assert {line.name: str(found_of(line)) for line in found} == {"stable": "every root is slow", "phase_deg": "nothing holds it"}
