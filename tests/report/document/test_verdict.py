"""Banner, matrix and worst case follow from the checks, in every format at once."""

from __future__ import annotations

import json

import pytest

from mfc_analysis.report.document.document import Badge, Document, MatrixCell, Section
from mfc_analysis.report.document.verdict import matrix, picture, proofs, requirements, verdict
from mfc_analysis.report.render.write import rendered
from mfc_analysis.requirements.line import Line, Status
from tests.report import samples

INF, NAN = float("inf"), float("nan")


def test_a_gain_that_makes_a_loop_unstable_changes_banner_matrix_section_and_json():
    good, bad = (rendered(samples.chapter(phase), ("html", "json")) for phase in (62.0, NAN))
    page, data = bad["html"].decode(), json.loads(bad["json"])
    assert "PASS: All 6 requirements are met" in good["html"].decode()
    assert "FAIL: 2 of 6 requirements are not met" in page
    assert (data["verdict"]["status"], json.loads(good["json"])["verdict"]["status"]) == ("FAIL", "PASS")
    section = next(x for x in data["sections"] if x["loop"] == "single joint")
    assert section["status"] == "FAIL"
    assert section["checks"][0]["found"] == "unstable" and section["numbers"]["phase"] == "not defined"
    assert '<a class="cell fail" href="#computed-torque-single-joint">' in page
    assert "unstable" in data["verdict"]["detail"] and "single joint" in data["verdict"]["detail"]


def test_the_worst_check_is_the_one_farthest_beyond_its_limit():
    found = verdict(samples.chapter(30.0))
    assert found.check.found == 30.0 and found.section.loop == "single joint"
    assert found.sentence == "2 of 6 requirements are not met"


def test_without_a_miss_the_tightest_check_is_named():
    found = verdict(samples.chapter(62.0))
    assert (found.status, found.section.loop) == (Status.PASS, "planar 2R")
    assert found.detail.startswith("Tightest: phase margin of planar 2R: 47.0°, required: at least 45°")


def test_nothing_asked_is_no_pass():
    found = verdict(Document("t", "s", (Section("one"),)))
    assert found.status is Status.INFO and "No requirements were given" in found.sentence


def test_a_section_with_a_verdict_of_its_own_keeps_the_banner_from_passing():
    checks = (Line("x", 1.0, 2.0, "", 1.0, Status.PASS),)
    found = verdict(Document("t", "s", (Section("one", checks=checks), Section("two", verdict=Status.WATCH))))
    assert found.status is Status.WATCH and "warning" in found.sentence


def test_every_cell_of_the_matrix_leads_to_the_section_of_its_check():
    document = samples.chapter()
    keys = {id(s): f"key-{i}" for i, s in enumerate(document.sections)}
    found = matrix(document, keys)
    assert found.columns == ("phase margin [°]", "gain reduction [dB]")
    assert [(name, cells[0].target) for name, _, cells in found.rows] == [("UR5 + 2 kg", "key-0"), ("single joint", "key-1"), ("planar 2R", "key-2")]


def test_checks_that_few_loops_have_share_a_column_of_a_wide_matrix():
    common = tuple(Line(f"c{i}", 1.0, 2.0, "", 1.0, Status.PASS) for i in range(8))
    odd = Line("odd_one", 1.0, 0.5, "m", -0.5, Status.FAIL, label="odd")
    sections = tuple(Section(f"s{i}", checks=(*common, odd) if i == 0 else common, loop=f"s{i}") for i in range(6))
    found = matrix(Document("t", "s", sections), {id(s): s.title for s in sections})
    assert found.columns == (*(f"c{i}" for i in range(8)), "other checks")
    assert found.rows[0][2][-1].text == "odd: 0.500 m" and found.rows[1][2][-1] is None


def test_loops_that_are_only_shown_are_demos_and_leave_the_banner_and_the_count_alone():
    bad = Line("x", 1.0, 0.0, "", -1.0, Status.FAIL)
    good = Line("x", 1.0, 2.0, "", 1.0, Status.PASS)
    shown = Section("open", checks=(bad,), loop="open", shown="open loop")
    document = Document("t", "s", (Section("used", checks=(good,), loop="used"), Section("law", sections=(shown,))))
    found = verdict(document)
    assert shown.badge is Badge.DEMO and found.status is Status.PASS and found.check is good
    assert "1 loop is shown for demonstration (DEMO) and not counted" in found.detail and "All 1 requirements" in found.sentence
    cells = matrix(document, {id(s): s.title for s in (*document.sections, shown)}).rows
    assert [cell for _, _, row in cells for cell in row] == [MatrixCell(Status.PASS, "2.00", "used"), None]
    page = json.loads(rendered(document, ("json",))["json"])
    assert page["sections"][1]["sections"][0]["status"] == "DEMO" and page["sections"][1]["sections"][0]["shown"] == "open loop"


def test_theory_is_listed_once_and_counts_only_where_it_fails():
    good, bad = Line("closed form", 1e-6, 0.0, "%", 1e-6, Status.PASS, "pole", sense="≤"), Line("closed form", 1e-6, 1.0, "%", -1.0, Status.FAIL)
    asked = Section("used", checks=(Line("x", 1.0, 2.0, "", 1.0, Status.PASS),), loop="used")
    one, other = (Document("t", "s", (asked, Section("theory", proofs=(line,)))) for line in (good, bad))
    assert (verdict(one).status, verdict(one).sentence) == (Status.PASS, "All 1 requirements are met")
    assert "1 of 1 checks of theory are confirmed" in verdict(one).detail
    assert verdict(other).status is Status.FAIL and verdict(other).sentence.startswith("1 self-test of the library failed: closed form")
    ((table,),) = (s.body for s in proofs(one))
    assert table.rows == (("theory", Badge.CONFIRMED, "closed form: pole (0 %, ≤ 1e−06 %)"),) and proofs(Document("t", "s", (asked,))) == ()


def test_the_picture_has_a_bar_in_limits_for_each_loop_and_margin():
    def loop(name, phase, peak, shown=""):
        lines = (Line("phase_deg", 45.0, phase, "°", phase - 45, Status.PASS if phase >= 45 else Status.FAIL, label="phase margin"),)
        lines += (Line("sensitivity_peak", 2.0, peak, "", 2 - peak, Status.PASS, sense="≤", label="sensitivity peak"),)
        return Section(name, checks=lines, loop=name, shown=shown)

    found = picture(Document("t", "s", (loop("a", 90.0, 1.0), loop("b", 30.0, 1.6), loop("c", INF, 1.0, "open"))))
    loops, heads, ratio, words, marks = found.draw.args
    assert (loops, heads, marks) == (("a", "b", "c"), ("phase margin [°]", "sensitivity peak"), ("PASS", "FAIL", "DEMO"))
    assert ratio.tolist() == [[2.0, 2.0], [30 / 45, 1.25], [INF, 2.0]] and words == (("90.0", "1.00"), ("30.0", "1.60"), ("∞", "1.00"))
    assert "0.667" in found.alt and picture(Document("t", "s", (loop("a", 90.0, 1.0),))) is None


def test_two_checks_in_one_cell_show_the_worse():
    good, bad = (Line("x", 1.0, 1 + d, "", d, s) for d, s in ((1.0, Status.PASS), (-0.5, Status.FAIL)))
    sections = (Section("a", checks=(good,), loop="L"), Section("b", checks=(bad,), loop="L"))
    found = matrix(Document("t", "s", sections), {id(s): s.title for s in sections})
    assert found.rows[0][2][0].status is Status.FAIL and found.rows[0][2][0].target == "b"


def test_a_document_without_loops_has_no_matrix():
    assert matrix(Document("t", "s", (Section("a"),)), {}) is None


def test_requirements_are_listed_failures_first():
    table = requirements(samples.document().sections[0])
    assert table.rows[0][0] == "overshoot"
    assert [row[1] for row in table.rows] == [Status.FAIL, Status.PASS, Status.PASS, Status.PASS]


@pytest.mark.parametrize("overshoot", [9.99, 10.01])
def test_the_banner_turns_exactly_where_a_check_does(overshoot):
    assert verdict(samples.document(overshoot)).status is (Status.PASS if overshoot < 10 else Status.FAIL)


def test_a_cell_names_the_point_of_a_smaller_margin_and_leaves_its_channel_to_the_evidence() -> None:
    line = Line("delay margin", 2.0, 45.8, "ms", 43.8, Status.PASS, "fz at “force”", elsewhere="5.28 ms at “torque” (wrist_3_joint)")
    section = Section("one", checks=(line,), loop="one", key="one")
    found = matrix(Document("", "", (section,), "x"), {id(section): "one"})
    assert found is not None and found.rows[0][2][0].text == "45.8; 5.28 ms at “torque”"
    assert "wrist_3_joint" in str(requirements(section).rows[0][-1])
