"""The characteristic function: its phase and rate against a direct determinant and a difference, its bounds against samples of the phases."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.characteristic import Delayed, delayed_points, in_a_loop
from mfc_analysis.analysis.system import OpenSystem
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")
DELAYS = (np.array([0.11, 0.04]), np.array([0.2, 0.2]), np.array([0.0, 0.3]))


def loops(rng: np.random.Generator, delay: np.ndarray) -> OpenSystem:
    """Random loops with a direct term between their wires."""
    system = replace(random_loops(rng, 3, 4, 2), wire_delay=delay)
    system.D[:, 1:, 1:] = 0.3 * rng.normal(size=(3, 2, 2))
    system.C[:] *= 10.0 ** rng.uniform(-2, 2, 4)  # states of very different sizes, which balancing changes
    system.B[:] /= 10.0 ** rng.uniform(-2, 2, (4, 1))
    return system


def determinant(system: OpenSystem, i: int, at: complex) -> complex:
    """det of the whole loop at ``at``, every wire a row: [zI - A, -B; -E C, I - E D]; divided by that of the wires without dead time."""
    A, B, C, D = system.A[i], system.B[i][:, system.nu :], system.C[i][system.ny :], system.D[i][system.ny :, system.nu :]
    late = system.wire_delay > 0
    E = np.exp(-at * system.wire_delay)[:, None]
    z = np.exp(at * system.dt) if system.dt else at
    whole = np.block([[z * np.eye(len(A)) - A, -B.astype(complex)], [-E * C, np.eye(len(E)) - E * D]])
    return complex(np.linalg.det(whole) / np.linalg.det(np.eye(int((~late).sum())) - D[np.ix_(~late, ~late)]))


@pytest.mark.parametrize("delay", DELAYS, ids=["two", "equal", "one"])
def test_the_function_is_the_determinant_of_the_whole_loop(rng, delay):
    system = loops(rng, delay)
    at = rng.normal(size=9) * 2 + 1j * rng.normal(size=9) * 6
    mirrored = np.array([-1.0 + 2j, -1.0 - 2j, -3.0, -4.0])
    for i, point in enumerate(delayed_points(system)):
        f = np.array([determinant(system, i, x) for x in at])
        phase, rate = point.value(at, mirrored)
        g = f / np.prod(at[:, None] - mirrored, axis=1)
        assert_allclose(np.exp(1j * phase), g / np.abs(g), rtol=1e-9)
        G = point.gain(at)
        loop = point.alone.loop(np.zeros(at.size, int), at)
        size = np.linalg.det(np.eye(len(point.T)) - loop) * np.prod(at[:, None] - point.open_poles, axis=1)
        assert_allclose(size, f, rtol=1e-8)
        assert_allclose(loop, np.exp(-at[:, None] * point.T)[:, :, None] * G, rtol=1e-12)
        step = 1e-5
        ahead, behind = (np.array([determinant(system, i, x + d) for x in at]) for d in (step, -step))
        numerical = (ahead - behind) / (2 * step) / f - (1 / (at[:, None] - mirrored)).sum(axis=1)
        assert_allclose(rate, numerical, rtol=1e-6, atol=1e-7)


def test_a_sampled_loop_has_z_in_the_place_of_s(rng):
    dt = 0.02
    plain = open_system(control.c2d(control.ss(4 / (s**2 + 0.4 * s + 4.2)), dt))
    system = replace(plain, wire_delay=np.array([5 * dt]))
    (point,) = delayed_points(system)
    at = rng.normal(size=6) + 1j * rng.uniform(0, 100, 6)
    f = np.array([determinant(system, 0, x) for x in at])
    phase, rate = point.value(at, np.zeros(0, complex))
    assert_allclose(np.exp(1j * phase), f / np.abs(f), rtol=1e-9)
    step = 1e-5
    ahead, behind = (np.array([determinant(system, 0, x + d) for x in at]) for d in (step, -step))
    assert_allclose(rate, (ahead - behind) / (2 * step) / f, rtol=1e-6)


def test_at_a_root_the_function_vanishes_and_newton_returns_to_it():
    (point,) = delayed_points(open_system(2 / s, delay=0.3))
    root = 0.0j
    for x in (-1.5 + 4j, -12 + 25j):  # two roots of s + 2 e^(-0.3 s)
        for _ in range(40):
            x = x - 1 / point.value(np.array([x]), np.zeros(0, complex))[1][0]
        assert abs(x + 2 * np.exp(-0.3 * x)) < 1e-12 * abs(2 * np.exp(-0.3 * x)) + 1e-12
        assert abs(x - root) > 1
        root = x


def test_on_a_pole_of_the_response_the_function_keeps_its_phase_and_rate():
    T = 0.1
    (point,) = delayed_points(open_system(25 / ((s**2 + 4) * (s + 3)), delay=T))
    at = np.array([2j, -3.0 + 0j])
    f = (at**2 + 4) * (at + 3) + 25 * np.exp(-T * at)
    slope = 2 * at * (at + 3) + at**2 + 4 - 25 * T * np.exp(-T * at)
    phase, rate = point.value(at, np.zeros(0, complex))
    assert_allclose(np.exp(1j * phase), f / np.abs(f), atol=1e-3)
    near = at * (1 + 1e-6)
    assert_allclose(point.value(near, np.zeros(0, complex))[1], slope / f, rtol=1e-3)
    assert np.isfinite(rate).all()


def test_poles_with_and_without_dead_time():
    (point,) = delayed_points(open_system(20 / (s * (s + 4)), delay=0.1))
    assert_allclose(np.sort_complex(point.open_poles), [-4, 0], atol=1e-12)
    assert_allclose(np.sort_complex(point.closed_poles), [-2 - 4j, -2 + 4j])
    assert_allclose(np.sort(np.abs(point.places)), [4, np.sqrt(20), np.sqrt(20), 10])  # zero is left out


def test_a_direct_gain_round_the_loop_is_bounded_over_all_phases(rng):
    for delay in DELAYS:
        for point in delayed_points(loops(rng, delay)):
            turns = (
                np.exp(1j * rng.uniform(0, 2 * np.pi, (400, 1)))
                if point.alone.one_delay
                else np.exp(1j * rng.uniform(0, 2 * np.pi, (400, len(point.T))))
            )
            sampled = np.abs(np.linalg.eigvals(turns[:, :, None] * point.D)).max()
            assert sampled <= point.strongest_direct * (1 + 3e-3)
            loop = rng.normal(size=(5, len(point.T), len(point.T))) + 0j
            for one, bound in zip(loop, point.alone.contraction(loop), strict=True):
                assert np.abs(np.linalg.eigvals(turns[:, :, None] * one)).max() <= bound * (1 + 1e-9)


def test_dead_time_is_in_a_loop_only_where_its_signal_returns():
    assert in_a_loop(delayed_points(open_system(2 / s, delay=0.3))[0].alone)
    outside = replace(open_system(control.tf([1], [1, 3])), wire_delay=np.array([0.2]))
    assert not in_a_loop(delayed_points(replace(outside, C=np.zeros_like(outside.C)))[0].alone)
    into, out, none = np.array([[1.0, 0.0]]), np.array([[0.0], [1.0]]), np.zeros((2, 2))
    chain = Delayed(np.array([[-3.0]]), into, out, none, np.array([0.2, 0.3]), np.ones(1))  # the first wire drives the second, which ends
    assert not in_a_loop(chain.alone)
    assert in_a_loop(replace(chain, D=np.array([[0.0, 1e-3], [0.0, 0.0]])).alone)
