"""Losses between two values of a scan: dead times with a root on the axis, sample times at which a resonance folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.design.limits import stable
from mfc_analysis.design.windows import Growth, critical_delays, folding_times, growths, lost_between


def elastic(name: str, q: list[float], kp: float, kd: float, stiffness: float, damping: float, inertia: float) -> mfc.ClosedLoop:
    """Computed torque with a constant diagonal mass on elastic joints; spring, damper and motor in units of M_jj."""
    robot = mfc.robots.load(name)
    M = np.diag(robot.mass(np.array(q)))
    size = np.maximum(M, 0.05)
    hardware = mfc.Hardware(joint_stiffness=stiffness * size, joint_damping=damping * size, motor_inertia=inertia * np.maximum(M, 0.02))
    return mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(kp, None, kd, mass=np.diag(M)), mfc.trajectories.Hold(q), hardware=hardware)


PANDA = ("panda", [-0.25, 0.24, -1.25, -1.87, -0.56, 1.2, 0.64], 34.196, 12.1015, 6436.4, 7.2914, 0.6939)
UR10 = ("ur10", [2.17, -0.59, 1.44, 0.17, -2.06, -0.77], 74.7145, 41.932, 10606.8, 0.24631, 0.57858)


@pytest.mark.parametrize("case", [PANDA, UR10])
def test_no_dead_time_below_the_largest_one_is_lost(case):
    loop = elastic(*case)
    limit = float(mfc.design.max_delay(loop))
    for part in np.linspace(0.02, 0.99, 40):
        assert stable(replace(loop, hardware=replace(loop.hardware, delay=part * limit)), [0.0]), part
    assert not stable(replace(loop, hardware=replace(loop.hardware, delay=1.01 * limit)), [0.0])


@pytest.mark.parametrize("case", [PANDA, UR10])
def test_no_sample_time_below_the_longest_one_is_lost(case):
    loop = elastic(*case)
    limit = 1 / float(mfc.design.min_sample_rate(loop))
    for part in np.linspace(0.05, 0.99, 120):
        assert stable(replace(loop, hardware=loop.hardware.every(part * limit)), [0.0]), part


def test_critical_delays_of_one_joint_are_its_delay_margin():
    robot = mfc.robots.single_joint(inertia=0.5, mass=1.0, com_distance=0.1, damping=0.1)
    lin = mfc.ClosedLoop(robot, mfc.laws.JointPID(20.0, 15.0, 4.0), mfc.trajectories.Hold([0.3])).linearize()
    assert_allclose(critical_delays(lin.opened, "torque").min(), lin.margins().delay[0, 0], rtol=1e-9)


def test_velocity_p_has_the_critical_delay_pi_over_2k():
    k = np.array([3.0, 5.0])
    lin = mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.3, 0.4])).linearize()
    assert_allclose(critical_delays(lin.opened, "velocity"), np.pi / (2 * k[::-1]), rtol=1e-9)


def test_a_rigid_arm_has_no_folding_times_but_those_of_its_pendulum():
    lin = mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.ComputedTorque(100.0, None, 20.0), mfc.trajectories.Hold(np.full(6, 0.3))).linearize()
    assert folding_times(lin.opened, 1e-4, 0.1).size == 0


def test_folding_times_resolve_the_period_of_the_fastest_mode_that_still_rings():
    loop = elastic(*PANDA)
    found = folding_times(loop.linearize().opened, 1e-4, 0.05)
    assert found[0] >= 1e-4 and found[-2] < 0.05 <= found[-1]
    assert (np.diff(found) > 0).all()


def test_a_narrow_loss_between_two_values_is_found_by_its_growth_or_its_fold():
    def grown(x: float) -> Growth:
        return Growth(-0.1 + (0.2 if abs(x - 0.52) < 0.004 else 0.0), -np.inf, -abs(x - 0.52))

    found = lost_between(grown, np.linspace(0, 1, 11))
    assert found.size and (np.abs(found - 0.52) < 0.004).all()


def test_the_growth_of_a_sampled_loop_has_the_sign_of_its_verdict():
    for h in (1e-3, 5e-2):
        loop = mfc.ClosedLoop(
            mfc.robots.planar_2r(),
            mfc.laws.ComputedTorque(100.0, None, 20.0),
            mfc.trajectories.Hold([0.3, 0.4]),
            hardware=mfc.Hardware(sample_time=h),
        )
        assert (growths(loop.linearize().opened).largest < 0) == stable(loop, [0.0])
