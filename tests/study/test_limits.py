"""The design wishes of a study: each is the search of ``mfc.design`` on the study's loop."""

from __future__ import annotations

import math

import pytest

from mfc_analysis import design
from mfc_analysis.study.check import check
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.limits import limits
from mfc_analysis.study.read import read

TEXT = """
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.10"
gains = {{ helper = "pid", bandwidth_hz = 2.0 }}
[reference]
kind = "Hold"
[hardware]
delay = 0.01
[requirements]
phase_deg = 50
[design]
{wishes}
"""


def study(tmp_path, wishes: str, text: str = TEXT):
    (tmp_path / "s.toml").write_text(text.format(wishes=wishes))
    return read(tmp_path / "s.toml")


def test_limits_are_those_of_the_design_searches_in_their_order(tmp_path):
    one = study(tmp_path, "max_payload = true\nmax_delay = true").loops[0]
    found = limits(one)
    assert [limit.name for limit in found] == ["largest stable dead time", "largest stable payload"]
    assert float(found[0]) == float(design.max_delay(one.loop))
    assert limits(study(tmp_path, "max_delay = false").loops[0]) == ()


def test_the_largest_bandwidth_ends_where_a_requirement_binds(tmp_path):
    made = study(tmp_path, "max_bandwidth = true")
    found = float(limits(made.loops[0])[0])
    text = TEXT.replace("bandwidth_hz = 2.0", "bandwidth = {bandwidth}")
    for factor, status in ((0.999, "PASS"), (1.01, "FAIL")):
        again = study(tmp_path, "", text.replace("{bandwidth}", f"{factor * found:.8f}"))
        assert check(again)[0].status == status


def test_over_ranges_the_largest_bandwidth_is_that_of_the_worst_case(tmp_path):
    alone = float(limits(study(tmp_path, "max_bandwidth = true").loops[0])[0])
    ranged = TEXT + "[ranges]\ndelay = [0.0, 0.02]\n"
    worst = float(limits(study(tmp_path, "max_bandwidth = true", ranged).loops[0])[0])
    late = float(limits(study(tmp_path, "max_bandwidth = true", TEXT.replace("delay = 0.01", "delay = 0.02")).loops[0])[0])
    assert worst < alone and math.isclose(worst, late, rel_tol=1e-4)


def test_a_bandwidth_needs_gains_from_a_helper_and_a_stiffness_a_surface(tmp_path):
    plain = TEXT.replace('gains = {{ helper = "pid", bandwidth_hz = 2.0 }}', "kp = 100\nkd = 20")
    with pytest.raises(StudyError, match=r"design\.max_bandwidth: .*law\.gains"):
        limits(study(tmp_path, "max_bandwidth = true", plain).loops[0])
    with pytest.raises(StudyError, match=r"design\.max_stiffness: .*environment"):
        limits(study(tmp_path, "max_stiffness = true").loops[0])
