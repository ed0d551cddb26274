"""The sections on 9.24: both halves' roots in closed form, a wall that is not where it is believed, findings that quote the numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.design.stiffness import over_stiffness
from mfc_analysis.report.chapter import hybrid
from mfc_analysis.report.chapter.force import KFI, KFP, POSE, arm
from mfc_analysis.report.document.document import written
from tests.report.read import told


def mass_along_the_normal() -> float:
    J, M = arm().jacobian(POSE), arm().mass(POSE)
    return float(1 / (J @ np.linalg.solve(M, J.T))[2, 2])


def test_the_force_half_is_one_mass_on_a_spring_and_the_motion_half_the_designs_double_poles() -> None:
    poles = hybrid.hybrid_loop().linearize().poles()[0]
    m, k = mass_along_the_normal(), hybrid.STIFFNESS
    wanted = np.roots([m, hybrid.DAMPING, k * (1 + KFP), k * KFI])
    assert max(np.abs(poles - z).min() / abs(z) for z in wanted) < 2e-3  # the tool turns on its arm: that much of the spring is not along z
    assert np.sum(np.abs(poles + 10.0) < 1e-4) == 6  # kp = 100, kd = 20: double poles of three directions


@pytest.mark.parametrize("kfi", [1.0, 8.0])
def test_without_damping_another_integral_gain_grows_at_its_own_closed_form(kfi: float) -> None:
    loop = hybrid.hybrid_loop(kdamp=0.0, kfi=kfi)
    assert over_stiffness(loop, [1e6]).growth[0] == pytest.approx(kfi / (2 * (1 + KFP)), rel=1e-3)  # in the limit of a hard wall


def test_a_wall_is_turned_about_its_own_axis_and_moved_along_its_own_normal() -> None:
    X, Y = arm().pose(POSE), hybrid.turned(5.0, 2e-3)
    assert_allclose(Y[:3, :3].T @ Y[:3, :3], np.eye(3), atol=1e-14)
    assert_allclose(Y[:3, 0], X[:3, 0], atol=1e-14)
    assert Y[:3, 2] @ X[:3, 2] == pytest.approx(np.cos(np.radians(5.0))) and Y[:3, 1] @ X[:3, 2] == pytest.approx(np.sin(np.radians(5.0)))
    assert_allclose(Y[:3, 3] - X[:3, 3], 2e-3 * X[:3, 2], atol=1e-15)


def test_the_error_at_rest_across_the_wall_is_its_distance_and_along_it_the_leak() -> None:
    n = told("hybrid")["hybrid-leak"]["numbers"]
    at_rest, predicted = np.array(n["at_rest"]), np.array(n["predicted"])
    assert abs(at_rest[2]) == pytest.approx(2e-4, rel=0.02)  # the wall's own give under 20 N stays what it was
    assert np.delete(predicted, 2) == pytest.approx(-at_rest[2] * np.delete(n["leak"]["dynamic"], 2))
    assert np.linalg.norm(np.delete(at_rest - predicted, 2)) < 0.1 * np.linalg.norm(np.delete(at_rest, 2))


def test_findings_quote_the_numbers_that_the_json_has() -> None:
    found = told("hybrid")
    n = {key: found[key]["numbers"] for key in found}
    rest = np.array(n["hybrid-leak"]["at_rest"])
    couplings = [max(n["hybrid-coupling"][name]["motion_to_force"]) for name in ("2 kg unknown", "wall turned 5°", "selection")]
    quoted = {
        "hybrid": [n["hybrid"][key]["phase_deg"]["value"] for key in ("smallest", "smallest_selection")],
        "hybrid-damping": [f(n["hybrid-damping"]["growth_without"]) for f in (min, max)] + [max(n["hybrid-damping"]["growth_with"])],
        "hybrid-coupling": couplings,
        "hybrid-leak": [1e3 * abs(rest[2]), 1e3 * float(np.linalg.norm(rest[:2])), 1e3 * float(np.linalg.norm(rest[3:]))],
    }
    assert all(written(x) in found[key]["finding"] for key, values in quoted.items() for x in values)
