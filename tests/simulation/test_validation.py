"""Linear prediction against nonlinear simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument
from mfc_analysis.simulation import run, validation

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
    assert found.nrmse < 0.02
    assert found.radius > 0.02


def test_the_remainder_shrinks_with_the_square_where_the_base_run_reaches_a_limit():
    """An error of A(t) over a part of a step where the limit is reached and left would show as first order."""
    law, limit = mfc.laws.ComputedTorque(100, None, 20), np.array([400.0, 50.0, 400.0, 400.0, 400.0, 400.0])
    moving = mfc.trajectories.Sinusoid(Q, 0.2, 5.0)
    free, limited = (mfc.ClosedLoop(UR5, law, moving, hardware=mfc.Hardware(torque_limit=u)) for u in (400.0, limit))
    largest = np.abs(free.simulate(np.linspace(0, 0.5, 101)).command[:, 1]).max()
    assert largest > limit[1]
    found = limited.validate(time=0.5, size=1e-4)
    assert abs(found.taylor_order - 2.0) < 0.05


def test_a_linearisation_wrong_by_a_tenth_of_a_percent_shows_as_first_order(monkeypatch):
    loop = mfc.ClosedLoop(UR5, mfc.laws.JointPID(400, 200, 60), mfc.trajectories.Hold(Q))
    assert abs(loop.validate(time=0.3, size=1e-4).taylor_order - 2.0) < 0.05
    right = validation.accumulated
    monkeypatch.setattr(validation, "accumulated", lambda Phi: right((1 + 1e-3 / len(Phi)) * Phi))
    assert abs(loop.validate(time=0.3, size=1e-4).taylor_order - 1.0) < 0.2


def test_a_linear_loop_has_no_remainder():
    wall = mfc.Environment(1e3, preload=10.0)
    law = mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 1.0, 2.0, 20.0)
    found = mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.0]), environment=wall).validate(time=0.5)
    assert found.taylor_order == np.inf and found.radius == np.inf
    assert found.nrmse < 1e-6


@pytest.mark.parametrize("hardware", [{"delay": 5e-3}, {"sample_time": 1e-2}], ids=str)
def test_a_linear_loop_that_grows_has_no_remainder_either(hardware):
    """Gains far too large for the dead time: the solver's error grows with the response, and gave orders of -3.5 and 1.0."""
    fast = mfc.laws.ComputedTorque(1e6, 1e6, 2e3)
    found = mfc.ClosedLoop(mfc.robots.slider(), fast, mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(**hardware)).validate(0.05)
    assert found.taylor_order == np.inf
    joint = mfc.ClosedLoop(mfc.robots.single_joint(), fast, mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(**hardware)).validate(0.05)
    assert joint.taylor_order != np.inf  # gravity: not linear


def test_no_taylor_order_is_stated_where_the_error_of_the_solver_grows_with_the_disturbance():
    """Exact inverse dynamics, so linear, with a growth of 1e7 and more: orders of 0.997 and 0.093 looked like a wrong linearisation."""
    for robot, kd, time in ((mfc.robots.load("ur10"), -20.0, 1.0), (mfc.robots.planar_2r(), -25.0, 0.7)):
        hold = mfc.trajectories.Hold(np.full(robot.n, 0.4))
        found = mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(60.0, None, kd), hold).validate(time)
        assert np.isnan(found.taylor_order) and f"grows too much in {time:g} s for a Taylor order" in str(found)


def test_no_taylor_order_is_stated_where_even_the_least_disturbance_leaves_the_linear_range():
    """Joint PID on light wrists with 3 ms of dead time: an order of 1.000 at a size where the linear model is off by a factor of a million."""
    panda, pose = mfc.robots.load("panda"), np.array([1.0, 0.13, -0.9, -1.57, -0.63, 1.05, 1.05])
    M = np.diag(panda.mass(pose))
    law, late = mfc.laws.JointPID(100 * M, 50 * M, 20 * M), mfc.Hardware(delay=3e-3)
    found = mfc.ClosedLoop(panda, law, mfc.trajectories.Hold(pose), hardware=late).validate(0.1)
    assert found.radius == 0 and found.nrmse > 1e3 and np.isnan(found.taylor_order)


def test_a_remainder_below_the_error_of_the_solver_that_shrinks_with_the_square_counts():
    """One joint with lag: gravity is not linear, 4e-10 rad of remainder at 0.01 rad, which was taken for rounding."""
    law, lag = mfc.laws.ComputedTorque(1e4, 1e4, 200.0), mfc.Hardware(torque_lag=1e-3)
    found = mfc.ClosedLoop(mfc.robots.single_joint(), law, mfc.trajectories.Hold([0.3]), hardware=lag).validate(0.05)
    assert abs(found.taylor_order - 2.0) < 0.05


def shifted(loop, found, direction, size):
    """The joint deviations of the nonlinear run from a start disturbed by ``size * direction``."""
    rest = loop.linearize([0.0], coordinates="state").point.x[0]
    runs = [loop.simulate(found.t, x=x, rtol=1e-9, atol=1e-12) for x in (rest, rest + size * direction)]
    return runs[1].q - runs[0].q if runs[1].t.size == found.t.size else np.full((found.t.size, loop.robot.n), np.inf)


def test_beyond_the_radius_the_misfit_is_above_five_percent_and_within_it_below():
    loop = mfc.ClosedLoop(UR5, mfc.laws.JointPID(400, 200, 60), mfc.trajectories.Hold(Q))
    found = loop.validate(time=0.3)
    assert 0 < found.radius < 3
    assert loop.validate(time=0.3, size=0.97 * found.radius).nrmse < 0.05 < loop.validate(time=0.3, size=1.03 * found.radius).nrmse
    for part in (0.97, 1.03):
        s = part * found.radius
        nonlinear, linear = shifted(loop, found, found.direction, s), found.linear * s / found.size
        assert (validation.misfit(nonlinear, linear) < 0.05) == (part < 1)


def test_with_steep_friction_the_misfit_is_within_the_bound_where_runs_are_worst():
    """The response that chooses directions does not follow it: the radius was 0.051 rad, with a misfit of 5.6 % in this direction."""
    pose, bare = np.array([0.614, 1.608]), mfc.robots.load("double_pendulum")
    M = np.diag(bare.mass(pose))
    robot = bare.with_friction(viscous=0.1 * M.mean(), coulomb=2 * M, coulomb_speed=1e-3)
    loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(100 * M, 200 * M, 20 * M), mfc.trajectories.Hold(pose))
    found, worst = loop.validate(0.05), np.array([0.417, 1.0, -0.0183, -0.0758, 0.0499, -0.0499])
    A = loop.linearize([0.0], coordinates="state").A[0]
    linear = found.radius * np.stack([(expm(A * t) @ worst)[:2] for t in found.t])
    assert found.radius > 0.02 and validation.misfit(shifted(loop, found, worst, found.radius), linear) < 0.052


POSES = {
    "panda": [0.3, -0.4, 0.4, -1.8, -0.5, 1.9, 0.4],
    "ur10": [0.3, -0.9, 0.7, 1.1, -0.5, 0.9],
    "kinova": [0.3, 2.6, 2.0, 1.1, 2.5, 0.9],
}


def loop_on(name, equation, inverse="euclidean"):
    """9.8, 9.10 with a wrong model, 9.16, or 9.23 on a wall, on an arm of the catalogue in a generic pose."""
    robot, q, L = mfc.robots.load(name), np.array(POSES[name]), mfc.laws
    M, hold = np.diag(robot.mass(q)), mfc.trajectories.Hold(q)
    if equation == "9.8":
        return mfc.ClosedLoop(robot, L.JointPID(100 * M, 200 * M, 20 * M), hold)
    if equation == "9.10":
        return mfc.ClosedLoop(robot.with_payload(2.0), L.ComputedTorque(100, 100, 20), hold, controller_model=robot)
    if equation == "9.16":
        return mfc.ClosedLoop(robot, L.TaskComputedTorque(100, 100, 20, null_damping=5.0 if robot.n > 6 else 0, inverse=inverse), hold)
    wall = mfc.Environment(1e4, 50.0, axes="z", preload=20.0)
    return mfc.ClosedLoop(robot, L.DampedForcePI([0, 0, 20, 0, 0, 0], 0.5, 2.0, [60, 60, 60, 5, 5, 5]), hold, environment=wall)


@pytest.mark.parametrize(
    ("name", "equation"),
    [("panda", "9.8"), ("kinova", "9.8"), ("ur10", "9.10"), ("panda", "9.16"), ("kinova", "9.16"), ("ur10", "9.23"), ("panda", "9.23")],
)
def test_the_radius_is_that_of_the_worst_direction_whatever_the_seed(name, equation):
    """Along one random direction it varied by a factor of ten between seeds. No random disturbance of the joints, and none near the
    direction found, fails at a smaller size; two seeds agree to 4 % (1 % each from the search for the size, the rest from equal maxima)."""
    loop = loop_on(name, equation)
    found, again = (loop.validate(time=0.05, seed=seed) for seed in (0, 1))
    assert again.radius == pytest.approx(found.radius, rel=0.04)
    assert abs(found.taylor_order - 2.0) < 0.05
    n, rng = loop.robot.n, np.random.default_rng(3)
    assert found.direction.shape == (loop.equations.nx,) and np.abs(found.direction[:n]).max() == pytest.approx(1.0)
    A = loop.linearize([0.0], coordinates="state").A[0]
    response = [expm(A * t)[:n] for t in found.t]
    tried = [found.direction * (1 + 0.3 * rng.uniform(-1, 0, loop.equations.nx)) for _ in range(2)]
    tried += [np.concatenate([rng.uniform(-1, 1, n), np.zeros(loop.equations.nx - n)]) for _ in range(2)]
    for direction in tried:
        direction /= np.abs(direction[:n]).max()
        s = 0.9 * found.radius
        assert validation.misfit(shifted(loop, found, direction, s), s * np.array([P @ direction for P in response])) < 0.05


def test_higher_orders_count_in_the_worst_direction():
    """To second order the worst direction of 9.16 has all of joint 2; at the radius 0.7 of it are worse: 0.254 rad by Nelder-Mead on runs
    against 0.390 rad for the worst to second order."""
    assert loop_on("panda", "9.16", "dynamic").validate(time=0.05).radius <= 1.02 * 0.2539


@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_a_misfit_that_is_smaller_again_beyond_a_singularity_is_not_taken_for_none(size):
    """In the worst direction the misfit is 5 % at 0.87 rad, 15 % at 1 rad and 0.5 % at 3 rad."""
    xarm, q = mfc.robots.load("xarm7"), np.array([-0.93, -1.25, -0.39, 1.04, 1.66, 0.85, 0.86])
    loop = mfc.ClosedLoop(xarm, mfc.laws.TaskVelocity(10.0), mfc.trajectories.ToolHold(xarm.pose(q)), q_start=q)
    assert loop.validate(time=1e-3, size=size).radius == pytest.approx(0.87, rel=0.03)


def test_where_the_second_order_vanishes_the_radius_is_that_of_the_third():
    """A pendulum that hangs: g = m g l sin q is odd about its rest point."""
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(3.0, None, 0.5), mfc.trajectories.Hold([-np.pi / 2]))
    found = loop.validate(time=0.5)
    assert abs(found.taylor_order - 3.0) < 0.05
    assert loop.validate(time=0.5, size=0.97 * found.radius).nrmse < 0.05 < loop.validate(time=0.5, size=1.03 * found.radius).nrmse


def test_a_torque_limit_ends_the_validity_of_the_linear_model():
    """The second order does not see a limit. A slider under kp x + kd v is linear up to the limit, and its misfit jumps beyond."""
    law, hold = mfc.laws.JointPID(100.0, None, 20.0), mfc.trajectories.Hold([0.0])
    free, limited = (mfc.ClosedLoop(mfc.robots.slider(), law, hold, hardware=mfc.Hardware(torque_limit=limit)).validate(0.5) for limit in (None, 4.0))
    assert free.radius == np.inf and 0.01 < limited.radius < 0.2
    assert limited.taylor_order == np.inf  # well within the limit


def test_runs_that_take_too_much_work_give_no_figures_and_say_so(monkeypatch):
    """A stiff wall: a radius from runs that were stopped would be the limit's, not the loop's."""
    wall, law = mfc.Environment(1e8, 10.0, preload=5.0), mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 0.2, 0.5, 40.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(1.0, 2.0), law, mfc.trajectories.Hold([0.0]), environment=wall)
    monkeypatch.setattr(run, "MOST", 3000 * 2.5)
    found = loop.validate(0.05)
    assert np.isnan(found.radius) and np.isnan(found.nrmse) and np.isnan(found.direction).all()
    assert "evaluations" in found.message and found.message in str(found)


def test_a_size_at_which_the_run_diverges_leaves_the_order_and_the_radius():
    loop = mfc.ClosedLoop(UR5, mfc.laws.JointPID(400, 200, 60), mfc.trajectories.Hold(Q))
    found = loop.validate(time=0.1, size=1e5)
    assert found.nrmse == np.inf and "up to 10000" in found.message and found.message in str(found)
    assert abs(found.taylor_order - 2.0) < 0.2 and 0 < found.radius < 3 and np.isnan(found.nonlinear).all() and np.isfinite(found.linear).all()


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


def test_runs_on_a_one_sided_surface_in_two_processes_give_the_same_numbers():
    """Each run makes and loses contact by itself, so they are not integrated together."""
    wall = mfc.Environment(1e4, 50.0, pose=UR5.pose(Q), axes="z", preload=10.0, one_sided=True)
    law = mfc.laws.HybridMotionForce([0, 0, 10, 0, 0, 0], 100, None, 20, 0.5, 2.0, 30, constraints=np.eye(6)[[2]])
    loop = mfc.ClosedLoop(UR5, law, mfc.trajectories.ToolHold(UR5.pose(Q)), q_start=Q, environment=wall)
    one, two = loop.validate(0.1, 1e-4), loop.validate(0.1, 1e-4, n_jobs=2)
    assert 0 < one.radius < np.inf
    assert (two.radius, two.nrmse, two.taylor_order) == (one.radius, one.nrmse, one.taylor_order)
    assert np.array_equal(two.direction, one.direction) and np.array_equal(two.nonlinear, one.nonlinear)
    with pytest.raises(BadArgument, match="n_jobs"):
        loop.validate(0.1, n_jobs=0)
