"""Samples of all responses at once: against the matrix exponential at each time, at any times, at many points."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from mfc_analysis.analysis.step_samples import between, step_samples
from mfc_analysis.analysis.system import OpenSystem, close_wires
from tests.analysis.conftest import control, open_system, random_loops

TIMES = {
    "equal steps": np.linspace(0.0, 3.0, 50),
    "equal steps, later": np.linspace(0.7, 3.0, 33),
    "any": np.array([0.01, 0.3, 0.31, 2.0]),
    "one": np.array([1.5]),
    "zero": np.array([0.0]),
}


def square(m: int, n: int = 5, k: int = 3, dt: float = 0.0) -> OpenSystem:
    """m stable loops of n states with k inputs and outputs, no wires."""
    rng = np.random.default_rng(4)
    A = rng.normal(size=(m, n, n)) - 3.0 * np.eye(n)
    B, C, D = rng.normal(size=(m, n, k)), rng.normal(size=(m, k, n)), rng.normal(size=(m, k, k))
    names = tuple(f"u{i}" for i in range(k)), tuple(f"y{i}" for i in range(k))
    A = expm(A * dt) if dt else A
    return OpenSystem(np.zeros(m), A, B, C, D, tuple(f"x{i}" for i in range(n)), *names, {}, (), np.zeros(0), (), dt=dt)


@pytest.mark.parametrize("t", TIMES.values(), ids=TIMES)
def test_samples_are_those_of_the_matrix_exponential(t: np.ndarray) -> None:
    system = square(3)
    y = step_samples(system, t)
    assert y.shape == (3, 3, 3, t.size)
    for i in range(3):
        for k, x in enumerate(t):
            moved = np.linalg.solve(system.A[i], (expm(system.A[i] * x) - np.eye(5)) @ system.B[i])
            assert_allclose(y[i, :, :, k], system.C[i] @ moved + system.D[i], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("t", TIMES.values(), ids=TIMES)
def test_a_sampled_loop_holds_its_samples(t: np.ndarray) -> None:
    system = square(2, dt=0.1)
    x, samples = np.zeros((2, 5, 3)), []
    for _ in range(31):
        samples.append(system.C @ x + system.D)
        x = system.A @ x + system.B
    assert_allclose(step_samples(system, t), np.moveaxis([samples[int(k / 0.1 + 1e-9)] for k in t], 0, -1), rtol=1e-10, atol=1e-12)


def test_responses_with_dead_time_are_those_of_their_series() -> None:
    k, T = 1.5, 0.4
    t = np.array([0.1, 0.35, 0.5, 0.75])
    y = step_samples(open_system(k / control.tf("s"), delay=T), t)
    assert_allclose(y[0, 0, 0], k * t - (k * np.maximum(t - T, 0.0)) ** 2 / 2, rtol=1e-9)


def test_inputs_and_outputs_keep_their_wires(rng) -> None:
    system = random_loops(rng, 4, 5, 2)
    one = between(system, [0], [0])
    assert one.input_names == system.input_names[:1] and one.nw == system.nw
    for ours, theirs in zip(close_wires(one), close_wires(system), strict=True):
        assert_allclose(ours, theirs[:, : ours.shape[1], : ours.shape[2]])


def test_a_thousand_points_take_little_more_memory_than_their_samples() -> None:
    system, t = square(1000), np.linspace(0.0, 3.0, 301)
    tracemalloc.start()
    y = step_samples(system, t)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert y.nbytes < most < y.nbytes + 3 * 8 * (1 << 20)
