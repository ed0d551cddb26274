"""Robots from MJCF, against MuJoCo: M and h to 1e-9; and what Pinocchio would read otherwise is refused."""

from __future__ import annotations

import importlib.util
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import robots
from mfc_analysis.errors import BadArgument, BadRobot, MfcWarning, UnknownName
from mfc_analysis.robots.catalogue import ur5_urdf
from mfc_analysis.robots.mjcf import checked_mjcf
from mfc_analysis.robots.robot import Robot

there = importlib.util.find_spec("mujoco") is not None or bool(os.environ.get("CI"))
with_mujoco = pytest.mark.skipif(not there, reason="mujoco is not installed")

ARM = """<mujoco model="three"><compiler {compiler}/><option gravity="{gravity}"/>
<asset><mesh name="m" file="none.stl"/><material name="grey" rgba="1 1 1 1"/></asset>
<default><joint damping="0.3" armature="0.05"/><default class="fast"><joint damping="0.7"/></default></default>
<worldbody><light pos="0 0 1"/><geom type="plane" size="1 1 .1"/>
<body name="link1" pos="0 0 0.3"><joint name="j1" axis="0 0 1" {range}/>
<inertial pos="0.1 0 0" mass="2" fullinertia="0.02 0.02 0.03 0.001 0.002 0.0005"/><geom type="mesh" mesh="m" material="grey"/>
<body name="link2" pos="0.3 0 0" euler="{euler}"><joint name="j2" class="fast" axis="0 1 0" pos="0.01 0.02 0"/>{solid}
<body name="link3" pos="0.2 0 0.1" quat="1 0.2 0.1 0.3"><joint name="j3" type="slide" axis="1 0 1"/>
<geom type="box" size=".05 .03 .02" density="800"/>
<site name="tcp" pos="0.05 0 0.1"/></body></body></body>
<body name="table"><geom type="box" size="1 1 .1"/></body></worldbody></mujoco>"""
USUAL = {
    "compiler": 'angle="radian"',
    "gravity": "0 0 -9.81",
    "range": 'range="-2 1.5" actuatorfrcrange="-30 30"',
    "euler": "0.1 0.2 0.3",
    "solid": '<geom type="capsule" size="0.03 0.1" mass="1.2"/>',
}


def arm(**changes: str) -> str:
    return ARM.format(**USUAL | changes)


MESH = '<geom type="mesh" mesh="m" material="grey"/>'
SEVERAL = '<geom type="ellipsoid" size=".1 .2 .3"/><geom type="cylinder" fromto="0 0 0 .3 .2 .1" size=".02"/><geom size=".05"/>'
FRAMES = """<frame pos="0.1 0 0" euler="0.3 0 0"><geom size=".05" pos="0 0.1 0"/><frame euler="0 0.2 0"><body name="b"><joint name="j4" axis="0 1 0"/>
<geom size=".1" pos="0.2 0 0"/></body></frame></frame><frame/>"""
VARIANTS = {
    "as it is": arm(),
    "another gravity": arm(gravity="0.5 1 -3"),
    "degrees and another order of angles": arm(compiler='eulerseq="zyx"', euler="10 20 30", range='range="-90 45"'),
    "inertias from geoms": arm(compiler='angle="radian" inertiafromgeom="true"').replace(MESH, '<geom size=".1"/>'),
    "several solids": arm(solid=SEVERAL),
    "frames": arm().replace(MESH, MESH + FRAMES),  # of their geoms those of a body with an <inertial> do not count
    "frames that count": arm(solid='<geom size=".1"/>' + FRAMES),
    "a frame about the robot": arm()
    .replace('<body name="link1"', '<frame pos="1 0 0" euler="0 0.4 0"><body name="link1"')
    .replace('<body name="table"', '</frame><body name="table"'),
}


def in_mujoco(text: str) -> tuple[Any, Any, Any]:
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = mujoco.MjModel.from_xml_string(text)
    return mujoco, model, mujoco.MjData(model)


def dynamics(text: str, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M (n, n) and h (n,) of MuJoCo."""
    mujoco, model, data = in_mujoco(text)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    for j, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, M[j], unit)
    return M, np.array(data.qfrc_bias)


@with_mujoco
@pytest.mark.parametrize("name", VARIANTS)
def test_mass_and_bias_are_mujocos(name: str) -> None:
    text = VARIANTS[name].replace(MESH, "")  # MuJoCo opens the mesh
    text = text.replace('<mesh name="m" file="none.stl"/>', "")
    robot = Robot.from_mjcf(VARIANTS[name], tool="tcp")
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v = rng.uniform(-1.5, 1.5, (2, robot.n))
        M, h = dynamics(text, q, v)
        assert_allclose(robot.mass(q), M, atol=1e-9)
        assert_allclose(robot.bias(q, v), h, atol=1e-9)


@with_mujoco
def test_the_ur5_that_mujoco_writes_is_the_ur5(tmp_path: Path) -> None:
    """URDF into MuJoCo, MJCF out of it, and back: the dynamics of the URDF."""
    mujoco, model, _ = in_mujoco(ur5_urdf())
    mujoco.mj_saveLastXML(str(tmp_path / "ur5.xml"), model)
    robot, ours = Robot.from_mjcf(tmp_path / "ur5.xml", gravity=(0, 0, -9.81)), robots.ur5()
    q, v = np.random.default_rng(1).uniform(-2, 2, (2, 6))
    assert robot.joint_names == ours.joint_names
    assert_allclose(robot.mass(q), ours.mass(q), atol=1e-5)  # six digits in MuJoCo's file
    M, h = dynamics((tmp_path / "ur5.xml").read_text(encoding="utf-8"), q, v)
    assert_allclose(robot.mass(q), M, atol=1e-9)
    assert_allclose(robot.with_friction(viscous=0).bias(q, v), robot.bias(q, v), rtol=0)
    assert_allclose(robot.gravity(q), dynamics((tmp_path / "ur5.xml").read_text(encoding="utf-8"), q, 0 * v)[1], atol=1e-9)
    assert h.shape == (6,)


def test_names_limits_friction_armature_and_tool_are_read(tmp_path: Path) -> None:
    robot = Robot.from_mjcf(arm())
    assert (robot.name, robot.tool, robot.joint_names, robot.joint_units) == ("three", "link3", ("j1", "j2", "j3"), ("rad", "rad", "m"))
    assert_allclose(robot.viscous, [0.3, 0.7, 0.3])
    assert_allclose(robot.armature, 0.05)
    assert_allclose([robot.limits.lower[0], robot.limits.upper[0], robot.limits.torque[0]], [-2, 1.5, 30])
    assert np.isinf(robot.limits.velocity).all()
    assert_allclose(robot.gravity(np.zeros(3)), Robot.from_mjcf(arm(gravity="0 0 -4.905")).gravity(np.zeros(3)) * 2)
    assert_allclose(Robot.from_mjcf(arm(), gravity=(0, 0, 0)).gravity(np.ones(3)), 0)
    assert not Robot.from_mjcf(arm(), friction="none").viscous.any()
    tcp = Robot.from_mjcf(arm(), tool="tcp")
    assert_allclose(np.linalg.inv(robot.pose(np.ones(3))) @ tcp.pose(np.ones(3)) @ [0, 0, 0, 1], [0.05, 0, 0.1, 1], atol=1e-12)
    assert Robot.from_mjcf(arm(), locked={"j1": 0.3}, joints=["j3", "j2"]).joint_names == ("j3", "j2")
    (tmp_path / "a.xml").write_text(arm(), encoding="utf-8")
    assert Robot.from_mjcf(tmp_path / "a.xml").origin is not None
    assert_allclose(Robot.from_mjcf(str(tmp_path / "a.xml")).mass(np.ones(3)), robot.mass(np.ones(3)))


@with_mujoco
def test_where_the_base_stands_is_read(tmp_path: Path) -> None:
    text = (
        BODY.format(**SOLID)
        .replace('<body name="b">', '<body name="base" pos="1 2 3" euler="0 40 0"><body name="b" pos="0 0 1">')
        .replace("</body>", "</body></body>")
    )
    robot = Robot.from_mjcf(text)
    mujoco, model, data = in_mujoco(text)
    data.qpos[:] = 0.3
    mujoco.mj_forward(model, data)
    X = robot.pose(np.array([0.3]))
    assert_allclose(X[:3, 3], data.body("b").xpos, atol=1e-12)
    assert_allclose(X[:3, :3].ravel(), data.body("b").xmat, atol=1e-12)


def test_files_that_are_included_are_read_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.xml").write_text(arm(), encoding="utf-8")
    (tmp_path / "scene.xml").write_text('<mujoco model="scene"><include file="parts/arm.xml"/></mujoco>', encoding="utf-8")
    assert_allclose(Robot.from_mjcf(tmp_path / "scene.xml").mass(np.ones(3)), Robot.from_mjcf(arm()).mass(np.ones(3)))
    (tmp_path / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>', encoding="utf-8")
    with pytest.raises(BadRobot, match="too deeply"):
        checked_mjcf(tmp_path / "loop.xml")
    with pytest.raises(BadRobot, match="given as text"):
        checked_mjcf('<mujoco><include file="parts/arm.xml"/></mujoco>')


BODY = '<mujoco>{head}<worldbody><body name="b"><joint name="j" axis="0 1 0" {j}/>{i}</body>{more}</worldbody>{tail}</mujoco>'
SOLID = {"head": "", "j": "", "i": '<geom size=".1" mass="1" pos=".2 0 0"/>', "more": "", "tail": ""}
BAD = {
    "is not XML": "<mujoco>",
    "root element is <robot>": "<robot/>",
    "exactly one body in the world that has joints, and has 0": "<mujoco/>",
    "has 2: 'b', 'c'": BODY.format(**SOLID | {"more": '<body name="c"><joint/><geom size=".1"/></body>'}),
    "settotalmass='5'": BODY.format(**SOLID | {"head": '<compiler settotalmass="5"/>'}),
    "boundmass='1'": BODY.format(**SOLID | {"head": '<compiler boundmass="1"/>'}),
    "balanceinertia='true'": BODY.format(**SOLID | {"head": '<compiler balanceinertia="true"/>'}),
    "inertiagrouprange='0 1'": BODY.format(**SOLID | {"head": '<compiler inertiagrouprange="0 1"/>'}),
    "<replicate> in its world": BODY.format(**SOLID | {"more": "<replicate/>"}),
    "a <frame> with a joint": BODY.format(**SOLID | {"i": '<frame><joint name="k"/></frame><geom size=".1"/>'}),
    "body 'b' has no <inertial> and a geom of type mesh": BODY.format(**SOLID | {"i": '<geom type="mesh" mesh="m"/>'}),
    "a geom of type hfield": BODY.format(**SOLID | {"i": '<geom type="hfield" hfield="m"/>'}),
    "shellinertia": BODY.format(**SOLID | {"i": '<geom size=".1" shellinertia="true"/>'}),
    "its <inertial> has no mass": BODY.format(**SOLID | {"i": '<inertial pos="0 0 0" diaginertia="1 1 1"/>'}),
    "no diaginertia or fullinertia": BODY.format(**SOLID | {"i": '<inertial pos="0 0 0" mass="1"/>'}),
    "gravity 'down'": BODY.format(**SOLID | {"head": '<option gravity="down"/>'}),
    "moves no mass": BODY.format(**SOLID | {"i": ""}),
    "6 degrees of freedom": BODY.format(**SOLID).replace('<joint name="j" axis="0 1 0" />', "<freejoint/>"),
    "2 degrees of freedom": BODY.format(**SOLID | {"i": '<joint axis="1 0 0"/><geom size=".1" mass="1" pos=".2 0 .1"/>'}),
    "Pinocchio cannot build": BODY.format(**SOLID | {"i": '<inertial pos="0 0 0" mass="much" diaginertia="1 1 1"/>'}),
}


@pytest.mark.parametrize("said", BAD)
def test_what_would_be_read_wrongly_is_refused_by_name(said: str) -> None:
    with pytest.raises(BadRobot) as why:
        Robot.from_mjcf(BAD[said])
    assert said in str(why.value) and "hxx" not in str(why.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"j": 'stiffness="10"'}, "the joint stiffness"),
        ({"tail": '<equality><joint joint1="j" polycoef="0 0 0 0 0"/></equality>'}, "<equality>"),
        ({"head": '<default><joint stiffness="2"/></default>'}, "the joint stiffness"),
    ],
)
def test_what_acts_in_mujoco_and_is_not_read_is_said(change: dict[str, str], said: str) -> None:
    with pytest.warns(MfcWarning, match=said):
        Robot.from_mjcf(BODY.format(**SOLID | change))


def test_arguments_are_checked_as_those_of_a_urdf(tmp_path: Path) -> None:
    with pytest.raises(BadArgument, match="source"):
        Robot.from_mjcf(tmp_path / "none.xml")
    with pytest.raises(BadArgument, match="source"):
        Robot.from_mjcf(3)  # type: ignore[arg-type]
    with pytest.raises(UnknownName, match="tool"):
        Robot.from_mjcf(arm(), tool="no")
    with pytest.raises(UnknownName, match="locked"):
        Robot.from_mjcf(arm(), locked=["no"])
    with pytest.raises(BadArgument, match="friction"):
        Robot.from_mjcf(arm(), friction="urdf")  # type: ignore[arg-type]


ACTUATED = """<mujoco><default><position kp="10"/><default class="big"><position forcerange="-150 150"/>
<default class="bigger"><position kp="20"/></default>
</default><default class="small"><position forcerange="-28 20"/></default></default><worldbody>{bodies}</worldbody><actuator>
<position class="bigger" joint="j0"/><position class="small" joint="j1" gear="2"/><motor joint="j2" ctrlrange="-1 1" gear="-50"/><motor joint="j3"/>
<position class="big" joint="j4" forcerange="-7 7"/><position class="big" joint="j5"/></actuator></mujoco>"""


@with_mujoco
def test_torque_limits_are_those_of_the_actuators() -> None:
    bodies = ""
    for k in reversed(range(6)):
        own = 'actuatorfrcrange="-3 3"' if k == 5 else ""
        bodies = (
            f'<body name="b{k}" pos="0 0 .2"><joint name="j{k}" axis="{k % 2} 1 0" {own}/><geom size=".05" mass="1" pos=".1 0 0"/>{bodies}</body>'
        )
    text = ACTUATED.format(bodies=bodies)
    found = Robot.from_mjcf(text).limits.torque
    assert_allclose(found, [150, 56, 50, np.inf, 7, 3])
    _, model, _ = in_mujoco(text)
    of_force = np.abs(model.actuator_forcerange).max(axis=1) * np.abs(model.actuator_gear[:, 0])
    assert_allclose(found[[0, 1, 4]], of_force[[0, 1, 4]])
