"""Equations 9.6 to 9.13 against their closed forms: polynomials, Routh's bound from both sides, error dynamics on any robot at any point."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from mfc_analysis import laws as L, robots
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, Quintic, Sinusoid
from tests.conftest import ROBOTS, arm, full, moving, plant, regular_pose, seed

FEW = settings(max_examples=15, deadline=None)
TIMES = np.array([0.0, 0.3, 0.8])
angles = st.floats(-3.0, 3.0)
G = 9.81


def h(robot: robots.Robot, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """C v + g + viscous friction: what a controller that knows this robot computes."""
    return robot.bias(q, v) + robot.viscous * v


def joint_polynomial(I: float, b: float, mgr: float, th: float, kp: float, ki: float, kd: float) -> list[float]:
    """Of 9.6 under 9.8 about th."""
    return [I, b + kd, kp - mgr * np.sin(th), ki]


# --- 9.6 to 9.8 --------------------------------------------------------------------------------------------------------------


@FEW
@given(I=st.floats(0.2, 3), m=st.floats(0.1, 2), r=st.floats(0.05, 0.3), b=st.floats(0, 1), th=angles,
       kp=st.floats(0, 60), ki=st.floats(-10, 60), kd=st.floats(0, 10))  # fmt: skip
def test_pid_on_one_joint_has_its_polynomial(I: float, m: float, r: float, b: float, th: float, kp: float, ki: float, kd: float) -> None:
    robot = robots.single_joint(inertia=I + m * r * r, mass=m, com_distance=r, damping=b)
    lin = ClosedLoop(robot, L.JointPID(kp, ki, kd), Hold([th])).linearize([0.0])
    want = np.array(joint_polynomial(I + m * r * r, b, m * G * r, th, kp, ki, kd))
    assert_allclose(np.poly(lin.A[0]) * want[0], want, atol=1e-9 * np.abs(want).max())


@FEW
@given(th=angles)
def test_the_joint_alone_falls_over_where_the_sine_is_positive(th: float) -> None:
    assume(abs(np.sin(th)) > 1e-3)
    lin = ClosedLoop(robots.single_joint(), L.TorqueFeedforward(), Hold([th])).linearize([0.0])
    assert (lin.poles().real.max() > 0) == (np.sin(th) > 0)
    assert bool(lin.stable[0]) == (np.sin(th) < 0)


@FEW
@given(th=angles, kp=st.floats(2, 60), kd=st.floats(0.1, 10))
def test_pid_is_stable_up_to_rouths_bound_and_no_further(th: float, kp: float, kd: float) -> None:
    stiffness = kp - G * 0.1 * np.sin(th)
    bound = (0.1 + kd) * stiffness / 0.5
    for factor, stable in ((0.99, True), (1.01, False)):
        lin = ClosedLoop(robots.single_joint(), L.JointPID(kp, factor * bound, kd), Hold([th])).linearize([0.0])
        assert bool(lin.stable[0]) == stable
    for ki in (0.0, -1e-3):  # a coefficient that is not positive: a root to the right of zero, however slow
        lin = ClosedLoop(robots.single_joint(), L.JointPID(kp, ki, kd), Hold([th])).linearize([0.0], horizon=np.inf)
        assert bool(lin.stable[0]) == (ki == 0.0)  # the integral with gain 0 acts on nothing


def test_simulations_on_both_sides_of_rouths_bound_decay_and_grow() -> None:
    th, kp, kd = 0.5, 20.0, 1.0
    bound = (0.1 + kd) * (kp - G * 0.1 * np.sin(th)) / 0.5
    for factor, grows in ((0.9, False), (1.1, True)):
        loop = ClosedLoop(robots.single_joint(), L.JointPID(kp, factor * bound, kd), Hold([th]))
        sim = loop.simulate(np.linspace(0, 20, 2001), 0.01, integral="trimmed", rtol=1e-8)
        e = np.abs(sim.error[:, 0])
        poles = loop.linearize([0.0]).poles()[0]
        rate = poles[np.abs(poles.imag) > 1].real[0]
        ratio = e[-500:].max() / e[500:1000].max()
        assert (ratio > 1) == grows
        assert_allclose(np.log(ratio), rate * 10, atol=0.15)  # windows of 5 s, ten seconds apart; the peaks are 1 s apart


def test_the_books_joint_has_a_double_pole_at_minus_2_1() -> None:
    """Inertia 0.5 kg m^2, friction 0.1 Nms about th = 0: the defaults. 2.205 / 0.5 = 2.1^2 and (0.1 + 2) / 0.5 = 2 * 2.1."""
    lin = ClosedLoop(robots.single_joint(), L.JointPID(2.205, kd=2.0), Hold([0.0])).linearize([0.0])
    assert_allclose(np.poly(lin.A[0]), np.poly([-2.1, -2.1]), rtol=1e-12)
    assert_allclose(lin.poles(), -2.1, atol=1e-6)


def test_the_pd_joint_sags_under_its_weight_and_a_trimmed_integral_holds_it() -> None:
    th_d, kp = 0.4, 15.0
    sag = brentq(lambda th: kp * (th_d - th) - G * 0.1 * np.cos(th), -2, 2, xtol=1e-14)
    loop = ClosedLoop(robots.single_joint(), L.JointPID(kp, kd=2.0), Hold([th_d]))
    rest = loop.equilibrium()
    assert_allclose(rest.q, sag, atol=1e-10)
    assert_allclose(rest.error, th_d - sag, atol=1e-10)
    assert_allclose(rest.torque, G * 0.1 * np.cos(sag), atol=1e-10)
    assert_allclose(loop.linearize([0.0]).residual, -G * 0.1 * np.cos(th_d) / 0.5, rtol=1e-10)
    there = loop.linearize([0.0], about="equilibrium")
    assert_allclose(there.residual, 0)
    assert_allclose(np.poly(there.A[0]) * 0.5, joint_polynomial(0.5, 0.1, G * 0.1, sag, kp, 0, 2.0)[:3], rtol=1e-9)
    assert_allclose(loop.simulate([0, 30.0], 0.0).q[-1], sag, atol=1e-6)
    held = ClosedLoop(robots.single_joint(), L.JointPID(kp, 4.0, 2.0), Hold([th_d]))
    assert_allclose(held.linearize([0.0]).residual, 0, atol=1e-12)
    assert_allclose(held.equilibrium().error, 0, atol=1e-11)


def test_a_payload_that_the_controller_does_not_know_sags_in_closed_form() -> None:
    """I^ kp e = m g l cos(th) with the payload at the tool, at 0.2 m."""
    model = robots.single_joint()
    th_d, m, kp = 0.3, 0.7, 30.0
    loop = ClosedLoop(model.with_payload(m), L.ComputedTorque(kp, kd=10.0), Hold([th_d]), controller_model=model)
    sag = brentq(lambda th: 0.5 * kp * (th_d - th) - m * G * 0.2 * np.cos(th), -2, 2, xtol=1e-14)
    assert_allclose(loop.equilibrium().q, sag, atol=1e-10)
    known = ClosedLoop(model.with_payload(m), L.ComputedTorque(kp, kd=10.0), Hold([th_d]))
    assert_allclose(known.equilibrium().error, 0, atol=1e-11)


# --- 9.9 ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_feedforward_leaves_the_poles_of_the_plant(name: str) -> None:
    robot, ref = arm(name), moving(name)
    lin = ClosedLoop(robot, L.TorqueFeedforward(), ref).linearize(TIMES)
    point, n, step = ref(TIMES), robot.n, 1e-5
    M = robot.mass(point.q)
    assert_allclose(lin.residual, 0, atol=1e-9)
    for j in range(n):
        d = step * np.eye(n)[j]
        dq = ((robot.mass(point.q + d) - robot.mass(point.q - d)) @ point.a[..., None])[..., 0] + h(robot, point.q + d, point.v)
        dq, dv = dq - h(robot, point.q - d, point.v), h(robot, point.q, point.v + d) - h(robot, point.q, point.v - d)
        for column, change in ((j, dq), (n + j, dv)):
            want = -np.linalg.solve(M, change[..., None])[..., 0] / (2 * step)
            assert_allclose(lin.A[:, n:, column], want, atol=1e-6 * np.abs(lin.A).max())  # central differences at h = 1e-5


@FEW
@given(I=st.floats(0.3, 3), I_hat=st.floats(0.3, 3), b=st.floats(0, 1), th=angles)
def test_as_printed_the_inertia_becomes_the_sum_of_both(I: float, I_hat: float, b: float, th: float) -> None:
    robot, model = (robots.single_joint(inertia=i, damping=b) for i in (I, I_hat))
    lin = ClosedLoop(robot, L.TorqueFeedforward("printed"), Hold([th]), controller_model=model).linearize([0.0])
    assert_allclose(np.poly(lin.A[0]) * (I + I_hat), [I + I_hat, b, -G * 0.1 * np.sin(th)], atol=1e-9)


def test_as_printed_a_free_joint_follows_half_the_acceleration() -> None:
    """Without gravity and friction I q'' = I (q_d'' - q''): q'' = q_d'' / 2."""
    robot = robots.single_joint(gravity=0.0, damping=0.0)
    sim = ClosedLoop(robot, L.TorqueFeedforward("printed"), Quintic([0.0], [1.0], 2.0)).simulate(np.linspace(0, 2, 21), rtol=1e-9, atol=1e-12)
    assert_allclose(sim.q[:, 0], 0.5 * Quintic([0.0], [1.0], 2.0)(sim.t).q[:, 0], atol=1e-8)
    right = ClosedLoop(robot, L.TorqueFeedforward(), Quintic([0.0], [1.0], 2.0)).simulate(np.linspace(0, 2, 21), rtol=1e-9, atol=1e-12)
    assert_allclose(right.error, 0, atol=1e-8)


def test_as_printed_n_joints_are_solved_with_the_acceleration_inside() -> None:
    loop = ClosedLoop(plant("ur5"), L.TorqueFeedforward("printed"), moving("ur5"), controller_model=arm("ur5"))
    e, t = loop.equations, 0.4
    x = loop.linearize([t]).point.x[0] + 0.1 * seed("9.9").normal(size=12)
    a, q, v, ref = e.rates(t, x)[6:], x[:6], x[6:], moving("ur5")(t)
    tau = arm("ur5").mass(ref.q) @ (ref.a - a) + h(arm("ur5"), ref.q, ref.v)
    assert_allclose(plant("ur5").mass(q) @ a + plant("ur5").bias(q, v) + 0.3 * v + 0.2 * np.tanh(v / 0.7), tau, atol=1e-9)
    assert_allclose(np.asarray(e.flow(t, x).command), tau, atol=1e-9)


# --- 9.10 to 9.13 ------------------------------------------------------------------------------------------------------------


def error_dynamics(kp: np.ndarray, ki: np.ndarray, kd: np.ndarray) -> np.ndarray:
    """A of (e, e', z) under e''' + kd e'' + kp e' + ki e = 0."""
    n, eye, o = len(kp), np.eye(len(kp)), np.zeros_like(kp)
    return np.block([[o, eye, o], [-kp, -kd, -ki], [eye, o, o]]) if n else o


@pytest.mark.parametrize("name", ROBOTS)
@given(kp=st.floats(1, 1000), ki=st.floats(0.1, 1000), kd=st.floats(0.1, 100), which=st.integers(0, 20))
@settings(max_examples=4, deadline=None)
def test_an_exact_model_leaves_only_the_error_polynomial(name: str, kp: float, ki: float, kd: float, which: int) -> None:
    robot = plant(name).with_friction(viscous=0.4)  # viscous friction is in h^
    n = robot.n
    Kp, Ki, Kd = full(n, kp), np.diag(np.linspace(1, 2, n)) * ki, full(n, kd)
    rng = seed(name, which)
    ref = Sinusoid(regular_pose(name, which % 3), rng.uniform(0, 0.1, n), 4.0, rng.uniform(0, 6, n))
    want = error_dynamics(Kp, Ki, Kd)
    for law in (L.ComputedTorque(Kp, Ki, Kd), L.InverseDynamics({"kp": Kp, "ki": Ki, "kd": Kd})):
        lin = ClosedLoop(robot, law, ref).linearize(TIMES, coordinates="error")
        # rounding of M^-1 (M a), with wrists of 1e-4 kg m^2 beside shoulders of 1
        assert_allclose(lin.A, np.broadcast_to(want, lin.A.shape), atol=2e-9 * max(kp, ki, kd, 100.0))
        assert_allclose(lin.residual, 0, atol=1e-8)


@pytest.mark.parametrize("name", ROBOTS)
def test_as_printed_the_derivatives_of_h_stay_in_the_loop(name: str) -> None:
    robot, ref = arm(name), moving(name)
    n, step = robot.n, 1e-5
    right, printed = (ClosedLoop(robot, L.ComputedTorque(100.0, 30.0, 20.0, form=form), ref).linearize(TIMES).A for form in ("standard", "printed"))
    point, M = ref(TIMES), robot.mass(ref(TIMES).q)
    for j in range(n):
        d = step * np.eye(n)[j]
        dq = (h(robot, point.q + d, point.v) - h(robot, point.q - d, point.v)) / (2 * step)
        dv = (h(robot, point.q, point.v + d) - h(robot, point.q, point.v - d)) / (2 * step)
        for column, change in ((j, dq), (n + j, dv)):
            want = -np.linalg.solve(M, change[..., None])[..., 0]
            assert_allclose((printed - right)[:, n : 2 * n, column], want, atol=1e-6 * np.abs(printed).max())
    assert np.abs(printed - right).max() > 0.05  # and they are there


def test_a_constant_mass_stands_where_the_mass_matrix_stood() -> None:
    robot, q = arm("ur5"), regular_pose("ur5")
    M0 = np.diag([3.0, 3.0, 1.0, 0.5, 0.3, 0.1])
    lin = ClosedLoop(robot, L.ComputedTorque(80.0, 20.0, 15.0, mass=M0), Hold(q)).linearize([0.0])
    scale = np.linalg.solve(robot.mass(q), M0)
    assert_allclose(lin.A[0, 6:12], np.hstack([-80 * scale, -15 * scale, 20 * scale]), atol=1e-8)


@FEW
@given(w=st.floats(0.5, 40))
def test_the_triple_pole_has_a_gain_margin_downwards_of_one_ninth(w: float) -> None:
    law = L.ComputedTorque(3 * w * w, w**3, 3 * w)
    lin = ClosedLoop(robots.single_joint(), law, Hold([0.7])).linearize([0.0])
    assert_allclose(np.poly(lin.A[0]), [1, 3 * w, 3 * w * w, w**3], rtol=1e-9)
    m = lin.margins(at="command")
    assert_allclose(m.gain_reduction, 1 / 9, rtol=1e-7)
    assert m.gain_increase[0, 0] == np.inf and m.stable[0]
    for factor, stable in ((0.99 / 9, False), (1.01 / 9, True)):
        weak = L.ComputedTorque(factor * 3 * w * w, factor * w**3, factor * 3 * w)
        assert bool(ClosedLoop(robots.single_joint(), weak, Hold([0.7])).linearize([0.0]).stable[0]) == stable


@pytest.mark.parametrize("name", ["single_joint", "ur5", "panda"])
def test_margins_at_the_command_are_those_of_the_pid_on_a_double_integrator(name: str) -> None:
    robot, ref = arm(name), moving(name)
    bad = ClosedLoop(robot, L.ComputedTorque(2.0, 10.0, 2.0), ref).linearize(TIMES)
    m = bad.margins(at="command")
    assert not bad.stable.any() and not m.stable.any()
    for figure in (m.gain_reduction, m.gain_increase, m.phase_deg, m.delay, m.sensitivity_peak, m.crossover):
        assert np.isnan(figure).all() and figure.shape == (3, robot.n)
    good = ClosedLoop(robot, L.ComputedTorque(100.0, 200.0, 20.0), ref).linearize(TIMES)
    m = good.margins(at="command")
    assert good.stable.all() and m.stable.all()
    assert_allclose(m.gain_reduction, 0.1, rtol=1e-6)
    assert np.all(m.gain_increase == np.inf)
    single = control.ss(control.tf([20, 100, 200], [1, 0, 0, 0]))
    _, phase, _, _, crossover, _ = control.stability_margins(single)
    assert_allclose(m.phase_deg, phase, rtol=1e-6)
    assert_allclose(m.crossover, crossover, rtol=1e-6)


@FEW
@given(kp=st.floats(0.5, 50), ki=st.floats(-2, 50), kd=st.floats(-1, 20))
def test_the_double_integrator_is_stable_iff_the_gains_are_positive_and_kd_kp_exceeds_ki(kp: float, ki: float, kd: float) -> None:
    assume(abs(kd * kp - ki) > 1e-3 and abs(ki) > 1e-3 and abs(kd) > 1e-3)
    lin = ClosedLoop(robots.planar_2r(), L.InverseDynamics({"kp": kp, "ki": ki, "kd": kd}), Hold([0.3, 0.5])).linearize([0.0])
    assert bool(lin.stable[0]) == (ki > 0 and kd > 0 and kd * kp > ki)
    assert_allclose(np.poly(lin.A[0]), np.polymul([1, kd, kp, ki], [1, kd, kp, ki]), atol=1e-7 * max(kp, abs(ki), abs(kd)) ** 2)


def test_any_outer_loop_closes_around_the_double_integrator() -> None:
    """den(s) s^2 + num(s) = 0 for each joint; a transfer function, its state space and n x n copies are the same loop."""
    tf = control.tf([8.0, 120.0, 40.0], [0.02, 1.0, 0.0])
    want = np.polyadd(np.polymul([0.02, 1.0, 0.0], [1, 0, 0]), [8.0, 120.0, 40.0]) / 0.02
    want = np.polymul(want, want)
    square = control.append(control.ss(tf), control.ss(tf))
    for outer in (tf, control.ss(tf), square):
        lin = ClosedLoop(robots.planar_2r(), L.InverseDynamics(outer), moving("planar_2r")).linearize(TIMES, coordinates="error")
        for A in lin.A:
            assert_allclose(np.poly(A), want, rtol=1e-6)
        assert lin.A.shape == (3, 8, 8) and lin.stable.all()
    static = ClosedLoop(robots.planar_2r(), L.InverseDynamics(25.0), moving("planar_2r")).linearize(TIMES)
    assert static.A.shape[1] == 4 and not static.stable.any()  # no damping: an undamped pair is not stable


def test_an_outer_loop_with_an_integrator_is_trimmed_like_the_pid() -> None:
    """The integrator of an LTI outer loop carries the payload at the operating point, as z does."""
    tf = control.tf([8.0, 120.0, 40.0], [0.02, 1.0, 0.0])
    lin = ClosedLoop(plant("ur5"), L.InverseDynamics(tf), moving("ur5"), controller_model=arm("ur5")).linearize(TIMES)
    assert np.abs(lin.residual).max() < 1e-8
    without = ClosedLoop(plant("ur5"), L.InverseDynamics({"kp": 120.0, "kd": 8.0}), moving("ur5"), controller_model=arm("ur5")).linearize(TIMES)
    assert np.abs(without.residual).max() > 0.1


@pytest.mark.parametrize(("outer", "said"), [
    (control.tf([1, 2, 3], [1, 1]), "improper"),
    (control.ss([0.5], [1.0], [1.0], [0.0], True), "discrete"),
    (control.ss([], [], [], np.eye(3)), "one input and output"),
    ({"kp": 1.0, "kv": 2.0}, "kp="),
    ({}, "kp="),
    ("PID", "python-control"),
    (None, "python-control"),
])  # fmt: skip
def test_an_outer_loop_that_cannot_be_is_refused(outer: object, said: str) -> None:
    with pytest.raises(BadArgument, match=said) as info:
        ClosedLoop(robots.planar_2r(), L.InverseDynamics(outer), Hold([0.0, 0.0]))
    assert info.value.argument == "outer"


# --- what is free, what drifts -----------------------------------------------------------------------------------------------


def test_a_joint_without_stiffness_is_neutral_with_damping_and_drifts_without() -> None:
    robot = robots.planar_2r(gravity=0.0)
    free = ClosedLoop(robot, L.JointPID([900.0, 0.0], kd=[300.0, 50.0]), Hold([0.3, 0.5])).linearize([0.0])
    assert (free.neutral[0], free.drifts[0], free.stable[0]) == (1, False, True)
    slides = ClosedLoop(robot, L.JointPID([900.0, 0.0], kd=[300.0, 0.0]), Hold([0.3, 0.5])).linearize([0.0])
    assert (slides.drifts[0], slides.stable[0]) == (True, False)


def test_a_gain_of_zero_keeps_its_integral_state_and_none_removes_it() -> None:
    zeros = ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, [50.0, 0, 0, 0, 0, 0], 20.0), Hold(regular_pose("ur5"))).linearize([0.0])
    assert zeros.A.shape[-1] == 18 and zeros.poles().shape == (1, 18)
    assert (zeros.neutral[0], zeros.drifts[0], zeros.stable[0]) == (0, False, True)  # they act on nothing
    none = ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, None, 20.0), Hold(regular_pose("ur5"))).linearize([0.0])
    assert none.A.shape[-1] == 12


def test_undamped_imaginary_pairs_are_not_stable() -> None:
    lin = ClosedLoop(robots.single_joint(damping=0.0), L.ComputedTorque(100.0), Hold([0.0])).linearize([0.0])
    assert_allclose(np.sort(lin.poles()[0].imag), [-10, 10], atol=1e-9)
    assert not lin.stable[0] and not lin.drifts[0] and lin.neutral[0] == 0


def test_a_law_is_a_value_that_two_loops_can_share() -> None:
    law = L.ComputedTorque(100.0, 50.0, 20.0)
    one, two = (ClosedLoop(arm(name), law, moving(name)).linearize(TIMES) for name in ("ur5", "panda"))
    assert one.A.shape[-1] == 18 and two.A.shape[-1] == 21
    other = replace(law, kp=200.0)
    assert float(other.kp.array) == 200.0 and float(law.kp.array) == 100.0 and float(other.kd.array) == 20.0
    with pytest.raises(AttributeError):
        law.kp = 3.0
