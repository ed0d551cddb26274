"""Admittance control: one direction and six axes in closed form, both sides of the bounds, walls through every imperfection, statics and signs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.errors import BadArgument, NearSingular, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, ToolSinusoid
from tests.conftest import ARMS, Case, arm, each, full, loop_of, named, regular_pose, seed
from tests.dynamics.test_jacobians import misfit
from tests.laws.gantry import gantry
from tests.laws.test_impedance import assert_polynomial, axis_blocks

FEW = settings(max_examples=12, deadline=None)
masses, dampings, walls, lags = st.floats(0.3, 30), st.floats(10, 2000), st.floats(100, 1e5), st.floats(2e-3, 0.2)
PUSH = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])


def slider(M: float, D: float, wall: float, K: float | None = None, push: np.ndarray = PUSH, **hardware: object) -> ClosedLoop:
    surface = Environment(wall, preload=push[2])
    return ClosedLoop(robots.slider(1.0), L.Admittance(push, M, D, K, axes="z"), Hold([0.0]), environment=surface, hardware=Hardware(**hardware))


# --- one direction -----------------------------------------------------------------------------------------------------------


@FEW
@given(M=masses, D=dampings, k=walls, K=st.floats(0, 2000), T=lags, b=st.floats(20, 300), z=st.floats(0.3, 2))
def test_one_direction_on_a_spring_has_its_polynomial(M: float, D: float, k: float, K: float, T: float, b: float, z: float) -> None:
    assert_polynomial(slider(M, D, k).linearize().A[0], [M, D, k])
    assert_polynomial(slider(M, D, k, velocity_lag=T).linearize().A[0], [M * T, M + D * T, D, k])
    assert_polynomial(slider(M, D, k, K, velocity_lag=T).linearize().A[0], [M * T, M + D * T, D, k + K])
    w = Servo(b, z).natural_frequency
    servo = np.polyadd(np.polymul([M, D, 0], [1, 2 * z * w, w * w]), [(k + K) * w * w])
    assert_polynomial(slider(M, D, k, K, servo=Servo(b, z)).linearize().A[0], servo)


@FEW
@given(M=masses, D=dampings, k=walls, T=lags, c=st.floats(1, 100))
def test_a_filter_and_a_damper_of_the_wall_stand_where_they_should(M: float, D: float, k: float, T: float, c: float) -> None:
    """(M s + D) s (T s + 1) + (c s + k): the force through its filter; with a lag of the velocity the damper feels q'."""
    lin = slider(M, D, k, force_filter=T).linearize(coordinates="state")
    keep = [lin.state_names.index(name) for name in ("q_slide", "w_vz", "F_filter_fz")]  # the filters of the other components act on nothing
    assert_polynomial(lin.A[0][np.ix_(keep, keep)], np.polyadd(np.polymul([M, D, 0], [T, 1]), [k]))
    damped = replace(slider(M, D, k, velocity_lag=T), environment=Environment(k, c, preload=10.0))
    assert_polynomial(damped.linearize().A[0], np.polyadd(np.polymul([M, D, 0], [T, 1]), [c, k]))


@FEW
@given(M=masses, D=dampings, T=lags)
def test_behind_a_lag_there_is_a_stiffest_wall(M: float, D: float, T: float) -> None:
    bound = D / T + D * D / M
    for factor, stable in ((0.99, True), (1.01, False)):
        assert bool(slider(M, D, factor * bound, velocity_lag=T).linearize().stable[0]) == stable
        assert bool(slider(M, D, 0.4 * factor * bound, 0.6 * factor * bound, velocity_lag=T).linearize().stable[0]) == stable


BOUND = 60.0 / 0.05 + 60.0**2 / 4.0  #: of M = 4, D = 60, T = 0.05


@pytest.mark.parametrize(("factor", "grows"), [(0.8, False), (1.2, True)])
def test_simulations_on_both_sides_of_the_stiffest_wall_decay_and_grow(factor: float, grows: bool) -> None:
    run = slider(4.0, 60.0, factor * BOUND, velocity_lag=0.05).simulate(np.linspace(0, 3, 1501), 1e-4)
    F = np.abs(run.force[:, 2] - 10.0)
    assert (F[1200:].max() > F[300:600].max()) == grows


@pytest.mark.parametrize("hardware", [
    {"delay": 0.01}, {"force_delay": 0.01}, {"servo": Servo(50.0, 0.7, 0.016)}, {"sample_time": 8e-3, "servo": Servo(50.0, 0.7, 0.016)},
    {"sample_time": 8e-3, "delay": 0.012, "force_delay": 0.004, "force_filter": 5e-3}, {"velocity_lag": 0.01, "force_filter": 0.01, "delay": 3e-3},
], ids=str)  # fmt: skip
def test_the_bound_of_the_verdict_is_that_of_the_runs_through_every_imperfection(hardware: dict) -> None:
    """The stiffest stable wall by bisection on the verdict; runs on softer and stiffer ones decay and grow."""
    low, high = 10.0, 1e6
    for _ in range(20):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if slider(4.0, 200.0, middle, **hardware).linearize().stable[0] else (low, middle)
    for factor, grows in ((0.8, False), (1.25, True)):
        run = slider(4.0, 200.0, factor * low, **hardware).simulate(np.linspace(0, 1.6, 801), 1e-5)
        F = np.abs(run.force[:, 2] - 10.0)
        assert run.diverged or (F[600:].max() > F[200:400].max()) == grows
        assert grows or not run.diverged


def test_sampled_the_law_advances_exactly_with_the_force_held() -> None:
    """w by the exponential of -D/M under the held force, q by the held velocity: a map of two states."""
    M, D, k, h = 4.0, 60.0, 900.0, 0.02
    phi = np.exp(-D / M * h)
    A = np.array([[1.0, h], [-k * (1 - phi) / D, phi]])
    assert_allclose(np.sort_complex(slider(M, D, k, sample_time=h).linearize().poles()[0]), np.sort_complex(np.linalg.eigvals(A)), rtol=1e-9)
    run = slider(M, D, k, sample_time=h).simulate(np.arange(0, 0.5001, h), 1e-3)
    x = np.array([-1e-3, 0.0])
    for q in run.q[:, 0]:
        assert_allclose(q, x[0], atol=1e-10)
        x = A @ x


# --- six axes ----------------------------------------------------------------------------------------------------------------


def test_six_axes_of_a_gantry_are_six_of_one_direction() -> None:
    M, D, K, wall, T = each(6, 4.0), each(6, 60.0), each(6, 50.0), each(6, 900.0), 0.02
    loop = ClosedLoop(
        gantry(), L.Admittance(np.zeros(6), M, D, K), Hold(np.zeros(6)), environment=Environment(np.diag(wall)), hardware=Hardware(velocity_lag=T)
    )
    lin = loop.linearize(coordinates="state")
    names = tuple(name.replace("w_w", "w_r").replace("w_v", "w_") for name in lin.state_names)
    for A, m, d, s, k in zip(axis_blocks(lin.A[0], names), M, D, K, wall, strict=True):
        assert_polynomial(A, [m * T, m + d * T, d, s + k])


@pytest.mark.parametrize("name", ["ur5", "panda", "kinova"])
def test_an_arm_on_a_wall_in_all_directions_is_six_of_one_direction(name: str) -> None:
    """With one lag for all joints, whatever the arm: (M T s^3 + (M + D T) s^2 + D s + K + k)^6."""
    M, D, K, k, T = 4.0, 60.0, 50.0, 900.0, 0.02
    q = regular_pose(name)
    law = L.Admittance(np.zeros(6), M, D, K)
    loop = ClosedLoop(arm(name), law, Hold(q), environment=Environment(k * np.eye(6)), hardware=Hardware(velocity_lag=T))
    poles = loop.linearize().poles()[0]
    want = np.append(np.roots([M * T, M + D * T, D, K + k]), [0.0, -1 / T][: 2 * (arm(name).n - 6)])  # the self-motion: at rest, and its lag
    distance = np.abs(poles[:, None] - want)
    assert distance.min(axis=1).max() < 2e-3 * np.abs(want).max()  # a root of multiplicity six is known to a sixth of the digits
    assert_allclose(poles.sum().real, 6 * -(M + D * T) / (M * T) - (arm(name).n - 6) / T, rtol=1e-9)


# --- Jacobians, order and runs -----------------------------------------------------------------------------------------------

CHAINS = {
    "ideal": {}, "lag": {"velocity_lag": 5e-3}, "servo": {"servo": Servo(50.0, 0.7, 0.016)},
    "all": {"servo": Servo(50.0, 0.7, 4e-3), "velocity_lag": 2e-3, "force_filter": 3e-3, "delay": 2e-3, "force_delay": 1e-3, "velocity_limit": 1e3,
            "force_limit": 1e5},
    "sampled": {"servo": Servo(50.0, 0.7, 0.016), "sample_time": 8e-3, "force_filter": 3e-3},
}  # fmt: skip


@pytest.mark.parametrize("chain", CHAINS)
@pytest.mark.parametrize("case", named("admittance", "admittance free"), ids=str)
def test_the_jacobian_is_exact_behind_hardware_and_in_contact(case: Case, chain: str) -> None:
    for contact in (False, True):
        found = misfit(loop_of(case, "ur5", contact=contact, hardware=Hardware(**CHAINS[chain])), seed(case.name, chain))
        assert found.error < 1e-7
        assert abs(found.order - 2.0) <= 0.05


@pytest.mark.parametrize(("name", "chain"), [("panda", "sampled"), ("z1", "ideal")])
def test_the_linear_prediction_of_a_run_on_a_wall_is_of_second_order(name: str, chain: str) -> None:
    q = regular_pose(name)
    wall = Environment([3000.0, 1000.0, 1000.0, 100.0], 10.0 if chain != "ideal" else 0.0, axes="zxyrx", preload=[10.0, 0, 0, 0])
    law = L.Admittance(PUSH, 5.0, 300.0, [200, 200, 0, 20, 20, 20], axes=None)
    loop = ClosedLoop(arm(name), law, Hold(q), environment=wall, hardware=Hardware(**CHAINS[chain]))
    assert abs(loop.validate(time=0.02).taylor_order - 2.0) <= 0.05


# --- statics, motion and limits ----------------------------------------------------------------------------------------------


def test_at_rest_the_force_is_the_one_asked_for_and_with_a_spring_it_shares() -> None:
    """K = 0: F = F_d. With K and the reference d inside a wall k: k x = F_d + K (d - x)."""
    wall = Environment(900.0, pose=robots.slider(1.0).pose([0.0]))
    loop = ClosedLoop(robots.slider(1.0), L.Admittance(PUSH, 4.0, 60.0, axes="z"), Hold([0.02]), environment=wall)
    assert_allclose(loop.equilibrium().force, PUSH, atol=1e-9)
    assert_allclose(loop.simulate(3.0).force[-1], PUSH, atol=1e-4)
    spring = replace(loop, law=replace(loop.law, stiffness=300.0))
    assert_allclose(spring.equilibrium().force[2], 900.0 * (10.0 + 300.0 * 0.02) / 1200.0, rtol=1e-9)


def test_in_free_space_the_tool_moves_at_the_force_over_the_damping() -> None:
    """w = F_d / D (1 - exp(-D t / M)), into the direction that F_d presses."""
    loop = ClosedLoop(robots.slider(1.0), L.Admittance(PUSH, 4.0, 60.0, axes="z"), Hold([0.0]))
    run = loop.simulate(np.linspace(0, 0.5, 26), rtol=1e-9, atol=1e-11)
    assert_allclose(run.v[:, 0], 10.0 / 60.0 * (1 - np.exp(-15.0 * run.t)), atol=1e-7)


def test_an_arm_follows_a_moving_reference_exactly_and_comes_back_to_it() -> None:
    """[Ad] V_d is fed forward, and K pulls an initial error in: M X_e'' + D X_e' + K X_e = 0 in translation."""
    path = ToolSinusoid(arm("ur5").pose(regular_pose("ur5")), [0.01, 0.015, -0.01], 3.0, axis=(1, 0, 2), angle=0.1, phase=0.4)
    loop = ClosedLoop(arm("ur5"), L.Admittance(np.zeros(6), 2.0, 40.0, 150.0), path, q_start=regular_pose("ur5"))
    assert np.abs(loop.simulate(np.linspace(0, 1, 11), rtol=1e-9, atol=1e-11).error).max() < 1e-6
    X_e = np.array([0.01, -0.02, 0.015, 0, 0, 0])
    still = replace(loop, ref=Hold(regular_pose("ur5")), q_start=None)
    run = still.simulate(np.linspace(0, 1, 21), X_e, rtol=1e-10, atol=1e-12)
    A = np.array([[0, 1], [-75.0, -20.0]])
    want = np.array([expm(A * t)[0, 0] for t in run.t])
    assert_allclose(run.error, want[:, None] * X_e, atol=1e-7)


def test_a_dead_band_and_a_saturation_of_the_force_act_in_runs_and_by_their_slope_in_the_linear_model() -> None:
    base = slider(4.0, 60.0, 900.0)
    dead, cut = (replace(base, hardware=Hardware(**{name: value})) for name, value in (("force_deadband", 2.0), ("force_limit", 30.0)))
    assert_allclose(dead.equilibrium().force[2], 12.0, rtol=1e-9)  # the law sees 2 N less than there are
    assert_allclose(dead.simulate(3.0).force[-1, 2], 12.0, atol=1e-3)
    for loop in (dead, cut):  # outside the band and below the limit: the same slope
        assert_allclose(loop.linearize().A, base.linearize().A)
    inside = replace(base, hardware=Hardware(force_deadband=20.0)).linearize().A[0]
    beyond = replace(base, hardware=Hardware(force_limit=5.0)).linearize().A[0]
    for A in (inside, beyond):
        assert not A[1, 0]  # the force does nothing
    per_axis = replace(base, hardware=Hardware(force_deadband=[1.0, 1, 0, 1, 1, 1]))
    assert_allclose(per_axis.linearize().A, base.linearize().A)
    hit = replace(base, environment=Environment(900.0, preload=-50.0, one_sided=True), hardware=Hardware(velocity_limit=0.05, force_limit=30.0))
    run = hit.simulate(np.linspace(0, 4, 401))
    assert np.abs(run.tau).max() <= 0.05 + 1e-12 and np.abs(run.command).max() > 0.05
    assert any(event.kind == "touch" for event in run.events)
    assert_allclose(run.force[-1, 2], 10.0, atol=0.05)


# --- points and what is refused ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_margins_at_the_force_are_those_of_a_stiffer_wall(name: str) -> None:
    """L at the sensor grows with the wall: the gain that it still takes is the stiffest wall over this one."""
    M, D, k, T = 4.0, 60.0, 300.0, 0.05
    law = L.Admittance(PUSH, M, D)
    wall = Environment(k * np.eye(6))
    loop = ClosedLoop(arm(name), law, Hold(regular_pose(name)), environment=wall, hardware=Hardware(velocity_lag=T))
    found = loop.linearize().margins(at="force").gain_increase[0]
    together = (D / T + D * D / M) / k  # one axis at a time, the others closed: nothing couples them
    assert_allclose(found, together, rtol=1e-6)


def test_a_damper_without_a_velocity_of_the_joints_and_a_singular_pose_are_refused() -> None:
    with pytest.raises(Unsupported, match="velocity_lag or servo"):
        replace(slider(4.0, 60.0, 900.0), environment=Environment(900.0, 5.0))
    straight = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    x = np.r_[straight, np.zeros(6)]
    law = L.Admittance(np.zeros(6), 1.0, 10.0)
    with pytest.raises(NearSingular):
        ClosedLoop(arm("ur5"), law, Hold(straight)).equations.flow(0.0, x)
    soft = ClosedLoop(arm("ur5"), replace(law, inverse_damping=0.1), Hold(straight))
    assert_allclose(soft.equations.flow(0.0, x).command, 0.0, atol=1e-12)
    with pytest.raises(BadArgument, match="inertia"):
        L.Admittance(np.zeros(6), 0.0, 10.0)
    with pytest.raises(BadArgument, match="inertia"):
        ClosedLoop(arm("ur5"), L.Admittance(np.zeros(6), np.ones(3), 10.0), Hold(straight))


def test_the_gains_take_every_shape() -> None:
    q, shapes = regular_pose("ur5"), (3.0, np.full(6, 3.0), 3.0 * np.eye(6))
    A = [ClosedLoop(arm("ur5"), L.Admittance(PUSH, s, s, s), Hold(q)).linearize().A for s in shapes]
    assert_allclose(A[1], A[0], atol=1e-12)
    assert_allclose(A[2], A[0], atol=1e-12)
    some = L.Admittance(PUSH, each(3, 2.0), full(3, 3.0), axes="xyz")
    assert ClosedLoop(arm("ur5"), some, Hold(q)).equations.parts["w"].slot.channels == ("vx", "vy", "vz")
