"""Decoupled modes: what they add up to, multiple eigenvalues, and which of them rounding leaves in doubt."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.analysis.modes import modes


@pytest.mark.parametrize("n", [1, 2, 5, 12, 30])
def test_the_modes_add_up_to_the_matrix_and_do_not_see_each_other(n: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.normal(size=(n, n)) * 10 ** rng.uniform(0, 4, n)[:, None]
    found = modes(A)
    assert_allclose(sum(m.right @ m.T @ m.left for m in found), A, atol=1e-11 * np.abs(A).max())
    assert_allclose(sum(m.right @ m.left for m in found), np.eye(n), atol=1e-11)
    for one in found:
        assert_allclose(one.left @ one.right, np.eye(len(one.T)), atol=1e-10)
        assert np.allclose(one.T, np.triu(one.T))


def test_multiple_eigenvalues_stay_together() -> None:
    rng = np.random.default_rng(0)
    triple = np.array([[0.0, 1, 0], [0, 0, 1], [-1000, -300, -30]])  # (s + 10)^3, six times, and one apart
    Q = np.linalg.qr(rng.normal(size=(19, 19)))[0]
    whole = np.zeros((19, 19))
    whole[:18, :18], whole[18, 18] = np.kron(np.eye(6), triple), -500.0
    found = modes(Q @ whole @ Q.T)
    assert sorted(len(m.T) for m in found) == [1, 18]
    assert_allclose(sum(m.right @ m.T @ m.left for m in found), Q @ whole @ Q.T, atol=1e-9)


def test_eigenvalues_apart_whose_eigenvectors_are_worth_nothing_share_a_mode() -> None:
    """1e-3 of each other and coupled by 1e6: apart by the first gap, and amplified 1e9 times."""
    A = np.array([[-1.0, 1e6, 0.0], [0.0, -1.001, 0.0], [0.0, 0.0, -50.0]])
    rotated = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    found = modes(rotated @ A @ rotated.T)
    assert sorted(len(m.T) for m in found) == [1, 2]


def test_a_mode_decays_where_its_root_is_further_from_the_axis_than_rounding() -> None:
    # s^2 + s + 1e-6: roots -1e-6 and -1; s^2 + s: 0 and -1
    assert all(m.decays() for m in modes(np.array([[0, 1.0], [-1e-6, -1]])))
    assert sorted(m.decays() for m in modes(np.array([[0, 1.0], [0, -1]]))) == [False, True]
    dt = 1e-3
    for slow, known in ((1e-3, True), (0.0, False)):
        Z = expm(np.array([[0, 1.0], [-slow, -1]]) * dt)
        assert all(m.decays(dt) for m in modes((Z - np.eye(2)) / dt)) is known


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_the_integral_of_a_mode_is_its_answer_to_a_step(dt: float) -> None:
    one = next(m for m in modes(np.array([[0, 1.0], [0, -1]])) if not m.decays())
    assert_allclose(one.integral(3.0, dt), [[3.0]], rtol=1e-12)


def test_no_states_no_modes() -> None:
    assert modes(np.zeros((0, 0))) == []


def test_slow_and_fast_eigenvalues_are_never_in_one_mode_and_split_zeros_are() -> None:
    rng = np.random.default_rng(3)
    loose = np.kron(np.eye(3), [[0.0, 1.0], [0.0, 0.0]])  # three free positions that glide
    A = np.zeros((9, 9))
    A[:6, :6], A[:6, 6:], A[6:, 6:] = loose, 1e3 * rng.normal(size=(6, 3)), np.diag([-0.011, -5.0, -4e4])
    scale = 10 ** rng.uniform(-3, 3, 9)
    A = scale[:, None] * A / scale
    found = modes(A, radius=0.01)
    sizes = [np.abs(m.rates) for m in found]
    assert all((x < 0.01).all() or (x >= 0.01).all() for x in sizes)
    assert sum(len(x) for x in sizes if (x < 0.01).all()) == 6
    assert_allclose(sum(m.right @ m.T @ m.left for m in found), A, atol=1e-8 * np.abs(A).max())
