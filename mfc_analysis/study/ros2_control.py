"""Gains for the controllers of ros2_control, into a parameter file of the user and out of it.

Their law (joint_trajectory_controller with an "effort" or a "velocity" command, pid_controller) is

    u = ff v_d + p e + i int e + d (v_d - v),

without a model of the arm: 9.8 with effort, 9.1 to 9.4 with velocity. Gains of 9.10 and 9.12, [1/s^2], become those of 9.8, [Nm/rad], by the mass
matrix. Laws that need more are refused. Sources: the parameter files of ros2_controllers 6.9 and its user documentation.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import BadArgument, UnknownName, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from mfc_analysis.laws.law import Law
    from mfc_analysis.robots.robot import Robot
    from mfc_analysis.study.read import StudyLoop

TYPES = {
    "joint_trajectory_controller": "joint_trajectory_controller/JointTrajectoryController",
    "pid_controller": "pid_controller/PidController",
}  #: controller -> plugin
FEEDFORWARD = {"joint_trajectory_controller": "ff_velocity_scale", "pid_controller": "feedforward_gain"}
JOINTS = {"joint_trajectory_controller": "joints", "pid_controller": "dof_names"}
MODEL_LAWS = ("ComputedTorque", "InverseDynamics")
LAWS = ("JointPID", "ComputedTorque", "VelocityFeedforward", "VelocityP", "VelocityPI", "VelocityFeedforwardPI")


@dataclass(frozen=True, eq=False)
class Export:
    """A parameter file for ros2_control, and what it does not say."""

    text: str  #: YAML
    notes: tuple[str, ...]  #: conversions and what does not carry over, sentences


@dataclass(frozen=True, eq=False)
class _Gains:
    """Gains of n joints, for one command interface."""

    interface: str  #: "effort" or "velocity"
    p: Array  #: (n,) [Nm/rad, N/m] or [1/s]
    i: Array  #: (n,) [Nm/(rad s), N/(m s)] or [1/s^2]
    d: Array  #: (n,) [Nm s/rad, N s/m]; 0 with velocity
    ff: Array  #: (n,) [Nm s/rad, N s/m] or [-]
    comments: tuple[str, ...] = ()  #: beside p, one for each joint


def exported(one: StudyLoop, text: str = "", controller: str = "joint_trajectory_controller", name: str = "") -> Export:
    """The gains of a loop for a ``controller`` of ros2_control, in the parameter file ``text`` ("": a new one), whose other lines stay.

    ``name``: of the controller in the file; "": that of its type. Raises Unsupported for a law that these controllers do not have, BadArgument
    for a file that is not one, or whose controller has another command interface.
    """
    checks.choice("controller", controller, tuple(TYPES))
    loop, name = one.loop, name or controller
    robot = loop.robot
    notes: list[str] = []
    gains = _gains(loop.law, one, notes)
    if controller == "pid_controller" and gains.ff.any():
        notes.append("pid_controller multiplies the position, not the velocity, by feedforward_gain: it is 0 here, and there is no feedforward")
    limit = _limits(one, gains.interface, notes)
    yaml, tree = _read(text)
    manager = _inner(tree, ("controller_manager", "ros__parameters"))
    period = loop.equations.sample_time
    if period and "update_rate" not in manager:
        manager["update_rate"] = round(1 / period)
    elif period and abs(float(manager["update_rate"]) * period - 1) > 1e-6:
        notes.append(f"the file has update_rate {manager['update_rate']}, the study a sample time of {period:g} s: {1 / period:g} Hz")
    _inner(manager, (name,)).setdefault("type", TYPES[controller])
    table = _found(tree, name) or _inner(tree, (name, "ros__parameters"))
    _set_interfaces(table, controller, robot, gains.interface)
    for j, joint in enumerate(robot.joint_names):
        row = _inner(table, ("gains", joint))
        values = {"p": gains.p[j], "i": gains.i[j], "d": gains.d[j]}
        values[FEEDFORWARD[controller]] = 0.0 if controller == "pid_controller" else gains.ff[j]
        if np.isfinite(limit[j]):
            values |= {"u_clamp_max": limit[j], "u_clamp_min": -limit[j], "i_clamp_max": limit[j], "i_clamp_min": -limit[j]}
            if "i_clamp" in row:  # releases before 4.30
                values["i_clamp"] = limit[j]
        for key, value in values.items():
            row[key] = float(value)
        if gains.i[j] and np.isfinite(limit[j]):
            row["antiwindup_strategy"] = "conditional_integration"
        if gains.comments:
            row.yaml_add_eol_comment(gains.comments[j], "p")
    out = io.StringIO()
    yaml.dump(tree, out)
    return Export(out.getvalue(), (*notes, *_left(one, gains.interface)))


def law_table(text: str, joints: Sequence[str], name: str = "") -> tuple[dict[str, Any], tuple[str, ...]]:
    """The ``[law]`` table of a study from the gains of a controller in a parameter file, and notes.

    ``name``: of the controller; "": the only one that has gains for these joints. Raises BadArgument: no such controller or joint, a position
    command, gains that no law of the chapter has.
    """
    _, tree = _read(text)
    known = [key for key, table in _controllers(tree) if "gains" in table]
    if not name:
        name = next(iter(known)) if len(known) == 1 else ""
    if not name or name not in known:
        raise UnknownName("--name", name or None, known)
    table = _found(tree, name)
    assert table is not None
    pid = "dof_names" in table
    command = table.get("command_interface") if pid else table.get("command_interfaces")
    interfaces = [command] if isinstance(command, str) else list(command or [])
    given = {joint: table["gains"].get(joint) for joint in joints}
    for joint, row in given.items():
        if not isinstance(row, Mapping):
            raise UnknownName(f"{name}.gains", joint, tuple(table["gains"]))

    def column(key: str) -> Array:
        return np.array([checks.number(f"{name}.gains.{joint}.{key}", row.get(key, 0.0)) for joint, row in given.items()])

    p, i, d, ff = (column(key) for key in ("p", "i", "d", FEEDFORWARD["pid_controller" if pid else "joint_trajectory_controller"]))
    notes = [f"{name} has no model of the arm: gravity and coupling are not compensated, unless the arm does it"]
    if "effort" in interfaces:
        if ff.any():
            notes.append("the feedforward of the velocity has no part in the loop: it is not in the study")
        return {"name": "JointPID", "kp": p.tolist()} | _if_any("ki", i) | _if_any("kd", d), tuple(notes)
    if interfaces != ["velocity"]:
        raise Unsupported(f"{name}.command_interfaces", interfaces, "['effort'] or ['velocity']: with others the controller does not use its gains")
    if d.any() or not (np.all(ff == 1) or np.all(ff == 0)):
        raise Unsupported(
            f"{name}.gains", "d, or a velocity feedforward other than 0 and 1,", "p, i and a feedforward of 0 or 1 with velocity commands"
        )
    if ff.any():
        return ({"name": "VelocityFeedforwardPI", "kp": p.tolist()} | _if_any("ki", i)) if p.any() or i.any() else {"name": "VelocityFeedforward"}, ()
    return {"name": "VelocityPI" if i.any() else "VelocityP", "kp": p.tolist()} | _if_any("ki", i), ()


def with_law(study: str, law: Mapping[str, Any]) -> str:
    """The text of a study (TOML) with its ``[law]`` table replaced; the rest, with its comments, stays. Raises BadArgument without one such table."""
    lines = study.splitlines(keepends=True)
    heads = [k for k, line in enumerate(lines) if line.lstrip().startswith("[")]
    at = [k for k in heads if lines[k].split("#")[0].strip() == "[law]"]
    if len(at) != 1:
        raise BadArgument("study", f"{len(at)} [law] tables", "a study with one [law] table")
    inside = [k for k in heads if k > at[0] and not lines[k].lstrip().startswith("[law.")]
    end = inside[0] if inside else len(lines)
    while end > at[0] + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1  # comments above the next table belong to it
    new = [f'{key} = "{value}"\n' if isinstance(value, str) else f"{key} = {value!r}\n" for key, value in law.items()]
    return "".join([*lines[: at[0] + 1], *new, *lines[end:]])


# --- gains ---------------------------------------------------------------------------------------------------------------


def _gains(law: Law, one: StudyLoop, notes: list[str]) -> _Gains:
    n, kind = one.loop.robot.n, type(law).__name__
    if kind not in LAWS:
        model = " 9.11's outer loop may be any system;" if kind == "InverseDynamics" else ""
        takes = f"one of {', '.join(LAWS)}:{model} these controllers have no model of the arm, no tool pose and no force; see the guide"
        raise Unsupported("law", kind, takes)
    gains = law.gains()
    for key, gain in gains.items():
        M = gain.matrix(n)
        if np.any(np.diag(np.diag(M)) != M):
            raise Unsupported(f"law.{key}", "a matrix that is not diagonal", "one gain for each joint: these controllers are independent")
    p, i, d = (gains[key].diagonal(n) if key in gains else np.zeros(n) for key in ("kp", "ki", "kd"))
    if law.plant == "velocity":
        return _Gains("velocity", p, i, d, np.full(n, float(kind in ("VelocityFeedforward", "VelocityFeedforwardPI"))))
    if kind == "JointPID":
        return _Gains("effort", p, i, d, np.zeros(n))
    return _converted(law, one, p, i, d, notes)


def _converted(law: Law, one: StudyLoop, p: Array, i: Array, d: Array, notes: list[str]) -> _Gains:
    """The gains of 9.10 [1/s^2] times the diagonal of the controller's M [kg m^2] at the first time: those of 9.8 [Nm/rad]."""
    model: Robot = one.loop.equations.model
    q = one.loop.nominal(one.times[:1]).q[0]
    mass = getattr(law, "mass", None)
    M = np.asarray(model.mass(q) if mass is None else mass, float)
    m = np.diag(M)
    units = ["kg m^2" if unit == "rad" else "kg" for unit in model.joint_units]
    where = "the law's mass=" if mass is not None else f"the controller's model at t = {one.times[0]:g} s"
    notes.append(
        f"law 9.10 has kp in 1/s^2; these controllers take Nm/rad: p, i and d are kp, ki and kd times M_jj of {where}: "
        + ", ".join(f"{joint} {value:.4g} {unit}" for joint, value, unit in zip(model.joint_names, m, units, strict=True))
    )
    apart = np.abs(M - np.diag(m)).sum(axis=1) / m
    notes.append(
        f"this is 9.8, not the law of the study: M(q) is constant and its coupling is left out (up to {apart.max():.0%} of M_jj here, "
        f"{model.joint_names[int(apart.argmax())]}); gravity and Coriolis torques are not compensated. Check it as a study with --from"
    )
    said = tuple(f"= kp {k:.6g} 1/s^2 x M_jj {value:.6g} {unit}" for k, value, unit in zip(p, m, units, strict=True))
    ff = np.asarray(model.viscous, float)
    notes.append(_checked(one, m * p, m * i, m * d))
    if ff.any():
        notes.append("ff_velocity_scale is the viscous friction of the controller's model, which 9.10 compensates [Nm s/rad]")
    return _Gains("effort", m * p, m * i, m * d, ff, said)


def _checked(one: StudyLoop, p: Array, i: Array, d: Array) -> str:
    """What the converted gains do on the study's arm at its first time, a sentence. Raises Unsupported where that loop is unstable."""
    from mfc_analysis.study.schema import LawTable

    law = LawTable(name="JointPID", kp=p.tolist(), **_if_any("ki", i), **_if_any("kd", d))  # type: ignore[arg-type]  # lists of numbers
    loop = replace(one.parts, table=one.table.model_copy(update={"law": law, "at": None})).loop()
    margins = loop.linearize(one.times[:1], horizon=one.requirements.horizon).margins()
    if not margins.stable.all():
        raise Unsupported(
            "law", "gains whose conversion to Nm/rad is unstable on this arm", "gains that are stable without M(q) as well, such as gains.joint_pid"
        )
    phase, _, joint = margins.worst().phase_deg
    return f"with the converted gains this arm is stable at t = {one.times[0]:g} s; smallest phase margin {phase:.1f} deg ({joint})"


def _limits(one: StudyLoop, interface: str, notes: list[str]) -> Array:
    """(n,) clamp of the command: the torque limit of the hardware, else of the model (velocity: its velocity limit); inf where there is none."""
    robot = one.loop.robot
    if interface == "velocity":
        return np.asarray(robot.limits.velocity, float)
    given = one.loop.equations.hardware.torque_limit
    if given is None:
        notes.append("u_clamp and i_clamp are the effort limits of the model; the linear analysis has no clamp")
    return np.broadcast_to(np.asarray(robot.limits.torque if given is None else given, float), (robot.n,))


def _left(one: StudyLoop, interface: str) -> list[str]:
    """What the parameters do not say."""
    hardware = one.loop.equations.hardware
    out = []
    if interface == "effort" and np.abs(one.loop.robot.gravity(one.loop.nominal(one.times[:1]).q[0])).max() > 1e-9:
        out.append("gravity: these controllers do not compensate it; either the arm does, or the integral carries it")
    if hardware.velocity_filter is not None:
        out.append("velocity_filter: the controllers take the velocity of the state interface as it is; filter it in the hardware component")
    if not one.loop.equations.sample_time:
        out.append("update_rate: the study has no sample_time; analyse it with the one of your controller_manager")
    if one.loop.ref.is_hold is False:
        out.append("the path: it is sent to the controller as a trajectory, with velocities, or v_d is 0")
    return out


def _if_any(key: str, values: Array) -> dict[str, list[float]]:
    return {key: values.tolist()} if values.any() else {}


# --- the file ------------------------------------------------------------------------------------------------------------


def _read(text: str) -> tuple[Any, Any]:
    """The parser and the tree of a parameter file. Raises BadArgument."""
    from ruamel.yaml import YAML, YAMLError

    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 4096
    try:
        tree: Any = yaml.load(text if text.strip() else "{}\n")
    except YAMLError as why:
        raise BadArgument("parameters", " ".join(str(why).split())[:200], "a parameter file of ros2_control (YAML)") from why
    if not isinstance(tree, Mapping):
        raise BadArgument("parameters", type(tree).__name__, "a parameter file of ros2_control: a mapping of nodes to ros__parameters")
    made: Any = tree
    if not text.strip():
        made.fa.set_block_style()
    return yaml, made


def _inner(tree: Any, keys: Sequence[str]) -> Any:
    """The mapping under some keys, made where it is missing. Raises BadArgument where something else stands there."""
    for key in keys:
        if tree.get(key) is None:
            tree[key] = type(tree)()
        inner = tree[key]
        if not isinstance(inner, Mapping):
            raise BadArgument(key, inner, "a mapping in the parameter file")
        tree = tree[key]
    return tree


def _controllers(tree: Any) -> list[tuple[str, Any]]:
    """Name and parameters of each node of a file, also within a namespace."""
    out: list[tuple[str, Any]] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            inner = value.get("ros__parameters")
            out += [(str(key).rsplit("/", 1)[-1], inner)] if isinstance(inner, Mapping) else _controllers(value)
    return out


def _found(tree: Any, name: str) -> Any | None:
    return next((table for key, table in _controllers(tree) if key == name), None)


def _set_interfaces(table: Any, controller: str, robot: Robot, interface: str) -> None:
    """Joints and interfaces, where the file has none. Raises BadArgument where it has others."""
    joints = table.setdefault(JOINTS[controller], list(robot.joint_names))
    missing = [joint for joint in robot.joint_names if joint not in joints]
    if missing:
        raise UnknownName(JOINTS[controller], missing[0], tuple(joints))
    key = "command_interface" if controller == "pid_controller" else "command_interfaces"
    command = table.setdefault(key, interface if controller == "pid_controller" else [interface])
    if interface not in ([command] if isinstance(command, str) else list(command)):
        raise BadArgument(key, command, f"{interface!r} in the parameter file: with another command the gains mean something else, or nothing")
    states = ["position"] if controller == "pid_controller" and interface == "velocity" else ["position", "velocity"]
    table.setdefault("reference_and_state_interfaces" if controller == "pid_controller" else "state_interfaces", states)
