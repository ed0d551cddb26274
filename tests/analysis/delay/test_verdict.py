"""The verdict with dead time: closed forms, the disc of slow roots, direct gains, unstable roots found before the count."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.analysis.delay import verdict as module
from mfc_analysis.analysis.delay.characteristic import delayed_points
from mfc_analysis.analysis.delay.count import unstable_roots
from mfc_analysis.analysis.delay.verdict import LONGEST, chain, delayed_verdicts, some_unstable, unstable_count
from mfc_analysis.analysis.spectrum import spectrum
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def verdict(system: OpenSystem):
    return delayed_verdicts(system, spectrum(system))[0]


@settings(max_examples=60)
@given(k=st.floats(-4, 2).map(lambda x: 10**x), kT=st.floats(-2, 1.5).map(lambda x: 10**x), sign=st.sampled_from((1, -1)))
def test_the_roots_of_an_integrator_are_slow_or_judged(k, kT, sign):
    T = kT / k
    system = open_system(sign * k / s, delay=T)
    assume(LONGEST * system.horizon > T)  # else refused by name
    roots = lambertw(-sign * kT, np.arange(-12, 13)) / T
    distance = np.abs(roots) / system.radius
    assume(np.abs(distance - 1).min() > 1e-2 and (np.abs(roots.real) > 1e-6 * np.abs(roots)).all())
    assume(distance[[0, -1]].min() > 1.1)  # the branches reach out of the disc
    found = verdict(system)
    assert found.slow == (distance < 1).sum()
    assert found.decays == (roots.real[distance > 1] < 0).all()
    assert found.held


@pytest.mark.parametrize(("factor", "slow"), [(1.01, 0), (0.99, 1)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_real_root_beside_the_circle_is_slow_or_judged(factor, slow, sign):
    T, radius = 0.5, 0.01
    root = -sign * factor * radius
    system = open_system(-root * np.exp(root * T) / s, delay=T)
    found = verdict(system)
    assert found.slow == slow
    assert found.decays == (sign > 0 or slow == 1)
    if slow:
        assert_allclose(found.slow_roots, [root], rtol=1e-2)
    judged = verdict(replace(system, horizon=np.inf))
    assert (judged.slow, judged.decays) == (0, sign > 0)


@pytest.mark.parametrize(
    ("d", "stable"), [(0.7, True), (-0.7, True), (0.9, True), (-0.99, True), (0.999, True), (1.1, False), (-1.1, False), (1.0, False)]
)
def test_a_direct_gain_of_one_or_more_round_a_dead_time_is_unstable(d, stable):
    # w = -d w(t - T) + ...: infinitely many roots with the real part log(d) / T
    assert verdict(open_system(d * (s + 2) / (s + 2.1), delay=0.2)).decays == stable


def test_a_dead_time_outside_every_loop_changes_no_verdict():
    for pole, decays in ((-3.0, True), (3.0, False)):
        plain = open_system(1 / (s - pole), delay=0.3)
        outside = replace(plain, C=np.zeros_like(plain.C))
        found = verdict(outside)
        assert (found.decays, found.slow, found.held) == (decays, 0, True)
    still = open_system(1 / s, delay=0.3)
    found = verdict(replace(still, C=np.zeros_like(still.C)))
    assert (found.slow, found.held) == (1, False)
    assert_allclose(found.slow_roots, [0])


def test_unstable_roots_are_found_only_where_there_are_some(rng):
    system = replace(random_loops(rng, 60, 4, 2), wire_delay=np.array([0.31, 0.12]))
    unstable = 0
    for point in delayed_points(system):
        count = unstable_roots(point, system.radius)[0]
        unstable += count > 0
        assert (unstable_count(point, system.radius) > 0) == (count > 0)
        assert count or some_unstable(point, system.radius, np.array([0.3 + 5j, 2 + 1j])) is None
    assert 10 < unstable < 50


def test_the_unstable_root_of_a_similar_loop_leads_to_one(monkeypatch):
    """x' = -400 x(t - 1) and a little more: the root is that of Lambert's function next to the known one, and no other place is looked at."""
    known = np.array([lambertw(-400.0, 3)])
    (point,) = delayed_points(open_system(401.0 / s, delay=1.0))
    monkeypatch.setattr(module, "chain", lambda _: pytest.fail("another place is looked at"))
    assert_allclose(some_unstable(point, 0.01, known), lambertw(-401.0, 3), rtol=1e-9)


def test_the_chain_holds_the_unstable_roots_of_a_long_dead_time():
    kT = 400.0
    (point,) = delayed_points(open_system(kT / s, delay=1.0))
    roots = lambertw(-kT, np.arange(-80, 0))
    roots = np.append(roots, lambertw(-kT, 0))
    found = chain(point)
    assert found.size > 10 and (np.diff(found.real) <= 0).all() and (found.imag > 0).all()
    distance = np.abs(found[:, None] - np.concatenate([roots, roots.conj()])).min(axis=1)
    assert (distance < 1e-6 * np.abs(found)).all()


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_the_verdict_equals_that_of_the_sampled_loop_with_whole_samples(seed):
    # a sampled loop has its dead time as delayed samples in the states (poles) or as a wire delay (count): the same loop
    rng = np.random.default_rng(seed)
    dt, n = 0.05, int(rng.integers(1, 8))
    plant = control.c2d(control.ss(rng.uniform(0.2, 6) * (s + rng.uniform(0.1, 3)) / (s**2 + rng.uniform(-0.3, 3) * s + rng.uniform(0.2, 9))), dt)
    counted = replace(open_system(plant), wire_delay=np.array([n * dt]))
    registers = control.ss(np.eye(n, k=-1), np.eye(n)[:, :1], np.eye(n)[-1:], [[0.0]], dt)
    poles = np.linalg.eigvals(control.feedback(control.series(registers, plant), 1).A)
    assume(np.abs(np.abs(poles) - 1).min() > 1e-5)
    assume(np.abs(np.abs(np.log(poles[np.abs(poles) > 1e-6]) / dt) - 0.01).min() > 1e-5)
    size = np.abs(np.log(poles[np.abs(poles) > 1e-6]) / dt)
    outside = np.abs(poles[np.abs(poles) > 1e-6][size >= 0.01])
    assert verdict(counted).decays == (outside < 1).all()


def test_a_singular_gain_with_a_long_dead_time_has_a_verdict():
    """Two equal rows of Ki: the loop is singular to rounding; its integral of a double integrator is unstable with any gain, by Routh."""
    law = mfc.laws.ComputedTorque(0, [[4.037612088991638, 0.7342502514934814]] * 2, 6e-8)
    loop = mfc.ClosedLoop(mfc.robots.planar_2r(), law, mfc.trajectories.Hold([0.1, 0.2]), hardware=mfc.Hardware(delay=917.4581504594084))
    assert not loop.linearize([0.0]).stable[0]


def test_an_unstable_loop_is_unstable_also_where_its_slow_roots_cannot_be_counted(monkeypatch):
    from mfc_analysis.analysis.delay import verdict as module
    from mfc_analysis.errors import NotConverged

    def unsettled(points, *_):
        return [NotConverged("the number of unstable roots", "a root lies on the circle")] * len(points.A)

    late, prompt = open_system(3 / s / (1e-3 * s + 1), delay=0.6), open_system(3 / s / (1e-3 * s + 1), delay=0.1)
    monkeypatch.setattr(module, "disc_counts", unsettled)
    assert not verdict(late).decays
    with pytest.raises(NotConverged, match="circle"):
        verdict(prompt)


@pytest.mark.parametrize("late", [0.1, 0.5, 1.0])
def test_without_a_horizon_a_root_at_zero_is_not_stable(late):
    # s^2 + 2 s - 3 + (2 s + 3) e^(-s T) has the root 0 at any dead time; its eigenvalue is -2e-16
    found = verdict(replace(open_system(control.tf([2, 3], [1, 2, -3]), late), horizon=np.inf))
    assert not found.decays


def test_without_a_horizon_a_free_self_motion_is_not_stable_with_dead_time():
    robot, rng = mfc.robots.load("panda"), np.random.default_rng(1)
    law = mfc.laws.Impedance([400, 400, 400, 30, 30, 30], [60, 60, 60, 4, 4, 4], null_damping=2.0)
    for q in np.array([0.3, -0.6, 0.4, -1.9, 0.5, 1.7, 0.2]) + rng.uniform(-0.2, 0.2, (12, 7)):
        loop = mfc.ClosedLoop(robot, law, mfc.trajectories.ToolHold(robot.pose(q)), q_start=q, hardware=mfc.Hardware(delay=1e-3))
        assert loop.linearize().stable[0] and not loop.linearize(horizon=np.inf).stable[0]
