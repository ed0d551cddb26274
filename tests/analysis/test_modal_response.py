"""The pieces of a sum of modes against the sum itself: where they lie, how near they come, when they end."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.analysis.modal_response import LONGEST, VALUES, ModalPieces, Terms, terms
from mfc_analysis.analysis.modes import modes
from mfc_analysis.errors import NotConverged

SLOW_AND_FAST = np.diag([-1e6, -3.0, -1e-3])
JORDAN = np.array([[0.0, 1, 0], [0, 0, 1], [-1000, -300, -30]])
PAIR = np.array([[0.0, 50.0], [-50.0, -0.1]])


def pieces(A: np.ndarray, dt: float = 0.0, responses: int = 1) -> tuple[ModalPieces, Terms]:
    """Responses p c x to a unit step of x' = A x + b u, p = 1, 2, ..."""
    b, c = np.ones((len(A), responses)), np.outer(np.arange(1.0, responses + 1), np.arange(1.0, len(A) + 1))
    found = terms(modes(A), b, c, dt)
    return ModalPieces(found, -found.a[found.starts].real.sum(axis=0)), found


def exact(A: np.ndarray, t: float) -> float:
    """c x(t) of the first of these responses: x = A^-1 (exp(A t) - I) b."""
    c, b = np.arange(1.0, len(A) + 1), np.ones(len(A))
    return float(c @ np.linalg.solve(A, (expm(A * t) - np.eye(len(A))) @ b))


@pytest.mark.parametrize("A", [SLOW_AND_FAST, JORDAN, PAIR])
@pytest.mark.parametrize("responses", [1, 3])
def test_a_piece_is_the_response_everywhere(A: np.ndarray, responses: int) -> None:
    run, found = pieces(A, responses=responses)
    size = found.size.max(axis=0)
    before = 0.0
    for piece in (run.piece(i) for i in range(len(run))):
        assert piece.t[0] == pytest.approx(before, rel=1e-12)
        before = piece.t[-1]
        t = np.sort(np.concatenate([piece.t[::101], 0.5 * (piece.t[:-1] + piece.t[1:])[:: max(1, piece.t.size // 50)]]))
        truth = np.outer(np.arange(1, responses + 1), [exact(A, x) for x in t])
        assert (np.abs(piece.values(t) - truth) < 1e-9 * size[:, None]).all()
    assert before == run.end
    assert abs(exact(A, run.end) + found.a[found.starts].real.sum(axis=0)[0]) < 1e-12 * size[0]


def test_sections_follow_the_time_scales() -> None:
    run, _ = pieces(SLOW_AND_FAST)
    assert run.end == pytest.approx(30 / 1e-3, rel=0.1)
    assert sum(run.piece(i).t.size for i in range(len(run))) < 2000  # not the 1e11 of the fastest mode


def test_some_responses_of_a_piece_are_those_of_all_of_them() -> None:
    run, _ = pieces(PAIR, responses=4)
    assert len(run) > 8  # more than are kept: computed for those asked for
    some, every = run.piece(3, np.array([2, 0])), run.piece(3)
    assert_allclose(some.ends, every.ends[:, [2, 0]], rtol=1e-12, atol=1e-14)


def test_pieces_of_many_responses_are_short() -> None:
    run, found = pieces(PAIR, responses=400)
    assert run.piece(0).t.size - 1 == VALUES // 400 < LONGEST and found.a.shape[1] == 400


def test_a_sampled_response_is_held_from_sample_to_sample() -> None:
    Z, dt = np.array([[0.5, 0.2], [0.0, -0.3]]), 0.1
    run, _ = pieces((Z - np.eye(2)) / dt, dt)
    x, y = np.zeros(2), []
    for _ in range(run.piece(0).t.size - 1):
        y.append(x @ [1.0, 2.0])
        x = Z @ x + dt * np.ones(2)
    assert len(run.piece(0).basis) == 1 and len(run) == 1
    assert_allclose(run.piece(0).ends[0, 0], y, atol=1e-12)


def test_the_reach_bounds_what_is_still_to_come() -> None:
    run, _ = pieces(PAIR, responses=2)
    steady = -np.array([1.0, 2.0]) * (np.array([1.0, 2.0]) @ np.linalg.solve(PAIR, np.ones(2)))
    assert len(run) > 3 and (np.diff(run.reach, axis=0) < 0).all()
    for i in range(len(run)):
        high, low = run.piece(i).bounds
        assert (np.maximum(high - steady[:, None], steady[:, None] - low).max(axis=1) <= run.reach[i] * (1 + 1e-9)).all()
        assert run.piece(i).t.size - 1 <= LONGEST
    assert np.isinf(pieces(JORDAN)[0].reach).all()  # a few pieces, all looked at


@pytest.mark.parametrize("dt", [0.0, 1e-4])
def test_a_defective_mode_has_a_bound_too(dt: float) -> None:
    pair = np.array([[0.0, 10.0], [-10.0, -0.2]])
    A = np.block([[pair, np.eye(2)], [np.zeros((2, 2)), pair]])  # each root twice, in a chain
    _, found = pieces((expm(A * dt) - np.eye(4)) / dt if dt else A, dt)
    assert [block.stop - block.start for block in found.blocks] == [2, 2]
    t = np.linspace(0, 200, 401)
    size = np.abs([sum(found.over(j, x)[0] @ found.a[block] for j, block in enumerate(found.blocks)) for x in t])[:, 0]
    later = np.maximum.accumulate(size[::-1])[::-1]
    bound = found.bounds(t)[:, 0]
    assert (bound >= later).all() and bound[200] < 1e-2 * bound[0]


def test_a_response_that_never_seems_to_end_is_refused_with_its_reason() -> None:
    one = np.ones((1, 1), complex)
    endless = Terms(np.array([-1e-12 + 1e3j]), np.zeros(1), one, one.real, (slice(0, 1),))
    with pytest.raises(NotConverged, match="swings"):
        ModalPieces(endless, np.zeros(1))


def test_close_eigenvalues_that_differ_keep_their_form() -> None:
    """Newton's form where the eigenvalues of a mode are close and not equal: against the matrix exponential."""
    T = np.array([[-10.0, 300.0, 7.0], [0.0, -10.0005, 200.0], [0.0, 0.0, -10.001]])
    run, found = pieces(T)
    assert len(found.blocks) == 1
    t = np.linspace(0.0, 2.0, 9)
    assert_allclose(run.piece(0).values(t)[0], [exact(T, x) for x in t], atol=1e-9 * found.size.max())


def test_a_group_of_modes_of_very_different_decay_does_not_overflow() -> None:
    rates, one = np.array([-1e-3, -40.0 + 30j, -40.0 - 30j], complex), np.ones((3, 1), complex)
    group = Terms(rates, np.array([1e-3, 1e-3, 0.0]), one, one.real, (slice(0, 3),))
    for time in (0.1, 50.0, 6e4):
        J = np.diag(rates) + np.diag([1e-3, 1e-3], 1)
        found = group.over(0, time)
        assert np.isfinite(found).all()
        assert_allclose(found[0, 0], np.exp(-1e-3 * time), rtol=1e-12)
        if time < 1:
            assert_allclose(found, expm(J * time), atol=1e-12)
    assert np.isfinite(group.bounds(np.array([0.0, 1.0, 1e5]))).all()
