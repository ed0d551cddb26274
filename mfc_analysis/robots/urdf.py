"""Reads and checks a URDF before Pinocchio does, so that errors are reported in clear messages.

Only links with their inertias and joints are used; geometry, materials, transmissions and simulator tags are left out, and no mesh is opened.
"""

from __future__ import annotations

import codecs
import math
import os
import re
import sys
from collections import Counter
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from mfc_analysis.errors import BadArgument, BadRobot
from mfc_analysis.maths import checks, files
from mfc_analysis.maths.arrays import Array

LARGEST = 20_000_000  #: bytes of a URDF file
MOST_PARTS = 4000  #: links and joints of a URDF; Pinocchio ends the process on chains of ten thousands

_BLANKS = " \t\r\n"  # of XML; Python's split() takes others too
_KEPT = ("link", "joint")
_PARTS = {  # what is read of an element, by its tag
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics"),
    "fixed": ("origin", "parent", "child"),
}
_NAMES = {"link": ("name",), "joint": ("name", "type"), "parent": ("link",), "child": ("link",)}  # attributes that are text, by tag
_NUMBERS = {  # attributes that are numbers, by tag
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
}
_REQUIRED = ("mass", "inertia", "axis")  # tags whose numbers must all be there
_NOT_NEGATIVE = {"mass": ("value",), "limit": ("effort", "velocity"), "dynamics": ("damping", "friction")}
_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_DECLARED = re.compile(rb"<\?xml\b[^>]*?\bencoding\s*=\s*[\"']([\w.:-]+)[\"']")
_STARTS = {  # how a file starts that needs no declaration of its encoding
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it starts with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    b"<\0": "utf-16-le",
    b"\0<": "utf-16-be",
}


@dataclass(frozen=True, eq=False)
class Urdf:
    """What is read of a URDF."""

    text: str  #: links and joints only, as XML that Pinocchio reads without a word
    moving: tuple[str, ...]  #: joints that are not fixed, in the order of the file
    mimic: tuple[str, ...]  #: joints that mimic another one
    inertias: dict[str, Array]  #: (3, 3) [kg m^2] of each link that has one, about its centre of mass


def read_urdf(source: str | os.PathLike[str]) -> str:
    """The text of a URDF given as a path or as the XML itself. A file is read in the encoding of its byte order mark or XML declaration.

    Raises ``BadArgument`` where there is no such file or the argument is neither, ``BadRobot`` where the file is not in its encoding.
    """
    return read_xml(source, "a URDF")


def read_xml(source: object, what: str) -> str:
    """As ``read_urdf``; ``what`` the file is, for messages."""
    if isinstance(source, str) and source.lstrip("\ufeff" + _BLANKS).startswith("<"):
        return source
    takes = f"the path of {what.removesuffix(' file')} file, or its XML text"
    try:
        content = files.read(checks.path("source", source, takes).expanduser(), LARGEST)
    except (OSError, RuntimeError, UnicodeError) as why:  # RuntimeError: a home folder that does not exist
        raise BadArgument("source", str(source), f"{takes} ({getattr(why, 'strerror', None) or why})") from why
    declared = _DECLARED.match(content.lstrip())
    marked = next((name for start, name in _STARTS.items() if content.startswith(start)), None)
    encoding = marked or (declared[1].decode("ascii") if declared else "utf-8")
    try:
        text = content.decode(encoding)
        if declared and not text.lstrip("\ufeff" + _BLANKS).startswith("<"):
            raise ValueError
    except (LookupError, ValueError) as why:
        reason = "as its first bytes say" if marked else "which it declares" if declared else "and declares no other"
        raise BadRobot(f"{source} is not {what}: it is not text in the encoding {encoding}, {reason}; save it as UTF-8") from why
    return text


def checked_urdf(text: str) -> Urdf:
    """The links and joints of a URDF. A default XML namespace is left out.

    Raises ``BadRobot``, which names the link or joint: not XML, no ``<robot>``, unexpanded xacro, a missing or repeated name or part, a missing
    or unknown link, a floating or planar joint, an invalid number, a negative mass, limit or friction, a zero axis, no or several roots, a loop.
    """
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff" + _BLANKS))
    except (ElementTree.ParseError, ValueError) as why:
        raise BadRobot(f"the URDF is not XML: {why}") from why
    namespace, brace, local = root.tag.rpartition("}")
    if local != "robot":
        hint = "; Robot.from_mjcf reads it, and so does mjcf = in a study" if local == "mujoco" else ""
        raise BadRobot(f"not a URDF: its root element is <{local}>, not <robot>{hint}")
    for element in root.iter():
        element.tag = element.tag.removeprefix(namespace + brace)
    if any("xacro" in element.tag for element in root.iter()):
        raise BadRobot("the URDF still contains xacro tags: expand it first, with xacro arm.urdf.xacro > arm.urdf")
    parts = [element for element in root if element.tag in _KEPT]
    if len(parts) > MOST_PARTS:
        raise BadRobot(f"the URDF has {len(parts)} links and joints; at most {MOST_PARTS} are allowed")
    _check_names(parts)
    bare = ElementTree.Element("robot", {"name": root.get("name") or "robot"})
    bare.extend([_copied(element, f"{element.tag} {element.get('name')!r}") for element in parts])
    for joint in bare.findall("joint"):
        _check_limit(joint)
    _check_tree(bare)
    moving = tuple(str(j.get("name")) for j in bare.findall("joint") if j.get("type") != "fixed")
    mimic = tuple(str(j.get("name")) for j in root.findall("joint") if j.find("mimic") is not None)
    return Urdf(ElementTree.tostring(bare, encoding="unicode"), moving, mimic, _inertias(bare))


def _check_names(parts: list[ElementTree.Element]) -> None:
    for kind in _KEPT:
        names = [e.get("name") for e in parts if e.tag == kind]
        if not all(names):
            raise BadRobot(f"the URDF has a {kind} without a name")
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise BadRobot(f"the URDF has more than one {kind} named {twice[0]!r}")


def _copied(element: ElementTree.Element, what: str) -> ElementTree.Element:
    """The element with what is read of it alone, and its numbers written anew: urdfdom takes no blank at their ends."""
    tag = element.tag
    out = ElementTree.Element(tag, {name: element.attrib[name] for name in _NAMES.get(tag, ()) if name in element.attrib})
    for attribute, count in _NUMBERS.get(tag, {}).items():
        given = element.get(attribute)
        if given is not None:
            out.set(attribute, _numbers(given, count, what, tag, attribute))
        elif tag in _REQUIRED:
            raise BadRobot(f"{what}: <{tag}> has no {attribute}")
    unread = sorted(set(element.attrib) - set(out.attrib)) if tag == "origin" else []
    if unread:
        raise BadRobot(f"{what}: its <origin> has {unread[0]}, which is not read; it takes xyz and rpy")
    for part in _PARTS.get("fixed" if element.get("type") == "fixed" else tag, ()):
        found = element.findall(part)
        if len(found) > 1:
            raise BadRobot(f"{what} has more than one <{part}>")
        if not found and tag == "inertial" and part != "origin":
            raise BadRobot(f"{what}: its <inertial> has no <{part}>")
        copies = [_copied(one, what) for one in found]
        out.extend([one for one in copies if one.attrib or part != "dynamics"])  # urdfdom takes no empty <dynamics/>
    return out


def _numbers(text: str, count: int, what: str, tag: str, attribute: str) -> str:
    """The numbers as urdfdom reads them, and those of an axis scaled exactly to between 1 and 2. Raises ``BadRobot``."""
    words = re.split(f"[{_BLANKS}]+", text.strip(_BLANKS))
    values = [value for value in map(checks.decimal, words) if value is not None]
    if len(values) != len(words) or len(values) != count:
        takes = "a finite number" if count == 1 else f"{count} finite numbers"
        raise BadRobot(f"{what}: {tag} {attribute}={text!r} is not {takes} (digits 0 to 9, a point, an exponent)")
    if values[0] < 0 and attribute in _NOT_NEGATIVE.get(tag, ()):
        raise BadRobot(f"{what}: its {f'mass {values[0]:g} kg' if tag == 'mass' else f'{attribute} {values[0]:g}'} is negative")
    if tag == "axis":
        largest = max(map(abs, values))
        if largest == 0:
            raise BadRobot(f"{what}: its axis is zero")
        values = [math.ldexp(value, 1 - math.frexp(largest)[1]) for value in values]  # Pinocchio squares them
    return " ".join(map(repr, values))


def _check_limit(joint: ElementTree.Element) -> None:
    """Raises ``BadRobot`` where a limit is missing or its range is reversed; a continuous joint gets the limits that it lacks, infinite."""
    what, kind, limit = f"joint {joint.get('name')!r}", joint.get("type"), joint.find("limit")
    missing = ["limit"] if limit is None else [a for a in ("effort", "velocity") if limit.get(a) is None]
    if missing and kind in ("revolute", "prismatic"):
        raise BadRobot(f"{what}: a {kind} joint needs a <limit> with effort and velocity; {missing[0]} is missing")
    if limit is None:
        return
    for attribute in missing:
        limit.set(attribute, repr(sys.float_info.max))
    lower, upper = (float(limit.get(a, 0.0)) for a in ("lower", "upper"))
    if lower > upper and kind != "continuous":
        default = "" if limit.get("lower") and limit.get("upper") else " (0 where it is missing)"
        raise BadRobot(f"{what}: its limit lower={lower:g} is above upper={upper:g}{default}")


def _inertias(robot: ElementTree.Element) -> dict[str, Array]:
    out = {}
    for link in robot.findall("link"):
        inertia = link.find("inertial/inertia")
        if inertia is not None:
            xx, xy, xz, yy, yz, zz = (float(inertia.attrib[a]) for a in _NUMBERS["inertia"])
            out[str(link.get("name"))] = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return out


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
