"""Limits at which requirements are just met: closed forms, both sides of each limit by ``check``, and the first loss from the value given."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.design.edges import Judge, first_edge, requirement_limit
from mfc_analysis.design.searches import Outcome
from mfc_analysis.errors import BadArgument
from tests.design.test_limits import KDAMP, KFI, KFP, M, T, pressing, velocity_p
from tests.test_arms import pose

PHASE = mfc.Requirements(phase_deg=60.0)


def status(requirements: mfc.Requirements, loop: mfc.ClosedLoop, times=(0.0,), at=None) -> str:
    return requirements.check(loop, times, at).status.value


# --- the search --------------------------------------------------------------------------------------------------------------


def test_the_first_loss_from_the_value_given_is_found_where_it_is_met_again_beyond():
    edge = first_edge(lambda x: (x - 2.0) * (x - 5.0) * (x - 6.0) * -1.0, 5.5, [5.8, 6.5, 8.0], [4.0])
    assert edge.holds == pytest.approx(6.0, rel=2e-5) and edge.holds < 6.0 <= edge.lost and math.isnan(edge.start)


def test_where_it_fails_as_given_the_nearest_easier_value_is_found():
    edge = first_edge(lambda x: 3.0 - x, 4.0, [5.0], [3.5, 3.2, 2.9, 2.0])
    assert edge.holds == pytest.approx(3.0, rel=2e-5) and edge.holds <= 3.0 < edge.lost


def test_a_harder_value_may_be_the_one_that_meets_and_nowhere_is_said():
    def between(x):
        return min(x - 3.0, 7.0 - x)

    edge = first_edge(between, 1.0, [2.0, 4.0, 6.0, 9.0], [0.5], other=True)
    assert edge.holds == pytest.approx(7.0, rel=2e-5) and edge.start == pytest.approx(3.0, rel=2e-5)
    assert math.isnan(first_edge(between, 1.0, [2.0, 4.0], [0.5]).holds)


def test_a_distance_that_jumps_is_bisected():
    edge = first_edge(lambda x: 0.4 if x < math.pi else -math.inf, 1.0, [2.0, 4.0], [])
    assert edge.holds < math.pi <= edge.lost and edge.lost - edge.holds < 1.1e-5 * math.pi


# --- closed forms ------------------------------------------------------------------------------------------------------------


def test_dead_time_takes_the_phase_of_velocity_p():
    """L = k e^(-s T) / s crosses over at k: the phase margin is 90 deg - k T."""
    k = 5.0
    for given in (0.0, 0.02, 0.2):
        found = design.max_delay(velocity_p(k, delay=given), requirements=PHASE)
        assert float(found) == pytest.approx(math.radians(30.0) / k, rel=1e-5)
        assert found.binding.name == "phase_deg" and found.binding.where == "joint" and found.binding.when == 0.0
        assert found.pose == {"joint": pytest.approx(0.3)}
    assert any("missed at 0.2 s, as given: phase margin is missed" in note for note in found.notes)


def test_a_payload_of_the_pressing_mass_ends_where_its_gain_margin_does():
    """The characteristic polynomial with L at the force sensor times g: both force gains times g, and the limit of the mass is a closed form."""
    g = 1.2
    req = mfc.Requirements(gain_increase_db=20 * math.log10(g))
    law = (KDAMP * (1 + g * KFP) - 1e3 * T * g * KFP * (1 + g * KFP)) / (g * KFI)
    assert law > M
    found = design.max_payload(pressing(torque_lag=T), requirements=req, at="force")
    assert float(found) == pytest.approx(law - M, rel=1e-3)


def test_requirements_bind_before_stability_and_without_any_the_edge_is_that_of_stability():
    loop = pressing(torque_lag=T)
    edge = design.max_stiffness(loop)
    assert float(design.max_stiffness(loop, requirements=mfc.Requirements())) == pytest.approx(float(edge), rel=2e-5)
    inside = design.max_stiffness(loop, requirements=mfc.Requirements(gain_increase_db=3.0), at="force")
    assert 1e3 < inside < edge and inside.binding.name == "gain_increase_db" and edge.binding.name == "stable"
    assert edge.pose == {"slide": 0.0}


def test_the_slowest_sampling_from_a_continuous_loop_and_from_a_sampled_one():
    """Velocity P under a hold: z - 1 + k T, gain margin 2/(k T)."""
    k, req = 5.0, mfc.Requirements(gain_increase_db=20 * math.log10(4.0))
    for given in (None, 1e-3, 0.3):
        found = design.min_sample_rate(velocity_p(k, sample_time=given), requirements=req)
        assert float(found) == pytest.approx(2 * k, rel=1e-5)


# --- both sides, on arms -----------------------------------------------------------------------------------------------------


def wall(loop: mfc.ClosedLoop, k: float) -> mfc.ClosedLoop:
    surface = mfc.Environment(k, axes="z", preload=10.0)
    return mfc.ClosedLoop(loop.robot, loop.law, loop.ref, loop.controller_model, surface, loop.q_start, loop.hardware)


ARMS = [("panda", {"delay": 1e-3}), ("xarm7", {"torque_lag": 2e-3, "sample_time": 2e-3}), ("ur10", {"torque_lag": 4e-3})]


@pytest.mark.parametrize(("arm", "hardware"), ARMS)
def test_one_per_cent_within_is_met_and_one_beyond_is_not(arm, hardware):
    robot = mfc.robots.load(arm).with_armature(0.3)
    q = pose(robot, np.random.default_rng(11))
    law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(3.0)))
    req = mfc.Requirements(phase_deg=30.0, gain_increase_db=3.0, gain_reduction_db=3.0, sensitivity_peak=3.0)

    def loop(payload=0.0, **changes):
        return mfc.ClosedLoop(
            robot.with_payload(payload), law, mfc.trajectories.Hold(q), controller_model=robot, hardware=mfc.Hardware(**(hardware | changes))
        )

    judged = []
    for search, make, better in (
        (design.max_payload, lambda x: loop(payload=x), 0.99),
        (design.max_delay, lambda x: loop(delay=x), 0.99),
        (design.min_sample_rate, lambda x: loop(sample_time=1 / x), 1.01),
    ):
        found = search(loop(), requirements=req)
        assert found.outcome is Outcome.FOUND and list(found.pose) == list(robot.joint_names)
        assert list(found.pose.values()) == pytest.approx(q.tolist())
        judged.append([status(req, make(factor * found)) for factor in (better, 2 - better)])
        assert req.check(make((2 - better) * found), [0.0]).worst.name == found.binding.name
    assert judged == [["PASS", "FAIL"]] * 3


def test_a_wall_on_an_arm_one_per_cent_either_way():
    robot = mfc.robots.load("kinova").with_armature(0.2)
    q = pose(robot, np.random.default_rng(4))
    law = mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], kfp=0.5, kfi=2.0, kdamp=10.0)
    bare = mfc.ClosedLoop(robot.with_friction(viscous=5.0), law, mfc.trajectories.Hold(q), hardware=mfc.Hardware(torque_lag=2e-3, delay=1e-3))
    req = mfc.Requirements(gain_increase_db=6.0)
    found = design.max_stiffness(wall(bare, 1e3), requirements=req, at="force")
    assert found.outcome is Outcome.FOUND
    assert [status(req, wall(bare, factor * found), at="force") == "FAIL" for factor in (0.99, 1.01)] == [False, True]


def test_along_a_path_the_worst_pose_is_named():
    robot = mfc.robots.ur5()
    ref = mfc.trajectories.Quintic(np.array([0.0, -1.0, 1.4, -1.9, -1.57, 0.0]), np.array([1.0, -1.4, 1.7, -2.0, -1.5, 0.5]), 2.0)
    loop = mfc.ClosedLoop(
        robot, mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(4.0))), ref, robot, hardware=mfc.Hardware(torque_lag=2e-3)
    )
    times = np.linspace(0.0, 2.0, 5)
    found = design.max_payload(loop, requirements=mfc.Requirements(phase_deg=45.0), times=times)
    assert found.binding.when in times and list(found.pose.values()) == pytest.approx(ref(found.binding.when).q.tolist())
    again = pickle.loads(pickle.dumps(found))
    assert again.pose == found.pose and again.binding == found.binding and float(again) == float(found)


# --- as given, nowhere, always -----------------------------------------------------------------------------------------------


def test_a_payload_that_is_too_heavy_as_given_is_reduced():
    robot = mfc.robots.ur5()
    law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(6.0)))
    q = [0.0, -1.2, 1.5, -0.8, 1.57, 0.0]
    req = mfc.Requirements(phase_deg=50.0)

    def loop(payload):
        return mfc.ClosedLoop(robot.with_payload(payload), law, mfc.trajectories.Hold(q), robot, hardware=mfc.Hardware(torque_lag=4e-3))

    up, down = design.max_payload(loop(0.0), requirements=req), design.max_payload(loop(5.0), requirements=req)
    assert up > 0 > down and 5.0 + down == pytest.approx(float(up), rel=1e-4)
    assert "missed at 0 kg, as given: phase margin" in down.notes[0]


def test_no_value_and_every_value():
    never = design.max_delay(velocity_p(delay=0.01), requirements=mfc.Requirements(phase_deg=91.0))
    assert never == 0.0 and never.outcome is Outcome.NOWHERE and "no value from 0 to 0.01 s meets the requirements" in never.binds
    assert never.binding.name == "phase_deg"
    always = design.max_payload(velocity_p(), requirements=PHASE)
    assert math.isinf(always) and always.binding is None and always.pose == {}
    slow = design.min_sample_rate(velocity_p(), requirements=mfc.Requirements(phase_deg=91.0))
    assert math.isinf(slow) and slow.binds.startswith("there is no easier value; as given phase margin is missed")


def test_a_loop_that_drifts_meets_them_with_a_note():
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kfi=3.0, kdamp=20.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.0]))
    found = design.max_delay(loop, requirements=mfc.Requirements(delay=0.01))
    assert float(found) == pytest.approx(math.pi / 40 - 0.01, rel=1e-4)
    assert any(note.startswith("WATCH at the limit: stable, drifts") for note in found.notes)


def test_loops_are_judged_once_and_several_together():
    judge = Judge(PHASE, np.zeros(1))
    slow, fast = velocity_p(5.0), velocity_p(5.0, delay=0.05)
    assert judge.worst([slow, fast])[1] is fast and judge.distance(fast) == judge.distance(fast) and judge.count == 2
    found = requirement_limit(lambda w: [velocity_p(w), velocity_p(w, delay=0.01)], "bandwidth", 1.0, Judge(PHASE, np.zeros(1)), lower=0.1, upper=1e3)
    assert float(found) == pytest.approx(math.radians(30.0) / 0.01, rel=1e-5)


def test_from_a_nominal_bandwidth_the_search_starts_there():
    def make(w):
        return velocity_p(w, delay=0.01)

    limit = math.radians(30.0) / 0.01
    few = design.max_bandwidth(make, PHASE, [0.0], nominal=40.0)
    assert float(few) == pytest.approx(limit, rel=1e-5) and few.evaluations < design.max_bandwidth(make, PHASE, [0.0]).evaluations
    above = design.max_bandwidth(make, PHASE, [0.0], nominal=100.0)
    assert float(above) == pytest.approx(limit, rel=1e-5) and "missed at 100 rad/s, as given" in above.notes[0]
    with pytest.raises(BadArgument, match="nominal"):
        design.max_bandwidth(make, PHASE, [0.0], nominal=1e5)


@pytest.mark.parametrize("search", [design.max_delay, design.max_payload, design.min_sample_rate])
def test_bad_arguments_are_named(search):
    with pytest.raises(BadArgument, match="requirements"):
        search(velocity_p(), requirements={"phase_deg": 45})
    with pytest.raises(BadArgument, match="at"):
        search(velocity_p(), at="velocity")
    with pytest.raises(BadArgument, match="upper"):
        design.max_stiffness(pressing(stiffness=1e3), 1e2, requirements=PHASE)
