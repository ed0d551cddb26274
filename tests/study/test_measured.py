"""Signals of a CSV file, by name and number, and their response beside the model of a study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.study.measured import columns, compared, response, signal
from mfc_analysis.study.schema import MeasuredTable
from tests.study.samples import refused, study

K, DT = 4.0, 2e-3
TEXT = """
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.2"
kp = 4.0
[reference]
kind = "Hold"
[measured]
file = "run.csv"
input = "before + r"
output = "-before"
excitation = "r"
period = 10.0
"""


def run(folder: Path, name: str = "run.csv", late: int = 0) -> np.ndarray:
    """A record of three periods: u = before + r, before = -K z, z' = u of the step before, ``late`` samples late. So L = K DT z^-late / (z - 1)."""
    N = 20_000
    lines = np.unique(np.round(np.geomspace(2, 1500, 90)))
    r = np.cos(2 * np.pi * np.outer(np.arange(N) * DT, lines) / 10.0 + lines**2).sum(axis=1)
    before, z, u = np.zeros(N), 0.0, np.zeros(N)
    for k in range(N):
        before[k] = -K * z
        u[k] = before[k] + r[k]
        z += DT * (u[k - late] if k >= late else 0.0)
    table = np.column_stack([np.arange(N) * DT, before, r])[N // 4 :]
    np.savetxt(folder / name, table, delimiter=",", header="t,before,r", comments="", fmt="%.12g")
    return table


def test_columns_have_the_names_of_the_first_line_or_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('# log\n"t"; tau 1 ;r\n\n0;1;2\n0.1;3;4\n', encoding="utf-8")
    found = columns(tmp_path / "a.csv")
    assert list(found) == ["t", "tau 1", "r"]
    assert_allclose(found["tau 1"], [1, 3])
    (tmp_path / "b.csv").write_text("0 1 2\n0.1 3 4\n", encoding="utf-8")
    assert_allclose(columns(tmp_path / "b.csv")["3"], [2, 4])
    assert_allclose(signal("input", "tau 1 + r", found), [3, 7])
    assert_allclose(signal("output", "-tau 1", found), [-1, -3])
    assert_allclose(signal("output", "2 - 3", found), [-1, -1])


@pytest.mark.parametrize(
    ("text", "said"),
    [("t,u\n0,1\n1,x\n", "line 3: got 'x'"), ("t,u\n0,1\n1\n", "line 3: got '1 columns'"), ("t,t\n0,1\n", "line 1"), ("", "with numbers")],
)
def test_a_bad_file_is_named_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BadArgument, match=said):
        columns(tmp_path / "a.csv")


def test_an_unknown_column_is_named_with_those_there_are(tmp_path: Path) -> None:
    run(tmp_path)
    with pytest.raises(UnknownName, match=r"output: got 'befor'.*did you mean 'before'"):
        signal("output", "-befor", columns(tmp_path / "run.csv"))
    with pytest.raises(BadArgument, match="file: got"):
        columns(tmp_path / "none.csv")


def test_a_study_compares_the_integrator_with_its_record(tmp_path: Path) -> None:
    run(tmp_path)
    (one,) = study(tmp_path, TEXT).loops
    ((found, over),) = compared(one)
    assert_allclose(found.response, K * DT / (np.exp(1j * found.frequencies * DT) - 1), rtol=1e-6)
    assert (over.at, over.channel, over.time) == ("velocity", "joint", 0.0)
    assert float(over.margins.phase_deg[0, 0]) == pytest.approx(90.0 - np.degrees(K * DT / 2), abs=0.2)  # the hold is half a sample late
    assert "agrees with the data" in over.verdict
    assert tmp_path / "run.csv" in study(tmp_path, TEXT).files()


def test_samples_of_dead_time_that_the_study_lacks_are_found(tmp_path: Path) -> None:
    run(tmp_path, late=50)
    ((_, over),) = compared(study(tmp_path, TEXT).loops[0])
    assert over.missing_delay == pytest.approx(50.5 * DT, rel=0.01) and "101 ms of dead time missing" in over.verdict


def test_the_defaults_are_those_of_the_estimate(tmp_path: Path) -> None:
    table = run(tmp_path)
    from mfc_analysis import frf

    found = response(tmp_path, MeasuredTable(file="run.csv", input="before + r", output="-before", excitation="r"))
    direct = frf.estimate(table[:, 0], table[:, 1] + table[:, 2], -table[:, 1], table[:, 2])
    assert_allclose(found.response, direct.response, rtol=1e-5)


def test_errors_name_the_key_of_the_study(tmp_path: Path) -> None:
    run(tmp_path)
    assert "measured" in refused(tmp_path, TEXT + "excitaton = 3\n").key
    (one,) = study(tmp_path, TEXT + 'channel = "elbow"\n').loops
    with pytest.raises(ValueError, match=r"measured.channel"):
        compared(one)
