"""Loops without a robot: known figures, and the closed loop's own roots on both sides of every margin."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.plain import in_feedback
from mfc_analysis.errors import BadArgument

s, z = control.tf("s"), control.tf([1, 0], [1], 0.1)
LOOPS = {
    "three lags": 1 / (s**3 + 2 * s**2 + 3 * s + 4),
    "two lags and a zero": (s + 2) / (s**2 + 2 * s + 3),
    "servo with a resonance": 8.75 * (4 * s**2 + 0.4 * s + 1) / ((100 * s + 1) * (s**2 + 0.22 * s + 1)) / (s**2 / 100 + 0.008 * s + 1),
    "three equal lags": 15 / ((s + 1) * (s + 2) * (s + 3)),
    "third order": 25 / (s**3 + 10 * s**2 + 10 * s + 10),
    "type one": 20 / (s * (s**2 + 2 * s + 20)),
    "type one, slow": 1e-4 / (s * (s + 0.01)),
    "type two with lead": 4 * (s + 1) / (s**2 * (0.05 * s + 1)),
    "type three": 3 * (s + 1) ** 2 / s**3,
    "unstable pole": 3 / (s - 1),
    "unstable pole with a lag": 3 / ((s - 1) * (0.1 * s + 1)),
    "unstable pair": 6 * (s + 1) / (s**2 - s + 1) / (0.02 * s + 1),
    "inverted pendulum": 40 * (s + 2) / ((s - 3) * (s + 3)) / (0.01 * s + 1),
    "conditionally stable": 300 * (s + 2) ** 2 / (s**3 * (s + 30)) * 4,
    "zero in the right half plane": 0.8 * (1 - s) / (s + 1) ** 2,
    "several crossovers": 0.5 / s + 0.04 * 3 / (s**2 + 0.02 * s + 9) + 0.02 * 25 / (s**2 + 0.03 * s + 25),
    "resonance above one": 0.3 / s * (s**2 + 0.2 * s + 4) / (s**2 + 0.02 * s + 4.5),
    "feedthrough": 0.5 * (s + 4) / (s + 1),
    "negative gain": -0.5 / (s + 1),
    "discrete lag": 0.2 / (z - 0.8),
    "discrete integrator": 0.1 * (z + 0.5) / ((z - 1) * (z - 0.6)),
    "discrete unstable pole": 0.4 / (z - 1.1),
    "discrete resonance": 0.05 * (z + 0.9) / (z**2 - 1.6 * z + 0.95),
    "discrete deadbeat": 0.9 / (z * (z - 1)),
}


def stable(L: control.TransferFunction, gain: float) -> bool:
    roots = np.roots(np.polyadd(L.den[0][0], gain * L.num[0][0]))
    return bool((np.abs(roots) < 1).all() if L.dt else (roots.real < 0).all())


@pytest.mark.parametrize("name", LOOPS)
def test_the_closed_loop_is_lost_just_beyond_each_margin(name: str) -> None:
    L = control.tf(LOOPS[name])
    found = mfc.margins(L)
    assert found.stable[0] and stable(L, 1.0)
    down, up, phase, delay = (float(x[0, 0]) for x in (found.gain_reduction, found.gain_increase, found.phase_deg, found.delay))
    assert 0 <= down < 1 < up
    for end, inner, outer in ((down, 1.001, 0.999), (up, 0.999, 1.001)):
        if 0 < end < np.inf:
            assert stable(L, inner * end) and not stable(L, outer * end)
    for gain in np.geomspace(max(down * 1.001, 1e-3), min(up * 0.999, 1e3), 200):
        assert stable(L, gain)
    if np.isfinite(phase):
        w = found.crossover[0, 0]
        at = np.exp(1j * w * L.dt) if L.dt else 1j * w
        assert_allclose(abs(L(at)), 1, rtol=1e-9)
        assert_allclose(np.degrees(np.abs(np.angle(-L(at)))), phase, rtol=1e-7)
    if np.isfinite(delay) and not L.dt and delay > 0:
        w = found.delay_frequency[0, 0]
        assert_allclose(L(1j * w) * np.exp(-1j * w * delay), -1, atol=1e-8)
        assert mfc.delay_roots(L, 0.999 * delay)[0].real < 0 < mfc.delay_roots(L, 1.001 * delay)[0].real
    grid = np.linspace(1e-4, np.pi / L.dt, 20_001) if L.dt else np.geomspace(1e-5, 1e4, 20_001)
    at = np.exp(1j * grid * L.dt) if L.dt else 1j * grid
    Ms, where = found.sensitivity_peak[0, 0], found.peak_frequency[0, 0]
    assert Ms >= np.abs(1 / (1 + L(at))).max() * (1 - 1e-9)
    if Ms > 1 and np.isfinite(where):
        assert_allclose(Ms, abs(1 / (1 + L(np.exp(1j * where * L.dt) if L.dt else 1j * where))), rtol=1e-9)
        assert mfc.disk_margin(L).alpha[0] <= 1 / (Ms - 0.5) + 1e-9


def test_figures_known_from_elsewhere() -> None:
    # the servo: python-control's own tests give gm 2.2716, pm 97.5941 deg, sm 0.5591, wg 10.0053, wp 0.0850 (stability_margins)
    found = mfc.margins(LOOPS["servo with a resonance"])
    numbers = [found.gain_increase, found.phase_deg, 1 / found.sensitivity_peak, found.increase_frequency, found.crossover]
    assert_allclose([x[0, 0] for x in numbers], [2.2716, 97.5941, 0.5591, 10.0053, 0.0850], rtol=1e-3)
    # Seiler, Packard & Gahinet 2020: alpha 0.46 at 1.94 rad/s, gains 0.63 to 1.59
    disk = mfc.disk_margin(LOOPS["third order"])
    assert_allclose([disk.alpha[0], disk.frequency[0], disk.gain_reduction[0], disk.gain_increase[0]], [0.46, 1.94, 0.63, 1.59], atol=0.02)
    # k/s with dead time T: phase 90 deg - k T, gain pi/(2 k T)
    late = mfc.margins(2 / s, delay=0.1)
    assert_allclose([late.phase_deg[0, 0], late.gain_increase[0, 0]], [90 - np.degrees(0.2), np.pi / 0.4], rtol=1e-9)


def test_a_loop_of_two_channels_is_opened_one_at_a_time() -> None:
    P = control.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))  # a spinning body, of the literature on disk margins
    found = mfc.margins(P)
    assert found.channels == tuple(P.output_labels) and found.stable[0]
    alone = control.tf(1 / s)
    assert_allclose(found.phase_deg[0], [float(mfc.margins(alone).phase_deg[0, 0])] * 2, rtol=1e-9)  # each loop alone looks perfect
    assert mfc.disk_margin(P).alpha[0] < 0.25  # both together are not


def test_an_unstable_loop_has_no_margins() -> None:
    found = mfc.margins(0.5 / (s - 1))
    assert not found.stable[0] and np.isnan(found.phase_deg[0, 0])
    assert mfc.delay_roots(0.5 / (s - 1), count=1)[0] == pytest.approx(0.5)


def test_dead_time_of_a_discrete_loop_is_whole_samples() -> None:
    L = control.ss(LOOPS["discrete integrator"])
    late = control.ss(control.tf(L) / z**3)
    assert_allclose(np.sort_complex(mfc.delay_roots(L, 0.3)), np.sort_complex(mfc.delay_roots(late)), atol=1e-6)
    assert_allclose(mfc.margins(L, 0.3).gain_increase, mfc.margins(late).gain_increase, rtol=1e-8)
    with pytest.raises(BadArgument, match="whole sample"):
        mfc.margins(L, 0.15)


@pytest.mark.parametrize("wrong", [s, control.tf([1], [1, 1], True), control.ss([], [], [], np.ones((2, 1))), 3.0, "L", None])
def test_what_is_no_such_loop_is_refused(wrong: object) -> None:
    with pytest.raises(BadArgument, match="L"):
        mfc.margins(wrong)


def test_the_opened_system_has_one_point_and_the_horizon_asked_for() -> None:
    system = in_feedback(1 / (s * (s + 0.5)), horizon=10.0)
    assert system.points == ("loop",) and system.radius == 0.1 and not system.nu
    slow = mfc.margins(1e-4 / (s * (s + 2)), horizon=100.0)
    assert slow.stable[0] and mfc.margins(1e-4 / (s * (s + 2))).stable[0]


@pytest.mark.parametrize("gain", [0.5, -0.5, 0.9, -0.9])
@pytest.mark.parametrize("dt", [0, 0.1], ids=["continuous", "discrete"])
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_gain_is_a_loop_too(gain: float, dt: float, delay: float, capfd: pytest.CaptureFixture[str]) -> None:
    """Its sensitivity is 1/(1 + gain), later at any phase; dead time T makes of it exp(s T) = -gain."""
    L = control.ss([], [], [], [[gain]], dt)
    found = mfc.margins(L, delay=delay)
    lost = 1 / abs(gain) if delay or gain < 0 else np.inf
    peak = max(1.0, 1 / (1 - abs(gain) if delay else 1 + gain))
    assert found.stable.all() and found.gain_reduction[0, 0] == 0
    assert_allclose([found.gain_increase[0, 0], found.sensitivity_peak[0, 0]], [lost, peak], rtol=1e-6)
    assert np.isinf(found.phase_deg).all() and np.isinf(found.delay).all()
    assert_allclose(mfc.disk_margin(L, delay=delay).gain_increase[0] if delay else lost, lost, rtol=1e-6)
    roots = mfc.delay_roots(L, delay=delay, count=5)
    if not delay:
        assert not roots[np.isfinite(roots)].size
    else:
        assert_allclose(roots if dt else np.exp(roots * delay), -gain, rtol=1e-8)
        assert roots.size == (1 if dt else 5)
    assert not capfd.readouterr().err  # LAPACK complains there about matrices without rows


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_gain_above_one_tolerates_no_dead_time(delay: float) -> None:
    found = mfc.margins(control.ss([], [], [], [[2.0]]), delay=delay)
    assert found.stable[0] == (not delay)
    if not delay:
        assert found.delay[0, 0] == 0


@pytest.mark.parametrize("D", [[[-1.0]], [[0.0, 1.0], [1.0, 0.0]]], ids=["one", "two"])
@pytest.mark.parametrize("dt", [0, 0.1], ids=["continuous", "discrete"])
def test_a_loop_without_a_solution_is_refused(D: list[list[float]], dt: float) -> None:
    n = len(D)
    L = control.ss(0.5 * np.eye(n) - np.eye(n) * (not dt), np.eye(n), np.eye(n), D, dt)
    for function in (mfc.margins, mfc.disk_margin, mfc.delay_roots):
        with pytest.raises(BadArgument, match=r"^L: got 'I \+ D singular"):
            function(L)


def test_poles_of_measured_data_are_told_of_nothing_else() -> None:
    with pytest.raises(BadArgument, match="open_loop_unstable: got 1; takes FrequencyResponseData"):
        mfc.margins(3 / (s - 1), open_loop_unstable=1)
    with pytest.raises(BadArgument, match="open_loop_unstable: got -1"):
        mfc.margins(3 / (s - 1), open_loop_unstable=-1)
