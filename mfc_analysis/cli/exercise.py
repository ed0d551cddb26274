"""``mfc-analysis exercise``: answers from options, from prompts on a terminal, or by default; then the exercise."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.cli import terminal
from mfc_analysis.errors import BadArgument, UnknownName

if TYPE_CHECKING:
    from mfc_analysis.exercises import JointRun

_TARGET = ("target_deg", "desired location [deg]", 45.0)
_INVERSE = (
    _TARGET,
    ("kp", "proportional gain kp [1/s^2]", 100.0),
    ("ki", "integral gain ki [1/s^3]", 200.0),
    ("kd", "derivative gain kd [1/s]", 20.0),
    ("velocity_deg", "target velocity [deg/s] (0: a step)", 90.0),
)
#: exercise -> its questions: key, question with unit, default
QUESTIONS: dict[str, tuple[tuple[str, str, float], ...]] = {
    "9.1": (
        _TARGET,
        ("kp", "proportional gain kp [N m/rad]", 50.0),
        ("ki", "integral gain ki [N m/(rad s)]", 100.0),
        ("kd", "derivative gain kd [N m s/rad]", 10.0),
    ),
    "9.2": _INVERSE,
    "9.3": _INVERSE,
    "9.4": (
        ("theta_deg", "angle theta of the revolute joint [deg]", 45.0),
        ("d", "length d of the prismatic joint [m]", 1.0),
        ("fx", "force along x [N]", 3.0),
        ("fy", "force along y [N]", 4.0),
    ),
}


def answered(number: str, given: Mapping[str, float]) -> dict[str, float]:
    """All answers of an exercise: those given, and the others from prompts on a terminal or from their defaults.

    Raises UnknownName for an unknown exercise, BadArgument for an option that it does not have.
    """
    if number not in QUESTIONS:
        raise UnknownName("exercise", number, QUESTIONS)
    keys = [key for key, _, _ in QUESTIONS[number]]
    for key, value in given.items():
        if key not in keys:
            options = ", ".join("--" + k.replace("_", "-") for k in keys)
            raise BadArgument(f"--{key.replace('_', '-')}", value, f"no value: the options of exercise {number} are {options}")
    asking = on_a_terminal()
    out = {}
    for key, question, default in QUESTIONS[number]:
        if key in given:
            out[key] = given[key]
        elif asking:
            import typer

            out[key] = typer.prompt(question, default=default, type=float)
        else:
            out[key] = default
    return out


def run(number: str, given: Mapping[str, float], link: Mapping[str, float], duration: float, out: Path | None) -> None:
    """Runs one exercise, prints its answer and writes its graph into ``out``."""
    from mfc_analysis import exercises

    answers = answered(number, given)
    assumed = set() if on_a_terminal() else set(answers) - set(given)
    terminal.pairs([(question, f"{answers[key]:g}{' (default)' if key in assumed else ''}") for key, question, _ in QUESTIONS[number]])
    if number == "9.4":
        terminal.say("")
        terminal.pairs(exercises.rp_torques(answers["theta_deg"], answers["d"], (answers["fx"], answers["fy"])).rows())
        return
    body = exercises.Link(**link)
    terminal.say("", f"link: {body}", "")
    if number == "9.3":
        both = exercises.compare(answers["target_deg"], answers["kp"], answers["ki"], answers["kd"], answers["velocity_deg"], body, duration)
        terminal.table(("", "PID (9.1)", "PID + inverse dynamics (9.2)"), both.rows())
        terminal.say(both.finding)
        runs: list[JointRun] = [both.plain, both.inverse]
    else:
        one = exercises.pid if number == "9.1" else exercises.pid_with_inverse_dynamics
        runs = [one(**answers, link=body, duration=duration)]
        terminal.pairs(runs[0].rows())
    if out is not None:
        terminal.say("", f"graph: {_graph(number, runs, out)}")


def on_a_terminal() -> bool:
    """Whether prompts can be answered."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _graph(number: str, runs: list[JointRun], out: Path) -> Path:
    from mfc_analysis import exercises, plots
    from mfc_analysis.maths import files

    out.mkdir(parents=True, exist_ok=True)
    path = out / f"exercise-{number.replace('.', '-')}.svg"
    files.write(path, plots.svg(lambda: exercises.graph(runs)).encode("utf-8"))
    return path
