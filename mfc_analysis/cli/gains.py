"""``mfc-analysis gains``: calls a design helper with the options of the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mfc_analysis.errors import BadArgument, UnknownName

if TYPE_CHECKING:
    from mfc_analysis.gains.result import Gains
    from mfc_analysis.robots.robot import Robot

KINDS = ("p", "pi", "pd", "pid", "joint-pid", "force-pi", "cartesian-damping", "impedance", "admittance")

ASKED = ("bandwidth", "natural_frequency", "crossover", "settling_time")  #: what gains are computed from: one of them
SPEEDS = "--bandwidth-hz, --natural-frequency-hz, --crossover-hz (or without -hz, in rad/s) or --settling-time"


def designed(kind: str, given: Mapping[str, Any]) -> Gains:
    """The gains of a helper from the options given, by their names with underscores.

    Raises UnknownName for an unknown kind, BadArgument for an option that the helper does not take, and the errors of the helper.
    """
    from mfc_analysis import gains

    kind = kind.replace("_", "-")
    if kind not in KINDS:
        raise UnknownName("kind", kind, KINDS)
    helper: Callable[..., Gains] = getattr(gains, kind.replace("-", "_"))
    takes = tuple(signature(helper).parameters)
    asked: dict[str, Any] = {}
    for name, value in given.items():
        key, factor = (name[:-3], 2 * math.pi) if name.endswith("_hz") else (name, 1.0)
        if key not in takes and not (key == "tool" and "robot" in takes):
            raise BadArgument(
                f"--{name.replace('_', '-')}", value, f"no value: the options of {kind} are {', '.join('--' + t.replace('_', '-') for t in takes)}"
            )
        if key in asked:
            raise BadArgument(f"--{name.replace('_', '-')}", value, f"either --{key.replace('_', '-')}-hz or --{key.replace('_', '-')}")
        if factor != 1.0 and isinstance(value, (int, float)) and not value > 0:
            raise BadArgument(f"--{name.replace('_', '-')}", value, "a number above 0, in Hz")
        if isinstance(value, str) and key not in ("robot", "tool", "step"):
            value = numbers(name, value)
        asked[key] = value if factor == 1.0 or not isinstance(value, (int, float)) else factor * value
    for name in ("stiffness", "mass"):
        if name in takes and name not in asked:
            raise BadArgument(f"--{name}", None, f"a number, required by {kind}")
    if set(ASKED) <= set(takes) and len(named := [f"--{x.replace('_', '-')}" for x in ASKED if x in asked]) != 1:
        raise BadArgument(
            SPEEDS, " and ".join(named) or "none of them", f"exactly one of the four, for example: mfc-analysis gains {kind} --bandwidth-hz 4"
        )
    tool = asked.pop("tool", None)
    if "robot" not in takes:
        return helper(**asked)
    if "robot" not in asked:
        raise BadArgument("--robot", None, f"a URDF file, a study or a robot's name: {kind} uses its mass matrix")
    arm, start = _arm_and_start(asked.pop("robot"), tool)
    q = asked.pop("q", start)
    return helper(arm, [q] if isinstance(q, float) else q, **asked)


def _arm_and_start(name: str, tool: str | None) -> tuple[Robot, list[float]]:
    """A robot and a pose: for a study, the robot of its first loop with payload, at the start of its reference; else the pose 0."""
    if Path(name).suffix != ".toml":
        from mfc_analysis.robots.catalogue import robot_named

        arm = robot_named(name, tool)
        return arm, [0.0] * arm.n
    if tool is not None:
        raise BadArgument("--tool", tool, f"no value: {name} defines the tool")
    from mfc_analysis import study

    loop = study.read(name).loops[0].loop
    return loop.robot, [float(value) for value in loop.nominal([0.0]).q[0]]


def numbers(name: str, text: str) -> float | list[float]:
    """One number, or several separated by commas. Raises BadArgument."""
    try:
        out = [float(part) for part in text.split(",")]
    except ValueError as why:
        raise BadArgument(f"--{name.replace('_', '-')}", text, "a number, or numbers separated by commas") from why
    return out[0] if len(out) == 1 else out
