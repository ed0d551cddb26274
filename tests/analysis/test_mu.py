"""Bounds of the structured singular value: ordered, meeting, and SLICOT's where that is known."""

import numpy as np
import pytest

from mfc_analysis.analysis.mu import has_slycot, largest_bound, lower_bound, osborne_bound, polished_bound, slicot_bound
from mfc_analysis.errors import NotConverged

needs_slycot = pytest.mark.skipif(not has_slycot(), reason="slycot is not installed")


@needs_slycot
@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_bounds_of_mu_are_ordered_and_meet(n: int) -> None:
    rng = np.random.default_rng(n)
    M = (rng.normal(size=(12, n, n)) + 1j * rng.normal(size=(12, n, n))) * np.exp(2 * rng.normal(size=(12, n, 1)))
    rough, balance = osborne_bound(M)
    upper, lower = polished_bound(M, balance)
    exact = np.array([slicot_bound(x) for x in M])
    slack = 1 + 1e-9
    assert np.all(upper <= rough * slack)
    assert np.all(exact <= upper * slack)
    assert np.all(lower <= exact * slack)
    assert np.all([lower_bound(x) <= e * slack for x, e in zip(M, exact, strict=True)])
    assert np.median(upper / lower - 1) < 1e-6
    best, where, attained = largest_bound(M)
    assert (best, where) == (pytest.approx(exact.max(), rel=1e-7), int(exact.argmax()))
    assert attained <= best


def test_mu_of_a_triangular_matrix_is_its_largest_diagonal_entry() -> None:
    M = np.array([[1.0, 50.0, -7.0], [0.0, 2.0, 9.0], [0.0, 0.0, -1.5]], complex)
    assert largest_bound(M[None])[0] == pytest.approx(2.0, rel=1e-6)
    assert lower_bound(M) == pytest.approx(2.0, rel=1e-6)


def test_one_channel_is_its_modulus_and_nothing_is_zero() -> None:
    assert largest_bound(np.array([[[3 + 4j]], [[1.0]]]))[:2] == (pytest.approx(5.0), 0)
    assert largest_bound(np.zeros((2, 3, 3), complex))[0] == pytest.approx(0.0, abs=1e-12)


def test_unitary_channel_phases_do_not_change_mu() -> None:
    rng = np.random.default_rng(0)
    M = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    turned = np.exp(1j * rng.uniform(0, 6, 3))[:, None] * M
    scaled = np.diag([1.0, 30.0, 0.02]) @ M @ np.diag([1.0, 1 / 30.0, 50.0])
    for other in (turned, scaled):
        assert largest_bound(other[None])[0] == pytest.approx(largest_bound(M[None])[0], rel=1e-6)


def test_where_lapack_does_not_converge_the_bounds_still_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper bound is the Frobenius norm of the balanced matrix, its lower bound 0."""
    rng = np.random.default_rng(1)
    M = rng.normal(size=(3, 4, 4)) + 1j * rng.normal(size=(3, 4, 4))
    exact = [lower_bound(x) for x in M]

    def fails(A: np.ndarray) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    for name in ("eigh", "eigvals", "svd"):
        monkeypatch.setattr(np.linalg, name, fails)
    upper, lower = polished_bound(M, np.zeros((3, 4)))
    assert np.all(upper >= np.array(exact)) and np.all(lower == 0)
    assert lower_bound(M[0]) == 0
    assert largest_bound(M, use_slicot=False)[0] >= max(exact)


def test_a_response_that_is_not_finite_is_refused() -> None:
    M = np.full((1, 2, 2), np.nan, complex)
    with pytest.raises(NotConverged, match="boundary"):
        largest_bound(M)
