"""``mfc-analysis export``: into a parameter file that exists, out of it, and what is refused."""

from __future__ import annotations

from tests.cli.commands import run, small


def test_the_gains_go_into_a_file_and_come_back(tmp_path):
    path, out, again = small(tmp_path), tmp_path / "arm.yaml", tmp_path / "again.toml"
    out.write_text("# mine\nother:\n  ros__parameters: {a: 1}\n", encoding="utf-8")
    done = run("export", path, "--to", "ros2_control", "--out", out)
    assert done.exit_code == 0, done.output
    text = out.read_text(encoding="utf-8")
    assert text.startswith("# mine\nother:") and "p: 50.0" in text and "note: gravity" in done.stderr
    done = run("export", path, "--from", out, "--out", again)
    assert done.exit_code == 0, done.output
    assert "kp = [50.0]\nki = [100.0]\nkd = [10.0]" in again.read_text(encoding="utf-8")
    assert run("check", again).stdout.splitlines()[1:] == run("check", path).stdout.splitlines()[1:]
    assert run("export", path, "--from", out, "--out", again).exit_code == 2  # never over a study


def test_without_a_file_it_is_printed(tmp_path):
    done = run("export", small(tmp_path), "--controller", "pid_controller", "--name", "arm")
    assert done.exit_code == 0 and "type: pid_controller/PidController" in done.stdout and "\narm:\n" in done.stdout


def test_bad_input_ends_with_2_and_a_sentence(tmp_path):
    path = small(tmp_path)
    for options, said in (
        (("--to", "ros1"), "--to: got 'ros1'"),
        (("--from", tmp_path / "none.yaml"), "none.yaml"),
        (("--controller", "x"), "controller"),
    ):
        done = run("export", path, *options)
        assert done.exit_code == 2 and said in done.stderr and "Traceback" not in done.stderr
