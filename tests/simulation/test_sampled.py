"""Sampled runs against difference equations and the discrete model, whole and fractional dead time among them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.laws.law import Law
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, Sinusoid
from tests.conftest import arm, plant, regular_pose

JOINT = robots.single_joint()


def test_a_sampled_integrator_takes_steps_of_one_minus_k_t() -> None:
    k, T = 4.0, 0.1
    loop = ClosedLoop(JOINT, L.VelocityP(k), Hold([0.3]), hardware=Hardware(sample_time=T))
    lin = loop.linearize([0.0])
    assert_allclose(lin.A, [[[1 - k * T]]])
    assert lin.dt == T and lin.delay == 0.0
    sim = loop.simulate(np.arange(0, 2, T), 1.0, rtol=1e-9)
    assert_allclose(sim.error[:, 0], (1 - k * T) ** np.arange(20), atol=1e-8)
    middle = loop.simulate(np.arange(0, 2, T / 4), 1.0, rtol=1e-9)
    straight = np.interp(middle.t, sim.t, sim.error[:, 0])
    assert_allclose(middle.error[:76, 0], straight[:76], atol=1e-8)  # between samples the velocity is held
    assert_allclose(middle.tau[::4], middle.tau[1::4])
    for factor, stable in ((0.99, True), (1.01, False)):
        hardware = Hardware(sample_time=factor * 2 / k)
        assert bool(ClosedLoop(JOINT, L.VelocityP(k), Hold([0.3]), hardware=hardware).linearize([0.0]).stable[0]) == stable


@pytest.mark.parametrize("delay", [0.1, 0.2, 0.03, 0.17])
def test_a_sampled_integrator_with_whole_and_fractional_dead_time(delay: float) -> None:
    """q[k+1] = q[k] + (T - f) u[k-d] + f u[k-d-1], u = k e, f what is left of the dead time after d samples."""
    k, T = 3.0, 0.1
    d = int(np.floor(delay / T + 1e-9))
    f = delay - d * T
    loop = ClosedLoop(JOINT, L.VelocityP(k), Hold([0.0]), hardware=Hardware(sample_time=T, delay=delay))
    sim = loop.simulate(np.arange(0, 2, T), 1.0, rtol=1e-9)
    q, u = [-1.0], []
    for i in range(19):
        u.append(-k * q[-1])
        q.append(q[-1] + (T - f) * u[max(i - d, 0)] + f * u[max(i - d - 1, 0)])
    assert_allclose(sim.q[:, 0], q, atol=1e-8)
    poles = np.zeros(d + (2 if f > 1e-9 else 1) + 1)
    poles[:2] = [1, -1]
    poles[d + 1] += k * (T - f)
    if f > 1e-9:
        poles[d + 2] += k * f
    found = np.linalg.eigvals(loop.linearize([0.0]).A[0])
    assert_allclose(np.poly(found), poles, atol=1e-9)


LINEAR = {
    "spring": lambda h: ClosedLoop(robots.slider(1.0, 0.5), L.DampedForcePI([0, 0, 4.0, 0, 0, 0], 0.4, [0, 0, 2.0, 0, 0, 0], 6.0), Hold([0.0]),
                                   environment=Environment(150.0, 2.0, preload=4.0), hardware=h),
    "joint": lambda h: ClosedLoop(robots.single_joint(gravity=0.0), L.JointPID(12.0, 6.0, 2.0), Hold([0.2]), hardware=h),
}  # fmt: skip


@pytest.mark.parametrize(("which", "hardware"), [
    ("joint", {}), ("joint", {"delay": 0.02}), ("joint", {"delay": 0.031, "torque_lag": 0.01}),
    ("joint", {"velocity_filter": 0.015, "torque_lag": 0.02}),
    ("joint", {"joint_stiffness": 300.0, "joint_damping": 2.0, "motor_inertia": 0.1, "delay": 0.005}),
    ("spring", {}), ("spring", {"force_filter": 0.01}), ("spring", {"force_delay": 0.02}),
    ("spring", {"force_delay": 0.013, "delay": 0.024, "torque_lag": 0.01}),
])  # fmt: skip
def test_a_sampled_run_of_a_linear_loop_is_the_discrete_model(which: str, hardware: dict) -> None:
    """Every sample of the nonlinear run is A^k times the deviation at the start."""
    T, count = 0.02, 40
    loop = LINEAR[which](Hardware(sample_time=T, **hardware))
    lin = loop.linearize([0.0])
    point = lin.point.x[0]
    nx, names = point.size, lin.state_names
    x0 = point.copy()
    x0[0] += 0.03
    if "theta_joint" in names:
        x0[names.index("theta_joint")] += 0.03
    sim = loop.simulate(np.arange(count) * T, x=x0, rtol=1e-10, atol=1e-13)
    deviation = np.zeros(len(names))
    deviation[:nx] = x0 - point
    # what was sent, and seen, before the start is what would have been at the start: the registers hold it
    start_command = sim.command[0] - np.asarray(loop.equations.flow(0.0, point).command)
    for i, name in enumerate(names[nx:], nx):
        if name.startswith("torque"):
            deviation[i] = start_command[0]
        elif name.startswith("force"):
            deviation[i] = (sim.force[0] - np.asarray(loop.equations.flow(0.0, point).F_tip))[["fx", "fy", "fz", "mx", "my", "mz"].index(name[-2:])]
    want = [deviation]
    for _ in range(count - 1):
        want.append(lin.A[0] @ want[-1])
    assert_allclose(sim.x - point, np.array(want)[:, :nx], atol=1e-8)
    assert np.abs(sim.x[20] - point).max() > 1e-4


def test_a_sampled_run_of_an_arm_follows_the_discrete_model_near_its_path() -> None:
    """UR5 with a wrong model on a moving path: the error falls with the square of the disturbance (the discrete model is frozen, so at rest)."""
    T, q = 0.01, regular_pose("ur5")
    loop = ClosedLoop(plant("ur5"), L.ComputedTorque(100.0, 60.0, 20.0), Hold(q), arm("ur5"), hardware=Hardware(sample_time=T, delay=0.004))
    lin = loop.linearize([0.0])
    nx, d = 18, np.random.default_rng(3).normal(size=18) * np.r_[np.ones(12), np.zeros(6)]
    misfits = []
    for size in (2e-3, 1e-3):
        x0 = lin.point.x[0] + size * d
        sim = loop.simulate(np.arange(15) * T, x=x0, rtol=1e-10, atol=1e-12)
        deviation = np.zeros(lin.A.shape[-1])
        deviation[:nx] = size * d
        held = np.asarray(loop.equations.flow(0.0, x0).command) - np.asarray(loop.equations.flow(0.0, lin.point.x[0]).command)
        deviation[nx:] = held
        for _ in range(14):
            deviation = lin.A[0] @ deviation
        misfits.append(np.linalg.norm(sim.x[14, :6] - lin.point.x[0, :6] - deviation[:6]))
    assert misfits[0] < 5e-4
    assert abs(np.log2(misfits[0] / misfits[1]) - 2.0) < 0.15


def test_the_largest_stable_sample_time_of_an_arm_holds_in_simulation() -> None:
    """From the discrete model; at 0.95 and 1.05 of it the nonlinear arm decays and grows."""
    q, law = regular_pose("ur5"), L.ComputedTorque(400.0, kd=40.0)

    def loop(T: float) -> ClosedLoop:
        return ClosedLoop(arm("ur5"), law, Hold(q), hardware=Hardware(sample_time=T))

    low, high = 1e-3, 0.2
    assert loop(low).linearize([0.0]).stable[0] and not loop(high).linearize([0.0]).stable[0]
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop(middle).linearize([0.0]).stable[0] else (low, middle)
    for factor, grows in ((0.95, False), (1.05, True)):
        T = factor * low
        sim = loop(T).simulate(np.arange(60) * T, 1e-6, rtol=1e-9, atol=1e-13)
        e = np.abs(sim.error).max(axis=1)
        assert (e[-10:].max() > e[10:20].max()) == grows


def test_a_fast_sampled_loop_is_the_continuous_one_with_half_a_sample_of_dead_time() -> None:
    """To first order in T: what is left falls as T^2, what ideal and sampled differ by as T."""
    law, ref, t = L.JointPID(40.0, kd=4.0), Sinusoid([0.2], 0.3, 3.0), np.linspace(0, 1, 11)
    gaps = []
    for T in (0.02, 0.01):
        start = ClosedLoop(JOINT, law, ref).simulate(t, 0.0, rtol=1e-9)
        sampled = ClosedLoop(JOINT, law, ref, hardware=Hardware(sample_time=T)).simulate(t, 0.0, rtol=1e-9)
        late = ClosedLoop(JOINT, law, ref, hardware=Hardware(delay=T / 2)).simulate(t, 0.0, rtol=1e-9)
        gaps.append((np.abs(sampled.error - start.error).max(), np.abs(sampled.error - late.error).max()))
    assert 1.7 < gaps[0][0] / gaps[1][0] < 2.4
    assert gaps[0][1] / gaps[1][1] > 3.0


def test_an_end_between_samples_is_reached() -> None:
    loop = ClosedLoop(JOINT, L.VelocityP(1.0), Hold([0.0]), hardware=Hardware(sample_time=0.1))
    sim = loop.simulate(0.25, 1.0)
    assert_allclose(sim.end, 0.25)
    assert_allclose(sim.error[-1, 0], 0.9 * 0.9 - 0.05 * 0.81, atol=1e-7)


@pytest.mark.parametrize("T", [5.0, 300.0, 1e9])
@pytest.mark.parametrize("law", [L.VelocityP(4.0), L.JointPID(30.0, 5.0, 5.0)], ids=["9.2", "9.8"])
def test_a_run_shorter_than_its_sample_time_holds_the_first_command(T: float, law: Law) -> None:
    sim = ClosedLoop(JOINT, law, Hold([0.3]), hardware=Hardware(sample_time=T)).simulate(0.2, 0.1)
    assert not sim.diverged and sim.end == 0.2 and sim.t.size == 501
    assert_allclose(sim.tau, np.broadcast_to(sim.tau[0], sim.tau.shape))
    if law.plant == "velocity":
        assert_allclose(sim.error[:, 0], 0.1 * (1 - 4.0 * sim.t), atol=1e-9)
