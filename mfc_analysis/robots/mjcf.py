"""Reads and checks an MJCF (MuJoCo XML) before Pinocchio does: what Pinocchio reads otherwise than MuJoCo, or not at all, is refused or said.

Only bodies with their joints and inertias are used. Meshes are not opened, so a body whose mass is that of a mesh is refused.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from mfc_analysis.errors import BadRobot, MfcWarning
from mfc_analysis.maths import checks
from mfc_analysis.robots.urdf import MOST_PARTS, read_xml

Element = ElementTree.Element

DEEPEST = 8  #: files that include one another
WHAT = "an MJCF file"
_KEPT = ("compiler", "default", "worldbody")
_INNER = ("body", "joint", "freejoint", "inertial", "geom", "site")
_OTHERWISE = {  # attributes of <compiler> that change the inertias and that Pinocchio does not read, with the values that change nothing
    "settotalmass": ("-1", "0"),
    "boundmass": ("0",),
    "boundinertia": ("0",),
    "balanceinertia": ("false",),
    "inertiagrouprange": ("0 5",),
    "coordinate": ("local",),
}
_NOT_READ = (
    ("joint", "stiffness", "the joint stiffness: the robot has no springs"),
    ("body", "gravcomp", "gravcomp: gravity is not compensated"),
    ("actuator", "armature", "the armature of actuators: give it to the joint"),
    ("actuator", "damping", "the damping of actuators: give it to the joint"),
)
_SOLID = ("sphere", "capsule", "ellipsoid", "cylinder", "box")


@dataclass(frozen=True, eq=False)
class Mjcf:
    """What is read of an MJCF."""

    text: str  #: compiler, defaults and the bodies of the robot, as XML that Pinocchio reads as MuJoCo does
    name: str  #: of the model
    gravity: tuple[float, float, float]  #: [m/s^2] of its options


def checked_mjcf(source: object) -> Mjcf:
    """The bodies of an MJCF, given as a path or as the XML itself, with the files that it includes.

    Warns (``MfcWarning``) of what acts in MuJoCo and is not read: springs, tendons, equality constraints, gravity compensation. Raises
    ``BadRobot``, which names the element: not XML, no ``<mujoco>``, no or several robots, elements or compiler settings that Pinocchio does not
    read, a body whose mass is that of a mesh; ``BadArgument`` where there is no such file.
    """
    text = read_xml(source, WHAT)
    folder = None if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<") else checks.path("source", source).expanduser().parent
    root = _parsed(text, WHAT)
    if root.tag != "mujoco":
        raise BadRobot(f"not an MJCF: its root element is <{root.tag}>, not <mujoco>")
    _include(root, folder, 0)
    if sum(1 for _ in root.iter()) > 10 * MOST_PARTS:
        raise BadRobot(f"the MJCF has more than {10 * MOST_PARTS} elements")
    from_geoms = _check_compiler(root)
    _warn(root)
    for worldbody in root.findall("worldbody"):
        _frames_to_bodies(worldbody, from_geoms, True)
    top = _robot(root)
    for body in top.iter("body"):
        _check_body(body, root, from_geoms)
    _limit_torques(top, root)
    bare = Element("mujoco", {"model": root.get("model") or "robot"})
    bare.extend([element for element in root if element.tag in _KEPT[:2]])
    _strip_meshes(bare)
    fixed = ElementTree.SubElement(ElementTree.SubElement(bare, "worldbody"), "body", {"name": "mjcf_world"})
    fixed.append(top)  # Pinocchio leaves out where the first body stands, unless a joint moves it
    return Mjcf(ElementTree.tostring(bare, encoding="unicode"), root.get("model") or "robot", _gravity(root))


def _parsed(text: str, what: str) -> Element:
    try:
        return ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    except (ElementTree.ParseError, ValueError) as why:
        raise BadRobot(f"{what} is not XML: {why}") from why


def _include(element: Element, folder: Path | None, depth: int) -> None:
    """Puts the contents of the files that are included in their place."""
    children: list[Element] = []
    for child in element:
        if child.tag != "include":
            _include(child, folder, depth)
            children.append(child)
            continue
        name = child.get("file", "")
        if folder is None or depth == DEEPEST:
            reason = "includes files within one another too deeply" if folder else "is given as text: give its path instead"
            raise BadRobot(f"the MJCF includes {name!r} and {reason}")
        inner = _parsed(read_xml(folder / name, WHAT), name)
        _include(inner, folder, depth + 1)
        children.extend(inner)
    element[:] = children


def _check_compiler(root: Element) -> bool:
    """Raises BadRobot for settings that Pinocchio does not read; returns whether inertias come from geoms always."""
    from_geoms = False
    for compiler in root.findall("compiler"):
        for attribute, harmless in _OTHERWISE.items():
            if " ".join((compiler.get(attribute) or harmless[0]).split()) not in harmless:
                raise BadRobot(
                    f"the MJCF's compiler has {attribute}={compiler.get(attribute)!r}, which Pinocchio does not read: write the inertias out, for "
                    "example with mj_saveLastXML"
                )
        from_geoms = compiler.get("inertiafromgeom", "auto") == "true"
    return from_geoms


def _warn(root: Element) -> None:
    def found(tag: str, attribute: str) -> bool:
        where = (e for actuator in root.findall("actuator") for e in actuator) if tag == "actuator" else root.iter(tag)
        return any(e.get(attribute, "0").strip() not in ("0", "0.0") for e in where)

    said = [text for tag, attribute, text in _NOT_READ if found(tag, attribute)]
    said += [f"its <{tag}>" for tag in ("equality", "tendon", "deformable") if any(len(element) for element in root.findall(tag))]
    if said:
        warnings.warn(f"the MJCF has what this library does not read: {'; '.join(said)}", MfcWarning, stacklevel=4)


def _frames_to_bodies(parent: Element, from_geoms: bool, counts: bool) -> None:
    """Turns each ``<frame>``, which Pinocchio does not read, into a body fixed to its parent. ``counts``: geoms count towards the parent's mass."""
    for i, child in enumerate(list(parent)):
        if child.tag == "frame":
            if any(inner.tag in ("joint", "freejoint", "inertial") for inner in child):
                raise BadRobot(
                    "the MJCF has a <frame> with a joint or an inertia of its body in it, which is not supported: write it without the frame"
                )
            child.tag = "body"
            child.set("name", f"{parent.get('name', 'world')}_frame_{i}")
            if not counts:
                child[:] = [inner for inner in child if inner.tag != "geom"]
            _frames_to_bodies(child, from_geoms, counts)
            if not len(child):
                parent.remove(child)
        elif child.tag == "body":
            _frames_to_bodies(child, from_geoms, from_geoms or child.find("inertial") is None)


def _robot(root: Element) -> Element:
    """The body of the robot: the only one in the world that has joints."""
    world = [element for worldbody in root.findall("worldbody") for element in worldbody]
    for element in (e for top in world for e in top.iter()):
        if element.tag in ("replicate", "composite", "flexcomp", "attach"):
            raise BadRobot(f"the MJCF has <{element.tag}> in its world, which Pinocchio does not read: expand it, for example with mj_saveLastXML")
    moving = [body for body in world if body.tag == "body" and any(True for tag in ("joint", "freejoint") for _ in body.iter(tag))]
    if len(moving) != 1:
        names = ", ".join(repr(body.get("name", "")) for body in moving)
        raise BadRobot(f"the MJCF needs exactly one body in the world that has joints, and has {len(moving)}" + (f": {names}" if moving else ""))
    for parent in moving[0].iter():
        parent[:] = [child for child in parent if child.tag in _INNER]
    return moving[0]


def _check_body(body: Element, root: Element, from_geoms: bool) -> None:
    """Raises BadRobot where the mass of a body cannot be read; removes geoms that do not count."""
    name = body.get("name") or "without a name"
    inertial = body.find("inertial")
    if inertial is not None:
        missing = [a for a in ("pos", "mass") if inertial.get(a) is None]
        if not inertial.get("diaginertia") and not inertial.get("fullinertia"):
            missing.append("diaginertia or fullinertia")
        if missing:
            raise BadRobot(f"body {name!r}: its <inertial> has no {missing[0]}")
    geoms = body.findall("geom")
    if inertial is not None and not from_geoms:
        for geom in geoms:
            body.remove(geom)
        return
    kinds = {c.get("class"): c for c in root.iter("default")}
    for geom in geoms:
        default = kinds.get(geom.get("class"))
        inherited = None if default is None else default.find("geom")
        both = {**({} if inherited is None else inherited.attrib), **geom.attrib}
        if both.get("shellinertia", "false") == "true":
            raise BadRobot(f"body {name!r} has a geom with shellinertia, which Pinocchio does not read: give the body an <inertial>")
        if "mesh" in both or both.get("type", "sphere") not in _SOLID:
            raise BadRobot(f"body {name!r} has no <inertial> and a geom of type {both.get('type', 'mesh')}, whose mass is not read: give it one")


def _limit_torques(top: Element, root: Element) -> None:
    """Gives each joint without ``actuatorfrcrange`` the largest torque of its actuators: forcerange (a motor: ctrlrange) times gear."""
    if any(joint.get("actuatorfrcrange") for default in root.findall("default") for joint in default.iter("joint")):
        return
    joints = {joint.get("name"): joint for joint in top.iter("joint")}
    total: dict[str, float] = {}
    for actuator in (child for element in root.findall("actuator") for child in element):
        given = {**_defaults(root, actuator.tag, actuator.get("class", "main")), **actuator.attrib}
        name = given.get("joint", "")
        text = given.get("forcerange") or (given.get("ctrlrange") if actuator.tag == "motor" else None)
        numbers = [checks.decimal(word) for word in f"{text or ''} {given.get('gear', '1').split()[0]}".split()]
        known = [value for value in numbers if value is not None]
        if len(known) != 3 or len(numbers) != 3:
            total[name] = float("inf")  # an actuator without a limit
        else:
            total[name] = total.get(name, 0.0) + max(abs(known[0]), abs(known[1])) * abs(known[2])
    for name, torque in total.items():
        if name in joints and 0 < torque < float("inf") and joints[name].get("actuatorfrcrange") is None:
            joints[name].set("actuatorfrcrange", f"{-torque!r} {torque!r}")


def _defaults(root: Element, tag: str, name: str) -> dict[str, str]:
    """What the default class ``name`` says of an element, with what it inherits."""

    def within(default: Element, above: dict[str, str], outermost: bool) -> dict[str, str] | None:
        own = dict(above)
        for given in default.findall(tag):
            own |= given.attrib
        if default.get("class", "main" if outermost else "") == name:
            return own
        found = (within(inner, own, False) for inner in default.findall("default"))
        return next((one for one in found if one is not None), None)

    every = (within(default, {}, True) for default in root.findall("default"))
    return next((one for one in every if one is not None), {})


def _strip_meshes(bare: Element) -> None:
    """Removes what defaults say of meshes and materials, of which there are none left."""
    for element in bare.iter():
        for child in [c for c in element if c.tag in ("mesh", "material", "camera", "light", "tendon", "equality", "pair")]:
            element.remove(child)
        for attribute in ("material", "mesh", "hfield"):
            element.attrib.pop(attribute, None)


def _gravity(root: Element) -> tuple[float, float, float]:
    given = "0 0 -9.81"
    for option in root.findall("option"):
        given = option.get("gravity", given)
    values = [value for value in map(checks.decimal, given.split()) if value is not None]
    if len(values) != 3 or len(given.split()) != 3:
        raise BadRobot(f"the MJCF's gravity {given!r} is not 3 finite numbers")
    return values[0], values[1], values[2]
