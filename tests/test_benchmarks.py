"""The table of run times and memory: what a row says of a measurement; the table that the guide shows has the rows and targets of today."""

from __future__ import annotations

import re

import numpy as np
import pytest

from benchmarks import floors, table
from benchmarks.__main__ import RESULTS, ROOMS, main, rows
from benchmarks.loops import chain, computed_torque
from benchmarks.table import HEADS, ROOT, Found, Row
from mfc_analysis.dynamics.jacobians import closed_system


def test_the_table_has_the_rows_references_and_targets_of_today() -> None:
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in RESULTS.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    found = [(line[0], line[2], line[5]) for line in lines if line[0] not in (HEADS[0], "---")]
    assert found == [(row.task, row.reference, row.target) for room in ROOMS for row in rows(room)]


def test_the_guide_has_no_measurements_but_those_of_the_table() -> None:
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    assert "<!-- include: benchmarks/results.md -->" in page
    assert not re.search(r"\d+ ?(%|us|ms|times|x)\b", page.partition("## Results")[2])


@pytest.mark.parametrize(("most", "ratio", "target", "met"), [
    (1.5, 1.5, "<= 1.5", "yes"), (1.5, 1.51, "<= 1.5", "no"), (1 / 20, 0.049, "<= 1/20", "yes"), (None, 7.0, "for information", ""),
    (1.5, np.nan, "<= 1.5", "no"),
])  # fmt: skip
def test_a_row_says_whether_its_target_is_met(most: float | None, ratio: float, target: str, met: str) -> None:
    row = Row("task", "reference", lambda: Found(0.0), most)
    assert row.cells(Found(2e-5, 1.3e-3, ratio)) == ("task", "20 us", "reference", "1.3 ms", f"{ratio:.3g}", target, met)


def test_a_row_without_a_reference_has_a_target_in_its_own_unit() -> None:
    row = Row("memory", "", lambda: Found(0.0), 2 * 2.0**30, unit="bytes")
    assert row.target == "<= 2 GiB"
    assert row.cells(Found(900 * 2.0**20))[1:] == ("900 MiB", "", "", "", "<= 2 GiB", "yes")
    assert row.cells(Found(3 * 2.0**30))[-1] == "no"
    assert row.cells("measured with --all")[1:] == ("measured with --all", "", "", "", "<= 2 GiB", "")


@pytest.mark.parametrize(("value", "unit", "said"), [
    (2.67e-5, "s", "26.7 us"), (0.0123, "s", "12.3 ms"), (3.0, "s", "3 s"), (1234.0, "s", "1234 s"), (2560.0, "bytes/point", "2.5 KiB/point"),
])  # fmt: skip
def test_times_and_memory_have_a_prefix(value: float, unit: str, said: str) -> None:
    assert table.shown(value, unit) == said


def test_a_ratio_is_that_of_the_times_of_a_point() -> None:
    now = [0.0]

    def lasts(seconds: float) -> None:
        now[0] += seconds

    found = table.paired(lambda: lasts(0.02), lambda: lasts(0.04), 4, 2, lambda: now[0])
    assert (found.ours, found.reference, found.ratio) == pytest.approx((0.005, 0.02, 0.25))


@pytest.mark.parametrize("loop", [computed_torque(), computed_torque("xarm7"), chain(3)], ids=["ur5", "xarm7", "chain"])
def test_the_bare_loop_gives_the_same_a_and_b(loop) -> None:
    times = np.array([0.0, 0.7, 1.9])
    found = closed_system(loop.equations, times, loop.linearize(times).point.x)
    for ours, floor in zip(found[:2], floors.joint_loop(loop, times, inputs=True)(), strict=True):
        np.testing.assert_allclose(floor, ours, rtol=1e-9, atol=1e-9 * np.abs(ours).max())


def test_memory_is_that_of_a_process_of_its_own() -> None:
    held = np.ones(40_000_000)  # of this process
    before, most = table.peak("begin()\nb'1' * 300_000_000")
    assert before < 100e6 and 250e6 < most - before < 350e6 < held.nbytes + 100e6


def test_the_command_measures_the_rooms_asked_for(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "cli"])
    main()
    said = capsys.readouterr().out
    assert "import mfc_analysis" in said and "one BLAS thread" in said
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "cli", "--write"])
    with pytest.raises(SystemExit):
        main()
