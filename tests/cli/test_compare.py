"""``mfc-analysis compare``: its tables, and pictures in the folder asked for and nowhere else."""

from __future__ import annotations

from tests.cli.commands import run, small


def test_compare_says_what_changed_and_draws_where_it_is_told(tmp_path):
    first, second = (
        small(tmp_path, more="[hardware]\ndelay = 0.002\n"),
        small(tmp_path, 40.0, "[hardware]\ndelay = 0.004\ntorque_lag = 1e-3\n", "b.toml"),
    )
    done = run("compare", first, second, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    for said in ("hardware.delay", "requirements.phase_deg", "what each change did", "b.toml: what each imperfection costs", "all together"):
        assert said in done.stdout
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["costs-changes-1.svg", "costs-first-1.svg", "costs-second-1.svg"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.toml", "out", "small.toml"]
    assert "Where the phase margin went" in (tmp_path / "out" / "costs-first-1.svg").read_text()
    assert "the same loop and requirements" in run("compare", first, first).stdout
