"""``mfc-analysis init``: a commented study for a robot, which runs without changes."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree

import numpy as np

from mfc_analysis.analysis.participation import listed
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import files
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.catalogue import robot_named
from mfc_analysis.robots.coupling import lacks_armature

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


STRIDE = 0.5  #: [rad, m] longest joint motion of the first path

GRIPS, FINGERS = r"gripper|finger|jaw|claw|knuckle", r"finger|jaw|claw|knuckle"  #: in names of joints, and of links at the ends of a tree

BANDWIDTH = 10.0  #: [Hz] of the first gains

MODEL = """\
# The controller's model, where it differs from the plant:
# [controller_model]
# friction = "none"                        # no compensation of the joints' viscous friction
# payload = false
# inertia_scale = 1.1"""

MODEL_WITHOUT_FRICTION = """\
# The controller's model, where it differs from the plant. The viscous friction of this arm is larger than the damping of the gains below.
# If it were fully compensated, an error of a few percent would make the loop unstable. The controller therefore does not compensate it.
[controller_model]
friction = "none"
# payload = false
# inertia_scale = 1.1"""

TEMPLATE = """\
# A study: a robot, a control law, a path, hardware, and requirements on the loop.
#
#   mfc-analysis check {file}             requirements only: exit code 0 met, 1 not met, 2 bad input
#   mfc-analysis report {file} --out out  HTML, PDF and JSON
#   mfc-analysis limits {file}            the largest payload, dead time, bandwidth ... at which the requirements are met
#
# SI units and radians, except for keys that end in _deg or _hz. File names are relative to this file.

title = {title}

# Joint positions at the start: {joints} [{units}].
q_start = {q_start}
# at = "torque"                            # analysis point of the margins; default: the plant input
# horizon = 100.0                          # [s] of the verdict: roots slower than 1/horizon are judged by what they do within it

[robot]
{source}
tool = {tool}  # the frame of tool references and payloads
{locked}# gravity = [0, 0, -9.81]                  # in base axes
# friction = "none"                        # drop the URDF's joint damping; or {{viscous = 0.5, coulomb = 1.0}}
{armature}
# payload = {{mass = 2.0, com = [0, 0, 0.05], inertia = 0.01}}

{model}

[law]
# "mfc-analysis laws" lists the laws; 9.10 is computed torque: tau = M (a_d + kp e + ki z + kd e') + h
equation = "9.10"
gains = {{helper = "pid", bandwidth_hz = {bandwidth:g}, damping = 1.0}}  # or kp = ..., ki = ..., kd = ... directly
# form = "printed"                         # the equation as printed in the chapter

[reference]
# Hold, Quintic, Sinusoid, Waypoints, csv (file = "path.csv"); ToolHold, ToolLine, ToolSinusoid, ToolCircle for tool laws
kind = "Quintic"
q1 = {q1}
duration = {duration}

[hardware]                                 # ideal unless set here
# torque_lag = 0.002                       # [s]
# delay = 0.001                            # [s] of each commanded torque
# sample_time = 0.001                      # [s]; the loop becomes discrete
# velocity_filter = 0.001                  # [s]

# [environment]                            # for force laws
# stiffness = 1e4                          # [N/m]
# damping = 10.0
# axes = "z"                               # into the surface
# preload = 5.0                            # [N] at the start

[times]
stop = {duration}
count = 51

[requirements]
phase_deg = 45.0
gain_increase_db = 6.0
gain_reduction_db = 6.0
delay = 0.002                              # [s] of additional dead time
sensitivity_peak = 2.0
# disk_margin = 0.4
# damping_ratio = 0.5
# settling_time = 0.5                      # [s] to 2 %, of a step of the reference (v_d = 0); with step = "loop": of T = L/(1 + L)
# tracking_error = 1e-3                    # [rad, m] in a nonlinear run
# torque_fraction = 0.9                    # of the torque limits

# [ranges]                                 # every combination is checked; the controller's model does not change
# payload = [0.0, 1.0, 2.0]
# torque_lag = {{low = 0.001, high = 0.004, count = 4}}

# [design]
# tune = {{bandwidth_hz = [1, 20], damping = [0.5, 2.0]}}    # the fastest gains of law.gains that meet the requirements over the ranges
# limits = true                            # the tables of "mfc-analysis limits" in the report
"""


def study_for(robot: Robot, source: str, file: str, locked: Sequence[str] = ()) -> str:
    """The text of a study for a robot. ``source``: the line of its ``[robot]`` table with the source; ``locked``: locked joints."""
    q0, q1, duration = first_path(robot)
    turns = np.abs(robot.jacobian(q0)[3:]).max(axis=0) > 1e-9
    return TEMPLATE.format(
        file=_comment(file),
        title=json.dumps(f"{robot.name}: computed torque along a first path", ensure_ascii=True),
        joints=_comment(", ".join(robot.joint_names)),
        units="rad" if turns.all() else "m" if not turns.any() else "rad, m",
        q_start=_list(q0),
        source=source,
        locked=_locked(locked, robot.joint_names),
        armature=_armature(robot, q0, q1),
        model=MODEL_WITHOUT_FRICTION if friction_rules(robot, q0, q1) else MODEL,
        bandwidth=BANDWIDTH,
        tool=json.dumps(robot.tool, ensure_ascii=True),
        q1=_list(q1),
        duration=f"{duration:g}",
    )


def friction_rules(robot: Robot, *poses: Array) -> bool:
    """Whether the viscous friction of a joint exceeds the damping of the gains: a controller that compensates it has no margin left."""
    from mfc_analysis import gains, hertz

    kd = float(gains.pid(bandwidth=hertz(BANDWIDTH))["kd"])
    return any(bool(np.any(robot.viscous > kd * np.diag(robot.mass(q)))) for q in poses)


def first_path(robot: Robot) -> tuple[Array, Array, float]:
    """Start, end and duration [s] of a path inside the joint limits, at no more than half the speed limits."""
    limits = robot.limits
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    low, high = np.where(bounded, lower, 0.0), np.where(bounded, upper, 0.0)
    middle = np.where(bounded, low + 0.5 * (high - low), np.clip(0.0, lower, upper))
    room = np.where(bounded, 0.5 * (high - low), np.inf)
    half = np.minimum(0.5 * STRIDE, 0.4 * room)
    q0, q1 = np.round(middle - half, 4), np.round(middle + half, 4)
    one_sided = np.isfinite(lower) ^ np.isfinite(upper)
    q0 = np.where(one_sided & np.isfinite(lower), np.round(middle + 0.05, 4), q0)
    q1 = np.where(one_sided & np.isfinite(upper), np.round(middle - 0.05, 4), q1)
    speed = np.array(limits.velocity)
    slowest = float(np.max(1.875 * np.abs(q1 - q0) / (0.5 * np.where(np.isfinite(speed), speed, np.inf))))
    return q0, q1, max(2.0, math.ceil(10 * slowest) / 10)


def write(name: str, out: str | os.PathLike[str] | None = None, tool: str | None = None, *, overwrite: bool = False) -> Path:
    """Writes the study of a URDF file or a robot's name; returns its path.

    Raises BadArgument if the file exists and ``overwrite`` is False, or if the last joints of a URDF look like a gripper and no ``tool`` is given;
    BadRobot or UnknownName for the robot.
    """
    is_file = bool(Path(name).suffix) or Path(name).exists()
    if is_file and tool is None:
        _ask_for_the_tool(name)
    locked = unmoving(name, tool) if is_file else ()
    robot = _arm(name, tool, locked) if is_file else robot_named(name, tool)
    stem = Path(name).stem if is_file else name
    target = Path(out) if out is not None else Path(f"{stem}.toml")
    if target.exists() and not overwrite:
        raise BadArgument("--out", str(target), "a new file, or --force to overwrite")
    if is_file:
        try:
            relative = os.path.relpath(Path(name).resolve(), target.resolve().parent)
        except ValueError:  # another drive
            relative = str(Path(name).resolve())
        source = f"urdf = {json.dumps(Path(relative).as_posix(), ensure_ascii=True)}"
    else:
        source = f"name = {json.dumps(name)}"
    target.parent.mkdir(parents=True, exist_ok=True)
    files.write(target, study_for(robot, source, target.name, locked).encode("utf-8"))
    return target


class Gripper(NamedTuple):
    """Joints of a URDF that look like those of a gripper."""

    joints: tuple[tuple[int, str], ...]  #: number among the moving joints, from 1, and name
    link: str  #: the link that carries them


def gripper(urdf: str | os.PathLike[str]) -> Gripper | None:
    """The gripper of a URDF, by the names of its moving joints and, at the ends of the tree, of the links they move; None: it has none."""
    from mfc_analysis.robots.urdf import checked_urdf, read_urdf

    joints = ElementTree.fromstring(checked_urdf(read_urdf(Path(urdf))).text).findall("joint")
    moving = [j for j in joints if j.get("type") != "fixed"]
    parents = {_link(j, "parent") for j in moving}

    def grips(joint: ElementTree.Element) -> bool:
        child = _link(joint, "child")
        return bool(re.search(GRIPS, str(joint.get("name")).lower()) or (child not in parents and re.search(FINGERS, child.lower())))

    found = [j for j in moving if grips(j)]
    if not found or len(found) == len(moving):
        return None
    moved = {_link(j, "child") for j in found}
    above = {_link(j, "child"): _link(j, "parent") for j in joints}
    link = _link(found[0], "parent")
    while link in above and _carried_by(link, moved, above):
        link = above[link]
    return Gripper(tuple((moving.index(j) + 1, str(j.get("name"))) for j in found), link)


def _carried_by(link: str, moved: set[str], above: dict[str, str]) -> bool:
    """Whether a joint of the gripper moves this link."""
    while link not in moved and link in above:
        link = above[link]
    return link in moved


def _ask_for_the_tool(urdf: str) -> None:
    """Raises BadArgument where a URDF has a gripper: its joints belong to the arm or not, which only the tool tells."""
    found = gripper(urdf)
    if found is None:
        return
    names = listed([f"joint {number} ({name})" for number, name in found.joints])
    said = f"{names} {'looks' if len(found.joints) == 1 else 'look'} like a gripper; you may mean --tool {found.link}"
    raise BadArgument("--tool", None, f"a link or frame of the arm, and locks the joints that do not move it. {said}")


def unmoving(urdf: str | os.PathLike[str], tool: str | None) -> tuple[str, ...]:
    """The joints of a URDF that do not move the tool, such as fingers; without a tool, those that mimic another."""
    from mfc_analysis.robots.urdf import checked_urdf, read_urdf

    read = checked_urdf(read_urdf(Path(urdf)))
    joints = {str(j.get("name")): j for j in ElementTree.fromstring(read.text).findall("joint")}
    if tool is None:
        return read.mimic
    above = {_link(j, "child"): name for name, j in joints.items()}
    link = _link(joints[tool], "child") if tool in joints and tool not in above else tool
    chain = set()
    while link in above:
        chain.add(above[link])
        link = _link(joints[above[link]], "parent")
    return tuple(name for name, j in joints.items() if j.get("type") != "fixed" and name not in chain) if chain else read.mimic


def _arm(urdf: str, tool: str | None, locked: Sequence[str]) -> Robot:
    from mfc_analysis.robots import Robot

    try:
        return Robot.from_urdf(Path(urdf), tool=tool, locked=list(locked))
    except BadArgument as why:
        if why.argument == "tool" and tool is None:
            raise BadArgument("--tool", None, f"{why.takes}; the joints that do not move it are locked") from why
        raise


def _armature(robot: Robot, q0: Array, q1: Array) -> str:
    """The key for the rotor inertia, with what it is for, after what the model lacks along the path."""
    said = (
        "# The motors' inertia at the joints, rotor inertia times gear ratio squared: a URDF rarely has it. Without it the coupling of joints is\n"
        "# too strong, and independent-joint gains look worse than they are.\n"
    )
    key = "# armature = 0.3                           # one number or one for each joint [kg m^2, kg]"
    lacking = lacks_armature(robot, np.linspace(q0, q1, 21))
    return f"{said}# {_comment(lacking)}.\n{key}" if lacking else said + key


def _locked(names: Sequence[str], joints: Sequence[str]) -> str:
    if names:
        return f"locked = {json.dumps(list(names))}  # locked at 0; or {{ name = 0.04 }}\n"
    if len(joints) == 1:
        return ""
    return f"# locked = {json.dumps(list(joints[-1:]))}  # joints to lock, at 0; then q_start and q1 have no number for them\n"


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{v + 0.0:g}" for v in values) + "]"


def _comment(text: str) -> str:
    """Text on one line of a comment."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _link(joint: ElementTree.Element, end: str) -> str:
    """The name of a joint's "parent" or "child" link; the URDF has been checked."""
    found = joint.find(end)
    return "" if found is None else str(found.get("link"))
