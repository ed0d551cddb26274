"""The worst case over ranges: found on and between the grid, replayable, failures kept."""

import math

import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.errors import BadArgument, UnknownName
from tests.design.test_limits import velocity_p


def two_lags(gain: float, lag: float):
    return velocity_p(gain, velocity_lag=lag)


def test_the_worst_case_over_ranges_is_found_and_can_be_replayed():
    found = design.worst_case(two_lags, {"gain": (1.0, 5.0), "lag": (1e-3, 2e-2)}, [0.0], "phase_deg")
    assert found.case == {"gain": 5.0, "lag": 2e-2}
    assert float(found) == pytest.approx(two_lags(5.0, 2e-2).linearize([0.0]).margins().phase_deg[0, 0], rel=1e-12)
    names: dict = {}
    exec(found.replay.replace("print(", "verdict = ("), names)
    assert names["verdict"].line("phase_deg").found == pytest.approx(float(found), rel=1e-9)


def test_the_local_search_finds_a_worst_case_between_the_points_of_the_grid():
    def build(x):
        return velocity_p(5.0, velocity_lag=0.02 - 0.3 * (x - 0.37) ** 2 + 1e-9)

    found = design.worst_case(build, {"x": (0.2, 0.5)}, [0.0], "phase_deg", points=3)
    assert found.case["x"] == pytest.approx(0.37, abs=1e-3)


def test_an_unstable_case_is_worse_than_any_metric():
    def build(ki):
        return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, ki, 2.0), mfc.trajectories.Hold([0.3]))

    found = design.worst_case(build, {"ki": (0.1, 100.0)}, [0.0], "sensitivity_peak")
    assert not found.stable and math.isnan(float(found)) and found.rightmost > 0 and found.case["ki"] == pytest.approx(100.0)
    assert "not stable" in str(found) and f"(joint 1 (joint) at t = 0 s: root +{found.rightmost:.3g} ± " in str(found)


def test_cases_that_cannot_be_built_are_recorded_and_not_lost():
    found = design.worst_case(two_lags, {"gain": (1.0, 5.0), "lag": [-1.0, 1e-3, 2e-3]}, [0.0], "phase_deg")
    assert found.case["lag"] == 2e-3
    assert {case["lag"] for case, _ in found.failed} == {-1.0} and "velocity_lag" in found.failed[0][1]
    with pytest.raises(BadArgument, match="velocity_lag"):
        design.worst_case(two_lags, {"gain": (1.0, 5.0), "lag": [-1.0, -2.0, -3.0]}, [0.0])


def test_the_worst_settling_time_is_of_the_step_asked_for():
    def build(mass):
        law = mfc.laws.JointPID(**mfc.gains.pd(natural_frequency=10.0))
        return mfc.ClosedLoop(mfc.robots.slider(mass=mass), law, mfc.trajectories.Hold([0.0]))

    for step in ("reference", "loop"):
        found = design.worst_case(build, {"mass": [1.0, 1.2, 1.4]}, [0.0], "settling_time", step=step)
        each = [mfc.Requirements(settling_time=0, step=step).check(build(m), [0.0]).line("settling_time").found for m in (1.0, 1.2, 1.4)]
        assert float(found) == max(each) and f"settling time ({step} step)" in str(found)
        names: dict = {}
        exec(found.replay.replace("print(", "verdict = ("), names)
        assert names["verdict"].line("settling_time").found == pytest.approx(float(found), rel=1e-9)
    with pytest.raises(BadArgument, match="step: got"):
        design.worst_case(build, {"mass": [1.0, 1.2, 1.4]}, [0.0], "phase_deg", step="loop")


def test_a_metric_of_ones_own_is_minimised():
    found = design.worst_case(
        two_lags, {"gain": (1.0, 5.0), "lag": (1e-3, 2e-2)}, [0.0], lambda loop: -float(loop.linearize([0.0]).poles().real.max())
    )
    assert found.case["gain"] == pytest.approx(1.0)


def test_bad_ranges_and_metrics_are_refused():
    with pytest.raises(UnknownName, match="phase_deg"):
        design.worst_case(two_lags, {"gain": (1.0, 5.0), "lag": (0.1, 0.2)}, [0.0], "phase")
    for named, arguments in (("build", (3, {"gain": (1, 2)})), ("points", (two_lags, {"gain": (1, 2)}))):
        with pytest.raises(BadArgument, match=named):
            design.worst_case(*arguments, points=1)
    for bad in ({}, None, {"gain": (2.0, 1.0)}, {"gain": (1.0,)}, {"gain": (1.0, math.nan)}):
        with pytest.raises(BadArgument, match="ranges"):
            design.worst_case(two_lags, bad, [0.0])
