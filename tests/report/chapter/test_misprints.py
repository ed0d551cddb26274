"""The misprints of the joint-space equations: what they cost follows the gains, the arm and gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.report.chapter import misprints
from mfc_analysis.report.chapter.arms import Designs, arms
from mfc_analysis.report.document.document import Badge, Compare, written
from mfc_analysis.robots.catalogue import planar_2r
from mfc_analysis.trajectories import Hold
from tests.report.read import told


def compared(section: misprints.Section) -> Compare:
    (found,) = (b for b in section.body if isinstance(b, Compare))
    return found


def test_an_integral_gain_that_is_the_identity_makes_both_forms_of_9_3_one() -> None:
    velocity = {**Designs().velocity, "9.3": {"kp": 6.0, "ki": 1.0}}
    n = misprints.velocity_pi(Designs(velocity)).numbers
    assert_allclose(n["printed"]["poles"], n["standard"]["poles"], rtol=1e-12)
    assert n["printed"]["largest_error"] == pytest.approx(n["standard"]["largest_error"], rel=1e-9)
    other = misprints.velocity_pi(Designs({**velocity, "9.3": {"kp": 6.0, "ki": 9.0}})).numbers
    assert_allclose(other["printed"]["poles"], n["printed"]["poles"], rtol=1e-12)  # whatever was meant
    assert_allclose(np.poly(other["standard"]["poles"]), [1.0, 6.0, 9.0], rtol=1e-12)


def test_the_slowest_upright_triple_pole_goes_with_the_root_of_gravity_and_hanging_there_is_none() -> None:
    def limit(gravity: float, q: float) -> float:
        robot = planar_2r(gravity=gravity)
        return misprints.slowest_printed(replace(arms()[1], robot=robot, model=robot, ref=Hold([q, 0.0])))

    assert limit(4 * 9.81, np.pi / 2) == pytest.approx(2 * limit(9.81, np.pi / 2), rel=2e-4)  # both to 1e-4
    assert limit(9.81, -np.pi / 2) == pytest.approx(0.05, rel=1e-3)  # where the search begins


def test_where_the_page_prints_q_d_the_joint_follows_its_integral() -> None:
    section = misprints.velocity_feedforward(Designs())
    n, ref = section.numbers, arms()[0].ref
    t = np.linspace(0.0, 4.0, 40001)
    q_d = ref(t).q[:, 0]
    q = q_d[0] - misprints.OFFSET + float(np.sum((q_d[1:] + q_d[:-1]) / 2 * np.diff(t)))
    assert n["printed"]["last_error"] == pytest.approx(abs(q_d[-1] - q), rel=1e-5)
    assert n["standard"]["last_error"] == pytest.approx(misprints.OFFSET, abs=1e-6)  # the tolerance of the run
    assert all(written(n[form]["last_error"]) in str(compared(section).cost) for form in ("printed", "standard"))


def test_the_cost_of_each_misprint_quotes_both_rightmost_roots() -> None:
    for make in (misprints.velocity_pi, misprints.torque_feedforward, misprints.computed_torque):
        section = make(Designs())
        assert all(written(section.numbers[form]["rightmost"]) in str(compared(section).cost) for form in ("printed", "standard"))


def test_the_heading_names_the_misprint_that_makes_a_stable_loop_unstable_and_no_other() -> None:
    found = told("misprints")
    lost = [key for key, s in found.items() if s["numbers"] and s["numbers"]["standard"]["stable"] and not s["numbers"]["printed"]["stable"]]
    assert lost == ["misprint-9-12"]
    assert [key for key, s in found.items() if s["title"] in found["misprints"]["finding"]] == lost
    side = compared(misprints.triple(Designs()))
    assert (side.left.badge, side.left.note, side.right.badge, side.right.note) == (Badge.DEMO, "not stable", None, "")
