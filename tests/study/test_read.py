"""Study files: what they say becomes the loop that the library would have built, and what is wrong is named by file and key."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis import laws, trajectories
from mfc_analysis.study.read import StudyError, overridden, read
from tests.study.samples import BASE, Q, refused, study

pytestmark = pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")


def test_a_study_is_the_loop_that_the_library_builds(tmp_path):
    one = study(tmp_path, BASE).loops[0]
    robot = mfc.robots.ur5()
    loop = mfc.ClosedLoop(
        robot.with_payload(2.0, (0, 0, 0.05), 0.005),
        laws.ComputedTorque(100, 200, 20),
        trajectories.Quintic(Q, [1.0, -1.4, 1.7, -2.0, -1.5, 0.5], 2.0),
        controller_model=robot,
        hardware=mfc.Hardware(torque_lag=2e-3),
    )
    times = np.linspace(0, 2, 5)
    assert_allclose(one.times, times)
    assert_allclose(one.loop.linearize(one.times).A, loop.linearize(times).A, rtol=1e-12, atol=1e-12)
    assert one.requirements.asked() == {"phase_deg": 30.0}


def test_loops_change_some_keys_and_a_table_that_names_itself_anew_is_replaced(tmp_path):
    text = BASE + '[[loop]]\nname = "soft"\nlaw.kp = 50\n[[loop]]\nlaw = { equation = "9.8", kp = 300 }\nhardware.delay = 1e-3\n'
    soft, other = study(tmp_path, text).loops
    assert (soft.name, float(soft.loop.law.kp.array), float(soft.loop.law.kd.array)) == ("soft", 50.0, 20.0)
    assert (other.name, other.loop.law.equation, other.loop.law.kd.array) == ("JointPID on ur5", "9.8", None)
    assert other.loop.hardware.delay == 1e-3 and other.loop.hardware.torque_lag == 2e-3
    assert overridden({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}


def test_the_horizon_is_a_key_of_a_study_and_of_each_loop(tmp_path):
    assert [one.requirements.horizon for one in study(tmp_path, BASE).loops] == [100.0]
    text = "horizon = 10\n" + BASE + '[[loop]]\nname = "short"\n[[loop]]\nname = "by sign"\nhorizon = inf\n'
    assert [one.requirements.horizon for one in study(tmp_path, text).loops] == [10.0, np.inf]
    assert "horizon" in str(refused(tmp_path, "horizon = 0\n" + BASE))


def test_a_file_that_is_not_there_or_not_toml_is_named(tmp_path):
    with pytest.raises(StudyError, match=r"none\.toml: cannot be read"):
        read(tmp_path / "none.toml")
    assert "is not TOML" in str(refused(tmp_path, "title = "))
    (tmp_path / "s.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(StudyError, match="UTF-8"):
        read(tmp_path / "s.toml")


WRONG = {
    "too many cases": ("[times]", "[ranges]\npayload = { low = 0, high = 1, count = 999 }\ndelay = [0, 1e-3]\n[times]", "ranges", "1998"),
    "an override that is wrong": ("[times]", "[[loop]]\nlaw.kpp = 3\n[times]", "loop[0].law.kpp", "did you mean 'kp'?"),
    "an override of the wrong kind": ("[times]", "[[loop]]\nlaw.kp = [1, 2]\n[times]", "loop[0].law.kp", "shape (2,)"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_with_overrides_and_ranges_is_named_by_file_and_key(tmp_path, what):
    old, new, key, said = WRONG[what]
    assert old in BASE
    why = refused(tmp_path, BASE.replace(old, new, 1))
    assert why.key == key
    assert said in str(why)
