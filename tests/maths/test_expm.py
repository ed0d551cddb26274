"""Batched matrix exponentials against scipy's and closed forms."""

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.expm import expm, expm_integral

rng = np.random.default_rng(7)


@pytest.mark.parametrize("scale", [1e-4, 1e-2, 0.1, 0.3, 1.0, 3.0, 30.0])
def test_it_agrees_with_scipy_matrix_by_matrix(scale: float) -> None:
    A = rng.normal(size=(5, 18, 18)) * scale / 9
    ours, theirs = expm(A), np.stack([scipy.linalg.expm(a) for a in A])
    assert_allclose(ours, theirs, rtol=0, atol=2e-14 * np.abs(theirs).max())


def test_each_matrix_of_a_batch_is_scaled_by_its_own_norm() -> None:
    A = rng.normal(size=(4, 6, 6)) * np.array([1e-6, 1e-2, 1.0, 40.0])[:, None, None]
    for a, found in zip(A, expm(A), strict=True):
        theirs = scipy.linalg.expm(a)
        assert_allclose(found, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())


def test_rotations_and_jordan_blocks_have_their_closed_forms() -> None:
    t = np.array([0.0, 0.01, 1.0, 20.0])
    turn = expm(t[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]]))
    assert_allclose(turn[:, 0, 0], np.cos(t), atol=5e-14)
    assert_allclose(turn[:, 1, 0], np.sin(t), atol=5e-14)
    chain = expm(t[:, None, None] * np.diag([1.0, 1.0], 1))
    assert_allclose(chain[:, 0, 2], t**2 / 2, rtol=1e-13)


def test_the_inverse_is_the_exponential_of_the_negative() -> None:
    A = rng.normal(size=(2, 3, 6, 6)) * 2
    assert_allclose(expm(A) @ expm(-A), np.broadcast_to(np.eye(6), A.shape), atol=1e-9)


def test_complex_matrices_work() -> None:
    A = rng.normal(size=(3, 4, 4)) + 1j * rng.normal(size=(3, 4, 4))
    assert_allclose(expm(A), np.stack([scipy.linalg.expm(a) for a in A]), rtol=1e-12)


def test_the_held_input_is_integrated_exactly() -> None:
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    for h in (0.0, 0.3):
        Phi, Gamma = expm_integral(A, B, h)
        assert_allclose(Phi, [[1, h], [0, 1]])
        assert_allclose(Gamma[:, 0], [h**2 / 2, h])
    Phi, Gamma = expm_integral(-np.ones((2, 1, 1)), np.ones((2, 1, 1)), np.array([0.5, 2.0]))
    assert_allclose(Gamma[:, 0, 0], 1 - np.exp([-0.5, -2.0]), rtol=1e-14)


def test_bad_matrices_are_refused() -> None:
    with pytest.raises(BadArgument, match="square"):
        expm(np.zeros((3, 2)))
    with pytest.raises(BadArgument, match="finite"):
        expm(np.full((2, 2), np.nan))
    assert expm(np.zeros((0, 3, 3))).shape == (0, 3, 3)
