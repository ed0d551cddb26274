"""Models handed to python-control: what they contain, and what their names say."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.linearization.exported import closed_model, loop_model
from mfc_analysis.linearization.linearization import Linearization
from mfc_analysis.robots.catalogue import ur5_urdf

pytestmark = pytest.mark.filterwarnings("ignore:the dead time")  # whose absence the names say; the warning has its own test
W = np.array([0.5, 3.0, 20.0, 60.0])


def late() -> Linearization:
    arm = mfc.robots.ur5()
    hold = mfc.trajectories.Hold([0.3, -1.2, 1.5, -0.8, -1.4, 0.2])
    law, hardware = mfc.laws.ComputedTorque(kp=100, kd=20), mfc.Hardware(delay=0.004, torque_lag=0.002)
    return mfc.ClosedLoop(arm.with_payload(2.0), law, hold, controller_model=arm, hardware=hardware).linearize([0.0, 1.0])


@pytest.mark.parametrize("at", ["torque", "command", "position"])
def test_with_pade_the_loop_has_the_response_of_the_loop_with_dead_time(at: str) -> None:
    lin = late()
    exact = lin.frequency_response(W, at)[1]
    for j, channel in enumerate(lin.margins(at).channels):
        model = lin.loop(1, at, channel, pade=8)
        assert_allclose(model(1j * W), exact[j], rtol=1e-7)
        assert not np.allclose(lin.loop(1, at, channel)(1j * W), exact[j], rtol=1e-2)
        assert model.name == f"L_{at}_{channel}" and lin.loop(1, at, channel).name == f"L_{at}_{channel}_without_dead_time"


def test_with_pade_the_closed_loop_has_the_exact_rightmost_roots() -> None:
    lin = late()
    poles = lin.system(0, pade=10).poles()
    for root in lin.delay_roots(6)[0]:
        assert np.abs(poles - root).min() < 1e-5 * abs(root)
    assert lin.system(0, pade=10).name == "closed_loop" and lin.system(0).name == "closed_loop_without_dead_time"


def test_models_are_the_matrices_of_their_point() -> None:
    lin = late()
    one = lin.opened.at(slice(1, 2))
    model = closed_model(one)
    for found, expected in zip((model.A, model.B, model.C, model.D), close_wires(one), strict=True):
        assert_allclose(found, expected[0], atol=1e-12)
    assert model.input_labels == list(lin.input_names) and model.output_labels == list(lin.output_names)
    with pytest.raises(UnknownName, match="channel"):
        loop_model(one, "torque", "elbow")


def test_frequency_response_data_is_that_of_the_loop_with_dead_time() -> None:
    lin = late()
    exact, names = lin.frequency_response(W, "command"), lin.margins("command").channels
    data = lin.frd(W, "command", names[2], index=1)
    assert_allclose(np.asarray(data.frdata)[0, 0], exact[1, 2], rtol=0, atol=0)
    assert_allclose(np.asarray(data.omega), W)
    assert data.name == f"L_command_{names[2]}" and data.input_labels == [f"command_{names[2]}_in"]
    dense = lin.frd(np.geomspace(0.1, 1000, 20_000), "command", names[2], index=1)
    found, margins = mfc.margins(dense), lin.margins("command")
    assert_allclose(found.phase_deg[0, 0], margins.phase_deg[1, 2], rtol=1e-4)
    assert_allclose(found.delay[0, 0], margins.delay[1, 2], rtol=1e-4)
    with pytest.raises(BadArgument, match="frequencies"):
        lin.frd([-1.0])


@pytest.mark.parametrize("kd", [20.0, 1e6, 1e12])
@pytest.mark.parametrize("at", ["torque", "position"])
def test_the_loop_of_one_mass_is_that_of_the_page_for_any_gain(at: str, kd: float) -> None:
    """L = (kp + kd s) / (m s^2 + b s): the feedback of the gain itself is not taken out of the closed loop again."""
    arm = mfc.robots.slider(mass=2.0, friction=0.5)
    lin = mfc.ClosedLoop(arm, mfc.laws.JointPID(kp=160.0, kd=kd), mfc.trajectories.Hold([0.1])).linearize()
    s = 1j * np.geomspace(1e-2, 1e4, 13)
    L = (160 + kd * s) / (2 * s**2 + 0.5 * s)
    assert_allclose(lin.loop(at=at)(s), L, rtol=1e-12)
    assert_allclose(lin.frequency_response(s.imag, at)[0, 0], L, rtol=1e-12)


def test_a_joint_whose_name_has_a_full_stop_is_handed_on_with_an_underscore() -> None:
    arm = mfc.Robot.from_urdf(ur5_urdf().replace("elbow_joint", "elbow.joint"))
    loop = mfc.ClosedLoop(arm, mfc.laws.ComputedTorque(kp=100, kd=20), mfc.trajectories.Hold([0.3, -1.2, 1.5, -0.8, -1.4, 0.2]))
    lin = loop.linearize()
    for model in (lin.system(), lin.loop(0, channel="elbow.joint"), lin.frd([1.0], channel="elbow.joint"), loop.nlsys()):
        assert any("elbow_joint" in label for label in model.input_labels)
