"""Magnus steps, multipliers and the periodic orbit against closed forms and known transition curves."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.special import mathieu_a, mathieu_b

from mfc_analysis.analysis.floquet import (
    FloquetVerdict,
    accumulated,
    floquet,
    gauss_nodes,
    period_map,
    shoot,
    transient_growth,
    transition_magnus,
    transitions,
)
from mfc_analysis.errors import BadArgument, NotConverged


def steps(A, T: float, n: int) -> np.ndarray:
    edges = np.linspace(0, T, n + 1)
    nodes = gauss_nodes(edges)
    return transition_magnus(np.array([[A(t) for t in pair] for pair in nodes]), np.diff(edges))


def mathieu(a: float, q: float):
    return lambda t: np.array([[0.0, 1.0], [-(a - 2 * q * np.cos(2 * t)), 0.0]])


def test_the_nodes_are_those_of_two_point_gauss_legendre() -> None:
    x, _ = np.polynomial.legendre.leggauss(2)
    assert_allclose(gauss_nodes(np.array([1.0, 3.0, 3.5]))[0], 2 + x)


def test_a_constant_system_is_its_exponential_at_any_step() -> None:
    A = np.random.default_rng(0).normal(size=(5, 5))
    assert_allclose(period_map(steps(lambda t: A, 1.7, 3)), expm(1.7 * A), rtol=1e-11)


def test_the_error_falls_with_the_fourth_power_of_the_step() -> None:
    W, A0 = np.array([[0.0, -3.0], [3.0, 0.0]]), np.array([[-0.3, 2.0], [-1.0, -0.5]])
    exact = expm(2.0 * W) @ expm(2.0 * (A0 - W))  # A(t) = e^{Wt} A0 e^{-Wt}: constant in the turning frame
    errors = [np.abs(period_map(steps(lambda t: expm(t * W) @ A0 @ expm(-t * W), 2.0, n)) - exact).max() for n in (20, 40, 80)]
    assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 4.0, atol=0.05)
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("fast", [-2.0, -1e2, -1e4, -1e6])
def test_a_fast_root_along_a_turning_matrix_costs_no_accuracy(fast: float) -> None:
    """A(t) = e^{Wt} A0 e^{-Wt} again, over a second in 50 steps. The Magnus series is wrong by 1e-3 and more where the root is fast."""
    W, A0 = np.array([[0.0, -2.0], [2.0, 0.0]]), np.diag([-0.5, fast])

    def A(t: np.ndarray) -> np.ndarray:
        return np.array([expm(s * W) @ A0 @ expm(-s * W) for s in t])

    exact, edges = expm(W) @ expm(A0 - W), np.linspace(0.0, 1.0, 51)
    assert_allclose(period_map(transitions(A, edges)), exact, atol=3e-7)
    magnus = np.abs(period_map(steps(lambda t: A(np.array([t]))[0], 1.0, 50)) - exact).max()
    assert magnus < 3e-7 if fast > -10 else magnus > 1e-3


@pytest.mark.parametrize("jump", [0.5001, 0.5029, 0.5061, 0.508, 0.51, 0.5123, 0.5152, 0.5199])
def test_a_jump_is_found_wherever_in_a_step_it_is(jump: float) -> None:
    """Steps of 0.02 s; the nodes of the step and of its halves do not see a jump near its ends."""
    before, after = np.array([[0.0, 1.0], [-100.0, -20.0]]), np.array([[0.0, 1.0], [0.0, 0.0]])

    def A(t: np.ndarray) -> np.ndarray:
        return np.where((t < jump)[:, None, None], before, after)

    exact, edges = expm((1.0 - jump) * after) @ expm(jump * before), np.linspace(0.0, 1.0, 51)
    assert_allclose(period_map(transitions(A, edges, smooth=False)), exact, atol=1e-5 * np.abs(exact).max())


def test_a_short_event_is_followed_where_the_motion_is_not_smooth() -> None:
    """Damping that is large for a thousandth of a second, as friction is where a joint turns back."""

    def A(t: np.ndarray) -> np.ndarray:
        out = np.tile([[0.0, 1.0], [-100.0, -20.0]], (len(t), 1, 1))
        out[:, 1, 1] -= 1e3 * np.exp(-(((t - 0.437) / 1e-3) ** 2))
        return out

    found, fine = (period_map(transitions(A, np.linspace(0.0, 1.0, n + 1), smooth=False)) for n in (50, 50_000))
    assert_allclose(found, fine, atol=1e-6 * np.abs(fine).max())


def test_a_fast_root_of_a_constant_matrix_is_its_exponential() -> None:
    A = np.array([[0.0, 1.0], [-1e8, -1e5]])
    found = transitions(lambda t: np.broadcast_to(A, (len(t), 2, 2)), np.linspace(0.0, 1e-3, 3))
    assert_allclose(found, np.broadcast_to(expm(5e-4 * A), (2, 2, 2)), rtol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 5, 8, 13])
def test_the_product_and_the_accumulated_maps_agree_in_order(n: int) -> None:
    E = np.random.default_rng(n).normal(size=(n, 3, 3))
    Phi = accumulated(E)
    assert Phi.shape == (n + 1, 3, 3)
    assert_allclose(Phi[0], np.eye(3))
    assert_allclose(period_map(E), Phi[-1], rtol=1e-10)
    assert_allclose(Phi[1], E[0])


@pytest.mark.parametrize(
    ("a", "verdict"),
    [
        (lambda q: mathieu_b(1, q) + 1e-3, FloquetVerdict.PERIOD_DOUBLING),
        (lambda q: mathieu_a(1, q) - 1e-3, FloquetVerdict.PERIOD_DOUBLING),
        (lambda q: mathieu_b(1, q) - 1e-2, FloquetVerdict.STABLE),
        (lambda q: mathieu_a(1, q) + 1e-2, FloquetVerdict.STABLE),
        (lambda q: mathieu_a(0, q) - 1e-2, FloquetVerdict.UNSTABLE),
        (lambda q: mathieu_a(0, q) + 1e-2, FloquetVerdict.STABLE),
    ],
)
def test_mathieus_equation_changes_verdict_on_its_tabulated_curves(a, verdict) -> None:
    q, damping = 0.8, 1e-5  # a trace of damping, so that the stable side is not neutral
    system = mathieu(a(q), q)
    found = floquet(period_map(steps(lambda t: system(t) - np.diag([0.0, damping]), np.pi, 200)), np.pi)
    assert found.verdict is verdict
    assert found.stable == (verdict is FloquetVerdict.STABLE)
    assert (found.growth < 1) == found.stable


def test_the_product_of_the_multipliers_is_the_integrated_trace() -> None:
    found = floquet(period_map(steps(lambda t: mathieu(2.0, 0.5)(t) + np.diag([0.0, -0.3 * (1 + np.sin(2 * t))]), np.pi, 60)), np.pi)
    assert np.prod(found.multipliers).real == pytest.approx(np.exp(-0.3 * np.pi), rel=1e-9)
    assert np.sum(found.exponents).real == pytest.approx(-0.3, rel=1e-9)
    assert found.exponent == pytest.approx(np.log(np.abs(found.multipliers[0])) / np.pi)


def test_multipliers_of_a_constant_loop_are_exponentials_of_its_poles() -> None:
    poles = np.array([-1.0, -2.0, -0.5])
    found = floquet(expm(0.7 * np.diag(poles)), 0.7)
    assert_allclose(found.multipliers, np.exp(0.7 * np.sort(poles)[::-1]))
    assert found.exponent == pytest.approx(-0.5)
    assert found.verdict is FloquetVerdict.STABLE


def test_free_positions_are_neutral_and_sliding_ones_drift() -> None:
    free = floquet(np.diag([1.0, 0.5]), 2.0)
    assert (free.verdict, free.neutral, free.growth) == (FloquetVerdict.NEUTRAL, 1, 0.5)
    slides = floquet(np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.3]]), 2.0)
    assert slides.verdict is FloquetVerdict.DRIFTS
    assert not slides.stable
    circle = floquet(np.array([[0.0, -1.0], [1.0, 0.0]]), 2.0)  # an undamped pair is not stable
    assert circle.verdict is FloquetVerdict.UNSTABLE
    assert floquet(np.eye(2), 1.0).verdict is FloquetVerdict.NEUTRAL


def test_period_doubling_is_named() -> None:
    text = str(floquet(np.diag([-1.0738, 0.4]), 1.11))
    assert "period doubling" in text
    assert "1.0738" in text
    assert "180.0 deg" in text


def forced_pendulum(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    def f(t, y):
        q, v, Phi = y[0], y[1], y[2:].reshape(2, 2)
        A = np.array([[0.0, 1.0], [-4 * np.cos(q), -0.4]])
        return np.r_[v, -4 * np.sin(q) - 0.4 * v + 1.5 * np.cos(1.3 * t), (A @ Phi).ravel()]

    y = solve_ivp(f, (0, 2 * np.pi / 1.3), np.r_[x, 1, 0, 0, 1], rtol=1e-11, atol=1e-12).y[:, -1]
    return y[:2], y[2:].reshape(2, 2)


def test_shooting_finds_the_forced_orbit_of_a_pendulum_in_a_few_iterations() -> None:
    orbit = shoot(forced_pendulum, np.zeros(2))
    assert orbit.residual < 1e-10
    assert orbit.iterations <= 8
    found = floquet(orbit.Phi, 2 * np.pi / 1.3, orbit=orbit)
    assert np.prod(found.multipliers).real == pytest.approx(np.exp(-0.4 * 2 * np.pi / 1.3), rel=1e-8)
    assert found.orbit is orbit.x


def test_shooting_leaves_neutral_directions_alone() -> None:
    orbit = shoot(lambda x: (np.array([x[0], 0.5 * x[1] + 1.0]), np.diag([1.0, 0.5])), np.array([7.0, 0.0]))
    assert_allclose(orbit.x, [7.0, 2.0])


def test_no_orbit_is_an_error_with_the_residual() -> None:
    with pytest.raises(NotConverged, match="no periodic orbit"):
        shoot(lambda x: (x + 1.0, np.eye(1)), np.zeros(1))
    with pytest.raises(NotConverged, match="nan"):
        shoot(lambda x: (x * np.nan, np.eye(1)), np.zeros(1))


def test_transient_growth_of_a_shear_is_its_singular_value() -> None:
    t = np.linspace(0, 3, 31)
    Phi = np.stack([expm(s * np.array([[-1.0, 8.0], [0.0, -2.0]])) for s in t])
    found = transient_growth(Phi, t)
    norms = [np.linalg.svd(P)[1][0] for P in Phi]
    assert float(found) == pytest.approx(max(norms))
    assert found.time == t[int(np.argmax(norms))]
    assert np.linalg.norm(Phi[int(np.argmax(norms))] @ found.direction) == pytest.approx(found.largest)
    assert found.largest > 1
    assert "grows by at most" in str(found)
    with pytest.raises(BadArgument, match="Phi"):
        transient_growth(Phi, t[:-1])


def test_growth_beyond_all_numbers_is_refused_without_a_warning() -> None:
    A = np.broadcast_to([[1.0, 2.0], [0.5, 3.0]], (5, 2, 2, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for h in (100.0, 1e4, 1e100):  # the product of the steps overflows, or a step alone
            with pytest.raises(BadArgument, match="not finite"):
                transient_growth(accumulated(transition_magnus(A, h)), h * np.arange(6))
        with pytest.raises(BadArgument, match="A_nodes"):
            transition_magnus(A * np.nan, 1.0)
        with pytest.raises(BadArgument, match="A_nodes"):
            transition_magnus(A * 1e200, 1e200)


def test_a_map_without_a_finite_jacobian_is_no_orbit() -> None:
    with pytest.raises(NotConverged, match="no periodic orbit"):
        shoot(lambda x: (x + 1.0, np.full((2, 2), np.nan)), np.zeros(2))
