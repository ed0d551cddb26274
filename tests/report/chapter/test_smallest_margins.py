"""The smallest margins over all analysis points: checks that turn at the margin found, and the loop that breaks first, tried on both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.stability import stability
from mfc_analysis.report.chapter import force
from mfc_analysis.report.chapter.smallest_margins import force_checks, force_facts, margin_numbers, tightest
from mfc_analysis.requirements.line import Status


def test_each_check_of_a_force_loop_turns_at_the_margin_that_was_found() -> None:
    lin = force.slider_loop(2e3, hardware=mfc.Hardware(torque_lag=2e-3)).linearize()
    n = {name: found["value"] for name, found in margin_numbers(lin)["smallest"].items()}
    for side, status in ((1 - 1e-6, Status.PASS), (1 + 1e-6, Status.FAIL)):
        lines = force_checks(lin, side * n["phase_deg"], side * n["gain_increase_db"], n["sensitivity_peak"] / side)
        assert [lines[k].status for k in (1, 2, 5)] == [status] * 3
    phase, gain, delay = (x.value.value for x in force_facts(lin).facts)
    assert_allclose([phase, gain, delay], [n["phase_deg"], n["gain_increase_db"], 1e3 * n["delay"]])


def test_the_delay_margin_of_the_arm_is_that_of_the_torque_loop_that_breaks_first() -> None:
    """The force sensor alone would take 45.8 ms; dead time in one torque breaks the loop at 5.28 ms, on both sides of which it is tried."""
    loop = force.arm_loop(hardware=mfc.Hardware(torque_lag=2e-3))
    lin = loop.linearize()
    found = margin_numbers(lin)
    late = found["smallest"]["delay"]
    assert (late["point"], late["channel"]) == ("torque", "wrist_3_joint") and found["force"]["delay"] > 8 * late["value"]
    wires = lin.opened.wires["torque"]
    for part, stable in ((0.99, True), (1.01, False)):
        delay = np.zeros(len(lin.opened.wire_delay))
        delay[wires][5] = part * late["value"]  # a slice is a view
        assert bool(stability(replace(lin.opened, wire_delay=delay)).nonzero_stable[0]) is stable
    line = next(x for x in force_checks(lin, 45.0, 6.0, 2.0) if x.name == "delay margin")
    assert line.found == 1e3 * late["value"] and line.where == "wrist_3_joint at “torque”"
    assert "5.28 ms (wrist_3_joint at “torque”)" in tightest(lin) and ", t = " not in tightest(lin)


def test_what_a_page_says_of_one_loop_takes_its_margins_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lin, other = (force.slider_loop(2e3, hardware=mfc.Hardware(torque_lag=lag)).linearize() for lag in (2e-3, 4e-3))
    asked: list[str] = []
    true = type(lin).margins
    monkeypatch.setattr(type(lin), "margins", lambda self, at: asked.append(at) or true(self, at))
    said = tightest(lin), force_facts(lin), margin_numbers(lin), force_checks(lin, 45.0, 6.0, 2.0)
    assert sorted(asked) == sorted(lin.opened.points)
    assert tightest(other) != said[0]  # another loop has its own
