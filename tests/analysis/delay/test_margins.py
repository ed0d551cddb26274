"""Margins of loops with dead time: closed forms of one loop, and loops that really go unstable."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import mfc_analysis as mfc
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.stability import stability
from tests.analysis.conftest import open_system, random_loops, scaled
from tests.soak.disk import sensitivities

s = control.tf("s")


@pytest.mark.parametrize("k", [1e-2, 1.0, 300.0])
@pytest.mark.parametrize("kT", [0.01, 0.2, 1.0, 1.5])
def test_an_integrator_with_dead_time_has_its_closed_forms(k, kT):
    found = margins(replace(open_system(k / s, delay=kT / k), horizon=np.inf), "torque")
    assert found.stable[0]
    assert_allclose(found.gain_increase[0, 0], np.pi / (2 * kT), rtol=1e-10)
    assert_allclose(found.phase_deg[0, 0], 90 - np.degrees(kT), rtol=1e-10)
    assert_allclose(found.delay[0, 0], (np.pi / 2 - kT) / k, rtol=1e-10)
    assert_allclose(found.crossover[0, 0], k, rtol=1e-12)
    assert found.gain_reduction[0, 0] == 0
    w = k * np.geomspace(1e-3, 1e3, 400_001)
    top = np.abs(1 / (1 + k / (1j * w) * np.exp(-1j * w * kT / k))).max()
    assert_allclose(found.sensitivity_peak[0, 0], max(1, top), rtol=1e-6)


def test_beyond_its_dead_time_a_loop_has_no_margins():
    found = margins(open_system(3 / s, delay=0.53), "torque")
    assert not found.stable[0] and np.isnan(found.phase_deg[0, 0]) and np.isnan(found.sensitivity_peak[0, 0])


def test_dead_time_taken_off_the_delay_margin_leaves_the_rest():
    L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    whole = margins(open_system(L), "torque")
    for part in (1e-4, 0.3, 0.9):
        late = margins(open_system(L, delay=part * whole.delay[0, 0]), "torque")
        assert_allclose(late.delay, whole.delay * (1 - part), rtol=1e-9)
        assert_allclose(late.crossover, whole.crossover, rtol=1e-10)


def test_the_margins_of_a_vanishing_dead_time_are_those_without(rng):
    system = random_loops(rng, 12, 5, 2)
    plain, late = margins(system, "torque"), margins(replace(system, wire_delay=np.full(2, 1e-9)), "torque")
    for name in ("gain_reduction", "phase_deg", "delay", "sensitivity_peak", "crossover"):
        assert_allclose(getattr(late, name), getattr(plain, name), rtol=1e-5)
    finite = plain.gain_increase < 1e3
    assert_allclose(late.gain_increase[finite], plain.gain_increase[finite], rtol=1e-5)


def test_every_metric_is_the_largest_perturbation_the_loop_survives(rng):
    system = replace(random_loops(rng, 14, 4, 2), wire_delay=np.array([0.11, 0.04]))
    found = margins(system, "torque")
    assert found.stable.sum() > 2
    for i in np.flatnonzero(found.stable):
        one = system.at(np.array([i]))
        for k in range(2):
            up, down, tau = found.gain_increase[i, k], found.gain_reduction[i, k], found.delay[i, k]
            if up < 1e3:
                assert stable(scaled(one, up * (1 - 1e-5), k)) and not stable(scaled(one, up * (1 + 1e-5), k))
            if down > 0:
                assert stable(scaled(one, down * (1 + 1e-5), k)) and not stable(scaled(one, down * (1 - 1e-5), k))
            if np.isfinite(tau):
                assert stable(later(one, k, tau * (1 - 1e-5))) and not stable(later(one, k, tau * (1 + 1e-5)))


def test_at_its_crossover_the_exact_response_has_size_one_and_the_phase_margin(rng):
    system = replace(random_loops(rng, 14, 4, 2), wire_delay=np.array([0.11, 0.04]))
    found = margins(system, "torque")
    for i, k in zip(*np.nonzero(np.isfinite(found.phase_deg)), strict=True):
        L = frequency_response(system.at(np.array([i])), found.crossover[i, k], "torque")[0, k, 0]
        assert_allclose([abs(L), abs(np.degrees(np.angle(-L)))], [1, found.phase_deg[i, k]], rtol=1e-9)


def test_a_high_resonance_binds_though_the_crossover_is_low():
    L = control.tf(2 / s) * (1 + 0.25 * s * 50 / (s**2 + 4 * s + 2500)) / (1 + s / 400)
    T = 0.004
    found = margins(open_system(L, delay=T), "torque")
    w = np.linspace(0.05, 600, 1_000_001)
    z = L(1j * w) * np.exp(-1j * w * T)
    real = np.flatnonzero((np.diff(np.sign(z.imag)) != 0) & (z.real[:-1] < 0))
    assert_allclose(found.gain_increase[0, 0], 1 / np.abs(z[real]).max(), rtol=1e-4)
    assert_allclose(found.sensitivity_peak[0, 0], np.abs(1 / (1 + z)).max(), rtol=1e-6)


def stable(system) -> bool:
    return bool(stability(system).nonzero_stable[0])


def later(system, wire: int, tau: float):
    delay = system.wire_delay.copy()
    delay[wire] += tau
    return replace(system, wire_delay=delay)


@pytest.mark.parametrize("T", [0.1, 2.0])
def test_a_real_root_that_leaves_the_disc_to_the_right_ends_the_gain_interval(T):
    # s + a - g k a e^(-sT) 3 / (s + 3) = 0 at s = radius
    a, k, radius = 0.02, 0.3, 0.01
    system = open_system(-k * a / (s + a) * 3 / (s + 3), delay=T)
    expected = (radius + a) / (k * a) * np.exp(radius * T) * (radius + 3) / 3
    found = margins(system, "torque")
    assert_allclose([found.gain_increase[0, 0], found.increase_frequency[0, 0]], [expected, 0], rtol=1e-9)
    assert stable(scaled(system, 0.99 * expected)) and not stable(scaled(system, 1.01 * expected))


def test_a_pair_that_leaves_the_disc_to_the_right_ends_the_gain_interval():
    d, w, radius = 0.002, 0.007, 0.01
    system = open_system(w**2 / (s**2 - 2 * d * s) * 3 / (s + 3), delay=0.5)
    found = margins(system, "torque")
    gain, at = found.gain_increase[0, 0], found.increase_frequency[0, 0]
    root = np.sqrt(radius**2 - at**2) + 1j * at
    assert 0 < at < radius
    assert_allclose(root**2 - 2 * d * root + gain * w**2 * 3 / (root + 3) * np.exp(-0.5 * root), 0, atol=1e-12)
    assert stable(scaled(system, 0.99 * gain)) and not stable(scaled(system, 1.01 * gain))
    assert_allclose(margins(replace(system, horizon=1e3), "torque").gain_increase, np.nan)  # the pair is not slow then


@pytest.mark.parametrize("q", [(0.04, 1.35), (1.33, 0.03), (0.92, 0.92)])
def test_coinciding_poles_do_not_hide_the_sensitivity_peak(q):
    # the poles of both joints coincide up to rounding, and so do frequencies that they place; the peak lies beside them
    law = mfc.laws.ComputedTorque(31.27, 17.49, 2.842)
    loop = mfc.ClosedLoop(mfc.robots.planar_2r(), law, mfc.trajectories.Hold(q), hardware=mfc.Hardware(delay=1.608e-3))
    system = loop.linearize([0.0]).opened
    S = sensitivities(system, "torque", np.linspace(1, 20, 20_001))
    assert_allclose(margins(system, "torque").sensitivity_peak[0], np.abs(S[:, [0, 1], [0, 1]]).max(axis=0), rtol=1e-6)


def test_many_points_at_once_have_the_margins_of_each_alone(rng):
    """Points of different spread, some unstable, and two with a triple pole whose modes are ill conditioned, with two dead times."""
    a, b = random_loops(rng, 12, 5, 2), random_loops(rng, 3, 5, 2)
    A, B, C, D = (np.concatenate([getattr(a, name), factor * getattr(b, name)]) for name, factor in (("A", 40), ("B", 1), ("C", 1), ("D", 1)))
    A[[2, 7], :3], B[[2, 7], :3] = np.eye(3, 5, k=1) - 5 * np.eye(3, 5), 0
    system = replace(a, times=np.arange(15.0), A=A, B=B, C=C, D=D, wire_delay=np.array([0.11, 0.04]))
    together = margins(system, "torque")
    assert 4 < together.stable.sum() < 15
    for i in range(15):
        alone = margins(system.at(np.array([i])), "torque")
        for name in ("gain_reduction", "gain_increase", "phase_deg", "delay", "crossover", "sensitivity_peak"):
            assert_allclose(getattr(together, name)[i], getattr(alone, name)[0], rtol=1e-9, err_msg=f"{name} at {i}")


def test_a_loop_whose_poles_without_dead_time_lie_on_the_axis_has_margins_with_it():
    # without dead time s^2 + 1; with it s^2 + 1.2 - 0.2 e^(-s T), which it damps
    L = control.ss([[0.0, 1.0], [-1.2, 0.0]], [[0.0], [1.0]], [[-0.2, 0.0]], [[0.0]])
    T = 0.4
    found = margins(open_system(L, delay=T), "torque")
    w = np.append(np.geomspace(0.02, 50, 40_001), 1.0)
    assert found.stable[0]
    assert_allclose(found.sensitivity_peak[0, 0], np.abs(1 / (1 + L(1j * w) * np.exp(-1j * w * T))).max(), rtol=1e-6)
    for gain, expectation in ((0.999, True), (1.001, False)):  # the pair is lost where the dead time no longer damps it
        assert stability(open_system(gain * found.gain_increase[0, 0] * L, delay=T)).nonzero_stable[0] == expectation


def test_the_gain_reduction_of_a_loop_with_a_huge_gain_has_its_digits():
    """K (s^2 + 2s + 1.5)/s^3 with K = 1e5: S is about 1e-5 at the crossing, which follows from the imaginary part of the loop itself."""
    K, T = 1e5, 1e-7
    s = control.tf("s")

    def loop(w: float) -> complex:
        return K * np.exp(-1j * w * T) * (1.5 - w * w + 2j * w) / (1j * w) ** 3

    w = brentq(lambda w: loop(w).imag, 1.0, 1.5, xtol=1e-15)
    found = mfc.margins(K * (s**2 + 2 * s + 1.5) / s**3, delay=T)
    assert found.gain_reduction.item() == pytest.approx(-1 / loop(w).real, rel=3e-9)
    assert found.reduction_frequency.item() == pytest.approx(w, rel=3e-9)


def test_of_many_maxima_of_nearly_the_same_height_the_highest_is_the_sensitivity_peak():
    """Dead time makes them; a fine grid finds none that is higher."""
    rng = np.random.default_rng(1)
    wires = int(rng.integers(1, 4))
    T = 10 ** rng.uniform(-3, 0, wires)
    system = replace(random_loops(rng, 4, int(rng.integers(wires, 7)), wires), wire_delay=T)
    (at,) = system.points
    found = margins(system, at)
    assert found.stable.any()
    for i in np.flatnonzero(found.stable):
        S = sensitivities(system.at(np.array([i])), at, np.geomspace(system.radius, 30 / T.min(), 20_000))
        size = np.abs(np.einsum("kii->ki", S)).max(axis=0)
        assert np.all(found.sensitivity_peak[i] >= size * (1 - 1e-12))
        assert_allclose(found.sensitivity_peak[i], np.maximum(size, 1), rtol=1e-4)


@pytest.mark.parametrize("zeta", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [0.4, 30.0])
def test_a_lightly_damped_pole_of_the_loop_does_not_hide_where_its_gain_may_end(zeta, w):
    """L has a pair of poles beside the axis, where S has zeros. At the ends of the interval of gains the count of the roots changes."""
    L = (4 * s + 4) / (s**2 - 0.01) * (s**2 + 2 * zeta * w * s + w**2) / (s**2 + 2.2 * zeta * w * s + (1.1 * w) ** 2)
    system = open_system(L, delay=0.02)
    found = margins(system, "torque")
    assert found.stable[0]
    low, high = found.gain_reduction[0, 0], found.gain_increase[0, 0]
    for k, stable in ((0.999 * low, False), (1.001 * low, True), (0.999 * high, True), (1.001 * high, False)):
        assert stability(scaled(system, k)).nonzero_stable[0] == stable
