"""Derivatives of the body Jacobian by brackets of its columns: order-2 remainders, and a step-ladder difference."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.robots.brackets import bracketed, jacobian_dot_derivatives, transposed_derivative
from mfc_analysis.robots.calls import Calls
from mfc_analysis.robots.primitives import Primitives
from tests.robots.test_primitives import EVERY, point

Map = Callable[[np.ndarray], np.ndarray]


def maps(name: str) -> list[tuple[Map, np.ndarray, np.ndarray]]:
    """Each function of the joint position (or velocity), where it is differentiated, and its derivative."""
    robot = EVERY[name]
    P, calls = Primitives(robot), Calls(robot)
    q, v, a, f = (x[0] for x in point(name))
    J = P.at(q).J
    K = bracketed(calls, J, v)
    dq, dv = jacobian_dot_derivatives(calls, J, K, v)
    return [
        (lambda x: P.at(x).J @ a, q, bracketed(calls, J, a)),
        (lambda x: P.at(x).J.T @ f, q, transposed_derivative(calls, J, f)),
        (lambda x: np.asarray(P.jacobian_dot(x, v)), q, dq),
        (lambda x: np.asarray(P.jacobian_dot(q, x)), v, dv),
    ]


@pytest.mark.parametrize("name", EVERY)
def test_each_derivative_leaves_a_remainder_of_second_order(name: str) -> None:
    for f, x, slope in maps(name):
        d = np.random.default_rng(0).uniform(-1, 1, x.size)
        h = np.array([1e-2, 1e-3])
        left = np.array([np.abs(f(x + s * d) - f(x) - s * slope @ d).max() for s in h])
        assert left[1] < 1e-9 or np.log10(left[0] / left[1]) == pytest.approx(2.0, abs=0.2)
        ladder = [(f(x + s * d) - f(x - s * d)) / (2 * s) for s in (1e-2, 1e-3)]
        assert_allclose((100 * ladder[1] - ladder[0]) / 99, slope @ d, atol=1e-8)


def test_the_rate_of_the_jacobian_is_its_derivative_along_the_velocity() -> None:
    for name in EVERY:
        P, (q, v, _, _) = Primitives(EVERY[name]), (x[0] for x in point(name))
        assert_allclose(bracketed(Calls(EVERY[name]), P.at(q).J, v) @ v, P.jacobian_dot(q, v), atol=1e-9)
