"""The sections on stiffness and hardware: what they say, confirmed another way."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.chapter import force, hardware, stiffness
from tests.report.read import statuses, told

# --- stiffness ---------------------------------------------------------------------------------------------------


def test_without_lag_the_boundary_is_rouths_at_every_stiffness() -> None:
    n = told("stiffness")["stiffness-ideal"]["numbers"]
    assert_allclose(n["edges"], force.KDAMP * (1 + force.KFP) / force.MASS, rtol=1e-2)
    assert n["limit"] == force.KDAMP * (1 + force.KFP) / force.MASS


def test_with_lag_the_limit_is_the_closed_form_and_the_bisection_of_the_library() -> None:
    n = told("stiffness")["stiffness-lag"]["numbers"]
    T, kfp = stiffness.LAG, force.KFP
    assert n["limit"] == pytest.approx((force.KDAMP * (1 + kfp) - force.MASS * force.KFI) / (T * kfp * (1 + kfp)), rel=1e-5)
    assert n["limit"] == pytest.approx(float(mfc.design.max_stiffness(force.slider_loop(hardware=stiffness.LAGGED))), rel=1e-4)


def test_at_the_limit_with_delay_and_filter_the_loop_transfer_goes_through_minus_one() -> None:
    k = told("stiffness")["stiffness-lag"]["numbers"]["limit_with_delay_and_filter"]
    T, delay, filter_ = stiffness.LAG, 1e-3, 2e-3
    w = np.linspace(10, 400, 400_000)
    s = 1j * w
    late = np.exp(-s * delay) / (T * s + 1)
    L = late * (force.KDAMP * s + (force.KFP + force.KFI / s) * k / (filter_ * s + 1)) / (force.MASS * s**2 + k)
    assert np.abs(1 + L).min() < 1e-4  # by hand from 9.19 and 9.23


def test_simulated_points_lie_on_both_sides() -> None:
    found = told("stiffness")
    for key in ("stiffness-ideal", "stiffness-lag", "stiffness-arm"):
        assert {bool(p[2]) for p in found[key]["numbers"]["points"]} == {True, False}


def test_the_arms_limit_is_where_python_control_sees_the_pole_cross() -> None:
    n = told("stiffness")["stiffness-arm"]["numbers"]
    rightmost = []
    for part in (0.99, 1.01):
        poles = control.poles(force.arm_loop(part * n["limit"], hardware=stiffness.FILTERED).linearize().system(0))
        rightmost.append(max(p.real for p in poles if abs(p) > 1e-6 and abs(p.imag) > 1))
    assert rightmost[0] < 0 < rightmost[1]
    assert n["limit_with_delay"] < n["limit"]
    assert max(n["growth_ideal"]) < 0


# --- hardware ----------------------------------------------------------------------------------------------------


def test_limits_are_those_of_the_design_searches_and_of_single_loops() -> None:
    n = told("hardware")["breaks-first"]["numbers"]["limits"]
    loop = hardware.loaded()
    lin = loop.linearize()
    phases = [control.margin(lin.loop(0, at="torque", channel=j))[1] for j in range(6)]
    assert n["phase of one torque"] <= min(phases) * (1 + 1e-6)
    dt = 1 / n["sample rate"]
    for part, stable in ((0.999, True), (1.001, False)):
        sampled = hardware.computed_torque(loop.robot, force.arm(), force.POSE, hardware=mfc.Hardware(torque_lag=2e-3, sample_time=part * dt))
        assert (np.abs(control.poles(sampled.linearize().system(0))).max() < 1) == stable
    heavy = [force.arm().with_payload(part * n["unknown payload"]) for part in (0.999, 1.001)]
    found = [
        hardware.computed_torque(r, force.arm(), force.POSE, hardware=mfc.Hardware(torque_lag=2e-3)).linearize().poles().real.max() for r in heavy
    ]
    assert found[0] < 0 < found[1]


def test_the_dead_time_limit_is_where_the_delayed_loop_goes_through_minus_one() -> None:
    n = told("hardware")["dead-time"]["numbers"]
    J, b, m, r, g, theta, w = 0.5, 0.1, 1.0, 0.1, 9.81, 0.3, 10.0
    weight = -m * g * r * np.sin(theta)  # slope of the gravity torque
    s = 1j * np.linspace(1, 60, 600_000)
    law = J * (3 * w * s + 3 * w**2 + w**3 / s) - b * s - weight  # what the torque feeds back of theta
    L = law * np.exp(-s * n["limit"]) / (J * s**2 + b * s + weight)
    assert np.abs(1 + L).min() < 1e-4
    assert n["product"][0] == pytest.approx(10 * n["limit"])


def test_disk_margin_of_all_torques_is_below_that_of_each_and_gives_its_gain() -> None:
    n = told("hardware")["disk"]["numbers"]
    lin = hardware.loaded().linearize()
    w = np.geomspace(0.1, 1e3, 400)
    S = 1 / (1 + lin.frequency_response(w, "torque")[0])
    each = 1 / np.abs(S - 0.5).max(axis=1)  # of one loop alone: alpha = 1 / max |S - 1/2|
    assert n["alpha_torque"] <= each.min()
    assert n["gain_all_db"] == pytest.approx(20 * np.log10((2 + n["alpha_torque"]) / (2 - n["alpha_torque"])), rel=1e-9)
    assert n["alpha_both"] < n["alpha_torque"]


def test_disk_margin_of_all_torques_is_python_controls() -> None:
    pytest.importorskip("slycot")
    n = told("hardware")["disk"]["numbers"]
    lin = hardware.loaded().linearize()
    w = n["frequency"] * np.array([0.999, 1.0, 1.001])
    assert n["alpha_torque"] == pytest.approx(float(control.disk_margins(all_torques(lin), w)[0]), rel=1e-4)


def all_torques(lin: mfc.Linearization) -> control.StateSpace:
    """L at all torques at once: the wires "torque" cut together, the others closed."""
    from mfc_analysis.analysis.system import close_wires

    opened = lin.opened
    cut = np.zeros(opened.nw, bool)
    cut[opened.wires["torque"]] = True
    A, B, C, D = (M[0] for M in close_wires(opened, cut))
    return control.ss(A, B[:, opened.nu :], -C[opened.ny :], -D[opened.ny :, opened.nu :])


def test_the_truth_is_period_doubling_where_frozen_poles_say_stable() -> None:
    n = told("hardware")["floquet"]["numbers"]
    assert max(n["frozen"]) < 0 < n["growth"] - 1
    assert n["simulated"] == pytest.approx(n["growth"], rel=1e-3)
    assert n["angle_deg"] == pytest.approx(180)
    assert n["growth"] == pytest.approx(1.0738, abs=5e-5)  # with the UR5 of example-robot-data, which the extra "test" installs


@pytest.mark.parametrize("module", ["stiffness", "hardware"])
def test_every_check_of_these_sections_is_met(module: str) -> None:
    assert statuses(told(module)) == {"PASS"}
