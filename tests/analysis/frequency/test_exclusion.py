"""Crossovers isolated by exclusion are those of the eigenvalue problem."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.crossings import _candidates, _polished, _squared_frequencies, crossings
from mfc_analysis.analysis.frequency.exclusion import crossover_intervals, narrowed, phase_intervals
from mfc_analysis.analysis.frequency.grid import on_grid
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest
from mfc_analysis.analysis.frequency.resolvent import resolvent
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")
LOWEST = 1e-3  #: [rad/s]


def prepared(system):
    ch = channels(system, "torque")
    ch = ch.at(np.linalg.eigvals(ch.A).real.max(axis=1) < 0)
    found = resolvent(ch)
    return on_grid(found, frequencies_of_interest(found.poles, LOWEST))


@pytest.mark.parametrize(("nx", "n", "spread"), [(3, 1, 0.0), (8, 2, 0.0), (8, 2, 1.5), (14, 1, 1.0)])
def test_both_ways_find_the_same_crossovers(rng, nx, n, spread):
    system = random_loops(rng, 80, nx, n)
    rates = 10.0 ** rng.uniform(-spread, spread, (80, nx, 1))
    system.A[:], system.B[:] = system.A * rates, system.B * rates
    grid = prepared(system)
    found = grid.found
    assert phase_intervals(grid)[2].mean() < 0.05
    squared = _squared_frequencies(found.ch, found.poles, np.ones((2, *found.ch.H0.shape), bool), LOWEST)
    for by_exclusion, candidates, gain in zip(crossings(grid), squared, (True, False), strict=True):
        by_eigenvalues = _polished(found, *_candidates(candidates, LOWEST), gain=gain)
        by_eigenvalues = by_eigenvalues[by_eigenvalues.w >= LOWEST]
        a, b = (np.lexsort((x.w, x.channel, x.point)) for x in (by_exclusion, by_eigenvalues))
        assert by_exclusion.w.size == by_eigenvalues.w.size > 5
        assert (by_exclusion.point[a] == by_eigenvalues.point[b]).all()
        assert_allclose(by_exclusion.w[a], by_eigenvalues.w[b], rtol=1e-10)


def test_two_crossovers_of_a_narrow_resonance_are_both_isolated():
    L = 0.5 / (s + 1) + 2e-4 * s / (s**2 + 2e-4 * s + 400)
    grid = prepared(open_system(L))
    some, failed = crossover_intervals(grid)
    assert not failed.any() and some.a.size == 2
    at = narrowed(grid.found, some)
    assert_allclose(np.abs(L(1j * at)), 1, rtol=1e-9)
    assert_allclose(at, 20, rtol=1e-4)


def test_a_loop_that_tends_to_one_is_left_to_the_eigenvalues():
    assert crossover_intervals(prepared(open_system((s + 2) / (s + 3))))[1].all()


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_phase_crossings_of_any_relative_degree_need_no_eigenvalue_problem(degree):
    L = 3 / (s + 1) * (5 / (s + 5)) ** (degree - 1)
    known, some, failed = phase_intervals(prepared(open_system(L)))
    assert not failed.any()
    # the phase of L is -180 deg times a whole number where atan(w) + (degree - 1) atan(w / 5) is
    w = np.sort(narrowed(known, some))
    assert_allclose((np.arctan(w) + (degree - 1) * np.arctan(w / 5)) / np.pi, np.arange(1, (degree + 1) // 2), rtol=1e-9)
    assert some.a.size == max(0, (degree + 1) // 2 - 1)


def test_phase_crossings_that_may_lie_anywhere_above_are_left_to_the_eigenvalues():
    grid = prepared(open_system(3 / (s + 1) * 5 / (s + 5)))  # with c b = 1e-14, from rounding, H would be real again far above
    ch = grid.found.ch
    near = replace(ch, B=ch.B + 1e-14 * np.swapaxes(ch.C, 1, 2))
    assert phase_intervals(on_grid(replace(grid.found, ch=near), grid.w))[2].all()
