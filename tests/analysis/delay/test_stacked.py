"""Points evaluated together: against one linear system at a time, with and without rows that leave it first."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.characteristic import delayed_points, stacked
from mfc_analysis.analysis.delay.stacked import Stacked, perron, times_own
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def chained(rng: np.random.Generator, m: int = 4) -> Stacked:
    """Three joints with integrals: z' = -c q, q' = v of different scale, v' full; a filter, two wires, one of them with a direct term."""
    n, nx = 3, 10
    A = np.zeros((m, nx, nx))
    A[:, np.arange(n), n + np.arange(n)] = 10.0 ** rng.uniform(-3, 3, (m, n))
    A[:, 2 * n + np.arange(n), np.arange(n)] = -(10.0 ** rng.uniform(-3, 3, (m, n)))
    A[:, n : 2 * n, : 2 * n] = rng.normal(size=(m, n, 2 * n))
    A[:, 9, 3:6], A[:, 9, 9] = 2.0, -2.0
    B = np.zeros((m, nx, 2))
    B[:, n : 2 * n] = rng.normal(size=(m, n, 2))
    D = np.zeros((m, 2, 2))
    D[:, 0, 1] = 0.3
    return Stacked(A, B, rng.normal(size=(m, 2, nx)), D, np.tile([0.1, 0.25], (m, 1)))


def test_the_gain_is_that_of_one_linear_system_for_each_place(rng):
    points = chained(rng)
    s = 10.0 ** rng.uniform(-4, 5, 80) * np.exp(1j * rng.uniform(-1.6, 1.6, 80))
    at = rng.integers(0, 4, 80)
    direct = np.stack([points.C[i] @ np.linalg.solve(x * np.eye(10) - points.A[i], points.B[i]) + points.D[i] for i, x in zip(at, s, strict=True)])
    assert_allclose(points.gain(at, s), direct, rtol=1e-9)
    assert_allclose(points.loop(at, s), np.exp(-s[:, None] * points.T[at])[:, :, None] * direct, rtol=1e-9)


def test_the_phase_and_rate_are_those_of_the_determinant(rng):
    points, poles = chained(rng), np.array([[-1.0, -2.0 + 1j]] * 4)
    s, at = rng.uniform(0.1, 3, 20) + 1j * rng.uniform(-30, 30, 20), rng.integers(0, 4, 20)
    phase, rate = points.value(at, s, poles)
    step = 1e-5 * np.abs(s)
    f, ahead, behind = (np.linalg.det(points.matrix(at, x)[0]) for x in (s, s + step, s - step))
    down = s[:, None] - poles[at]
    g = f / down.prod(axis=1)
    assert_allclose(np.exp(1j * phase), g / np.abs(g), rtol=1e-8)
    assert_allclose(rate, (ahead - behind) / (2 * step) / f - (1 / down).sum(axis=1), rtol=1e-5)


@pytest.mark.parametrize("direct", [False, True])
def test_f_has_its_digits_on_a_pole_of_the_gain_too(rng, direct):
    """det(sI - A) is zero there and det(I - E G) has a pole; the determinant of the whole characteristic matrix is neither."""
    points = chained(rng)
    points = points if direct else replace(points, D=np.zeros_like(points.D))
    s = np.array([pole for pole in points.open_poles[2] if pole.imag >= 0 and abs(pole) > 1e-6])  # at 0 f is zero as well
    s, at = np.concatenate([s, s * (1 + 1e-13), s * (1 + 1e-7j)]), np.full(3 * s.size, 2)
    phase, rate = points.value(at, s, np.zeros((4, 0), complex))
    f, df = points.matrix(at, s)
    assert_allclose(np.exp(1j * phase), np.linalg.slogdet(f)[0], rtol=1e-8)
    assert_allclose(rate, np.trace(np.linalg.solve(f, df), axis1=1, axis2=2), rtol=1e-8)


def test_at_a_root_the_rate_is_infinite():
    """x' = 0: f = s."""
    point = Stacked(np.zeros((1, 1, 1)), np.zeros((1, 1, 1)), np.ones((1, 1, 1)), np.zeros((1, 1, 1)), np.array([[0.5]]))
    rate = point.value(np.zeros(2, int), np.array([0.0, 2.0j]), np.zeros((1, 0), complex))[1]
    assert np.isinf(rate[0])
    assert_allclose(rate[1], 1 / 2.0j)


def test_rows_are_multiplied_by_the_matrix_of_their_point(rng):
    rows, matrices = rng.normal(size=(9, 2, 3)) + 1j, rng.normal(size=(5, 3, 4))
    for at in (rng.integers(0, 5, 9), np.sort(rng.integers(0, 5, 9)), np.full(9, 3)):
        assert_allclose(times_own(rows, matrices, at), rows @ matrices[at], rtol=1e-13)
    assert times_own(rows[:0], matrices, np.zeros(0, int)).shape == (0, 2, 4)


def test_an_oscillator_and_rows_with_an_input_or_another_entry_stay(rng):
    """x1' = x2, x2' = -4 x1: one of the two rows may leave, not both; so may no row with an input, nor one whose entry is 0 at some point."""
    A = np.zeros((2, 4, 4))
    A[:, 0, 1], A[:, 1, 0], A[:, 2, 3], A[:, 3, 2] = 1.0, -4.0, [1.0, 0.0], -9.0
    A[:, 3, 3] = -0.5
    B = np.ones((2, 4, 1)) * [[0.0], [0.0], [1.0], [1.0]]
    for inputs in (B, B[:, ::-1]):
        points = Stacked(A, inputs, rng.normal(size=(2, 1, 4)), np.zeros((2, 1, 1)), np.array([[0.2], [0.2]]))
        s, at = rng.uniform(0.5, 2, 12) + 1j * rng.uniform(-5, 5, 12), np.arange(12) % 2
        direct = np.stack([points.C[i] @ np.linalg.solve(x * np.eye(4) - A[i], points.B[i]) for i, x in zip(at, s, strict=True)])
        assert_allclose(points.gain(at, s), direct, rtol=1e-12)


def test_small_entries_keep_their_digits(rng):
    """Two integrator chains that touch by 1e-18: the entries of G between them are as exact as the others."""
    A = np.zeros((1, 4, 4))
    A[0, 0, 1] = A[0, 2, 3] = 1.0
    A[0, 1, :2], A[0, 3, 2:] = (-4.0, -1.0), (-9.0, -2.0)
    A[0, 1, 2] = 1e-18
    B, C = np.zeros((1, 4, 2)), np.zeros((1, 2, 4))
    B[0, 1, 0] = B[0, 3, 1] = C[0, 0, 0] = C[0, 1, 2] = 1.0
    s = 1j * np.array([0.01, 1.0, 2.0, 300.0])
    G = Stacked(A, B, C, np.zeros((1, 2, 2)), np.array([[0.1, 0.1]])).gain(np.zeros(4, int), s)
    first, second = 1 / (s * s + s + 4), 1 / (s * s + 2 * s + 9)
    assert_allclose(G, np.moveaxis([[first, first * second * 1e-18], [0 * s, second]], 2, 0), rtol=1e-13)


def test_points_together_are_the_points_alone(rng):
    points = delayed_points(replace(random_loops(rng, 5, 4, 2), wire_delay=np.array([0.3, 0.1])))
    s, at = 1j * rng.uniform(0.1, 40, 30), rng.integers(0, 5, 30)
    together = stacked(points)
    phase, rate = together.value(at, s, together.closed_poles)
    for k in range(30):
        alone = points[at[k]].value(s[k : k + 1], points[at[k]].closed_poles)
        assert_allclose((np.exp(1j * phase[k]), rate[k]), (np.exp(1j * alone[0][0]), alone[1][0]), rtol=1e-9)
    some = together.some(np.array([1, 3]))
    assert_allclose(some.gain(np.array([0, 1]), s[:2]), together.gain(np.array([1, 3]), s[:2]))


def test_perrons_bounds_are_close_from_above(rng):
    G = np.abs(rng.normal(size=(50, 4, 4)))
    exact = np.abs(np.linalg.eigvals(G)).max(axis=1)
    found = perron(G)
    assert (found >= exact * (1 - 1e-12)).all()
    assert_allclose(found, exact, rtol=1e-2)
    assert perron(np.zeros((1, 3, 3)))[0] == 0


def test_a_loop_gain_is_below_a_limit_where_its_eigenvalues_are(rng):
    """Of all kinds of matrices, nilpotent, zero and graded ones among them, with limits on both sides of the largest eigenvalue."""
    point = delayed_points(open_system(1 / s, delay=0.2))[0].alone
    M = rng.normal(size=(400, 4, 4)) + 1j * rng.normal(size=(400, 4, 4))
    M[100:200] = np.triu(M[100:200])
    M[200:300] *= np.geomspace(1, 1e5, 4)[:, None] / np.geomspace(1, 1e5, 4)
    M[300:350, :, 1:] = M[300:350, :, :1] * rng.normal(size=(50, 1, 3))
    M[0], M[1] = 0, np.eye(4, k=1)
    M *= 10.0 ** rng.uniform(-60, 60, (400, 1, 1))
    radius = np.abs(np.linalg.eigvals(M)).max(axis=1)
    for off in (-0.5, -1e-3, -1e-7, 1e-7, 1e-3, 0.5):
        below = [point.contracts(one[None], np.array([r * (1 + off)]))[0] for one, r in zip(M[2:], radius[2:], strict=True)]
        assert np.all(np.array(below) == (off > 0)), off
    assert point.contracts(M[:2], np.full(2, 1e-3)).all()
    assert_allclose(point.contracts(M / radius.max(), np.full(len(M), 0.8)), point.contraction(M / radius.max()) < 0.8)
