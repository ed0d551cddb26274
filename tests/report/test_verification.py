"""The document of a test run, without pytest: order, expected failures, lost evidence, the same bytes."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.report.document.document import Badge, Table
from mfc_analysis.report.document.verdict import verdict
from mfc_analysis.report.render.write import rendered
from mfc_analysis.report.verification import Origin, record, relief, verification_document, with_outcomes
from mfc_analysis.testing import assert_margins, assert_stable, assert_validated, observed
from tests.requirements.test_requirements import hold, velocity_p


def unstable():
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 100.0, 2.0), hold())


@pytest.fixture
def records():
    seen = []
    with observed(seen.append):
        assert_margins(velocity_p(), [0.0], phase_deg=45)
        with pytest.raises(AssertionError):
            assert_stable(unstable())
        assert_validated(velocity_p(), 0.2)
    names = ["b.py::second", "a.py::first", "c.py::third"]
    return [record(asserted, name, 0) for asserted, name in zip(seen, names, strict=True)]


def test_sections_stand_in_the_order_of_the_tests_names_whoever_ran_them_when(records):
    outcomes = {"a.py::first": "failed", "b.py::second": "passed", "c.py::third": "passed"}
    one = verification_document(with_outcomes(records, outcomes))
    other = verification_document(with_outcomes(pickle.loads(pickle.dumps(records[::-1])), outcomes))
    assert [s.title for s in one.sections] == ["a.py::first", "b.py::second", "c.py::third"]
    late = verification_document(with_outcomes(records, outcomes | {"a.py::first": "passed"}))
    assert late.sections[0].title == "a.py::first" and late.sections[0].badge is Badge.DEMO  # expected: in the order of the names
    assert rendered(one, ("json",)) == rendered(other, ("json",))


def test_a_failure_counts_unless_its_test_passed(records):
    for outcome, status in (("failed", "FAIL"), ("passed", "PASS"), ("", "FAIL")):
        document = verification_document(with_outcomes(records, {"a.py::first": outcome}))
        assert verdict(document).status == status
    assert "1 failed" in document.subtitle


def test_failures_stand_first_and_an_id_a_rationale_and_the_origin_are_told(records):
    marked = [replace(r, requirement=f"REQ-{k}", rationale="the arm must not ring" if k == 0 else "") for k, r in enumerate(records)]
    named = [replace(marked[1], test="z.py::last"), marked[0], marked[2]]
    document = verification_document(with_outcomes(named, {"z.py::last": "failed"}), origin=Origin("A. Author", "r42", "2026-11-27"))
    assert [s.title for s in document.sections] == ["z.py::last", "b.py::second", "c.py::third"]
    assert document.subtitle.endswith("1 failed; by A. Author, r42, 2026-11-27")
    assert dict(document.provenance.items)["revision"] == "r42" and dict(document.provenance.items)["date"] == "2026-11-27"
    (table,) = document.front[0].body
    assert [row[:3] for row in table.rows] == [("REQ-1", "FAIL", ""), ("REQ-0", "PASS", "the arm must not ring"), ("REQ-2", "PASS", "")]
    data = json.loads(rendered(document, ("json",))["json"])
    assert next(s for s in data["sections"] if s["title"] == "b.py::second")["numbers"]["rationale"] == "the arm must not ring"
    assert verification_document(records).front == ()


def test_what_would_make_it_pass_is_the_limit_of_the_closed_form():
    """9.2 with dead time: the phase margin is 90 degrees less k T, so that 45 degrees need k T <= pi / 4."""
    k, T = 5.0, 0.2
    seen = []
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(k), hold(), hardware=mfc.Hardware(delay=T))
    with observed(seen.append), pytest.raises(AssertionError):
        assert_margins(loop, [0.0], phase_deg=45)
    late, bandwidth = found = relief(seen[0])
    assert (late.name, late.given, bandwidth.name) == ("dead time", "0.2 s", "bandwidth of the gains")
    assert late.limit == f"{np.pi / 4 / k:.4g} s" and bandwidth.limit == f"{np.pi / 4 / (k * T):.4g} times"
    made = replace(record(seen[0], "t", 0), relief=found, outcome="failed")
    (section,) = verification_document([made]).sections
    (table,) = (b for b in section.body if isinstance(b, Table) and str(b.caption).startswith("What would make it pass"))
    assert table.rows == tuple((x.name, x.given, x.limit, x.why) for x in found) and section.numbers["would_pass"][0]["limit"] == late.limit
    (expected,) = verification_document([replace(made, outcome="passed")]).sections
    assert not any(isinstance(b, Table) and "make it pass" in str(b.caption) for b in expected.body)


def test_what_would_make_a_force_loop_pass_is_the_factor_on_its_force_gains_of_the_closed_form():
    """9.22: m s^3 + b s^2 + k (1 + kfp) s + k kfi is stable for m kfi < b (1 + kfp), on any wall, so that a softer one does not help."""
    m, b, kfp, kfi = 2.0, 6.0, 0.5, 10.0
    only_z = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    wall = mfc.Environment(1e4, axes="z", preload=5.0)
    law = mfc.laws.ForcePI(5.0 * only_z, kfp=kfp * only_z, kfi=kfi * only_z)
    seen = []
    with observed(seen.append), pytest.raises(AssertionError):
        assert_stable(mfc.ClosedLoop(mfc.robots.slider(mass=m, friction=b), law, hold(), environment=wall))
    stiffness, gains = relief(seen[0])
    assert (stiffness.name, stiffness.limit, gains.name) == ("stiffness of the wall", "no value", "gains of the force error")
    assert gains.limit == f"{b / (m * kfi - b * kfp):.4g} times" and gains.given == "1 (as given)"


def test_what_nothing_eases_is_told_and_a_met_assertion_needs_nothing():
    seen = []
    with observed(seen.append):
        with pytest.raises(AssertionError):
            assert_margins(velocity_p(), [0.0], phase_deg=95)  # an integrator has 90
        assert_margins(velocity_p(), [0.0], phase_deg=45)
    (only,) = relief(seen[0])
    assert only.limit == "no value" and only.name == "bandwidth of the gains" and relief(seen[1]) == ()


def test_lost_evidence_fails_the_report(records):
    document = verification_document(with_outcomes(records[:1], {}), ["worker gw1"])
    assert verdict(document).status == "FAIL" and "gw1" in str(document.sections[0].finding)


def test_each_section_has_its_evidence_and_its_replay(records):
    found = {s.title: s for s in verification_document(with_outcomes(records, {})).sections}
    assert found["b.py::second"].numbers["phase_deg"][0, 0] == pytest.approx(90.0)
    assert found["c.py::third"].numbers["taylor_order"] == float("inf")
    for section in found.values():
        assert any("mfc.ClosedLoop(" in getattr(block, "text", "") for block in section.body if isinstance(getattr(block, "text", ""), str))


def test_of_a_loop_with_dead_time_the_roots_with_it_are_shown():
    """9.2 with k T = 2 > pi/2: the roots of s + k exp(-s T) are Lambert's W(-k T) / T; the pole without dead time is at -20."""
    made = []
    late = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(20.0), hold(), hardware=mfc.Hardware(delay=0.1))
    with observed(lambda a: made.append(record(a, "t", 0))), pytest.raises(AssertionError):
        assert_stable(late)
    assert made[0].poles[0] == pytest.approx(complex(lambertw(-2.0, 0)) / 0.1)
    page = rendered(verification_document(made), ("html",))["html"].decode()
    assert "rightmost characteristic roots, dead time included" in page and "closed-loop poles" not in page
