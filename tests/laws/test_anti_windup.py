"""Back-calculation of the integral where a torque saturates: the runs of an independent solver, less overshoot, nothing in the linear model."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, ToolHold
from tests.conftest import each, full, seed
from tests.dynamics.test_jacobians import misfit

T = 0.1
Q = np.array([0.3, 0.8])
PLANAR = robots.planar_2r()


def planar(law: L.Law, limit: float | np.ndarray | None, **more: object) -> ClosedLoop:
    hardware = Hardware(torque_limit=limit, **more)
    if law.space == "tool":
        return ClosedLoop(PLANAR, law, ToolHold(PLANAR.pose(Q)), q_start=Q, hardware=hardware)
    return ClosedLoop(PLANAR, law, Hold(Q), hardware=hardware)


def by_hand(kind: str, kp: float, ki: np.ndarray, kd: float, limit: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x' of (q, v, z): the law, the limit and back-calculation in matrices of the robot."""
    q, v, z = x[:2], x[2:4], x[4:]
    M, h = PLANAR.mass(q), PLANAR.bias(q, v) + PLANAR.viscous * v
    if kind == "9.16":  # tool axes x and y: X_e = R^T (p_d - p), with the rows that the error turns with
        X, J, J_dot_v = PLANAR.pose(q), PLANAR.jacobian(q), PLANAR.jacobian_rate(q, v) @ v
        p = (X[:3, :3].T @ (PLANAR.pose(Q)[:3, 3] - X[:3, 3]))[:2]
        turn = np.array([[1, 0, 0, 0, 0, -p[1]], [0, 1, 0, 0, 0, p[0]]])  # v - p x w
        A, w = turn @ J, J[5] @ v
        e, e_dot = p, -A @ v
        spin = np.array([e_dot[1] * w, -e_dot[0] * w])  # p' x w, of axes that turn
        tau = M @ np.linalg.solve(A, spin + kp * e + ki @ z + kd * e_dot - turn @ J_dot_v) + h
        to_command = A @ np.linalg.inv(M)
    else:
        e, e_dot = Q - q, -v
        command = kp * e + ki @ z + kd * e_dot
        tau, to_command = (command, np.eye(2)) if kind == "9.8" else (M @ command + h, np.linalg.inv(M))
    sat = np.clip(tau, -limit, limit)
    return np.r_[v, np.linalg.solve(M, sat - h), e + np.linalg.solve(ki, to_command @ (sat - tau)) / T]


CASES = {
    "9.8": (9000.0, full(2, 15000.0), 1800.0, L.JointPID(9000.0, full(2, 15000.0), 1800.0, anti_windup=T)),
    "9.10": (64.0, full(2, 120.0), 14.0, L.ComputedTorque(64.0, full(2, 120.0), 14.0, anti_windup=T)),
    "9.16": (64.0, full(2, 120.0), 14.0, L.TaskComputedTorque(64.0, full(2, 120.0), 14.0, axes="xy", anti_windup=T)),
}


def saturating(kind: str) -> np.ndarray:
    """A limit that holds the arm at Q and leaves little to move it."""
    return np.abs(PLANAR.gravity(Q)) * 1.3


@pytest.mark.parametrize("kind", CASES)
def test_a_run_that_saturates_is_that_of_the_equations_by_hand(kind: str) -> None:
    kp, ki, kd, law = CASES[kind]
    limit, q0 = saturating(kind), Q - [0.25, 0.3]
    t = np.linspace(0.0, 1.0, 11)
    run = planar(law, limit).simulate(t, q=q0, v=np.zeros(2), rtol=1e-9, atol=1e-11)
    want = solve_ivp(lambda _, x: by_hand(kind, kp, ki, kd, limit, x), (0, 1), np.r_[q0, np.zeros(4)], "RK45", t, rtol=1e-10, atol=1e-12)
    assert (np.abs(run.command) > limit).any() and np.abs(run.tau).max() <= limit.max()
    assert_allclose(run.x, want.y.T, atol=2e-6)


@pytest.mark.parametrize("kind", CASES)
def test_the_tool_or_joint_overshoots_less_than_without(kind: str) -> None:
    law, limit, q0 = CASES[kind][-1], saturating(kind), Q - ([0.15, -0.1] if kind == "9.16" else [0.8, 0.6])
    worst = {}
    for T_ in (T, None):
        run = planar(law.changed(anti_windup=T_), limit).simulate(np.linspace(0.0, 6.0, 601), q=q0, v=np.zeros(2))
        assert not run.diverged
        worst[T_] = float(np.max(-run.error / np.sign(run.error[0])))
    assert worst[T] < 0.7 * worst[None]


@pytest.mark.parametrize("kind", CASES)
def test_the_linear_model_of_a_loop_that_does_not_saturate_is_the_same_without_it(kind: str) -> None:
    law = CASES[kind][-1]
    with_, without = (planar(one, 5e4).linearize() for one in (law, law.changed(anti_windup=None)))
    assert np.array_equal(with_.A, without.A) and np.array_equal(with_.margins().phase_deg, without.margins().phase_deg, equal_nan=True)


@pytest.mark.parametrize("kind", CASES)
def test_the_jacobian_where_a_torque_saturates_is_that_of_the_equations(kind: str) -> None:
    found = misfit_saturated(planar(CASES[kind][-1], np.array([1e6, 1.0])), seed("windup", kind))
    assert found < 1e-7


def misfit_saturated(loop: ClosedLoop, rng: np.random.Generator) -> float:
    """Of two points where the second joint saturates: its limit is tiny, the other's is far."""
    return misfit(loop, rng).error


def test_a_sampled_law_takes_its_integral_back_once_per_sample() -> None:
    kp, ki, kd, h = 9000.0, 15000.0, 1800.0, 5e-3
    limit, q0 = saturating("9.8"), Q - [0.25, 0.3]
    loop = planar(L.JointPID(kp, ki, kd, anti_windup=T), limit, sample_time=h)
    run = loop.simulate(np.arange(21) * h, q=q0, v=np.zeros(2), rtol=1e-9, atol=1e-11)
    x = np.r_[q0, np.zeros(2)]
    z = np.zeros(2)
    for k in range(20):
        e, tau = Q - x[:2], kp * (Q - x[:2]) + ki * z - kd * x[2:]
        sat = np.clip(tau, -limit, limit)
        z = z + h * (e + (sat - tau) / ki / T)

        def moved(_: float, y: np.ndarray, sat: np.ndarray = sat) -> np.ndarray:
            h_ = PLANAR.bias(y[:2], y[2:]) + PLANAR.viscous * y[2:]
            return np.r_[y[2:], np.linalg.solve(PLANAR.mass(y[:2]), sat - h_)]

        x = solve_ivp(moved, (0, h), x, rtol=1e-10, atol=1e-12).y[:, -1]
        assert_allclose(run.x[k + 1], np.r_[x, z], atol=1e-8)


def test_where_no_limit_is_given_nothing_happens_and_what_makes_no_sense_is_refused() -> None:
    law = CASES["9.8"][-1]
    runs = [ClosedLoop(PLANAR, one, Hold(Q)).simulate(0.3, initial_error=0.3).x for one in (law, law.changed(anti_windup=None))]
    assert np.array_equal(*runs)
    with pytest.raises(BadArgument, match="a gain ki"):
        L.JointPID(60.0, kd=14.0, anti_windup=T)
    for bad in (0.0, -1.0, "a"):
        with pytest.raises(BadArgument, match="anti_windup"):
            L.ComputedTorque(60.0, 1.0, anti_windup=bad)
    with pytest.raises(Unsupported, match="sample time"):
        planar(law, 4.0, sample_time=0.2)
    assert "anti_windup=0.1" in str(law)


def test_joints_without_an_integral_gain_are_left_alone() -> None:
    law = L.JointPID(60.0, [150.0, 0.0], 14.0, anti_windup=T)
    loop = planar(law, 0.1)
    e = loop.equations
    x = np.r_[Q - 0.2, np.zeros(4)]
    rate, free = (value[e.parts["z"].where] for value in (e.rates(0.0, x), ClosedLoop(PLANAR, law, Hold(Q)).equations.rates(0.0, x)))
    assert rate[1] == free[1] and rate[0] != free[0]
    assert_allclose(L.JointPID(60.0, each(2, 3.0)).ki.inverse(2), np.diag(1 / each(2, 3.0)))
