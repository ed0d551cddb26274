"""The loop with more dead time in one channel against the determinants of the loops resampled with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.shifted import shifted
from mfc_analysis.analysis.system import OpenSystem, close_wires
from tests.analysis.test_sampled import THIRD, loop

PLACES = np.exp(1j * np.array([0.2, 1.1, 3.0]))


def ratio(later: OpenSystem, now: OpenSystem, z: complex) -> complex:
    """det(zI - A) of the loop with more dead time over that of the loop now, without the registers that were added."""
    first, second = (np.linalg.slogdet(z * np.eye(one.nx) - close_wires(one)[0][0]) for one in (later, now))
    return complex(first[0] / second[0] * np.exp(first[1] - second[1]) * z ** (now.nx - later.nx))


@pytest.mark.parametrize("at", ["torque", "force"])
@pytest.mark.parametrize("delays", [(0.0, 0.0), (0.05, 0.0), (0.0, 0.07), (0.13, 0.07), (0.02, 0.1)])
@pytest.mark.parametrize("fast", [1.0, 40.0])
@pytest.mark.parametrize("by_modes", [True, False])
def test_more_dead_time_of_one_channel_is_the_loop_resampled_with_it(at: str, delays: tuple[float, float], fast: float, by_modes: bool) -> None:
    A, B, C = THIRD
    h = 0.05  # fast: 2 rad a sample, and several pieces of the fraction
    system = loop(A * fast, np.multiply(B, fast), C, 0.4, Ac=[[-2.0]], Bc=[1.0], Cc=[0.3], delays=delays)
    now = sampled(system, h)
    poles, vectors = np.linalg.eig(channels(now, at).A)
    found = shifted(now, at, (poles.astype(complex), vectors.astype(complex)) if by_modes else None)
    wire = ("torque", "force").index(at)
    assert_allclose(found.present, delays[wire] / h)
    one = np.zeros(1, np.int64)
    for more in (1e-5, 0.3, 0.75, 1.0, 2.6):
        T = float(found.present[0]) + more
        late = np.array(delays)
        late[wire] = T * h
        later = sampled(replace(system, wire_delay=late), h)
        d = np.ceil(T - 1e-9) - 1
        for z in PLACES:
            log = found.at(one, one, np.array([z]), np.array([T - d]))[0][0]
            left = found.left(one, one, np.array([z]))[0][0]
            U = 1 + found.at_infinity[0, 0] + left @ found.base[0, 0]
            assert_allclose(U * (1 - np.exp(log) * z ** -(d + 1)), ratio(later, now, complex(z)), rtol=1e-8, atol=1e-10)


def test_slopes_are_those_of_differences() -> None:
    now = sampled(loop(*THIRD, 0.4, Ac=[[-2.0]], Bc=[1.0], Cc=[0.3], delays=(0.03, 0.07)), 0.05)
    one = np.zeros(1, np.int64)
    for at in ("torque", "force"):
        found = shifted(now, at, None)
        z, f, step = np.exp(0.7j) * np.ones(1), np.array([0.37]), 1e-6
        _, by_z, by_f = found.at(one, one, z, f)
        up, down = (found.at(one, one, z + x, f)[0] for x in (step, -step))
        assert_allclose(by_z, (up - down) / (2 * step), rtol=1e-7)
        up, down = (found.at(one, one, z, f + x)[0] for x in (step, -step))
        assert_allclose(by_f, (up - down) / (2 * step), rtol=1e-6)
