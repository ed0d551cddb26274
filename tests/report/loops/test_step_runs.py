"""A step of the reference, linear and nonlinear: the size, what moves, what drives it, and how long it is followed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.maths.se3 import exp6, inverse, log6
from mfc_analysis.report.loops.step_runs import GROWTH, Shifted, ToolOf, step_run, wrench_asked
from tests.conftest import arm, moving, regular_pose
from tests.report.loops.views import PUSH, H, L, T, mass, open_loop, planar, pushing, unstable, velocity, view


def test_the_step_of_a_velocity_loop_is_the_exponential_in_both_models() -> None:
    run = step_run(velocity(4.0))
    assert (run.size, run.unit, run.channel, run.said) == (0.05, "rad", "joint", "")
    assert_allclose(run.predicted, 0.05 * (1 - np.exp(-4.0 * run.t)), atol=2e-6)  # interpolated between samples of the linear step
    assert_allclose(run.nonlinear, 0.05 * (1 - np.exp(-4.0 * run.t)), atol=1e-7)
    assert_allclose(run.drive, 4.0 * 0.05 * np.exp(-4.0 * run.t), atol=1e-6)
    assert run.misfit == pytest.approx(np.abs(run.nonlinear - run.predicted).max() / 0.05, rel=1e-12)


def test_a_sliding_joint_is_stepped_in_metres_and_overshoots_by_its_damping_ratio() -> None:
    run = step_run(mass(25.0, 6.0))  # w = 5, damping 0.6; the rate wanted knows nothing of the step
    assert (run.size, run.unit) == (0.01, "m")
    assert run.linear.overshoot == pytest.approx(np.exp(-np.pi * 0.6 / 0.8), rel=1e-6)
    assert run.nonlinear.max() / run.size - 1 == pytest.approx(run.linear.overshoot, rel=1e-3)
    assert run.drive[0] == pytest.approx(25.0 * 0.01, rel=1e-6)


def test_a_force_is_stepped_by_a_twentieth_of_what_is_asked_and_of_a_small_one_by_a_newton() -> None:
    big = step_run(pushing())
    assert (big.size, big.unit, big.channel) == (0.05 * PUSH[2], "N", "F_fz")
    assert big.drive[0] == pytest.approx((1 + 1.0) * big.size, rel=1e-6)  # F_d + kfp F_e
    loop = pushing().loop
    small = mfc.ClosedLoop(loop.robot, loop.law.changed(F_d=np.array(PUSH) / 20), loop.ref, environment=list(loop.equations.surfaces))
    assert step_run(type(pushing())("small", small, np.zeros(1))).size == 1.0
    assert wrench_asked(loop).tolist() == list(PUSH) and wrench_asked(mass().loop).tolist() == [0.0] * 6


@pytest.mark.parametrize(("axes", "unit"), [("xy", "m"), ([[0, 0, 0, 0, 0, 1.0]], "rad")])
def test_a_selected_direction_of_the_tool_is_stepped_also_where_the_reference_is_turned(axes: object, unit: str) -> None:
    q, turn = np.array([0.2, 0.9]), np.array([0, 0, 0, 0, 0, 0.4 if axes == "xy" else 0.0])
    law, ref = L.TaskComputedTorque(64.0, kd=16.0, axes=axes, null_damping=8.0), T.ToolHold(planar().pose(q) @ exp6(turn))
    run = step_run(view(mfc.ClosedLoop(planar(), law, ref, q_start=q)))
    assert run.unit == unit and run.channel in ("X_vx", "X_vy", "X_wz")
    assert_allclose(run.predicted, run.size * (1 - (1 + 8 * run.t) * np.exp(-8 * run.t)), atol=1e-3 * run.size)
    assert run.misfit < 2e-3  # exact in both: the rest is interpolation


def test_nothing_is_stepped_without_feedback_and_a_growing_loop_is_followed_for_a_few_time_constants() -> None:
    assert step_run(open_loop()) is None
    found = unstable()
    run = step_run(found)
    assert run.linear.outcome is Outcome.GROWS and run.t[-1] == pytest.approx(GROWTH / found.growth)
    late = step_run(velocity(4.0, H(sample_time=2e-3)))
    assert late.t[-1] == pytest.approx(300 * 2e-3)  # samples that a run may take


def test_a_moved_tool_reference_keeps_the_twist_of_its_own_motion() -> None:
    source, delta, t, h = T.ToolCircle(arm("ur5").pose(regular_pose("ur5")), 0.05, 2.0), np.array([0.1, -0.2, 0.05, 0.3, -0.4, 0.2]), 0.3, 1e-5
    moved = Shifted(source, delta)
    assert_allclose(moved(t).X, np.asarray(source(t).X) @ exp6(delta), atol=1e-15)
    twist = log6(inverse(moved(t - h).X) @ moved(t + h).X) / (2 * h)
    assert_allclose(moved(t).V, twist, atol=1e-9)
    assert_allclose(moved(t).dV, (moved(t + h).V - moved(t - h).V) / (2 * h), atol=1e-8)
    joints = Shifted(moving("ur5"), np.arange(6.0))
    assert_allclose(joints(t).q - moving("ur5")(t).q, np.arange(6.0), atol=1e-15)
    assert joints.period == moving("ur5").period and (joints(t).v == moving("ur5")(t).v).all()


def test_a_joint_path_is_stepped_as_the_tool_motion_that_a_tool_law_sees() -> None:
    ref, t = moving("ur5"), 0.4
    loop = mfc.ClosedLoop(arm("ur5"), L.TaskVelocity(4.0), ref)
    seen, here = ToolOf(ref, loop.equations)(t), ref(t)
    assert_allclose(seen.X, arm("ur5").pose(here.q), atol=1e-12)
    assert_allclose(seen.V, arm("ur5").jacobian(here.q) @ here.v, atol=1e-12)
