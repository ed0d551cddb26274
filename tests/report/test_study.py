"""The report of a study: chosen sections, the worst of its ranges, its limits, and what a change of the study changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mfc_analysis.report import study as pages
from mfc_analysis.report.document.document import Section, Table
from mfc_analysis.requirements.line import Status
from mfc_analysis.study.check import check
from mfc_analysis.study.limits import limits
from tests.study.samples import study

K = 4.0
TEXT = """
title = "integrator"
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.2"
kp = 4.0
[reference]
kind = "Hold"
[requirements]
phase_deg = 45
"""


def over(folder: Path, delays: list[float]) -> tuple[Section, Table]:
    """The section on ranges of the dead time, and its table."""
    (found,) = check(study(folder, f"{TEXT}[ranges]\ndelay = {delays}\n"))
    made = pages.ranges_section(found)
    (table,) = made.body
    assert isinstance(table, Table)
    return made, table


def phase(delay: float) -> float:
    """[deg] of L = k exp(-s delay) / s."""
    return 90.0 - float(np.degrees(K * delay))


def test_over_ranges_the_worst_case_is_that_of_the_longest_delay(tmp_path: Path) -> None:
    section, table = over(tmp_path, [0.0, 0.05, 0.15])
    worst = section.numbers["worst"]["phase_deg"]
    assert section.numbers["cases"] == 3 and worst["found"] == pytest.approx(phase(0.15), rel=1e-9) and "0.15" in worst["case"]
    assert [row[0] for row in table.rows] == [f"delay = {x}" for x in ("0.15", "0.05", "0")]  # the worst first
    assert f"{phase(0.05):.4g} deg" in str(table.rows[1][3]) and "delay = 0.15" in str(section.finding)


def test_a_longer_delay_fails_its_case_and_no_other(tmp_path: Path) -> None:
    assert phase(0.19) > 45.0 > phase(0.21)
    section, table = over(tmp_path, [0.0, 0.19])
    assert section.badge is Status.PASS
    section, table = over(tmp_path, [0.0, 0.21])
    assert section.badge is Status.FAIL and [row[1] for row in table.rows] == [Status.FAIL, Status.PASS]


def test_of_many_cases_only_the_worst_are_shown_and_all_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "MOST_ROWS", 2)
    section, table = over(tmp_path, [0.0, 0.05, 0.1, 0.15])
    assert [row[0] for row in table.rows] == ["delay = 0.15", "delay = 0.1"] and section.numbers["cases"] == 4
    assert all(str(n) in str(table.caption) for n in (2, 4))


def test_limits_are_those_of_the_search_and_of_the_closed_form(tmp_path: Path) -> None:
    (one,) = study(tmp_path, TEXT + "[design]\nmax_delay = true\n").loops
    searched = limits(one)
    section = pages.limits_section(one.name, searched, many=False)
    ((name, limit),) = section.numbers.items()
    assert limit["value"] == pytest.approx(np.pi / (2 * K), rel=1e-6) and (limit["unit"], name) == ("s", searched[0].name)
    assert f"{limit['value']:.4f}" in str(section.finding)
    assert one.name in pages.limits_section(one.name, searched, many=True).title and one.name not in section.title


def test_only_the_sections_asked_for_stay_and_ranges_and_limits_have_their_own(tmp_path: Path) -> None:
    whole = pages.document(study(tmp_path, TEXT))
    everything = {inner.title for inner in whole.sections[0].sections}
    seen: list[str] = []
    more = '[report]\nsections = ["poles", "run"]\n[ranges]\ndelay = [0.0, 0.1]\n[design]\nmax_delay = true\n'
    some = pages.document(study(tmp_path, TEXT + more), seen.append)
    assert {inner.title for inner in some.sections[0].sections} == everything & {*pages.PAGES["poles"], *pages.PAGES["run"]}
    assert everything <= {title for titles in pages.PAGES.values() for title in titles}  # any of them can be chosen
    assert (len(whole.sections), len(some.sections), len(seen)) == (1, 3, 1)


def test_a_measured_loop_has_a_section_with_its_verdict_and_the_margins_of_both(tmp_path: Path) -> None:
    from mfc_analysis.report.document.document import Figure
    from tests.study.test_measured import TEXT as MEASURED, run

    run(tmp_path, late=50)
    found = pages.document(study(tmp_path, MEASURED + "[report]\nsections = []\n"))
    section = next(s for s in found.sections if s.title == "Measured and model")
    _, figure, table = section.body
    assert isinstance(figure, Figure) and isinstance(table, Table)
    assert "optimistic" in str(section.finding) and section.numbers["verdict"] in str(section.finding).replace("The model", "the model")
    assert table.rows[0][0] == "phase margin" and section.numbers["margins"]["phase_deg"]["model"] == pytest.approx(90.0)
    assert "r (no bias by feedback)" in str(section.body[0]) and len(figure.draw()) == 3


# --- what would make it pass, and gains --------------------------------------------------------------------------------------


def test_what_would_make_it_pass_has_the_limits_the_costs_and_the_bars(tmp_path: Path) -> None:
    text = TEXT + "[hardware]\ndelay = 0.25\nvelocity_lag = 0.01\n[design]\nlimits = true\ntune = { kp = [0.1, 10] }\n"
    made = pages.document(study(tmp_path, text))
    section, gains = made.sections[-2:]
    assert section.title == "What would make it pass" and gains.title == "Tuned gains"
    numbers = section.numbers["largest dead time"]
    w = float(np.sqrt((np.sqrt(1 + 4 * (K * 0.01) ** 2) - 1) / 2) / 0.01)
    assert numbers["value"] == pytest.approx(float((np.pi / 4 - np.arctan(0.01 * w)) / w), rel=1e-4) and numbers["as given"] == 0.25
    assert str(section.finding).startswith("Not met as given; largest dead time: 0.18")
    assert [type(block).__name__ for block in section.body] == ["Table", "Bullets", "Figure", "Table"]
    assert gains.numbers["met"] and gains.numbers["gains"]["kp"] < K
