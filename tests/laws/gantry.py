"""A gantry with a wrist whose axes meet in the centre of mass of the tool: at q = 0 J = 1 and Lambda is diagonal."""

from __future__ import annotations

from functools import cache

from mfc_analysis.robots.robot import Robot

AXES = ("x", "y", "z", "rx", "ry", "rz")
MASSES = (3.0, 2.0, 1.5)  #: [kg] of the slides and what they carry beyond the tool
TOOL, TURN = 1.2, (0.05, 0.07, 0.09)  #: [kg], [kg m^2] about its axes
#: [kg, kg m^2] Lambda(0): each slide carries those after it
INERTIAS = (sum(MASSES) + TOOL, MASSES[1] + MASSES[2] + TOOL, MASSES[2] + TOOL, *TURN)


@cache
def gantry() -> Robot:
    """Slides along x, y, z, then turns about x, y, z; no gravity, no friction. Joints and channels are named after the axes."""

    def link(name: str, mass: float, inertia: tuple[float, ...]) -> str:
        xx, yy, zz = inertia
        body = f'<inertial><mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        return f'<link name="{name}">{body}</link>'

    def joint(axis: str, parent: str, child: str) -> str:
        kind = "revolute" if axis.startswith("r") else "prismatic"
        along = " ".join("1" if axis.endswith(c) else "0" for c in "xyz")
        limit = '<limit lower="-3" upper="3" effort="1000" velocity="10"/>'
        return f'<joint name="{axis}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{along}"/>{limit}</joint>'

    tiny = 1e-12  # of the massless links of the wrist
    links = [(*MASSES, tiny, tiny, TOOL), (*[(1e-3, 1e-3, 1e-3)] * 3, *[(tiny, tiny, tiny)] * 2, TURN)]
    text = '<robot name="gantry"><link name="base"/>'
    parent = "base"
    for axis, mass, inertia in zip(AXES, *links, strict=True):
        text += link(f"link_{axis}", mass, inertia) + joint(axis, parent, f"link_{axis}")
        parent = f"link_{axis}"
    return Robot.from_urdf(text + "</robot>", gravity=(0.0, 0.0, 0.0))
