"""Bounds of the structured singular value: ordered, meeting, and SLICOT's where that is known."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.analysis.mu import largest_bound, lower_bound, osborne_bound, polished_bound, raised
from mfc_analysis.errors import NotConverged


def slicot_bound(M: np.ndarray) -> float:
    """SLICOT's AB13MD: the same infimum by an interior point method."""
    slycot = pytest.importorskip("slycot")
    return float(slycot.ab13md(M, np.ones(len(M), int), np.full(len(M), 2))[0])


@pytest.mark.parametrize("n", [2, 3, 5, 7])
def test_the_bounds_of_mu_are_ordered_and_meet(n: int) -> None:
    rng = np.random.default_rng(n)
    M = (rng.normal(size=(12, n, n)) + 1j * rng.normal(size=(12, n, n))) * np.exp(2 * rng.normal(size=(12, n, 1)))
    rough, balance = osborne_bound(M)
    upper, best_balance, lower = polished_bound(M, balance)
    scale = np.exp(best_balance)
    attained_by = np.linalg.norm(scale[:, :, None] * M / scale[:, None, :], 2, axis=(1, 2))
    np.testing.assert_allclose(attained_by, upper, rtol=1e-12)
    exact = np.array([slicot_bound(x) for x in M])
    slack = 1 + 1e-9
    assert np.all(upper <= rough * slack)
    np.testing.assert_allclose(upper, exact, rtol=1e-6)  # SLICOT stops at about 1e-7
    assert np.all(lower <= upper * slack)
    assert np.all([lower_bound(x) <= e * slack for x, e in zip(M, upper, strict=True)])
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


def test_only_what_exceeds_the_largest_so_far_is_polished() -> None:
    rng = np.random.default_rng(4)
    M = rng.normal(size=(20, 4, 4)) + 1j * rng.normal(size=(20, 4, 4))
    rough = osborne_bound(M)[0]
    found = raised([M], [-1.0])[0]
    assert found.bound[found.index] == found.value == largest_bound(M)[0]
    assert (found.bound <= rough).all() and (found.bound < rough).any() and (found.bound == rough).any()
    again = raised([M], [found.value])[0]
    assert (again.value, again.index, again.lower) == (found.value, -1, 0.0)


def test_sets_worked_on_together_have_the_largest_of_each_alone() -> None:
    rng = np.random.default_rng(14)
    every = [rng.normal(size=(k, 3, 3)) + 1j * rng.normal(size=(k, 3, 3)) for k in (1, 20, 9)]
    above = [-1.0, 1.0, 1e3]
    for M, least, found in zip(every, above, raised(every, above), strict=True):
        alone = raised([M], [least])[0]
        assert (found.index, found.value) == (alone.index, pytest.approx(alone.value, rel=1e-12))
        assert found.bound == pytest.approx(alone.bound, rel=1e-12) and found.lower <= found.value


def test_up_to_three_scalars_both_bounds_meet() -> None:
    rng = np.random.default_rng(6)
    M = (rng.normal(size=(40, 3, 3)) + 1j * rng.normal(size=(40, 3, 3))) * np.exp(2 * rng.normal(size=(40, 3, 1)))
    upper = polished_bound(M, osborne_bound(M)[1])[0]
    lower = [lower_bound(x) for x in M]
    assert np.median(upper / lower - 1) < 1e-9
    assert np.mean(upper / lower - 1 < 1e-6) > 0.9  # the power iteration may stop at a smaller maximum


def test_where_lapack_does_not_converge_the_bounds_still_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper bound is the Frobenius norm of the balanced matrix, its lower bound 0."""
    rng = np.random.default_rng(1)
    M = rng.normal(size=(3, 4, 4)) + 1j * rng.normal(size=(3, 4, 4))
    exact = [lower_bound(x) for x in M]

    def fails(A: np.ndarray) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    for name in ("eigh", "eigvals", "svd"):
        monkeypatch.setattr(np.linalg, name, fails)
    upper, _, lower = polished_bound(M, np.zeros((3, 4)))
    assert np.all(upper >= np.array(exact)) and np.all(lower == 0)
    assert lower_bound(M[0]) == 0
    assert largest_bound(M)[0] >= max(exact)


def test_a_response_that_is_not_finite_is_refused() -> None:
    M = np.full((1, 2, 2), np.nan, complex)
    with pytest.raises(NotConverged, match="boundary"):
        largest_bound(M)
