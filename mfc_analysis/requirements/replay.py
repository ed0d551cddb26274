"""Code that rebuilds a loop: a snippet to paste from a failed test, a report or a search. It lists what it cannot reproduce.

Robots from a URDF file, embedded ones and those of the catalogue are recognised by comparison with a rebuilt robot (payloads, friction,
armature and scaling included). Any other robot, and a law or reference from outside this package, becomes a line to fill in.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.errors import MfcError
from mfc_analysis.laws.constraints import ConstraintSet
from mfc_analysis.laws.gain import Gain
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.robot import Robot

LONGEST = 600  #: most numbers of one array that are printed
DERIVED = ("index", "K", "B", "f0")  #: fields of an Environment that follow from the others
SAME = 1e-9  #: relative difference below which two robots are the same


@dataclass(frozen=True)
class Replay:
    """A snippet, and what it cannot reproduce."""

    code: str
    missing: tuple[str, ...]  #: a sentence each; empty: the snippet runs unchanged

    def __str__(self) -> str:
        return self.code if not self.missing else "\n".join([self.code, *(f"# to fill in: {what}" for what in self.missing)])


def replay(loop: ClosedLoop, times: ArrayLike | None = None, call: str = "") -> Replay:
    """Python code that rebuilds ``loop`` and ``times`` (m,) [s] and then makes ``call``. Raises BadArgument for bad times."""
    missing: list[str] = []
    robot = _robot(loop.robot, "robot", missing)
    lines = ["import numpy as np", "import mfc_analysis as mfc", "", f"robot = {robot}"]
    arguments = ["robot", _value(loop.law, "law", missing), _value(loop.ref, "ref", missing)]
    if loop.controller_model is not None:
        base = "robot" if loop.controller_model is loop.robot else _robot(loop.controller_model, "controller_model", missing)
        arguments.append(f"controller_model={base}")
    if loop.environment is not None:
        given = loop.environment
        surfaces = [_value(s, "environment", missing) for s in ([given] if isinstance(given, Environment) else given)]
        arguments.append("environment=" + (surfaces[0] if isinstance(given, Environment) else f"[{', '.join(surfaces)}]"))
    if loop.q_start is not None:
        arguments.append(f"q_start={_value(loop.q_start, 'q_start', missing)}")
    if loop.hardware is not None:
        arguments.append(f"hardware={_value(loop.hardware, 'hardware', missing)}")
    lines += ["loop = mfc.ClosedLoop(", *(f"    {a}," for a in arguments), ")"]
    if "control.ss(" in "".join(arguments):
        lines.insert(0, "import control")
    if times is not None:
        lines.append(f"times = {_times(checks.times(times))}")
    if call:
        lines.append(call)
    return Replay("\n".join(lines), tuple(missing))


def _times(t: Array) -> str:
    even = np.linspace(t[0], t[-1], t.size)
    return f"np.linspace({float(t[0])!r}, {float(t[-1])!r}, {t.size})" if t.size > 2 and np.array_equal(even, t) else repr(t.tolist())


def _value(given: Any, what: str, missing: list[str]) -> str:
    """An expression of a number, array, law, reference, surface or hardware; a name to fill in where there is none."""
    if isinstance(given, Gain):
        return _value(given.array, what, missing)
    if given is None or isinstance(given, (bool, int, float, str)):
        return repr(given)
    if isinstance(given, (np.ndarray, np.generic, list, tuple)):
        return _array(np.asarray(given, float), what, missing)
    if isinstance(given, ConstraintSet):
        return _array(np.asarray(given.rows), what, missing)
    if isinstance(given, Mapping):
        return "{" + ", ".join(f"{key!r}: {_value(x, what, missing)}" for key, x in given.items()) + "}"
    home = _home(given)
    if home and is_dataclass(given):
        return home + "(" + ", ".join(_fields(given, what, missing)) + ")"
    missing.append(f"{what}: {' '.join(str(given).split())[:120]} ({type(given).__module__}.{type(given).__qualname__} is not part of this package)")
    return what


def _array(given: Array, what: str, missing: list[str]) -> str:
    if given.size > LONGEST:
        missing.append(f"{what}: an array of shape {given.shape}, too long to print")
        return f"{what}_array"
    return repr(given.item()) if given.ndim == 0 else f"np.array({given.tolist()!r})"


def _home(given: Any) -> str:
    """The public name of this object's class; empty if it has none."""
    from mfc_analysis import laws, trajectories

    name = type(given).__name__
    if isinstance(given, (Environment, Hardware, Servo)):
        return f"mfc.{name}"
    for module, prefix in ((laws, "mfc.laws"), (trajectories, "mfc.trajectories")):
        if getattr(module, name, None) is type(given):
            return f"{prefix}.{name}"
    return ""


def _fields(given: Any, what: str, missing: list[str]) -> list[str]:
    out = []
    for f in fields(given):
        if not f.init or (isinstance(given, Environment) and f.name in DERIVED):
            continue
        x = getattr(given, f.name)
        if isinstance(x, Gain) and x.array is None:
            x = None
        system = getattr(given, "system", None) if f.name == "outer" else None
        if system is not None:  # an LTI outer loop
            late = getattr(given, "sample_time", None)
            dt = [] if late is None else [repr(late)]
            out.append("outer=control.ss(" + ", ".join([*(repr(np.asarray(M).tolist()) for M in system), *dt]) + ")")
            continue
        if _is_default(x, f.default):
            continue
        out.append(f"{f.name}={_value(x, what, missing)}")
    return out


def _is_default(x: Any, default: Any) -> bool:
    raw = x.array if isinstance(x, Gain) else x
    if raw is None or isinstance(raw, (bool, str)):
        return raw is default or raw == default
    return isinstance(default, (int, float)) and not isinstance(default, bool) and np.ndim(raw) == 0 and float(raw) == default


# --- robots ----------------------------------------------------------------------------------------------------------


def _robot(robot: Robot, what: str, missing: list[str]) -> str:
    """An expression that builds this robot, verified by its dynamics; otherwise a name to fill in."""
    for text, base in _candidates(robot):
        try:
            code, built = _changed(text, base(), robot)
            if _same(built, robot):
                return code
        except MfcError:
            continue
    missing.append(f"{what}: {robot}")
    return what if what != "robot" else "..."


def _candidates(robot: Robot) -> list[tuple[str, Callable[[], Robot]]]:
    from mfc_analysis import robots

    out: list[tuple[str, Callable[[], Robot]]] = []
    if robot.origin is not None:
        path: Any = robot.origin[0]
        given: dict[str, Any] = dict(robot.origin[1])
        for build in (Robot.from_urdf, Robot.from_mjcf):
            default = {name: p.default for name, p in signature(build).parameters.items()}
            shown = "".join(f", {name}={x!r}" for name, x in given.items() if x is not None and x != default.get(name))
            out.append((f"mfc.Robot.{build.__name__}({_nearby(path)!r}{shown})", partial(build, path, **given)))
    if robot.name == "slider" and robot.n == 1:
        mass = robot.total_mass - sum(p.mass for p in robot.payloads)
        out.append((f"mfc.robots.slider(mass={_short(mass)})", lambda: robots.slider(mass=_round(mass))))
    if robot.name == "single_joint" and robot.n == 1:
        given = _single_joint(robot)
        shown = ", ".join(f"{k}={x!r}" for k, x in given.items())
        out.append((f"mfc.robots.single_joint({shown})", lambda: robots.single_joint(**given)))
    if robot.name in ("ur5", "rp", "planar_2r"):
        out.append((f"mfc.robots.{robot.name}()", getattr(robots, robot.name)))
    if robot.name in robots.names():
        out.append((f"mfc.robots.load({robot.name!r})", lambda: robots.load(robot.name)))
        out.append((f"mfc.robots.load({robot.name!r}, tool={robot.tool!r})", lambda: robots.load(robot.name, tool=robot.tool)))
    return out


def _nearby(path: str) -> str:
    """The path relative to the working folder, where it lies below it."""
    whole, here = os.path.abspath(path), os.getcwd()
    return os.path.relpath(whole, here) if whole.startswith(here + os.sep) else path


def _single_joint(robot: Robot) -> dict[str, float]:
    """The arguments of ``single_joint`` that give this robot without payloads."""
    r = 0.5 * float(robot.pose(np.zeros(1))[0, 3])
    load = sum(p.inertia[2, 2] + p.mass * ((2 * r + p.com[0]) ** 2 + p.com[1] ** 2) for p in robot.payloads)
    inertia = float(robot.mass(np.zeros(1))[0, 0] - robot.armature[0] - load)
    mass = robot.total_mass - sum(p.mass for p in robot.payloads)
    return {"inertia": _round(inertia), "mass": _round(mass), "com_distance": _round(r), "damping": _round(float(robot.viscous[0]))}


def _changed(text: str, base: Robot, robot: Robot) -> tuple[str, Robot]:
    """The base with the scaling, payloads, friction and armature of ``robot``: the code and the robot."""
    own = robot.total_mass - sum(p.mass for p in robot.payloads)
    if base.n == robot.n and abs(own - base.total_mass) > SAME * own:
        factor = _round(own / base.total_mass)
        text, base = f"{text}.with_inertia_scaled({factor!r})", base.with_inertia_scaled(factor)
    for p in robot.payloads:
        com, inertia = p.com.tolist(), p.inertia.tolist()
        more = (f", com={com!r}" if any(com) else "") + (f", inertia={inertia!r}" if p.inertia.any() else "")
        text, base = f"{text}.with_payload({p.mass!r}{more})", base.with_payload(p.mass, com, inertia)
    if base.n == robot.n and np.abs(base.armature - robot.armature).max() > SAME:
        text, base = f"{text}.with_armature({robot.armature.tolist()!r})", base.with_armature(robot.armature)
    if base.n == robot.n and (np.any(base.viscous != robot.viscous) or np.any(base.coulomb != robot.coulomb)):
        more = f", coulomb={robot.coulomb.tolist()!r}, coulomb_speed={robot.coulomb_speed!r}" if robot.coulomb.any() else ""
        text = f"{text}.with_friction(viscous={robot.viscous.tolist()!r}{more})"
        base = base.with_friction(robot.viscous, robot.coulomb, robot.coulomb_speed)
    return text, base


def _same(a: Robot, b: Robot) -> bool:
    """True for robots with equal names, limits and friction, and equal mass, gravity, bias and tool pose at three configurations."""
    if a.joint_names != b.joint_names or a.tool != b.tool:
        return False
    pairs = [
        (a.viscous, b.viscous),
        (a.coulomb, b.coulomb),
        (a.armature, b.armature),
        (a.limits.torque, b.limits.torque),
        (a.limits.velocity, b.limits.velocity),
    ]
    for k in range(3):
        q, v = np.cos(np.arange(a.n) + k), np.sin(2.0 * np.arange(a.n) + k)
        pairs += [(a.mass(q), b.mass(q)), (a.gravity(q), b.gravity(q)), (a.bias(q, v), b.bias(q, v)), (a.pose(q), b.pose(q))]
    return all(np.allclose(x, y, rtol=SAME, atol=SAME) for x, y in pairs)


def _round(x: float) -> float:
    """The number without the rounding error of a subtraction."""
    return float(f"{x:.13g}")


def _short(x: float) -> str:
    return repr(_round(x))
