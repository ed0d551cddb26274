"""Batches, orders and kept results of Pinocchio's calls."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis.maths.dual import Dual
from mfc_analysis.robots import calls
from mfc_analysis.robots.calls import symmetric
from mfc_analysis.robots.primitives import Primitives
from tests.conftest import arm, plant, seed
from tests.robots.test_primitives import REORDERED, point


def test_batches_of_any_shape_are_points_one_by_one() -> None:
    P, rng = Primitives(plant("kinova")), np.random.default_rng(5)
    q, v, a = rng.uniform(-1, 1, (3, 2, 4, 6))
    found = P.aba(q, v, a)
    assert found.shape == (2, 4, 6)
    assert_allclose(found[1, 2], P.aba(q[1, 2], v[1, 2], a[1, 2]), atol=1e-12)
    spread = P.rnea(q[0, 0], v[0], a[0])  # one pose, several velocities
    assert_allclose(spread[3], P.rnea(q[0, 0], v[0, 3], a[0, 3]), atol=1e-12)


@pytest.mark.parametrize("robot", [plant("panda"), plant("kinova"), plant("single_joint"), REORDERED], ids=str)
def test_many_points_in_one_call_of_pinocchio_are_the_points_one_by_one(robot, monkeypatch) -> None:
    """Also where Pinocchio was built without that call; and no point is no call."""
    P, rng = Primitives(robot), np.random.default_rng(6)
    q, v, x = rng.uniform(-1, 1, (3, 5, P.n))
    found = P.rnea(q, v, x), P.aba(q, v, x)
    assert P.aba(q[:0], v[:0], x[:0]).shape == (0, P.n)
    monkeypatch.setattr(calls, "MANY", {})
    for together, apart in zip(found, (P.rnea(q, v, x), P.aba(q, v, x)), strict=True):
        assert_allclose(together, apart, rtol=1e-12, atol=1e-10)


def test_what_was_returned_stays_when_the_next_point_is_evaluated() -> None:
    """Pinocchio's arrays are views of its Data."""
    P = Primitives(arm("ur5"))
    q, v, a, _ = point("ur5")
    first = P.rnea(Dual(q, np.ones((2, 6, 1))), v, a)
    kept = first.value.copy(), first.tangent.copy(), P.at(q).J.copy()
    at = P.at(q)
    P.rnea(Dual(q + 1, np.ones((2, 6, 1))), v, a)
    P.jacobian(q + 1, v)
    assert_allclose(first.value, kept[0])
    assert_allclose(first.tangent, kept[1])
    assert_allclose(at.J, kept[2])


def test_a_result_is_kept_when_the_next_call_overwrites_the_data_of_pinocchio() -> None:
    P, rng = Primitives(arm("ur5")), seed("kept")
    q, v, a = rng.normal(size=(3, 6))
    for call in (P.rnea, P.aba, lambda q, v, a: P.jacobian_dot(q, v), lambda q, v, a: P.at(q).M):
        first = call(q, v, a)
        copy = np.array(first)
        call(q + 1.0, v + 1.0, a)
        assert np.array_equal(first, copy)


def test_a_reordered_robot_is_the_same_robot() -> None:
    P, same = Primitives(REORDERED), Primitives(arm("ur5"))
    q, v, a, f = point("reordered")
    assert_allclose(P.rnea(q, v, a)[:, ::-1], same.rnea(q[:, ::-1], v[:, ::-1], a[:, ::-1]), atol=1e-12)
    assert_allclose(P.jacobian_transpose(q, f)[:, ::-1], same.jacobian_transpose(q[:, ::-1], f), atol=1e-12)


def test_rows_that_are_not_contiguous_are_taken_as_they_are() -> None:
    """A slice of states (m, 3 n), Fortran's order, every second entry, one row for all."""
    P, x = Primitives(arm("ur5")), seed("rows").normal(size=(5, 18))
    q, v, a = x[:, :6], x[:, 6:12], x[:, 12:]
    wanted = P.rnea(*(np.ascontiguousarray(y) for y in (q, v, a)))
    for form in (lambda y: y, np.asfortranarray, lambda y: np.repeat(y, 2, axis=1)[:, ::2]):
        assert_array_equal(P.rnea(form(q), form(v), form(a)), wanted)
    assert_array_equal(P.rnea(np.broadcast_to(q[0], (5, 6)), v, a), P.rnea(q[0], v, a))


def test_the_full_matrices_mirror_the_upper_triangle() -> None:
    upper = seed("symmetric").normal(size=(2, 3, 4, 4))
    wanted = np.triu(upper) + np.swapaxes(np.triu(upper, 1), -1, -2)
    assert_array_equal(symmetric(upper.copy()), wanted)
    assert_array_equal(symmetric(np.asfortranarray(upper[0, 0])), wanted[0, 0])
