"""Equations 9.19 to 9.23: one mass on a spring in closed form with and without lag, signs on a real arm, free space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, Sinusoid
from tests.conftest import F_D, arm, plant, regular_pose

FEW = settings(max_examples=15, deadline=None)
PUSH = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
masses, frictions, springs, proportional, integral, dampings = (
    st.floats(0.2, 5), st.floats(0, 3), st.floats(50, 5e4), st.floats(0, 5), st.floats(0.1, 20), st.floats(0, 200))  # fmt: skip


def slider(law: L.Law, m: float, b: float, k: float, c: float = 0.0, lag: float | None = None, **more: object) -> ClosedLoop:
    spring = Environment(k, c, preload=PUSH[2], **more)
    return ClosedLoop(robots.slider(m, b), law, Hold([0.0]), environment=spring, hardware=Hardware(torque_lag=lag))


def active(A: np.ndarray, lag: bool = False) -> np.ndarray:
    """A of q, v, z_f along z (and lag): the five other integrals act on nothing."""
    keep = [0, 1, 4, *([8] if lag else [])]
    idle = [i for i in range(A.shape[0]) if i not in keep]
    assert not A[np.ix_(keep, idle)].any()
    return A[np.ix_(keep, keep)]


# --- one mass on a spring ----------------------------------------------------------------------------------------------------


@FEW
@given(m=masses, b=frictions, k=springs, c=st.floats(0, 50), kfp=proportional, kfi=integral, kdamp=dampings)
def test_the_damped_force_loop_has_its_polynomial(m: float, b: float, k: float, c: float, kfp: float, kfi: float, kdamp: float) -> None:
    lin = slider(L.DampedForcePI(PUSH, kfp, kfi, kdamp), m, b, k, c).linearize([0.0])
    want = np.array([m, b + kdamp + c * (1 + kfp), k * (1 + kfp) + c * kfi, k * kfi])
    found = np.poly(active(lin.A[0])) * m
    scale = np.abs(np.linalg.eigvals(active(lin.A[0]))).max() ** np.arange(4) * m
    assert np.max(np.abs(found - want) / scale) < 1e-11
    without = slider(L.ForcePI(PUSH, kfp, kfi), m, b, k, c).linearize([0.0])  # 9.22 is 9.23 without kdamp
    want[1] -= kdamp
    assert np.max(np.abs(np.poly(active(without.A[0])) * m - want) / scale) < 1e-11


@FEW
@given(m=masses, b=frictions, k=springs, kfp=proportional, kfi=integral, kdamp=dampings, T=st.floats(1e-3, 0.1))
def test_with_a_torque_lag_it_is_of_fourth_order(m: float, b: float, k: float, kfp: float, kfi: float, kdamp: float, T: float) -> None:
    lin = slider(L.DampedForcePI(PUSH, kfp, kfi, kdamp), m, b, k, lag=T).linearize([0.0])
    A = active(lin.A[0], lag=True)
    want = np.array([m * T, m + b * T, b + kdamp + k * T, k * (1 + kfp), k * kfi])
    scale = np.abs(np.linalg.eigvals(A)).max() ** np.arange(5) * m * T
    assert np.max(np.abs(np.poly(A) * m * T - want) / scale) < 1e-11


@FEW
@given(m=masses, b=frictions, k=springs, kfp=proportional, kdamp=st.floats(0.5, 200))
def test_without_lag_the_bound_does_not_know_the_stiffness(m: float, b: float, k: float, kfp: float, kdamp: float) -> None:
    bound = (b + kdamp) * (1 + kfp) / m
    for factor, stable in ((0.99, True), (1.01, False)):
        for stiffness in (k, 100 * k):
            lin = slider(L.DampedForcePI(PUSH, kfp, factor * bound, kdamp), m, b, stiffness).linearize([0.0])
            assert bool(lin.stable[0]) == stable and not lin.drifts[0] and lin.neutral[0] == 0


@FEW
@given(m=masses, kfp=st.floats(0.2, 5), kfi=st.floats(0.1, 5), kdamp=st.floats(5, 200), T=st.floats(1e-3, 0.05))
def test_with_lag_there_is_a_largest_stiffness(m: float, kfp: float, kfi: float, kdamp: float, T: float) -> None:
    bound = (kdamp * (1 + kfp) - m * kfi) / (T * kfp * (1 + kfp))
    assume(bound > 1)
    for factor, stable in ((0.99, True), (1.01, False)):
        lin = slider(L.DampedForcePI(PUSH, kfp, kfi, kdamp), m, 0.0, factor * bound, lag=T).linearize([0.0])
        assert bool(lin.stable[0]) == stable


def test_simulations_on_both_sides_of_the_largest_stiffness_decay_and_grow() -> None:
    m, kfp, kfi, kdamp, T = 1.0, 1.0, 2.0, 40.0, 0.01
    bound = (kdamp * (1 + kfp) - m * kfi) / (T * kfp * (1 + kfp))
    for factor, grows in ((0.9, False), (1.1, True)):
        loop = slider(L.DampedForcePI(PUSH, kfp, kfi, kdamp), m, 0.0, factor * bound, lag=T)
        sim = loop.simulate(np.linspace(0, 3, 3001), 1e-5)
        F = np.abs(sim.force[:, 2] - 10.0)
        assert (F[-300:].max() > F[300:600].max()) == grows


def test_a_positive_force_presses_and_is_reached() -> None:
    """Against a wall along +z the tool goes into it, and F_tip is what the robot applies."""
    loop = slider(L.DampedForcePI(PUSH, 1.0, 4.0, 30.0), 1.0, 0.0, 1000.0)
    rest = loop.equilibrium()
    assert_allclose(rest.force, PUSH, atol=1e-9)
    assert_allclose(rest.torque, 10.0, atol=1e-9)
    harder = ClosedLoop(loop.robot, L.DampedForcePI(2 * PUSH, 1.0, 4.0, 30.0), loop.ref, environment=loop.environment)
    assert_allclose(harder.equilibrium().q, 10.0 / 1000.0, atol=1e-12)
    sim = harder.simulate(3.0)
    assert_allclose(sim.force[-1], 2 * PUSH, atol=1e-3)
    assert sim.q[-1, 0] > 0.0099


def test_without_an_integral_a_preload_error_stays_in_closed_form() -> None:
    """9.22 with P only: F = F_d + kfp (F_d - F) gives F = F_d: no error without a model error; a spring of the plant would leave one."""
    loop = slider(L.ForcePI(3 * PUSH, 2.0), 1.0, 5.0, 1000.0)
    assert_allclose(loop.equilibrium().force, 3 * PUSH, atol=1e-9)
    pushed = loop.simulate(6.0, disturbance=-9.0)  # F = F_d + kfp F_e - 9, so F_e = 3
    assert_allclose(pushed.force[-1, 2], 30.0 - 9.0 / 3.0, atol=1e-4)


# --- free space --------------------------------------------------------------------------------------------------------------


def test_in_free_space_a_proportional_force_loop_accelerates_away() -> None:
    """m v' = (1 + kfp) F_d: nothing to push against."""
    loop = ClosedLoop(robots.slider(2.0), L.ForcePI(PUSH, 1.5), Hold([0.0]))
    sim = loop.simulate(np.linspace(0, 2, 11))
    assert_allclose(sim.v[:, 0], 2.5 * 10 / 2.0 * sim.t, rtol=1e-6, atol=1e-7)
    lin = loop.linearize([0.0])
    assert (lin.drifts[0], lin.stable[0]) == (True, False)
    assert_allclose(lin.residual, 2.5 * 10 / 2.0)


@FEW
@given(kfi=st.floats(0.5, 10), kdamp=st.floats(5, 60), b=frictions)
def test_in_free_space_the_damped_loop_drifts_and_its_speed_ramps(kfi: float, kdamp: float, b: float) -> None:
    loop = ClosedLoop(robots.slider(1.0, b), L.DampedForcePI(PUSH, 1.0, kfi, kdamp), Hold([0.0]))
    lin = loop.linearize([0.0])
    assert (lin.drifts[0], lin.stable[0]) == (True, False)
    end = 15.0 / (b + kdamp)
    t = np.linspace(0, end, 200)
    sim = loop.simulate(t, rtol=1e-8)
    acceleration = np.diff(sim.v[-2:, 0]) / np.diff(sim.t[-2:])
    assert_allclose(acceleration, kfi * 10.0 / (kdamp + b), rtol=1e-4)


def test_in_free_space_without_an_integral_the_damped_loop_is_neutral() -> None:
    """A constant force against damping: a steady speed, a free position."""
    loop = ClosedLoop(robots.slider(1.0), L.DampedForcePI(PUSH, 1.0, kdamp=20.0), Hold([0.0]))
    lin = loop.linearize([0.0])
    assert (lin.neutral[0], lin.drifts[0], lin.stable[0]) == (1, False, True)
    assert_allclose(loop.simulate(3.0).v[-1], 2 * 10 / 20.0, rtol=1e-5)
    with pytest.raises(NotConverged, match="free space"):
        loop.equilibrium()


def test_margins_of_a_drifting_loop_keep_their_figures_and_say_so() -> None:
    lin = ClosedLoop(robots.slider(1.0), L.DampedForcePI(PUSH, 1.0, 2.0, 20.0), Hold([0.0])).linearize([0.0])
    m = lin.margins()
    assert m.drifts[0] and np.isfinite(m.sensitivity_peak).all()


# --- on an arm ---------------------------------------------------------------------------------------------------------------


def wall(name: str, axis: str = "z", **more: object) -> Environment:
    return Environment(5000.0, 20.0, pose=arm(name).pose(regular_pose(name)), axes=axis, preload=1.0, **more)


@pytest.mark.parametrize("name", ["ur5", "panda", "kinova"])
def test_the_law_is_the_page_at_any_state(name: str) -> None:
    """tau = g^ + J^T (F_d + Kfp F_e + Kfi z_f - Kdamp V) by the robot's own matrices, with the true F_tip."""
    from tests.conftest import each, full, seed, surfaces

    q0, rng, n = regular_pose(name), seed("force", name), arm(name).n
    law = L.DampedForcePI(F_D, full(6, 1.5), each(6, 2.0), full(6, 30.0))
    loop = ClosedLoop(plant(name), law, Hold(q0), arm(name), surfaces(name, q0))
    q, v, z = q0 + rng.uniform(-0.02, 0.02, n), rng.uniform(-0.3, 0.3, n), rng.uniform(-1, 1, 6)
    flow = loop.equations.flow(0.0, np.concatenate([q, v, z]))
    J, F = arm(name).jacobian(q), np.asarray(flow.F_tip)
    assert np.abs(F).min() > 1e-3
    wrench = F_D + full(6, 1.5) @ (F_D - F) + np.diag(each(6, 2.0)) @ z - full(6, 30.0) @ (J @ v)
    assert_allclose(np.asarray(flow.command), arm(name).gravity(q) + J.T @ wrench, atol=1e-10)
    # and the plant takes it: M q'' + h + friction + J^T F_tip = tau
    a, robot = np.asarray(flow.rates["v"]), plant(name)
    left = robot.mass(q) @ a + robot.bias(q, v) + robot.friction(v) + J.T @ F
    assert_allclose(left, np.asarray(flow.command), atol=1e-9)
    assert_allclose(np.asarray(flow.rates["z_f"]), F_D - F, atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_arm_presses_the_wall_with_the_force_asked_for(axis: str) -> None:
    """Against a wall along a tool axis, the other directions held by the law's damping only: F_tip along it becomes F_d, positive."""
    i = "xyz".index(axis)
    F_d = np.zeros(6)
    F_d[i] = 15.0
    q = regular_pose("ur5")
    held = Environment(2e3, 200.0, pose=arm("ur5").pose(q), axes="xyzrxryrz", preload=0.0)
    loop = ClosedLoop(arm("ur5"), L.DampedForcePI(F_d, 1.0, 3.0, 60.0), Hold(q), environment=held)
    rest = loop.equilibrium()
    assert_allclose(rest.force, F_d, atol=1e-8)
    moved = (arm("ur5").pose(rest.q)[:3, 3] - arm("ur5").pose(q)[:3, 3]) @ arm("ur5").pose(q)[:3, :3]
    assert moved[i] > 0.007  # into the wall: 15 N / 2000 N/m
    sim = loop.simulate(4.0)
    assert_allclose(sim.force[-1], F_d, atol=0.05)


def test_open_loop_force_misses_by_the_payload() -> None:
    """9.21: at rest J^T (F_tip - F_d) = g^ - g, and with the payload known the force is the one asked for."""
    q, F_d = regular_pose("ur5"), np.array([0, 0, 12.0, 0, 0, 0])
    held = Environment(2e4, 10.0, pose=arm("ur5").pose(q), axes="xyzrxryrz", preload=0.0)
    heavy = arm("ur5").with_payload(1.5)
    loop = ClosedLoop(heavy, L.OpenLoopForce(F_d), Hold(q), arm("ur5"), held)
    rest = loop.equilibrium()
    missing = arm("ur5").gravity(rest.q) - heavy.gravity(rest.q)
    assert_allclose(arm("ur5").jacobian(rest.q).T @ (rest.force - F_d), missing, atol=1e-8)
    R = arm("ur5").pose(rest.q)[:3, :3]
    assert_allclose(rest.force[:3] - F_d[:3], R.T @ [0, 0, -1.5 * 9.81], atol=1e-6)  # the weight hangs at the tool
    known = ClosedLoop(heavy, L.OpenLoopForce(F_d), Hold(q), environment=held)
    assert_allclose(known.equilibrium().force, F_d, atol=1e-8)


def test_force_channels_are_in_wrench_order_and_those_not_sensed_are_nan() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(arm("ur5").with_friction(viscous=2.0), L.DampedForcePI(PUSH, 0.5, 1.0, 300.0), Hold(q), environment=wall("ur5"))
    m = loop.linearize([0.0]).margins(at="force")
    assert m.gain_increase.shape == (1, 6)
    assert np.isnan(m.phase_deg[0, [0, 1, 3, 4, 5]]).all()


@pytest.mark.parametrize(("law", "ref", "argument"), [
    (lambda: L.ForcePI(PUSH[:3], 1.0), Hold([0.0]), "F_d"),
    (lambda: L.ForcePI([0, 0, np.nan, 0, 0, 0], 1.0), Hold([0.0]), "F_d"),
    (lambda: L.ForcePI(PUSH, [1.0, 2.0]), Hold([0.0]), "kfp"),
    (lambda: L.DampedForcePI(PUSH, 1.0, None, np.eye(3)), Hold([0.0]), "kdamp"),
    (lambda: L.OpenLoopForce(PUSH), Sinusoid([0.0], 0.1, 1.0), "ref"),
])  # fmt: skip
def test_what_a_force_law_cannot_take_is_refused_by_name(law: object, ref: object, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        ClosedLoop(robots.slider(), law(), ref)
    assert info.value.argument == argument
