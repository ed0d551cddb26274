"""The sections of a loop: numbers, disk margin, roots with dead time, the length of the comparison, path and run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import lambertw

from mfc_analysis.report.loops import sections
from mfc_analysis.report.loops.step_runs import GROWTH
from mfc_analysis.report.loops.view import View
from tests.report.loops.views import H, falling, links, mass, open_loop, triple, unstable, velocity


def test_numbers_of_one_mass_are_those_of_its_polynomial() -> None:
    found = sections.numbers(mass(25.0, 6.0))
    assert_allclose(np.poly(found["poles"]), [1.0, 6.0, 25.0])
    wc = found["crossover"][0]  # |25 + 6 j w| = w^2
    assert wc**4 == pytest.approx(36 * wc**2 + 625) and found["phase_deg"][0] == pytest.approx(np.degrees(np.arctan(6 * wc / 25)))
    assert (found["gain_reduction"][0], found["gain_increase"][0]) == (0.0, np.inf)
    assert found["gains"] == {"kp": 25.0, "kd": 6.0} and (found["equation"], found["at"]) == ("9.8", "torque")
    assert "validation" not in found


def test_the_disk_margin_of_decoupled_double_integrators_is_that_of_one_of_them() -> None:
    (_,), found = sections.disk_block(links())
    # S - 1/2 = (s^2 - 16 s - 64) / (2 (s + 8)^2), largest at s = 8j: 1/sqrt(2)
    assert found["disk_margin"] == pytest.approx(np.sqrt(2.0), rel=1e-6) and found["disk_frequency"] == pytest.approx(8.0, rel=1e-3)
    assert sections.frequency_section(triple()).numbers == {}  # one channel: its own margins say it all


def test_with_dead_time_the_roots_are_those_of_lamberts_function() -> None:
    k, delay = 4.0, 0.1
    roots = sections.pole_section(velocity(k, H(delay=delay))).numbers["delay_roots"]
    s = np.array([complex(lambertw(-k * delay, branch)) / delay for branch in range(-3, 3)])  # s + k exp(-s delay) = 0
    assert_allclose(np.poly(roots), np.poly(s), rtol=1e-9)  # pairs may stand in either order
    assert sections.pole_section(velocity(k)).numbers == {}


def test_the_numbers_of_a_loop_with_dead_time_call_its_poles_what_they_are() -> None:
    """The JSON has no field "poles" there: -k is no root of s + k exp(-s T)."""
    found = sections.numbers(velocity(4.0, H(delay=0.1)))
    assert "poles" not in found and found["poles_without_dead_time"] == pytest.approx([-4.0])
    assert found["delay_roots"][0] == pytest.approx(complex(lambertw(-0.4, 0)) / 0.1)
    assert "poles" in sections.numbers(velocity(4.0)) and "poles" in sections.numbers(velocity(4.0, H(delay=0.1, sample_time=0.05)))


@pytest.mark.parametrize(("make", "time"), [
    (lambda: velocity(4.0), sections.VALIDATED), (lambda: velocity(4.0, H(sample_time=8e-3)), sections.SEGMENTS * 8e-3),
    (lambda: mass(1e4, 10.0), sections.PERIODS * 2 * np.pi / 100.0), (lambda: mass(1.6e5, 100.0), sections.SHORTEST),
], ids=["calm", "sampled", "rings at 100 rad/s", "rings at 400 rad/s"])  # fmt: skip
def test_the_comparison_is_as_long_as_the_loop_allows(make: Callable[[], View], time: float) -> None:
    assert sections.validated(make()).time == pytest.approx(time, rel=1e-9)


def test_the_comparison_of_a_growing_loop_takes_a_few_time_constants_and_never_more_than_asked() -> None:
    found = unstable()
    assert sections.validated(found).time == pytest.approx(GROWTH / found.growth, rel=1e-9)
    assert sections.validated(found, 0.05).time == 0.05


def test_a_path_tells_its_smallest_and_largest_phase_margin_or_where_it_is_first_unstable() -> None:
    assert sections.path_section(mass()) == ()
    (section,) = sections.path_section(falling())
    bad = np.flatnonzero(~falling().evidence.judged)
    assert f"{bad.size} of 5" in section.finding and f"t = {falling().times[bad[0]]:g} s" in section.finding
    ok = replace(falling(), loop=replace(falling().loop, law=falling().loop.law.changed(kp=4.0)))
    (section,) = sections.path_section(ok)
    assert all(f"{x:.1f}°" in section.finding for x in (ok.margins.phase_deg.min(), ok.margins.phase_deg.max()))


def test_without_feedback_a_run_keeps_the_error_that_it_starts_with() -> None:
    found = sections.time_section(open_loop()).numbers
    assert found == {"first_error": pytest.approx(0.05), "last_error": pytest.approx(0.05)}
    step = sections.time_section(velocity(4.0)).numbers
    assert step["settling"] == pytest.approx(np.log(50.0) / 4.0, rel=1e-6) and step["rise"] == pytest.approx(np.log(9.0) / 4.0, rel=1e-6)


@pytest.mark.parametrize(
    "make", [mass, unstable, triple, lambda: velocity(4.0, H(delay=0.1)), open_loop], ids=["mass", "unstable", "triple", "late", "open"]
)
def test_the_second_opinion_is_of_the_worst_case_and_leaves_nothing_unexplained(make: Callable[[], View]) -> None:
    found = make()
    section = sections.opinion_section(found)
    ours = found.lin.second_opinion(found.worst.row, found.point, found.worst.channel)
    (table,) = section.body
    assert [row[0] for row in table.rows] == [c.name for c in ours.comparisons] and section.numbers == {"second_opinion_watch": []}
    assert section.finding.endswith("none differs without one.") and ours.version in table.caption
