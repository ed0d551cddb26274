"""Roots at zero taken apart from the others."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.zero_roots import equilibrated, nonzero_roots, surely_regular, without_decoupled_zeros, without_zero_roots, zero_roots


def transfer(A, B, C, s):
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B)


def chained(rng: np.random.Generator, spread: float) -> np.ndarray:
    """A chain of two and one of one at zero, and four other roots, in random coordinates of different units."""
    A = np.zeros((7, 7))
    A[0, 1] = 1.0
    A[3:5, 3:5], A[5, 5], A[6, 6] = [[-1, 30], [-30, -1]], -2e-3, -1e4
    T = np.linalg.qr(rng.normal(size=A.shape))[0] * 10.0 ** rng.uniform(-spread, spread, 7)
    return T @ A @ np.linalg.inv(T)


@pytest.mark.parametrize("spread", [0.0, 1.5])
def test_both_parts_together_are_the_whole_system(rng, spread):
    for _ in range(10):
        A, B, C = chained(rng, spread), rng.normal(size=(7, 2)), rng.normal(size=(3, 7))
        parts = without_zero_roots(A, B, C)
        assert parts.A.shape == (4, 4) and parts.A_zero.shape == (3, 3)
        for s in (0.3, 2j, -5 + 1j):
            both = transfer(parts.A, parts.B, parts.C, s) + transfer(parts.A_zero, parts.B_zero, parts.C_zero, s)
            whole = transfer(A, B, C, s)
            assert_allclose(both, whole, rtol=1e-6, atol=1e-6 * np.abs(whole).max())


def test_the_other_roots_keep_their_digits_beside_a_chain(rng):
    found = nonzero_roots(chained(rng, 0.0), 3)
    assert_allclose(np.sort_complex(found), [-1e4, -1 - 30j, -1 + 30j, -2e-3], rtol=1e-6)


def test_counts_are_those_of_the_jordan_form(rng):
    found = zero_roots(np.stack([chained(rng, 1.0) for _ in range(5)] + [np.diag(np.arange(1.0, 8.0))]))
    assert found.neutral.tolist() == [1] * 5 + [0]
    assert found.drifts.tolist() == [True] * 5 + [False]
    assert found.count.tolist() == [3] * 5 + [0]


def test_only_zeros_that_wires_do_not_touch_are_decoupled():
    # x0: driven and seen; x1: seen only; x2, x3: a driven chain that nothing sees; x4: an ordinary root
    A = np.zeros((5, 5))
    A[2, 3], A[4, 4] = 1.0, -2.0
    B = np.array([[1.0], [0], [0], [1], [1]])
    C = np.array([[1.0, 1, 0, 0, 1]])
    a, b, c = without_decoupled_zeros(A, B, C)
    assert a.shape == (2, 2)
    for s in (0.5, 3j):
        assert_allclose(transfer(a, b, c, s), transfer(A, B, C, s), rtol=1e-12)


def test_scaling_does_not_care_for_units(rng):
    A = rng.normal(size=(6, 6))
    D = 10.0 ** rng.uniform(-6, 6, 6)
    E, r, c = equilibrated(A * D[:, None] / D)
    assert np.abs(E).max(axis=0) == pytest.approx(1, rel=0.1) and np.abs(E).max(axis=1) == pytest.approx(1, rel=0.1)
    assert_allclose(E, (A * D[:, None] / D) * r[:, None] * c)


def test_full_rank_is_granted_only_by_a_wide_margin():
    assert surely_regular(np.stack([np.diag([1e-6, 1e6]), np.array([[1.0, 1.0], [1.0, 1.0 + 1e-12]])])).tolist() == [True, False]
    assert surely_regular(np.zeros((2, 3, 3))).tolist() == [False, False]
