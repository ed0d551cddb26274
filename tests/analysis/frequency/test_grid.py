"""H on a grid: how far it bends between the frequencies, and what it does above all poles, against the loop itself."""

from __future__ import annotations

import control
import numpy as np
import pytest

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.grid import Grid, on_grid
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest
from mfc_analysis.analysis.frequency.resolvent import resolvent
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def grid_of(system) -> Grid:
    ch = channels(system, "torque")
    found = resolvent(ch.at(np.linalg.eigvals(ch.A).real.max(axis=1) < 0))
    return on_grid(found, frequencies_of_interest(found.poles, 1e-3))


def test_between_two_frequencies_no_loop_leaves_its_chord_by_more_than_the_bend_allows(rng):
    grid = grid_of(random_loops(rng, 30, 8, 2))
    assert grid.found.modal.all()
    middle = (grid.w[:, 1:] + grid.w[:, :-1]) / 2
    off = np.abs(grid.found.on(middle) - (grid.H[..., 1:] + grid.H[..., :-1]) / 2)
    assert (off <= np.diff(grid.w, axis=1)[:, None] ** 2 / 4 * grid.bend * (1 + 1e-9) + 1e-12 * np.abs(grid.H[..., 1:])).all()


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_above_its_end_the_loop_is_not_real_and_just_below_it_may_be(degree):
    grid = grid_of(open_system(3 / (s + 1) * (5 / (s + 5)) ** (degree - 1)))
    end, fastest = grid.real_end(), np.abs(grid.found.poles).max()
    assert 2 * fastest <= end[0, 0] < 20 * fastest
    w = end[0, 0] * np.geomspace(1, 300, 3000)[None]
    assert (np.diff(np.sign(grid.found.on(w)[0, 0].imag)) == 0).all()


def test_above_its_end_the_sensitivity_is_below_the_peak(rng):
    grid = grid_of(random_loops(rng, 60, 6, 2))
    S0 = np.abs(1 + grid.found.ch.H0)
    dense = np.geomspace(1, 1e6, 4000)
    for share in (0.0, 1e-5, 0.1):
        end = grid.peak_end(S0 * (1 + share))
        known = np.isfinite(end)
        assert known.mean() > (0.9 if share else 0.2)
        for i, j in np.argwhere(known):
            S = 1 + grid.found.some(np.array([i])).on(end[i, j] * dense[None])[0, j]
            assert np.abs(S).max() <= S0[i, j] * (1 + share) * (1 + 1e-12)


def test_a_loop_that_rises_above_one_again_far_up_has_no_end_below_that():
    L = control.tf(1.0 / (s + 1)) + 1e5 / (s**2 + 20 * s + 1e6)  # |S| > 1 around 1000 rad/s
    grid = grid_of(open_system(L))
    end = grid.peak_end(np.array([[1 + 1e-5]]))
    assert end[0, 0] > 1000
