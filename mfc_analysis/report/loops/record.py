"""A loop as data, complete: law, gains, arm, payload, path, hardware, surfaces and analysis point, and tables of them for the pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.laws.gain import Gain
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import log6
from mfc_analysis.report.document.document import Column, Section, Table, written
from mfc_analysis.report.loops.parameters import HARDWARE, array_words, gain_unit
from mfc_analysis.requirements.replay import DERIVED, replay

if TYPE_CHECKING:
    from mfc_analysis.laws.law import Law
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.robots.robot import Robot

UNITS = {"duration": "s", "stiffness": "N/m", "damping": "Ns/m", "preload": "N", "angle": "rad", "frequency": "rad/s", "radius": "m"}
MOST_NUMBERS = 60  #: of one argument that are written in a table
SERVO = {"bandwidth": "rad/s", "damping": "(ratio)", "delay": "s"}  #: units of the arguments of a servo
KEY = "loop"  #: of the record among the numbers of a section


def record(loop: ClosedLoop, times: ArrayLike = (0.0,), at: str = "") -> dict[str, Any]:
    """All that rebuilds a loop, as plain numbers and words, and the Python code that does.

    Laws, references, surfaces and hardware have their class and the arguments that differ from its defaults; robots have their name, tool,
    friction and payloads.

    Args:
        times: (m,) [s] of its linearisations. at: the analysis point of its margins.
    """
    hardware = loop.equations.hardware
    out = {
        "robot": _robot(loop.robot),
        "controller_model": _robot(loop.equations.model),
        "law": _value(loop.law) | {"equation": loop.law.equation},
        "gains": {name: {"value": value, "unit": _unit(gain_unit(loop.law, name, value))} for name, value in _gains(loop.law).items()},
        "reference": _value(loop.ref, whole=True) if is_dataclass(loop.ref) else {"class": type(loop.ref).__name__},
        "q_start": None if loop.q_start is None else np.asarray(loop.q_start),
        "hardware": _value(hardware),
        "surfaces": [_value(x) for x in _surfaces(loop)],
        "times": np.asarray(times, float),
        "at": at,
    }
    return out | {"python": str(replay(loop, times))}


def _gains(law: Law) -> dict[str, Any]:
    """The gains of a law, and its desired wrench."""
    out = {name: np.asarray(gain.array) for name, gain in law.gains().items() if gain}
    return out | ({} if law.desired_wrench is None else {"F_d": np.asarray(law.desired_wrench)})


def _unit(unit: str) -> str:
    return "" if unit == "-" else unit


def _surfaces(loop: ClosedLoop) -> list[Environment]:
    """The surfaces as given: those without a pose lie at the tool's start pose."""
    given = loop.environment
    return [] if given is None else [given] if isinstance(given, Environment) else list(given)


def _robot(robot: Robot) -> dict[str, Any]:
    loads = [{"mass": p.mass, "com": p.com, "inertia": p.inertia} for p in robot.payloads]
    friction = {"viscous": robot.viscous, "coulomb": robot.coulomb}
    return {"name": robot.name, "tool": robot.tool, "joints": robot.joint_names, "units": robot.joint_units, "payloads": loads, **friction}


def _value(given: Any, whole: bool = False) -> Any:
    """A dataclass as its class and the arguments that differ from the defaults (``whole``: all of them); anything else as it is."""
    if isinstance(given, Gain):
        return given.array
    if isinstance(given, np.ndarray) or not is_dataclass(given) or isinstance(given, type):
        return given
    out: dict[str, Any] = {"class": type(given).__name__}
    for f in fields(given):
        value = getattr(given, f.name) if f.init and f.name not in DERIVED else None
        system = getattr(given, "system", None) if f.name == "outer" else None
        if system is not None:  # an LTI outer loop
            out[f.name] = {**dict(zip("ABCD", (np.asarray(M) for M in system), strict=True)), "dt": getattr(given, "sample_time", None) or 0.0}
            continue
        if isinstance(value, Gain):
            value = value.array
        if value is not None and (whole or not (np.ndim(value) == 0 and value == f.default)):
            out[f.name] = _value(value)
    return out


# --- tables --------------------------------------------------------------------------------------------------------------


def recorded(sections: Iterable[Section]) -> dict[str, tuple[Section, Mapping[str, Any]]]:
    """Loop -> its section and record, in page order."""
    out: dict[str, tuple[Section, Mapping[str, Any]]] = {}
    for section in sections:
        if KEY in section.numbers and section.loop:
            out.setdefault(section.loop, (section, section.numbers[KEY]))
        out |= {name: found for name, found in recorded(section.sections).items() if name not in out}
    return out


def gains_section(sections: Iterable[Section]) -> tuple[Section, ...]:
    """The gains of every loop: value, unit, law and origin; none without loops."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for name, (section, data) in recorded(sections).items():
        law, origins = data["law"], dict(section.origins)
        said = [f"{gain} = {_values(found['value'])} {found['unit']}".rstrip() for gain, found in data["gains"].items()]
        why = [origins.get(gain, origins.get("", "as given")) for gain in data["gains"]]
        cells = (
            f"{law['class']}, {'eq. ' if law['equation'][:1].isdigit() else ''}{law['equation']}",
            "; ".join(said) or "none",
            "; ".join(dict.fromkeys(why)) or "the law has no gains",
        )
        rows.setdefault(cells, []).append(name)
    if not rows:
        return ()
    heads = (("Loop", 3.0), ("Law", 2.9), ("Gains", 5.8), ("Where they come from", 3.2))
    columns = tuple(Column(x, numeric=False, share=share) for x, share in heads)
    table = Table(
        "The gains of every loop; one number acts on all channels alike.", columns, tuple((_names(names), *cells) for cells, names in rows.items())
    )
    return (Section("Gains", body=(table,), key="gains"),)


def _names(names: list[str]) -> str:
    """Names of loops: what those of one equation share is told once."""
    heads: dict[str, list[str]] = {}
    for name in names:
        head, _, tail = name.partition(", ")
        heads.setdefault(head, []).append(tail)
    return "; ".join(f"{head}, {' and '.join(tails)}" if tails != [""] else head for head, tails in heads.items())


def _values(value: Any) -> str:
    """Numbers as text; only their count where there are many, and what is no number by its own words."""
    try:
        a: Array = np.asarray(value, float)
    except (TypeError, ValueError):
        return " ".join(str(value).split())
    a = a.reshape(()) if a.size == 1 else a
    if a.size > MOST_NUMBERS:
        return f"{' × '.join(map(str, a.shape))} numbers (in the JSON)"
    if a.ndim == 2 and a.shape[0] == len(a[0]) and np.array_equal(a, np.diag(np.diag(a))):
        return f"diag{array_words(np.diag(a))}"
    return array_words(a)


def setups_section(sections: Iterable[Section]) -> tuple[Section, ...]:
    """Arm, model, path, hardware, surfaces and analysis point of every loop: loops that share them in one row."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, (_, data) in recorded(sections).items():
        groups.setdefault(_setup(data), []).append(name)
    if not groups:
        return ()
    heads = (("Loops", 5.0), ("Arm and controller's model", 2.4), ("Reference and times", 5.0), ("Hardware and surfaces", 4.6), ("At", 1.4))
    rows = tuple((_names(names), *cells) for cells, names in groups.items())
    caption = (
        "The loops as they were analysed. Each can be rebuilt from these values and its gains; the JSON has all digits, and the Python code of each."
    )
    return (
        Section(
            "Arms, paths and hardware", body=(Table(caption, tuple(Column(x, numeric=False, share=share) for x, share in heads), rows),), key="setups"
        ),
    )


def _setup(data: Mapping[str, Any]) -> tuple[str, ...]:
    plant, model, t = data["robot"], data["controller_model"], data["times"]
    arm = _arm(plant)
    same = _arm(model) == arm
    count = f"{len(t)} times to {written(float(t[-1]), exact=True)} s" if len(t) > 1 else f"t = {written(float(t[0]), exact=True)} s"
    hardware = _said(data["hardware"]) or "ideal"
    surfaces = "; ".join(f"surface: {_said(x)}" for x in data["surfaces"])
    joints = " or ".join(sorted(set(plant["units"])))
    start = "" if data["q_start"] is None else f"; from q = {_values(data['q_start'])} {joints}"
    return (
        f"{arm}; model {'exact' if same else _arm(model)}",
        f"{data['reference']['class']}: {_said(data['reference'], dict.fromkeys(('q', 'q0', 'q1', 'center'), joints))}{start}; {count}",
        "; ".join(x for x in (hardware, surfaces) if x),
        data["at"],
    )


def _arm(robot: Mapping[str, Any]) -> str:
    loads = "".join(f" + {written(float(p['mass']), exact=True)} kg at {robot['tool']}" for p in robot["payloads"])
    return f"{robot['name']}{loads}"


def _said(data: Mapping[str, Any], units: Mapping[str, str] | None = None) -> str:
    """Arguments of a recorded value as text; a pose by its position and its rotation vector."""
    out = []
    for name, value in data.items():
        if name == "class":
            continue
        if isinstance(value, Mapping):
            kind = value.get("class", "")
            word = name.replace("_", " ")
            out.append(f"{word} ({_said(value, SERVO)})" if kind == "Servo" else f"{word} {kind} ({_said(value)})")
        elif isinstance(value, (str, bool)):
            out.append(f"{name.replace('_', ' ')} {value}")
        elif np.ndim(value) == 2 and np.shape(value) == (4, 4):
            out.append(f"{name} at {array_words(np.asarray(value)[:3, 3])} m, turned by {array_words(log6(np.asarray(value))[3:])} rad")
        else:
            unit = (units or {}).get(name) or UNITS.get(name) or HARDWARE.get(name, ("", ""))[1]
            turning = {"stiffness": ", Nm/rad", "damping": ", Nm s/rad"}.get(name, "") if "r" in str(data.get("axes", "")) else ""
            out.append(f"{name.replace('_', ' ')} {_values(value)} {unit}{turning}".rstrip())
    return ", ".join(out)
