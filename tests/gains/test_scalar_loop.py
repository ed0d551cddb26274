"""Metrics of scalar loops against closed forms and python-control."""

import math

import control
import numpy as np
import pytest

from mfc_analysis.gains.scalar_loop import loop_metrics


def test_an_integrator_has_its_gain_as_bandwidth_and_crossover() -> None:
    f = loop_metrics([5.0], [1.0, 0.0])
    assert (f.bandwidth, f.crossover) == (pytest.approx(5.0), pytest.approx(5.0))
    assert f.phase_deg == pytest.approx(90.0)
    assert f.settling_time == pytest.approx(math.log(50) / 5)


def test_a_second_order_lag_has_the_textbook_metrics() -> None:
    z, w = 0.3, 4.0  # L = w^2 / (s (s + 2 z w)): T = w^2 / (s^2 + 2 z w s + w^2)
    f = loop_metrics([w**2], [1.0, 2 * z * w, 0.0])
    assert f.bandwidth == pytest.approx(w * math.sqrt(1 - 2 * z**2 + math.sqrt((1 - 2 * z**2) ** 2 + 1)))
    assert f.crossover == pytest.approx(w * math.sqrt(math.sqrt(1 + 4 * z**4) - 2 * z**2))
    assert f.phase_deg == pytest.approx(math.degrees(math.atan2(2 * z * w, f.crossover)))


@pytest.mark.parametrize(("num", "den"), [([25.0], [1, 10, 10, 0]), ([3.0, 3, 1], [1, 0, 0, 0]), ([2.0, 1], [0.1, 1, 0, 0])])
def test_they_agree_with_python_control(num, den) -> None:
    f = loop_metrics(num, den)
    _, pm, _, wc = control.margin(control.tf(num, den))
    assert f.crossover == pytest.approx(wc, rel=1e-6)
    assert f.phase_deg == pytest.approx(pm, rel=1e-6)
    T = control.feedback(control.tf(num, den))
    assert f.bandwidth == pytest.approx(control.bandwidth(T, -20 * math.log10(math.sqrt(2))), rel=1e-6)
    t = np.linspace(0, 2.9 * f.settling_time, 30001)
    y = control.step_response(T, t)[1]
    assert f.settling_time == pytest.approx(t[np.flatnonzero(np.abs(y - 1) > 0.02)[-1]], abs=t[1])


def test_an_unstable_loop_has_no_metrics() -> None:
    f = loop_metrics([1.0], [1.0, 0.0, 0.0, 0.0])
    assert not f.stable
    assert math.isnan(f.bandwidth)
    assert math.isnan(f.settling_time) and math.isnan(f.loop_settling_time)


def test_a_loop_that_never_reaches_one_has_an_infinite_crossover_and_never_settles() -> None:
    f = loop_metrics([0.5], [1.0, 1.0])
    assert f.crossover == math.inf
    assert f.settling_time == math.inf


def test_scale_does_not_matter() -> None:
    slow, fast = loop_metrics([3.0, 3, 1], [1, 0, 0, 0]), loop_metrics([3e6, 3e12, 1e18], [1, 0, 0, 0])
    assert fast.bandwidth == pytest.approx(1e6 * slow.bandwidth, rel=1e-12)
    assert fast.settling_time == pytest.approx(1e-6 * slow.settling_time, rel=1e-9)
    assert math.isnan(loop_metrics([1.0], [1.0, 0.0], settle=()).settling_time)


def last_outside(error, end: float) -> float:
    """[s] the last time at which |error(t)| is 0.02: from a fine grid, then by bisection."""
    t = np.linspace(0.0, end, 200_001)
    k = int(np.flatnonzero(np.abs(error(t)) > 0.02)[-1])
    low, high = t[k], t[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if abs(error(middle)) > 0.02 else (low, middle)
    return float(low)


@pytest.mark.parametrize(
    ("num", "den", "reference", "follows", "of_loop"),
    [  # poles all at -1: the errors of the step of the reference, and of T
        ([2.0, 1], [1.0, 0, 0], [1.0], lambda t: (1 + t) * np.exp(-t), lambda t: (1 - t) * np.exp(-t)),
        ([3.0, 3, 1], [1.0, 0, 0, 0], [3.0, 1], lambda t: (1 + t - t**2) * np.exp(-t), lambda t: (1 - 2 * t + t**2 / 2) * np.exp(-t)),
    ],
)
def test_the_steps_of_the_reference_and_of_the_loop_have_their_closed_forms(num, den, reference, follows, of_loop) -> None:
    f = loop_metrics(num, den, reference=reference)
    assert f.settling_time == pytest.approx(last_outside(follows, 40.0), rel=1e-9)
    assert f.loop_settling_time == pytest.approx(last_outside(of_loop, 40.0), rel=1e-9)
    same = loop_metrics(num, den)
    assert same.settling_time == same.loop_settling_time == f.loop_settling_time


@pytest.mark.parametrize("lag", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("damping", [0.3, 0.9])
def test_both_settling_times_agree_with_a_sum_of_modes(damping: float, lag: float) -> None:
    kp, ki, kd = 1 + 2 * damping, 1.0, 1 + 2 * damping
    num, den = [kd, kp, ki], [lag, 1.0, 0.0, 0.0, 0.0] if lag else [1.0, 0.0, 0.0, 0.0]
    closed = np.polyadd(num, den)
    poles = np.roots(closed)

    def of(over):
        parts = np.polyval(over, poles) / (poles * np.polyval(np.polyder(closed), poles))
        return lambda t: np.real(np.exp(np.multiply.outer(t, poles)) @ parts)

    f = loop_metrics(num, den, reference=[kp, ki])
    end = 16 / float(np.min(-poles.real))
    assert f.settling_time == pytest.approx(last_outside(of([kp, ki]), end), rel=1e-9)
    assert f.loop_settling_time == pytest.approx(last_outside(of(num), end), rel=1e-9)


@pytest.mark.parametrize(("damping", "w"), [(0.017042388010162668, 13.263775101069902), (0.01034373341188248, 10.984887107274307)])
def test_a_peak_outside_the_band_between_two_samples_is_not_missed(damping: float, w: float) -> None:
    """A pair of poles and a pole at -1: the last peak outside the band reaches less than 1 % beyond it."""
    closed = np.polymul([1.0, 2 * damping * w, w * w], [1.0, 1.0])
    poles, over = np.roots(closed), closed[3:]
    parts = np.polyval(over, poles) / (poles * np.polyval(np.polyder(closed), poles))
    f = loop_metrics(over, [*closed[:3], 0.0])
    end = 16 / float(np.min(-poles.real))
    assert f.settling_time == pytest.approx(last_outside(lambda t: np.real(np.exp(np.multiply.outer(t, poles)) @ parts), end), rel=1e-6)


def test_a_band_that_ends_on_a_sample_is_no_failure_of_the_search() -> None:
    for i in range(1, 300, 3):
        t = 16 / 0.5 * i / 4000  # the samples of this loop
        e = math.exp(-t / 2) * (math.cos(math.sqrt(0.75) * t) + math.sin(math.sqrt(0.75) * t) / math.sqrt(3))
        if abs(e) > 1e-3:
            ts = loop_metrics([1.0], [1.0, 1.0, 0.0], tolerance=abs(e)).settling_time
            assert ts > t - 1e-9
            assert math.exp(-ts / 2) * abs(math.cos(math.sqrt(0.75) * ts) + math.sin(math.sqrt(0.75) * ts) / math.sqrt(3)) == pytest.approx(abs(e))
