"""Loops over dead time: the exact roots against a scalar equation, and both sides of the limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.design.dead_time import delay_map, over_delay
from mfc_analysis.errors import BadArgument, Unsupported


def loop(k: float = 4.0, **hardware: Any) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.3, 0.2]), hardware=mfc.Hardware(**hardware))


def test_growth_solves_the_delayed_integrators_equation() -> None:
    k = 4.0
    for T, s in zip((0.1, 0.5), over_delay(loop(k), [0.1, 0.5]), strict=True):  # s + k e^(-s T) = 0, rightmost by Newton from above
        root = complex(-k, k) if T < 0.2 else complex(0.1, np.pi / 2 / T)
        for _ in range(50):
            root -= (root + k * np.exp(-root * T)) / (1 - k * T * np.exp(-root * T))
        assert s == pytest.approx(root.real, abs=1e-9)


def test_the_limit_is_a_quarter_turn_on_both_sides() -> None:
    limit = np.pi / 2 / 4.0
    below, above = over_delay(loop(4.0), [0.999 * limit, 1.001 * limit])
    assert below < 0 < above


def test_dead_times_judged_together_are_those_of_loops_of_their_own() -> None:
    """A force loop whose sensor is late too, by as much as one of the dead times of the actuators."""
    law = mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 1.0, 5.0, 20.0)
    wall, hardware = mfc.Environment(1e3, 5.0, preload=10.0), mfc.Hardware(torque_lag=2e-3, force_delay=5e-3)
    pressing = mfc.ClosedLoop(mfc.robots.slider(1.0), law, mfc.trajectories.Hold([0.0]), environment=wall, hardware=hardware)
    delays = [1e-3, 5e-3, 0.03]
    alone = [replace(pressing, hardware=replace(hardware, delay=T)).linearize([0.0]) for T in delays]
    rightmost = [max(s.real for s in lin.delay_roots(12)[0] if abs(s) > 0.01) for lin in alone]
    assert over_delay(pressing, delays) == pytest.approx(rightmost, rel=1e-9)
    assert [bool(lin.stability.nonzero_stable[0]) for lin in alone] == [g < 0 for g in rightmost]


def test_one_verdict_for_all_dead_times_together(monkeypatch: pytest.MonkeyPatch) -> None:
    from mfc_analysis.analysis import stability
    from mfc_analysis.analysis.delay import roots

    asked: list[int] = []
    for module in (stability, roots):
        true = module.delayed_verdicts
        monkeypatch.setattr(module, "delayed_verdicts", lambda system, known, true=true: asked.append(len(system.A)) or true(system, known))
    assert (over_delay(loop(4.0), [0.1, 0.2, 0.5]) < 0).tolist() == [True, True, False]  # k T is below a quarter turn
    assert asked == [3]


def test_a_map_scales_with_the_gain() -> None:
    found = delay_map(loop, [0.05, 0.1, 0.2, 0.4], [2.0, 4.0, 8.0])
    assert (found.stable == (np.outer([2.0, 4.0, 8.0], [0.05, 0.1, 0.2, 0.4]) < np.pi / 2)).all()


def test_the_loops_own_dead_time_is_replaced() -> None:
    assert over_delay(loop(delay=0.3), [0.1])[0] == pytest.approx(over_delay(loop(), [0.1])[0], rel=1e-12)


def test_the_dead_time_of_a_servo_is_kept() -> None:
    servo = mfc.Servo(bandwidth=50.0, delay=0.05)
    together, alone = over_delay(loop(servo=servo), [0.1]), over_delay(loop(servo=replace(servo, delay=None)), [0.15])
    assert together == pytest.approx(alone, rel=1e-9)
    lin = loop(servo=servo, delay=0.1).linearize([0.0])
    assert together == pytest.approx([max(s.real for s in lin.delay_roots(6)[0])], rel=1e-9)


def test_a_slow_growth_counts_within_a_longer_horizon_only() -> None:
    k, T = -0.02, 0.1  # s = 0.02 e^(-s T): s T = W(0.02 T), 0.01996 1/s on the main branch of Lambert's function
    every = np.array([lambertw(-k * T, branch) / T for branch in (-1, 0, 1)])
    assert over_delay(loop(k), [T], horizon=1e3)[0] == pytest.approx(every.real.max(), rel=1e-9)
    assert over_delay(loop(k), [T], horizon=10.0)[0] == pytest.approx(np.sort(every.real)[-2], rel=1e-9)
    found = [delay_map(loop, [T, 2 * T], [k, 4.0], horizon=horizon).stable.tolist() for horizon in (1e3, 10.0)]
    assert found == [[[False, False], [True, True]], [[True, True], [True, True]]]


def test_bad_input_is_named() -> None:
    with pytest.raises(BadArgument, match="delays"):
        over_delay(loop(), [0.0])
    with pytest.raises(BadArgument, match="horizon"):
        over_delay(loop(), [0.1], horizon=1e-3)  # dead times up to twenty horizons
    with pytest.raises(Unsupported, match="sample_time"):
        over_delay(loop(sample_time=0.01), [0.1])
