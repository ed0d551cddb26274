"""The sections on 9.17 and 9.18: the table of a task, and a product that no frame changes."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.laws.constraints import peg_in_hole, surface_sliding
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.report.chapter.constraints import constraint_section, unit
from mfc_analysis.report.chapter.force import POSE, arm
from mfc_analysis.report.document.document import Table, written
from mfc_analysis.requirements.line import Status
from tests.report.read import told

PAIRS = {"vx": "fx", "vy": "fy", "vz": "fz", "wx": "mx", "wy": "my", "wz": "mz"}  #: the two of one axis


@pytest.mark.parametrize("key", ["peg-in-hole", "surface-sliding"])
def test_along_each_axis_nature_fixes_one_of_motion_and_force_and_the_controller_the_other(key: str) -> None:
    n = told("constraints")[key]["numbers"]
    for motion, force in PAIRS.items():
        assert {motion in n["natural"], force in n["natural"]} == {True, False}
        assert (motion in n["artificial"]) == (force in n["natural"])


def test_another_speed_or_force_changes_one_cell_of_the_table_and_nothing_else() -> None:
    def rows(given: object) -> list[tuple]:
        (table, *_) = (b for b in constraint_section("t", given, "k").body if isinstance(b, Table))
        return list(table.rows)

    for slow, fast, axis, said in (
        (peg_in_hole(insertion_speed=0.01), peg_in_hole(insertion_speed=0.035), "z", "vz = 0.035 m/s"),
        (surface_sliding(force=20.0), surface_sliding(force=27.5), "z", "fz = 27.5 N"),
    ):
        changed = [b for a, b in zip(rows(slow), rows(fast), strict=True) if a != b]
        assert [(row[0], row[2]) for row in changed] == [(axis, said)]


def test_the_projector_has_the_free_directions_as_its_rank_and_annihilates_the_constraint_wrenches() -> None:
    section = constraint_section("t", peg_in_hole(), "k")
    A, Lambda = np.asarray(section.numbers["rows"]), arm().task_inertia(POSE)
    mobility = np.linalg.inv(Lambda)
    P = np.eye(6) - A.T @ np.linalg.solve(A @ mobility @ A.T, A @ mobility)
    assert section.numbers["projector"]["rank of P"] == np.linalg.matrix_rank(P, tol=1e-6) == section.numbers["rank_free"]
    assert np.abs(P @ A.T).max() < 1e-12 and {c.status for c in section.proofs} == {Status.PASS}


def test_components_of_twists_and_wrenches_have_their_units() -> None:
    assert [unit(x) for x in ("vx", "wz", "fy", "mx")] == ["m/s", "rad/s", "N", "Nm"]


def test_the_finding_tells_the_distance_of_the_frame_and_both_products() -> None:
    found = told("constraints")["reciprocity"]
    n = found["numbers"]
    frame = exp6(np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6]))
    said = (f"{np.linalg.norm(frame[:3, 3]):.2f} m", written(n["change_of_work"], 2), written(n["change_of_twist_product"]))
    assert all(x in found["finding"] for x in said)
