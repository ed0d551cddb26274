"""Equations 9.1 to 9.5 against their closed forms, linear and simulated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import ad, exp6
from mfc_analysis.trajectories import Hold, Sinusoid, ToolHold, ToolSinusoid
from mfc_analysis.trajectories.joint import JointPoint, JointReference
from tests.conftest import SIX, arm, regular_pose

JOINT = robots.single_joint()
FEW = settings(max_examples=15, deadline=None)
gains = st.floats(0.2, 50.0)


class Parabola(JointReference):
    """q0 + v t + a t^2 / 2 on every joint: the ramp and the parabola of the closed forms."""

    def __init__(self, v: float, a: float = 0.0) -> None:
        self.v, self.a = v, a

    @property
    def n(self) -> int:
        return 1

    def _at(self, t: np.ndarray) -> JointPoint:
        t = t[..., None]
        return JointPoint(self.v * t + 0.5 * self.a * t * t, self.v + self.a * t, self.a + 0 * t)


def loop(law: L.Law, ref: JointReference | None = None) -> ClosedLoop:
    return ClosedLoop(JOINT, law, ref or Hold([0.3]))


def simulate(law: L.Law, ref: JointReference, end: float, error: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    sim = loop(law, ref).simulate(np.linspace(0, end, 40), error, rtol=1e-9, atol=1e-12)
    assert not sim.diverged
    return sim.t, sim.error[:, 0]


# --- 9.1 ---------------------------------------------------------------------------------------------------------------------


def test_feedforward_leaves_the_error_what_it_was() -> None:
    _, e = simulate(L.VelocityFeedforward(), Sinusoid([0.0], 0.5, 2.0), 3.0, 0.2)
    assert_allclose(e, 0.2, atol=1e-8)


@pytest.mark.parametrize("name", ["single_joint", "ur5", "panda"])
def test_feedforward_is_a_pure_integrator_for_each_joint(name: str) -> None:
    robot = arm(name)
    lin = ClosedLoop(robot, L.VelocityFeedforward(), Hold(regular_pose(name))).linearize([0.0])
    assert_allclose(lin.A, 0)
    assert_allclose(lin.poles(), 0)
    assert (lin.neutral[0], lin.drifts[0], lin.stable[0]) == (robot.n, False, False)  # nothing but neutral roots: neutral, never stable


def test_a_velocity_disturbance_integrates_under_feedforward_and_not_under_feedback() -> None:
    t = np.linspace(0, 2, 20)
    open_ = loop(L.VelocityFeedforward()).simulate(t, disturbance=0.1)
    assert_allclose(open_.error[:, 0], -0.1 * t, atol=1e-8)
    closed = loop(L.VelocityP(4.0)).simulate(t, disturbance=0.1, rtol=1e-9)
    assert_allclose(closed.error[:, 0], -0.1 / 4 * (1 - np.exp(-4 * t)), atol=1e-8)


# --- 9.2 ---------------------------------------------------------------------------------------------------------------------


@FEW
@given(k=gains, v=st.floats(-2, 2))
def test_proportional_feedback_has_the_figures_of_k_over_s(k: float, v: float) -> None:
    lin = loop(L.VelocityP(k)).linearize([0.0])
    assert_allclose(lin.poles(), [[-k]], rtol=1e-12)
    m = lin.margins()
    assert_allclose(m.phase_deg, 90.0, rtol=1e-9)
    assert_allclose(m.delay, np.pi / (2 * k), rtol=1e-9)
    assert_allclose(m.crossover, k, rtol=1e-9)
    assert (m.gain_reduction[0, 0], m.gain_increase[0, 0]) == (0.0, np.inf)
    assert_allclose(m.sensitivity_peak, 1.0, rtol=1e-9)
    t, e = simulate(L.VelocityP(k), Parabola(v), 6 / k)
    assert_allclose(e, v / k * (1 - np.exp(-k * t)), atol=1e-7)


def test_a_gain_matrix_couples_the_joints_as_written() -> None:
    K = np.array([[3.0, 1.0], [-0.5, 2.0]])
    lin = ClosedLoop(robots.planar_2r(), L.VelocityP(K), Hold([0.2, 0.4])).linearize([0.0])
    assert_allclose(lin.A[0], -K)


# --- 9.3 and 9.4 -------------------------------------------------------------------------------------------------------------


@FEW
@given(kp=gains, ki=gains)
def test_proportional_integral_feedback_has_its_polynomial(kp: float, ki: float) -> None:
    for law in (L.VelocityPI(kp, ki), L.VelocityFeedforwardPI(kp, ki)):
        A = loop(law, Sinusoid([0.1], 0.4, 3.0)).linearize([0.3]).A[0]
        assert_allclose(np.poly(A), [1, kp, ki], rtol=1e-9)


def test_critical_damping_is_at_a_quarter_of_kp_squared() -> None:
    for factor, damped in ((0.99, True), (1.01, False)):
        poles = loop(L.VelocityPI(6.0, factor * 9.0)).linearize([0.0]).poles()
        assert bool(np.all(poles.imag == 0)) == damped
    assert_allclose(np.poly(loop(L.VelocityPI(6.0, 9.0)).linearize([0.0]).A[0]), np.poly([-3, -3]), rtol=1e-12)


def test_the_integral_takes_the_error_of_a_ramp_and_leaves_that_of_a_parabola() -> None:
    law = L.VelocityPI(8.0, 12.0)  # poles -2 and -6
    _, ramp = simulate(law, Parabola(0.7), 12.0)
    assert abs(ramp[-1]) < 1e-8
    _, parabola = simulate(law, Parabola(0.7, 0.5), 12.0)
    assert_allclose(parabola[-1], 0.5 / 12.0, rtol=1e-6)
    assert abs(parabola[3]) > 1e-3


def test_as_printed_the_integral_has_the_gain_one() -> None:
    printed = loop(L.VelocityPI(8.0, 12.0, form="printed"))
    assert_allclose(np.poly(printed.linearize([0.0]).A[0]), [1, 8, 1], rtol=1e-12)
    _, parabola = simulate(L.VelocityPI(8.0, 12.0, form="printed"), Parabola(0.0, 0.5), 120.0)
    assert_allclose(parabola[-1], 0.5, rtol=1e-5)


def test_with_feedforward_the_error_forgets_the_path() -> None:
    t, e = simulate(L.VelocityFeedforwardPI(8.0, 12.0), Sinusoid([0.1], 0.4, 3.0, 0.5), 3.0, 0.2)
    # e'' + 8 e' + 12 e = 0 from e = 0.2, z = 0: e' = -8 e
    assert_allclose(e, 0.2 * (1.5 * np.exp(-6 * t) - 0.5 * np.exp(-2 * t)), atol=1e-8)
    _, without = simulate(L.VelocityPI(8.0, 12.0), Sinusoid([0.1], 0.4, 3.0, 0.5), 3.0, 0.2)
    assert np.abs(without - e).max() > 0.05


def test_feedforward_without_an_integral_has_no_integral_state() -> None:
    lin = loop(L.VelocityFeedforwardPI(3.0)).linearize([0.0])
    assert lin.state_names == ("q_joint",)
    assert_allclose(lin.A, -3.0)


# --- 9.5 ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("moving", [False, True])
def test_a_pose_error_of_any_size_decays_exactly(moving: bool) -> None:
    """From 2.3 rad and 0.3 m: X_e(t) = exp(-k t) X_e(0), however the reference moves."""
    robot, k, q = arm("ur5"), 3.0, np.array([0.4, -1.3, 1.7, -1.2, -1.4, 0.3])
    X = robot.pose(q)
    ref = ToolSinusoid(X, [0.05, 0.02, -0.04], 2.0, axis=(1, 2, 0), angle=0.2) if moving else ToolHold(X)
    X_e = np.array([0.18, -0.20, 0.1323, 0.6, -0.4, 2.184])
    X_e[3:] *= 2.3 / np.linalg.norm(X_e[3:])
    assert_allclose([np.linalg.norm(X_e[:3]), np.linalg.norm(X_e[3:])], [0.3, 2.3], atol=1e-3)
    sim = ClosedLoop(robot, L.TaskVelocity(k), ref, q_start=q).simulate(np.linspace(0, 2, 60), X_e, rtol=1e-11, atol=1e-13)
    assert not sim.diverged
    assert_allclose(sim.error, np.exp(-k * sim.t)[:, None] * X_e, atol=1e-8)


@pytest.mark.parametrize("name", SIX)
def test_the_linearised_pose_error_is_kp_alone_and_without_the_adjoint_it_is_not(name: str) -> None:
    robot, q = arm(name), regular_pose(name)
    ref = ToolSinusoid(robot.pose(q), [0.01, 0.02, -0.01], 3.0, axis=(1, 0, 2), angle=0.1)
    t = np.array([0.0, 0.2, 0.9])
    K = 4.0 * np.eye(6) + 0.3 * np.arange(36).reshape(6, 6) / 36
    loops = [ClosedLoop(robot, L.TaskVelocity(K, form=form), ref, q_start=q) for form in ("standard", "no_adjoint")]
    right, slip = (one.linearize(t, coordinates="error") for one in loops)
    assert_allclose(right.A, np.broadcast_to(-K, (3, 6, 6)), atol=1e-10 * 4)
    assert_allclose(slip.A, -K - ad(ref(t).V), atol=1e-10 * 4)
    assert np.abs(ad(ref(t).V)).max() > 0.05


def test_with_an_integral_the_pose_error_has_six_copies_of_the_polynomial() -> None:
    robot, q = arm("z1"), regular_pose("z1")
    lin = ClosedLoop(robot, L.TaskVelocity(4.0, 3.0), ToolHold(robot.pose(q)), q_start=q).linearize([0.0])
    design = np.block([[-4 * np.eye(6), -3 * np.eye(6)], [np.eye(6), np.zeros((6, 6))]])
    assert_allclose(lin.A[0], design, atol=1e-9)
    assert lin.coordinates == "error"


def test_as_printed_a_rotation_decays_by_its_sine() -> None:
    """X_d - X in place of the logarithm: theta' = -k sin(theta), so tan(theta / 2) decays exponentially."""
    robot, k, q = arm("ur5"), 2.0, np.array([0.4, -1.3, 1.7, -1.2, -1.4, 0.3])
    axis = np.array([0.0, 0.6, 0.8])
    ref = ToolHold(robot.pose(q))
    sim = ClosedLoop(robot, L.TaskVelocity(k, form="printed"), ref, q_start=q).simulate(
        np.linspace(0, 2, 20), np.r_[0, 0, 0, 1.9 * axis], rtol=1e-10, atol=1e-12)  # fmt: skip
    theta = 2 * np.arctan(np.tan(0.95) * np.exp(-k * sim.t))
    assert_allclose(sim.error[:, 3:], np.sin(theta)[:, None] * axis, atol=1e-8)
    assert_allclose(sim.error[:, :3], 0, atol=1e-8)


def test_on_a_redundant_arm_the_tool_obeys_the_same_law() -> None:
    robot, q, k = arm("panda"), regular_pose("panda"), 3.0
    X_e = np.array([0.03, -0.02, 0.04, 0.1, 0.3, -0.2])
    sim = ClosedLoop(robot, L.TaskVelocity(k), ToolHold(robot.pose(q)), q_start=q).simulate(np.linspace(0, 1, 10), X_e, rtol=1e-10, atol=1e-12)
    assert_allclose(sim.error, np.exp(-k * sim.t)[:, None] * X_e, atol=1e-8)
    lin = ClosedLoop(robot, L.TaskVelocity(k), Hold(q)).linearize([0.0])
    assert lin.coordinates == "state" and lin.neutral[0] == 1 and lin.stable[0]  # the elbow stays where it is


def test_the_pose_error_is_the_logarithm_from_the_tool_to_the_reference() -> None:
    robot, q = arm("ur5"), regular_pose("ur5")
    X_e = np.array([0.02, 0.01, -0.03, 0.2, -0.1, 0.3])
    loop_ = ClosedLoop(robot, L.TaskVelocity(3.0), ToolHold(robot.pose(q) @ exp6(X_e)), q_start=q)
    flow = loop_.equations.flow(0.0, q)
    assert_allclose(flow.error, X_e, atol=1e-12)
    assert_allclose(robot.jacobian(q) @ flow.command, 3.0 * X_e, atol=1e-10)


@pytest.mark.parametrize("law", [L.VelocityP(None), L.VelocityPI(None, None)], ids=str)
def test_without_any_gain_the_joints_are_integrators(law: L.VelocityP | L.VelocityPI) -> None:
    lin = ClosedLoop(robots.planar_2r(), law, Hold([0.1, 0.2])).linearize([0.0])
    assert_allclose(lin.A, np.zeros((1, 2, 2)))
    assert_allclose(lin.B[0, :, 2:], np.eye(2))  # of a velocity disturbance
