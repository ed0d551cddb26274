"""Lags, filters, dead time, sampling, elastic joints and limits against their closed forms; all off is the ideal loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.special import lambertw

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.flow import NO_INPUTS, uncut
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.law import Measured
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.dual import value
from mfc_analysis.trajectories import Hold
from tests.conftest import LAWS, Case, arm, loop_of, moving, named, plant, regular_pose, seed

FEW = settings(max_examples=15, deadline=None)
TIMES = np.array([0.1, 0.7])
I, B_FRICTION, MGR = 0.5, 0.1, 0.981  # of the single joint
PLANT = np.array([I, B_FRICTION, -MGR * np.sin(0.4)])  # about th = 0.4
kps, kis, kds, lags = st.floats(5, 100), st.floats(0.5, 50), st.floats(0.5, 20), st.floats(1e-3, 0.2)


def joint(law: L.Law, **hardware: object) -> np.ndarray:
    """A of the single joint about th = 0.4."""
    return ClosedLoop(robots.single_joint(), law, Hold([0.4]), hardware=Hardware(**hardware)).linearize([0.0]).A[0]


def assert_polynomial(A: np.ndarray, *wanted: object) -> None:
    """The characteristic polynomial of A is the sum of these polynomials, made monic."""
    want = np.zeros(1)
    for one in wanted:
        want = np.polyadd(want, one)
    want = np.asarray(want) / want[0]
    assert len(want) == len(A) + 1
    scale = max(np.abs(np.linalg.eigvals(A)).max(), 1e-9) ** np.arange(len(want))
    assert np.max(np.abs(np.poly(A) - want) / scale) < 1e-11


# --- lags and filters --------------------------------------------------------------------------------------------------------


@FEW
@given(k=kps, ki=kis, T=lags)
def test_a_velocity_lag_adds_one_order(k: float, ki: float, T: float) -> None:
    assert_polynomial(joint(L.VelocityP(k), velocity_lag=T), [T, 1, k])
    assert_polynomial(joint(L.VelocityPI(k, ki), velocity_lag=T), [T, 1, k, ki])


@FEW
@given(kp=kps, ki=kis, kd=kds, T=lags)
def test_a_torque_lag_stands_before_the_plant(kp: float, ki: float, kd: float, T: float) -> None:
    """(T s + 1) s (I s^2 + b s - m g r sin th) + kd s^2 + kp s + ki."""
    assert_polynomial(joint(L.JointPID(kp, ki, kd), torque_lag=T), np.polymul(np.polymul([T, 1], PLANT), [1, 0]), [kd, kp, ki])


@FEW
@given(kp=kps, ki=kis, kd=kds, T=lags)
def test_a_velocity_filter_delays_the_damping_only(kp: float, ki: float, kd: float, T: float) -> None:
    loop = np.polymul(np.polymul(PLANT, [1, 0]), [T, 1])
    assert_polynomial(joint(L.JointPID(kp, ki, kd), velocity_filter=T), loop, np.polymul([kp, ki], [T, 1]), [kd, 0, 0])


@FEW
@given(m=st.floats(0.3, 4), k=st.floats(100, 1e4), kfp=st.floats(0, 3), kfi=st.floats(0.1, 9), kdamp=st.floats(1, 90), T=lags)
def test_a_force_filter_delays_the_force(m: float, k: float, kfp: float, kfi: float, kdamp: float, T: float) -> None:
    """s (T s + 1)(m s^2 + kdamp s + k) + k (kfp s + kfi)."""
    law = L.DampedForcePI([0, 0, 5.0, 0, 0, 0], kfp, [0, 0, kfi, 0, 0, 0], kdamp)
    loop = ClosedLoop(robots.slider(m), law, Hold([0.0]), environment=Environment(k, preload=5.0), hardware=Hardware(force_filter=T))
    lin = loop.linearize([0.0])
    keep = [lin.state_names.index(n) for n in ("q_slide", "v_slide", "z_f_fz", "F_filter_fz")]
    assert_polynomial(lin.A[0][np.ix_(keep, keep)], np.polymul(np.polymul([1, 0], [T, 1]), [m, kdamp, k]), [k * kfp, k * kfi])


# --- elastic joints ----------------------------------------------------------------------------------------------------------


@FEW
@given(kp=kps, ki=kis, kd=kds, K=st.floats(20, 5000), D=st.floats(0.1, 10), B=st.floats(0.02, 1))
def test_an_elastic_joint_is_two_masses_and_a_spring(kp: float, ki: float, kd: float, K: float, D: float, B: float) -> None:
    """Link I s^2 + b s - m g r sin th, motor B s^2, spring D s + K between them, PID at the motor or at the link."""
    spring, motor, pid = np.array([D, K]), np.array([B, 0, 0]), np.array([kd, kp, ki])
    link = np.polyadd(PLANT, spring)
    for feedback in ("motor", "link"):
        A = joint(L.JointPID(kp, ki, kd), joint_stiffness=K, joint_damping=D, motor_inertia=B, feedback=feedback)
        free = np.polyadd(np.polymul(link, np.polyadd(motor, spring)), -np.polymul(spring, spring))
        at = link if feedback == "motor" else spring
        assert_polynomial(A, np.polymul(free, [1, 0]), np.polymul(at, pid))


@FEW
@given(kp=kps, kd=kds, K=st.floats(20, 5000), T=lags)
def test_the_filter_sees_the_speed_where_the_encoder_sits(kp: float, kd: float, K: float, T: float) -> None:
    """PD with a filtered rate at the motor or at the link of an elastic joint."""
    spring, motor, lag = np.array([K]), np.array([0.2, 0, 0]), np.array([T, 1])
    link = np.polyadd(PLANT, spring)
    free = np.polymul(lag, np.polyadd(np.polymul(link, np.polyadd(motor, spring)), [-K * K]))
    pd = np.polyadd(np.polymul([kp], lag), [kd, 0])
    for feedback, at in (("motor", link), ("link", spring)):
        A = joint(L.JointPID(kp, kd=kd), joint_stiffness=K, motor_inertia=0.2, velocity_filter=T, feedback=feedback)
        assert_polynomial(A, free, np.polymul(at, pd))


def test_cut_at_the_encoder_the_filtered_rate_is_cut_as_well() -> None:
    w = np.array([0.4, 3.0, 30.0])
    s, T = 1j * w, 0.05
    lin = ClosedLoop(robots.single_joint(), L.JointPID(20.0, 5.0, 3.0), Hold([0.4]), hardware=Hardware(velocity_filter=T)).linearize([0.0])
    want = (20.0 + 5.0 / s + 3.0 * s / (T * s + 1)) / np.polyval(PLANT, s)
    for at in ("torque", "position"):
        assert_allclose(lin.frequency_response(w, at)[0, 0], want, rtol=1e-9)


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_a_stiff_elastic_joint_is_a_rigid_one_with_the_motors_inertia(feedback: str) -> None:
    kp, ki, kd, B = 60.0, 30.0, 8.0, 0.3
    rigid = np.roots(np.polyadd(np.polymul(np.polyadd(PLANT, [B, 0, 0]), [1, 0]), [kd, kp, ki]))
    gaps = []
    for K in (1e5, 1e6, 1e7):
        A = joint(L.JointPID(kp, ki, kd), joint_stiffness=K, joint_damping=0.05 * np.sqrt(K), motor_inertia=B, feedback=feedback)
        poles = np.linalg.eigvals(A)
        slow = poles[np.argsort(np.abs(poles))[:3]]
        gaps.append(np.abs(np.sort_complex(slow) - np.sort_complex(rigid)).max())
    assert gaps[2] < 1e-3 and gaps[1] / gaps[2] > 2.5  # falls at least as the square root of the stiffness


def test_an_arm_with_stiff_joints_is_the_rigid_arm_with_armature() -> None:
    q, B = regular_pose("ur5"), 0.2
    law = L.ComputedTorque(60.0, 20.0, 12.0)
    stiff = ClosedLoop(arm("ur5"), law, Hold(q), hardware=Hardware(joint_stiffness=1e8, joint_damping=1e4, motor_inertia=B)).linearize([0.0])
    rigid = ClosedLoop(arm("ur5").with_armature(arm("ur5").armature + B), law, Hold(q), controller_model=arm("ur5")).linearize([0.0])
    slow = stiff.poles()[0][:18]
    far = [np.abs(slow - p).min() for p in rigid.poles()[0]]
    assert max(far) < 1e-3


@pytest.mark.parametrize("case", [c for c in LAWS if c.law(6).plant == "torque" and not c.law(6).needs_acceleration], ids=str)
def test_every_law_sees_the_encoder_that_feedback_names(case: Case) -> None:
    """The torque of the loop is that of the law at (theta, omega) or at (q, v), where the two differ."""
    rng = seed("encoder", case.name)
    for feedback, places in (("motor", ("theta", "omega")), ("link", ("q", "v"))):
        loop = loop_of(case, "ur5", hardware=Hardware(joint_stiffness=2e3, motor_inertia=0.3, feedback=feedback))
        e = loop.equations
        x = loop.linearize(TIMES[:1]).point.x[0]
        s = e.split(x + 0.02 * rng.normal(size=x.shape))
        F = rng.normal(size=6)
        action, _ = e.control(0.1, s, F, uncut, NO_INPUTS)
        now = Measured(*(s[name] for name in places), F if e.law.senses_force else np.zeros(6), s)
        assert np.array_equal(value(action.command), value(e.law.act(e.controller, now, e.reference(0.1), uncut).command))


@pytest.mark.parametrize("lag", [None, 0.02])
def test_feedforward_as_printed_has_the_acceleration_of_its_encoder(lag: float | None) -> None:
    """A mass m with m^ a of the link, B th'' + K (th - q) = m^ (a_d - q''), or of the motor, (B + m^) th'' + K (th - q) = m^ a_d."""
    m, m_hat, K, B = 2.0, 0.7, 500.0, 0.3
    for feedback in ("motor", "link"):
        hardware = Hardware(joint_stiffness=K, motor_inertia=B, feedback=feedback, torque_lag=lag)
        law = L.TorqueFeedforward("printed")
        loop = ClosedLoop(robots.slider(mass=m), law, Hold([0.1]), controller_model=robots.slider(mass=m_hat), hardware=hardware)
        late = [1.0] if lag is None else [lag, 1.0]
        motor = np.polyadd(np.polymul(late, [B, 0, K]), [m_hat, 0, 0] if feedback == "motor" else [0.0])
        link = np.polyadd([m, 0, K], [0.0])
        coupled = np.polymul(late, [K]) if feedback == "motor" else np.polyadd(np.polymul(late, [K]), [-m_hat, 0, 0])
        assert_polynomial(loop.linearize([0.0]).A[0], np.polymul(motor, link), -np.polymul(coupled, [K]))
        run = loop.simulate(0.3, q=[0.12], v=[0.0], rtol=1e-9, atol=1e-11)
        x0 = run.x[0] - loop.linearize([0.0]).point.x[0]
        want = loop.linearize([0.0]).point.x[0] + expm(0.3 * loop.linearize([0.0]).A[0]) @ x0  # the loop is linear
        assert_allclose(run.x[-1], want, atol=1e-7)


def test_the_residual_of_an_elastic_joint_is_that_of_the_rigid_one() -> None:
    """Without an integral nothing holds the weight: the springs do not hide it."""
    B, law, robot = 0.2, L.ComputedTorque(60.0, kd=12.0), plant("ur5")
    springs = Hardware(joint_stiffness=1e6, motor_inertia=B, feedback="link")
    elastic = ClosedLoop(robot, law, moving("ur5"), arm("ur5"), hardware=springs).linearize(TIMES)
    rigid = ClosedLoop(robot.with_armature(robot.armature + B), law, moving("ur5"), arm("ur5")).linearize(TIMES)
    assert np.abs(rigid.residual).max() > 0.1
    assert_allclose(elastic.residual, rigid.residual, rtol=1e-4, atol=1e-4)


# --- dead time ---------------------------------------------------------------------------------------------------------------


@FEW
@given(k=st.floats(0.5, 20))
def test_dead_time_destabilises_an_integrator_at_pi_over_2k(k: float) -> None:
    for factor, stable in ((0.99, True), (1.01, False)):
        lin = ClosedLoop(robots.single_joint(), L.VelocityP(k), Hold([0.4]), hardware=Hardware(delay=factor * np.pi / (2 * k))).linearize([0.0])
        assert bool(lin.stable[0]) == stable
        assert_allclose(lin.A[0], [[-k]])  # dead time is left out of A ...
        assert_allclose(lin.delay, factor * np.pi / (2 * k))  # ... which says so


@pytest.mark.parametrize("kd_", [0.2, 1 / np.e - 1e-3, 1.0, 1.7])
def test_the_rightmost_roots_with_dead_time_are_lamberts(kd_: float) -> None:
    k = 5.0
    d = kd_ / k
    lin = ClosedLoop(robots.single_joint(), L.VelocityP(k), Hold([0.4]), hardware=Hardware(delay=d)).linearize([0.0])
    want = np.array([lambertw(-k * d, branch) / d for branch in range(-4, 5)])
    want = want[np.argsort(-want.real, kind="stable")][:4]
    found = lin.delay_roots(4)[0]
    assert_allclose(np.sort(found.real), np.sort(want.real), atol=1e-7)
    assert_allclose(np.sort(np.abs(found.imag)), np.sort(np.abs(want.imag)), atol=1e-7)


def test_dead_time_shifts_the_phase_of_the_loop() -> None:
    w = np.array([0.5, 3.0, 20.0])
    law = L.JointPID(20.0, 5.0, 3.0)
    plain, late = (ClosedLoop(robots.single_joint(), law, Hold([0.4]), hardware=Hardware(delay=d)).linearize([0.0]) for d in (None, 0.02))
    assert_allclose(late.frequency_response(w), plain.frequency_response(w) * np.exp(-0.02j * w), rtol=1e-9)
    margin = plain.margins().delay[0, 0]
    assert_allclose(late.margins().delay[0, 0], margin - 0.02, rtol=1e-6)
    for d, stable in ((0.99 * margin, True), (1.01 * margin, False)):
        assert bool(ClosedLoop(robots.single_joint(), law, Hold([0.4]), hardware=Hardware(delay=d)).linearize([0.0]).stable[0]) == stable


# --- all off, and what does not apply ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", named("9.2", "9.5 standard", "9.8", "9.10 standard", "9.16 standard", "9.23", "9.24 dynamic standard"), ids=str)
def test_all_imperfections_off_are_the_ideal_loop(case: Case) -> None:
    """None, and zeros, and time constants of a nanosecond seen from the slow poles."""
    contact = case.law(6).plant == "torque"
    ideal = loop_of(case, "ur5", contact=contact).linearize(TIMES)
    off = Hardware(torque_lag=0, velocity_lag=0, delay=0, force_delay=0.0, sample_time=0, force_filter=0, velocity_filter=np.zeros(6), torque_limit=0)
    assert off.ideal and not off.elastic
    none = loop_of(case, "ur5", contact=contact, hardware=off).linearize(TIMES)
    assert none.state_names == ideal.state_names and none.delay == none.force_delay == none.dt == 0.0
    assert_allclose(none.A, ideal.A, rtol=0, atol=1e-12 * np.abs(ideal.A).max())


@pytest.mark.parametrize("case", named("9.2", "9.8", "9.16 standard"), ids=str)
def test_the_poles_of_a_fast_lag_are_those_of_the_ideal_loop(case: Case) -> None:
    fast = {"velocity_lag": 1e-7} if case.law(6).plant == "velocity" else {"torque_lag": 1e-7, "velocity_filter": 1e-7}
    contact = case.law(6).plant == "torque"
    ideal = loop_of(case, "ur5", contact=contact).linearize([0.1]).poles()[0]
    slow = loop_of(case, "ur5", contact=contact, hardware=Hardware(**fast)).linearize([0.1]).poles()[0]
    slow = slow[np.abs(slow) < 1e5]
    assert slow.size == ideal.size
    for pole in ideal:
        assert np.abs(slow - pole).min() < 1e-3 * max(1.0, abs(pole))  # they move by T s^2


@pytest.mark.parametrize(("given", "argument"), [
    ({"torque_lag": -1e-3}, "torque_lag"), ({"delay": np.nan}, "delay"), ({"delay": [1e-3, 2e-3]}, "delay"),
    ({"sample_time": np.inf}, "sample_time"), ({"velocity_filter": [1e-3, 0.0]}, "velocity_filter"), ({"torque_limit": "strong"}, "torque_limit"),
    ({"torque_lag": np.ones((2, 2))}, "torque_lag"),
    ({"joint_stiffness": 1e3}, "joint_stiffness"), ({"motor_inertia": 1.0}, "motor_inertia"), ({"joint_damping": 1.0}, "joint_damping"),
    ({"feedback": "both"}, "feedback"), ({"delay": 3.0, "sample_time": 1e-3}, "delay"),
])  # fmt: skip
def test_hardware_that_cannot_be_is_refused_by_name(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        Hardware(**given)
    assert argument in info.value.argument


def test_hardware_for_another_number_of_joints_is_refused() -> None:
    with pytest.raises(BadArgument, match=r"torque_lag.*\(2,\)") as info:
        ClosedLoop(robots.planar_2r(), L.JointPID(1.0), Hold([0.1, 0.2]), hardware=Hardware(torque_lag=[1e-3, 2e-3, 3e-3]))
    assert "torque_lag" in info.value.argument
    with pytest.raises(BadArgument, match="Hardware"):
        ClosedLoop(robots.planar_2r(), L.JointPID(1.0), Hold([0.1, 0.2]), hardware={"delay": 1e-3})


def test_a_torque_limit_holds_in_simulation() -> None:
    loop = ClosedLoop(robots.single_joint(), L.JointPID(200.0, kd=20.0), Hold([0.4]), hardware=Hardware(torque_limit=5.0))
    sim = loop.simulate(1.0, 0.5)
    assert np.abs(sim.command).max() > 50 and np.abs(sim.tau).max() <= 5.0
    lagged = ClosedLoop(robots.single_joint(), L.JointPID(200.0, kd=20.0), Hold([0.4]), hardware=Hardware(torque_limit=5.0, torque_lag=0.01))
    assert np.abs(lagged.simulate(1.0, 0.5).tau).max() <= 5.0 + 1e-6
