"""Metrics and what a residual implies: closed forms, simulation, dead time, sampling."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.participation import rightmost
from mfc_analysis.errors import BadArgument, NotConverged, UnknownName
from mfc_analysis.requirements.evidence import Evidence
from mfc_analysis.requirements.requirements import Requirements
from tests.requirements.test_requirements import hold, velocity_p


def test_the_residual_of_a_lagging_actuator_is_the_same_as_without():
    law = mfc.laws.JointPID(40.0, kd=5.0)
    found = [
        Requirements().check(mfc.ClosedLoop(mfc.robots.single_joint(), law, hold(), hardware=h), [0.0]).line("residual").found
        for h in (None, mfc.Hardware(torque_lag=1e-3))
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_tracking_error_is_that_of_the_nonlinear_run():
    robot = mfc.robots.ur5()
    ref = mfc.trajectories.Quintic(np.full(6, 0.5), np.full(6, 0.8), 1.0)
    loop = mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(kp=100, kd=20), ref, controller_model=robot)
    line = Requirements(tracking_error=1.0).check(loop, [0.0, 1.0]).line("tracking_error")
    run = loop.simulate(np.linspace(0, 1, 400))
    assert line.found == pytest.approx(np.abs(run.error).max(), rel=1e-6)


def test_torque_fraction_needs_limits_and_takes_the_smaller_ones():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(40.0, kd=10.0), hold(q=0.0))
    assert math.isnan(Requirements(torque_fraction=1).check(loop, [0.0]).line("torque_fraction").found)
    limited = mfc.ClosedLoop(loop.robot, loop.law, loop.ref, hardware=mfc.Hardware(torque_limit=2.0))
    line = Requirements(torque_fraction=1).check(limited, [0.0]).line("torque_fraction")
    assert line.found == pytest.approx(0.981 / 2.0, rel=1e-9) and line.where == "joint"


def test_dead_time_is_in_damping_and_in_the_rightmost_root():
    k, T = 5.0, 0.1
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(k), hold(), hardware=mfc.Hardware(delay=T))
    verdict = Requirements(damping_ratio=0.5).check(loop, [0.0])
    root = loop.linearize([0.0]).delay_roots(1)[0, 0]
    assert abs(root + k * np.exp(-root * T)) < 1e-9
    assert verdict.line("stable").found == pytest.approx(root.real, rel=1e-12)
    assert verdict.line("damping_ratio").found == pytest.approx(-root.real / abs(root), rel=1e-9)
    assert "rightmost" in verdict.line("damping_ratio").note


def test_sampled_metrics_tend_to_the_continuous_ones():
    def made(**hardware):
        return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(kp=100.0, kd=14.0), hold(), hardware=mfc.Hardware(**hardware))

    req = Requirements(phase_deg=1, damping_ratio=0.01, settling_time=10, overshoot=1)
    ideal, sampled = (req.check(loop, [0.0]) for loop in (made(), made(sample_time=1e-4)))
    for line in ideal.lines:
        assert sampled.line(line.name).found == pytest.approx(line.found, rel=0.01)


def test_an_open_loop_with_a_wrong_model_is_held_by_nothing():
    robot = mfc.robots.slider()
    loop = mfc.ClosedLoop(robot, mfc.laws.OpenLoopForce([0, 0, 5, 0, 0, 0]), hold(q=0.0))  # pushes into free space
    found = Requirements().check(loop, [0.0]).line("residual").found
    assert found == pytest.approx(0.5 * 5.0 * 100.0**2)  # 5 N on 1 kg over the horizon
    assert Requirements(horizon=10.0).check(loop, [0.0]).line("residual").found == pytest.approx(0.5 * 5.0 * 10.0**2)


def test_a_spring_holds_what_the_open_loop_force_does_not_balance():
    surface = mfc.Environment(1e3, damping=20.0, preload=2.0)  # 3 N missing: 3 mm
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.OpenLoopForce([0, 0, 5, 0, 0, 0]), hold(q=0.0), environment=surface)
    verdict = Requirements().check(loop, [0.0])
    assert verdict.status == "WATCH" and verdict.line("residual").found == pytest.approx(3e-3, rel=1e-9)


def test_an_integral_force_loop_that_starts_at_the_wrong_force_moves_until_it_is_right():
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kfi=3.0, kdamp=40.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(mass=2.0), law, hold(q=0.0), environment=mfc.Environment(1e3, preload=1.0))
    assert Requirements().check(loop, [0.0]).line("residual").found == pytest.approx(4e-3, rel=1e-9)


def test_metrics_are_known_by_the_names_of_the_requirements():
    evidence = Evidence(velocity_p().equations, [0.0])
    assert evidence.found("phase_deg").value == pytest.approx(90.0)
    assert evidence.found("phase_deg") is evidence.found("phase_deg")
    with pytest.raises(UnknownName, match="phase_deg"):
        evidence.found("phase")
    with pytest.raises(BadArgument, match="loop"):
        mfc.Requirements(phase_deg=30).check(3, [0.0])


def test_the_slowest_root_names_its_joint():
    robot = mfc.robots.ur5()
    gains = np.array([9.0, 8.0, 7.0, 1.0, 5.0, 4.0])
    loop = mfc.ClosedLoop(robot, mfc.laws.VelocityP(gains), hold(6))
    found = Evidence(loop.equations, [0.0]).slowest_root()
    assert found.value == pytest.approx(-1.0, rel=1e-12) and found.where == robot.joint_names[3]


def test_the_root_of_a_loop_with_many_samples_in_transit_is_named_from_its_wires():
    """70 and 200 samples of one dead time on the way: the same boundary, joint and root as with a state for each sample."""
    law, path = mfc.laws.JointPID(kp=40, kd=6), mfc.trajectories.Hold([0.3, 0.4])
    for samples in (70, 200):
        hardware = mfc.Hardware(delay=0.14, sample_time=0.14 / samples)
        e = Evidence(mfc.ClosedLoop(mfc.robots.planar_2r(), law, path, hardware=hardware).equations, np.zeros(1))
        lin = e.linearization
        assert not e.judged[0] and lin.judged.nx < 10 < 2 * samples < lin.opened.nx
        z = lin.poles()[0]
        full = rightmost(lin.opened, e.roots)
        assert_allclose(e.rightmost.value.real, np.log(np.abs(z)).max() / lin.dt, rtol=1e-6)
        assert str(e.rightmost) == str(full) and "joint" in str(full)


def test_a_root_on_the_edge_of_the_slow_ones_is_located_whatever_rounding_says():
    e = Evidence(mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.VelocityP(-0.01 * (1 + 1e-9)), hold(1)).equations, [0.0])
    assert not e.judged[0] and "joint 1 (slide) at t = 0 s: root +0.01 1/s" in e.unstable
    e.__dict__["roots"] = np.array([[0.01 * (1 - 1e-9) + 0j]]), np.array([[True]])  # another eigenvalue routine's rounding
    del e.__dict__["rightmost"]
    assert "joint 1 (slide) at t = 0 s: root +0.01 1/s" in e.unstable and e.slowest_root().value > 0


def test_a_steady_state_without_digits_is_an_error_in_words():
    """Friction of 1e30 Nm s/rad: the fast part of A is singular to rounding."""
    q = [0.1, -1.0, 1.0, 0.3, 0.4, 0.5]
    loop = mfc.ClosedLoop(
        mfc.robots.ur5().with_friction(viscous=1e30, coulomb=0.1),
        mfc.laws.ComputedTorque(100.0, 10.0, 20.0),
        mfc.trajectories.Quintic(q, [0.3] * 6, 1.0),
        hardware=mfc.Hardware(delay=1e-3, torque_lag=2e-3, sample_time=1e-3),
    )
    with pytest.raises(NotConverged, match="no digits"):
        Requirements(phase_deg=30.0).check(loop, [0.0, 0.5, 1.0])
