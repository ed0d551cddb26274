"""A measured loop over the model's: the same loop agrees, and what was changed is found, with its size and its band."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.comparison import Comparison
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.linearization import Linearization

Q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0])
ELBOW = 2
ARM = mfc.robots.ur5()
LAW = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(10)))
W = np.geomspace(3.0, 600.0, 400)


def loop(robot: mfc.Robot = ARM, **hardware: float) -> mfc.ClosedLoop:
    lags = {"torque_lag": 3e-3, "velocity_filter": 3e-3} | hardware
    return mfc.ClosedLoop(robot, LAW, mfc.trajectories.Hold(Q), controller_model=ARM, hardware=mfc.Hardware(**lags))


@pytest.fixture(scope="module")
def model() -> Linearization:
    return loop().linearize()


def over(model: Linearization, measured: Linearization, w: np.ndarray = W) -> Comparison:
    """The exact response of one loop over the other's."""
    return model.compare(measured.frd(w, channel=ELBOW), channel=ELBOW)


def test_a_noisy_sweep_of_the_elbow_has_the_margins_of_the_model(model: Linearization) -> None:
    """Six sweeps of 8 Nm from 0.5 to 60 Hz in the nonlinear simulation, noise of 0.03 Nm on both torques; the first sweep is left out."""
    t, length = np.arange(0.0, 36.0, 2e-3), 6.0
    low, high = mfc.hertz(0.5), mfc.hertz(60)
    k = np.log(high / low) / length

    def excitation(t: float) -> np.ndarray:
        return np.eye(6)[ELBOW] * 8.0 * np.sin(low / k * (np.exp(k * (t % length)) - 1))

    run = loop().simulate(t, 0.0, excitation, integral="trimmed", max_evaluations=10**7, rtol=1e-5)
    r = np.array([excitation(x)[ELBOW] for x in t])
    noise = 0.03 * np.random.default_rng(0).standard_normal((2, t.size))
    u, y = run.tau[:, ELBOW] + r + noise[0], -run.tau[:, ELBOW] + noise[1]
    late = t >= length
    welch, whole = (mfc.frf.estimate(t[late], u[late], y[late], r[late], period=p) for p in (None, length))
    hz = welch.frequencies / 2 / np.pi
    assert welch.coherence[(hz > 1.5) & (hz < 50)].min() > 0.9 and welch.coherence[hz > 80].max() < 0.3
    exact = model.margins().channel(ELBOW)
    for found in (model.compare(welch, channel="elbow_joint"), model.compare(whole, channel=ELBOW)):
        assert found.verdict.startswith("the model agrees with the data") and found.channel == "elbow_joint"
        assert_allclose(found.margins.phase_deg, exact.phase_deg, atol=1.0)
        assert_allclose(found.margins.gain_increase_db, exact.gain_increase_db, atol=0.3)
        assert_allclose(found.margins.gain_reduction_db, exact.gain_reduction_db, atol=0.3)
        assert_allclose(found.margins.sensitivity_peak, exact.sensitivity_peak, rtol=0.02)


def test_the_exact_response_agrees_with_itself(model: Linearization) -> None:
    found = over(model, model)
    assert_allclose(found.gain_db, 0.0, atol=1e-9)
    assert_allclose(found.phase_deg, 0.0, atol=1e-9)
    assert found.findings == () and "agrees with the data" in found.verdict and np.isnan(found.missing_delay)
    assert_allclose(found.margins.phase_deg, found.model_margins.phase_deg, atol=0.01)


def test_a_dead_time_that_the_model_lacks_is_found_with_its_size(model: Linearization) -> None:
    found = over(model, loop(delay=2e-3).linearize())
    assert found.missing_delay == pytest.approx(2e-3, rel=1e-2)  # the other joints are late as well
    assert_allclose(found.phase_deg, -np.degrees(2e-3 * W), atol=0.1)  # beyond half a turn as well
    first = found.findings[0]
    edge = np.radians(3.0) / 2e-3 / 2 / np.pi  # [Hz] 3 deg of 2 ms
    assert first.startswith("the model is optimistic by") and f"above {edge:.2g} Hz" in first and "its phase is too high" in first
    assert "2 ms of dead time missing" in found.verdict
    lost = float(found.margins.phase_deg[0, 0] - found.model_margins.phase_deg[0, 0])
    assert lost == pytest.approx(-np.degrees(2e-3 * float(found.model_margins.crossover[0, 0])), abs=0.3)
    back = over(loop(delay=2e-3).linearize(), model)
    assert "pessimistic" in back.findings[0] and "2 ms of dead time too much" in back.verdict


def test_a_gain_that_is_off_everywhere_is_said_to_be(model: Linearization) -> None:
    frd = model.frd(W, channel=ELBOW)
    found = model.compare(2.0 * frd, channel=ELBOW)
    assert_allclose(found.gain_db, 20 * np.log10(2.0), atol=1e-9)
    assert len(found.findings) == 1 and "by 6 dB from" in found.findings[0] and "its gain is too low" in found.findings[0]
    assert_allclose(found.margins.gain_increase, found.model_margins.gain_increase / 2, rtol=2e-3)


def test_a_measured_loop_that_is_unstable_has_no_margins(model: Linearization) -> None:
    frd = model.frd(W, channel=ELBOW)
    factor = 1.2 * float(model.margins().gain_increase[0, ELBOW])
    assert not model.compare(factor * frd, channel=ELBOW).margins.stable[0]
    assert "the measured loop is unstable" in str(model.compare(factor * frd, channel=ELBOW))
    below = 0.8 * float(model.margins().gain_increase[0, ELBOW])
    assert model.compare(below * frd, channel=ELBOW).margins.stable[0]
    slow = 0.8 * float(model.margins().gain_reduction[0, ELBOW])
    assert not model.compare(slow * frd, channel=ELBOW).margins.stable[0]


def test_beyond_the_data_no_margin_is_read(model: Linearization) -> None:
    found = over(model, model, np.geomspace(20.0, 150.0, 100))  # both gain margins lie outside
    assert np.isinf(found.margins.gain_increase[0, 0]) and found.margins.gain_reduction[0, 0] == 0
    assert str(found).count("not in the data") == 2 and found.margins.stable[0]


def test_what_is_not_known_well_enough_takes_no_part(model: Linearization) -> None:
    exact = model.frd(W, channel=ELBOW).frdata[0, 0]
    lost = (W > 200) | (np.abs(W - 50) < 1)
    coherence = np.where(lost, 0.1, 0.999)
    wrong = mfc.analysis.FrequencyResponse(W, np.where(lost, 30.0 * exact, exact), coherence, np.full(W.size, 20.0), "test")
    found = model.compare(wrong, channel=ELBOW)
    assert not found.trusted[lost].any() and found.findings == () and "agrees" in found.verdict
    assert_allclose(found.margins.phase_deg, found.model_margins.phase_deg, atol=0.3)


def test_one_coherent_frequency_among_many_that_are_not_is_chance(model: Linearization) -> None:
    exact = model.frd(W, channel=ELBOW).frdata[0, 0]
    coherence = np.where(W < 200, 0.999, 0.1)
    coherence[380] = 0.999
    found = model.compare(mfc.analysis.FrequencyResponse(W, exact, coherence, np.full(W.size, 4.0), "test"), channel=ELBOW)
    assert not found.trusted[380] and found.trusted[100]


def test_where_it_is_noisy_the_average_over_neighbours_is_nearer_and_where_it_is_not_it_stays(model: Linearization) -> None:
    exact = model.frd(W, channel=ELBOW).frdata[0, 0]
    rng, off = np.random.default_rng(4), 0.05
    noisy = exact * np.exp(off * (rng.standard_normal(W.size) + 1j * rng.standard_normal(W.size)))
    for size, gain in ((off, np.sqrt(17)), (1e-3, 1.0)):  # 17 neighbours within a sixth of an octave
        K = 1000.0
        coherence = np.full(W.size, 1 / (1 + 2 * K * size**2))
        found = model.compare(mfc.analysis.FrequencyResponse(W, noisy, coherence, np.full(W.size, K), "test"), channel=ELBOW)
        assert_allclose(found.deviation, size * K / (K - 1), rtol=1e-9)
        was, now = (np.sqrt((np.abs(x / exact - 1) ** 2).mean()) for x in (found.measured, found.averaged))
        assert was / now == pytest.approx(gain, rel=0.1)


def test_what_cannot_be_compared_is_refused(model: Linearization) -> None:
    with pytest.raises(BadArgument, match="frd: got"):
        model.compare("data.csv")
    with pytest.raises(BadArgument, match=r"frd: got .2 x 2"):
        model.compare(control.frd(np.ones((2, 2, 5)), np.arange(1.0, 6.0)))
    with pytest.raises(UnknownName, match="elbow_joint"):
        model.compare(model.frd(W), channel="elbow")
    sampled = loop(sample_time=5e-3).linearize()
    found = sampled.compare(control.frd(model.frd(W).frdata, W))
    assert found.frequencies[-1] < np.pi / 5e-3
    with pytest.raises(BadArgument, match="Nyquist"):
        sampled.compare(model.frd(np.array([700.0, 800.0, 900.0])))


def test_it_is_shown_as_text_and_as_a_table(model: Linearization) -> None:
    found = over(model, loop(delay=2e-3).linearize())
    assert "phase margin" in str(found) and "difference" in str(found) and found.verdict in str(found)
    assert "<table>" in found._repr_html_() and found.rows()[0][0] == "phase margin"
