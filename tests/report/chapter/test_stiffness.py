"""The sections on stiffness: the closed form on both sides, where a sign changes, points that agree with a map or don't."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.loop import ClosedLoop
from mfc_analysis.report.chapter import stiffness
from mfc_analysis.report.chapter.force import KDAMP, KFI, MASS, slider_loop
from mfc_analysis.report.document.document import written
from mfc_analysis.requirements.line import Status
from tests.report.read import told


@pytest.mark.parametrize("kfp", [0.4, 1.0, 6.0])
@pytest.mark.parametrize(("part", "stable"), [(0.999, True), (1.001, False)])
def test_a_mass_with_a_lag_is_stable_below_the_closed_form_and_not_above(kfp: float, part: float, stable: bool) -> None:
    k, T = part * stiffness.closed_form(kfp), stiffness.LAG
    roots = np.roots([MASS * T, MASS, KDAMP + k * T, k * (1 + kfp), k * KFI])
    assert (roots.real.max() < 0) == stable
    poles = slider_loop(k, kfp=kfp, hardware=stiffness.LAGGED).linearize().poles()[0]
    assert (poles[np.abs(poles) > 0].real.max() < 0) == stable


def test_an_edge_is_where_the_sign_changes_first_on_a_logarithmic_axis() -> None:
    values = np.array([1.0, 10.0, 1000.0, 1e4])
    assert stiffness.edge(values, np.array([-2.0, -1.0, 1.0, -1.0])) == pytest.approx(100.0)
    growth = np.sinh(np.log(values / 30.0))  # a straight line once asinh is taken
    assert stiffness.edge(values, growth) == pytest.approx(30.0)


def test_points_run_on_both_sides_of_a_boundary_agree_with_its_map_and_one_that_does_not_fails() -> None:
    def make(k: float, kfi: float) -> ClosedLoop:
        return slider_loop(k, kfi=kfi)

    limit = 120.0  # kdamp (1 + kfp) / m
    found = stiffness.mapped(make, limit * np.array([0.25, 4.0]), ((2e4, limit / 2), (2e4, limit * 2)), np.array([1e-3]), np.array([1e3, 2e4]))
    assert [settles for *_, settles in found.points] == [True, False] and found.agree == 2
    assert (np.sign(found.map.growth) == [[-1, -1], [1, 1]]).all()
    assert found.check().status is Status.PASS and found._replace(agree=1).check().status is Status.FAIL


def test_findings_quote_the_limits_in_kilonewtons_a_metre() -> None:
    found = told("stiffness")
    lag, arm, ideal = (found[f"stiffness-{name}"] for name in ("lag", "arm", "ideal"))
    for section, keys in ((lag, ("limit", "closed_form", "limit_with_delay_and_filter")), (arm, ("limit", "limit_with_delay"))):
        assert all(written(section["numbers"][key] / 1e3) in section["finding"] for key in keys)
    assert all(written(x) in ideal["finding"] for x in (min(ideal["numbers"]["edges"]), ideal["numbers"]["limit"]))
    assert lag["numbers"]["limit_with_delay_and_filter"] < lag["numbers"]["limit"]  # dead time costs
