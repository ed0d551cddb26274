"""Step responses with dead time: the method of steps by hand, and the order of the error."""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import gammainc

import mfc_analysis as mfc
from mfc_analysis.analysis.delay import steps as module
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_metrics import Outcome
from mfc_analysis.analysis.steps import step
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.conftest import open_system, random_loops
from tests.test_arms import loops

s = control.tf("s")


def integrator(k: float, T: float, t: np.ndarray) -> np.ndarray:
    """x' = -k x(t - T) + 1 from rest: sum of (-k)^j (t - j T)^(j + 1) / (j + 1)!."""
    x = np.zeros_like(t)
    for j in range(int(t.max() / T) + 1):
        x += np.where(t > j * T, (-k) ** j * np.maximum(t - j * T, 0) ** (j + 1) / factorial(j + 1), 0.0)
    return x


def plain_integrator(k: float, T: float) -> OpenSystem:
    return OpenSystem(
        times=np.zeros(1),
        A=np.zeros((1, 1, 1)),
        B=np.ones((1, 1, 2)),
        C=np.array([[[1.0], [-k]]]),
        D=np.zeros((1, 2, 2)),
        state_names=("x",),
        input_names=("d",),
        output_names=("x",),
        wires={"torque": slice(0, 1)},
        wire_names=("joint",),
        wire_delay=np.array([T]),
        points=("torque",),
    )


@pytest.mark.parametrize(("k", "T"), [(1.0, 0.6), (2.0, 0.5), (50.0, 0.015)])
def test_an_integrator_with_dead_time_follows_its_series(k, T):
    found = step(plain_integrator(k, T), 0, "d", "x")
    assert found.outcome is Outcome.SETTLES
    early = found.t < 12 * T
    assert_allclose(found.y[early], integrator(k, T, found.t[early]), atol=1e-8 / k)
    assert_allclose(found.steady_state, 1 / k)
    t = np.linspace(0, 12 * T, 200_001)
    y = integrator(k, T, t)
    assert_allclose([found.peak, found.peak_time], [y.max(), t[y.argmax()]], rtol=1e-4)
    outside = t[np.abs(y * k - 1) > 0.02]
    if outside[-1] < 11 * T:
        assert_allclose(found.settling, outside[-1], rtol=1e-4)


def test_a_jump_on_the_wire_comes_back_as_a_jump_one_dead_time_later():
    found = step(open_system(0.5 * (s + 1) / (s + 1), delay=0.25), 0, "d", "y", duration=1.0)
    # y = 0.5 (1 - y(t - T)): 0.5, 0.25, 0.375, ... on successive dead times
    for k, level in enumerate((0.5, 0.25, 0.375, 0.3125)):
        inside = (found.t > 0.25 * k + 1e-9) & (found.t < 0.25 * (k + 1) - 1e-9)
        assert_allclose(found.y[inside], level, atol=1e-12)


def test_a_short_dead_time_changes_little(rng):
    L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    late, plain = step(open_system(L, delay=1e-3), 0, "d", "y", duration=5.0), step(open_system(L), 0, "d", "y", duration=5.0)
    assert_allclose(np.interp(plain.t, late.t, late.y), plain.y, atol=3e-3)


def test_delays_that_share_no_divisor_agree_with_neighbours_that_do(rng):
    system = random_loops(rng, 30, 4, 2)
    exact = replace(system, wire_delay=np.array([0.02, 0.03]))
    i = int(np.flatnonzero(stability(exact).stable)[0])
    near = replace(system, wire_delay=np.array([0.02, 0.03 + 1e-9 * np.pi]))
    a, b = (step(one, i, "d", "y", duration=3.0) for one in (exact, near))
    assert_allclose(b.settling, a.settling, rtol=1e-5)
    assert_allclose(b.y[: a.y.size], a.y[: b.y.size], atol=1e-6 * np.abs(a.y).max())


def test_beyond_its_delay_margin_the_response_grows():
    found = step(plain_integrator(2.0, 0.8), 0, "d", "x")
    assert found.outcome is Outcome.GROWS and np.isnan(found.settling)
    assert np.abs(found.y[-found.y.size // 4 :]).max() > 2 * np.abs(found.y[: found.y.size // 4]).max()


def test_a_response_that_does_not_settle_is_shown_as_far_as_steps_are_afforded():
    """An arm that slides along a wall, its drives 1 ms late: eight of its slowest time constants would take millions of steps."""
    for arm in ("panda", "ur10"):
        loop = next(loop for name, _, loop in loops(arm, 1, ["dead time"]) if name == "9.23 on z")
        found = step(loop.linearize().opened, 0, 0, 0)
        assert found.outcome is not Outcome.SETTLES and np.isfinite(found.y[:1000]).all() and found.t[-1] > 0.1


@pytest.mark.parametrize("T", [[0.1, 0.1], [0.2, 0.3], [0.7, 0.7], [6.0, 6.0], [0.25, 0.32], [6.0, 7.77]])
def test_steps_in_blocks_are_the_steps_one_by_one(rng, monkeypatch, T):
    h, delay = 0.1 if T != [0.25, 0.32] else 0.25 / 3, np.array(T)
    A, B = np.array([[-1.0, 4.0, 0.0], [-4.0, -1.0, 1.0], [0.0, 0.0, -9.0]]), rng.normal(size=(3, 4))
    march = module._Steps(A, B, 0.1 * rng.normal(size=(3, 3)), 0.1 * rng.normal(size=(3, 4)), delay, h, 2)
    plain = module._Steps(*march.loop, delay, h, 2)
    plain.together, plain.powers = 1, march.powers[:1]
    wanted = plain.taken(1003, plain.start(), np.eye(2))
    for found in (march.taken(1003, march.start(), np.eye(2)), march.run(1003, march.start(), 10**9)):
        for one, other in zip(found, wanted, strict=True):
            assert_allclose(one, other, atol=1e-12 * np.abs(other).max())


@pytest.mark.parametrize(("a", "T", "off"), [(300.0, 0.1, 3e-9), (3000.0, 0.1, 3e-7), (100.0, 0.02, 3e-9)])
def test_a_fast_pole_that_the_law_cancels_without_dead_time_is_followed(a, T, off):
    """x' = -a x + (a - 1) x(t - T) + 1 from rest: sum of (a - 1)^j / a^(j + 1) P(j + 1, a (t - j T)), P the incomplete gamma function.

    Where 1024 steps in the dead time are longer than 0.05 / a, the error is that of the cubic in such a step.
    """
    one = replace(plain_integrator(1.0, T), A=np.full((1, 1, 1), -a), C=np.array([[[1.0], [a - 1]]]))
    found = module.delayed_runner(one)(2.0, 10)
    t = np.linspace(0.0, 2.0, 2001)
    j = np.arange(int(2.0 / T) + 1)[:, None]
    wanted = np.sum(np.exp(j * np.log((a - 1) / a)) / a * gammainc(j + 1, a * np.maximum(t - j * T, 0.0)), axis=0)
    assert_allclose(found.values(t)[0], wanted, atol=off * wanted.max())


@pytest.mark.parametrize("T", [[0.01, 0.01], [0.01, 0.013]])
def test_longer_steps_are_taken_where_the_response_is_smooth_and_change_nothing_else(rng, monkeypatch, T):
    """Two loops, one with a fast pole, coupled: the run of 30 s has a part of the steps, and the same values between them."""
    A = np.array([[0.0, 1.0, 0.0, 0.0], [-4.0, -2.0, 1.0, 0.0], [0.0, 0.0, -1.0, 1.0], [0.0, 0.5, 0.0, -300.0]])
    B, C = np.array([[0, 0, 0], [2.0, 0, 1.0], [0, 0, 0], [0, 90.0, 0]]), np.array([[1.0, 0, 0, 0], [-1.0, -0.3, 0, 0], [0, 0, -0.5, 0.0]])
    one = replace(plain_integrator(1.0, 0.01), A=A[None], B=B[:, [2, 0, 1]][None], C=C[None], D=np.zeros((1, 3, 3)), state_names=tuple("abcd"))
    one = replace(one, wires={"torque": slice(0, 2)}, wire_names=("1", "2"), wire_delay=np.array(T))
    found = module.delayed_runner(one)(30.0, 10)
    monkeypatch.setattr(module, "SAME", 0.0)
    wanted = module.delayed_runner(one)(30.0, 10)
    assert found.t.size < 0.15 * wanted.t.size
    t = np.linspace(0.0, 30.0, 3001)
    assert_allclose(found.values(t), wanted.values(t), atol=2e-9)


def test_a_response_below_the_error_of_the_others_does_not_keep_them_from_settling():
    """An arm whose wrist hardly moves its shoulder: the response of that pair is rounding, and so is its final value."""
    hold, hardware = mfc.trajectories.Hold(np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])), mfc.Hardware(delay=1e-3, torque_lag=4e-3)
    loop = mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.ComputedTorque(kp=528.0, ki=3040.0, kd=57.6), hold, hardware=hardware)
    lin = loop.linearize()
    found, alone = lin.steps([0.0, 0.1]), lin.step(input=0, output=0)
    assert np.isfinite(found.settling).all()
    assert found[0, 0, 0].settling == pytest.approx(alone.settling, rel=1e-9)


@pytest.mark.parametrize("hardware", [{"delay": 4e-3}, {"delay": 4e-3, "sample_time": 1e-3}])
@pytest.mark.filterwarnings("error")
def test_an_unstable_loop_overflows_without_a_warning_of_numpy(hardware):
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(1e6, kd=2000.0), mfc.trajectories.Hold([0.0]), hardware=mfc.Hardware(**hardware))
    lin = loop.linearize()
    assert not lin.stable[0]
    found = lin.step(0, input="q_d_slide", output="q_slide", duration=5.0)
    assert np.isfinite(found.y[:100]).all() and not np.isfinite(found.y[-1])
    y = lin.steps(np.linspace(0.0, 8.0, 9)).y
    assert np.isfinite(y[..., 0]).all() and not np.isfinite(y[0, 0, 0, -1])
