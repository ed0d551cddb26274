"""The response to second order against runs, and its largest misfits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.second_order import SAMPLES, STEPS, SecondOrder, expansion
from tests.simulation.test_directions import LOOPS, based


def joints(along: Along, basis: np.ndarray) -> SecondOrder:
    found = expansion(along, basis)
    assert found is not None
    return found.of_joints(along.e.parts["q"].where)


@pytest.mark.parametrize("name", LOOPS)
def test_the_second_order_response_is_half_the_second_difference_of_runs(name: str) -> None:
    loop, s = LOOPS[name](), 1e-3
    along, basis = based(loop, 0.2)
    found = joints(along, basis)
    t = np.linspace(0, 0.2, SAMPLES + 1)
    c = np.random.default_rng(0).uniform(-1, 1, basis.shape[1])
    up, down, still = (loop.simulate(t, x=along.base.x[0] + sign * s * basis @ c, **TIGHT).q for sign in (1, -1, 0))
    linear, square = (up - down) / (2 * s), (up + down - 2 * still) / (2 * s**2)
    assert_allclose(found.first @ c, linear.ravel(), atol=2e-3 * np.abs(linear).max())  # A held over a hundredth of the run
    assert_allclose(c @ found.second @ c, square.ravel(), atol=6e-2 * np.abs(square).max())  # the wrist's fast roots within a step
    assert_allclose(found.ratios(c[None])[0], np.log(np.linalg.norm(square) / np.linalg.norm(linear)), atol=0.06)


def test_a_maximum_stays_in_the_box_and_nothing_near_it_is_larger() -> None:
    loop = LOOPS["at rest"]()
    along, basis = based(loop, 0.2)
    found = joints(along, basis)
    k, rng = basis.shape[1], np.random.default_rng(1)
    start = np.eye(k)[2]
    reached, c = (x[0] for x in found.maxima(start[None], 6))
    assert c[2] == 1.0 and np.abs(c).max() <= 1.0
    near = np.clip(c + 0.3 * rng.normal(size=(200, k)), -1, 1)
    near[:, 2] = 1.0
    assert found.ratios(near).max() <= reached + 1e-9 and found.ratios(c[None])[0] == pytest.approx(reached)
    assert reached > found.ratios(start[None])[0]


def test_fewer_rows_give_the_same_misfits() -> None:
    loop = LOOPS["at rest"]()
    along, basis = based(loop, 0.2)
    found = joints(along, basis)
    few, c = found.turned(), np.random.default_rng(2).uniform(-1, 1, (50, basis.shape[1]))
    assert len(few.second) < 0.5 * len(found.second)
    assert_allclose(few.ratios(c), found.ratios(c), atol=1e-4)


def test_between_its_times_the_second_order_part_is_a_straight_line_and_of_the_square_of_the_size() -> None:
    loop = LOOPS["on a moving path"]()
    along, basis = based(loop, 0.2)
    found = expansion(along, basis)
    assert found is not None and len(found.t) - 1 in STEPS
    c = np.random.default_rng(4).uniform(-1, 1, (3, basis.shape[1]))
    own = found.beyond(found.t, c)
    assert_allclose(found.beyond(0.5 * (found.t[:-1] + found.t[1:]), c), 0.5 * (own[:-1] + own[1:]), atol=1e-15)
    assert_allclose(found.beyond(found.t[-1:], 0.1 * c), 0.01 * own[-1:], rtol=1e-12)
    every = (len(found.t) - 1) // SAMPLES
    assert_allclose(np.ravel(own[::every, 0, :2]), c[0] @ joints(along, basis).second @ c[0], atol=1e-15)
