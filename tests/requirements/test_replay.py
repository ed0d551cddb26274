"""Replay code runs and gives the same loop again, or says what it cannot give."""

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.requirements.replay import replay

Q = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])


def rerun(code: str) -> dict:
    names: dict = {}
    exec(code, names)
    return names


def loops():
    joint, ur5 = mfc.robots.single_joint(inertia=0.7, mass=2.0, com_distance=0.15, damping=0.3), mfc.robots.ur5()
    hold, X = mfc.trajectories.Hold([0.3]), ur5.pose(Q)
    laws, tr = mfc.laws, mfc.trajectories
    surface = mfc.Environment(np.array([1e3, 2e3]), damping=3.0, axes="xz", preload=[0.0, 5.0])
    return {
        "joint": mfc.ClosedLoop(joint, laws.JointPID(40.0, 5.0, 4.0), hold),
        "payload and friction": mfc.ClosedLoop(
            joint.with_payload(0.5, com=(0, 0.01, 0.02), inertia=0.01).with_friction(0.4, coulomb=0.1),
            laws.JointPID(40.0, kd=4.0),
            hold,
            controller_model=joint,
        ),
        "scaled, armature": mfc.ClosedLoop(
            ur5.with_inertia_scaled(1.2).with_armature(0.1), laws.ComputedTorque(100.0, kd=np.arange(1.0, 7.0)), tr.Hold(Q)
        ),
        "slider in contact": mfc.ClosedLoop(
            mfc.robots.slider(mass=2.5, friction=0.3),
            laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kdamp=20.0),
            tr.Hold([0.0]),
            environment=mfc.Environment(1e3, preload=5.0),
            hardware=mfc.Hardware(torque_lag=5e-3),
        ),
        "outer LTI": mfc.ClosedLoop(ur5, laws.InverseDynamics(control.tf([20.0, 100.0], [0.01, 1.0])), tr.Sinusoid(Q, np.full(6, 0.1), 2.0)),
        "outer PID": mfc.ClosedLoop(ur5, laws.InverseDynamics({"kp": 100.0, "kd": 20.0}), tr.Waypoints([0.0, 1.0, 2.0], [Q, Q + 0.1, Q])),
        "tool": mfc.ClosedLoop(
            ur5.with_payload(1.0),
            laws.TaskComputedTorque(100.0, kd=20.0, form="printed"),
            tr.ToolCircle(X, 0.05, 2.0),
            q_start=Q,
            controller_model=ur5,
        ),
        "redundant": mfc.ClosedLoop(
            mfc.robots.load("panda"),
            laws.TaskComputedTorque(100.0, kd=20.0, null_damping=3.0, inverse="euclidean"),
            tr.Hold([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]),
        ),
        "hybrid": mfc.ClosedLoop(
            ur5,
            laws.HybridMotionForce([0, 0, 5, 0, 0, 0], kp=100.0, kd=20.0, kfp=1.0, kdamp=30.0, constraints=np.eye(6)[2:3]),
            tr.ToolHold(X),
            q_start=Q,
            environment=[surface, mfc.Environment(500.0, axes="z")],
        ),
        "impedance": mfc.ClosedLoop(
            ur5, laws.Impedance(np.full(6, 300.0), 30.0, inertia=2.0, F_d=[0, 0, 5, 0, 0, 0]), tr.Hold(Q), environment=surface
        ),
        "plain impedance": mfc.ClosedLoop(ur5, laws.Impedance(300.0, 30.0, feedforward=False), tr.Hold(Q)),
        "admittance behind a servo": mfc.ClosedLoop(
            ur5,
            laws.Admittance([0, 0, 5, 0, 0, 0], inertia=4.0, damping=300.0, stiffness=[200.0, 200, 0, 20, 20, 20]),
            tr.Hold(Q),
            environment=surface,
            hardware=mfc.Hardware(servo=mfc.Servo(50.0, np.linspace(0.6, 0.9, 6), 0.01), force_deadband=0.5, velocity_limit=np.ones(6)),
        ),
        "planar": mfc.ClosedLoop(mfc.robots.planar_2r(), laws.TorqueFeedforward(form="printed"), tr.Quintic([0.1, 0.2], [0.5, 0.4], 1.0)),
    }


@pytest.mark.parametrize("name", loops())
def test_the_snippet_gives_the_same_linear_loop(name):
    loop, times = loops()[name], np.linspace(0.0, 0.5, 3)
    said = replay(loop, times, "A = loop.linearize(times).A")
    assert said.missing == ()
    A = loop.linearize(times).A
    assert_allclose(rerun(said.code)["A"], A, rtol=1e-9, atol=1e-9 * np.abs(A).max())


def test_a_robot_of_ones_own_is_named_as_what_is_missing():
    robot = mfc.Robot.from_urdf(mfc.robots.catalogue.ur5_urdf().replace("8.393", "8.4"), tool="tool0")
    said = replay(mfc.ClosedLoop(robot, mfc.laws.JointPID(40.0, kd=5.0), mfc.trajectories.Hold(Q)), [0.0])
    assert len(said.missing) == 1 and said.missing[0].startswith("robot:")
    assert "to fill in: robot" in str(said) and "robot = ..." in said.code


def test_a_path_too_long_to_print_is_named_as_what_is_missing():
    t = np.linspace(0, 1, 200)
    ref = mfc.trajectories.Waypoints(t, np.sin(t)[:, None] * np.ones(6))
    said = replay(mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.JointPID(40.0, kd=5.0), ref), [0.0])
    assert any("(200, 6)" in what for what in said.missing)


def test_a_robot_of_a_file_is_read_from_it_again(tmp_path, monkeypatch):
    (tmp_path / "arm.urdf").write_text(mfc.robots.catalogue.ur5_urdf().replace("8.393", "8.4"))
    monkeypatch.chdir(tmp_path)
    robot = mfc.Robot.from_urdf(tmp_path / "arm.urdf", tool="tool0", locked=["wrist_3_joint"]).with_payload(1.5)
    loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(40.0, kd=5.0), mfc.trajectories.Hold(Q[:5]))
    said = replay(loop, [0.0], "A = loop.linearize(times).A")
    assert said.missing == ()
    assert "mfc.Robot.from_urdf('arm.urdf', tool='tool0', locked=['wrist_3_joint']).with_payload(1.5)" in said.code
    assert_allclose(rerun(said.code)["A"], loop.linearize([0.0]).A, rtol=1e-9)


def test_a_file_that_has_changed_since_is_not_claimed_to_be_the_robot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(mfc.robots.catalogue.ur5_urdf())
    robot = mfc.Robot.from_urdf(path, tool="tool0")
    path.write_text(mfc.robots.catalogue.ur5_urdf().replace("2.275", "2.3"))
    said = replay(mfc.ClosedLoop(robot, mfc.laws.JointPID(40.0, kd=5.0), mfc.trajectories.Hold(Q)))
    assert "from_urdf" not in said.code


def test_a_robot_of_an_mjcf_file_is_read_from_it_again(tmp_path, monkeypatch):
    (tmp_path / "arm.xml").write_text(
        '<mujoco model="own"><worldbody><body name="b"><joint name="j" axis="0 1 0" damping="0.3"/><geom size=".1" mass="1" pos=".2 0 0"/></body>'
        "</worldbody></mujoco>"
    )
    monkeypatch.chdir(tmp_path)
    loop = mfc.ClosedLoop(
        mfc.Robot.from_mjcf(tmp_path / "arm.xml", gravity=(0, 0, -1.6)), mfc.laws.JointPID(40.0, kd=5.0), mfc.trajectories.Hold([0.3])
    )
    said = replay(loop, [0.0], "A = loop.linearize(times).A")
    assert said.missing == () and "mfc.Robot.from_mjcf('arm.xml', gravity=(0.0, 0.0, -1.6))" in said.code
    assert_allclose(rerun(said.code)["A"], loop.linearize([0.0]).A, rtol=1e-9)
