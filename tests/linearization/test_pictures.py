"""Pictures of a linearised loop and of results: drawn from the same numbers, registered with pyplot, in axes of one's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, UnknownName, UnknownPoint
from mfc_analysis.linearization.coupling import coupling
from mfc_analysis.plots import figure as sheet
from tests.plots.drawn import legend, levels, lines, marks, words
from tests.plots.overlaps import drawn_texts, texts_on_texts

ARM = mfc.robots.planar_2r()
PATH = mfc.trajectories.Sinusoid([0.3, 0.8], 0.4, 3.0)
LAW = mfc.laws.ComputedTorque(100.0, 50.0, 20.0)


def made(**hardware: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(ARM.with_payload(1.0), LAW, PATH, controller_model=ARM, hardware=mfc.Hardware(**hardware))


LOOP, LATE = made(), made(delay=0.01)
LIN, LATE_LIN = LOOP.linearize(np.linspace(0, 1, 6)), LATE.linearize([0.0, 0.5])


def pressing(kfi: float) -> mfc.ClosedLoop:
    law = mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], 0.5, kfi, [40.0] * 6)
    wall = mfc.Environment(stiffness=1e4, damping=10.0, axes="z", preload=5.0)
    return mfc.ClosedLoop(mfc.robots.slider(1.0), law, mfc.trajectories.Hold([0.0]), environment=wall, hardware=mfc.Hardware(torque_lag=5e-3))


def touching() -> mfc.ClosedLoop:
    wall = mfc.Environment(stiffness=1e4, damping=10.0, axes="z", one_sided=True)
    return mfc.ClosedLoop(mfc.robots.slider(1.0), mfc.laws.OpenLoopForce([0, 0, 5, 0, 0, 0]), mfc.trajectories.Hold([0.0]), environment=wall)


#: what has a picture -> a function of ax
PICTURES: dict[str, Callable[..., Axes]] = {
    "bode": LIN.plot_bode,
    "bode with dead time": LATE_LIN.plot_bode,
    "nyquist": LIN.plot_nyquist,
    "poles": LIN.plot_poles,
    "roots": LATE_LIN.plot_poles,
    "sampled poles": made(sample_time=0.01).linearize().plot_poles,
    "margins": LIN.margins().plot,
    "margins at one time": LATE_LIN.again(np.array([0.5])).margins().plot,
    "disk margin": LIN.disk_margin().plot,
    "port": LIN.port(np.geomspace(0.1, 1e3, 21)).plot,
    "passivity": LIN.passivity().plot,
    "step": LIN.step().plot,
    "steps": LIN.steps(np.linspace(0, 1, 11)).plot,
    "simulation": LOOP.simulate(0.5, 0.1).plot,
    "validation": LOOP.validate(0.1).plot,
    "floquet": LOOP.floquet().plot,
    "growth": LIN.transient_growth().plot,
    "coupling": coupling(LIN, (LIN.input_names[0],), (LIN.output_names[1],), [1.0, 10.0, 100.0]).plot,
    "stiffness": mfc.design.over_stiffness(pressing(20.0), np.geomspace(1e2, 1e5, 11)).plot,
    "impact": mfc.design.impact(touching(), [0.05, 0.1], [1e3, 1e4], duration=0.05).plot,
    "impact of one run": mfc.design.impact(touching(), [0.05], duration=0.05).plot,
    "stiffness map": mfc.design.stiffness_map(pressing, np.geomspace(1e2, 1e5, 11), [5.0, 20.0, 80.0]).plot,
    "delay map": mfc.design.delay_map(lambda k: made(), [1e-3, 5e-3, 2e-2], [1.0, 2.0]).plot,
}


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """No figure of pyplot is left over."""
    plt.close("all")
    yield
    plt.close("all")


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_a_new_figure_of_pyplot_or_in_the_axes_given(name: str) -> None:
    ax = PICTURES[name]()
    assert isinstance(ax, Axes) and [plt.figure(k) for k in plt.get_fignums()] == [ax.figure]
    assert ax.get_ylabel() and ax.figure.axes[-1].get_xlabel()
    ax.figure.canvas.draw()
    figure, (left, right) = plt.subplots(1, 2)
    assert PICTURES[name](ax=right) is right and right.has_data() and not left.has_data() and right.figure is figure
    assert len(plt.get_fignums()) == 2


def test_a_bode_plot_shows_l_with_its_dead_time_and_its_margins() -> None:
    at, found = "torque", LATE_LIN.margins("torque")
    k = int(found.phase_deg[1].argmin())
    upper = LATE_LIN.plot_bode(1, at=at)
    (w, gain), lower = lines(upper, color=sheet.colour(k))[0].T, upper.figure.axes[1]
    L = LATE_LIN.frequency_response(w, at)[1, k]
    assert_allclose(gain, 20 * np.log10(np.abs(L)), atol=1e-9)
    assert_allclose(np.exp(1j * np.radians(lines(lower, color=sheet.colour(k))[0][:, 1])), L / np.abs(L), atol=1e-9)
    assert f"PM {found.phase_deg[1, k]:.3g}°" in words(lower)
    assert upper.get_title(loc="left") == f"L at torque, {found.channels[k]}, t = 0.5 s"


def test_a_bode_plot_takes_two_axes_and_divides_one() -> None:
    _, (upper, lower) = plt.subplots(2)
    assert LIN.plot_bode(0, channel="joint2", ax=(upper, lower)) is upper and lower.has_data()
    figure = plt.figure()
    whole = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    LIN.plot_bode(0, channel=1, ax=whole)
    above, below = (ax.get_position() for ax in figure.axes)
    assert above.y0 > below.y1 and (above.x0, above.width) == (below.x0, below.width)


def test_a_nyquist_plot_stays_outside_the_disk_of_its_sensitivity_peak() -> None:
    ax, peak = LATE_LIN.plot_nyquist(0, channel=1), LATE_LIN.margins().sensitivity_peak[0, 1]
    curve = lines(ax, color=sheet.colour(1))[0]
    assert np.nanmin(np.hypot(curve[:, 0] + 1, curve[:, 1])) == pytest.approx(1 / peak, rel=1e-3)
    assert f"circle: 1/Ms = {1 / peak:.3g}" in words(ax)


def test_a_nyquist_plot_of_a_joint_with_a_long_name_has_room_for_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    law, pose = mfc.laws.VelocityP([7.0, 8.0, 7.0, 7.0, 7.0, 7.0]), mfc.trajectories.Hold(np.zeros(6))
    lin = mfc.ClosedLoop(mfc.robots.ur5(), law, pose, hardware=mfc.Hardware(delay=0.05)).linearize([0.125])
    ax = lin.plot_nyquist()
    assert (ax.get_title(loc="left"), ax.get_xlabel()) == ("shoulder_lift_joint, t = 0.125 s", "Re L at velocity")
    figure = sheet.figure_of(ax)
    assert texts_on_texts(figure, monkeypatch) == []
    boxes = [box for _, box, _ in drawn_texts(figure, monkeypatch)]
    assert max(box.x1 for box in boxes) <= figure.bbox.x1


def test_a_pole_plot_of_a_loop_with_dead_time_shows_its_roots_and_says_what_is_grey() -> None:
    ax = LATE_LIN.plot_poles(1, damping=0.4)
    drawn = np.concatenate(marks(ax, "x"))
    roots = LATE_LIN.delay_roots(LATE_LIN.A.shape[-1])[1]
    assert_allclose(np.sort_complex(drawn @ [1, 1j]), np.sort_complex(roots), rtol=1e-9)
    assert_allclose(np.sort_complex(marks(ax, ".")[0] @ [1, 1j]), np.sort_complex(LATE_LIN.poles()[1]), rtol=1e-9)
    assert "grey: poles without dead time" in words(ax)


def test_results_draw_their_own_numbers() -> None:
    m = LIN.margins()
    ax = m.plot("delay", asked=2e-3)
    assert levels(ax) == [2.0] and legend(ax) == list(m.channels)
    assert_allclose(lines(ax, color=sheet.colour(1))[0], np.column_stack([m.times, 1e3 * m.delay[:, 1]]))
    run = LOOP.simulate(0.5, 0.1)
    ax = run.plot("tau")
    assert_allclose(lines(ax, color=sheet.colour(0))[0], np.column_stack([run.t, run.tau[:, 0]]))
    assert legend(ax) == list(ARM.joint_names)
    step = LIN.step(0, "q_d_joint1", "q_joint1")
    assert_allclose(lines(step.plot(), color=sheet.colour(0))[0], np.column_stack([step.t, step.y]))
    every = LIN.steps(step.t)
    ax = every.plot("q_joint2", "disturbance_joint2")
    worst = int(every.settling[:, LIN.output_names.index("q_joint2"), LIN.input_names.index("disturbance_joint2")].argmax())
    assert legend(ax) == [f"t = {LIN.times[worst]:g} s"]
    check = LOOP.validate(0.1)
    assert_allclose(np.array(lines(check.plot(), style="--")[:2])[:, :, 1], check.linear.T)


def test_a_signal_of_a_tool_law_has_the_names_of_its_axes() -> None:
    arm = mfc.robots.ur5()
    q = np.array([0.3, -1.2, 1.5, -0.8, -1.4, 0.2])
    run = mfc.ClosedLoop(arm, mfc.laws.TaskComputedTorque(100.0, kd=20.0), mfc.trajectories.Hold(q)).simulate(0.05, 0.01)
    assert legend(run.plot()) == ["vx", "vy", "vz", "wx", "wy", "wz"]
    assert legend(run.plot("force")) == ["fx", "fy", "fz", "mx", "my", "mz"]


def test_an_unstable_loop_has_pictures_that_say_so() -> None:
    bad = mfc.ClosedLoop(ARM, mfc.laws.JointPID(-50.0), mfc.trajectories.Hold([0.3, 0.8])).linearize()
    assert words(bad.disk_margin().plot()) == ["no disk margin: not stable"]
    assert words(bad.margins().plot()) == ["unstable at every time"]
    assert not any(word.startswith("PM") for ax in bad.plot_bode().figure.axes for word in words(ax))


WRONG: list[tuple[Callable[[], Any], type[Exception]]] = [
    (lambda: LIN.plot_bode(0, at="force"), UnknownPoint),
    (lambda: LIN.plot_bode(0, channel="elbow"), UnknownName),
    (lambda: LIN.plot_nyquist(6), BadArgument),
    (lambda: LIN.margins().plot("phase"), UnknownName),
    (lambda: LOOP.simulate(0.1).plot("x"), UnknownName),
    (lambda: LIN.steps([0.0, 1.0]).plot("q_elbow"), UnknownName),
    (lambda: LIN.disk_margin().plot(17), BadArgument),
]


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_a_wrong_name_is_refused_before_a_figure_is_made(number: int) -> None:
    ask, error = WRONG[number]
    with pytest.raises(error):
        ask()
    assert not plt.get_fignums()
