"""Measured frequency responses, of sampled loops whose response is known: bias, coherence, leakage, and what is refused."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

import mfc_analysis as mfc
from mfc_analysis.analysis.frf import FrequencyResponse
from mfc_analysis.errors import BadArgument

DT = 2e-3
T = np.arange(20_000) * DT
L = control.tf(control.sample_system(control.tf([1200.0], [1.0, 28.0, 0.0]), DT))  # crossover 33 rad/s


def truth(w: np.ndarray) -> np.ndarray:
    return np.asarray(L(np.exp(1j * w * DT)))


def closed(r: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u = r - y and y = L u + noise: the noise comes back through the feedback."""
    num, den = (np.asarray(x[0][0], float) for x in (L.num, L.den))
    num = np.pad(num, (den.size - num.size, 0))
    y = np.asarray(signal.lfilter(num, den + num, r) + signal.lfilter(den, den + num, noise))
    return r - y, y


def coloured(seed: int, size: float = 1.0) -> np.ndarray:
    """Noise up to 30 Hz."""
    return np.asarray(size * signal.lfilter(*signal.butter(2, 30 * 2 * DT), np.random.default_rng(seed).standard_normal(T.size)))


def error(found: FrequencyResponse, low: float, high: float) -> float:
    """Root mean square of the relative error between two frequencies [rad/s]."""
    some = (found.frequencies >= low) & (found.frequencies <= high)
    off = np.abs(found.response[some] / truth(found.frequencies[some]) - 1)
    return float(np.sqrt((off**2).mean()))


def test_in_open_loop_it_is_scipys_estimate_and_coherence() -> None:
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, 4000))
    y = signal.lfilter([0.2], [1, -0.8], u) + 0.3 * y
    found = mfc.frf.estimate(T[:4000], u, y, averages=8, cycles=1e6)  # segments as long as the averages allow, at all frequencies
    f, pxy = signal.csd(u, y, 1 / DT, nperseg=2 * 4000 // 9)
    _, pxx = signal.welch(u, 1 / DT, nperseg=2 * 4000 // 9)
    _, c = signal.coherence(u, y, 1 / DT, nperseg=2 * 4000 // 9)
    some = slice(3, 3 + found.frequencies.size)
    assert_allclose(found.frequencies, 2 * np.pi * f[some], rtol=1e-12)  # [rad/s]
    assert_allclose(found.response, (pxy / pxx)[some], rtol=1e-9)
    assert_allclose(found.coherence, c[some], rtol=1e-9)


def test_noise_in_the_loop_biases_u_and_y_alone_and_not_the_estimate_with_an_excitation() -> None:
    r = 2 * np.sin(5.0 * T) + coloured(1, 0.02)
    u, y = closed(r, coloured(2, 0.5))  # above 5 rad/s the noise is larger than the excitation
    direct, indirect = mfc.frf.estimate(T, u, y), mfc.frf.estimate(T, u, y, r)
    some = (direct.frequencies > 8) & (direct.frequencies < 60)
    assert direct.coherence[some].min() > 0.9  # nothing warns: u = r - y is y
    assert np.median(np.abs(direct.response[some] + 1)) < 0.05  # the critical point, whatever the loop
    assert np.median(indirect.coherence[some]) < 0.3 and indirect.coherence[some].max() < 0.8  # this one says that nothing was measured
    assert "nowhere" not in str(direct) and "excitation r" in str(indirect)


def test_the_coherence_falls_where_there_is_no_excitation() -> None:
    sweep = 3 * signal.chirp(T, 0.5, 38, 12, method="logarithmic")
    found = mfc.frf.estimate(T, *closed(sweep, 0.05 * np.random.default_rng(3).standard_normal(T.size)), sweep)
    hz = found.frequencies / 2 / np.pi
    assert found.coherence[(hz > 1) & (hz < 9)].min() > 0.95
    assert found.coherence[hz > 30].max() < 0.5
    assert error(found, 10.0, 60.0) < 0.02


def test_the_standard_deviation_is_that_of_repeated_records() -> None:
    """Of 10 records of a loop with an excitation: over 20 to 60 rad/s no bias, and the scatter of |G| and of its phase is the median deviation."""
    scatter, said = [], []
    for seed in range(10):
        found = mfc.frf.estimate(T, *closed(r := coloured(100 + seed, 3.0), coloured(200 + seed, 0.6)), r)
        some = (found.frequencies > 20) & (found.frequencies < 60)
        scatter.append(np.log(found.response[some] / truth(found.frequencies[some])))
        said.append(found.deviation[some])
    wanted = float(np.median(said))
    assert abs(np.mean(scatter)) < 0.2 * wanted
    assert np.std(np.real(scatter)) == pytest.approx(wanted, rel=0.15)
    assert np.std(np.imag(scatter)) == pytest.approx(wanted, rel=0.15)


def test_whole_periods_of_a_multisine_do_not_leak() -> None:
    lines = np.array([1, 2, 3, 5, 8, 13, 21, 34, 55, 89])
    r = np.cos(2 * np.pi * np.outer(T, lines) / 4.0 + np.arange(10) ** 2).sum(axis=1)
    u, y = closed(r, np.zeros(T.size))
    late = T >= 8.0  # settled
    found = mfc.frf.estimate(T[late], u[late], y[late], r[late], period=4.0)
    assert_allclose(found.frequencies, 2 * np.pi * lines / 4.0, rtol=1e-12)
    assert_allclose(found.response, truth(found.frequencies), rtol=1e-6)
    assert_allclose(found.coherence, 1.0, atol=1e-9)
    windowed = mfc.frf.estimate(T[late], u[late], y[late], r[late])
    assert error(found, 1.0, 200.0) < 1e-3 * error(windowed, 1.0, 200.0)


def test_python_control_takes_the_response() -> None:
    found = mfc.frf.estimate(T, *closed(r := coloured(1, 3.0), coloured(2, 0.01)), r)
    frd = found.frd
    assert isinstance(frd, control.FrequencyResponseData)
    assert_allclose(frd.frdata[0, 0], found.response)
    assert_allclose(frd.omega, found.frequencies)
    assert np.isclose(found.gain_db[5], 20 * np.log10(abs(found.response[5])))
    some = found.where(found.frequencies < 50.0)
    assert some.frequencies.max() < 50.0 and some.response.size == some.coherence.size == some.phase_deg.size
    assert "rad/s" in str(found) and "<table>" in found._repr_html_() and len(found.rows(7)) == 7


def test_a_time_that_is_not_uniform_is_named_with_its_index() -> None:
    u, y = closed(r := coloured(1), coloured(2))
    late = T.copy()
    late[417:] += 0.6 * DT  # a gap
    with pytest.raises(BadArgument, match=r"t\[417\]: got .*0\.0032 s after .*not 0\.002 s"):
        mfc.frf.estimate(late, u, y, r)
    with pytest.raises(BadArgument, match=r"t\[9000\]"):
        mfc.frf.estimate(np.delete(T, 9000), u[1:], y[1:])
    with pytest.raises(BadArgument, match=r"t: got .steps of"):
        mfc.frf.estimate(T[::-1], u, y)
    rounded = np.round(T, 4)  # a log with 4 decimals at 500 Hz is uniform
    assert mfc.frf.estimate(rounded, u, y).frequencies.size == mfc.frf.estimate(T, u, y).frequencies.size


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"u": np.ones(T.size)}, "u: got .1 at all times"),
        ({"y": np.ones(7)}, r"y: got shape \(7,\)"),
        ({"u": np.full(T.size, np.nan)}, "u: got"),
        ({"window": "no such"}, "window"),
        ({"averages": 1}, "averages: got 1"),
        ({"averages": 9000}, "t: got .20000 samples"),
        ({"period": 0.0123}, "period: got .6.15 samples"),
        ({"period": 30.0}, "period"),
        ({"cycles": 0.5}, "cycles"),
    ],
)
def test_bad_input_is_named(change: dict, said: str) -> None:
    given = {"u": np.sin(T), "y": np.cos(3 * T)} | change
    with pytest.raises(BadArgument, match=said):
        mfc.frf.estimate(T, given.pop("u"), given.pop("y"), **given)


def test_a_period_that_the_excitation_does_not_have_is_refused() -> None:
    half = coloured(5)[:500]
    u = np.concatenate([half, -half, half, -half])
    with pytest.raises(BadArgument, match="no line of this one repeats"):
        mfc.frf.estimate(T[:2000], u, u + coloured(6)[:2000], period=500 * DT)
