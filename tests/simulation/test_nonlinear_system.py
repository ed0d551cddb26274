"""The nonlinear loop as a system of python-control: against the linearisation by its differences, and against ``simulate``."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import MfcWarning, Unsupported
from mfc_analysis.maths.se3 import exp6
from tests.conftest import LAWS, Case, arm, loop_of, named, plant, regular_pose


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_its_linearisation_by_differences_is_ours(case: Case) -> None:
    """All laws on a moving reference, with contact where a law takes it: B and D have every input, the law's own acceleration included."""
    name = "ur5" if case.tool else "planar_2r"
    loop = loop_of(case, name, contact=True)
    lin = loop.linearize([0.3], coordinates="state")
    system = loop.nlsys()
    assert (system.state_labels, system.input_labels, system.output_labels) == tuple(
        list(names) for names in (lin.state_names, lin.input_names, lin.output_names)
    )
    found = control.linearize(system, lin.point.x[0], np.zeros(system.ninputs), t=0.3, eps=1e-6)
    for ours, theirs in zip((lin.A, lin.B, lin.C, lin.D), (found.A, found.B, found.C, found.D), strict=True):
        assert_allclose(theirs, ours[0], atol=2e-5 * max(1.0, np.abs(ours).max()))


def test_its_response_is_that_of_simulate() -> None:
    robot = mfc.robots.planar_2r()
    loop = mfc.ClosedLoop(robot.with_payload(1.0), mfc.laws.JointPID(300.0, 40.0, 50.0), mfc.trajectories.Sinusoid([0.3, 0.6], 0.4, 3.0))
    push = np.array([2.0, -1.0])
    run = loop.simulate(np.linspace(0, 1, 51), 0.1, disturbance=push, rtol=1e-9, atol=1e-11)
    u = np.zeros((4, run.t.size))
    u[2:] = push[:, None]
    theirs = control.input_output_response(loop.nlsys(), run.t, u, run.x[0], solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-11})
    ours = run.response
    assert ours.output_labels == theirs.output_labels and ours.state_labels == theirs.state_labels
    assert_allclose(ours.outputs, theirs.outputs, atol=1e-6 * np.abs(ours.outputs).max())
    assert_allclose(ours.states, theirs.states, atol=1e-7)


@pytest.mark.parametrize("case", named("9.3", "9.8", "9.9 standard", "9.9 printed", "9.10 printed", "9.11 LTI"), ids=str)
def test_a_shift_of_a_joint_reference_is_another_reference(case: Case) -> None:
    """9.9 as printed has M^(q_d) in its algebraic loop as well."""
    robot, q, r = plant("planar_2r"), np.array([0.3, 0.8]), np.array([0.2, -0.1])
    moved, plain = (
        mfc.ClosedLoop(robot, case.law(2), mfc.trajectories.Sinusoid(center, 0.4, 3.0), controller_model=arm("planar_2r")).nlsys()
        for center in (q + r, q)
    )
    x = np.random.default_rng(3).normal(size=plain.nstates)
    u, nothing = np.concatenate([r, np.zeros(2)]), np.zeros(4)
    assert_allclose(plain.dynamics(0.7, x, u), moved.dynamics(0.7, x, nothing), rtol=1e-9, atol=1e-9)
    assert_allclose(plain.output(0.7, x, u), moved.output(0.7, x, nothing), rtol=1e-9, atol=1e-9)


def test_a_shift_of_a_tool_reference_moves_it_in_its_own_frame() -> None:
    """X_d exp(r): the loop with that reference has the same rates."""
    robot, q = arm("ur5"), regular_pose("ur5")
    law, r = mfc.laws.TaskComputedTorque(100.0, kd=20.0), np.array([0.02, -0.01, 0.03, 0.1, 0.2, -0.05])
    X = robot.pose(q)
    shifted, plain = (mfc.ClosedLoop(robot, law, mfc.trajectories.ToolHold(one), q_start=q) for one in (X @ exp6(r), X))
    x = np.concatenate([q, np.zeros(6)])
    u = np.zeros(12)
    u[:6] = r
    expected = shifted.nlsys()
    for ask in ("dynamics", "output"):
        assert_allclose(getattr(plain.nlsys(), ask)(0.0, x, u), getattr(expected, ask)(0.0, x, np.zeros(12)), atol=1e-9)


def test_a_change_of_the_desired_force_adds_to_that_of_the_law() -> None:
    slider, wall = mfc.robots.slider(1.0), mfc.Environment(stiffness=1e4, damping=10.0, axes="z")

    def made(force: float) -> control.NonlinearIOSystem:
        law = mfc.laws.DampedForcePI([0, 0, force, 0, 0, 0], 0.5, 20.0, [40.0] * 6)
        return mfc.ClosedLoop(slider, law, mfc.trajectories.Hold([0.0]), environment=wall).nlsys()

    two, five = made(2.0), made(5.0)
    x, u = np.full(two.nstates, 1e-3), np.zeros(two.ninputs)
    u[two.input_labels.index("F_d_fz")] = 3.0
    assert_allclose(two.dynamics(0.0, x, u), five.dynamics(0.0, x, np.zeros(u.size)), rtol=1e-12)


def test_dead_time_is_left_out_with_a_warning_and_sampling_is_refused() -> None:
    def made(**hardware: float) -> mfc.ClosedLoop:
        return mfc.ClosedLoop(
            mfc.robots.single_joint(), mfc.laws.ComputedTorque(100, kd=20), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(**hardware)
        )

    with pytest.warns(MfcWarning, match=r"the dead time, 0\.004 s, is left out") as seen:
        assert made(delay=0.004).nlsys().name.endswith("without_dead_time")
    assert seen[0].filename == __file__
    with pytest.raises(Unsupported, match="sample_time"):
        made(sample_time=0.01).nlsys()
