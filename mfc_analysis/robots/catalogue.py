"""Robots by name: five embedded ones, without meshes or files, and the fixed-base arms of the optional example-robot-data."""

from __future__ import annotations

import importlib.metadata
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument, MfcError, MfcWarning, UnknownName
from mfc_analysis.maths import checks
from mfc_analysis.robots import build
from mfc_analysis.robots.build import Locked
from mfc_analysis.robots.robot import Robot
from mfc_analysis.robots.urdf import checked_urdf, read_urdf

EARTH = 9.81  #: [m/s^2]
SMALLEST, LARGEST = 1e-12, 1e12  #: SI, of the masses, inertias, lengths and friction of an embedded robot


# --- embedded ------------------------------------------------------------------------------------------------------------


def single_joint(inertia: float = 0.5, mass: float = 1.0, com_distance: float = 0.1, damping: float = 0.1, gravity: float = EARTH) -> Robot:
    r"""One revolute joint in a vertical plane, equation 9.6: :math:`I\ddot\theta + m g r\cos\theta + b\dot\theta = \tau`.

    The angle is measured from the horizontal; the link lies along x, gravity along -y, the joint turns about z.
    The tool is at the end of the link, at twice ``com_distance``.

    Args:
        inertia: I [kg m^2] > 0 about the axis of rotation (M is this number). mass: m [kg] >= 0. com_distance: r [m] from the axis, >= 0.
        damping: b [Nm s/rad], viscous joint friction. gravity: [m/s^2] along -y; 0 for a horizontal plane.

    Warns where inertia < mass com_distance^2, which is not physical (the equation still holds).
    """
    inertia = checks.number("inertia", inertia, low=SMALLEST, high=LARGEST)
    mass, r = checks.number("mass", mass, low=0.0, high=LARGEST), checks.number("com_distance", com_distance, low=0.0, high=LARGEST)
    damping = checks.number("damping", damping, low=0.0, high=LARGEST)
    about_com = inertia - mass * r * r
    if about_com < 0:
        text = f"inertia={inertia:g} kg m^2 about the axis is less than mass com_distance^2 = {mass * r * r:g}, which is not physical"
        warnings.warn(text, MfcWarning, stacklevel=2)
        link = _flat((mass * r) ** 2 / inertia, (inertia / (mass * r), 0, 0), 0.0)  # a point mass with this inertia and gravity moment
    else:
        link = _flat(mass, (r, 0, 0), about_com)
    model = _planar("single_joint", gravity)
    _add(model, 0, "joint", pin.JointModelRZ(), (0, 0, 0), link)
    _tool(model, (2 * r, 0, 0))
    return Robot.from_pinocchio(model, tool="tool").with_friction(viscous=damping)


def slider(mass: float = 1.0, friction: float = 0.0) -> Robot:
    """One prismatic joint along z without gravity: the one-mass force loop of 9.21-9.23.

    Args:
        mass: [kg] > 0. friction: [N s/m] viscous, >= 0.
    """
    mass = checks.number("mass", mass, low=SMALLEST, high=LARGEST)
    model = _planar("slider", 0.0)
    _add(model, 0, "slide", pin.JointModelPZ(), (0, 0, 0), _flat(mass, (0, 0, 0), 0.0))
    _tool(model, (0, 0, 0))
    return Robot.from_pinocchio(model, tool="tool").with_friction(viscous=checks.number("friction", friction, low=0.0))


def rp(masses: ArrayLike = (4.0, 1.0), inertias: ArrayLike = (0.1, 0.02), com_distance: float = 0.3, gravity: float = EARTH) -> Robot:
    r"""A revolute and a prismatic joint in the vertical x-y plane, q = (theta, d), tool at d (cos theta, sin theta, 0).

    Link 1 turns about z and has its com at ``com_distance`` along the arm; link 2 slides along the arm and has its com at the tool. So
    M = diag(I1 + m1 r^2 + I2 + m2 d^2, m2) is diagonal, but C and g couple the joints. Gravity is along -y; 0 for a horizontal plane.

    Args:
        masses: (m1, m2) [kg]. inertias: (I1, I2) [kg m^2] about the coms, axis z. com_distance: r [m]. gravity: [m/s^2].
    """
    m, I = checks.array("masses", masses, (2,)), checks.array("inertias", inertias, (2,))
    if np.any(m < 0) or m[1] == 0:
        raise BadArgument("masses", masses, "two masses [kg] >= 0, the second > 0")
    if np.any(I < 0):
        raise BadArgument("inertias", inertias, "two inertias [kg m^2] >= 0")
    r = checks.number("com_distance", com_distance)
    model = _planar("rp", gravity)
    first = _add(model, 0, "theta", pin.JointModelRZ(), (0, 0, 0), _flat(m[0], (r, 0, 0), I[0]))
    _add(model, first, "d", pin.JointModelPX(), (0, 0, 0), _flat(m[1], (0, 0, 0), I[1]))
    _tool(model, (0, 0, 0))
    return Robot.from_pinocchio(model, tool="tool")


def planar_2r(gravity: float = EARTH) -> Robot:
    r"""Siciliano's two-link arm in the vertical x-y plane, motors included; gravity along -y.

    a = 1 m, l = 0.5 m, m_l = 50 kg, I_l = 10 kg m^2 for both links; motors of 5 kg and 0.01 kg m^2 with gears of 100, the second
    carried at the elbow. M(q) and g(q) are exactly those of the book, with the term k_r I_m of the second rotor that couples the joints. The
    model has this term as a body of inertia k_r I_m fixed to link 2, minus the same armature on both joints; in a plane this is equal.

    Source: Siciliano et al., Robotics: Modelling, Planning and Control, section 7.3.2 and example 7.2 (equations of motion, numbers).
    """
    a, l, m_l, I_l = 1.0, 0.5, 50.0, 10.0
    m_m, I_m, k_r = 5.0, 0.01, 100.0
    model = _planar("planar_2r", gravity)
    link, motor = _flat(m_l, (l, 0, 0), I_l), _flat(m_m, (a, 0, 0), I_m)
    elbow = _add(model, 0, "joint1", pin.JointModelRZ(), (0, 0, 0), link + motor)
    _add(model, elbow, "joint2", pin.JointModelRZ(), (a, 0, 0), link + _flat(0.0, (0, 0, 0), k_r * I_m))
    _tool(model, (a, 0, 0))
    return Robot.from_pinocchio(model, tool="tool").with_armature(k_r**2 * I_m - k_r * I_m)


@dataclass(frozen=True)
class _Cylinder:
    """A link of the UR5: joint origin (xyz [m], pitch [rad]) and axis, limits, mass and inertia (a cylinder along z of the link)."""

    name: str
    joint: str
    xyz: tuple[float, float, float]
    pitch: float
    axis: str
    effort: float  # [Nm]
    velocity: float  # [rad/s]
    range: float  # [rad] either way
    mass: float  # [kg]
    com: float  # [m] along z
    across: float  # [kg m^2] about x and y, at the com
    along: float  # [kg m^2] about z


_UR5 = (
    _Cylinder("shoulder_link", "shoulder_pan_joint", (0, 0, 0.089159), 0, "0 0 1", 150, 3.15, 2 * math.pi, 3.7, 0, 0.010267495893, 0.00666),
    _Cylinder(
        "upper_arm_link", "shoulder_lift_joint", (0, 0.13585, 0), math.pi / 2, "0 1 0", 150, 3.15, 2 * math.pi, 8.393, 0.28, 0.22689067591, 0.0151074
    ),
    _Cylinder("forearm_link", "elbow_joint", (0, -0.1197, 0.425), 0, "0 1 0", 150, 3.15, math.pi, 2.275, 0.25, 0.049443313556, 0.004095),
    _Cylinder("wrist_1_link", "wrist_1_joint", (0, 0, 0.39225), math.pi / 2, "0 1 0", 28, 3.2, 2 * math.pi, 1.219, 0, 0.111172755531, 0.21942),
    _Cylinder("wrist_2_link", "wrist_2_joint", (0, 0.093, 0), 0, "0 0 1", 28, 3.2, 2 * math.pi, 1.219, 0, 0.111172755531, 0.21942),
    _Cylinder("wrist_3_link", "wrist_3_joint", (0, 0, 0.09465), 0, "0 1 0", 28, 3.2, 2 * math.pi, 0.1879, 0, 0.0171364731454, 0.033822),
)


def ur5_urdf() -> str:
    """The URDF text of :func:`ur5`: no meshes, frames and joints named as in ROS-Industrial's."""
    parts = ['<robot name="ur5"><link name="world"/><link name="base_link"/>', _fixed("world_joint", "world", "base_link", "0 0 0", "0 0 0")]
    parent = "base_link"
    for c in _UR5:
        parts.append(
            f'<link name="{c.name}"><inertial><mass value="{c.mass!r}"/><origin xyz="0 0 {c.com!r}"/>'
            f'<inertia ixx="{c.across!r}" ixy="0" ixz="0" iyy="{c.across!r}" iyz="0" izz="{c.along!r}"/></inertial></link>'
            f'<joint name="{c.joint}" type="revolute"><parent link="{parent}"/><child link="{c.name}"/>'
            f'<origin xyz="{c.xyz[0]} {c.xyz[1]} {c.xyz[2]}" rpy="0 {c.pitch!r} 0"/><axis xyz="{c.axis}"/>'
            f'<limit lower="{-c.range!r}" upper="{c.range!r}" effort="{c.effort}" velocity="{c.velocity}"/></joint>'
        )
        parent = c.name
    parts.append('<link name="ee_link"/><link name="tool0"/>')
    parts.append(_fixed("ee_fixed_joint", parent, "ee_link", "0 0.0823 0", f"0 0 {math.pi / 2!r}"))
    parts.append(_fixed("wrist_3_link-tool0_fixed_joint", parent, "tool0", "0 0.0823 0", f"{-math.pi / 2!r} 0 0"))
    return "".join(parts) + "</robot>"


def ur5() -> Robot:
    """Universal Robots' UR5, tool ``tool0``: published kinematics, masses and inertias.

    Kinematics and inertias (a cylinder for each link) are those of ROS-Industrial's ur_description, so M and h equal those of ``load("ur5")``: a =
    -0.425, -0.39225 m; d = 0.089159, 0.10915, 0.09465, 0.0823 m; ``d4`` is 0.13585 - 0.1197 + 0.093 m. Its wrist cylinders
    have a radius of 0.6 m, where the arm has about 0.06 m. The wrist inertias, 0.11 to 0.22 kg m^2, are therefore too large; they are kept so that
    results agree with other tools.

    Source: ROS-Industrial universal_robot, ur_description (ur5.urdf); Universal Robots, DH parameters for calculations of kinematics and dynamics.
    """
    return Robot.from_urdf(ur5_urdf(), tool="tool0")


# --- of example-robot-data -----------------------------------------------------------------------------------------------


def _numbered(pattern: str, count: int, first: int = 1) -> tuple[str, ...]:
    return tuple(pattern.format(i) for i in range(first, first + count))


@dataclass(frozen=True)
class _Entry:
    """An arm of example-robot-data: its file, its tool (None: the last link) and its moving joints (None: all). The others are locked at 0."""

    path: str
    tool: str | None = None
    moving: tuple[str, ...] | None = None


_BAXTER, _PR2 = (
    ("s0", "s1", "e0", "e1", "w0", "w1", "w2"),
    ("shoulder_pan", "shoulder_lift", "upper_arm_roll", "elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll"),
)
_SO = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
_PANDA = _numbered("panda_joint{}", 7)
_ARMS: dict[str, _Entry] = {
    "asr_twodof": _Entry("asr_twodof_description/urdf/TwoDofs.urdf", "Tip"),
    "baxter_left": _Entry("baxter_description/urdf/baxter.urdf", "left_gripper", tuple(f"left_{x}" for x in _BAXTER)),
    "baxter_right": _Entry("baxter_description/urdf/baxter.urdf", "right_gripper", tuple(f"right_{x}" for x in _BAXTER)),
    "borinot_arm": _Entry("borinot_description/urdf/borinot_flying_arm_2.urdf", "flying_arm_2__ee"),
    "double_pendulum": _Entry("double_pendulum_description/urdf/double_pendulum.urdf"),
    "double_pendulum_continuous": _Entry("double_pendulum_description/urdf/double_pendulum_continuous.urdf"),
    "double_pendulum_simple": _Entry("double_pendulum_description/urdf/double_pendulum_simple.urdf"),
    "finger_edu": _Entry("finger_edu_description/robots/finger_edu.urdf", "finger_tip_link"),
    "hextilt_arm": _Entry("hextilt_description/urdf/hextilt_flying_arm_5.urdf", "flying_arm_5__gripper"),
    "kinova": _Entry("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", _numbered("j2s6s200_joint_{}", 6)),
    "panda": _Entry("panda_description/urdf/panda.urdf", "panda_hand_tcp", _PANDA),
    "panda_collision": _Entry("panda_description/urdf/panda_collision.urdf", "panda_hand_tcp", _PANDA),
    "pr2_left": _Entry("pr2_description/urdf/pr2.urdf", "l_gripper_tool_frame", tuple(f"l_{x}_joint" for x in _PR2)),
    "pr2_right": _Entry("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", tuple(f"r_{x}_joint" for x in _PR2)),
    "so100": _Entry("so_arm_description/urdf/so100.urdf", "gripper", _SO),
    "so101": _Entry("so_arm_description/urdf/so101.urdf", "gripper_frame_link", _SO),
    "talos_left_arm": _Entry("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link", _numbered("arm_left_{}_joint", 6, first=2)),
    "tiago": _Entry("tiago_description/robots/tiago.urdf", "wrist_ft_tool_link", _numbered("arm_{}_joint", 7)),
    "tiago_no_hand": _Entry("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link", _numbered("arm_{}_joint", 7)),
    "tiago_dual_left": _Entry("tiago_description/robots/tiago_dual.urdf", "wrist_left_ft_tool_link", _numbered("arm_left_{}_joint", 7)),
    "tiago_dual_right": _Entry("tiago_description/robots/tiago_dual.urdf", "wrist_right_ft_tool_link", _numbered("arm_right_{}_joint", 7)),
    "tiago_pro_left": _Entry("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_tool_link", _numbered("arm_left_{}_joint", 7)),
    "tiago_pro_right": _Entry("tiago_pro_description/robots/tiago_pro.urdf", "arm_right_tool_link", _numbered("arm_right_{}_joint", 7)),
    "ur3": _Entry("ur_description/urdf/ur3_robot.urdf", "tool0"),
    "ur3_gripper": _Entry("ur_description/urdf/ur3_gripper.urdf", "tool0"),
    "ur3_limited": _Entry("ur_description/urdf/ur3_joint_limited_robot.urdf", "tool0"),
    "ur5": _Entry("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "ur5_gripper": _Entry("ur_description/urdf/ur5_gripper.urdf", "tool0"),
    "ur5_limited": _Entry("ur_description/urdf/ur5_joint_limited_robot.urdf", "tool0"),
    "ur10": _Entry("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "ur10_limited": _Entry("ur_description/urdf/ur10_joint_limited_robot.urdf", "tool0"),
    "xarm7": _Entry("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "z1": _Entry("z1_description/urdf/z1.urdf", "gripperStator", _numbered("joint{}", 6)),
}
_ALIASES = {"baxter": "baxter_right", "borinot": "borinot_arm", "hextilt": "hextilt_arm", "pr2": "pr2_right", "talos_arm": "talos_left_arm"}
#: robots without a file, by name
EMBEDDED: dict[str, Callable[..., Robot]] = {"single_joint": single_joint, "slider": slider, "rp": rp, "planar_2r": planar_2r, "ur5": ur5}


def names() -> tuple[str, ...]:
    """Names that :func:`load` takes: the embedded robots and the arms of example-robot-data, installed or not."""
    return tuple(sorted({*EMBEDDED, *_ARMS}))


def load(name: str, tool: str | None = None, locked: Locked = None) -> Robot:
    """An arm of the optional example-robot-data by name, or an embedded robot (``"ur5"`` loads the file; ``ur5()`` is embedded).

    Args:
        name: one of :func:`names`. tool: a link or frame; None: the flange or hand of the arm (``robot.tool``).
        locked: joints to lock, names or ``{name: value}`` [rad or m]; None: all joints outside the arm (fingers, head, torso, wheels, the
            other arm), at 0. If given, only these are locked (``[]``: none).

    Raises ``UnknownName``; ``MissingRobots`` (a ``ValueError``) where example-robot-data is not installed.
    """
    name = _ALIASES.get(name, name) if isinstance(name, str) else name
    if not isinstance(name, str) or name not in names():
        raise UnknownName("name", name, names())
    if name not in _ARMS:
        robot = EMBEDDED[name]()
        return robot if tool is None and not locked else _changed(robot, tool, locked)
    entry = _ARMS[name]
    path = _data_folder(name) / entry.path
    if not path.is_file():
        raise MissingRobots(name, f"the installed example-robot-data has no {entry.path}; another version may")
    text = read_urdf(path)
    if locked is None and entry.moving is not None:
        locked = [joint for joint in checked_urdf(text).moving if joint not in entry.moving]
    robot = Robot.from_urdf(text, tool=entry.tool if tool is None else tool, locked=locked)
    return replace(robot, name=name)


def robot_named(name: str, tool: str | None = None) -> Robot:
    """The robot of a URDF file, or the embedded or loadable robot of this name. Raises UnknownName, BadRobot, BadArgument."""
    if Path(name).suffix or Path(name).exists():
        return Robot.from_urdf(Path(name), tool=tool)
    if name in EMBEDDED and tool is None:
        return EMBEDDED[name]()
    return load(name, tool)


def _changed(robot: Robot, tool: str | None, locked: Locked) -> Robot:
    model = pin.Model(robot.model)
    model.damping = np.array(robot.viscous)  # embedded robots have Pinocchio's order
    return Robot.from_pinocchio(model, tool=robot.tool if tool is None else tool, locked=locked)


class MissingRobots(MfcError, ValueError):
    """The robot files of example-robot-data are not installed."""

    def __init__(self, name: str, why: str) -> None:
        self.name = name
        super().__init__(f"robot {name!r}: {why}")


def _data_folder(name: str) -> Path:
    missing = 'it needs the robot files of example-robot-data: pip install "mfc-analysis[robots]"' + (
        "; robots.ur5() is embedded" if name == "ur5" else ""
    )
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError as why:
        raise MissingRobots(name, missing) from why
    for file in files:
        parts = file.parts
        if "example-robot-data" in parts and "robots" in parts and file.suffix == ".urdf":
            whole = Path(str(file.locate()))
            return Path(*whole.parts[: len(whole.parts) - len(parts) + parts.index("robots") + 1])
    raise MissingRobots(name, missing)


# --- construction --------------------------------------------------------------------------------------------------------


def _planar(name: str, gravity: float) -> pin.Model:
    model = pin.Model()
    model.name = name
    model.gravity = pin.Motion(np.array([0.0, -checks.number("gravity", gravity), 0.0]), np.zeros(3))
    return model


def _flat(mass: float, com: tuple[float, float, float], inertia: float) -> pin.Inertia:
    return build.body(float(mass), np.array(com, float), np.diag([0.0, 0.0, float(inertia)]))


def _add(model: pin.Model, parent: int, name: str, joint: pin.JointModel, at: tuple[float, float, float], body: pin.Inertia) -> int:
    index = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(at, float)), name)
    model.appendBodyToJoint(index, body, pin.SE3.Identity())
    model.addJointFrame(index, -1)
    return int(index)


def _tool(model: pin.Model, at: tuple[float, float, float]) -> None:
    last = model.njoints - 1
    frame = pin.Frame("tool", last, model.getFrameId(model.names[last]), pin.SE3(np.eye(3), np.array(at, float)), pin.FrameType.BODY)
    model.addFrame(frame)


def _fixed(name: str, parent: str, child: str, xyz: str, rpy: str) -> str:
    return f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/></joint>'
