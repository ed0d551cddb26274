"""Where a loop is real on the indentation of Nyquist's contour, against the roots of the loop's polynomials."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import mfc_analysis as mfc
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, places
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.sampled import sampled as sampled_system
from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import close_wires
from tests.analysis.conftest import open_system, scaled

s = control.tf("s")
RADIUS = 0.01
SAMPLE_TIME = 0.5


def closed(L, gain: float) -> np.ndarray:
    """Roots in the s plane of 1 + gain L."""
    found = np.roots(np.polyadd(L.den[0][0], gain * L.num[0][0]))
    return rates(found, float(L.dt or 0.0))


def value(L, at):
    """L at places ``at`` of the s plane."""
    return np.polyval(L.num[0][0], np.exp(at * L.dt) if L.dt else at) / np.polyval(L.den[0][0], np.exp(at * L.dt) if L.dt else at)


def real_on_the_arc(L) -> np.ndarray:
    """Angles above 0 on a fine grid at which L is real, polished."""

    def f(theta):
        return value(L, RADIUS * np.exp(1j * theta)).imag

    theta = np.linspace(1e-4, np.pi / 2, 20_001)
    change = np.flatnonzero(np.diff(np.sign(f(theta))))
    return np.array([brentq(f, theta[k], theta[k + 1], xtol=1e-15) for k in change])


LOOPS = {
    "integrator": control.tf(0.02 / s),
    "two integrators": (0.02 * s + 4e-4) / s**2,
    "three integrators": (3 * 0.02 * s**2 + 3 * 0.02**2 * s + 0.02**3) / s**3,
    "a pair near the arc": (s + 0.02) ** 2 / (s * (s**2 + 0.0008 * s + 1.1e-4)),
    "a pair inside": 3e-4 / (s**2 - 0.004 * s + 6e-5) + 0.5 / (s + 1),
    "a pair that leaves beside zero": (6.375e-5 - 0.00702 * s) / (s * (s - 0.00898)),
    "a pair that comes in beside zero": s * (s - 0.00898) / ((6.375e-5 - 0.00702 * s) * (s + 3)),
    "a narrow pair on it": 1e-5 * s / (s**2 + 2e-6 * s + 1e-4 * (1 + 1e-3)) + 0.3 / (s + 0.2),
}


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("name", LOOPS)
def test_the_loop_is_real_exactly_where_a_fine_grid_finds_it_real(name, sampled):
    L = LOOPS[name] if not sampled else control.tf(control.c2d(control.ss(LOOPS[name]), SAMPLE_TIME))
    poles = rates(np.concatenate([L.poles(), np.roots(np.polyadd(L.den[0][0], L.num[0][0]))]), float(L.dt or 0))[None]
    at, theta = places(RADIUS, float(L.dt or 0)), angles(poles, RADIUS)

    def H(w):
        return 1 / (1 + value(L, 2 * np.arctanh(w) / L.dt if L.dt else w)) - 1

    found = arc_crossings(RADIUS, theta, H(at(theta))[:, None], at, lambda point, channel, w: H(w))
    on_axis = found.w == 0
    assert on_axis.sum() == 1
    assert_allclose(found.L[on_axis], value(L, np.array([RADIUS + 0j])), rtol=1e-9)
    expected = value(L, RADIUS * np.exp(1j * real_on_the_arc(L)))
    # the narrow pair turns a rounding of 1e-12 of the angle into 1e-8 of the loop
    assert_allclose(np.sort(found.L[~on_axis].real), np.sort(expected.real), rtol=1e-7 if name == "a narrow pair on it" else 1e-8)
    gain = -1 / found.L.real
    for g in gain[np.abs(gain) < 1e6]:  # a root of 1 + g L lies on the circle there
        assert np.abs(np.abs(closed(L, g)) / RADIUS - 1).min() < 1e-6


def test_angles_rise_and_surround_the_poles_near_the_arc():
    poles = RADIUS * np.array([[1.001 * np.exp(0.7j), 1.001 * np.exp(-0.7j), 50.0], [0.0, -3, 100.0]])
    theta = angles(poles, RADIUS)
    assert theta.shape[0] == 2 and (np.diff(theta, axis=1) >= 0).all()
    assert theta[:, 0].tolist() == [0, 0] and (theta[:, -1] == np.pi / 2).all()
    assert (np.abs(theta[0] - 0.7) < 4e-3).sum() >= 5


def judged(system) -> bool:
    return bool(stability(system).nonzero_stable[0])


def outside_decay(system) -> bool:
    """All roots with abs(s) >= RADIUS have a negative real part."""
    roots = rates(np.linalg.eigvals(close_wires(system)[0][0]), system.dt)
    return bool((roots.real[np.abs(roots) >= RADIUS] < 0).all())


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("k", [1.5, 0.3])
def test_a_real_root_that_leaves_the_disc_to_the_right_ends_the_gain_interval(k, sampled):
    # s + a - g k a: the root g k a - a leaves the disc at g = (a + radius) / (k a); the other one, of a fast lag, is -3
    a = 0.02
    L = -k * a / (s + a) * 3 / (s + 3)
    if sampled:
        L = control.tf(control.c2d(control.ss(L), SAMPLE_TIME))
    system = open_system(L)
    expected = -1 / value(L, np.array([RADIUS + 0j]))[0].real
    found = margins(system, "torque")
    assert found.stable[0] and found.drifts[0] == (k > 1)
    assert_allclose([found.gain_increase[0, 0], found.increase_frequency[0, 0]], [expected, 0.0], rtol=1e-9, atol=1e-12)
    for factor, expectation in ((0.99, True), (1.01, False)):
        late = scaled(system, factor * expected)
        assert judged(late) is outside_decay(late) is expectation


@pytest.mark.parametrize("sampled", [False, True])
def test_a_pair_that_leaves_the_disc_to_the_right_ends_the_gain_interval(sampled):
    # s^2 - 2 d s + g w^2: the pair grows slowly, and leaves the disc where g w^2 = radius^2
    d, w = 0.002, 0.007
    L = w**2 / (s**2 - 2 * d * s) * 3 / (s + 3)
    if sampled:
        L = control.tf(control.c2d(control.ss(L), SAMPLE_TIME))
    system = open_system(L)
    found = margins(system, "torque")
    assert found.stable[0] or found.drifts[0]
    gain = found.gain_increase[0, 0]
    assert_allclose(gain, (RADIUS / w) ** 2, rtol=0.02)  # the fast lag moves it a little
    leaves = closed(L, gain)
    leaves = leaves[np.abs(leaves.imag) > 1e-4]
    assert_allclose(np.abs(leaves), RADIUS, rtol=1e-7)
    assert (leaves.real > 0).all()
    assert_allclose(found.increase_frequency[0, 0], np.abs(leaves.imag).max(), rtol=1e-3)
    for factor, expectation in ((0.99, True), (1.01, False)):
        late = scaled(system, factor * gain)
        assert judged(late) is outside_decay(late) is expectation


def test_without_a_disc_a_real_root_ends_the_interval_at_zero():
    system = replace(open_system(-0.5 * 0.02 / (s + 0.02) * 3 / (s + 3)), horizon=np.inf)
    assert_allclose(margins(system, "torque").gain_increase[0, 0], 2.0, rtol=1e-12)


SLOW_PAIRS = {  # closed loops whose pair of slow roots leaves the disc to the right with dead time, while |L| < 1 on all of the axis above it
    "beside a real root": (2.84e-3 * s**2 + 5.94e-5 * s + 1.64e-7) / (s**3 + 3.1e-3 * s**2 + 2.78e-5 * s + 3.86e-7),
    "beside another pair": 2.96e-9 / (s**4 - 3.25e-3 * s**3 + 1.046e-4 * s**2 + 5.64e-8 * s + 2.93e-10),
    "beside a fast root": (1.352e-2 * s**2 + 8.0e-5 * s + 3.54e-8) / (s**3 + 2.138e-2 * s**2 - 9.09e-5 * s + 1.989e-6),
}


@pytest.mark.parametrize("already", [0.0, 4.0])
@pytest.mark.parametrize("name", SLOW_PAIRS)
def test_dead_time_that_drives_a_slow_pair_out_of_the_disc_ends_the_delay_margin(name, already):
    L = SLOW_PAIRS[name] * 3 / (s + 3)
    system = open_system(L, already)
    found = margins(system, "torque")
    delay = found.delay[0, 0]
    assert found.stable[0] and 5 < delay < 300
    root = np.sqrt(RADIUS**2 - found.delay_frequency[0, 0] ** 2) + 1j * found.delay_frequency[0, 0]
    assert abs(1 + value(L, root) * np.exp(-root * (delay + already))) < 1e-8
    for factor in (0.1, 0.5, 0.9, 0.999):
        assert judged(open_system(L, already + factor * delay))
    assert not judged(open_system(L, already + 1.001 * delay))


@pytest.mark.parametrize("already", [0.0, 0.5])
def test_dead_time_that_drives_a_real_slow_root_out_of_the_disc_ends_the_delay_margin(already):
    # s^2 + 2 s - 3 + (2 s + 3) e^(-s T): a root at 0, and a second one at T = 4/3; |L| < 1 on all of the axis
    L = (2 * s + 3) / (s**2 + 2 * s - 3)
    found = margins(open_system(L, already), "torque")
    delay = found.delay[0, 0]
    assert found.stable[0]
    assert_allclose(delay + already, np.log(-value(L, RADIUS)) / RADIUS, rtol=1e-9)
    assert_allclose(delay + already, 4 / 3, rtol=5e-3)
    assert found.delay_frequency[0, 0] == 0
    assert judged(open_system(L, already + 0.999 * delay)) and not judged(open_system(L, already + 1.001 * delay))


def test_dead_time_that_drives_a_real_slow_root_of_a_discrete_loop_out_of_the_disc_ends_the_delay_margin():
    L = control.tf(control.c2d(control.ss((2 * s + 3) / (s**2 + 2 * s - 3)), 0.01))
    found = margins(open_system(L), "torque")
    assert_allclose(found.delay[0, 0], np.log(-value(L, np.array([RADIUS + 0j]))[0].real) / RADIUS, rtol=1e-8)


def with_dead_time(lin, late):
    """The linear loop with dead times (n,) [s] added to its joint torques."""
    system = lin.opened.held if lin.dt else lin.opened
    delay = np.array(system.wire_delay)
    delay[system.wires["torque"]] += late
    late_system = replace(system, wire_delay=delay)
    return sampled_system(late_system, lin.dt) if lin.dt else late_system


@pytest.mark.parametrize("hardware", [None, mfc.Hardware(torque_lag=3e-3), mfc.Hardware(delay=2e-3), mfc.Hardware(sample_time=1e-3)])
def test_dead_time_of_one_joint_of_an_arm_with_a_free_self_motion_is_lost_where_the_self_motion_runs_away(hardware):
    robot = mfc.robots.load("panda")
    q = np.array([0.3, -0.6, 0.4, -1.9, 0.5, 1.7, 0.2])
    law = mfc.laws.Impedance([400, 400, 400, 30, 30, 30], [60, 60, 60, 4, 4, 4], null_damping=2.0)
    lin = mfc.ClosedLoop(robot, law, mfc.trajectories.ToolHold(robot.pose(q)), q_start=q, hardware=hardware).linearize()
    found = lin.margins()
    assert lin.slow[0] == 1 and found.stable[0] and (found.delay_frequency < 1e-9).any()
    for k in range(7):
        for factor, expectation in ((0.99, True), (1.01, False)):
            late = np.zeros(7)
            late[k] = factor * found.delay[0, k]
            if np.isfinite(late[k]):
                assert bool(stability(with_dead_time(lin, late)).nonzero_stable[0]) is expectation, (k, factor)
