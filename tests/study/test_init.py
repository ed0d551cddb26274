"""A study for a robot: it runs as it is, its first path keeps within the limits, and what does not move the tool is locked."""

from __future__ import annotations

import re
import tomllib
import warnings

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import robots
from mfc_analysis.errors import BadArgument
from mfc_analysis.study.check import check
from mfc_analysis.study.init import STRIDE, first_path, friction_rules, gripper, study_for, unmoving, write
from mfc_analysis.study.read import read
from mfc_analysis.trajectories import Quintic
from tests.conftest import arm
from tests.study.samples import URDF

EMBEDDED = ("ur5", "rp", "planar_2r", "single_joint", "slider")
TWO_LINKS = URDF.replace("{name}", "arm").replace("{joint}", "turn")
FINGER = """<joint name="f{0}" type="prismatic"><parent link="hand"/><child link="finger{0}"/><axis xyz="0 1 0"/>{1}
<limit lower="0" upper="0.04" effort="5" velocity="1"/></joint>
<link name="finger{0}"><inertial><mass value="0.01"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
MIMIC = TWO_LINKS.replace("</robot>", FINGER.format(1, "") + FINGER.format(2, '<mimic joint="f1"/>') + "</robot>")
ONE_JAW = TWO_LINKS.replace("</robot>", FINGER.format(1, "").replace('"f1"', '"gripper"') + "</robot>")
CARRIED = TWO_LINKS.replace(
    "</robot>",
    FINGER.format(1, "").replace('"f1"', '"gripper_base"') + FINGER.format(2, "").replace('parent link="hand"', 'parent link="finger1"') + "</robot>",
)
TWO_FINGERS = MIMIC.replace('<mimic joint="f1"/>', "")


def file(tmp_path, text: str, name: str = "arm.urdf"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


@pytest.mark.parametrize("robot", EMBEDDED)
def test_the_study_of_an_embedded_robot_is_met_as_it_is(tmp_path, robot):
    path = write(robot, tmp_path / "s.toml")
    (found,) = check(read(path))
    assert found.status == "PASS" and found.loop.loop.robot.name == robot


@pytest.mark.parametrize("robot", [*EMBEDDED, "panda", "kinova"])
def test_the_first_path_keeps_within_the_limits_at_half_their_speed(robot):
    body = getattr(mfc.robots, robot)() if robot in EMBEDDED else arm(robot)
    q0, q1, duration = first_path(body)
    ref, t = Quintic(q0, q1, duration)(np.linspace(0, duration, 401)), body.limits
    assert (ref.q >= t.lower).all() and (ref.q <= t.upper).all()
    assert (np.abs(ref.v) <= 0.5 * np.array(t.velocity) * (1 + 1e-9)).all()
    assert np.abs(q1 - q0).max() > 0.01 and (np.abs(q1 - q0) <= STRIDE + 1e-9).all() and duration >= 2.0


def test_what_moves_the_tool_in_no_way_is_locked(tmp_path):
    assert unmoving(file(tmp_path, MIMIC), "hand") == ("f1", "f2") == unmoving(file(tmp_path, TWO_FINGERS), "hand")
    assert unmoving(file(tmp_path, MIMIC), "finger1") == ("f2",)
    assert unmoving(file(tmp_path, MIMIC), None) == ("f2",) and unmoving(file(tmp_path, TWO_FINGERS), None) == ()
    assert unmoving(file(tmp_path, TWO_LINKS), "arm") == ("wrist",)


def test_a_study_with_locked_joints_names_them_and_runs(tmp_path):
    path = write(str(file(tmp_path, MIMIC)), tmp_path / "s.toml", "hand")
    assert tomllib.loads(path.read_text())["robot"]["locked"] == ["f1", "f2"]
    (found,) = check(read(path))
    assert found.status == "PASS" and found.loop.loop.robot.joint_names == ("turn", "wrist")


def test_a_tool_that_is_not_plain_is_asked_for_with_what_it_could_be(tmp_path):
    forked = TWO_FINGERS.replace('"finger', '"branch')
    with pytest.raises(BadArgument) as why:
        write(str(file(tmp_path, forked)), tmp_path / "s.toml")
    assert why.value.argument == "--tool" and "'branch1', 'branch2'" in why.value.takes and not (tmp_path / "s.toml").exists()


@pytest.mark.parametrize(("text", "joints"), [(MIMIC, "joint 3 (f1) and joint 4 (f2) look"), (ONE_JAW, "joint 3 (gripper) looks")])
def test_a_gripper_is_found_and_the_tool_asked_for(tmp_path, text, joints):
    path = file(tmp_path, text)
    with pytest.raises(BadArgument) as why:
        write(str(path), tmp_path / "s.toml")
    assert why.value.argument == "--tool" and not (tmp_path / "s.toml").exists()
    assert f"{joints} like a gripper; you may mean --tool hand" in why.value.takes
    for tool in ("hand", "finger1"):  # an answer is taken, the finger too
        assert read(write(str(path), tmp_path / "s.toml", tool, overwrite=True)).loops[0].loop.robot.tool == tool


def test_an_arm_without_fingers_has_no_gripper(tmp_path):
    assert gripper(file(tmp_path, TWO_LINKS)) is None and gripper(file(tmp_path, robots.catalogue.ur5_urdf())) is None
    assert gripper(file(tmp_path, TWO_LINKS.replace('"hand"', '"gripper"'))) is None  # the last link of the arm, by its name
    assert gripper(file(tmp_path, MIMIC)) == (((3, "f1"), (4, "f2")), "hand")
    assert gripper(file(tmp_path, CARRIED)).link == "hand"  # not the first link of the gripper itself


#: keys of the template that change what q_start means, or that need another law
OF_OTHERS = ("locked",)


@pytest.mark.parametrize("robot", ["ur5", "single_joint", "rp"])
def test_every_key_of_the_template_stands_where_it_can(tmp_path, robot):
    """Each commented key, without its comment mark and with the table it stands under, gives a study that can be read and built."""
    lines = write(robot, tmp_path / "s.toml").read_text().splitlines()
    keys, table = 0, None
    for i, line in enumerate(lines):
        if match := re.match(r"(# )?\[(\w+)\]", line):
            table = i if match[1] else None
        key = re.match(r"# (\w+) = ", line)
        if not key or key[1] in OF_OTHERS:
            continue
        keys += 1
        text = [x[2:] if j in (i, table) or (table is not None and re.match(r"# stiffness|# payload = \[", x) and j == table + 1) else x
                for j, x in enumerate(lines)]  # fmt: skip
        (tmp_path / "one.toml").write_text("\n".join(text))
        loop = read(tmp_path / "one.toml").loops[0]
        assert loop.loop.law is not None and loop.requirements is not None
    assert keys >= 15
    locked = [line for line in lines if line.startswith("# locked")]
    assert len(locked) == (robot != "single_joint") and all(f'"{arm_joints(robot)[-1]}"' in line for line in locked)


def arm_joints(robot):
    return getattr(mfc.robots, robot)().joint_names


def test_an_arm_without_rotor_inertia_has_that_beside_the_key_for_it(tmp_path):
    text = write("panda", tmp_path / "panda.toml").read_text()
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if "the URDF lacks rotor inertia; give armature" in line)
    assert lines[at].startswith("# panda: ") and "panda_joint" in lines[at] and lines[at + 1].startswith("# armature = 0.3")
    given = tmp_path / "given.toml"
    given.write_text(text.replace("# armature = 0.3", "armature = 0.3"))
    assert read(given).loops[0].loop.robot.armature.tolist() == [0.3] * 7
    plain = write("rp", tmp_path / "rp.toml").read_text()
    assert "# armature = 0.3" in plain and "lacks" not in plain


def test_a_file_that_is_there_is_kept_unless_it_may_be_overwritten(tmp_path):
    (tmp_path / "s.toml").write_text("mine")
    with pytest.raises(BadArgument) as why:
        write("ur5", tmp_path / "s.toml")
    assert why.value.argument == "--out" and (tmp_path / "s.toml").read_text() == "mine"
    assert write("ur5", tmp_path / "s.toml", overwrite=True).read_text() != "mine"


def test_a_urdf_is_named_relative_to_the_study_and_without_a_place_the_study_has_its_name(tmp_path, monkeypatch):
    file(tmp_path, TWO_LINKS, "my arm.urdf")
    deep = write(str(tmp_path / "my arm.urdf"), tmp_path / "a" / "b" / "s.toml")
    assert tomllib.loads(deep.read_text())["robot"]["urdf"] == "../../my arm.urdf"
    monkeypatch.chdir(tmp_path)
    assert write("my arm.urdf").name == "my arm.toml" and write("slider").name == "slider.toml"


def test_the_controller_leaves_friction_alone_where_it_outweighs_the_damping_of_the_gains():
    kd = float(mfc.gains.pid(bandwidth=mfc.hertz(10.0))["kd"])
    for share, rules in ((0.99, False), (1.01, True)):
        body = mfc.robots.single_joint(inertia=0.5, damping=share * kd * 0.5)
        assert friction_rules(body, np.zeros(1)) is rules
        said = tomllib.loads(study_for(body, 'name = "single_joint"', "s.toml"))
        assert said.get("controller_model") == ({"friction": "none"} if rules else None)


@pytest.mark.parametrize(("robot", "unit"), [("ur5", "[rad]"), ("slider", "[m]"), ("rp", "[rad, m]")])
def test_the_start_says_its_unit(robot, unit):
    text = study_for(getattr(mfc.robots, robot)(), f'name = "{robot}"', "s.toml")
    assert next(line for line in text.splitlines() if "Joint positions at the start" in line).endswith(f"{unit}.")


def test_names_that_would_break_out_of_a_comment_or_a_text_do_not():
    text = study_for(mfc.robots.slider(), 'name = "slider"', 'a\nb".toml', ['f"1', "f\n2"])
    said = tomllib.loads(text)
    assert said["robot"]["locked"] == ['f"1', "f\n2"] and "mfc-analysis check a?b" in text


def test_the_first_path_of_joints_without_limits_is_computed_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for robot in (robots.single_joint(), robots.planar_2r(), robots.rp()):
            q0, q1, duration = first_path(robot)
            assert np.isfinite(q0).all() and np.isfinite(q1).all() and duration == 2.0
