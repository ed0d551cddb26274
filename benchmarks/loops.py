"""The loops that are measured."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin

import mfc_analysis as mfc

Q0 = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
STARTS = {"ur5": Q0, "panda": np.array([0.0, -0.6, 0.2, -1.8, 0.1, 1.4, 0.5]), "xarm7": np.array([0.0, -0.6, 0.2, 1.8, 0.1, 1.4, 0.5])}
TIMES = np.linspace(0.0, 4.0, 1000)
GAINS = 100.0, 80.0, 20.0


@cache
def computed_torque(name: str = "ur5", hardware: mfc.Hardware | None = None) -> mfc.ClosedLoop:
    """An arm under 9.10 with an unknown payload of 2 kg on a moving reference: 18 states with six joints, 21 with seven."""
    robot = mfc.robots.ur5() if name == "ur5" else mfc.robots.load(name)
    path = mfc.trajectories.Sinusoid(STARTS[name], 0.3, 1.5)
    return mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(*GAINS), path, controller_model=robot, hardware=hardware)


@cache
def task() -> mfc.ClosedLoop:
    """The UR5 under 9.16 with the same payload."""
    robot = mfc.robots.ur5()
    path = mfc.trajectories.ToolSinusoid(robot.pose(Q0), [0.05, 0.0, 0.05], 1.5)
    return mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.TaskComputedTorque(*GAINS), path, controller_model=robot, q_start=Q0)


@cache
def hybrid() -> mfc.ClosedLoop:
    """The UR5 under 9.24, dynamic projection, pressing on a wall, with the same payload."""
    robot = mfc.robots.ur5()
    X0 = robot.pose(Q0)
    wall = mfc.Environment(1e4, 10.0, pose=X0, axes="z", preload=10.0)
    law = mfc.laws.HybridMotionForce([0, 0, 10, 0, 0, 0], 100, None, 20, 0.5, 2.0, 30, constraints=np.eye(6)[[2]])
    flat = mfc.trajectories.ToolSinusoid(X0, [0.05, 0.0, 0.0], 1.5)
    return mfc.ClosedLoop(robot.with_payload(2.0), law, flat, controller_model=robot, q_start=Q0, environment=wall)


@cache
def chain(n: int) -> mfc.ClosedLoop:
    """An arm of n joints, turning about z and y in turns, links of 1 kg and 1/n m, under 9.10 with an unknown payload of 0.2 kg."""
    model = pin.Model()
    length, parent = 1.0 / n, 0
    link = pin.Inertia(1.0, np.array([0.5 * length, 0.0, 0.0]), np.diag([1e-3, 2e-3, 2e-3]))
    for i in range(n):
        place = pin.SE3(np.eye(3), np.array([length if i else 0.0, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY() if i % 2 else pin.JointModelRZ(), place, f"joint{i + 1}")
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
        model.addJointFrame(parent, -1)
    tip = pin.Frame("tool", parent, model.getFrameId(f"joint{n}"), pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])), pin.FrameType.BODY)
    model.addFrame(tip)
    robot = mfc.Robot.from_pinocchio(model, tool="tool").with_armature(0.05)
    path = mfc.trajectories.Sinusoid(np.full(n, 0.3), 0.2, 1.5)
    return mfc.ClosedLoop(robot.with_payload(0.2), mfc.laws.ComputedTorque(*GAINS), path, controller_model=robot)
