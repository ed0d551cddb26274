"""Metrics of pairs of inputs and outputs against those of single steps, and against closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.step_metrics import Outcome, pair_metrics, points
from tests.analysis.conftest import open_system
from tests.analysis.test_steps import LOOPS, METRICS, ur5

s = control.tf("s")


def test_pairs_have_the_metrics_of_the_steps_between_them():
    lin = ur5(*LOOPS["wrong model"], [0.0, 1.0])
    found, every = pair_metrics(lin.opened, np.array([0, 3]), np.array([2, 3])), lin.steps([0.0])
    for name in METRICS:
        assert_allclose(found[name], getattr(every, name)[:, [2, 3], [0, 3]], rtol=1e-7 if name == "peak_time" else 1e-9, atol=1e-12)


def test_no_pairs_have_no_metrics():
    none = np.zeros(0, int)
    assert pair_metrics(open_system(4 / s), none, none)["settling"].shape == (1, 0)


@pytest.mark.parametrize(("L", "outcome", "settling"), [(4 / s, Outcome.SETTLES, np.log(50) / 4), (-4 / (s + 1), Outcome.GROWS, np.nan)])
def test_an_outcome_and_a_settling_time_of_first_order(L: control.TransferFunction, outcome: Outcome, settling: float) -> None:
    found = pair_metrics(open_system(L), np.array([0]), np.array([0]))
    assert found["outcome"][0, 0] is outcome
    assert_allclose(found["settling"], [[settling]], rtol=1e-9)


def test_the_points_of_a_batch_are_its_loops_one_by_one() -> None:
    lin = ur5(*LOOPS["wrong model"], [0.0, 1.0])
    found = points(lin.opened)
    assert len(found) == 2 and all(point.others_decay for point in found)
    for i, point in enumerate(found):
        assert_allclose(point.closed[0], lin.A[i], atol=1e-9 * np.abs(lin.A).max())


def test_an_integral_brings_every_joint_back_and_its_torque_takes_the_disturbance() -> None:
    """Exactly 0 and -1 of all pairs: the sum over the modes, of an arm whose wrists are light, had an error of 1e-9 of the peak, and with dead
    time no response settled about it.
    """
    robot = mfc.robots.load("panda").with_armature(0.2)
    q = np.array([-1.486, -0.003, 0.406, -1.945, -1.408, 1.855, -1.718])
    law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=20.0))
    path = mfc.trajectories.Sinusoid(center=q, amplitude=0.05, frequency=2.0)
    loop = mfc.ClosedLoop(robot.with_payload(1.0), law, path, robot, hardware=mfc.Hardware(torque_lag=2e-3))
    pushes = [f"disturbance_{joint}" for joint in robot.joint_names]
    lin = loop.linearize(np.linspace(0, 3, 9))
    moved = lin.steps([0.0], inputs=pushes, outputs=[f"q_{joint}" for joint in robot.joint_names])
    assert not moved.steady_state.any()
    torque = lin.steps([0.0], inputs=pushes, outputs=[f"tau_{joint}" for joint in robot.joint_names])
    assert (np.abs(torque.steady_state + np.eye(7)) <= 1e-12 * torque.peak).all()
