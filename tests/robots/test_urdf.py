from __future__ import annotations

import pytest

from mfc_analysis import errors
from mfc_analysis.robots.robot import Robot
from mfc_analysis.robots.urdf import checked_urdf, read_urdf
from tests.robots.arms import FORK, TWO, joint, link, robot


@pytest.mark.parametrize("source", ["no_such_file.urdf", "", "a\0b", "\ud800.urdf", 3, None, b"<robot/>", ["arm.urdf"]])
def test_what_is_neither_a_file_nor_xml_is_refused(source):
    with pytest.raises(errors.BadArgument, match="source"):
        read_urdf(source)


def test_a_folder_is_not_a_urdf(tmp_path):
    with pytest.raises(errors.BadArgument, match="source"):
        read_urdf(tmp_path)


def test_a_path_and_its_text_give_the_same_robot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("\ufeff" + TWO, encoding="utf-8")
    for source in (path, str(path), "\n  " + TWO):
        assert Robot.from_urdf(source).joint_names == ("j1", "j2")


def test_a_binary_file_is_not_a_urdf(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_bytes(b"\x7fELF\xff\xfe\x00\x01")
    with pytest.raises(errors.BadRobot, match="not text"):
        Robot.from_urdf(path)


BAD = {
    "is not XML": "<robot name='x'><link></robot>",
    "root element is <sdf>": "<sdf/>",
    "xacro": '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="y"/></robot>',
    "has no link": "<robot name='x'/>",
    "no joint that moves": "<robot name='x'><link name='base'/></robot>",
    "link without a name": "<robot name='x'><link/></robot>",
    "more than one link named 'base'": robot(link("base")),
    "more than one joint named 'j1'": robot(link("a"), link("b"), joint("j1", "base", "a"), joint("j1", "a", "b")),
    "its child link 'b' is not in the URDF": robot(link("a"), joint("j1", "base", "b")),
    "child of more than one joint": robot(link("a"), joint("j1", "base", "a"), joint("j2", "base", "a")),
    "exactly one root link and has 2": robot(link("a"), link("b"), joint("j1", "base", "a")),
    "not connected to the root: a, b": robot(link("a"), link("b"), joint("j1", "a", "b"), joint("j2", "b", "a")),
    "type 'floating'": robot(link("a"), joint("j1", "base", "a", "floating")),
    "type 'planar'": robot(link("a"), joint("j1", "base", "a", "planar")),
    "mass value='heavy' is not a finite number": robot(link("a", "heavy"), joint("j1", "base", "a")),
    "mass value='nan' is not a finite number": robot(link("a", "nan"), joint("j1", "base", "a")),
    "its mass -1 kg is negative": robot(link("a", -1), joint("j1", "base", "a")),
    "its damping -2 is negative": robot(link("a"), joint("j1", "base", "a", damping=-2)),
    "its axis is zero": robot(link("a"), joint("j1", "base", "a")).replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"'),
    "axis xyz='0 1' is not 3 finite numbers": robot(link("a"), joint("j1", "base", "a")).replace('axis xyz="0 0 1"', 'axis xyz="0 1"'),
    "needs a <limit> with effort and velocity; limit is missing": robot(link("a"), joint("j1", "base", "a")).replace("limit", "limits"),
    "effort is missing": robot(link("a"), joint("j1", "base", "a")).replace("effort", "force"),
    "<inertial> has no <mass>": robot(link("a"), joint("j1", "base", "a")).replace('<mass value="1.0"/>', ""),
    "<inertia> has no iyz": robot(link("a"), joint("j1", "base", "a")).replace('iyz="0" ', ""),
}


@pytest.mark.parametrize("says", BAD)
def test_a_bad_urdf_is_refused_in_our_words(says, capfd):
    with pytest.raises(errors.BadRobot) as info:
        Robot.from_urdf(BAD[says], tool="a")
    assert says in str(info.value)
    assert capfd.readouterr().err == ""  # nothing of the parser's own


def test_meshes_materials_and_simulator_tags_are_left_out():
    extra = TWO.replace("</robot>", "<gazebo reference='one'><oops/></gazebo><transmission name='t'/></robot>").replace(
        '<link name="one">', '<link name="one"><visual><geometry><mesh filename="package://nowhere/x.dae"/></geometry></visual>'
    )
    read = checked_urdf(extra)
    assert "mesh" not in read.text and "gazebo" not in read.text and read.mimic == ()


def test_moving_joints_are_those_that_are_not_fixed():
    assert checked_urdf(FORK).moving == ("j1", "jl", "jr")
    assert checked_urdf(FORK.replace('name="jr" type="revolute"', 'name="jr" type="fixed"')).moving == ("j1", "jl")


def test_a_mimic_joint_is_refused_until_it_is_locked():
    text = FORK.replace("</joint></robot>", '<mimic joint="jl"/></joint></robot>')
    with pytest.raises(errors.BadRobot, match=r"'jr' mimics another one.*locked=\['jr'\]"):
        Robot.from_urdf(text, tool="left")
    assert Robot.from_urdf(text, tool="left", locked=["jr"]).joint_names == ("j1", "jl")
