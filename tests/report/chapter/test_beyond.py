"""The sections beyond the chapter: what they say is what the loops do, on both sides of each limit."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mfc_analysis.report.chapter import beyond
from mfc_analysis.report.document.document import written
from mfc_analysis.requirements.line import Status


def table(section, word: str):
    return next(block for block in section.body if word in getattr(block, "caption", "") and hasattr(block, "rows"))


def test_an_impedance_behind_a_lag_is_stable_and_passive_above_t_k_only() -> None:
    found = beyond.impedance_section()
    rows = [[str(cell) for cell in row] for row in table(found, "One mass").rows]
    assert [row[2:] for row in rows] == [["unstable", "0 of 3", "not passive"]] * 2 + [["stable", "3 of 3", "passive"]] * 2
    assert all(proof.status is Status.PASS for proof in found.proofs) and "T K = 10 Ns/m" in found.finding
    assert pickle.loads(pickle.dumps(found)).finding == found.finding  # from the process that made it


@pytest.fixture(scope="module")
def admittance():
    return beyond.admittance_section()


def test_the_stiffest_wall_of_the_admittance_is_a_boundary_of_its_roots(admittance) -> None:
    limit = admittance.numbers["limit"]
    for part, decays in ((0.999, True), (1.001, False)):
        z = beyond.admittance_loop(part * limit).linearize([0.0]).poles()[0]
        assert (np.abs(z).max() < 1) == decays
    assert written(limit / 1e3) in admittance.finding and admittance.proofs[0].status is Status.PASS


def test_one_direction_through_a_servo_with_dead_time_has_that_limit(admittance) -> None:
    """s (m s + D)(s^2 + 2 zeta w s + w^2) + (k + c s) w^2 e^(-s T) = 0 with s = j x: both parts zero at the limit without sampling."""
    k, w, zeta = admittance.numbers["chain"]["and its 16 ms of dead time"], beyond.SERVO.natural_frequency, beyond.SERVO.damping
    x = np.linspace(1.0, 60.0, 590_001)
    s = 1j * x
    wall = -s * (beyond.INERTIA * s + beyond.DAMPING) * (s**2 + 2 * zeta * w * s + w**2) / (w**2 * np.exp(-s * 0.016)) - 50.0 * s
    cross = np.flatnonzero(np.diff(np.sign(wall.imag)) != 0)
    assert min(wall.real[cross][wall.real[cross] > 0]) == pytest.approx(k, rel=1e-4)


def test_steel_is_left_again_and_again_and_rubber_never() -> None:
    found = beyond.impact_section((0.1,))
    bounces = found.numbers["bounces"][:, 0]
    assert bounces[0] == 0 and bounces[-1] > 5 and found.proofs[0].status is Status.PASS
    assert beyond.SURFACES["wood"] < found.numbers["limit"] < beyond.SURFACES["steel"]
    assert found.numbers["peak"][-1, 0] > found.numbers["peak"][0, 0]
