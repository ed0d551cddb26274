"""Dual arrays: each operation against central differences along random directions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.maths.dual import Dual, Seed, chain, concatenate, elementwise, matvec, times, total, value

K = np.random.default_rng(3).normal(size=(4, 3))

OPERATIONS = {
    "sum": lambda x, y: x + y,
    "sum with plain": lambda x, y: x + np.array([1.0, 2.0, 3.0]),
    "sum with number": lambda x, y: 2.0 + x,
    "difference": lambda x, y: x - y,
    "plain minus": lambda x, y: np.array([1.0, 2.0, 3.0]) - x,
    "minus plain": lambda x, y: x - np.array([1.0, 2.0, 3.0]),
    "negative": lambda x, y: -x,
    "product": lambda x, y: x * y,
    "product with plain": lambda x, y: np.array([1.0, 2.0, 3.0]) * x,
    "product with number": lambda x, y: x * 3.0,
    "product with one component": lambda x, y: x * y[2:3],
    "slice": lambda x, y: x[1:] * y[:2],
    "matrix": lambda x, y: matvec(K, x),
    "matrices": lambda x, y: matvec(np.stack([K, 2 * K]), x),
    "total": lambda x, y: total(x * y),
    "sine": lambda x, y: elementwise(x, np.sin, np.cos),
    "joined": lambda x, y: concatenate([x, y * y, -x]),
    "joined with plain": lambda x, y: concatenate([np.zeros((2, 2)), x * y]),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_carries_its_derivative(name: str) -> None:
    def f(x: object, y: object) -> object:
        if isinstance(x, Dual):
            return OPERATIONS[name](x, y)
        if "slice" in name or "one component" in name:  # a slice of a dual is of its last axis
            return x[..., 1:] * y[..., :2] if "slice" in name else x * y[..., 2:3]
        return OPERATIONS[name](x, y)

    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 2, 3))
    dx, dy = rng.normal(size=(2, 2, 3, 5))
    found = f(Dual(x, dx), Dual(y, dy))
    assert_allclose(found.value, np.broadcast_to(f(x, y), found.value.shape))
    assert found.tangent.shape == (*found.value.shape, 5)
    h = 1e-6
    for k in range(5):
        num = (f(x + h * dx[..., k], y + h * dy[..., k]) - f(x - h * dx[..., k], y - h * dy[..., k])) / (2 * h)
        assert_allclose(found.tangent[..., k], np.broadcast_to(num, found.value.shape), atol=1e-8)


def test_numpy_on_the_left_hands_over() -> None:
    x = Dual(np.ones(3), np.eye(3))
    for found in (np.arange(3.0) + x, np.arange(3.0) - x, np.arange(3.0) * x, np.float64(2) * x):
        assert isinstance(found, Dual)


def test_plain_arguments_stay_plain_and_cost_no_derivative() -> None:
    def never() -> np.ndarray:
        raise AssertionError("asked for a derivative of a plain argument")

    assert isinstance(chain(np.ones(2), (never, np.ones(3))), np.ndarray)
    out = chain(np.ones(2), (never, np.ones(3)), (lambda: np.ones((2, 3)), Dual(np.ones(3), np.eye(3))))
    assert_allclose(out.tangent, np.ones((2, 3)))
    assert isinstance(concatenate([np.ones(2), np.zeros(1)]), np.ndarray)
    assert value(3.0).shape == () and value(out) is out.value


def test_times_is_a_batched_matrix_on_a_vector() -> None:
    A, x = np.random.default_rng(1).normal(size=(5, 4, 3)), np.random.default_rng(2).normal(size=(5, 3))
    assert_allclose(times(A, x), np.einsum("mij,mj->mi", A, x))
    assert_allclose(times(A[0], x[0]), A[0] @ x[0])
    assert_allclose(times(A[0], x), x @ A[0].T)


def test_independent_variables_have_the_tangent_of_their_directions_in_sums_chains_and_slices() -> None:
    rng = np.random.default_rng(4)
    x = Seed(rng.normal(size=(2, 6)), 1, 9)
    plain = Dual(x.value, x.tangent)
    assert np.array_equal(x.tangent[0], np.eye(6, 9, 1))
    P, Q, R = rng.normal(size=(2, 4, 3)), rng.normal(size=(4, 3)), rng.normal(size=(2, 4, 6))
    for part, other in ((slice(3), slice(3, 6)), (slice(2, 5), slice(-3, None))):
        assert isinstance(x[part], Seed)
        for partials in ([P, Q], [Q, P]):
            found, want = (
                chain(np.zeros((2, 4)), *((lambda p=p: p, y) for p, y in zip(partials, (s[part], s[other]), strict=True))) for s in (x, plain)
            )
            assert np.array_equal(found.tangent, want.tangent)
    found, want = (chain(np.zeros((2, 4)), (lambda: Q, s[:3]), (lambda: R, s * s)) for s in (x, plain))
    assert_allclose(found.tangent, want.tangent, rtol=1e-15, atol=1e-15)  # summed in another order
    assert not isinstance(x[::2], Seed) and np.array_equal(x[::2].tangent, plain[::2].tangent)
    w = rng.normal(size=6)
    for act in (lambda s: 2 * s, lambda s: s * w, lambda s: -s, lambda s: w - s, lambda s: plain - s, lambda s: s - plain, lambda s: plain * s):
        found, want = act(x), act(plain)
        assert not isinstance(found, Seed) and np.array_equal(found.value, want.value) and np.array_equal(found.tangent, want.tangent)
