"""A command line to run, and a small study to run it on."""

from __future__ import annotations

from pathlib import Path

from click.testing import Result
from typer.testing import CliRunner

from mfc_analysis.cli.app import app

SMALL = """
title = "small"
q_start = [0.3]
[robot]
name = "single_joint"
[law]
equation = "9.8"
kp = 50.0
ki = 100.0
kd = 10.0
[reference]
kind = "Hold"
[requirements]
phase_deg = {phase}
"""


def run(*args: object) -> Result:
    """The command with these arguments: exit code and what it said."""
    return CliRunner().invoke(app, [str(a) for a in args])


def small(folder: Path, phase: float = 30.0, more: str = "", name: str = "small.toml") -> Path:
    """A study of one joint that asks for this phase margin [deg]; ``more``: tables at its end."""
    path = folder / name
    path.write_text(SMALL.format(phase=phase) + more, encoding="utf-8")
    return path
