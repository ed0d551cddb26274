"""The pieces of a sum of modes against the sum itself: where they lie, how near they come, when they end."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.analysis.modal_response import LONGEST, ModalPieces, Term, term
from mfc_analysis.analysis.modes import modes
from mfc_analysis.errors import NotConverged

SLOW_AND_FAST = np.diag([-1e6, -3.0, -1e-3])
JORDAN = np.array([[0.0, 1, 0], [0, 0, 1], [-1000, -300, -30]])
PAIR = np.array([[0.0, 50.0], [-50.0, -0.1]])


def pieces(A: np.ndarray, dt: float = 0.0) -> tuple[ModalPieces, list[Term]]:
    b, c = np.ones(len(A)), np.arange(1.0, len(A) + 1)
    found = [term(m, b, c, dt) for m in modes(A)]
    return ModalPieces(found, -float(sum((t.g @ t.v).real for t in found)), dt), found


@pytest.mark.parametrize("A", [SLOW_AND_FAST, JORDAN, PAIR])
def test_a_piece_is_the_sum_of_the_modes_everywhere(A: np.ndarray) -> None:
    run, found = pieces(A)
    size = max(t.size for t in found)
    before = 0.0
    for piece in run:
        assert piece.t[0] == pytest.approx(before, rel=1e-12)
        before = piece.t[-1]
        time, y, *_ = piece.nodes
        middle = 0.5 * (piece.t[:-1] + piece.t[1:])[:: max(1, len(piece.c) // 50)]
        values = np.polynomial.polynomial.polyval(0.5, piece.c.T)[:: max(1, len(piece.c) // 50)]
        for t, v in [*zip(time[::101], y[::101], strict=True), *zip(middle, values, strict=True)]:
            assert abs(v - run.steady - sum((one.g @ one.over(t) @ one.v).real for one in found)) < 1e-9 * size
    assert before == run.end
    assert all(abs(one.g @ one.over(run.end) @ one.v) < 1e-12 * size for one in found)


def test_sections_follow_the_time_scales() -> None:
    run, _ = pieces(SLOW_AND_FAST)
    assert run.end == pytest.approx(30 / 1e-3, rel=0.1)
    assert sum(len(piece.c) for piece in run) < 2000  # not the 1e11 of the fastest mode


def test_a_sampled_response_is_held_from_sample_to_sample() -> None:
    Z, dt = np.array([[0.5, 0.2], [0.0, -0.3]]), 0.1
    run, _ = pieces((Z - np.eye(2)) / dt, dt)
    x, y = np.zeros(2), []
    for _ in range(len(run[0].c)):
        y.append(x @ [1.0, 2.0])
        x = Z @ x + dt * np.ones(2)
    assert run[0].c.shape[1] == 1 and len(run) == 1
    assert_allclose(run[0].c[:, 0], y, atol=1e-12)


def test_the_reach_bounds_what_is_still_to_come() -> None:
    run, _ = pieces(PAIR)
    assert len(run) > 3 and (np.diff(run.reach) < 0).all()
    for i, piece in enumerate(run[:]):
        assert np.abs(piece.nodes[1] - run.steady).max() <= run.reach[i] * (1 + 1e-9)
    assert all(len(piece.c) <= LONGEST for piece in run)
    assert np.isinf(pieces(JORDAN)[0].reach).all()  # a few pieces, all looked at


@pytest.mark.parametrize("dt", [0.0, 1e-4])
def test_a_defective_mode_has_a_bound_too(dt: float) -> None:
    pair = np.array([[0.0, 10.0], [-10.0, -0.2]])
    A = np.block([[pair, np.eye(2)], [np.zeros((2, 2)), pair]])  # each root twice, in a chain
    _, found = pieces((expm(A * dt) - np.eye(4)) / dt if dt else A, dt)
    t = np.linspace(0, 200, 401)
    for one in found:
        assert len(one.T) == 2
        size = np.array([np.linalg.norm(one.g @ one.over(x)) * np.linalg.norm(one.v) for x in t])
        later = np.maximum.accumulate(size[::-1])[::-1]
        bound = one.bound(t)
        assert (bound >= later).all() and bound[200] < 1e-2 * bound[0]


def test_a_response_that_never_seems_to_end_is_refused_with_its_reason() -> None:
    endless = Term(np.array([[-1e-12 + 1e3j]]), np.ones(1, complex), np.ones(1, complex))
    with pytest.raises(NotConverged, match="swings"):
        ModalPieces([endless], 0.0)
