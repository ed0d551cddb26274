"""The second opinion: the same figures where both are right, a checked rule where python-control is known to differ, WATCH where neither holds."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.errors import NotConverged, UnknownName, UnknownPoint
from mfc_analysis.linearization import second_opinion as module
from mfc_analysis.linearization.linearization import Linearization
from mfc_analysis.linearization.second_opinion import Judgement
from tests.conftest import loop_of, named

SLIDER = mfc.robots.slider(mass=1.0)


def slider(kp: float, ki: float, kd: float, **hardware: float) -> Linearization:
    return mfc.ClosedLoop(SLIDER, mfc.laws.JointPID(kp, ki, kd), mfc.trajectories.Hold([0.0]), hardware=mfc.Hardware(**hardware)).linearize()


def test_of_an_unstable_loop_it_gives_margins_that_ours_does_not() -> None:
    """s^3 + s^2 + s + 2.5: its gain margin is 2.5."""
    found = slider(1.0, 2.5, 1.0).second_opinion(0, at="torque")
    gain, stable = found["gain margin"], found["stable"]
    assert (stable.ours, stable.theirs, stable.judgement) == (0.0, 0.0, Judgement.AGREES)
    assert np.isnan(gain.ours) and gain.theirs == pytest.approx(2.5) and gain.why.startswith("no stability flag")
    assert not found.watch


def test_a_gain_margin_below_one_is_the_lower_end_of_the_interval() -> None:
    """A triple pole at -1: 3 k s^2 + 3 k s + k over s^3 is stable above k = 1/9."""
    found = slider(3.0, 1.0, 3.0).second_opinion()
    gain, peak = found["gain margin"], found["sensitivity peak"]
    assert gain.theirs == pytest.approx(1 / 9) and gain.judgement is Judgement.EXPLAINED and "(0.11111, inf)" in gain.why
    assert peak.ours == 1.0 and peak.judgement is Judgement.EXPLAINED  # a supremum that is not attained
    pole = found["rightmost pole"]
    assert pole.judgement is Judgement.AGREES or "multiple pole" in pole.why
    assert not found.watch


def test_each_figure_is_what_python_control_says_of_the_model_that_is_handed_on() -> None:
    lin = slider(30.0, 20.0, 9.0, torque_lag=0.01)
    L = lin.loop(0)
    found = lin.second_opinion(0, "torque", 0)
    gm, pm, sm, *_ = control.stability_margins(L)
    assert found["phase margin"].theirs == pytest.approx(abs(pm)) and found["gain margin"].theirs == pytest.approx(gm)
    assert found["sensitivity peak"].theirs == pytest.approx(1 / sm)
    assert found["least damping"].theirs == pytest.approx(control.damp(lin.system(0), doprint=False)[1].min())
    T = control.feedback(L, 1)
    assert found["overshoot"].theirs == pytest.approx(control.step_info(T)["Overshoot"], rel=1e-2)
    assert found["disk margin"].ours == pytest.approx(mfc.disk_margin(L).alpha[0])
    assert found.model == "L_torque_slide" and found.version == control.__version__ and not found.watch


def test_dead_time_goes_by_frequency_response_data_and_pade() -> None:
    found = slider(30.0, 20.0, 9.0, delay=0.01).second_opinion()
    assert found["phase margin"].function == "stability_margins of FRD" and "Pade" in found["disk margin"].function
    assert found["phase margin"].ours == pytest.approx(found["phase margin"].theirs, rel=1e-3) and not found.watch
    assert found["rightmost pole"].ours == pytest.approx(found["rightmost pole"].theirs, rel=1e-3)
    text = str(found)
    assert "delay" not in text and found.model in text and found._repr_html_().count("<tr>") == len(found.comparisons) + 1


@pytest.mark.parametrize(
    ("name", "robot", "hardware"),
    [
        ("9.2", "planar_2r", {}),
        ("9.8", "planar_2r", {"delay": 2e-3}),
        ("9.10 standard", "ur5", {"sample_time": 2e-3}),
        ("9.16 standard", "ur5", {"sample_time": 2e-3, "delay": 4e-3}),
        ("9.24 dynamic printed", "ur5", {}),
    ],
)
def test_no_loop_of_the_chapter_is_left_unexplained(name: str, robot: str, hardware: dict[str, float]) -> None:
    """Free positions, creep and sampling among them."""
    lin = loop_of(named(name)[0], robot, hardware=mfc.Hardware(**hardware)).linearize([0.3])
    for at in lin.opened.points[:2]:
        assert not lin.second_opinion(0, at).watch


@pytest.mark.parametrize(
    ("metric", "figure"), [("phase_deg", "phase margin"), ("gain_reduction", "gain reduction"), ("sensitivity_peak", "sensitivity")]
)
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_wrong_figure_of_ours_is_watched(metric: str, figure: str, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A figure that is too good, or too bad, has no rule."""
    plain = module.margins
    monkeypatch.setattr(module, "margins", lambda system, at: replace(right := plain(system, at), **{metric: factor * getattr(right, metric)}))
    found = slider(30.0, 20.0, 9.0, torque_lag=0.01).second_opinion()
    assert found[figure] in found.watch and all(one.name.startswith((figure, "gain margin")) for one in found.watch)


@pytest.mark.parametrize("contact", [False, True])
def test_a_gain_at_which_a_slow_root_leaves_first_is_missed(contact: bool) -> None:
    """The real root of 1 + k L passes 1/horizon = 0.01 1/s at our gain; python-control gives the next crossing, at 524 rad/s."""
    loop = loop_of(named("9.21")[0], "planar_2r", contact=contact, hardware=mfc.Hardware(sample_time=2e-3, delay=5e-3))
    lin = loop.linearize([0.0], horizon=100.0)
    found = lin.second_opinion(0, "torque", 0)
    gain, L = found["gain increase"], lin.loop(0)

    def rightmost(k: float) -> float:
        return float(np.log(np.abs(np.linalg.eigvals(L.A - k * L.B @ L.C))).max() / 2e-3)

    assert rightmost(gain.ours * (1 - 1e-5)) < 0.01 < rightmost(gain.ours * (1 + 1e-5)) < rightmost(2.0)
    assert gain.theirs > 1e4 and "end of the axis at 0 rad/s" in gain.why and not found.watch


def test_a_gain_at_which_a_root_leaves_at_half_the_sample_rate_is_missed() -> None:
    """L = kp T / (z - 1): its root 1 - k kp T comes to -1 at k = 2 / (kp T)."""
    loop = mfc.ClosedLoop(SLIDER, mfc.laws.VelocityP(10.0), mfc.trajectories.Hold([0.0]), hardware=mfc.Hardware(sample_time=0.01))
    found = loop.linearize().second_opinion()
    gain = found["gain increase"]
    assert gain.ours == pytest.approx(20.0) and gain.theirs > 1e3
    assert gain.judgement is Judgement.EXPLAINED and "end of the axis at 314.16 rad/s" in gain.why and not found.watch


def test_what_is_not_there_is_refused() -> None:
    lin = slider(30.0, 20.0, 9.0)
    with pytest.raises(UnknownPoint):
        lin.second_opinion(0, at="force")
    with pytest.raises(UnknownName):
        lin.second_opinion(0, channel="elbow")
    with pytest.raises(KeyError):
        _ = lin.second_opinion()["torque"]


def test_a_step_that_takes_too_long_to_settle_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise NotConverged("step", "not settled")

    monkeypatch.setattr(module, "step", never)
    found = slider(30.0, 20.0, 9.0, delay=1e-3).second_opinion(0)
    assert found["phase margin"].judgement is not Judgement.WATCH
    assert not any("of T" in one.name and "time" in one.name for one in found.comparisons)
