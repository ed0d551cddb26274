"""Sampled loops between the samples: the condition of Colgate and Schenkel on one mass with friction, from both sides."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.passivity import Passive

M, H = 2.0, 1e-2
HOLD = mfc.trajectories.Hold([0.0])


def wall(K: float, B: float, tau: float, friction: float, delay: float | None = None) -> mfc.Linearization:
    """One mass with friction on a virtual wall K + B s/(tau s + 1), sampled with a hold."""
    outer = control.ss([[-1 / tau]], [[1.0]], [[-B / tau**2 / M]], [[(K + B / tau) / M]])
    law, hardware = mfc.laws.InverseDynamics(outer), mfc.Hardware(sample_time=H, delay=delay)
    return mfc.ClosedLoop(mfc.robots.slider(M, friction), law, HOLD, controller_model=mfc.robots.slider(M), hardware=hardware).linearize()


def least_friction(K: float, B: float, tau: float, late: int) -> float:
    """sup of h/2 Re{(1 - e^{-jwh}) H(e^{jwh})} / (1 - cos wh), H the wall held between the samples, ``late`` samples later."""
    angle = np.linspace(1e-3, np.pi, 200_001)
    z, lag = np.exp(1j * angle), np.exp(-H / tau)
    wall = K + B / tau - B / tau * (1 - lag) / (z - lag)
    return float((H / 2 * ((1 - 1 / z) * wall / z**late).real / (1 - np.cos(angle))).max())


@pytest.mark.parametrize("part", [0.999, 1.001])
@pytest.mark.parametrize("K", [400.0, 4000.0])
def test_a_spring_needs_half_a_sample_of_its_stiffness(K: float, part: float) -> None:
    """b > K h/2: below it the mass alone may still be held, but is not passive."""
    loop = mfc.ClosedLoop(mfc.robots.slider(M, part * K * H / 2), mfc.laws.JointPID(K), HOLD, hardware=mfc.Hardware(sample_time=H))
    assert loop.linearize().passivity().passive[0] == (part > 1)


@pytest.mark.parametrize(("K", "B"), [(400.0, 5.0), (100.0, 10.0), (400.0, -1.5)])
def test_a_virtual_wall_coded_with_differences_needs_half_a_sample_of_its_stiffness_and_its_damping(K: float, B: float) -> None:
    """b > K h/2 + abs(B), Colgate and Schenkel's example: H(z) = K + B (z - 1)/(h z)."""
    b, coded = K * H / 2 + abs(B), mfc.Hardware(sample_time=H, derivative_rule="backward")
    for part in (0.999, 1.001):
        found = mfc.ClosedLoop(mfc.robots.slider(M, part * b), mfc.laws.JointPID(K, None, B), HOLD, hardware=coded).linearize().passivity()
        assert found.passive[0] == (part > 1)
        if part < 1:
            assert_allclose(found.damping[0], (1 - part) * b, rtol=1e-3)


CASES = (
    (400.0, 20.0, 2e-2, 0),  # worst at the Nyquist frequency
    (400.0, 20.0, 2e-2, 1),  # worst in between
    (50.0, -1.0, 1e-2, 0),  # worst at low frequency
)


@pytest.mark.parametrize(("K", "B", "tau", "late"), CASES)
def test_any_wall_needs_the_friction_of_colgate_and_schenkel(K: float, B: float, tau: float, late: int) -> None:
    b = least_friction(K, B, tau, late)
    for part in (0.999, 1.001):
        found = wall(K, B, tau, part * b, late * H or None).passivity()
        assert found.passive[0] == (part > 1), part
        if part < 1:
            assert_allclose(found.damping[0], (1 - part) * b, rtol=2e-3)


def test_a_wall_that_is_passive_at_each_frequency_may_not_be_through_the_harmonics() -> None:
    b = least_friction(400.0, 20.0, 2e-2, 0)
    found = wall(400.0, 20.0, 2e-2, 0.9 * b).passivity()
    assert found.outcome == (Passive.HARMONICS,) and found.smallest[0] > 0
    assert "harmonics" in str(found) and f"{0.1 * b:.3g}"[:3] in str(found)


def test_without_friction_no_sampled_loop_is_passive_and_a_sampled_rate_never_is() -> None:
    for law, friction in ((mfc.laws.JointPID(10.0, None, 5.0), 0.0), (mfc.laws.JointPID(10.0, None, 5.0), 100.0)):
        lin = mfc.ClosedLoop(mfc.robots.slider(M, friction), law, HOLD, hardware=mfc.Hardware(sample_time=H)).linearize()
        found = lin.passivity()
        assert lin.stable.all() and not found.passive.any() and found.damping[0] == np.inf


def test_an_arm_that_only_its_sampled_sensor_moves_is_not_passive() -> None:
    law, drives = mfc.laws.Admittance(np.zeros(6), 3.0, 40.0, 200.0, axes="z"), mfc.Hardware(sample_time=1e-3)
    lin = mfc.ClosedLoop(mfc.robots.slider(M), law, HOLD, q_start=[0.0], hardware=drives).linearize()
    found = lin.passivity()
    assert lin.stable.all() and not found.passive[0] and found.damping[0] == np.inf


def test_joints_that_follow_their_command_are_not_passive_between_the_samples() -> None:
    """No force moves an ideal servo: its port has no mobility of its own, and the held command delays what the law gives."""
    law = mfc.laws.Admittance(np.zeros(6), 4.0, 60.0, axes="z")
    hardware = mfc.Hardware(sample_time=H, servo=mfc.Servo(50.0, 0.7, 0.016))
    lin = mfc.ClosedLoop(mfc.robots.slider(M), law, HOLD, environment=mfc.Environment(900.0), hardware=hardware).linearize()
    found = lin.passivity()
    assert lin.stable.all() and not found.passive.any() and found.damping[0] == np.inf


def test_two_joints_are_judged_as_one_does_each() -> None:
    """Two sliders of a decoupled arm: the friction of each has to be enough for its own spring."""
    robot = mfc.robots.rp(gravity=0.0)
    for friction, passive in (([2.1, 4.2], True), ([2.1, 3.9], False), ([1.9, 4.2], False)):
        law = mfc.laws.JointPID([400.0, 800.0])
        arm = robot.with_friction(viscous=np.array(friction))
        lin = mfc.ClosedLoop(arm, law, mfc.trajectories.Hold([0.0, 1.0]), hardware=mfc.Hardware(sample_time=H)).linearize()
        if lin.stable.all():
            assert lin.passivity(at="joints").passive[0] == passive
            assert lin.passivity().passive[0] == passive
        else:
            assert not passive
