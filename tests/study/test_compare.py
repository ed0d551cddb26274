"""Two studies compared: the keys that changed, the metrics on both sides, and what each change did."""

from __future__ import annotations

import pytest

from mfc_analysis.study.compare import CHANGES, REQUIREMENTS, compare
from tests.study.samples import study

TEXT = """
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.2"
kp = {kp}
[reference]
kind = "Hold"
[hardware]
delay = {delay}
[requirements]
phase_deg = {phase}
"""


def two(tmp_path, **changes):
    given = {"kp": 5.0, "delay": 0.01, "phase": 45.0}
    return [study(tmp_path, TEXT.format(**values), name) for name, values in (("a.toml", given), ("b.toml", given | changes))]


def test_each_change_takes_the_phase_that_the_closed_form_says(tmp_path):
    """Velocity P with dead time: 90 deg - kp T. Together 57.3 x (8 x 0.03 - 5 x 0.01), alone with the other as in the first."""
    (found,) = compare(*two(tmp_path, kp=8.0, delay=0.03))
    assert found.changes == (("law.kp", "5", "8"), ("hardware.delay", "0.01", "0.03")) and len(CHANGES) == 3
    degree = 57.29577951308232
    assert found.did.factors == ("law.kp", "hardware.delay") and found.did.ends == ("first", "second")
    assert found.did.first[:, 0] == pytest.approx([degree * 3 * 0.01, degree * 5 * 0.02])
    assert found.did.last[:, 0] == pytest.approx([degree * 3 * 0.03, degree * 8 * 0.02])
    assert found.did.joint[0] == pytest.approx(degree * (8 * 0.03 - 5 * 0.01))
    row = next(row for row in found.rows() if row[0] == "phase margin")
    assert row == ("phase margin", "87.14 deg", "76.25 deg", "-10.89", "PASS", "PASS", "joint, t = 0 s") and len(row) == len(REQUIREMENTS)
    assert found.costs[1].joint[0] == pytest.approx(degree * 8 * 0.03)
    picture = found.costs[0].plot()
    assert (picture.get_xlabel(), picture.get_title("left")) == ("cost [deg]", "Where the phase margin went")


def test_a_change_of_what_is_asked_changes_no_loop(tmp_path):
    (found,) = compare(*two(tmp_path, phase=88.0))
    assert found.changes == (("requirements.phase_deg", "45", "88"),) and found.did is None
    assert [row[4:6] for row in found.rows() if row[0] == "phase margin"] == [("PASS", "FAIL")]
    (same,) = compare(*two(tmp_path))
    assert same.changes == () and same.heading == "VelocityP on single_joint -> VelocityP on single_joint"


def test_loops_are_paired_by_name_and_a_robot_changed_as_a_whole_is_one_change(tmp_path):
    several = TEXT.format(kp=5.0, delay=0.01, phase=45.0)
    first = study(tmp_path, several + '[[loop]]\nname = "x"\n[[loop]]\nname = "y"\n[loop.hardware]\ndelay = 0.02\n', "a.toml")
    second = study(tmp_path, several + '[[loop]]\nname = "y"\n[[loop]]\nname = "x"\n[loop.robot]\nname = "slider"\n', "b.toml")
    found = compare(first, second)
    assert [pair.first.loop.name for pair in found] == [pair.second.loop.name for pair in found] == ["x", "y"]
    assert found[0].changes == (("robot.name", "single_joint", "slider"),) and found[1].changes == (("hardware.delay", "0.02", "0.01"),)
