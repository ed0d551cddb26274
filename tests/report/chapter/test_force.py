"""The sections on 9.19 to 9.23: closed forms of one mass, checks that turn at their limit, findings that quote the numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.chapter import force
from mfc_analysis.report.document.document import written
from tests.report.read import told


@pytest.mark.parametrize(
    ("k", "kfp", "kfi", "kdamp", "lag"), [(2e3, 1.0, 5.0, 60.0, 2e-3), (3e4, 0.3, 12.0, 45.0, 5e-4), (150.0, 4.0, 1.0, 9.0, 1e-2)]
)
def test_one_mass_on_a_spring_has_the_chapters_polynomial(k: float, kfp: float, kfi: float, kdamp: float, lag: float) -> None:
    def polynomial(hardware: mfc.Hardware | None) -> np.ndarray:
        p = force.slider_loop(k, kfp, kfi, kdamp, hardware).linearize().poles()[0]
        return np.poly(p[np.abs(p) > 0]).real

    m = force.MASS
    assert_allclose(polynomial(None), np.array([m, kdamp, k * (1 + kfp), k * kfi]) / m, rtol=1e-8)
    late = np.array([m * lag, m, kdamp + k * lag, k * (1 + kfp), k * kfi])
    assert_allclose(polynomial(mfc.Hardware(torque_lag=lag)), late / late[0], rtol=1e-8)


@pytest.mark.parametrize(("part", "stable"), [(0.99, True), (1.01, False)])
def test_without_lag_the_integral_gain_decides_and_the_stiffness_does_not(part: float, stable: bool) -> None:
    limit = force.KDAMP * (1 + force.KFP) / force.MASS
    for k in (1e2, 1e4, 1e6):
        p = force.slider_loop(k, kfi=part * limit).linearize().poles()[0]
        assert (p[np.abs(p) > 0].real.max() < 0) == stable


def test_pushing_on_nothing_the_speed_is_the_integral_of_the_force() -> None:
    t = np.linspace(0.0, 1.0, 11)
    F, m, kfp = 10.0, force.MASS, 0.5
    bare = force.slider_loop(None, kfp, None, 0.0).simulate(t).twist[:, 2]
    assert_allclose(bare, F * (1 + kfp) / m * t, atol=1e-9)  # 9.22 without its integral
    damped = force.slider_loop(None, kfp, None, 20.0).simulate(t, rtol=1e-9, atol=1e-12).twist[:, 2]
    assert_allclose(damped, F * (1 + kfp) / 20.0 * (1 - np.exp(-20.0 / m * t)), atol=1e-8)  # 9.23 without: a speed, no ramp


def test_where_a_curve_first_rises_through_a_level_is_exact_for_a_power() -> None:
    x = np.geomspace(0.1, 100.0, 7)
    assert force.crossing(x, 3 * x**2, 5.0) == pytest.approx(np.sqrt(5.0 / 3.0), rel=1e-12)
    assert force.crossing(x, x, 1e3) == np.inf and force.crossing(x, x, 0.05) == x[0]
    assert [force.tiny(v) for v in (1e-7, -1e-7, 1e-5)] == [0.0, 0.0, 1e-5]


def test_findings_quote_the_numbers_that_the_json_has() -> None:
    found = told("force")
    n = {key: found[key]["numbers"] for key in found}
    free, arm, slider = n["free-space"], n["arm-force"], n["slider-force"]
    quoted = {
        "contact": [*n["contact"]["one_tenth_at"].values()],
        "payload": [abs(n["payload"]["errors"]["9.21"][1])],
        "free-space": [free["speed"]["slider, 9.22"], free["speed"]["UR5, 9.22"], free["acceleration"]["slider, 9.23"]],
        "slider-force": [slider["smallest"]["phase_deg"]["value"], 1e3 * slider["smallest"]["delay"]["value"]],
        "arm-force": [arm["smallest"]["phase_deg"]["value"], min(arm["torque_phase_deg"]), 1e3 * arm["smallest"]["delay"]["value"]],
    }
    assert all(written(x, 3) in found[key]["finding"] for key, values in quoted.items() for x in values)
