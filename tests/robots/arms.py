"""Small URDF texts for the tests."""

from __future__ import annotations

LINK = (
    '<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="0.2 0 0"/>'
    '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>'
)
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="1.5" effort="10" velocity="3"/><dynamics damping="{damping}" friction="0.7"/>{more}</joint>'
)


def link(name: str, mass: float | str = 1.0) -> str:
    return LINK.format(name=name, mass=mass)


def joint(name: str, parent: str, child: str, kind: str = "revolute", damping: float | str = 0.3, more: str = "") -> str:
    return JOINT.format(name=name, parent=parent, child=child, kind=kind, damping=damping, more=more)


def robot(*parts: str) -> str:
    return '<robot name="arm"><link name="base"/>' + "".join(parts) + "</robot>"


TWO = robot(link("one"), link("two"), joint("j1", "base", "one"), joint("j2", "one", "two", damping=0.4))
CONTINUOUS = robot(link("one"), link("two"), joint("j1", "base", "one", "continuous"), joint("j2", "one", "two", "prismatic"))
FORK = robot(link("one"), link("left"), link("right"), joint("j1", "base", "one"), joint("jl", "one", "left"), joint("jr", "one", "right"))

#: four joints: two turn about the vertical, one slides along it, the last turns the tool
SCARA = robot(
    link("one", 4.0), link("two", 3.0), link("quill", 1.0), link("hand", 0.5),
    joint("shoulder", "base", "one"), joint("elbow", "one", "two"), joint("lift", "two", "quill", "prismatic"), joint("turn", "quill", "hand"),
)  # fmt: skip
