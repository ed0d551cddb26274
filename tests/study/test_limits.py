"""The design wishes of a study: each is the search of ``mfc.design`` on the study's loop."""

from __future__ import annotations

import json
import math

import pytest

from mfc_analysis import design
from mfc_analysis.study.check import check
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.limits import as_json, limits, requirement_limits
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


# --- limits at which the requirements are met ----------------------------------------------------------------------------

ARM = """
q_start = [0.0, -1.2, 1.5, -0.8, 1.57, 0.0]
[robot]
name = "ur5"
payload = {{ mass = {payload}, com = [0, 0, 0.05] }}
[controller_model]
payload = false
[law]
equation = "9.10"
gains = {{ helper = "pid", bandwidth = {bandwidth} }}
[reference]
kind = "Hold"
[hardware]
torque_lag = 2e-3
delay = {delay}
{sampling}
[requirements]
phase_deg = 40
gain_increase_db = 6
{more}
"""
GIVEN = {"payload": 1.0, "bandwidth": 60.0, "delay": 0.002, "sampling": "", "more": ""}


def arm(tmp_path, **changes):
    (tmp_path / "arm.toml").write_text(ARM.format(**(GIVEN | changes)))
    return read(tmp_path / "arm.toml")


@pytest.mark.parametrize("more", ["", "[ranges]\npayload = [0.0, 2.0]\n"])
def test_each_limit_is_met_one_per_cent_within_and_not_one_beyond(tmp_path, more):
    found = requirement_limits(arm(tmp_path, more=more).loops[0])
    limit = {one.name: float(one.limit) for one in found.found}
    assert found.met and list(limit) == ["largest payload", "largest dead time", "largest bandwidth", "smallest sample rate"]
    keys = {"largest dead time": "delay", "largest bandwidth": "bandwidth"} | ({} if more else {"largest payload": "payload"})
    for name, key in keys.items():
        checks = [check(arm(tmp_path, more=more, **{key: factor * limit[name]}))[0].status for factor in (0.99, 1.01)]
        assert checks == ["PASS", "FAIL"], name
    periods = [f"sample_time = {factor / limit['smallest sample rate']:.17g}" for factor in (0.99, 1.01)]
    assert [check(arm(tmp_path, more=more, sampling=p))[0].status for p in periods] == ["PASS", "FAIL"]


def test_the_rows_say_what_binds_and_the_sentences_give_the_pose(tmp_path):
    found = requirement_limits(arm(tmp_path).loops[0])
    row = found.rows()[0]
    assert row[2:] == ("1 kg", "phase margin", "elbow_joint", "0 s") and row[1].endswith(" kg") and found.rows()[-1][2] == "continuous"
    said = found.sentences()
    assert said[0].startswith("pose at t = 0 s: shoulder_pan_joint 0 rad, shoulder_lift_joint -1.2 rad") and "largest payload" in said[0]
    told = json.loads(as_json([found]))[0]
    assert told["met"] and told["limits"]["largest payload"]["binding"] == "phase_deg"
    assert told["limits"]["largest payload"]["pose"]["elbow_joint"] == 1.5 and told["limits"]["smallest sample rate"]["as given"] == "infinite"


def test_a_loop_that_misses_them_is_told_what_would_make_it_pass(tmp_path):
    heavy = requirement_limits(arm(tmp_path, payload=8.0).loops[0])
    light = requirement_limits(arm(tmp_path).loops[0])
    assert not heavy.met and float(heavy.found[0].limit) == pytest.approx(float(light.found[0].limit), rel=1e-4)
    assert heavy.found[1].limit == 0.0 and "no value" in heavy.rows()[1]
    assert any(
        "largest dead time: no value from 0 to 0.002 s meets the requirements; as given phase margin is missed" in x for x in heavy.sentences()
    )


def test_a_wall_is_searched_where_there_is_one_and_only_what_the_law_has(tmp_path):
    text = """
q_start = [0.0]
[robot]
name = "slider"
parameters = { mass = 2.0 }
[law]
equation = "9.23"
F_d = [0, 0, 5, 0, 0, 0]
kfp = 2.0
kfi = 3.0
kdamp = 40.0
[reference]
kind = "Hold"
[environment]
stiffness = 1e3
preload = 5.0
[hardware]
torque_lag = 5e-3
"""
    (tmp_path / "wall.toml").write_text(text)
    found = {one.name: one.limit for one in requirement_limits(read(tmp_path / "wall.toml").loops[0]).found}
    k_max = (40.0 * 3 - 2.0 * 3) / (5e-3 * 2 * 3)
    assert float(found["largest stiffness"]) == pytest.approx(k_max, rel=2e-5)
    assert "largest bandwidth" not in found and found["largest stiffness"].pose == {"slide": 0.0}
