"""Rigid motions: exponential, logarithm, adjoint and their derivatives, against scipy, Pinocchio and differences."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.errors import BadArgument, NearPi
from mfc_analysis.maths import se3
from mfc_analysis.maths.dual import Dual
from mfc_analysis.maths.se3 import Pose

ANGLES = (0.0, 1e-12, 1e-8, 1e-5, 3e-4, 1.5e-3, 0.05, 0.2, 0.4999, 0.5001, 1.0, 2.3, 3.0, 3.13)
FEW = settings(max_examples=30, deadline=None)
component = st.floats(-1.5, 1.5)
twists = st.lists(component, min_size=6, max_size=6).map(np.array)


def matrix(V: np.ndarray) -> np.ndarray:
    """4x4 of se(3)."""
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = se3.hat(V[3:]), V[:3]
    return out


def with_angle(angle: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = rng.normal(size=3)
    return np.r_[rng.normal(size=3), angle * w / np.linalg.norm(w)]


@pytest.mark.parametrize("angle", ANGLES)
def test_the_exponential_is_that_of_the_matrix_and_the_logarithm_its_inverse(angle: float) -> None:
    V = with_angle(angle)
    X = se3.exp6(V)
    assert_allclose(X, expm(matrix(V)), atol=1e-13)
    assert_allclose(se3.exp3(V[3:]), X[:3, :3], atol=1e-15)
    assert_allclose(se3.log6(X), V, atol=3e-13 if angle < 3 else 2e-11)  # near pi 1/sin(angle) takes its toll
    assert_allclose(se3.log3(X[:3, :3]), V[3:], atol=3e-13)


@FEW
@given(V=twists, W=twists)
def test_the_adjoint_is_the_conjugation_and_ad_its_derivative(V: np.ndarray, W: np.ndarray) -> None:
    X = se3.exp6(V)
    assert_allclose(matrix(se3.adjoint(X) @ W), X @ matrix(W) @ se3.inverse(X), atol=1e-12)
    assert_allclose(se3.adjoint(X), expm(se3.ad(V)), atol=1e-11)
    assert_allclose(matrix(se3.bracket(V, W)), matrix(V) @ matrix(W) - matrix(W) @ matrix(V), atol=1e-12)
    assert_allclose(se3.inverse(X) @ X, np.eye(4), atol=1e-13)
    assert_allclose(se3.adjoint(X), pin.SE3(X).toActionMatrix(), atol=1e-13)  # (linear, angular), as Pinocchio has it


@pytest.mark.parametrize("angle", ANGLES)
def test_the_derivative_of_the_logarithm_is_exact_at_every_angle(angle: float) -> None:
    V, W, h = with_angle(angle), np.random.default_rng(1).normal(size=6), 1e-4
    X = se3.exp6(V)
    num = sum(w * se3.log6(X @ se3.exp6(k * h * W)) for k, w in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12 * h)
    assert_allclose(se3.Jlog6(V) @ W, num, atol=3e-10 if angle < 3 else 2e-6)  # near pi the differences are the weaker side
    assert_allclose(se3.log_rate(V, W), se3.Jlog6(V) @ W, atol=1e-12 * (1 if angle < 3 else 1e3))
    assert_allclose(se3.Jlog6(V) @ V, V, atol=1e-12)  # along itself the logarithm moves as it is
    inverse = sum((-1) ** k / math.factorial(k + 1) * np.linalg.matrix_power(se3.ad(V), k) for k in range(40))
    if angle < 2.5:
        assert_allclose(se3.Jlog6(V) @ inverse, np.eye(6), atol=1e-11)


def test_where_pinocchio_loses_digits_ours_does_not() -> None:
    """At 3e-4 rad pin.Jlog6 is off by 1e-6 and more; ours agrees with its Taylor series there to rounding."""
    V = with_angle(3e-4)
    a = se3.ad(V)
    series = np.eye(6) + a / 2 + a @ a / 12 - a @ a @ a @ a / 720
    assert_allclose(se3.Jlog6(V), series, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.3, 0.6, 2.0, 3.1])
def test_the_rate_of_the_logarithm_is_differentiated_as_well(angle: float) -> None:
    V, W = with_angle(angle), with_angle(0.7, 5)
    dV, dW = np.random.default_rng(2).normal(size=(2, 6, 3))
    dV *= 0.1
    found, h = se3.log_rate(Dual(V, dV), Dual(W, dW)), 1e-4
    for k in range(3):

        def f(s: float, k: int = k) -> np.ndarray:
            return se3.log_rate(V + s * dV[:, k], W + s * dW[:, k])

        num = (f(-2 * h) - 8 * f(-h) + 8 * f(h) - f(2 * h)) / (12 * h)
        assert_allclose(found.tangent[:, k], num, atol=1e-9 if angle < 3 else 1e-6)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_derivative_of_a_rotation_vector_and_its_own_derivative(angle: float) -> None:
    w, y, h = with_angle(angle)[3:], np.random.default_rng(3).normal(size=3), 1e-4
    assert_allclose(se3.Jlog3(w), se3.Jlog6(np.r_[0, 0, 0, w])[3:, 3:], atol=1e-12 * (1 if angle < 3 else 1e3))
    assert_allclose(se3.rotation_vector(se3.exp3(w)), w, atol=3e-13)
    steps = ((-2, 1), (-1, -8), (1, 8), (2, -1))
    num = np.stack([sum(c * se3.Jlog3(w + k * h * e) @ y for k, c in steps) / (12 * h) for e in np.eye(3)], axis=-1)
    assert_allclose(se3.Jlog3_slope(w, y), num, atol=1e-9 if angle < 3 else 1e-5 * np.abs(num).max())


def test_poses_carry_body_twists_through_products_inverses_adjoints_and_logarithms() -> None:
    rng = np.random.default_rng(4)
    A, B, V = se3.exp6(rng.normal(size=(2, 6))), se3.exp6(rng.normal(size=(2, 6)) * 0.5), rng.normal(size=(2, 6))
    a, b, v = rng.normal(size=(3, 2, 6))
    h = 1e-5

    def moved(X: np.ndarray, twist: np.ndarray, s: float) -> np.ndarray:
        return X @ se3.exp6(s * twist)

    PA, PB = Pose.of(A, a[..., None]), Pose.of(B, b[..., None])
    both = PA.inverse() @ PB

    def plain(s: float) -> np.ndarray:
        return se3.inverse(moved(A, a, s)) @ moved(B, b, s)

    assert_allclose(both.matrix, plain(0.0), atol=1e-14)
    twist = se3.log6(se3.inverse(plain(-h)) @ plain(h)) / (2 * h)
    assert_allclose(both.twist[..., 0], twist, atol=1e-8)
    found = both.adjoint(Dual(V, v[..., None]))
    num = (se3.adjoint(plain(h)) @ (V + h * v)[..., None] - se3.adjoint(plain(-h)) @ (V - h * v)[..., None])[..., 0] / (2 * h)
    assert_allclose(found.tangent[..., 0], num, atol=1e-7)
    num = (se3.log6(plain(h)) - se3.log6(plain(-h))) / (2 * h)
    assert_allclose(both.log().tangent[..., 0], num, atol=1e-7)
    assert Pose.of(A).inverse().twist is None and isinstance(Pose.of(A).log(), np.ndarray)


def test_a_rotation_by_nearly_pi_is_refused_and_one_just_below_is_not() -> None:
    with pytest.raises(NearPi) as info:
        Pose.of(se3.exp6(with_angle(np.pi - 5e-4))).log()
    assert abs(info.value.angle - (np.pi - 5e-4)) < 1e-9
    Pose.of(se3.exp6(with_angle(np.pi - 2e-3))).log()


NO_POSES = [np.eye(3), np.diag([1.0, 1, -1, 1]), 2 * np.eye(4), np.full((4, 4), np.nan), None, "pose", np.eye(4) + np.eye(4)[[3, 0, 1, 2]]]


@pytest.mark.parametrize("X", NO_POSES, ids=str)
def test_what_is_no_pose_is_refused(X: object) -> None:
    with pytest.raises(BadArgument) as info:
        se3.pose_matrix("X0", X)
    assert info.value.argument == "X0"


def test_a_pinocchio_pose_is_a_pose() -> None:
    X = se3.exp6(with_angle(1.0))
    assert_allclose(se3.pose_matrix("X", pin.SE3(X)), X, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_one_pose_gives_what_a_batch_gives(angle: float) -> None:
    V, W = with_angle(angle), with_angle(0.7, 1)
    X = se3.exp6(V)
    assert_allclose(se3.log6(X), se3.log6(X[None])[0], rtol=1e-12, atol=1e-15)
    assert_allclose(se3.log6(X), V, atol=1e-10)
    assert_allclose(se3.cross(V[:3], W[:3]), np.cross(V[:3], W[:3]), atol=1e-15)
    assert_allclose(se3.bracket(V, W), se3.bracket(V[None], W[None])[0], atol=1e-14)
    one, batch = Pose.of(X), Pose.of(X[None])
    assert_allclose(one.adjoint(W), batch.adjoint(W[None])[0], atol=1e-14)
    assert_allclose(one.adjoint(W), se3.adjoint(X) @ W, atol=1e-14)
    assert_allclose(one.log(), batch.log()[0], rtol=1e-12, atol=1e-15)
    assert_allclose(se3.rotation_vector(one.R), se3.rotation_vector(batch.R)[0], rtol=1e-12, atol=1e-15)
    assert_allclose(se3.Jlog3(V[3:]), se3.Jlog3(V[None, 3:])[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("short", [0.9e-3, 1.1e-3])
def test_one_pose_near_pi_is_refused_as_in_a_batch(short: float) -> None:
    X = se3.exp6(with_angle(np.pi - short))
    for pose in (Pose.of(X), Pose.of(X[None])):
        if short < 1e-3:
            with pytest.raises(NearPi):
                pose.log()
        else:
            assert np.isfinite(pose.log()).all()


def test_a_turn_by_pi_exactly_is_refused_alone_as_in_a_batch() -> None:
    """Its sine is 0: the angle is not the length of the logarithm."""
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    for X in (turned, turned[None]):
        with pytest.raises(NearPi):
            Pose.of(X).log()
        with pytest.raises(NearPi):
            se3.rotation_vector(X[..., :3, :3])


@pytest.mark.parametrize("angle", [*ANGLES, 2.5, np.pi - 1e-3])
def test_the_slope_of_the_rate_of_a_logarithm_is_that_of_differences_and_has_an_exact_tangent(angle: float) -> None:
    xi, eta, V, h = with_angle(angle), with_angle(0.9, 1), with_angle(0.7, 2), 1e-3 * max(1e-3, min(1.0, np.pi - angle))
    numeric = sum(c * se3.log_rate(xi + s * h * eta, V) for s, c in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12 * h)
    assert_allclose(se3.log_slope(xi, eta, V), numeric, rtol=1e-6, atol=1e-7)
    found = se3.log_slope(*(Dual(x, np.eye(18)[6 * i : 6 * i + 6]) for i, x in enumerate((xi, eta, V))))
    d = np.random.default_rng(3).normal(size=18)
    slopes = [se3.log_slope(xi + s * h * d[:6], eta + s * h * d[6:12], V + s * h * d[12:]) for s in (-2, -1, 1, 2)]
    numeric = (slopes[0] - 8 * slopes[1] + 8 * slopes[2] - slopes[3]) / (12 * h)
    assert_allclose(found.tangent @ d, numeric, rtol=1e-5, atol=1e-6)


def test_the_transposes_are_those_of_the_matrices() -> None:
    xi, V, F = with_angle(1.2), with_angle(0.7, 1), with_angle(0.4, 2)
    assert_allclose(se3.coadjoint(V, F), se3.ad(V).T @ F, atol=1e-14)
    assert_allclose(se3.log_rate_transposed(xi, F), se3.Jlog6(xi).T @ F, atol=1e-13)
    seeds = np.eye(12)
    found = se3.log_rate_transposed(Dual(xi, seeds[:6]), Dual(F, seeds[6:]))
    d, h = np.random.default_rng(4).normal(size=12), 1e-4
    numeric = (se3.log_rate_transposed(xi + h * d[:6], F + h * d[6:]) - se3.log_rate_transposed(xi - h * d[:6], F - h * d[6:])) / (2 * h)
    assert_allclose(found.tangent @ d, numeric, atol=1e-7)
