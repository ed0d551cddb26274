"""Roots of loops with dead time: Lambert's function, closed forms of the boundary, several delays at once."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.analysis.delay.roots import delay_roots, slow_rates
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, Unsupported
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


@pytest.mark.parametrize("kT", [0.05, 0.3, 1.0, 1.6, 8.0])
@pytest.mark.parametrize("k", [1e-2, 1.0, 1e3])
def test_an_integrator_with_dead_time_has_the_roots_of_lambert(k, kT):
    T = kT / k
    branches = np.array([lambertw(-kT, b) for b in range(-6, 7)]) / T
    expected = branches[np.lexsort((-branches.imag, np.abs(branches.imag), -branches.real))][:7]
    found = delay_roots(replace(open_system(k / s, delay=T), horizon=np.inf), 7)[0]
    assert_allclose(found, expected, rtol=1e-9)


def test_the_double_root_at_the_branch_point_is_found_to_half_of_the_digits():
    found = delay_roots(open_system(1 / s, delay=np.exp(-1)), 2)[0]
    assert_allclose(found, [-np.e, -np.e], rtol=1e-5)


@pytest.mark.parametrize("factor", [1 - 1e-6, 1 + 1e-6])
def test_an_integrator_is_stable_up_to_a_quarter_period(factor):
    assert stability(open_system(3 / s, delay=factor * np.pi / 6)).nonzero_stable[0] == (factor < 1)


@pytest.mark.parametrize("factor", [1 - 1e-6, 1 + 1e-6])
def test_the_delay_margin_is_the_boundary(factor):
    from mfc_analysis.analysis.margins import margins

    L = 25 / (s**3 + 10 * s**2 + 10 * s + 10)
    margin = margins(open_system(L), "torque").delay[0, 0]
    assert stability(open_system(L, delay=factor * margin)).stable[0] == (factor < 1)


def test_two_different_delays_satisfy_their_equation(rng):
    system = replace(random_loops(rng, 5, 4, 2), wire_delay=np.array([0.1, 0.37]))
    for i, roots in enumerate(delay_roots(system, 8)):
        A, B, C = system.A[i], system.B[i][:, 1:], system.C[i][1:]
        for root in roots:
            M = root * np.eye(4) - A - B @ np.diag(np.exp(-root * system.wire_delay)) @ C
            singular = np.linalg.svd(M, compute_uv=False)
            assert singular[-1] < 1e-10 * singular[0]


def test_commensurate_delays_equal_the_single_delay_they_add_up_to():
    # two wires in series around one integrator: dead times add
    T1, T2, k = 0.2, 0.5, 1.3
    system = OpenSystem(
        times=np.zeros(1),
        A=np.zeros((1, 1, 1)),
        B=np.array([[[1.0, 0.0]]]),
        C=np.array([[[0.0], [-k]]]),
        D=np.array([[[0.0, 1.0], [0.0, 0.0]]]),
        state_names=("x",),
        input_names=(),
        output_names=(),
        wires={"torque": slice(0, 1), "force": slice(1, 2)},
        wire_names=("a", "b"),
        wire_delay=np.array([T1, T2]),
        points=("torque", "force"),
    )
    assert_allclose(delay_roots(system, 5), delay_roots(open_system(k / s, delay=T1 + T2), 5), rtol=1e-9)


def test_no_unstable_root_is_missed_at_long_delays():
    # the argument principle counts the roots to the right of the axis
    for T in (0.5, 3.0, 12.0):
        L = 4 / (s**2 + 0.4 * s + 4.2)
        roots = delay_roots(open_system(L, delay=T), 40)[0]
        w = np.linspace(-6, 6, 2_000_001)
        one = 1 + L(1j * w) * np.exp(-1j * w * T)
        turns = np.unwrap(np.angle(one))
        encircled = -round((turns[-1] - turns[0]) / (2 * np.pi))
        assert (roots.real > 0).sum() == encircled


def integrators(*gains: float) -> OpenSystem:
    """Separate loops k/s, each with a dead time of 0.3 s."""
    n = len(gains)
    return replace(
        open_system(2 / s, delay=0.3),
        A=np.zeros((1, n, n)),
        B=np.hstack([np.zeros((n, 1)), np.eye(n)])[None],
        C=np.vstack([np.zeros((1, n)), -np.diag(gains)])[None],
        D=np.zeros((1, n + 1, n + 1)),
        wires={"torque": slice(0, n)},
        wire_names=tuple("abc"[:n]),
        wire_delay=np.full(n, 0.3),
        state_names=tuple("xyz"[:n]),
    )


@pytest.mark.parametrize("count", [6, 12, 18, 30])
def test_identical_copies_keep_all_their_roots_with_all_digits(count):
    expected = delay_roots(integrators(2.0), count // 3)[0]
    assert_allclose(_sorted(delay_roots(integrators(2.0, 2.0, 2.0), count)[0]), _sorted(np.repeat(expected, 3)), rtol=1e-9)


@pytest.mark.parametrize("apart", [1e-9, 1e-6, 1e-4, 1e-3])
def test_nearly_identical_copies_keep_their_own_roots(apart):
    each = np.concatenate([delay_roots(integrators(k), 8)[0] for k in (2.0, 2.0 * (1 + apart))])
    assert_allclose(_sorted(delay_roots(integrators(2.0, 2.0 * (1 + apart)), 16)[0]), _sorted(each), rtol=1e-6)


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("T", [1e-9, 1e-8, 1e-7])
def test_a_dead_time_next_to_none_leaves_the_poles(T, count):
    plant = (16 * s**2 + 80 * s + 60) / s**3
    found = delay_roots(open_system(plant, delay=T), count)[0]
    assert_allclose(_sorted(found[:3]), _sorted(np.roots([1, 16, 80, 60])), rtol=1e-5)


def _sorted(roots):
    return roots[np.lexsort((roots.real, np.round(roots.imag, 2)))]


def test_a_neutral_root_stays_and_the_others_are_judged():
    plain = open_system(3 / s, delay=0.4)
    free = replace(
        plain,
        A=np.zeros((1, 2, 2)),
        B=np.pad(plain.B, ((0, 0), (0, 1), (0, 0))),
        C=np.pad(plain.C, ((0, 0), (0, 0), (0, 1))),
        state_names=("x", "q"),
    )
    verdict = stability(free)
    assert (verdict.stable[0], verdict.neutral[0]) == (True, 1)
    roots = delay_roots(free, 3)[0]
    assert_allclose(roots[0], 0, atol=1e-15)
    assert_allclose(roots[1:], delay_roots(plain, 2)[0], rtol=1e-9)
    late = replace(free, wire_delay=np.array([0.6]))
    assert not stability(late).stable[0] and stability(late).neutral[0] == 1


def test_without_dead_time_the_roots_are_the_poles_and_beyond_them_there_are_none():
    found = delay_roots(open_system(20 / (s**2 + 4 * s)), 3)[0]
    assert_allclose(found[:2], [-2 + 4j, -2 - 4j])
    assert found[2].real == -np.inf


def test_dead_time_outside_every_loop_adds_no_roots():
    outside = replace(open_system(control.tf([1], [1, 3])), wire_delay=np.array([0.2]))
    outside = replace(outside, C=np.zeros_like(outside.C))
    found = delay_roots(outside, 4)[0]
    assert_allclose(found[0], -3)
    assert np.isneginf(found[1:].real).all()


def test_bad_counts_and_sampled_loops_are_refused():
    for bad in (0, -1, 2.5, True):
        with pytest.raises(BadArgument, match="count"):
            delay_roots(open_system(1 / s, delay=0.1), bad)
    with pytest.raises(Unsupported, match="sampled"):
        delay_roots(open_system(control.tf([0.4], [1, -0.9], 0.01)), 2)


@pytest.mark.parametrize("T", [0.1, 0.5])
def test_the_copies_of_a_multiple_unstable_root_are_not_listed_twice(T):
    """An admittance on a wall that is the same along x, y and z: (M s + D) s (lag s + 1)^2 + k e^(-s T), three times."""
    M, D, k, lag = 3.0, 60.0, 3e4, 5e-3
    law = mfc.laws.Admittance([0, 0, 10, 0, 0, 0], [M] * 3 + [2.0] * 3, [D] * 3 + [40.0] * 3)
    hold = mfc.trajectories.Hold(np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0]))
    wall = mfc.Environment(k, axes="xyz", preload=10.0)
    hardware = mfc.Hardware(delay=T, velocity_lag=lag, force_filter=lag)
    found = mfc.ClosedLoop(mfc.robots.ur5(), law, hold, environment=wall, hardware=hardware).linearize().delay_roots(8)[0]
    late, slow = k * np.exp(-found * T), lag * found + 1
    f = (M * found + D) * found * slow**2 + late
    slope = (2 * M * found + D) * slow**2 + 2 * lag * (M * found + D) * found * slow - T * late
    np.testing.assert_array_less(np.abs(f / slope), 1e-9 * np.abs(found))
    np.testing.assert_allclose(found[:3], found[0], rtol=1e-9)


@pytest.mark.parametrize("T", [0.01, 0.2])
def test_rates_of_slow_roots_without_newton_are_those_of_the_roots(rng, T):
    system = random_loops(rng, 20, 4, 2)
    for i in np.flatnonzero(stability(replace(system, wire_delay=np.full(2, T))).stable)[:5]:
        one = replace(system.at(np.array([i])), wire_delay=np.full(2, T))
        found, roots = slow_rates(one), delay_roots(one, 12)[0]
        near = roots[np.abs(roots) * T < 1.9]
        assert near.size and np.abs(found[:, None] + near.real).min(axis=0).max() < 1e-4 * np.abs(near).max()
