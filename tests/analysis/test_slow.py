"""The slow part of a loop: its size, its transition matrix, and what keeps moving within the horizon."""

import numpy as np
import pytest
from scipy.linalg import expm

from mfc_analysis.analysis.slow import moving, parts

RNG = np.random.default_rng(4)


def hidden(*blocks: np.ndarray) -> np.ndarray:
    """A block-diagonal matrix in other coordinates, badly scaled."""
    n = sum(len(b) for b in blocks)
    A, k = np.zeros((n, n)), 0
    for b in blocks:
        A[k : k + len(b), k : k + len(b)] = b
        k += len(b)
    T = RNG.normal(size=(n, n)) * 10.0 ** RNG.uniform(-2, 2, n)[:, None]
    return np.asarray(T @ A @ np.linalg.inv(T))


FAST = np.diag([-3.0, -40.0, -1e3])
RAMP = np.array([[0.0, 1.0], [0.0, 0.0]])


@pytest.mark.parametrize(("block", "count", "moves"), [(np.zeros((1, 1)), 1, False), (RAMP, 2, True), (np.array([[-5e-3]]), 1, False)])
def test_parts_decouple_and_give_the_transition_of_the_whole(block: np.ndarray, count: int, moves: bool) -> None:
    A = hidden(block, FAST)
    found = parts(A, 0.01)
    assert found.slow.block.shape == (count, count)
    assert found.slow.left @ found.slow.right == pytest.approx(np.eye(count), abs=1e-8)
    assert np.sort(np.linalg.eigvals(found.fast).real) == pytest.approx([-1e3, -40.0, -3.0], rel=1e-6)
    t = 0.7
    whole = found.slow.at(t) + found.fast_right @ expm(found.fast * t) @ found.fast_left
    assert np.abs(whole - expm(A * t)).max() < 1e-6 * np.abs(expm(A * t)).max()
    assert found.slow.moves(100.0).any() == moves


def test_a_root_belongs_to_the_slow_part_by_its_size_alone() -> None:
    for size, count in ((1.01, 0), (0.99, 1)):
        for sign in (1.0, -1.0):
            found = parts(hidden(np.array([[sign * size * 0.01]]), FAST), 0.01)
            assert len(found.slow.block) == count


def test_roots_known_to_be_slow_are_in_the_slow_part_with_both_of_a_pair() -> None:
    pair = np.array([[0.0, 0.0101], [-0.0101, 0.0]])  # just outside the disc
    A = hidden(np.array([[1e-4]]), pair, FAST)
    assert [len(parts(A, 0.01, least=k).slow.block) for k in range(6)] == [1, 1, 3, 3, 4, 5]
    found = parts(A, 0.01, least=2)
    assert np.sort(np.abs(np.linalg.eigvals(found.slow.block))) == pytest.approx([1e-4, 0.0101, 0.0101], rel=1e-6)
    whole = found.slow.at(3.0) + found.fast_right @ expm(3.0 * found.fast) @ found.fast_left
    assert np.abs(whole - expm(3.0 * A)).max() < 1e-6 * np.abs(expm(3.0 * A)).max()


def test_a_growth_of_one_over_the_horizon_keeps_moving_and_a_decay_does_not() -> None:
    assert moving(np.array([[np.e]]), np.array([[np.exp(0.5)]])).any()
    assert not moving(np.array([[np.exp(-1)]]), np.array([[np.exp(-0.5)]])).any()


def test_a_sampled_slow_part_has_the_same_transition() -> None:
    A, dt = hidden(RAMP, FAST), 1e-3
    found, same = parts(expm(A * dt), 0.01, dt), parts(A, 0.01)
    assert np.abs(found.slow.at(100.0) - same.slow.at(100.0)).max() < 1e-4 * np.abs(same.slow.at(100.0)).max()
    assert np.linalg.eigvals(found.slow.block) == pytest.approx(np.zeros(2), abs=1e-4)


def test_the_integral_is_that_of_the_transition() -> None:
    found = parts(hidden(RAMP, FAST), 0.01).slow
    times = np.linspace(0, 2.0, 2001)
    each = np.stack([expm(found.block * t) for t in times])
    assert found.integral(2.0) == pytest.approx(np.trapezoid(each, times, axis=0), rel=1e-5, abs=1e-9)
