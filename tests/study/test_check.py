"""Requirements of a study over its ranges: the worst line of each, in words and as JSON."""

from __future__ import annotations

import json
import math

import pytest

from mfc_analysis.study.check import COLUMNS, as_json, check
from tests.study.samples import study

LOOP = """
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.10"
gains = { helper = "pid", bandwidth_hz = 2.0 }
[reference]
kind = "Hold"
[hardware]
delay = 0.01
[requirements]
"""


def checked(tmp_path, asked: str = "phase_deg = 30", more: str = "", **options):
    """What came of a joint with 10 ms of dead time; ``more``: tables at the end of the study."""
    return check(study(tmp_path, f"{LOOP}{asked}\n{more}"), **options)


def test_the_limits_stand_below_the_check_and_in_its_json(tmp_path):
    found = checked(tmp_path, "phase_deg = 50", "[design]\nmax_delay = true\n", search=True)
    assert any(line.startswith("limit: largest stable dead time") for line in found[0].sentences())
    assert '"largest stable dead time"' in as_json(found)
    assert checked(tmp_path, more="[design]\nmax_delay = true\n")[0].limits == ()


def test_over_ranges_each_requirement_shows_its_own_worst_case(tmp_path):
    more = "[ranges]\ndelay = [0.005, 0.02]\ninertia_scale = [0.5, 2.0]\n"
    (one,) = checked(tmp_path, "phase_deg = 1\ngain_increase_db = 1\ngain_reduction_db = 1", more)
    assert one.cases == 4 and [str(case) for case in one.loop.cases()] == [said for said, _ in one.verdicts]
    for line, case in one.lines:
        every = {said: next(x for x in verdict.lines if x.name == line.name) for said, verdict in one.verdicts}
        assert line is every[case] and line.severity == max(x.severity for x in every.values())
    cases = {line.name: case for line, case in one.lines}
    assert cases["gain_increase_db"] == "inertia_scale = 0.5, delay = 0.02"  # a light arm is a high gain
    assert cases["gain_reduction_db"].startswith("inertia_scale = 2")


@pytest.mark.parametrize(("share", "status"), [(0.999, "PASS"), (1.001, "FAIL")])
def test_the_status_turns_where_the_requirement_is_just_met(tmp_path, share, status):
    line = next(line for line, _ in checked(tmp_path)[0].lines if line.name == "phase_deg")
    (one,) = checked(tmp_path, f"phase_deg = {share * line.found:.10f}")
    assert one.status == status and one.lines[0][0].status == one.status
    assert one.sentences()[-1] == f"{status}: {one.loop.name}"
    said = [x for x in one.sentences() if x.startswith("FAIL:") and "phase margin: found" in x]
    assert len(said) == (status == "FAIL")


def test_rows_have_a_cell_for_each_column_and_the_heading_says_how_much_was_judged(tmp_path):
    (one,) = checked(tmp_path)
    assert {len(row) for row in one.rows()} == {len(COLUMNS)} and one.heading.endswith("t = 0 s")
    (several,) = checked(tmp_path, more="[times]\nvalues = [0.0, 0.5]\n[ranges]\ndelay = [0.0, 0.01]\n")
    assert several.heading.endswith("2 times from 0 to 0.5 s, 2 cases")


def test_json_has_words_for_what_is_no_number(tmp_path):
    stable = json.loads(as_json(checked(tmp_path, "gain_increase_db = 1\nphase_deg = 20", "[ranges]\ndelay = [0.0]\n")))
    unstable = json.loads(as_json(checked(tmp_path, more="[ranges]\ndelay = [0.9]\n")))
    found = {line["requirement"]: line["found"] for line in stable[0]["lines"]}
    assert found["gain_increase_db"] == "infinite" and math.isfinite(found["phase_deg"])
    lost = {line["requirement"]: line["found"] for line in unstable[0]["lines"]}
    assert lost["phase_deg"] == "undefined" and unstable[0]["status"] == "FAIL"


def test_an_arm_without_rotor_inertia_is_a_note_that_changes_no_verdict(tmp_path):
    text = (
        "q_start = [0, 0, 0, 0, 0, 0, 0]\n[robot]\nload = 'xarm7'\nfriction = 'none'\n[law]\nequation = '9.10'\nkp = 100\nkd = 20\n"
        "[reference]\nkind = 'Hold'\n[requirements]\nphase_deg = 30\n"
    )
    (one,) = check(study(tmp_path, text))
    (geared,) = check(study(tmp_path, text.replace("friction", "armature = 0.3\nfriction", 1)))
    assert [note for note in one.notes if "lacks rotor inertia; give armature: M_jj (M^-1)_jj of joint 'joint" in note]
    assert not any("rotor" in note for note in geared.notes) and one.status == geared.status == "PASS"
    assert any(line.startswith("note: xarm7: the URDF lacks") for line in one.sentences())


def test_progress_counts_every_case_of_every_loop(tmp_path):
    seen = []
    checked(tmp_path, more="[ranges]\ndelay = [0.0, 0.01, 0.02]\n", progress=lambda what, done, of: seen.append((done, of)))
    assert seen == [(i, 3) for i in range(4)]


def test_notes_of_several_cases_are_said_once(tmp_path):
    moving = LOOP.replace('kind = "Hold"', 'kind = "Sinusoid"\namplitude = 0.2\nfrequency = 2.0')
    more = "[times]\nvalues = [0.0]\n[ranges]\ndelay = [0.0, 0.01]\n"
    (one,) = check(study(tmp_path, f"{moving}phase_deg = 30\n{more}"))
    (note,) = one.notes
    assert [verdict.notes for _, verdict in one.verdicts] == [(note,)] * 2 and one.sentences().count(f"note: {note}") == 1
