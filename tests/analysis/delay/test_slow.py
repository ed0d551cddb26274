"""The slow roots of loops with dead time against Lambert's function, and what they keep moving."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

from mfc_analysis.analysis.delay.characteristic import delayed_points
from mfc_analysis.analysis.delay.slow import slow_part
from mfc_analysis.analysis.slow import MOVES
from mfc_analysis.analysis.stability import stability
from tests.analysis.conftest import open_system

s = control.tf("s")
RADIUS = 0.01


def found(L, T: float, count: int):
    return slow_part(delayed_points(open_system(L, delay=T))[0], RADIUS, count)


@pytest.mark.parametrize("T", [0.01, 1.0, 20.0, 100.0])
@pytest.mark.parametrize("k", [1e-5, 1e-3, 2e-3, -3e-3])
def test_the_slow_root_of_an_integrator_is_lamberts(k, T):
    roots, motion = found(k / s, T, 1)
    expected = lambertw(-k * T).real / T
    assert abs(expected) < 0.8 * RADIUS
    assert_allclose(roots, [expected], rtol=1e-6, atol=1e-12)
    assert motion.shape == (1, 1)


@pytest.mark.parametrize("T", [200.0, 500.0])
def test_a_slow_pair_of_a_long_dead_time_is_found_where_there_are_two_states(T):
    # k/s with a lag of 0.2 s: the pair is that of s (s + 5) / 5 + k e^(-sT)
    k = 1.2 / T
    verdict = stability(open_system(k * 5 / (s * (s + 5)), delay=T))
    pair = lambertw(-k * T, [0, -1]) / T
    for _ in range(30):
        late = k * np.exp(-pair * T)
        pair = pair - (pair * (pair + 5) / 5 + late) / ((2 * pair + 5) / 5 - T * late)
    others = np.abs(lambertw(-k * T, [1, -2]) / T)
    assert (np.abs(pair) < 0.9 * RADIUS).all()
    if (others > 1.2 * RADIUS).all():
        assert verdict.slow[0] == 2
        assert_allclose(np.sort_complex(verdict.slow_roots[0]), np.sort_complex(pair), rtol=1e-6)
    else:
        assert verdict.slow[0] >= 4


def test_two_free_positions_with_a_loop_beside_them_stay():
    loop = open_system(3 / (s * (s + 4)) * 4, delay=0.1)
    A = np.zeros((1, 4, 4))
    A[:, :2, :2] = loop.A
    free = replace(
        loop,
        A=A,
        B=np.pad(loop.B, ((0, 0), (0, 2), (0, 0))),
        C=np.pad(loop.C, ((0, 0), (0, 0), (0, 2))),
        state_names=("a", "b", "p", "q"),
    )
    roots, motion = slow_part(delayed_points(free)[0], RADIUS, 2)
    assert_allclose(roots, [0, 0], atol=1e-12)
    assert not motion.any()
    A[:, 2, 3] = 1.0  # now q is the rate of p
    roots, motion = slow_part(delayed_points(replace(free, A=A))[0], RADIUS, 2)
    assert_allclose(np.abs(roots), 0, atol=1e-6)
    expected = np.zeros((4, 4))
    expected[2, 3] = 0.5 / RADIUS  # p gains q times half the horizon
    assert_allclose(motion, expected, rtol=1e-9, atol=1e-9)


def test_motion_is_in_the_physical_states():
    loop = open_system(12 / (s * (s + 4)), delay=0.1)
    plain = replace(
        loop,
        A=np.pad(loop.A, ((0, 0), (0, 2), (0, 2))) + np.eye(4, k=1) * np.array([0, 0, 1.0, 0])[:, None],
        B=np.pad(loop.B, ((0, 0), (0, 2), (0, 0))),
        C=np.pad(loop.C, ((0, 0), (0, 0), (0, 2))),
        state_names=("a", "b", "p", "q"),
    )
    sizes = np.array([1.0, 1e3, 1e-4, 10.0])
    other = replace(plain, A=sizes[:, None] * plain.A / sizes, B=sizes[:, None] * plain.B, C=plain.C / sizes)
    motion = [slow_part(delayed_points(one)[0], RADIUS, 2)[1] for one in (plain, other)]
    big = np.abs(motion[1]) > MOVES
    assert_allclose(motion[1][big], (sizes[:, None] * motion[0] / sizes)[big], rtol=1e-6)


@pytest.mark.parametrize(("k", "drifts"), [(-9.5e-3, True), (-7e-3, False), (-1e-3, False), (1e-3, False), (3e-3, False)])
def test_a_slow_growth_drifts_where_it_grows_by_half_in_half_the_horizon(k, drifts):
    T = 0.5
    system = open_system(k / s * 5 / (s + 5), delay=T)
    verdict = stability(system)
    assert verdict.slow[0] == 1 and verdict.drifts[0] == drifts
    root = verdict.slow_roots[0][0].real
    assert abs(root * (root + 5) / 5 + k * np.exp(-root * T)) < 1e-9
    assert drifts == (np.exp(root / RADIUS / 2) > 1.5)


def test_the_slow_part_is_that_of_the_loop_without_dead_time_as_it_vanishes():
    L = (0.02 * s + 2e-5) / s**2 * 3 / (s + 3)
    late, plain = stability(open_system(L, delay=1e-7)), stability(open_system(L))
    assert late.slow[0] == plain.slow[0] == 1
    assert_allclose(late.slow_roots[0], plain.slow_roots[0], rtol=1e-5)
    assert_allclose(late.motion[0], plain.motion[0], rtol=1e-4, atol=1e-6)
