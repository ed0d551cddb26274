"""Reads and checks a URDF before Pinocchio does, so that errors are reported in clear messages.

Only links with their inertias and joints are used; geometry, materials, transmissions and simulator tags are left out, and no mesh is opened.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from xml.etree import ElementTree

from mfc_analysis.errors import BadArgument, BadRobot
from mfc_analysis.maths import checks, files

LARGEST = 20_000_000  #: bytes of a URDF file
MOST_PARTS = 4000  #: links and joints of a URDF; Pinocchio ends the process on chains of ten thousands

_KEPT = ("link", "joint")
_PARTS = {"link": ("inertial",), "joint": ("origin", "parent", "child", "axis", "limit", "dynamics"), "fixed": ("origin", "parent", "child")}
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_NUMBERS = {  # attributes that are numbers, by tag
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
}


def read_urdf(source: str | os.PathLike[str]) -> str:
    """The text of a URDF given as a path or as the XML itself.

    Raises ``BadArgument`` where there is no such file or the argument is neither.
    """
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return source
    takes = "the path of a URDF file, or its XML text"
    try:
        content = files.read(checks.path("source", source, takes).expanduser(), LARGEST)
    except (OSError, RuntimeError) as why:  # RuntimeError: a home folder that does not exist
        raise BadArgument("source", str(source), f"{takes} ({getattr(why, 'strerror', None) or why})") from why
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as why:
        raise BadRobot(f"{source} is not a URDF: it is not text") from why


def checked_urdf(text: str) -> tuple[str, tuple[str, ...]]:
    """The URDF reduced to links and joints, and the names of its mimic joints.

    Raises ``BadRobot``, which names the link or joint: not XML, no ``<robot>``, unexpanded xacro, a missing or repeated name, a missing or
    unknown link, a floating or planar joint, an invalid number, a negative mass, a zero axis, no or several roots, a loop.
    """
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except (ElementTree.ParseError, ValueError) as why:
        raise BadRobot(f"the URDF is not XML: {why}") from why
    if root.tag != "robot":
        raise BadRobot(f"not a URDF: its root element is <{_local(root.tag)}>, not <robot>")
    if any(isinstance(e.tag, str) and "xacro" in e.tag for e in root.iter()):
        raise BadRobot("the URDF still contains xacro tags: expand it first, with xacro arm.urdf.xacro > arm.urdf")
    bare = ElementTree.Element("robot", {"name": root.get("name") or "robot"})
    for element in root:
        if element.tag in _KEPT:
            bare.append(_stripped(element))
    if len(bare) > MOST_PARTS:
        raise BadRobot(f"the URDF has {len(bare)} links and joints; at most {MOST_PARTS} are allowed")
    _check_names(bare)
    for element in bare:
        _check_numbers(element)
    _check_tree(bare)
    mimic = tuple(j.get("name", "") for j in root.findall("joint") if j.find("mimic") is not None)
    return ElementTree.tostring(bare, encoding="unicode"), mimic


def moving_joints(text: str) -> tuple[str, ...]:
    """Names of the joints of a URDF that are not fixed, in the order of the file."""
    checked, _ = checked_urdf(text)
    return tuple(str(j.get("name")) for j in ElementTree.fromstring(checked).findall("joint") if j.get("type") != "fixed")


def _stripped(element: ElementTree.Element) -> ElementTree.Element:
    out = ElementTree.Element(element.tag, element.attrib)
    kept = _PARTS["fixed" if element.get("type") == "fixed" else element.tag]
    out.extend(child for child in element if child.tag in kept)
    return out


def _check_names(robot: ElementTree.Element) -> None:
    for kind in _KEPT:
        names = [e.get("name") for e in robot.findall(kind)]
        if not all(names):
            raise BadRobot(f"the URDF has a {kind} without a name")
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise BadRobot(f"the URDF has more than one {kind} named {twice[0]!r}")


def _check_numbers(element: ElementTree.Element) -> None:
    what = f"{element.tag} {element.get('name')!r}"
    for inertial in element.findall("inertial"):
        missing = [part for part in ("mass", "inertia") if inertial.find(part) is None]
        if missing:
            raise BadRobot(f"{what}: its <inertial> has no <{missing[0]}>")
    if element.get("type") in ("revolute", "prismatic"):
        limit = element.find("limit")
        missing = ["limit"] if limit is None else [a for a in ("effort", "velocity") if limit.get(a) is None]
        if missing:
            raise BadRobot(f"{what}: a {element.get('type')} joint needs a <limit> with effort and velocity; {missing[0]} is missing")
    for part in element.iter():
        for attribute, count in _NUMBERS.get(part.tag, {}).items():
            text = part.get(attribute)
            if text is None:
                if part.tag in ("mass", "inertia"):
                    raise BadRobot(f"{what}: <{part.tag}> has no {attribute}")
                continue
            try:
                values = [float(word) for word in text.split()]
            except ValueError:
                values = []
            if len(values) != count or not all(map(math.isfinite, values)):
                raise BadRobot(f"{what}: {part.tag} {attribute}={text!r} is not {'a finite number' if count == 1 else f'{count} finite numbers'}")
            if part.tag == "mass" and values[0] < 0:
                raise BadRobot(f"{what}: its mass {text} kg is negative")
            if part.tag == "dynamics" and values[0] < 0:
                raise BadRobot(f"{what}: its {attribute} {text} is negative")
            if part.tag == "axis" and not any(values):
                raise BadRobot(f"{what}: its axis is zero")


def _check_tree(robot: ElementTree.Element) -> None:
    links = {e.get("name") for e in robot.findall("link")}
    parent: dict[str, str] = {}
    for joint in robot.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if kind not in _JOINT_TYPES:
            taken = ", ".join(_JOINT_TYPES)
            raise BadRobot(f"joint {name!r} is of type {kind!r}: this library takes fixed bases and joints with one degree of freedom ({taken})")
        ends = []
        for end in ("parent", "child"):
            part = joint.find(end)
            link = None if part is None else part.get("link")
            if link not in links or link is None:
                raise BadRobot(f"joint {name!r}: its {end} link {link!r} is not in the URDF")
            ends.append(link)
        if ends[1] in parent:
            raise BadRobot(f"link {ends[1]!r} is the child of more than one joint: closed chains are not supported")
        parent[ends[1]] = ends[0]
    if not links:
        raise BadRobot("the URDF has no link")
    roots = sorted(str(link) for link in links if link not in parent)
    if len(roots) != 1:
        raise BadRobot(f"the URDF needs exactly one root link and has {len(roots)}" + (f": {', '.join(roots)}" if roots else ""))
    loose = sorted(str(link) for link in links - _reached(roots[0], parent))
    if loose:
        raise BadRobot(f"the URDF has links that are not connected to the root: {', '.join(loose)}")


def _reached(root: str, parent: dict[str, str]) -> set[str]:
    children: dict[str, list[str]] = {}
    for child, above in parent.items():
        children.setdefault(above, []).append(child)
    seen, stack = set(), [root]
    while stack:
        link = stack.pop()
        seen.add(link)
        stack.extend(children.get(link, ()))
    return seen


def _local(tag: str) -> str:
    return tag.rsplit("}", 1)[-1]
