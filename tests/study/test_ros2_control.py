"""Gains to ros2_control and back: units, names, what stays in the user's file, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from ruamel.yaml import YAML

from mfc_analysis.errors import BadArgument, UnknownName, Unsupported
from mfc_analysis.study.ros2_control import exported, law_table, with_law
from tests.study.samples import Q, study

JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
BASE = f"""
q_start = {Q}
[robot]
name = "ur5"
# the law of the arm
[law]
LAW
# the motion
[reference]
kind = "Hold"
[hardware]
torque_lag = 2e-3
"""
PID = 'equation = "9.8"\nkp = [900, 900, 500.5, 100, 100, 50]\nki = [800, 800, 400, 90, 90, 0.1]\nkd = 30'
#: the gains of a joint in src/joint_trajectory_controller_parameters.yaml and src/pid_controller.yaml of ros2_controllers 6.9.0 (August 2026)
COMMON = {
    "p",
    "i",
    "d",
    "u_clamp_max",
    "u_clamp_min",
    "i_clamp_max",
    "i_clamp_min",
    "antiwindup_strategy",
    "tracking_time_constant",
    "error_deadband",
}
NAMES = {
    "joint_trajectory_controller": COMMON | {"ff_velocity_scale"},
    "pid_controller": COMMON | {"feedforward_gain", "angle_wraparound", "save_i_term"},
}
TABLE = {
    "joint_trajectory_controller": {"joints", "command_interfaces", "state_interfaces", "gains"},
    "pid_controller": {"dof_names", "command_interface", "reference_and_state_interfaces", "gains"},
}


def loop(folder: Path, law: str, more: str = "") -> Any:
    return study(folder, BASE.replace("LAW", law) + more).loops[0]


def parameters(text: str, name: str = "joint_trajectory_controller") -> Any:
    return YAML(typ="safe").load(text)[name]["ros__parameters"]


@pytest.mark.parametrize("controller", NAMES)
def test_every_name_is_documented_and_every_gain_a_double(tmp_path: Path, controller: str) -> None:
    found = parameters(exported(loop(tmp_path, PID), "", controller).text, controller)
    assert set(found) == TABLE[controller] and set(found["gains"]) == set(JOINTS)
    for row in found["gains"].values():
        assert set(row) <= NAMES[controller]
        assert all(type(value) is float for key, value in row.items() if key != "antiwindup_strategy")  # ROS refuses a whole number for a double
        assert row["antiwindup_strategy"] in ("back_calculation", "conditional_integration", "none")


@pytest.mark.parametrize("controller", NAMES)
def test_the_gains_of_joint_pid_are_written_as_they_are_and_read_back(tmp_path: Path, controller: str) -> None:
    one = loop(tmp_path, PID)
    made = exported(one, "", controller)
    row = parameters(made.text, controller)["gains"]["elbow_joint"]
    assert (row["p"], row["i"], row["d"], row["u_clamp_max"]) == (500.5, 400.0, 30.0, 150.0)  # the UR5's elbow has 150 Nm
    law, _ = law_table(made.text, JOINTS)
    (again,) = study(tmp_path, with_law(BASE.replace("LAW", PID), law), "again.toml").loops
    assert type(again.loop.law) is type(one.loop.law)
    for key, gain in one.loop.law.gains().items():
        assert (again.loop.law.gains()[key].diagonal(6) == gain.diagonal(6)).all()
    assert_allclose(again.loop.linearize().A, one.loop.linearize().A, rtol=0, atol=0)
    assert any("gravity" in note for note in made.notes)


VELOCITY_LAWS = (
    'equation = "9.1"',
    'equation = "9.2"\nkp = 4',
    'equation = "9.3"\nkp = 4\nki = [1, 2, 3, 4, 5, 6]',
    'equation = "9.4"\nkp = 4\nki = 1.5',
    'name = "VelocityFeedforwardPI"\nkp = 3',
)


@pytest.mark.parametrize("law", VELOCITY_LAWS)
def test_velocity_laws_are_read_back_with_their_feedforward(tmp_path: Path, law: str) -> None:
    one = study(tmp_path, BASE.replace("LAW", law).replace("torque_lag = 2e-3", "")).loops[0]
    made = exported(one)
    found = parameters(made.text)
    assert found["command_interfaces"] == ["velocity"] and found["gains"]["elbow_joint"]["u_clamp_max"] == pytest.approx(
        one.loop.robot.limits.velocity[2]
    )
    read, _ = law_table(made.text, JOINTS)
    again = study(tmp_path, with_law(BASE.replace("LAW", law).replace("torque_lag = 2e-3", ""), read), "again.toml").loops[0]
    assert type(again.loop.law) is type(one.loop.law)
    assert {k: g.diagonal(6).tolist() for k, g in again.loop.law.gains().items()} == {
        k: g.diagonal(6).tolist() for k, g in one.loop.law.gains().items()
    }


def test_gains_of_computed_torque_become_nm_per_rad_by_the_mass_matrix(tmp_path: Path) -> None:
    one = loop(tmp_path, 'equation = "9.10"\nkp = 100\nki = 200\nkd = 20')
    made = exported(one)
    m = np.diag(one.loop.robot.mass(np.array(Q)))
    gains = parameters(made.text)["gains"]
    assert_allclose([gains[j]["p"] for j in JOINTS], 100 * m, rtol=1e-12)
    assert_allclose([gains[j]["i"] for j in JOINTS], 200 * m, rtol=1e-12)
    assert_allclose([gains[j]["d"] for j in JOINTS], 20 * m, rtol=1e-12)
    said = " ".join(made.notes)
    assert "1/s^2" in said and "Nm/rad" in said and f"elbow_joint {m[2]:.4g} kg m^2" in said and "not the law of the study" in said
    assert f"# = kp 100 1/s^2 x M_jj {m[2]:.6g} kg m^2" in made.text
    law, notes = law_table(made.text, JOINTS)  # what the arm will run is 9.8, and so it is read
    assert law["name"] == "JointPID" and "no model of the arm" in notes[0]
    read = study(tmp_path, with_law(BASE.replace("LAW", 'equation = "9.10"\nkp = 100'), law), "again.toml").loops[0]
    phase, _, joint = read.loop.linearize().margins().worst().phase_deg
    assert f"smallest phase margin {phase:.1f} deg ({joint})" in said


def test_converted_gains_that_are_unstable_are_refused(tmp_path: Path) -> None:
    """s^3 + kd s^2 + kp s + ki is stable for kd kp > ki; with the coupling dropped this one is not."""
    with pytest.raises(Unsupported, match="unstable on this arm"):
        exported(loop(tmp_path, 'equation = "9.10"\nkp = 100\nki = 1950\nkd = 20'))


def test_friction_that_computed_torque_compensates_is_the_velocity_feedforward(tmp_path: Path) -> None:
    text = BASE.replace("LAW", 'equation = "9.10"\nkp = 100\nkd = 20').replace('name = "ur5"', 'name = "ur5"\nfriction = {viscous = 1.5}')
    gains = parameters(exported(study(tmp_path, text).loops[0]).text)["gains"]
    assert [gains[j]["ff_velocity_scale"] for j in JOINTS] == [1.5] * 6
    assert "i_clamp_max" in gains["elbow_joint"] and "antiwindup_strategy" not in gains["elbow_joint"]


OLD = """# my arm
controller_manager:
  ros__parameters:
    update_rate: 500   # [Hz]
    arm:
      type: joint_trajectory_controller/JointTrajectoryController

other_node:
  ros__parameters: {a: 1}
arm:
  ros__parameters:
    joints: [wrist_3_joint, shoulder_pan_joint, shoulder_lift_joint, elbow_joint, wrist_1_joint, wrist_2_joint]
    command_interfaces: [effort]
    gains:
      elbow_joint: {p: 1.0, i: 2.0, d: 3.0, error_deadband: 0.5}   # tuned by hand
    constraints:
      goal_time: 0.6  # keep
"""


def test_the_users_file_keeps_what_is_not_a_gain(tmp_path: Path) -> None:
    made = exported(loop(tmp_path, PID, "sample_time = 1e-3\n"), OLD, name="arm")
    for line in ("# my arm", "update_rate: 500   # [Hz]", "ros__parameters: {a: 1}", "goal_time: 0.6  # keep", "# tuned by hand"):
        assert line in made.text
    found = parameters(made.text, "arm")
    assert found["joints"][0] == "wrist_3_joint" and found["gains"]["elbow_joint"]["error_deadband"] == 0.5
    assert found["gains"]["elbow_joint"]["p"] == 500.5 and found["state_interfaces"] == ["position", "velocity"]
    assert any("update_rate 500" in note and "1000 Hz" in note for note in made.notes)
    assert exported(loop(tmp_path, PID, "sample_time = 1e-3\n"), made.text, name="arm").text == made.text
    assert (
        YAML(typ="safe").load(exported(loop(tmp_path, PID, "sample_time = 4e-3\n")).text)["controller_manager"]["ros__parameters"]["update_rate"]
        == 250
    )


def test_the_clamp_of_older_releases_is_set_where_the_file_has_it(tmp_path: Path) -> None:
    made = exported(loop(tmp_path, PID), OLD.replace("error_deadband: 0.5", "i_clamp: 1.0"), name="arm")
    gains = parameters(made.text, "arm")["gains"]
    assert gains["elbow_joint"]["i_clamp"] == 150.0 and "i_clamp" not in gains["wrist_1_joint"]


def test_a_namespace_is_looked_into(tmp_path: Path) -> None:
    inside = "/left:\n" + "".join(f"  {line}\n" for line in OLD.splitlines() if line)
    made = exported(loop(tmp_path, PID), inside, name="arm")
    assert YAML(typ="safe").load(made.text)["/left"]["arm"]["ros__parameters"]["gains"]["elbow_joint"]["p"] == 500.5
    assert law_table(made.text, JOINTS, "arm")[0]["kp"] == [900, 900, 500.5, 100, 100, 50]


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ('equation = "9.8"\nkp = [[9,1,0,0,0,0],[1,9,0,0,0,0],[0,0,9,0,0,0],[0,0,0,9,0,0],[0,0,0,0,9,0],[0,0,0,0,0,9]]', "not diagonal"),
        ('equation = "9.9"', "TorqueFeedforward"),
        ('equation = "9.16"\nkp = 100\nkd = 20', "TaskComputedTorque"),
        ('equation = "9.11"\nouter = {kp = 100, kd = 20}', "InverseDynamics"),
    ],
)
def test_laws_that_the_controllers_do_not_have_are_refused(tmp_path: Path, law: str, said: str) -> None:
    text = BASE.replace("LAW", law)
    if "9.16" in law:
        text = text.replace('kind = "Hold"', 'kind = "ToolHold"')
    with pytest.raises(Unsupported, match=said):
        exported(study(tmp_path, text).loops[0])


def test_another_command_interface_or_another_joint_is_refused(tmp_path: Path) -> None:
    one = loop(tmp_path, PID)
    with pytest.raises(BadArgument, match=r"command_interfaces.*'effort'"):
        exported(one, OLD.replace("[effort]", "[position]"), name="arm")
    with pytest.raises(UnknownName, match="joints: got 'elbow_joint'"):
        exported(one, OLD.replace("shoulder_lift_joint, elbow_joint", "shoulder_lift_joint, elbo_joint"), name="arm")
    with pytest.raises(BadArgument, match="YAML"):
        exported(one, "a: [1, 2")
    with pytest.raises(BadArgument, match="controller"):
        exported(one, "", "effort_controller")


def test_what_no_law_of_the_chapter_does_is_not_read(tmp_path: Path) -> None:
    text = exported(loop(tmp_path, PID)).text
    with pytest.raises(UnknownName, match="--name: got 'arm'"):
        law_table(text, JOINTS, "arm")
    with pytest.raises(UnknownName, match="gains: got 'joint_7'"):
        law_table(text, (*JOINTS, "joint_7"))
    with pytest.raises(Unsupported, match="command_interfaces"):
        law_table(text.replace("- effort", "- position"), JOINTS)
    with pytest.raises(Unsupported, match="p, i and a feedforward"):
        law_table(text.replace("- effort", "- velocity"), JOINTS)  # with kd
    with pytest.raises(BadArgument, match=r"elbow_joint.p"):
        law_table(text.replace("p: 500.5", "p: much"), JOINTS)


def test_only_the_law_of_a_study_is_replaced() -> None:
    text = BASE.replace("LAW", PID + "\n\n[law.gains]\nhelper = 1")
    new = with_law(text, {"name": "VelocityP", "kp": [1.0, 2.0]})
    assert new == BASE.replace("LAW", 'name = "VelocityP"\nkp = [1.0, 2.0]')
    with pytest.raises(BadArgument, match=r"one .law. table"):
        with_law("a = 1\n", {"name": "VelocityP"})
