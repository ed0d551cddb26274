"""The gains that a study tunes: closed forms, over its ranges, told by check and met when they are written into the file."""

from __future__ import annotations

import json
import math

import pytest

from mfc_analysis.study.check import as_json, check
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.tuned import tuned, with_gains
from tests.study.samples import study

TEXT = """
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.2"
{law}
[reference]
kind = "Hold"
[hardware]
delay = 0.002
[requirements]
phase_deg = 60
[ranges]
delay = [0.002, 0.01]
[design]
tune = {tune}
"""
HELPER = 'gains = { helper = "p", settling_time = 1.0 }'
FASTEST = math.radians(30.0 - 0.06) / 0.01  #: of velocity P with 10 ms: 90 deg - k T = 60 deg, and the reserve


def given(law: str = HELPER, tune: str = "{ bandwidth = [1, 300] }") -> str:
    return TEXT.format(law=law, tune=tune)


def test_the_fastest_bandwidth_over_the_ranges_is_the_closed_form(tmp_path):
    found = tuned(study(tmp_path, given()).loops[0])
    assert found.met and found.gains["bandwidth"] == pytest.approx(FASTEST, rel=1e-3) and found.case == {"delay": 0.01}
    (checked,) = check(study(tmp_path, given()), search=True)
    assert any(text.startswith("tuned: bandwidth = 52.2") and "one more hertz misses: phase margin" in text for text in checked.sentences())
    assert json.loads(as_json([checked]))[0]["tuned"]["met"] is True
    again = given(f'gains = {{ helper = "p", bandwidth = {found.gains["bandwidth"]} }}')
    assert check(study(tmp_path, again))[0].status == "PASS"


def test_the_gains_of_the_law_and_a_wanted_bandwidth_in_hertz(tmp_path):
    of_the_law = tuned(study(tmp_path, given("kp = 3.0", "{ kp = [1, 300] }")).loops[0])
    assert of_the_law.gains["kp"] == pytest.approx(FASTEST, rel=1e-3)
    wanted = tuned(study(tmp_path, given(tune="{ bandwidth_hz = [0.2, 50], wanted_hz = 2.0 }")).loops[0])
    assert wanted.gains["bandwidth"] == pytest.approx(4 * math.pi, rel=1e-12)
    loop = with_gains(study(tmp_path, given()).loops[0], {"bandwidth": 7.0}, {"delay": 0.01})
    assert float(loop.law.kp.array) == pytest.approx(7.0) and loop.hardware.delay == 0.01


def test_none_is_tuned_where_none_is_asked_and_a_helper_is_needed(tmp_path):
    assert tuned(study(tmp_path, given().replace("tune = { bandwidth = [1, 300] }", "")).loops[0]) is None
    with pytest.raises(StudyError, match=r"law\.gains"):
        tuned(study(tmp_path, given("kp = 3.0")).loops[0])
    with pytest.raises(StudyError, match="low < high"):
        tuned(study(tmp_path, given(tune="{ bandwidth = [30, 3] }")).loops[0])
