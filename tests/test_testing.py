"""Assertions: both sides of every limit, what a failure says, and that NaN fails."""

import math
import subprocess
import sys

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.testing import assert_margins, assert_requirements, assert_stable, assert_validated, observed
from tests.requirements.test_requirements import KNOWN, hold, second_order, triple_pole, velocity_p


@pytest.fixture
def drifting():
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=2.0, kfi=3.0, kdamp=20.0)
    return mfc.ClosedLoop(mfc.robots.slider(), law, hold(q=0.0))


@pytest.fixture
def sagging():
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(40.0, kd=5.0), hold())


@pytest.fixture
def unstable():
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 100.0, 2.0), hold())


def message(call, *args, **kwargs) -> str:
    with pytest.raises(AssertionError) as why:
        call(*args, **kwargs)
    return str(why.value)


@pytest.mark.parametrize(
    ("field", "make", "at", "value"), [k for k in KNOWN if k[3] * 1.001 <= 180 and k[3] != 2.0], ids=lambda x: x if isinstance(x, str) else ""
)
def test_known_margins_pass_at_0_999_and_fail_at_1_001(field, make, at, value):
    inside, outside = (1.001, 0.999) if field == "settling_time" else (0.999, 1.001)
    assert_margins(make(), [0.0], at=at, **{field: inside * value})
    said = message(assert_margins, make(), [0.0], at=at, **{field: outside * value})
    assert f"{value:.4g}"[:4] in said


def test_a_failure_names_worst_joint_time_asked_and_found_and_its_code_fails_again():
    robot = mfc.robots.ur5()
    ref = mfc.trajectories.Quintic(np.full(6, 0.5), np.full(6, 1.0), 2.0)
    loop = mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(100.0, 100.0, 20.0), ref, controller_model=robot)
    times = np.linspace(0, 2, 5)
    said = message(assert_margins, loop, times, phase_deg=75, gain_increase_db=6)
    margins = loop.linearize(times).margins()
    worst = margins.worst().phase_deg
    first = said.splitlines()[0]
    assert f"{worst[0]:.6g} deg" in first and worst[2] in first and f"t = {worst[1]:.4g} s" in first and "at least 75 deg" in first
    code = said.split("to reproduce it:")[1].replace("\n    ", "\n").replace("print(", "found = (")
    names: dict = {}
    exec(code, names)
    assert names["found"].status == "FAIL"
    assert names["found"].worst.found == pytest.approx(worst[0], rel=1e-9)


def test_an_assertion_says_which_step_settles_and_its_code_fails_again():
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.ComputedTorque(**mfc.gains.pid(settling_time=0.5, step="loop")), mfc.trajectories.Hold([0.0]))
    assert_margins(loop, settling_time=0.501, step="loop")
    said = message(assert_margins, loop, settling_time=0.499, step="loop")
    assert said.startswith("settling time (loop step) is 0.5 s") and "mfc.Requirements(settling_time=0.499, step='loop')" in said
    assert message(assert_margins, loop, settling_time=0.501).startswith("settling time (reference step) is 0.69")
    with pytest.raises(BadArgument, match="step: got"):
        assert_margins(loop, phase_deg=30, step="loop")


def test_an_unstable_loop_fails_every_assertion_and_its_nan_does_not_pass(unstable):
    assert "not stable" in message(assert_stable, unstable)
    assert "not stable" in message(assert_margins, unstable, phase_deg=0)
    assert "not stable" in message(assert_margins, unstable, sensitivity_peak=1e9)


def test_a_validation_that_is_nan_fails(monkeypatch):
    loop = second_order()

    class Nothing:
        nrmse = taylor_order = math.nan

    monkeypatch.setattr(mfc.ClosedLoop, "validate", lambda *a: Nothing())
    message(assert_validated, loop)


def test_drift_fails_unless_it_is_allowed(drifting):
    assert "drifts" in message(assert_stable, drifting)
    message(assert_margins, drifting, phase_deg=45, allow_residual=True)
    assert_stable(drifting, allow_drift=True)
    assert_margins(drifting, phase_deg=45, allow_drift=True)
    assert_requirements(drifting, mfc.Requirements(phase_deg=45), allow_drift=True)
    assert_margins(drifting, phase_deg=45, allow_drift=True, allow_residual=True)
    message(assert_margins, drifting, phase_deg=95, allow_drift=True, allow_residual=True)


def test_an_unstable_loop_fails_even_where_drift_is_allowed(unstable):
    message(assert_stable, unstable, allow_drift=True)


def test_a_residual_that_matters_fails_a_verdict_but_not_stability(sagging):
    assert_stable(sagging)
    assert "error at rest" in message(assert_margins, sagging, phase_deg=20)
    assert "error at rest" in message(assert_margins, sagging, phase_deg=20, allow_drift=True)
    assert_margins(sagging, phase_deg=20, allow_residual=True)


def test_neutral_is_not_stable():
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityFeedforward(), hold())
    assert "neutral" in message(assert_stable, loop, allow_drift=True)


@pytest.mark.parametrize("horizon", [1e4, math.inf])
def test_the_horizon_decides_and_is_in_the_code_of_a_failure(horizon):
    creeping = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(kp=4.0, ki=1e-3, kd=2.0), hold(q=0.0))  # a root at -ki/kp
    assert creeping.linearize().slow == [1] and creeping.linearize(horizon=horizon).slow == [0]
    assert_stable(creeping, horizon=horizon)
    assert_margins(creeping, phase_deg=30, horizon=horizon)
    undamped = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(kp=4.0), hold(q=0.0))
    said = message(assert_stable, undamped, allow_drift=True, horizon=horizon)
    with pytest.raises(AssertionError, match="FAIL"):
        exec(said.split("to reproduce it:")[1].replace("\n    ", "\n"), {})
    assert f"horizon={horizon!r}".replace("=inf", "=float('inf')") in message(assert_margins, undamped, phase_deg=30, horizon=horizon)


def test_requirements_are_asserted_as_an_object():
    req = mfc.Requirements(phase_deg=89.9)
    assert_requirements(velocity_p(), req, [0.0])
    message(assert_requirements, triple_pole(), req, [0.0], at="command")


def test_validation_is_asserted_from_both_sides():
    robot = mfc.robots.single_joint()
    loop = mfc.ClosedLoop(robot, mfc.laws.JointPID(40.0, 5.0, 5.0), hold())
    found = loop.validate(0.5)
    assert_validated(loop, 0.5, nrmse=1.01 * found.nrmse)
    assert "misfit" in message(assert_validated, loop, 0.5, nrmse=0.99 * found.nrmse)
    assert "Taylor order" in message(assert_validated, loop, 0.5, nrmse=1.0, order=found.taylor_order + 0.06)


def test_what_cannot_be_asked_is_refused():
    with pytest.raises(UnknownName, match="phase_deg"):
        assert_margins(velocity_p(), phase_degree=45)
    with pytest.raises(BadArgument, match="at least one"):
        assert_margins(velocity_p())
    with pytest.raises(BadArgument, match="requirements"):
        assert_requirements(velocity_p(), {"phase_deg": 45})
    with pytest.raises(BadArgument, match="loop"):
        assert_validated(3)


def test_observers_are_told_of_passed_and_failed_assertions_only_while_they_watch(unstable):
    seen = []
    with observed(seen.append):
        assert_stable(velocity_p())
        message(assert_stable, unstable)
    assert_stable(velocity_p())
    assert [s.passed for s in seen] == [True, False]
    assert [s.status for s in seen] == ["PASS", "FAIL"] and "assert_stable(loop, times)" in seen[0].replay


def test_the_assertions_need_no_pytest():
    code = "import sys; sys.modules['pytest'] = None; import mfc_analysis.testing"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("q", [0.0, 0.3, 3.0])
def test_a_linear_loop_is_validated_whatever_rounding_its_runs_leave(q):
    """The solver's rounding grows with the position: it was taken for a remainder, and the order came out below 1."""
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(5.0), hold(q=q))
    assert loop.validate(0.5).taylor_order == math.inf
    assert_validated(loop, 0.5)


def test_a_failure_names_the_joint_the_time_and_the_unstable_root(unstable):
    """I s^3 + (b + kd) s^2 + (kp - m g r sin th) s + ki of law 9.8 on the joint of eq. 9.6."""
    s = max(np.roots([0.5, 2.1, 5.0 - 0.981 * math.sin(0.3), 100.0]), key=lambda x: x.real)
    said = f"joint 1 (joint) at t = 0 s: root +{s.real:.3g} ± {abs(s.imag):.3g} j 1/s"
    assert message(assert_stable, unstable).startswith(f"the loop is not stable: {said}\n")
    assert f"unstable: {said}" in message(assert_margins, unstable, phase_deg=30.0)
