"""Crossovers isolated by exclusion are those of the eigenvalue problem."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.crossings import _candidates, _polished, _squared_frequencies, crossings
from mfc_analysis.analysis.frequency.exclusion import crossover_intervals, narrowed
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest
from mfc_analysis.analysis.frequency.resolvent import resolvent
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def prepared(system):
    ch = channels(system, "torque")
    ch = ch.at(np.linalg.eigvals(ch.A).real.max(axis=1) < 0)
    found = resolvent(ch)
    w = frequencies_of_interest(found.poles, 0.0)
    return found, w, found.on(w)


@pytest.mark.parametrize(("nx", "n", "spread"), [(3, 1, 0.0), (8, 2, 0.0), (8, 2, 1.5), (14, 1, 1.0)])
def test_both_ways_find_the_same_crossovers(rng, nx, n, spread):
    system = random_loops(rng, 80, nx, n)
    rates = 10.0 ** rng.uniform(-spread, spread, (80, nx, 1))
    system.A[:], system.B[:] = system.A * rates, system.B * rates
    found, w, H = prepared(system)
    by_exclusion, _ = crossings(found, w, H)
    squared, _ = _squared_frequencies(found.ch, found.poles, np.ones(found.ch.H0.shape, bool), 0.0)
    by_eigenvalues = _polished(found, *_candidates(squared, 0.0), gain=True)
    a, b = (np.lexsort((x.w, x.channel, x.point)) for x in (by_exclusion, by_eigenvalues))
    assert by_exclusion.w.size == by_eigenvalues.w.size > 5
    assert (by_exclusion.point[a] == by_eigenvalues.point[b]).all()
    assert_allclose(by_exclusion.w[a], by_eigenvalues.w[b], rtol=1e-10)


def test_two_crossovers_of_a_narrow_resonance_are_both_isolated():
    L = 0.5 / (s + 1) + 2e-4 * s / (s**2 + 2e-4 * s + 400)
    found, w, H = prepared(open_system(L))
    some, failed = crossover_intervals(found, w, H)
    assert not failed.any() and some.a.size == 2
    at = narrowed(found, some)
    assert_allclose(np.abs(L(1j * at)), 1, rtol=1e-9)
    assert_allclose(at, 20, rtol=1e-4)


def test_a_loop_that_tends_to_one_is_left_to_the_eigenvalues():
    found, w, H = prepared(open_system((s + 2) / (s + 3)))
    assert crossover_intervals(found, w, H)[1].all()
