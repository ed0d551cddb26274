"""``mfc-analysis frf``: from a CSV file to a response, and beside a study to a verdict."""

from __future__ import annotations

import re

from tests.cli.commands import run
from tests.study.test_measured import TEXT, run as record


def test_a_csv_file_gives_a_table_and_a_figure(tmp_path):
    record(tmp_path)
    done = run("frf", tmp_path / "run.csv", "--input", "before + r", "--output=-before", "--excitation", "r", "--plot", tmp_path / "a.svg")
    assert done.exit_code == 0, done.output
    assert "coherence above 0.8" in done.stdout and "gain [dB]" in done.stdout and "from the excitation r" in done.stdout
    assert (tmp_path / "a.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_beside_a_study_it_ends_with_a_verdict_and_the_margins_of_both(tmp_path):
    record(tmp_path)
    (tmp_path / "s.toml").write_text(TEXT, encoding="utf-8")
    columns = ("--input", "before + r", "--output=-before", "--excitation", "r")
    done = run("frf", tmp_path / "run.csv", *columns, "--study", tmp_path / "s.toml", "--channel", "joint")
    assert done.exit_code == 0, done.output
    assert "the model agrees with the data" in done.stdout and re.search(r"phase margin +8\d[.\d]* deg +90 deg", done.stdout)


def test_bad_input_ends_with_2_and_a_sentence(tmp_path):
    record(tmp_path)
    for options, said in (
        ((), "input: got 'u'"),
        (("--input", "r", "--output", "before", "--plot", "a.png"), "--plot: got 'a.png'"),
        (("--averages", "1"), "--averages: got 1"),
    ):
        done = run("frf", tmp_path / "run.csv", *options)
        assert done.exit_code == 2 and said in done.stderr and "Traceback" not in done.stderr
