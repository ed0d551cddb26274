"""The linear prediction of a disturbed run with dead time and sampling: closed forms, and runs of loops that are linear."""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.simulation.prediction import delayed, sampled_along, sampled_at_rest, solved
from mfc_analysis.simulation.simulation import Simulation
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, moving, plant, regular_pose

TIGHT = {"rtol": 1e-10, "atol": 1e-13}


def base_of(loop: ClosedLoop, t: np.ndarray) -> Simulation:
    """The run from the operating point."""
    return loop.simulate(t, x=on_reference(loop.equations, t[:1]).x[0], **TIGHT)


def velocity(k: float, **hardware: float) -> ClosedLoop:
    return ClosedLoop(robots.single_joint(), L.VelocityP(k), Hold([0.3]), hardware=Hardware(**hardware))


def spring(**hardware: float) -> ClosedLoop:
    """A linear loop with force and motion in it."""
    law = L.DampedForcePI([0, 0, 4.0, 0, 0, 0], 0.4, [0, 0, 2.0, 0, 0, 0], 6.0)
    return ClosedLoop(robots.slider(1.0, 0.5), law, Hold([0.0]), environment=Environment(150.0, 2.0, preload=4.0), hardware=Hardware(**hardware))


@pytest.mark.parametrize("d", [0.05, 0.1, 0.25])  # whole parts of the second, so that every kink is the end of a segment
def test_an_integrator_with_dead_time_follows_its_series(d: float) -> None:
    """x' = -k x(t - d), x = 1 before: 1 + sum over j of (-k)^j (t - (j - 1) d)^j / j! while t > (j - 1) d."""
    k, t = 5.0, np.linspace(0, 1, 21)
    want = np.ones_like(t)
    for j in range(1, 40):
        since = np.maximum(t - (j - 1) * d, 0.0)
        want += np.where(since > 0, (-k) ** j * since**j / factorial(j), 0.0)
    loop = velocity(k, delay=d)
    assert_allclose(delayed(loop.equations, base_of(loop, t), t, np.ones(1))[:, 0], want, atol=1e-8)


@pytest.mark.parametrize("hardware", [{"delay": 0.02}, {"force_delay": 0.05}, {"delay": 0.02, "force_delay": 0.01, "torque_lag": 0.01}], ids=str)
def test_of_a_linear_loop_the_prediction_with_dead_time_is_the_run(hardware: dict) -> None:
    t, loop = np.linspace(0, 0.4, 17), spring(**hardware)
    base = base_of(loop, t)
    direction = np.zeros(loop.equations.nx)
    direction[:2] = [0.01, -0.2]
    run = loop.simulate(t, x=base.x[0] + direction, **TIGHT)
    assert_allclose(delayed(loop.equations, base, t, direction), run.x - base.x, atol=1e-6)
    assert np.abs(run.x - base.x)[-1].max() > 1e-3


def test_the_prediction_is_linear_in_its_direction() -> None:
    t, loop = (
        np.linspace(0, 0.1, 11),
        ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"), hardware=Hardware(delay=0.01)),
    )
    base = base_of(loop, t)
    a, b = np.random.default_rng(2).normal(size=(2, loop.equations.nx))
    one, other, both = (delayed(loop.equations, base, t, d) for d in (a, b, 2 * a - 3 * b))
    assert_allclose(both, 2 * one - 3 * other, atol=1e-10)
    assert_allclose(one[0], a)


@pytest.mark.parametrize("predict", [sampled_at_rest, sampled_along])
def test_a_sampled_integrator_is_a_power_of_one_minus_k_t(predict) -> None:
    k, T = 4.0, 0.1
    loop, t = velocity(k, sample_time=T), T * np.arange(12)
    assert_allclose(predict(loop.equations, base_of(loop, t), t, np.ones(1))[:, 0], (1 - k * T) ** np.arange(12), atol=1e-9)


@pytest.mark.parametrize(
    "hardware", [{}, {"delay": 0.013}, {"force_delay": 0.008, "delay": 0.005, "force_filter": 0.01, "torque_lag": 0.01}], ids=str
)
def test_of_a_linear_loop_both_sampled_predictions_are_the_run(hardware: dict) -> None:
    T = 0.01
    t, loop = T * np.arange(30), spring(sample_time=T, **hardware)
    base = base_of(loop, t)
    direction = np.zeros(loop.equations.nx)
    direction[:2] = [0.01, -0.2]
    run = loop.simulate(t, x=base.x[0] + direction, **TIGHT)
    for predict in (sampled_at_rest, sampled_along):
        assert_allclose(predict(loop.equations, base, t, direction), run.x - base.x, atol=1e-8)
    assert np.abs(run.x - base.x)[-1].max() > 1e-4


def test_at_rest_the_two_sampled_predictions_of_an_arm_agree() -> None:
    T = 0.01
    hardware = Hardware(sample_time=T, delay=0.004, velocity_filter=0.02)
    loop = ClosedLoop(plant("ur5"), L.ComputedTorque(100.0, 60.0, 20.0), Hold(regular_pose("ur5")), arm("ur5"), hardware=hardware)
    t = T * np.arange(15)
    base = base_of(loop, t)
    direction = np.zeros(loop.equations.nx)
    direction[:6] = np.random.default_rng(4).normal(size=6)
    frozen, along = (predict(loop.equations, base, t, direction) for predict in (sampled_at_rest, sampled_along))
    assert_allclose(along, frozen, atol=1e-6 * np.abs(frozen).max())


def test_along_a_moving_path_the_frozen_prediction_is_not_the_other_one() -> None:
    T, t = 0.01, 0.01 * np.arange(60)
    loop = ClosedLoop(
        plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), replace(moving("planar_2r"), amplitude=0.8), hardware=Hardware(sample_time=T)
    )
    base = base_of(loop, t)
    direction = np.zeros(loop.equations.nx)
    direction[:2] = [1.0, -1.0]
    small = 1e-5
    run = loop.simulate(t, x=base.x[0] + small * direction, **TIGHT)
    true = (run.x - base.x)[:, :2] / small
    misfit = {p: np.abs(p(loop.equations, base, t, direction)[:, :2] - true).max() for p in (sampled_along, sampled_at_rest)}
    assert misfit[sampled_along] < 1e-4 < 0.02 < misfit[sampled_at_rest]


@pytest.mark.parametrize("delay", [0.03, 0.11, 0.25])
def test_an_exactly_linear_loop_has_order_inf_whether_or_not_its_dead_time_divides_the_run(delay: float) -> None:
    """A kink inside a Runge-Kutta step made this 1.0: "the linearisation is wrong"."""
    found = velocity(0.8 / delay, delay=delay).validate(time=1.0)
    assert found.taylor_order == np.inf and found.nrmse < 1e-8


@pytest.mark.parametrize(("delay", "force_delay"), [(0.011, 0.03), (0.017, 0.0171), (0.15, 0.11)])
def test_an_exactly_linear_loop_with_two_dead_times_has_order_inf_too(delay: float, force_delay: float) -> None:
    """A kink comes back after each sum of the dead times; inside a segment of the run it left a remainder of 1e-8 of the size."""
    found = spring(delay=delay, force_delay=force_delay).validate(time=0.4)
    assert found.taylor_order == np.inf and found.radius == np.inf and found.nrmse < 1e-8


def test_many_directions_at_once_are_each_of_them_alone() -> None:
    directions = np.random.default_rng(5).normal(size=(8, 3))
    for hardware, predict in (({"delay": 0.02}, delayed), ({"sample_time": 0.01}, sampled_at_rest), ({"sample_time": 0.01}, sampled_along)):
        loop, t = spring(**hardware, force_delay=0.013), 0.01 * np.arange(8)
        base = base_of(loop, t)
        alone = [predict(loop.equations, base, t, d) for d in directions.T]
        assert_allclose(predict(loop.equations, base, t, directions), np.stack(alone, axis=2), atol=1e-12)


def test_a_linear_equation_with_forcing_is_solved_to_rounding_whatever_its_length() -> None:
    """x' = A x + b t: by the exponential of the block matrix. A segment too long for one polynomial is halved."""
    A = np.array([[0.0, 1.0], [-2500.0, -30.0]])
    b, x = np.array([[0.0], [40.0]]), np.array([[1.0], [0.0]])
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2:3], block[2, 3] = A, b, 1.0
    for length in (1e-3, 0.02, 0.5):
        found = solved(lambda s: np.repeat(A[None], len(s), axis=0), lambda s, length=length: b * (s * length)[:, None, None], length, x)
        for s in (0.0, 0.3, 1.0):
            exact = expm(block * s * length) @ np.array([1.0, 0.0, 0.0, 1.0])
            assert_allclose(found(np.array([s]))[0, :, 0], exact[:2], atol=2e-10 * max(1.0, 50 * length))
