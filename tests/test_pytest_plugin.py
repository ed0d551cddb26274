"""The plugin in runs of its own: what the report says of failing, passing and expected failures, alone and under xdist."""

import json
from importlib.metadata import entry_points

import pytest

pytest_plugins = ["pytester"]

LOOPS = """
import pytest
import mfc_analysis as mfc
from mfc_analysis.testing import assert_margins, assert_stable, assert_validated

def velocity_p(k=5.0):
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.3]))

def unstable():
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 100.0, 2.0), mfc.trajectories.Hold([0.3]))
"""


@pytest.fixture
def run(pytester):
    """Runs a test file in another process; returns the result and the report's JSON (None where there is none)."""
    named = any(point.value == "mfc_analysis.pytest_plugin" for point in entry_points(group="pytest11"))

    def go(tests: str, *arguments: str, formats: str = "json"):
        pytester.makepyfile(test_arm=LOOPS + tests)
        load = () if named else ("-p", "mfc_analysis.pytest_plugin")
        result = pytester.runpytest_subprocess(*load, "-p", "no:cacheprovider", "--mfc-report=out", f"--mfc-report-formats={formats}", *arguments)
        path = pytester.path / "out" / "verification.json"
        return result, json.loads(path.read_text()) if path.exists() else None

    return go


def sections(report) -> dict:
    return {s["title"]: s for s in report["sections"]}


FAILING = """
def test_too_much():
    assert_margins(velocity_p(), phase_deg=95)

def test_unstable():
    assert_stable(unstable())

def test_good():
    assert_margins(velocity_p(), phase_deg=89, delay=0.3)
"""


def test_failures_are_in_the_report_with_test_asked_found_and_replay(run):
    result, report = run(FAILING)
    result.assert_outcomes(failed=2, passed=1)
    result.stdout.fnmatch_lines(["*phase margin is 90 deg (joint, t = 0 s), asked at least 95 deg", "*to reproduce it:", "*laws.VelocityP(kp=5.0)*"])
    result.stdout.fnmatch_lines(["*verification report of 3 assertions, 2 failed:", "*verification.json"])
    found = sections(report)
    assert set(found) == {"test_arm.py::test_too_much", "test_arm.py::test_unstable", "test_arm.py::test_good"}
    bad = found["test_arm.py::test_too_much"]
    assert bad["status"] == "FAIL" and "95" in json.dumps(bad) and "90" in json.dumps(bad)
    assert found["test_arm.py::test_unstable"]["status"] == "FAIL"
    assert found["test_arm.py::test_good"]["status"] == "PASS"
    assert report["verdict"]["status"] == "FAIL"


def test_xdist_gives_the_same_report_as_one_process(run, pytester):
    pytest.importorskip("xdist")
    run(FAILING)
    alone = (pytester.path / "out" / "verification.json").read_bytes()
    (pytester.path / "out" / "verification.json").unlink()
    result, _ = run(FAILING, "-n", "2")
    result.assert_outcomes(failed=2, passed=1)
    assert (pytester.path / "out" / "verification.json").read_bytes() == alone


def test_a_worker_that_crashes_leaves_a_report_that_says_it_is_not_complete(run):
    pytest.importorskip("xdist")
    result, report = run(
        "\ndef test_crash():\n    assert_stable(velocity_p())\n    import os\n    os._exit(3)\n", "-n", "1", "--max-worker-restart=0"
    )
    assert result.ret != 0
    assert "Missing evidence" in sections(report) and report["verdict"]["status"] == "FAIL"
    result.stdout.fnmatch_lines(["*ended without passing on its assertions*"])


def test_a_failure_that_the_test_expects_is_shown_and_does_not_count(run):
    result, report = run(
        """
def test_expected():
    assert_stable(velocity_p())
    with pytest.raises(AssertionError):
        assert_stable(unstable())

@pytest.mark.xfail(strict=True)
def test_known_bad():
    assert_stable(unstable())
"""
    )
    result.assert_outcomes(passed=1, xfailed=1)
    assert report["verdict"]["status"] == "PASS"
    found = sections(report)
    shown = found["test_arm.py::test_expected, assertion 2"]
    assert shown["status"] == "DEMO" and {c["status"] for c in shown["checks"]} == {"FAIL"}
    assert "expected" in json.dumps(found["test_arm.py::test_known_bad"])


def test_a_marker_names_the_requirement_and_a_failure_says_what_would_make_it_pass(run):
    result, report = run(
        """
@pytest.mark.mfc_requirement("REQ-7", rationale="the tool must not ring")
def test_late():
    late = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(5.0), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(delay=0.2))
    assert_margins(late, phase_deg=45)

def test_a_good_one():
    assert_margins(velocity_p(), phase_deg=45)
""",
        "--strict-markers", "--mfc-report-author=A. Author", "--mfc-report-revision=r42", "--mfc-report-date=2026-11-27",
    )  # fmt: skip
    result.assert_outcomes(failed=1, passed=1)
    assert [s["title"] for s in report["sections"]] == ["Requirements and their tests", "test_arm.py::test_late", "test_arm.py::test_a_good_one"]
    late = report["sections"][1]["numbers"]
    assert (late["requirement"], late["rationale"]) == ("REQ-7", "the tool must not ring")
    assert late["would_pass"][0]["name"] == "dead time" and late["would_pass"][0]["limit"].startswith("0.1571 s")
    assert report["subtitle"].endswith("by A. Author, r42, 2026-11-27") and report["provenance"]["items"]["date"] == "2026-11-27"


def test_all_formats_are_written_and_validation_is_evidence_too(run, pytester):
    result, report = run("\ndef test_model():\n    assert_validated(velocity_p(), 0.5)\n", formats="html,pdf,json")
    result.assert_outcomes(passed=1)
    assert (pytester.path / "out" / "verification.pdf").read_bytes().startswith(b"%PDF")
    assert "test_arm.py::test_model" in (pytester.path / "out" / "verification.html").read_text()
    assert "nrmse" in json.dumps(report)


def test_without_assertions_nothing_is_written_and_that_is_said(run, pytester):
    result, report = run("\ndef test_nothing():\n    pass\n")
    result.assert_outcomes(passed=1)
    assert report is None and not (pytester.path / "out").exists()
    result.stdout.fnmatch_lines(["no assertion of mfc_analysis.testing was made*"])


def test_a_wrong_format_ends_the_run_before_it_begins(run):
    result, report = run("\ndef test_nothing():\n    pass\n", formats="html,docx")
    assert result.ret == pytest.ExitCode.USAGE_ERROR and report is None
    result.stderr.fnmatch_lines(["*--mfc-report-formats: got 'docx'; takes some of html,pdf,json*"])


def test_a_folder_that_is_a_file_ends_the_run_before_it_begins(run, pytester):
    (pytester.path / "out").write_text("")
    result, _ = run("\ndef test_nothing():\n    pass\n")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*takes an output folder*"])


def test_hostile_names_stay_text_and_nothing_is_written_outside(run, pytester):
    result, _ = run(
        """
@pytest.mark.parametrize("name", ["<script>alert(1)</script>", "../../up", "$x$ #y"])
def test_named(name):
    assert_stable(velocity_p())
""",
        formats="html,pdf,json",
    )
    result.assert_outcomes(passed=3)
    page = (pytester.path / "out" / "verification.html").read_text()
    assert "<script>alert(1)" not in page and "&lt;script&gt;alert(1)" in page
    assert len([*pytester.path.rglob("*verification*")]) == 3
    assert sorted(p.name for p in (pytester.path / "out").iterdir()) == ["verification.html", "verification.json", "verification.pdf"]


def test_the_plugin_costs_nothing_where_no_report_is_asked_for(pytester):
    pytester.makepyfile(
        "def test_light():\n    import sys\n    assert not {'numpy', 'scipy', 'pinocchio', 'control', 'matplotlib'} & set(sys.modules)\n"
    )
    load = () if any(p.value == "mfc_analysis.pytest_plugin" for p in entry_points(group="pytest11")) else ("-p", "mfc_analysis.pytest_plugin")
    result = pytester.runpytest_subprocess(*load, "-p", "no:cacheprovider", "-p", "no:hypothesispytest")
    result.assert_outcomes(passed=1)
