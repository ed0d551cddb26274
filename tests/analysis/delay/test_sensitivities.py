"""Sensitivities with dead time against a direct solution with every wire a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay import sensitivities as module
from mfc_analysis.analysis.delay.sensitivities import sensitivities
from tests.analysis.conftest import random_loops


@pytest.mark.parametrize("delay", [(0.1, 0.1), (0.1, 0.04), (0.0, 0.3)], ids=["equal", "two", "one"])
@pytest.mark.parametrize("condition", [module.CONDITION, 0.0], ids=["modes", "solutions"])
def test_they_are_those_of_the_whole_loop(rng, monkeypatch, delay, condition):
    monkeypatch.setattr(module, "CONDITION", condition)
    system = replace(random_loops(rng, 3, 4, 2), wire_delay=np.array(delay))
    (at,) = system.points
    found = sensitivities(system, at, np.arange(3))
    assert found.modal.all() == (condition > 0)
    point, s = np.array([2, 0, 1, 1, 2]), 1j * np.array([0.3, 2.0, 5.0, 5.0, 40.0]) + 0.1
    H = found.H(point, s)
    for k, (i, x) in enumerate(zip(point, s, strict=True)):
        B, C, D = system.B[i][:, system.nu :], system.C[i][system.ny :], system.D[i][system.ny :, system.nu :]
        G = C @ np.linalg.solve(x * np.eye(system.nx) - system.A[i], B) + D
        S = np.linalg.inv(np.eye(2) - np.exp(-x * system.wire_delay)[:, None] * G)
        assert_allclose(H[k], np.diag(S) - 1, rtol=1e-9)
        assert_allclose(found.one(point[k : k + 1], np.array([1]), s[k : k + 1]), H[k, 1], rtol=1e-9)
    assert_allclose(found.over(np.tile(s, (3, 1)))[point, :, np.arange(5)], H, rtol=1e-12)
    repeated = found.over_some(np.array([1]), s[None, [0, 1, 1, 4]])
    assert_allclose(repeated[:, :, 1], repeated[:, :, 2], rtol=0)
