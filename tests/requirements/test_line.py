"""Lines of a verdict: their order, their words."""

from __future__ import annotations

from math import inf, nan

from mfc_analysis.requirements.line import Line, Status, worst


def line(name: str, asked: float, distance: float, status: Status) -> Line:
    return Line(name, asked, asked + distance, "dB", distance, status)


def test_the_worst_line_is_the_failure_that_misses_most_and_before_all_the_loop_that_is_not_stable() -> None:
    unstable = line("stable", 0.0, -0.1, Status.FAIL)
    undefined = Line("phase_deg", 45.0, nan, "deg", nan, Status.FAIL)
    far, near = line("a", 10.0, -5.0, Status.FAIL), line("b", 1.0, -0.4, Status.FAIL)
    watch, met, free = line("c", 1.0, -9.0, Status.WATCH), line("d", 1.0, 0.5, Status.PASS), line("e", inf, inf, Status.PASS)
    given = [met, watch, near, unstable, free, far, undefined]
    assert sorted(given, key=lambda x: x.severity, reverse=True) == [unstable, undefined, far, near, watch, met, free]


def test_the_worst_status_of_none_is_info() -> None:
    assert worst([]) is Status.INFO
    assert worst([Status.PASS, Status.WATCH, Status.INFO]) is Status.WATCH
    assert [s.rank for s in (Status.INFO, Status.PASS, Status.WATCH, Status.FAIL)] == [0, 1, 2, 3]


def test_a_line_says_what_was_asked_and_found_where_and_when() -> None:
    said = Line("phase_deg", 45.0, 30.25, "deg", -14.75, Status.FAIL, "elbow", 0.5, label="phase margin", note="at the encoder")
    assert str(said) == "FAIL  phase margin  30.25 deg  ≥ 45 deg  -14.8 deg  elbow, t = 0.5 s  at the encoder"
    assert said.place == "elbow, t = 0.5 s" and Line("x", 1.0, 2.0, "", 1.0, Status.PASS).place == ""
    assert Line("x", nan, nan, "", nan, Status.FAIL).cells() == ("FAIL", "x", "undefined", "", "", "", "")
