"""Floquet multipliers on the true orbit, and transient growth along a path."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis.analysis.floquet import FloquetVerdict
from mfc_analysis.errors import BadArgument, NotConverged, Unsupported

Q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
UR5 = mfc.robots.ur5()


def doubling() -> mfc.ClosedLoop:
    """The decentralised 9.10 whose frozen poles all decay and whose true motion doubles its period: a UR5 with 1 kg unknown."""
    arm = mfc.robots.load("ur5")
    middle = np.array([0, -0.9, 1.6, -0.7, 1.57, 0])
    kp, kd = 3.65**2, 2 * 0.16 * 3.65
    law = mfc.laws.ComputedTorque(kp, 0.18 * kp * kd, kd, mass=np.diag(np.diag(arm.mass(middle))))
    path = mfc.trajectories.Sinusoid(center=middle, amplitude=[0, 0.2, 0.2, 0, 0.15, 0], frequency=5.66)
    return mfc.ClosedLoop(arm.with_payload(1.0, inertia=0.001), law, path, controller_model=arm)


def test_an_exact_task_law_has_the_multipliers_of_its_design_on_a_moving_path():
    path = mfc.trajectories.ToolSinusoid(UR5.pose(Q), [0.05, 0.03, 0.04], 4.0, axis=(0, 1, 0), angle=0.1)
    loop = mfc.ClosedLoop(UR5, mfc.laws.TaskComputedTorque(26.0, 24.0, 9.0), path, q_start=Q)
    found = loop.floquet()
    wanted = np.repeat(np.exp(np.roots([1, 9, 26, 24]) * path.period), 6)
    # six equal copies: a multiple eigenvalue is known to a third of the digits; the traces of powers are known to all
    for power in (1, 2, 3):
        assert_allclose(np.sum(found.multipliers**power).real, np.sum(wanted**power), rtol=2e-5)
    assert found.verdict is FloquetVerdict.STABLE


def test_frozen_poles_say_stable_and_the_motion_doubles_its_period():
    loop = doubling()
    found = loop.floquet()
    assert found.verdict is FloquetVerdict.PERIOD_DOUBLING
    assert_allclose(found.multipliers[0], -1.0738, atol=5e-5)
    times = np.linspace(0, found.period, 41)
    orbit = loop.simulate(times, x=found.orbit, rtol=1e-9, atol=1e-11)
    frozen = loop.linearize(times, about="simulation", simulation=orbit)
    assert frozen.poles().real.max() < -0.05
    assert frozen.stable.all()


def test_the_simulated_growth_a_period_is_the_multiplier_to_a_tenth_of_a_percent():
    loop = doubling()
    found = loop.floquet()
    values, vectors = np.linalg.eig(found.Phi)
    mode = vectors[:, np.argmin(np.abs(values - found.multipliers[0]))].real
    start = found.orbit + 1e-5 * mode / np.linalg.norm(mode)
    away = []
    x, y = found.orbit, start
    for _ in range(4):
        away.append(np.linalg.norm(y - x))
        x, y = (loop.simulate([0.0, found.period], x=z, rtol=1e-11, atol=1e-13).x[-1] for z in (x, y))
    growth = np.array(away[1:]) / np.array(away[:-1])
    assert_allclose(growth, 1.07384, rtol=1e-3)


def test_a_hold_with_a_period_of_ones_own_has_the_exponentials_of_its_poles():
    loop = mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.ComputedTorque(6.0, None, 5.0), mfc.trajectories.Hold([0.3, 0.4]))
    found = loop.floquet(period=0.7)
    assert_allclose(np.sort(np.abs(found.multipliers)), np.sort(np.exp(0.7 * np.array([-2.0, -2.0, -3.0, -3.0]))), rtol=1e-6)


def test_a_sampled_loop_has_the_powers_of_its_discrete_model():
    hardware = mfc.Hardware(sample_time=0.02)
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.VelocityP(3.0), mfc.trajectories.Hold([0.1]), hardware=hardware)
    assert_allclose(loop.floquet(period=0.2).multipliers, [(1 - 3 * 0.02) ** 10], rtol=1e-12)
    with pytest.raises(Unsupported, match="whole number of samples"):
        loop.floquet(period=0.21)


def soft() -> mfc.ClosedLoop:
    """An arm of 370 kg m^2 that sags by a radian: Newton's method does not find its orbit from the reference."""
    return mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.JointPID(kp=600, kd=80), mfc.trajectories.Sinusoid([0.3, 0.4], 0.2, 2.0))


def test_an_orbit_far_from_the_reference_is_found_from_a_run():
    """Where the loop's own simulation ends after 100 periods; the multipliers from differences of the period map there."""
    loop = soft()
    found = loop.floquet()

    def once(x: np.ndarray, periods: int = 1) -> np.ndarray:
        return loop.simulate([0.0, periods * found.period], x=x, rtol=1e-11, atol=1e-13).x[-1]

    assert_allclose(found.orbit, once(loop.linearize().point.x[0], 100), atol=1e-7)
    assert np.abs(found.orbit[:2] - [0.3, 0.4]).max() > 1
    h = 1e-4
    columns = [(once(found.orbit + h * d) - once(found.orbit - h * d)) / (2 * h) for d in np.eye(4)]
    assert_allclose(np.sort(np.abs(found.multipliers)), np.sort(np.abs(np.linalg.eigvals(np.transpose(columns)))), rtol=1e-5)


def test_the_work_of_the_search_is_limited_over_all_its_runs():
    loop = soft()
    with pytest.raises(
        NotConverged, match=r"2000 evaluations .* not enough: the limit was reached in run \d+ .* over a period of 3.14159 s; max_evaluations="
    ):
        loop.floquet(max_evaluations=2000)
    with pytest.raises(BadArgument, match="max_evaluations"):
        loop.floquet(max_evaluations=0)


def test_no_period_and_dead_time_are_refused_by_name():
    hold = mfc.trajectories.Hold([0.3, 0.4])
    law = mfc.laws.ComputedTorque(6.0, None, 5.0)
    with pytest.raises(BadArgument, match="period"):
        mfc.ClosedLoop(mfc.robots.planar_2r(), law, hold).floquet()
    with pytest.raises(Unsupported, match="delay"):
        mfc.ClosedLoop(mfc.robots.planar_2r(), law, hold, hardware=mfc.Hardware(delay=1e-3)).floquet(period=1.0)


def test_transient_growth_at_rest_is_that_of_the_matrix_exponential():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(20.0, None, 1.0), mfc.trajectories.Hold([0.4]))
    lin = loop.linearize(np.linspace(0, 2, 5))
    found = lin.transient_growth()
    sizes = [np.linalg.norm(expm(lin.A[0] * t), 2) for t in found.times]
    assert_allclose(found.singular, sizes, rtol=1e-9)
    assert_allclose(float(found), max(sizes), rtol=1e-9)
    with pytest.raises(BadArgument, match="two or more times"):
        loop.linearize([0.0]).transient_growth()
