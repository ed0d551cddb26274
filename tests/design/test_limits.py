"""Searches against closed forms, from both sides of each limit."""

import math
import pickle
import re

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.design.limits import with_stiffness
from mfc_analysis.design.searches import Outcome
from mfc_analysis.design.stiffness import at_stiffness
from mfc_analysis.dynamics.environment import stiffened
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.simulation.settling import settles
from tests.conftest import regular_pose
from tests.test_arms import loops

T, M, KDAMP, KFP, KFI = 5e-3, 2.0, 40.0, 2.0, 3.0
K_MAX = (KDAMP * (1 + KFP) - M * KFI) / (T * KFP * (1 + KFP))


def pressing(mass: float = M, stiffness: float = 1e3, kdamp: float = KDAMP, kfi: float | None = KFI, pose=None, preload: float = 5.0, **hardware):
    return mfc.ClosedLoop(
        mfc.robots.slider(mass=mass),
        mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=KFP, kfi=kfi, kdamp=kdamp),
        mfc.trajectories.Hold([0.0]),
        environment=mfc.Environment(stiffness, preload=preload, pose=pose),
        hardware=mfc.Hardware(**hardware) if hardware else None,
    )


def velocity_p(k: float = 5.0, **hardware):
    return mfc.ClosedLoop(
        mfc.robots.single_joint(), mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(**hardware) if hardware else None
    )


# --- stiffness -------------------------------------------------------------------------------------------------------


def test_the_largest_stiffness_of_one_mass_with_a_lag_is_the_closed_form():
    found = design.max_stiffness(pressing(torque_lag=T))
    assert float(found) == pytest.approx(K_MAX, rel=1e-5)
    assert found.outcome is Outcome.FOUND and "slide" in found.binds and found.unit == "N/m"


def test_the_largest_stiffness_with_friction_and_damping_is_the_root_of_the_quartic():
    b, c = 0.7, 1.5
    robot = mfc.robots.slider(mass=M, friction=b)
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=KFP, kfi=KFI, kdamp=KDAMP)
    loop = mfc.ClosedLoop(
        robot, law, mfc.trajectories.Hold([0.0]), environment=mfc.Environment(1e3, damping=c, preload=5.0), hardware=mfc.Hardware(torque_lag=T)
    )
    k = float(design.max_stiffness(loop))

    def growth(k):  # m T s^4 + (m + (b + c) T) s^3 + ..., with the damper's force fed back as well
        p = [M * T, M + (b + c) * T, b + KDAMP + k * T + c * (1 + KFP), k * (1 + KFP) + c * KFI, k * KFI]
        return np.roots(p).real.max()

    assert growth(0.99999 * k) < 0 < growth(1.00001 * k)


def test_the_loop_on_the_limit_is_stable_and_the_one_beyond_is_not():
    found = design.max_stiffness(pressing(torque_lag=T))
    assert found.loop.linearize([0.0]).stable.all()
    assert not found.beyond.linearize([0.0]).stable.any()
    for factor, holds in ((0.99, True), (1.01, False)):
        assert pressing(stiffness=factor * found, torque_lag=T).linearize([0.0]).stable.all() == holds


def test_an_ideal_loop_does_not_care_about_the_stiffness():
    found = design.max_stiffness(pressing())
    assert math.isinf(found) and found.outcome is Outcome.UNLIMITED


@pytest.mark.parametrize("part", [0.99, 1.01])
def test_a_passive_loop_says_why_no_stiffness_is_too_large(part: float):
    """Re Z = (kd - kp T)/(1 + T^2 w^2): passive up to a lag of T = kd/kp."""
    loop = mfc.ClosedLoop(
        mfc.robots.slider(M), mfc.laws.JointPID(300.0, None, 20.0), mfc.trajectories.Hold([0.0]), environment=mfc.Environment(100.0, preload=5.0),
        hardware=mfc.Hardware(torque_lag=part * 20.0 / 300.0),
    )  # fmt: skip
    found = design.max_stiffness(loop, upper=1e9)
    assert any("passive at the tool" in note for note in found.notes) == math.isinf(found) == (part < 1)


def test_without_its_stiffness_the_loop_is_judged_under_the_same_force():
    """The force alone turns with the tool: it stays in the linear loop, which is the limit of those on ever softer surfaces."""
    robot, q = mfc.robots.ur5(), regular_pose("ur5")
    wall = mfc.Environment(2e3, damping=5.0, pose=robot.pose(q) @ exp6(np.array([0.0, 0.0, 2e-3, 0.1, -0.2, 0.3])), axes="z", preload=20.0)
    loop = mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(100.0, None, 20.0), mfc.trajectories.Hold(q), environment=wall)
    stiffer, _ = with_stiffness(loop)
    nominal = loop.nominal([0.0])
    slots = {"q": nominal.q, "v": nominal.v}
    forces = [one.equations.touch(slots).wrench for one in (loop, stiffer(0.0))]
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-12)
    soft, none = (stiffer(k).linearize().A for k in (1e-6, 0.0))
    np.testing.assert_allclose(soft, none, atol=1e-5)
    assert np.abs(none - mfc.ClosedLoop(robot, loop.law, loop.ref).linearize().A).max() > 0.1


def test_an_undamped_integrating_wall_is_unstable_whatever_its_stiffness():
    found = design.max_stiffness(pressing(kdamp=0.0))
    assert float(found) == 0.0 and found.outcome is Outcome.NOWHERE


def test_upper_is_where_the_search_ends():
    assert math.isinf(design.max_stiffness(pressing(torque_lag=T), upper=0.99 * K_MAX))
    assert float(design.max_stiffness(pressing(torque_lag=T), upper=1.01 * K_MAX)) == pytest.approx(K_MAX, rel=1e-5)


def test_the_force_at_the_reference_stays_what_it_is():
    X = np.eye(4)
    X[2, 3] = -2e-3  # the tool is 2 mm inside: 2 N and the preload of 3 N
    loop = pressing(torque_lag=T, pose=X, preload=3.0)
    found = design.max_stiffness(loop)
    assert float(found) == pytest.approx(K_MAX, rel=1e-5)
    for one in (loop, found.loop, found.beyond):
        assert one.equations.flow(0.0, np.zeros(one.equations.nx)).F_tip[2] == pytest.approx(5.0, rel=1e-9)


@pytest.mark.parametrize("axes", ["xyz", "zrz"])
def test_stiffness_is_scaled_in_proportion_and_the_wrench_kept(axes):
    robot, q = mfc.robots.ur5(), np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])
    X = robot.pose(q)
    pose = X @ mfc.robots.ur5().pose(np.zeros(6)) @ np.linalg.inv(mfc.robots.ur5().pose(np.full(6, 1e-2)))
    surface = mfc.Environment(np.arange(1.0, len(axes.replace("r", "")) + 1) * 100, axes=axes, preload=4.0, pose=pose)
    stiffer = stiffened(surface, 5e3, X)
    assert np.allclose(stiffer.K * surface.K[:3, :3].max(), surface.K * 5e3)

    def wrench(s):
        loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(100.0, kd=10.0), mfc.trajectories.Hold(q), environment=s)
        return loop.equations.flow(0.0, np.concatenate([q, np.zeros(6)])).F_tip

    assert np.allclose(wrench(stiffer), wrench(surface), rtol=1e-9, atol=1e-9) and np.abs(wrench(surface)).max() > 1


def test_only_preloaded_surfaces_are_varied():
    loop = pressing(torque_lag=T)
    soft = mfc.Environment(10.0)
    both = mfc.ClosedLoop(loop.robot, loop.law, loop.ref, environment=[loop.environment, soft], hardware=loop.hardware)
    found = design.max_stiffness(both)
    assert found.loop.environment[1].K[2, 2] == 10.0
    assert float(found) == pytest.approx(K_MAX - 10.0, rel=1e-5)  # two springs in parallel, both sensed


def test_a_loop_without_an_environment_is_refused():
    with pytest.raises(BadArgument, match="environment"):
        design.max_stiffness(velocity_p())


# --- dead time, sampling, payload ------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.5, 5.0, 80.0])
def test_velocity_p_survives_a_dead_time_of_pi_over_2k(k):
    found = design.max_delay(velocity_p(k))
    assert float(found) == pytest.approx(math.pi / (2 * k), rel=1e-5)
    for factor, holds in ((0.999, True), (1.001, False)):
        assert velocity_p(k, delay=factor * found).linearize([0.0]).stable.all() == holds


@pytest.mark.parametrize("k", [0.5, 5.0, 80.0])
def test_sampled_velocity_p_needs_a_rate_of_half_k(k):
    found = design.min_sample_rate(velocity_p(k))
    assert float(found) == pytest.approx(k / 2, rel=1e-5)
    for factor, holds in ((0.999, True), (1.001, False)):
        assert velocity_p(k, sample_time=factor / found).linearize([0.0]).stable.all() == holds


def test_a_light_joint_needs_a_rate_above_the_usual_ones_and_ranges_are_rates():
    """PD on an inertia I under a zero-order hold: (z - 1)^2 + (kd T/I)(z - 1) + (kp T^2/2I)(z + 1) has its root at z = -1 where T = 2 I/kd."""
    robot = mfc.robots.single_joint(inertia=2.216e-5, mass=0.0, damping=0.0)
    loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(200.0, kd=5.0), mfc.trajectories.Hold([0.0]))
    found = design.min_sample_rate(loop)
    assert float(found) == pytest.approx(5.0 / (2 * 2.216e-5), rel=1e-6) and found > 1e5
    assert [found.loop.linearize().stable[0], found.beyond.linearize().stable[0]] == [True, False]
    within = design.min_sample_rate(loop, upper=1e5)
    assert math.isinf(within) and within.outcome is Outcome.NOWHERE
    assert within.binds.startswith(
        "above the upper end of the search, 100000 1/s: not stable from 0.1 to 100000 1/s; joint 1 (joint) at t = 0 s: z = "
    )
    far = design.min_sample_rate(loop, lower=2e5, upper=1e6)
    assert far == 0.0 and far.binds == "stable down to 200000 1/s"


@pytest.mark.parametrize("k", [2.0, 8.0])
def test_a_sampled_arm_has_a_largest_dead_time_of_hundreds_of_samples(k):
    """u(j) = k e(j - d) with d samples of dead time: z^d (z - 1) + k h has roots on the circle where k h = 2 sin(pi / (4 d + 2))."""
    q, h = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0]), 1e-3
    loop = mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.VelocityP(k), mfc.trajectories.Hold(q), hardware=mfc.Hardware(sample_time=h))
    found = design.max_delay(loop)
    whole = (math.pi / math.asin(k * h / 2) - 2) / 4  # the limit in samples, where it is whole
    assert abs(float(found) / h - whole) < 1e-2 and found.outcome is Outcome.FOUND
    assert found.binding.name == "stable" and found.binding.when == 0.0 and found.loop.linearize().stable.all()


def test_the_search_for_a_dead_time_ends_at_2000_samples():
    found = design.max_delay(velocity_p(0.5, sample_time=1e-3))  # the limit is pi s
    assert math.isinf(found) and found.binds == "stable up to 2 s"
    servo = mfc.Servo(bandwidth=50.0, delay=0.02)
    assert design.max_delay(velocity_p(0.5, sample_time=1e-3, servo=servo)).binds == "stable up to 1.98 s"


@pytest.mark.parametrize("delay", [0.025, 0.1])
def test_a_sample_rate_is_found_behind_a_long_dead_time(delay):
    found = design.min_sample_rate(velocity_p(2.0, delay=delay))
    assert found.outcome is Outcome.FOUND and found < 2.0
    assert [found.loop.linearize().stable[0], found.beyond.linearize().stable[0]] == [True, False]


def test_an_unstable_loop_with_dead_time_is_stable_at_no_sample_rate():
    q = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])
    loop = mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.VelocityP(200.0), mfc.trajectories.Hold(q), hardware=mfc.Hardware(delay=0.019))
    found = design.min_sample_rate(loop)
    assert math.isinf(found) and found.outcome is Outcome.NOWHERE and found.binds.startswith("not stable from 0.1 to 105263 1/s")


def test_the_largest_dead_time_is_the_delay_margin_of_a_single_loop():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.ComputedTorque(kp=100.0, ki=100.0, kd=20.0), mfc.trajectories.Hold([0.3]))
    assert float(design.max_delay(loop)) == pytest.approx(loop.linearize([0.0]).margins().delay[0, 0], rel=1e-5)


CONFIRMED = {
    "dead time": (design.max_delay, lambda x: velocity_p(delay=x), velocity_p, 60.0),
    "sample time": (design.min_sample_rate, lambda x: velocity_p(sample_time=1 / x), velocity_p, 60.0),
    "payload": (design.max_payload, lambda x: pressing(mass=M + x, torque_lag=T), lambda: pressing(torque_lag=T), 25.0),
    "stiffness": (design.max_stiffness, lambda x: pressing(stiffness=x, torque_lag=T), lambda: pressing(torque_lag=T), 4.0),
}


@pytest.mark.parametrize("name", CONFIRMED)
def test_limits_are_confirmed_by_simulation_from_both_sides(name):
    search, make, loop, duration = CONFIRMED[name]
    limit = float(search(loop()))
    better = 1.01 if name == "sample time" else 0.99
    for factor, holds in ((better, True), (2 - better, False)):
        run = make(factor * limit).simulate(np.linspace(0, duration, 3000), initial_error=1e-3)
        assert settles(run.t, run.error) == holds


def test_the_largest_payload_of_the_pressing_mass_is_the_closed_form():
    limit = (KDAMP * (1 + KFP) - 1e3 * T * KFP * (1 + KFP)) / KFI  # mass at which 1e3 N/m is the largest stiffness
    found = design.max_payload(pressing(torque_lag=T))
    assert float(found) == pytest.approx(limit - M, rel=1e-5)


def test_the_controller_does_not_know_of_the_payload():
    robot = mfc.robots.ur5()
    loop = mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(kp=100.0, ki=900.0, kd=20.0), mfc.trajectories.Hold(np.full(6, 0.5)))
    found = design.max_payload(loop)
    assert found.loop.equations.model is robot and found.loop.robot.payloads[-1].mass == float(found)
    known = mfc.ClosedLoop(found.beyond.robot, loop.law, loop.ref)
    assert not found.beyond.linearize([0.0]).stable.any() and known.linearize([0.0]).stable.all()


def test_a_payload_that_the_arm_does_not_hold_at_its_reference_is_noted():
    """Without an integral the arm sags away from the reference at which its roots are judged; with one it does not."""
    hold = mfc.trajectories.Hold(np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0]))

    def notes(ki):
        loop = mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.ComputedTorque(kp=100.0, ki=ki, kd=20.0), hold, hardware=mfc.Hardware(torque_lag=2e-3))
        found = design.max_payload(loop, 20.0)
        return [note for note in found.notes if note.startswith("WATCH at the limit: error at rest")]

    assert len(notes(None)) == 1 and "does not stay at its operating point" in notes(None)[0]
    assert notes(50.0) == []


def test_a_loop_that_is_unstable_as_it_is_has_no_room_at_all():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 100.0, 2.0), mfc.trajectories.Hold([0.3]))
    for search in (design.max_delay, design.max_payload):
        found = search(loop)
        assert float(found) == 0.0 and found.outcome is Outcome.NOWHERE and "not stable as given" in found.binds
    found = design.min_sample_rate(loop)
    assert math.isinf(found) and found.binds.startswith("not stable from 0.1 to 1e+09 1/s")


def test_a_drifting_loop_is_judged_by_its_other_roots():
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kfi=3.0, kdamp=20.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.0]))  # m v' = -kdamp v
    found = design.max_delay(loop)
    assert float(found) == pytest.approx(math.pi / 2 / 20.0, rel=1e-5)
    assert any("drifts" in note for note in found.notes)


def test_an_island_says_that_stiffer_walls_hold_again():
    loop = next(loop for name, _, loop in loops("ur3", 50, ["friction"]) if name == "9.23 on xyz")
    found = design.max_stiffness(loop, 1e3)
    assert found == pytest.approx(3.2460, rel=1e-4) and "also not stable" in str(found)
    again = float(re.findall(r"stable again at (\S+) N/m", str(found))[0])
    holds = [at_stiffness(loop, k).linearize().stability.nonzero_stable[0] for k in (3.2, 3.3, 0.74 * again, again)]
    assert holds == [True, False, False, True]


def test_a_moving_reference_is_judged_along_its_path():
    robot = mfc.robots.ur5()
    ref = mfc.trajectories.Quintic(np.full(6, 0.5), np.full(6, 1.0), 1.0)
    loop = mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(kp=100.0, ki=300.0, kd=20.0), ref, controller_model=robot)
    along = design.max_payload(loop, times=np.linspace(0, 1, 5))
    each = [float(design.max_payload(loop, times=[t])) for t in (0.0, 0.5, 1.0)]
    assert float(along) <= min(each) * (1 + 1e-6)


# --- the search itself -----------------------------------------------------------------------------------------------


def test_results_are_floats_that_say_what_binds_and_pickle():
    found = design.max_stiffness(pressing(torque_lag=T))
    assert isinstance(found, float) and found > 1.0 and np.isfinite(found)
    again = pickle.loads(pickle.dumps(found))
    assert float(again) == float(found) and str(again) == str(found) and "3800 N/m" in str(found)


def test_the_loop_on_the_limit_can_be_made_again_from_its_code():
    found = design.max_stiffness(pressing(torque_lag=T))
    names: dict = {}
    exec(found.replay, names)
    assert np.allclose(names["loop"].linearize([0.0]).A, found.loop.linearize([0.0]).A, rtol=1e-12)


def test_progress_is_shown_when_asked_and_changes_nothing(capsys):
    assert float(design.max_stiffness(pressing(torque_lag=T), progress=True)) == float(design.max_stiffness(pressing(torque_lag=T)))


@pytest.mark.parametrize("search", [design.max_stiffness, design.max_delay, design.max_payload, design.min_sample_rate])
def test_bad_input_is_refused_by_name(search):
    with pytest.raises(BadArgument, match="loop"):
        search(3)
    with pytest.raises(BadArgument, match="upper"):
        search(pressing(), upper=-1.0)
    with pytest.raises(BadArgument, match="times"):
        search(pressing(), times=[1.0, 0.0])


# --- bandwidth -------------------------------------------------------------------------------------------------------


def lagging(w: float, lag: float = 5e-3):
    return mfc.ClosedLoop(
        mfc.robots.single_joint(damping=0.0),
        mfc.laws.ComputedTorque(**mfc.gains.pd(natural_frequency=w, damping=1.0)),
        mfc.trajectories.Hold([0.3]),
        hardware=mfc.Hardware(torque_lag=lag),
    )


def test_one_per_cent_more_bandwidth_misses_the_requirement_that_binds():
    req = mfc.Requirements(phase_deg=50, sensitivity_peak=2.0, settling_time=1.0)
    found = design.max_bandwidth(lagging, req, [0.0], at="command")
    assert req.check(lagging(float(found)), [0.0], at="command").passed
    missed = req.check(lagging(1.01 * found), [0.0], at="command")
    assert missed.status == "FAIL" and missed.worst.name == found.binding.name == "phase_deg"
    assert "phase margin" in str(found) and found.binding.where == "joint"
    assert any("missed from" in note for note in found.notes)  # too slow to settle in time


def test_the_bandwidth_that_a_lag_allows_is_the_closed_form():
    """Velocity P with a first-order lag: L = k / (s (T s + 1)); 60 degrees where k sqrt(1 + (k' T)^2) = ..., solved for the crossover."""
    lag, phase = 0.02, 60.0

    def make(k):
        return velocity_p(k, velocity_lag=lag)

    crossover = math.tan(math.radians(90 - phase)) / lag
    k = crossover * math.sqrt(1 + (crossover * lag) ** 2)
    assert float(design.max_bandwidth(make, mfc.Requirements(phase_deg=phase), [0.0])) == pytest.approx(k, rel=1e-5)


def test_several_loops_have_to_meet_the_requirements_together():
    req = mfc.Requirements(phase_deg=50)
    alone = [float(design.max_bandwidth(lambda w, T=T: lagging(w, T), req, [0.0], at="command")) for T in (2e-3, 8e-3)]
    both = design.max_bandwidth(lambda w: [lagging(w, 2e-3), lagging(w, 8e-3)], req, [0.0], at="command")
    assert float(both) == pytest.approx(min(alone), rel=1e-6)


def test_requirements_that_nothing_meets_and_that_everything_meets():
    nothing = design.max_bandwidth(lambda w: velocity_p(w), mfc.Requirements(phase_deg=91), [0.0])
    assert float(nothing) == 0.0 and nothing.binding.name == "phase_deg"
    everything = design.max_bandwidth(lambda w: velocity_p(w), mfc.Requirements(phase_deg=89), [0.0], upper=100.0)
    assert math.isinf(everything) and everything.binding is None
    with pytest.raises(BadArgument, match="make_loop"):
        design.max_bandwidth(3, mfc.Requirements(phase_deg=45), [0.0])


def test_dead_time_of_a_sampled_loop_is_searched_between_whole_samples():
    """z^(d + 1) - z^d + k T: with k T = 0.5 two samples of dead time are stable (limit 0.618) and three are not (0.445)."""
    k, period = 5.0, 0.1
    found = design.max_delay(velocity_p(k, sample_time=period))
    assert 2 * period < found < 3 * period
    for factor, holds in ((0.999, True), (1.001, False)):
        assert velocity_p(k, sample_time=period, delay=factor * found).linearize([0.0]).stable.all() == holds


SERVO = mfc.Servo(bandwidth=50.0, delay=0.01)


@pytest.mark.parametrize("hardware", [{}, {"velocity_lag": 2e-3}, {"servo": SERVO}, {"sample_time": 0.01}], ids=str)
def test_dead_times_judged_together_give_the_limit_of_loops_judged_one_by_one(hardware, monkeypatch):
    from mfc_analysis.design import ahead

    found = []
    for count in (1, 3):
        monkeypatch.setattr(ahead, "TOGETHER", count)
        found.append(design.max_delay(velocity_p(**hardware)))
    one, three = found
    assert float(one) == float(three) and str(one) == str(three) and one.evaluations == three.evaluations > 20


def test_a_search_for_a_dead_time_counts_several_at_once(monkeypatch):
    from mfc_analysis.analysis import stability

    counted, true = [], stability.delayed_verdicts
    monkeypatch.setattr(stability, "delayed_verdicts", lambda system, known: counted.append(len(system.A)) or true(system, known))
    found = design.max_delay(velocity_p())
    assert found.evaluations > 20 and len(counted) < 0.6 * found.evaluations and max(counted) == 3
