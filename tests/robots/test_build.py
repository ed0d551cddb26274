from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis import errors
from mfc_analysis.robots import build
from mfc_analysis.robots.robot import Robot
from tests.robots.arms import CONTINUOUS, FORK, TWO, joint, link, robot


def test_a_locked_joint_is_welded_at_its_value():
    whole, part = Robot.from_urdf(TWO), Robot.from_urdf(TWO, locked={"j2": 0.4})
    assert part.joint_names == ("j1",) and part.tool == "two"
    assert_allclose(part.mass([0.3]), whole.mass([0.3, 0.4])[:1, :1], rtol=1e-14)
    assert_allclose(part.pose([0.3]), whole.pose([0.3, 0.4]), atol=1e-15)
    assert_array_equal(part.viscous, [0.3])


def test_a_continuous_joint_is_locked_at_an_angle():
    whole, part = Robot.from_urdf(CONTINUOUS), Robot.from_urdf(CONTINUOUS, locked={"j1": 2.5})
    assert_allclose(part.pose([0.2]), whole.pose([2.5, 0.2]), atol=1e-15)


def test_a_name_alone_locks_at_zero_and_may_be_a_single_string():
    for locked in ("j2", ["j2"], ("j2",), {"j2"}, {"j2": 0}):
        assert_allclose(Robot.from_urdf(TWO, locked=locked).pose([0.3]), Robot.from_urdf(TWO).pose([0.3, 0.0]), atol=1e-15)


def test_a_joint_that_shares_its_name_with_a_link_can_be_locked():
    text = robot(link("one"), link("hand"), link("jaw"), joint("j1", "base", "one"), joint("arm", "one", "hand"), joint("hand", "hand", "jaw"))
    part = Robot.from_urdf(text, tool="hand", locked=["hand"])
    assert part.joint_names == ("j1", "arm")
    assert_allclose(part.pose([0.1, 0.2]), Robot.from_urdf(text, tool="hand").pose([0.1, 0.2, 0.9]), atol=1e-15)
    assert [f.name for f in part.model.frames].count("hand") == 2


def test_a_link_and_not_the_joint_is_meant_where_they_share_a_name():
    text = robot(link("one"), link("hand"), joint("hand", "base", "one"), joint("j2", "one", "hand"))
    both = Robot.from_urdf(text, tool="hand")
    assert both.model.frames[both.frame_id].type == pin.FrameType.BODY
    assert_allclose(both.pose([0.0, 0.0])[:3, 3], [1.0, 0, 0])


@pytest.mark.parametrize(
    ("locked", "error"),
    [(["j9"], errors.UnknownName), ({"j1": np.nan}, errors.BadArgument), (3, errors.BadArgument), ({"j1": "x"}, errors.BadArgument)],
)
def test_bad_locks_are_refused(locked, error):
    with pytest.raises(error, match="locked"):
        Robot.from_urdf(TWO, locked=locked)


def test_locking_every_joint_leaves_no_robot():
    with pytest.raises(errors.BadRobot, match="no joint that moves"):
        Robot.from_urdf(TWO, locked=["j1", "j2"])


def test_a_free_flyer_is_refused_by_name():
    model = pin.buildModelFromXML(TWO, pin.JointModelFreeFlyer())
    with pytest.raises(errors.BadRobot, match=r"'root_joint' \(FreeFlyer\) has 6 degrees of freedom"):
        Robot.from_pinocchio(model, tool="two")


def test_a_spherical_joint_is_refused_by_name():
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(errors.BadRobot, match="'ball'"):
        Robot.from_pinocchio(model)


def test_pinocchios_own_mimic_joint_is_refused_by_name():
    text = FORK.replace("</joint></robot>", '<mimic joint="jl"/></joint></robot>')
    model = pin.buildModelFromXML(text, True)
    with pytest.raises(errors.BadRobot, match="'jr' mimics"):
        Robot.from_pinocchio(model, tool="left")


def test_a_link_without_mass_is_refused_by_the_joint_that_moves_it():
    with pytest.raises(errors.BadRobot, match="'j2' moves no mass"):
        Robot.from_urdf(TWO.replace(link("two"), '<link name="two"/>'))
    with pytest.raises(errors.BadRobot, match="'j1' moves no mass"):
        Robot.from_urdf(robot('<link name="a"/>', joint("j1", "base", "a")))


def test_a_massless_link_between_others_is_no_harm():
    text = robot('<link name="one"/>', link("two"), joint("j1", "base", "one"), joint("j2", "one", "two"))
    assert np.linalg.eigvalsh(Robot.from_urdf(text).mass([0.1, 0.2]))[0] > 0


def test_two_joints_that_share_all_their_mass_are_singular():
    text = robot('<link name="one"/>', link("two"), joint("j1", "base", "one"), joint("j2", "one", "two").replace("0.5 0 0", "0 0 0"))
    with pytest.raises(errors.BadRobot, match="not positive definite"):
        Robot.from_urdf(text)


def test_an_inertia_that_is_negative_is_refused():
    negative = robot(link("a"), joint("j1", "base", "a")).replace('izz="0.02"', 'izz="-1"')
    with pytest.raises(errors.BadRobot, match=r"effective inertia is -0.96"):
        Robot.from_pinocchio(pin.buildModelFromXML(negative))
    with pytest.raises(errors.BadRobot, match=r"link 'a': its inertia has a negative principal moment, -1 kg m\^2"):
        Robot.from_urdf(negative)
    with pytest.raises(errors.BadRobot, match=r"link 'two': .* negative principal moment, -0.0352 kg m\^2"):  # 0.015 - sqrt(0.005^2 + 0.05^2)
        Robot.from_urdf(robot(link("one"), joint("j1", "base", "one"), link("two").replace('ixy="0"', 'ixy="0.05"'), joint("j2", "one", "two")))
    model = pin.buildModelFromXML(TWO)
    model.inertias[1] = pin.Inertia(np.nan, np.zeros(3), np.eye(3))
    with pytest.raises(errors.BadRobot, match="not finite"):
        Robot.from_pinocchio(model)


def test_numbers_whose_mass_matrix_overflows_are_refused():
    for text in (TWO.replace('value="1.0"', 'value="1e308"'), TWO.replace('xyz="0.2 0 0"', 'xyz="1e200 0 0"')):
        with pytest.raises(errors.BadRobot, match="not finite"):
            Robot.from_urdf(text)


def test_an_inertia_above_the_triangle_inequality_warns_of_its_link():
    def arm(izz):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = Robot.from_urdf(
                robot(link("one"), joint("j1", "base", "one"), link("two").replace('izz="0.02"', f'izz="{izz}"'), joint("j2", "one", "two"))
            )
        return found, [str(one.message) for one in said]

    for plate in (0.03, 0.03002):  # ixx + iyy = 0.03; the second is above by less than what three digits tell
        assert arm(plate)[1] == []
    assert "link 'two': its principal moments of inertia 0.01, 0.02, 0.0301 kg m^2 are not possible" in arm(0.03006)[1][0]
    found, said = arm(0.5)
    assert len(said) == 1 and found.mass([0.0, 0.0])[1, 1] == pytest.approx(0.5 + 0.2**2)


def test_an_inertia_without_effect_is_not_judged_and_a_point_mass_is_a_body():
    bad = link("hand").replace('izz="0.02"', 'izz="-1"')
    text = robot(link("one"), joint("j1", "base", "one"), bad, joint("j2", "base", "hand"))
    assert Robot.from_urdf(text, tool="one", locked=["j2"]).mass([0.0])[0, 0] == pytest.approx(0.02 + 0.2**2)
    with pytest.raises(errors.BadRobot, match="link 'hand'"):
        Robot.from_urdf(text, tool="one")
    with pytest.raises(errors.BadRobot, match="link 'hand'"):  # fixed to a link that moves
        Robot.from_urdf(text.replace('<joint name="j2" type="revolute"><parent link="base"/>', '<joint name="j2" type="fixed"><parent link="one"/>'))
    point = TWO.replace('ixx="0.01"', 'ixx="0"').replace('"0.02"', '"0"')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Robot.from_urdf(point).mass([0.0, 0.0])[1, 1] == pytest.approx(0.2**2)


def test_a_model_with_two_joints_of_one_name_is_refused():
    model = pin.buildModelFromXML(TWO)
    model.names[2] = "j1"
    with pytest.raises(errors.BadRobot, match="more than one joint named 'j1'"):
        Robot.from_pinocchio(model, tool="two")


def test_the_default_tool_is_the_last_link_and_else_the_choices_are_listed():
    assert Robot.from_urdf(TWO).tool == "two"
    with pytest.raises(errors.BadArgument, match=r"tool.*'left', 'right'"):
        Robot.from_urdf(FORK)
    assert Robot.from_urdf(FORK, locked=["jr"], tool="left").n == 2


def test_an_unknown_tool_lists_the_frames_and_the_nearest():
    with pytest.raises(errors.UnknownName, match="did you mean 'two'") as info:
        Robot.from_urdf(TWO, tool="tow")
    assert info.value.argument == "tool" and set(info.value.known) == {"base", "j1", "one", "j2", "two"}
    for tool in ("base", "universe", 3):
        with pytest.raises(errors.BadArgument, match="tool"):
            Robot.from_urdf(TWO, tool=tool)


def test_the_order_of_joints_is_the_users():
    model = pin.buildModelFromXML(FORK)
    assert_array_equal(build.joint_order(model, None), [0, 1, 2])
    assert_array_equal(build.joint_order(model, ["jr", "j1", "jl"]), [2, 0, 1])


@pytest.mark.parametrize("joints", [["j1"], ["j1", "j1"], ["j1", "j9"], "j1", 3, ["j1", "j2", "j1"]])
def test_a_bad_order_of_joints_is_refused(joints):
    with pytest.raises(errors.BadArgument, match="joints"):
        Robot.from_urdf(TWO, joints=joints)
