"""The smallest margins over all analysis points: the tightest point is named, equal ones go to the first, what is not sensed is passed over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfc_analysis.report.document.document import Section, found_of
from mfc_analysis.report.document.verdict import requirements
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.points import METRICS, smallest
from mfc_analysis.requirements.requirements import Requirements
from tests.report.loops.views import H, mass, pushing


def test_the_smallest_margin_of_a_force_loop_is_that_of_the_tightest_point_however_it_is_opened() -> None:
    found = replace(pushing(), loop=replace(pushing().loop, hardware=H(torque_lag=2e-3)))
    for at in found.lin.opened.points:
        least = replace(found, at=at).smallest
        by_point = {point: found.lin.margins(point) for point in found.lin.opened.points}
        for name in METRICS[:4]:
            values = {point: np.nanmin(getattr(m, name)) for point, m in by_point.items()}
            assert least[name].value == pytest.approx(min(values.values()), rel=1e-6)
            assert values[least[name].point] == pytest.approx(least[name].value, rel=1e-6)
        assert least["sensitivity_peak"].value == pytest.approx(max(np.nanmax(m.sensitivity_peak) for m in by_point.values()), rel=1e-6)


def test_equal_margins_belong_to_the_first_point_and_an_unlimited_one_is_infinite() -> None:
    m = mass().lin.margins("torque")
    other = replace(m, at="elsewhere", phase_deg=m.phase_deg * (1 - 1e-9))
    assert {found.point for found in smallest([m, other]).values()} == {"torque"}
    less = replace(m, at="elsewhere", phase_deg=m.phase_deg * 0.99)
    assert smallest([m, less])["phase_deg"].point == "elsewhere" and smallest([m, less])["delay"].point == "torque"
    force = pushing().lin.margins("force")  # five channels are not sensed
    assert np.isinf(smallest([force])["gain_reduction_db"].value)
    assert np.isnan(smallest([replace(m, phase_deg=m.phase_deg * np.nan)])["phase_deg"].value)


def test_a_requirement_at_one_point_names_it_and_a_smaller_margin_at_another() -> None:
    loop = replace(pushing().loop, hardware=H(torque_lag=2e-3))
    found = replace(pushing(), loop=loop, at="force", requirements=Requirements(delay=5e-2))
    torque = found.lin.margins("torque").delay[0, 0]
    assert torque < 5e-2 < found.lin.margins("force").delay[0, 2]
    line = next(line for line in found.checks if line.name == "delay")
    assert line.status == "PASS" and line.where == "fz at “force”"
    assert f"{1e3 * torque:.1f} ms at “torque”" in line.elsewhere and "beyond the limit" in line.elsewhere
    (row,) = (row for row in requirements(Section("", checks=found.checks)).rows if row[0] == "delay margin")
    assert line.elsewhere in str(row[-1]) and str(found_of(line)) == str(row[2])
    assert blocks.sensitivity(found).facts[3].value.value == pytest.approx(1e3 * torque)
    assert "“torque”" in found.tightest() or "“position”" in found.tightest()
