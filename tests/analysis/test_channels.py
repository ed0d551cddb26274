"""Channels: the sensitivity of each wire with all others closed."""

from __future__ import annotations

import control
import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels, continuous
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")


def at(ch, i, k, point):
    return 1 + ch.H0[i, k] + ch.C[i, k] @ np.linalg.solve(point * np.eye(ch.A.shape[-1]) - ch.A[i], ch.B[i][:, k])


def test_each_channel_is_the_sensitivity_of_its_wire(rng):
    system = random_loops(rng, 2, 5, 3)
    ch = channels(system, "torque")
    for point in (0.7j, 2 + 1j):
        for i in range(2):
            G = system.C[i][1:] @ np.linalg.solve(point * np.eye(5) - system.A[i], system.B[i][:, 1:])
            whole = np.linalg.inv(np.eye(3) - G)
            for k in range(3):
                assert_allclose(at(ch, i, k, point), whole[k, k], rtol=1e-10)


def test_a_loop_with_a_direct_term_keeps_it():
    L = 3 * (s + 2) / (s + 5)
    ch = channels(open_system(L), "torque")
    assert_allclose(1 + ch.H0[0, 0], 1 / 4)
    assert_allclose(at(ch, 0, 0, 2j), 1 / (1 + L(2j)), rtol=1e-12)


def test_the_unit_circle_becomes_the_imaginary_axis():
    L = control.tf([0.4, 0.1], [1, -0.9, 0.2], 0.01)
    ch = channels(open_system(L), "torque")
    w = continuous(ch)
    for nu in (0.0, 0.3, 5.0):
        assert_allclose(at(w, 0, 0, 1j * nu), 1 / (1 + L((1 + 1j * nu) / (1 - 1j * nu))), rtol=1e-10)
    assert_allclose(1 + w.H0[0, 0], 1 / (1 + L(-1)), rtol=1e-10)
    assert continuous(w) is w
