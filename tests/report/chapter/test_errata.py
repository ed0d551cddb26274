"""The misprints of tool space, contact and hybrid control: findings quote the numbers, and claims about the forms hold elsewhere too."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.chapter import errata
from mfc_analysis.report.chapter.force import POSE, arm
from mfc_analysis.report.chapter.task import GAINS
from mfc_analysis.report.document.document import Badge, written
from tests.report.read import told


def leaves(value: object) -> list[float]:
    return [x for v in value.values() for x in leaves(v)] if isinstance(value, dict) else [value]


@pytest.mark.parametrize(("key", "path", "scale"), [
    ("misprint-9-5", ("time_to_1_percent",), 1), ("misprint-9-5-adjoint", ("position_error_mm", "no_adjoint"), 1),
    ("misprint-9-5-adjoint", ("imaginary",), 1), ("misprint-9-15", ("torque",), 1), ("misprint-9-15", ("share",), 100),
    ("misprint-9-16", ("printed", "away"), 1), ("misprint-9-16", ("standard", "sideways"), 1), ("misprint-9-16", ("printed", "sideways"), 1),
    ("misprint-9-17", ("change_of_twist_product",), 1), ("misprint-9-24", ("off_mm", "printed"), 1), ("misprint-9-24", ("turned_mrad", "printed"), 1),
])  # fmt: skip
def test_a_finding_quotes_the_numbers_that_the_json_has(key: str, path: tuple[str, ...], scale: float) -> None:
    found = told("errata")[key]
    value = found["numbers"]
    for name in path:
        value = value[name]
    assert all(written(scale * x) in found["finding"] for x in leaves(value))


def test_at_rest_both_forms_of_9_16_have_the_poles_of_the_design() -> None:
    hold = mfc.trajectories.ToolHold(arm().pose(POSE))
    design = np.poly(np.tile(np.roots([1, GAINS["kd"], GAINS["kp"], GAINS["ki"]]), 6)).real
    for form in ("standard", "printed"):
        loop = mfc.ClosedLoop(arm(), mfc.laws.TaskComputedTorque(**GAINS, form=form), hold, q_start=POSE)
        assert_allclose(np.poly(loop.linearize([0.0]).poles()[0]).real, design, rtol=1e-6)
    n = told("errata")["misprint-9-16"]["numbers"]
    assert n["printed"]["away"] > 1.0 > 1e-6 > n["standard"]["away"]  # and on the moving path they have not


def test_the_misplaced_bias_acts_as_gravity_on_the_motion_directions() -> None:
    rest = errata.hybrid_loop(form="printed_eta").equilibrium()
    Lambda, eta, A = arm().task_inertia(rest.q), arm().task_bias(rest.q, np.zeros(6)), errata.NORMAL
    mobility = np.linalg.inv(Lambda)
    P = np.eye(6) - A.T @ np.linalg.solve(A @ mobility @ A.T, A @ mobility)
    assert_allclose(P @ Lambda @ (errata.KP * rest.error), P @ (eta + rest.force), atol=1e-6)  # Newton's residual, of some 100 N
    assert np.linalg.norm(P @ eta) > 10.0 and np.abs(rest.error).max() > 0.01
    assert_allclose(errata.at_rest("printed_eta").error, rest.error, atol=1e-12)
    assert_allclose(errata.at_rest("standard").error, 0.0, atol=1e-12)


def test_the_heading_names_every_misprint_whose_printed_side_fails_and_no_other() -> None:
    top, *_ = errata.sections()
    lost = [s.title for s in top.sections for b in s.body if isinstance(b, errata.Compare) and b.left.note == "not stable"]
    assert str(len(top.sections)) in top.finding and all(title in top.finding for title in lost)
    assert not [s.title for s in top.sections if s.title in top.finding and s.title not in lost]
    assert all(
        b.left.badge is Badge.DEMO and b.right.badge is None and not b.right.note
        for s in top.sections
        for b in s.body
        if isinstance(b, errata.Compare)
    )


def test_every_slip_of_the_text_has_its_place_and_two_different_readings() -> None:
    places = [place for place, _, _ in errata.SLIPS]
    assert {"9.1", "9.7", "9.12", "9.17", "9.18", "9.19", "9.24", "exercise 9.3"} <= set(places)
    assert all(printed != meant for _, printed, meant in errata.SLIPS)
    (table,) = told("errata")["slips"]["tables"]
    assert [row[0] for row in table["rows"]] == places and told("errata")["slips"]["finding"].startswith(str(len(places)))
