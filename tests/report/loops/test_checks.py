"""Checks of a section from a verdict of requirements."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

import pytest

from mfc_analysis.report.document.document import Status
from mfc_analysis.report.loops.checks import checks
from mfc_analysis.requirements.requirements import Line, Status as Asked


@dataclass(frozen=True)
class Verdict:
    lines: tuple[Line, ...]


@pytest.mark.parametrize(
    ("line", "found", "limit"),
    [
        (Line("phase_deg", "phase margin", 45.0, 66.04, "deg", 21.04, Asked.PASS, "elbow", 0.5), "66.0°", "≥ 45°"),
        (Line("delay", "delay margin", 0.002, 0.0239, "s", 0.0219, Asked.PASS), "23.9 ms", "≥ 2 ms"),
        (Line("overshoot", "overshoot", 0.1, 0.159, "", -0.059, Asked.FAIL, sense="≤"), "15.9 %", "≤ 10 %"),
        (Line("gain_increase_db", "gain margin, up", 6.0, inf, "dB", inf, Asked.PASS), "no limit", "≥ 6 dB"),
        (Line("delay", "delay margin", 0.002, nan, "s", nan, Asked.FAIL), "unstable", "≥ 2 ms"),
    ],
)
def test_a_line_becomes_a_check_in_a_readers_units(line, found, limit):
    (check,) = checks(Verdict((line,)))
    assert (str(check.value), str(check.limit)) == (found, limit)
    assert check.status is Status(line.status.value) and check.place == line.place
