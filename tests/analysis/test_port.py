"""The admittance of a port: closed forms with dead time and sampling, and the component at the same frequency in a simulation."""

from __future__ import annotations

import pickle
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.port import Port
from mfc_analysis.errors import BadArgument, UnknownName

M, KP, KD = 2.0, 300.0, 20.0
W = np.array([1e-2, 1.0, 10.0, 100.0, 1e4])
S = 1j * W
HOLD = mfc.trajectories.Hold([0.0])


def on_slider(law: mfc.laws.Law, friction: float = 0.0, environment: mfc.Environment | None = None, **hardware: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(mfc.robots.slider(M, friction), law, HOLD, environment=environment, hardware=mfc.Hardware(**hardware))


@pytest.mark.parametrize(
    ("hardware", "path"),
    [({}, np.ones(5)), ({"delay": 3e-3}, np.exp(-3e-3 * S)), ({"torque_lag": 4e-3}, 1 / (1 + 4e-3 * S))],
    ids=["ideal", "delay", "lag"],
)
@pytest.mark.parametrize("law", [mfc.laws.JointPID(KP, None, KD), mfc.laws.ComputedTorque(KP / M, None, KD / M)], ids=["9.8", "9.10"])
def test_one_mass_under_pd_moves_as_by_hand(law: mfc.laws.Law, hardware: dict[str, float], path: np.ndarray) -> None:
    found = on_slider(law, **hardware).linearize().port(W).admittance[0]
    assert_allclose(found[:, 2, 2], S / (M * S**2 + (KD * S + KP) * path), rtol=1e-10)
    found[:, 2, 2] = 0
    assert not found.any()  # it slides along z only


def test_the_sensor_sees_the_push_with_the_other_sign() -> None:
    """m s v = tau - (k/s + c) v + f and tau = -e^{-sT}(kfp + kfi/s) e^{-sT_f} ((k/s + c) v - f) - e^{-sT} kdamp v."""
    kfp, kfi, kdamp, k, c, T, T_f = 0.5, 3.0, 6.0, 1e3, 10.0, 1e-3, 2e-3
    law, wall = mfc.laws.DampedForcePI([0, 0, 5.0, 0, 0, 0], kfp, kfi, kdamp), mfc.Environment(k, c, axes="z", preload=5.0)
    found = on_slider(law, environment=wall, delay=T, force_delay=T_f).linearize().port(W).admittance[0, :, 2, 2]
    late = np.exp(-S * T)
    sensed = late * np.exp(-S * T_f) * (kfp + kfi / S)
    assert_allclose(found, (1 + sensed) / (M * S + (k / S + c) * (1 + sensed) + late * kdamp), rtol=1e-9)


def test_an_admittance_is_the_one_asked_for_behind_the_drives() -> None:
    """M_d w' = f - D w - K x and x' = w behind a lag T: Y = s/((M_d s^2 + D s)(1 + T s) + K); the push is measured with the other sign."""
    m, D, K, T = 3.0, 40.0, 200.0, 5e-3
    law = mfc.laws.Admittance(np.zeros(6), m, D, K, axes="z")
    loop = mfc.ClosedLoop(mfc.robots.slider(M), law, HOLD, q_start=[0.0], hardware=mfc.Hardware(velocity_lag=T))
    found = loop.linearize().port(W).admittance[0, :, 2, 2]
    assert_allclose(found, S / ((m * S**2 + D * S) * (1 + T * S) + K), rtol=1e-9)


def test_an_impedance_shows_the_spring_and_the_damper_asked_for() -> None:
    K, D = 200.0, 40.0
    found = on_slider(mfc.laws.Impedance(K, D, axes="z")).linearize().port(W).admittance[0, :, 2, 2]
    assert_allclose(found, S / (M * S**2 + D * S + K), rtol=1e-9)


def test_a_sampled_spring_is_as_by_hand_and_takes_away_half_a_sample_of_damping() -> None:
    """One mass with friction b under tau = -K x, sampled: the pulse transfer function of 1/(s (m s + b)) is that of the tables."""
    K, b, T = 400.0, 3.0, 1e-2
    s = 1j * np.array([1.0, 10.0, 100.0, 250.0, 400.0, 3000.0])
    found = on_slider(mfc.laws.JointPID(K), b, sample_time=T).linearize().port(s.imag).admittance[0, :, 2, 2]
    a, z = b / M, np.exp(s * T)
    e = np.exp(-a * T)
    pulse = ((a * T - 1 + e) * z + (1 - e - a * T * e)) / (M * a * a * (z - 1) * (z - e))
    G, hold = 1 / (M * s + b), (1 - np.exp(-s * T)) / (s * T)
    assert_allclose(found, G - G * hold * K / (1 + K * pulse) * G / s, rtol=1e-8)
    low = on_slider(mfc.laws.JointPID(K), b, sample_time=T).linearize().port([1e-2]).admittance[0, 0, 2, 2]
    assert_allclose((1 / low).real, b - K * T / 2, rtol=1e-3)


@pytest.mark.parametrize("law", [mfc.laws.JointPID(400.0, 300.0, 30.0), mfc.laws.JointPID(400.0, None, 30.0)], ids=["PID", "PD"])
@pytest.mark.parametrize("late", [{}, {"delay": 6e-3}, {"torque_lag": 8e-3, "velocity_filter": 4e-3}], ids=["", "delay", "lag"])
def test_a_sampled_loop_pushed_at_one_frequency_moves_so_at_that_frequency(law: mfc.laws.JointPID, late: dict[str, float]) -> None:
    T, w = 1e-2, 2 * np.pi / 0.16  # sixteen samples are a period
    loop = on_slider(law, 3.0, sample_time=T, **late)
    assert loop.linearize().stable.all()
    t = np.linspace(8.0, 8.0 + 0.16, 1601)
    run = loop.simulate(np.concatenate([[0.0], t]), disturbance=lambda t: [np.cos(w * t)], rtol=1e-9, atol=1e-12, max_evaluations=10**6)
    v = run.v[1:, 0] * np.exp(-1j * w * t)
    assert_allclose(2 * np.trapezoid(v, t) / 0.16, loop.linearize().port([w]).admittance[0, 0, 2, 2], rtol=2e-4)


@pytest.fixture
def port() -> Port:
    return on_slider(mfc.laws.JointPID(KP, None, KD)).linearize([0.0, 1.0]).port(W)


def test_a_port_says_what_it_is_and_shows_itself(port: Port) -> None:
    assert str(port) == "admittance at the tool: 6 x 6, 5 frequencies from 0.01 to 1e+04 rad/s, 2 times"
    page = port._repr_html_()
    ElementTree.fromstring(f"<div>{page}</div>")
    assert "<td>300</td>" in page and "<td>2</td>" in page  # the stiffness and the mass that it shows
    assert np.array_equal(np.asarray(port), port.admittance)
    assert str(pickle.loads(pickle.dumps(port))) == str(port)
    assert "sampled every 0.01 s" in str(on_slider(mfc.laws.JointPID(KP, None, KD), sample_time=1e-2).linearize().port([1.0]))
    assert "no frequency" in str(on_slider(mfc.laws.JointPID(KP)).linearize().port([]))


def test_a_port_draws_what_moves_and_refuses_what_is_not_there(port: Port) -> None:
    ax = port.plot(-1)
    assert len(ax.get_lines()) == 1
    assert_allclose(ax.get_lines()[0].get_ydata(), np.abs(port.admittance[1, :, 2, 2]))
    assert len(port.plot(channels=["fx", 2]).get_lines()) == 2
    with pytest.raises(UnknownName, match="channel"):
        port.plot(channels=["fw"])
    with pytest.raises(BadArgument, match="index"):
        port.plot(2)


def test_a_pole_of_the_loop_is_no_frequency() -> None:
    with pytest.raises(BadArgument, match="not poles of the loop"):
        on_slider(mfc.laws.JointPID(2.0)).linearize().port([1.0])  # 2 x'' + 2 x = 0
