"""The document of a test run, without pytest: order, expected failures, lost evidence, the same bytes."""

import pickle

import pytest
from scipy.special import lambertw

import mfc_analysis as mfc
from mfc_analysis.report.document.verdict import verdict
from mfc_analysis.report.render.write import rendered
from mfc_analysis.report.verification import record, verification_document, with_outcomes
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
    assert rendered(one, ("json",)) == rendered(other, ("json",))


def test_a_failure_counts_unless_its_test_passed(records):
    for outcome, status in (("failed", "FAIL"), ("passed", "PASS"), ("", "FAIL")):
        document = verification_document(with_outcomes(records, {"a.py::first": outcome}))
        assert verdict(document).status == status
    assert "1 failed" in document.subtitle


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
