"""Wires cut and closed: against python-control's feedback, direct terms included; integrals that act on nothing."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.spectrum import poles
from mfc_analysis.analysis.system import OpenSystem, close_wires, without_idle
from tests.analysis.conftest import from_matrix, open_system, random_loops

s = control.tf("s")


def with_direct_terms(rng: np.random.Generator) -> OpenSystem:
    system = random_loops(rng, m=2, nx=4, n=3)
    return replace(system, D=rng.uniform(-0.2, 0.2, system.D.shape))


def transfer(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, at: complex) -> np.ndarray:
    return D + C @ np.linalg.solve(at * np.eye(len(A)) - A, B)


@pytest.mark.parametrize("L", [25 / (s**3 + 10 * s**2 + 10 * s + 10), 3 * (s + 2) / (s + 5), control.tf([0.4], [1, -0.9], 0.01)], ids=str)
def test_a_closed_wire_is_python_controls_feedback(L):
    A, B, C, D = (M[0] for M in close_wires(open_system(L)))
    ours, theirs = control.ss(A, B, C, D, L.dt), control.feedback(control.ss(L), 1)
    at = np.array([0.1 + 0.3j, 2.0 - 1j])
    assert_allclose(ours(at), theirs(at), rtol=1e-10)
    assert_allclose(np.poly(A), np.poly(theirs.A), atol=1e-9)


def test_closing_all_wires_with_direct_terms_is_the_algebra_of_their_transfers(rng):
    system = with_direct_terms(rng)
    A, B, C, D = close_wires(system)
    for i in range(2):
        G = transfer(system.A[i], system.B[i], system.C[i], system.D[i], 0.3 + 1j)
        closed = G[:1, :1] + G[:1, 1:] @ np.linalg.solve(np.eye(3) - G[1:, 1:], G[1:, :1])  # w = G21 u + G22 w
        assert_allclose(transfer(A[i], B[i], C[i], D[i], 0.3 + 1j), closed, rtol=1e-10)


def test_wires_that_stay_cut_are_the_last_in_their_order_and_can_be_closed_later(rng):
    system = with_direct_terms(rng)
    at_once = close_wires(system)
    A, B, C, D = close_wires(system, np.array([True, False, True]))
    assert B.shape[2] == C.shape[1] == 3
    left = replace(system, A=A, B=B, C=C, D=D, wire_names=("j0", "j2"), wires={"torque": slice(0, 2)}, wire_delay=np.zeros(2))
    for one, other in zip(close_wires(left), at_once, strict=True):
        assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_with_every_wire_kept_nothing_changes(rng):
    system = with_direct_terms(rng)
    for kept, name in zip(close_wires(system, np.ones(3, bool)), "ABCD", strict=True):
        assert np.array_equal(kept, getattr(system, name))


def test_a_loop_with_dead_time_on_a_wire_is_delayed():
    assert open_system(1 / s, delay=0.1).delayed
    assert not open_system(1 / s).delayed


def test_some_of_the_points_keep_their_own_matrices():
    sampled = open_system([control.c2d(control.ss(k / s), 0.1) for k in (1, 2, 3)])
    some = sampled.at(np.array([2, 0]))
    assert some.times.tolist() == [2.0, 0.0] and (some.nx, some.nu, some.ny, some.nw) == (1, 1, 1, 1)
    assert_allclose(close_wires(some)[0].ravel(), [1 - 0.3, 1 - 0.1], rtol=1e-12)


def test_idle_integrals_go_and_nothing_else_changes():
    A = np.array([[-3.0, 0, -2, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]])  # q1, q2, z1, z2: z2 acts on nothing
    whole = replace(from_matrix(A, integrals=(2, 3)), plant_states=(0, 1))
    less = without_idle(whole)
    assert less.state_names == ("x0", "x1", "x2") and less.integrals == (2,) and less.plant_states == (0, 1)
    assert_allclose(poles(less)[0], [-1, -1, -2])
    assert_allclose(poles(whole)[0], [0, -1, -1, -2])
    assert without_idle(less) is less


def test_a_state_that_acts_at_one_point_or_is_no_integral_stays():
    idle = np.array([[-3.0, 0], [1, 0]])
    used = np.array([[-3.0, -1], [1, 0]])
    assert without_idle(from_matrix(idle, integrals=(1,))).nx == 1
    assert without_idle(from_matrix(np.stack([idle, used]), integrals=(1,))).nx == 2
    assert without_idle(from_matrix(idle)).nx == 2
