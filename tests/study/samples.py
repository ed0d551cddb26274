"""A study to change, and what comes of reading it."""

from __future__ import annotations

from pathlib import Path

import pytest

from mfc_analysis.errors import MfcError
from mfc_analysis.study.read import Study, StudyError, read

Q = [0.0, -1.0, 1.4, -1.9, -1.57, 0.0]
BASE = f"""
title = "a study"
q_start = {Q}
[robot]
name = "ur5"
payload = {{ mass = 2.0, com = [0, 0, 0.05], inertia = 0.005 }}
[controller_model]
payload = false
[law]
equation = "9.10"
kp = 100
ki = 200
kd = 20
[reference]
kind = "Quintic"
q1 = [1.0, -1.4, 1.7, -2.0, -1.5, 0.5]
duration = 2
[hardware]
torque_lag = 2e-3
[times]
stop = 2
count = 5
[requirements]
phase_deg = 30
"""

#: two links and two turning joints, the first of a name to be given
URDF = """<robot name="{name}"><link name="base"/>
<joint name="{joint}" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="30" velocity="3"/></joint>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="wrist" type="revolute"><parent link="arm"/><child link="hand"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="3"/></joint>
<link name="hand"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.002" iyy="0.004" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


def study(folder: Path, text: str, name: str = "s.toml") -> Study:
    """The study of this text."""
    (folder / name).write_text(text, encoding="utf-8")
    return read(folder / name)


def refused(folder: Path, text: str) -> StudyError:
    """The error of a study that cannot be used; it names the file."""
    with pytest.raises(StudyError) as why:
        study(folder, text)
    assert isinstance(why.value, ValueError) and isinstance(why.value, MfcError)
    assert why.value.file.endswith("s.toml") and why.value.file in str(why.value)
    return why.value
