"""A loop as a report sees it: its worst place, which channels are fed back, the span of its figures, how long a run is followed."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.analysis.frequency.window import MOST_DECADES
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.view import FAR, place_words
from tests.report.loops.views import MGR, B, H, I, L, T, falling, joint, links, mass, open_loop, planar, unstable, velocity, view


def test_the_worst_place_is_where_python_control_has_the_smallest_phase_margin() -> None:
    kp, ki, kd = 20.0, 30.0, 3.0
    ref, times = T.Quintic([-0.5], [1.3], 2.0), np.linspace(0.0, 2.0, 9)
    found = view(mfc.ClosedLoop(joint(), L.JointPID(kp, ki, kd), ref), times)
    phases = [control.margin(control.tf([kd, kp, ki], [I, B, -MGR * np.sin(q), 0.0]))[1] for q in ref(times).q[:, 0]]
    assert found.worst.row == int(np.argmin(phases)) > 0 and found.worst.time == times[found.worst.row]
    assert found.margins.phase_deg[found.worst.row, 0] == pytest.approx(min(phases), rel=1e-6)
    L_here = found.response(np.array([2.0, 5.0]))
    s = 2j, 5j
    angle = ref(found.worst.time).q[0]
    assert_allclose(L_here, [(kd * x**2 + kp * x + ki) / (x * (I * x**2 + B * x - MGR * np.sin(angle))) for x in s], rtol=1e-9)


def test_the_finding_of_an_unstable_loop_names_joint_time_and_root() -> None:
    s = max(np.roots([I, B + 1.0, 10.0 - MGR * np.sin(0.3), 1e3]), key=lambda x: x.real)
    said = f"joint 1 (joint) at t = 0 s: root +{s.real:.3g} ± {abs(s.imag):.3g} j 1/s"
    assert unstable().summary() == f"Not stable: {said}." and f"the loop is unstable ({said})" in unstable().tightest()


def test_with_dead_time_the_finding_says_that_it_is_included() -> None:
    """9.2 with k T = 2 > pi/2: the pole without dead time is at -20."""
    s = complex(lambertw(-2.0, 0)) / 0.1
    late = velocity(20.0, H(delay=0.1))
    assert late.summary() == f"Not stable (dead time included): joint 1 (joint) at t = 0 s: root +{s.real:.3g} ± {s.imag:.3g} j 1/s."
    fact = blocks.three_numbers(late).facts[0]
    assert fact.name == "Rightmost root, dead time included" and fact.value.value == pytest.approx(s.real)
    assert blocks.three_numbers(velocity(20.0)).facts[0].name == "Rightmost pole"


def test_an_open_loop_has_no_feedback_whether_it_holds_or_not() -> None:
    assert open_loop().tightest() == "there is no feedback, so there are no margins"


def test_of_an_unstable_path_the_worst_place_is_the_rightmost_root() -> None:
    found = falling()
    assert not found.stable and found.worst.time == 2.0
    top = np.roots([I, B + 1.0, 0.4 - MGR * np.sin(1.3)]).max()
    assert found.growth == pytest.approx(top, rel=1e-9) and mass().growth == 0.0
    assert found.evidence.judged.tolist() == [MGR * np.sin(q) < 0.4 for q in found.loop.nominal(found.times).q[:, 0]]


def test_a_channel_without_a_gain_is_not_fed_back_and_is_never_the_worst() -> None:
    found = view(mfc.ClosedLoop(planar(), L.VelocityP([0.0, 4.0]), T.Hold([0.3, 0.2])))
    assert found.fed_back.tolist() == [False, True] and found.worst.name == planar().joint_names[1]
    assert links().fed_back.tolist() == [True, True] and not open_loop().fed_back.any()


def test_figures_span_the_poles_and_crossings_and_end_below_half_the_sample_rate() -> None:
    grid = velocity().frequencies(50)
    assert grid.size == 50 and grid[0] < 4.0 / 10 and grid[-1] > 4.0 * 10
    dt = 8e-3
    assert velocity(hardware=H(sample_time=dt)).frequencies()[-1] == pytest.approx(np.pi / dt, rel=1e-6)
    wide = mass(1e6, 1e9).frequencies()  # poles at 1e-3 and 1e9, crossover at 1e9
    assert np.log10(wide[-1] / wide[0]) <= MOST_DECADES and wide[0] < 1e9 / 10 < 1e9 * 10 < wide[-1]


def test_a_run_is_followed_to_its_end_only_where_the_loop_stays_near() -> None:
    assert mass().calm(50.0) == 50.0
    found = falling()
    span = found.calm(50.0)
    run = found.loop.simulate(found.worst.time + np.linspace(0.0, span, 9), x=found.lin.point.x[found.worst.row])
    assert span < 50.0 and np.abs(run.error - run.error[0]).max() > FAR
    assert unstable().calm(0.1) == 0.1


def test_a_place_has_its_time_only_on_a_path() -> None:
    assert [place_words("elbow", 0.25, count) for count in (1, 2)] == ["elbow", "elbow, t = 0.25 s"]


def test_a_loop_that_slides_says_in_its_finding_what_slides_how_slowly_and_what_would_hold_it() -> None:
    law = L.DampedForcePI(np.eye(6)[2] * 10, np.eye(6)[2], 2 * np.eye(6)[2], kdamp=40.0)
    q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.2])
    wall = mfc.Environment(1e4, axes="z", preload=10.0)
    for asked in ({}, {"phase_deg": 179.0}):  # also where another requirement comes first
        said = view(mfc.ClosedLoop(mfc.robots.load("ur10"), law, T.Hold(q), environment=wall, hardware=H(torque_lag=2e-3)), **asked).summary()
        assert "Nothing holds the tool along x" in said and "along z within" not in said and "add a foot" in said
        assert "time constant of" in said or "zero to rounding" in said
    assert "othing" not in mass().summary()
    free = view(mfc.ClosedLoop(mfc.robots.load("panda"), L.ComputedTorque(kp=0.0, kd=5.0), T.Hold([0.3, 0.3, 0.3, -1.5, 0.3, 1.5, 0.3])))
    assert "Nothing brings all 7 joints back within 100 s: they stay nearly where they are put; add position feedback there." in free.summary()
