"""Linear prediction against nonlinear simulation."""

from __future__ import annotations

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument
from mfc_analysis.simulation import validation

Q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
UR5 = mfc.robots.ur5()
MOVING = mfc.trajectories.Sinusoid(Q, 0.2, 2.0)
CASES = {
    "ideal": {},
    "lag": {"torque_lag": 4e-3},
    "dead time": {"delay": 2e-2},
    "sampled": {"sample_time": 1e-2},
    "elastic": {"joint_stiffness": 1e4, "joint_damping": 5.0, "motor_inertia": 0.5},
    "sampled, fractional delay, lag, filter": {"sample_time": 1e-2, "delay": 1.5e-2, "torque_lag": 4e-3, "velocity_filter": 4e-3},
}


@pytest.mark.parametrize("hardware", CASES.values(), ids=CASES)
def test_the_remainder_shrinks_with_the_square_on_a_moving_path_with_a_wrong_model(hardware):
    law = mfc.laws.ComputedTorque(100, 100, 20)
    loop = mfc.ClosedLoop(UR5.with_payload(2.0), law, MOVING, controller_model=UR5, hardware=mfc.Hardware(**hardware))
    found = loop.validate(time=0.3)
    assert abs(found.taylor_order - 2.0) < 0.05
    assert found.nrmse < 0.01
    assert found.radius > 0.1


def test_a_linearisation_wrong_by_a_tenth_of_a_percent_shows_as_first_order(monkeypatch):
    loop = mfc.ClosedLoop(UR5, mfc.laws.JointPID(400, 200, 60), mfc.trajectories.Hold(Q))
    assert abs(loop.validate(time=0.3, size=1e-3).taylor_order - 2.0) < 0.05
    right = validation.transitions_along
    monkeypatch.setattr(validation, "transitions_along", lambda *along: (1 + 1e-3 / 200) * right(*along))
    assert abs(loop.validate(time=0.3, size=1e-3).taylor_order - 1.0) < 0.2


def test_a_linear_loop_has_no_remainder():
    wall = mfc.Environment(1e3, preload=10.0)
    law = mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 1.0, 2.0, 20.0)
    found = mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.0]), environment=wall).validate(time=0.5)
    assert found.taylor_order == np.inf and found.radius == np.inf
    assert found.nrmse < 1e-6


def test_beyond_the_radius_the_misfit_is_above_five_percent_and_within_it_below():
    loop = mfc.ClosedLoop(UR5, mfc.laws.JointPID(400, 200, 60), mfc.trajectories.Hold(Q))
    radius = loop.validate(time=0.3).radius
    assert 0 < radius < 3
    assert loop.validate(time=0.3, size=0.95 * radius).nrmse < 0.05 < loop.validate(time=0.3, size=1.1 * radius).nrmse


def test_a_base_run_that_does_not_end_says_why_there_are_no_figures():
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(-400.0, None, -50.0), mfc.trajectories.Hold([0.01]))
    found = loop.validate(time=2.0)
    assert np.isnan(found.taylor_order) and np.isnan(found.nrmse) and found.radius == 0.0
    assert "diverged" in found.message and "diverged" in str(found)


@pytest.mark.parametrize("wrong", [{"time": 0.0}, {"time": np.nan}, {"time": 1.0, "size": -1.0}], ids=str)
def test_a_time_or_size_that_is_not_positive_is_refused(wrong):
    with pytest.raises(BadArgument):
        mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(10.0), mfc.trajectories.Hold([0.0])).validate(**wrong)


def test_with_every_imperfection_on_at_once_the_remainder_still_shrinks_with_the_square():
    """Each is tested alone elsewhere; here lag, dead time, sampling, filter, elastic joints and a torque limit act together."""
    elastic = {"joint_stiffness": 2e4, "joint_damping": 20.0, "motor_inertia": 0.5}
    everything = mfc.Hardware(torque_lag=2e-3, delay=3e-3, sample_time=2e-3, velocity_filter=1e-3, torque_limit=400.0, **elastic)
    found = mfc.ClosedLoop(UR5, mfc.laws.JointPID(600, 200, 90), mfc.trajectories.Hold(Q), hardware=everything).validate(time=0.15)
    assert abs(found.taylor_order - 2.0) < 0.05


def test_a_sampled_force_loop_with_both_dead_times_lag_and_filters_too():
    everything = mfc.Hardware(torque_lag=2e-3, delay=3e-3, sample_time=2e-3, force_delay=1e-3, force_filter=1e-3, velocity_filter=1e-3)
    law = mfc.laws.DampedForcePI([0, 0, 20, 0, 0, 0], 0.2, None, [60, 60, 60, 3, 3, 3])
    wall = mfc.Environment(3e3, 30.0, axes="z", preload=20.0)
    found = mfc.ClosedLoop(UR5, law, mfc.trajectories.Hold(Q), environment=wall, hardware=everything).validate(time=0.1)
    assert abs(found.taylor_order - 2.0) < 0.05


@pytest.mark.parametrize(("share", "decays"), [(0.95, True), (1.05, False)], ids=["below", "above"])
def test_the_largest_stable_sample_time_of_a_ur5_is_where_sampled_runs_turn(share, decays):
    def loop(sample_time: float) -> mfc.ClosedLoop:
        hold, hardware = mfc.trajectories.Hold(Q), mfc.Hardware(sample_time=sample_time)
        return mfc.ClosedLoop(UR5.with_payload(2.0), mfc.laws.ComputedTorque(100, 100, 20), hold, controller_model=UR5, hardware=hardware)

    low, high = 0.01, 0.3
    for _ in range(25):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop(middle).linearize([0.0]).stable[0] else (low, middle)
    tried = loop(share * low)
    rest = tried.linearize([0.0]).point.x[0]
    start = rest.copy()
    start[:6] += 1e-5 * np.array([1, -1, 1, 1, -1, 1])
    run = tried.simulate(share * low * np.arange(200), x=start)
    away = np.abs(run.q - rest[:6]).max(axis=1)
    assert (away[-5:].max() < 1e-7) == decays
    assert decays or run.diverged or away[-5:].max() > 1e-3
