"""Gains that meet all requirements: closed forms and brute force, ranges, what binds, and what one more hertz would break."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.design.edges import Judge
from mfc_analysis.design.tuning import RESERVE
from mfc_analysis.errors import BadArgument
from tests.design.test_limits import velocity_p

PHASE = mfc.Requirements(phase_deg=60.0)


def late(bandwidth: float, delay: float = 0.01) -> mfc.ClosedLoop:
    return velocity_p(bandwidth, delay=delay)


def pd(bandwidth: float, damping: float) -> mfc.ClosedLoop:
    law = mfc.laws.ComputedTorque(**mfc.gains.pd(bandwidth=bandwidth, damping=damping))
    return mfc.ClosedLoop(mfc.robots.single_joint(damping=0.0), law, mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(delay=0.01))


def test_one_gain_ends_at_the_closed_form_of_the_latest_case():
    """Velocity P with dead time T: 90 deg - k T, and the reserve of 0.1 % of 60 deg is kept."""
    found = design.tune(late, {"bandwidth": (1.0, 300.0)}, PHASE, ranges={"delay": [0.002, 0.01]})
    assert found.met and found.gains["bandwidth"] == pytest.approx(math.radians(30.0 - 60.0 * RESERVE) / 0.01, rel=3e-4)
    assert found.case == {"delay": 0.01} and [line.name for line in found.binding] == ["phase_deg"]
    assert found.more["bandwidth"] == pytest.approx(found.speed + 2 * math.pi) and [line.name for line in found.breaks] == ["phase_deg"]
    assert found.breaks[0].found == pytest.approx(90 - math.degrees(found.more["bandwidth"] * 0.01))


def test_pd_with_dead_time_is_as_fast_as_brute_force_finds():
    req = mfc.Requirements(phase_deg=50.0, sensitivity_peak=1.8)
    found = design.tune(pd, {"damping": (0.5, 2.0), "bandwidth": (1.0, 300.0)}, req)
    judge = Judge(req, np.zeros(1))
    assert judge.distance(found.loop) >= 0
    near = [(b, d) for d in np.linspace(1.2, 1.8, 7) for b in found.gains["bandwidth"] * np.array([1.01, 1.03])]
    assert all(judge.distance(pd(b, d)) < 0 for b, d in near)  # nothing faster by 1 % within reach of the optimum
    assert {line.name for line in found.binding} == {"phase_deg", "sensitivity_peak"}  # the optimum is where they meet
    assert str(pickle.loads(pickle.dumps(found))) == str(found)
    names: dict = {}
    exec(found.replay, names)
    assert np.allclose(names["loop"].linearize().A, found.loop.linearize().A, rtol=1e-12)


def test_the_gains_of_a_law_are_tuned_by_the_crossover():
    """JointPID on an inertia with a lag: kp and kd in their bounds, met, and no faster ones on a grid."""

    def build(kp: float, kd: float) -> mfc.ClosedLoop:
        robot = mfc.robots.single_joint(inertia=0.5, mass=0.0, damping=0.0)
        return mfc.ClosedLoop(robot, mfc.laws.JointPID(kp, kd=kd), mfc.trajectories.Hold([0.0]), hardware=mfc.Hardware(torque_lag=5e-3))

    found = design.tune(build, {"kp": (1.0, 400.0), "kd": (0.5, 100.0)}, PHASE)
    judge = Judge(PHASE, np.zeros(1))
    assert found.met and judge.distance(found.loop) >= 0
    fastest = math.tan(math.radians(30.0)) / 5e-3  # 90 - atan(5e-3 w) - atan(kp / (kd w)) = 60 deg with kp = 0
    assert 0.985 * fastest < found.speed < fastest


def test_a_wanted_bandwidth_is_kept_where_it_is_met_and_else_the_nearest_is_found():
    bounds = {"bandwidth": (1.0, 300.0)}
    assert design.tune(late, bounds, PHASE, wanted=20.0).gains == {"bandwidth": 20.0}
    assert design.tune(late, bounds, PHASE).gains == design.tune(late, bounds, PHASE).gains
    high = design.tune(late, bounds, PHASE, wanted=100.0)
    assert high.met and high.gains["bandwidth"] == pytest.approx(math.radians(30.0) / 0.01, rel=5e-3)
    damped = design.tune(pd, {"bandwidth": (1.0, 100.0), "damping": (0.5, 2.0)}, PHASE, wanted=30.0)
    assert damped.gains["bandwidth"] == 30.0 and damped.met


def test_a_ten_times_finer_path_and_range_pass_too():
    arm = mfc.robots.ur5()
    ref = mfc.trajectories.Quintic(np.array([0.0, -1.0, 1.4, -1.9, -1.57, 0.0]), np.array([1.0, -1.4, 1.7, -2.0, -1.5, 0.5]), 2.0)

    def build(bandwidth: float, payload: float) -> mfc.ClosedLoop:
        law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=bandwidth))
        return mfc.ClosedLoop(arm.with_payload(payload), law, ref, arm, hardware=mfc.Hardware(torque_lag=4e-3))

    req = mfc.Requirements(phase_deg=40.0, gain_increase_db=6.0)
    found = design.tune(build, {"bandwidth": (1.0, 300.0)}, req, np.linspace(0, 2, 5), ranges={"payload": [0.0, 1.5, 3.0]})
    fine = Judge(req, np.linspace(0, 2, 41))
    assert found.met and all(fine.distance(build(found.gains["bandwidth"], p)) >= 0 for p in np.linspace(0.0, 3.0, 7))
    assert fine.distance(build(1.01 * found.gains["bandwidth"], found.case["payload"])) < 0


def test_where_nothing_meets_them_the_least_missed_is_returned():
    found = design.tune(late, {"bandwidth": (60.0, 300.0)}, PHASE)
    assert not found.met and found.gains["bandwidth"] == pytest.approx(60.0) and [line.name for line in found.binding] == ["phase_deg"]
    assert "no gains within the bounds meet the requirements" in str(found) and "missed: phase margin" in str(found)
    free = design.tune(late, {"bandwidth": (1.0, 10.0)}, PHASE)
    assert free.met and free.gains == {"bandwidth": 10.0} and free.binding == () and "nothing binds" in str(free)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"gains": {}}, "gains"),
        ({"gains": {"bandwidth": (2.0, 1.0)}}, "gains"),
        ({"gains": {"bandwidth": (0.0, 1.0)}}, "gains"),
        ({"wanted": -1.0}, "wanted"),
        ({"start": {"kp": 1.0}}, "start"),
        ({"ranges": {"delay": []}}, "ranges"),
        ({"requirements": 3}, "requirements"),
        ({"make_loop": 3}, "make_loop"),
        ({"make_loop": lambda bandwidth: bandwidth}, "make_loop"),
    ],
)
def test_bad_arguments_are_named(given, named):
    usual = {"make_loop": late, "gains": {"bandwidth": (1.0, 2.0)}, "requirements": PHASE}
    with pytest.raises(BadArgument, match=named):
        design.tune(**(usual | given))
    with pytest.raises(BadArgument, match="wanted"):
        design.tune(late, {"delay": (0.1, 0.2)}, PHASE, wanted=3.0)
