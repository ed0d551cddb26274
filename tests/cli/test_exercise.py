"""``mfc-analysis exercise``: answers from options, prompts or defaults, and what the exercise says."""

from __future__ import annotations

import re

import pytest
import typer

from mfc_analysis.cli import exercise
from mfc_analysis.cli.exercise import QUESTIONS, answered
from mfc_analysis.errors import BadArgument, UnknownName
from tests.cli.commands import run


def test_exercises_run_unattended_say_their_defaults_and_write_the_graph(tmp_path):
    done = run("exercise", "9.3", "--kp", 80, "--out", tmp_path / "o")
    assert done.exit_code == 0, done.output
    assert "(default)" in done.stdout and re.search(r"kp \[1/s\^2\] +80\n", done.stdout)
    assert "inverse dynamics" in done.stdout and "starts at q = 0 deg" in done.stdout
    assert (tmp_path / "o" / "exercise-9-3.svg").read_text(encoding="utf-8").startswith("<?xml")
    torques = run("exercise", "9.4", "--theta-deg", 90, "--d", 2)
    assert "tau = J^T F = [-6 N m, 4 N]" in torques.stdout
    unstable = run("exercise", "9.1", "--ki", 5000)
    assert "NOT STABLE" in unstable.stdout and "lower ki below" in unstable.stdout
    assert run("exercise", "9.9").exit_code == 2
    assert run("exercise", "9.1", "--fx", 1).exit_code == 2


@pytest.mark.parametrize("number", QUESTIONS)
def test_what_is_not_given_is_the_default_where_nobody_can_answer(number, monkeypatch):
    monkeypatch.setattr(exercise, "on_a_terminal", lambda: False)
    monkeypatch.setattr(typer, "prompt", lambda *_, **__: pytest.fail("asked"))
    defaults = {key: default for key, _, default in QUESTIONS[number]}
    first = next(iter(defaults))
    assert answered(number, {}) == defaults
    assert answered(number, {first: -3.0}) == {**defaults, first: -3.0}


def test_on_a_terminal_only_what_is_not_given_is_asked_for_with_its_unit_and_default(monkeypatch):
    asked = {}

    def prompt(question: str, default: float, type: type) -> float:
        asked[question] = default
        return type(default + 1)

    monkeypatch.setattr(exercise, "on_a_terminal", lambda: True)
    monkeypatch.setattr(typer, "prompt", prompt)
    found = answered("9.4", {"d": 2.0, "fy": 0.0})
    assert found == {"theta_deg": 46.0, "d": 2.0, "fx": 4.0, "fy": 0.0}
    assert asked == {"angle theta of the revolute joint [deg]": 45.0, "force along x [N]": 3.0}


def test_an_exercise_or_an_answer_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(UnknownName) as why:
        answered("9.5", {})
    assert why.value.known == ("9.1", "9.2", "9.3", "9.4")
    with pytest.raises(BadArgument) as refused:
        answered("9.4", {"target_deg": 3.0})
    assert refused.value.argument == "--target-deg" and "--theta-deg, --d, --fx, --fy" in refused.value.takes


@pytest.mark.parametrize(("number", "graph"), [("9.1", True), ("9.2", True), ("9.4", False)])
def test_an_exercise_with_a_motion_writes_its_graph_and_one_without_nothing(tmp_path, number, graph):
    done = run("exercise", number, "--out", tmp_path / "o")
    assert done.exit_code == 0, done.output
    files = [path.name for path in tmp_path.rglob("*.svg")]
    assert files == ([f"exercise-{number.replace('.', '-')}.svg"] if graph else [])
    assert all(name in done.stdout for name in files)


def test_zeros_of_an_answer_are_zeros():
    said = run("exercise", "9.4", "--theta-deg", 90, "--d", 0, "--fx", 3, "--fy", 4).stdout
    assert "J = [[0, 0], [0, 1]]" in said and "tau = J^T F = [0 N m, 4 N]" in said
