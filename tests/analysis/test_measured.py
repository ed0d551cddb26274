"""Margins of sampled frequency responses, against those of the transfer function they are of."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.measured import unstable_roots
from mfc_analysis.errors import BadArgument
from tests.analysis.test_plain import LOOPS

W = np.geomspace(1e-3, 1e3, 60_000)
UNSTABLE = {"unstable pole": 1, "unstable pole with a lag": 1, "unstable pair": 2, "inverted pendulum": 1}
CONTINUOUS = [name for name, L in LOOPS.items() if not L.dt]


@pytest.mark.parametrize("name", [n for n in CONTINUOUS if n != "type one, slow"])
def test_dense_data_has_the_margins_of_its_transfer_function(name: str) -> None:
    L = control.tf(LOOPS[name])
    found, exact = mfc.margins(control.frd(L, W), open_loop_unstable=UNSTABLE.get(name, 0)), mfc.margins(L)
    assert found.stable[0]
    for metric in ("gain_increase", "gain_reduction", "phase_deg", "sensitivity_peak"):
        a, b = getattr(found, metric)[0, 0], getattr(exact, metric)[0, 0]
        if metric == "gain_increase" and a > 500:
            assert b > 500
        elif not (metric == "gain_reduction" and max(a, b) < 1e-3):
            assert_allclose(a, b, rtol=2e-3, err_msg=metric)


@pytest.mark.parametrize("name", CONTINUOUS)
@pytest.mark.parametrize("gain", [0.05, 0.4, 1.0, 3.0, 40.0])
def test_nyquists_count_is_the_number_of_unstable_roots(name: str, gain: float) -> None:
    L = control.tf(LOOPS[name])
    roots = np.roots(np.polyadd(L.den[0][0], gain * L.num[0][0]))
    w = np.geomspace(1e-5, 1e5, 20_000)
    if np.abs(roots.real).min() < 1e-3 or abs(gain * L(1j * w[-1])) > 1:
        pytest.skip("next to the boundary, or no end of the response")
    assert unstable_roots(w, gain * L(1j * w), UNSTABLE.get(name, 0)) == (roots.real > 0).sum()


def test_dead_time_turns_the_data() -> None:
    L = 2 / (s := control.tf("s"))
    found = mfc.margins(control.frd(L, W), delay=0.1)
    assert_allclose(found.phase_deg[0, 0], 90 - np.degrees(0.2), rtol=1e-4)
    assert not mfc.margins(control.frd(L, W[W < 60]), delay=0.9).stable[0] and s.ninputs == 1


def test_nothing_is_read_beyond_the_data() -> None:
    L = 15 / ((s := control.tf("s") + 1) * (s + 1) * (s + 2))
    found = mfc.margins(control.frd(L, np.geomspace(0.01, 2.5, 500)))
    assert np.isinf(found.gain_increase[0, 0])  # the phase crosses -180 deg at 3.3 rad/s
    assert_allclose(found.phase_deg, mfc.margins(L).phase_deg, rtol=1e-3)
    with pytest.raises(BadArgument, match="well above"):
        mfc.margins(control.frd(L, np.geomspace(0.01, 0.5, 100)))  # ends where |L| is 2


def test_too_few_unstable_poles_are_named() -> None:
    data = control.frd(control.tf([3], [1, -1]), W)
    assert mfc.margins(data, open_loop_unstable=1).stable[0]
    with pytest.raises(BadArgument, match="open_loop_unstable: got 0; takes at least 1"):
        mfc.margins(data)
    with pytest.raises(BadArgument, match="one channel"):
        mfc.margins(control.frd(np.ones((2, 2, 5)), np.arange(1.0, 6.0)))
