"""Delay margins of sampled loops against closed forms and against the loop resampled with more dead time."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.analysis import late_roots
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.sampled import sampled
from tests.analysis.test_sampled import loop
from tests.soak.sampled_delay import compared, drawn, random_plant, wrong_delays


def velocity_p(k: float, h: float, **hardware: float) -> mfc.ClosedLoop:
    law, hold = mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.2])
    return mfc.ClosedLoop(mfc.robots.single_joint(), law, hold, hardware=mfc.Hardware(sample_time=h, **hardware))


@pytest.mark.parametrize("kT", [1.001, 1.2, 1.5, 1.95])
def test_an_integrator_sampled_slowly_has_the_inverse_of_its_gain(kT: float) -> None:
    """z^2 + (kT (1 - f) - 1) z + kT f: the product of the roots is kT f, so that T f = 1/k; phase over frequency says another time."""
    h = 0.1
    found = velocity_p(kT / h, h).linearize([0.0]).margins()
    assert found.delay[0, 0] == pytest.approx(h / kT, rel=1e-9)
    z = np.roots([1, kT * (1 - 1 / kT) - 1, 1])
    assert found.delay_frequency[0, 0] == pytest.approx(float(np.abs(np.angle(z)).max()) / h, rel=1e-6)
    assert kT < 1.1 or abs(np.radians(found.phase_deg[0, 0]) / found.crossover[0, 0] / (h / kT) - 1) > 0.03


@pytest.mark.parametrize("d", [1, 2, 7, 40, 300])
def test_an_integrator_loses_at_a_whole_number_of_samples_where_theory_says(d: int) -> None:
    """z^(d + 1) - z^d + kT has its roots on the circle at kT = 2 sin(pi / (4 d + 2))."""
    h, kT = 0.01, 2 * np.sin(np.pi / (4 * d + 2))
    found = velocity_p(kT / h, h).linearize([0.0]).margins()
    assert found.delay[0, 0] == pytest.approx(d * h, rel=1e-9)
    assert found.delay_frequency[0, 0] * h == pytest.approx(np.pi / (2 * d + 1), rel=1e-9)


def test_dead_time_that_is_there_is_part_of_the_total() -> None:
    h, k = 0.1, 5.0
    whole = velocity_p(k, h).linearize([0.0]).margins().delay[0, 0]
    for now in (0.3 * h, h, 1.4 * h, 2 * h):
        assert velocity_p(k, h, delay=now).linearize([0.0]).margins().delay[0, 0] == pytest.approx(whole - now, rel=1e-9)


@pytest.mark.parametrize("seed", [1, 59, 114, 116, *range(2, 12)])
def test_random_plants_with_few_samples_a_period_lose_stability_where_the_margin_says(seed: int) -> None:
    """Resonances above the Nyquist frequency: windows of instability within one sample, narrower than a tenth of it."""
    found: Counter[str] = Counter()
    assert wrong_delays(random_plant(seed), 1.0, 100.0, found, 40) == []


@pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5, 6, 8])
def test_every_channel_of_random_arms_loses_stability_where_the_margin_says(seed: int) -> None:
    """The soak test of the same name in short: all laws, a scan in few steps."""
    said, made = drawn(seed)
    assert compared(made, Counter(), 12, channels=2) == [], said


def test_the_delay_margin_of_an_encoder_is_that_of_the_only_loop_through_it() -> None:
    """One joint: dead time in the actuator or in the encoder, the loop is the same."""
    rules = {"integral_rule": "tustin", "derivative_rule": "backward", "velocity_filter": 8e-3}
    joint, hold = mfc.robots.single_joint(inertia=0.7, mass=0.0, damping=0.4), mfc.trajectories.Hold([0.0])
    for law, first, hardware in (
        (mfc.laws.JointPID(60.0, 90.0, 9.0), "torque", {"sample_time": 5e-3, **rules}),
        (mfc.laws.VelocityPI(20.0, 30.0), "velocity", {"sample_time": 5e-3, "delay": 3e-3, "velocity_lag": 4e-3}),
    ):
        lin = mfc.ClosedLoop(joint, law, hold, hardware=mfc.Hardware(**hardware)).linearize([0.0])
        one, other = lin.margins(first), lin.margins("position")
        for figure in ("gain_increase", "phase_deg", "delay", "sensitivity_peak"):
            assert getattr(other, figure)[0, 0] == pytest.approx(getattr(one, figure)[0, 0], rel=1e-9), figure


def test_an_unstable_loop_has_no_delay_margin() -> None:
    found = velocity_p(25.0, 0.1).linearize([0.0]).margins()
    assert not found.stable[0] and np.isnan(found.delay).all()


def test_a_loop_of_small_gain_has_an_unlimited_one() -> None:
    found = margins(sampled(loop([[-1.0]], [1.0], [1.0], 0.5), 0.1), "torque")
    assert found.delay[0, 0] == np.inf and found.delay_frequency[0, 0] == np.inf


def test_margins_requirements_and_the_search_agree() -> None:
    for k, h, delay in ((12.0, 0.1, None), (5.0, 0.1, None), (5.0, 0.1, 0.13), (3.0, 0.004, 0.001)):
        hardware = {} if delay is None else {"delay": delay}
        made = velocity_p(k, h, **hardware)
        margin = float(made.linearize([0.0]).margins().delay[0, 0])
        assert float(mfc.design.max_delay(made)) == pytest.approx(margin + (delay or 0.0), rel=1e-6)
        assert mfc.Requirements(delay=margin * (1 - 1e-6)).check(made, [0.0]).passed
        assert not mfc.Requirements(delay=margin * (1 + 1e-6)).check(made, [0.0]).passed
        for factor, stable in ((1 - 1e-6, True), (1 + 1e-6, False)):
            late = velocity_p(k, h, delay=(delay or 0.0) + margin * factor)
            assert late.linearize([0.0]).stable.all() == stable


def test_a_channel_without_a_loop_is_not_searched_sample_by_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall along z gives fx and fy of an admittance a loop of 1e-15: rounding, and no dead time loses it."""
    monkeypatch.setattr(late_roots, "FINE", None)  # of the search
    arm, q = mfc.robots.ur5(), np.radians([0.0, -60.0, 80.0, -110.0, -90.0, 0.0])
    law = mfc.laws.Admittance([0, 0, 20.0, 0, 0, 0], 60.0, 3700.0)
    drives = mfc.Hardware(sample_time=8e-3, servo=mfc.Servo(bandwidth=mfc.hertz(8), damping=0.7, delay=16e-3))
    made = mfc.ClosedLoop(
        arm, law, mfc.trajectories.ToolHold(arm.pose(q)), q_start=q, environment=mfc.Environment(2e4, axes="z", preload=20.0), hardware=drives
    )
    found = made.linearize([0.0]).margins("force").delay[0]
    assert np.isinf(found[:2]).all() and 0.1 < found[2] < 1.0
