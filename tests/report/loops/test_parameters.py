"""A loop in words: its hardware, model and surfaces with their numbers."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.report.document.document import Equation, Table
from mfc_analysis.report.loops import parameters
from mfc_analysis.report.loops.view import View
from tests.report.loops.views import PUSH, H, L, T, joint, links, planar, pushing, view


def cells(found: View) -> str:
    """All text of the tables of the section about the loop and its parameters."""
    return " ".join(str(cell) for block in parameters.parameters(found) if isinstance(block, Table) for row in block.rows for cell in row)


def test_every_piece_of_hardware_is_told_with_its_number() -> None:
    given = {
        "torque_lag": 0.0011, "delay": 0.0013, "sample_time": 0.0026, "velocity_filter": 0.0017, "joint_stiffness": 1900.0, "joint_damping": 2.3,
        "motor_inertia": 0.29, "torque_limit": 31.0,
    }  # fmt: skip
    assert set(given) < {field.name for field in fields(H)}
    said = cells(view(mfc.ClosedLoop(joint(), L.JointPID(50.0, kd=10.0), T.Hold([0.3]), hardware=H(**given))))
    ideal = cells(view(mfc.ClosedLoop(joint(), L.JointPID(50.0, kd=10.0), T.Hold([0.3]))))
    for value in given.values():
        assert f"{value:g}" in said and f"{value:g}" not in ideal
    assert all(f"{value:g} N" in cells(pushing()) for value in (1000.0, PUSH[2]))


def test_the_servo_and_the_sensor_are_told_and_a_law_outside_the_chapter_has_no_number() -> None:
    hardware = H(servo=mfc.Servo(47.0, 0.71, 0.013), velocity_limit=0.83, force_limit=61.0, force_deadband=1.7)
    law = L.Admittance(np.zeros(6), 4.0, 80.0, axes="z")
    found = view(mfc.ClosedLoop(mfc.robots.slider(), law, T.Hold([0.0]), environment=mfc.Environment(1e3), hardware=hardware))
    said = cells(found)
    assert all(word in said for word in ("bandwidth 47 rad/s (-3 dB), damping 0.71, dead time 0.013 s", "0.83 m/s", "61 N", "1.7 N"))
    equations = [block for block in parameters.the_loop(found).body if isinstance(block, Equation)]
    assert [block.number for block in equations] == ["", ""] and "admittance" in equations[0].alt and "servo" in equations[1].alt


def test_anti_windup_is_told() -> None:
    law = L.JointPID(50.0, 20.0, 10.0, anti_windup=0.037)
    assert "0.037 s" in cells(view(mfc.ClosedLoop(joint(), law, T.Hold([0.3]))))


def test_selected_directions_are_told() -> None:
    q = np.array([0.2, 0.4])
    for axes, said in (("xy", "xy of the tool frame"), ([[0.6, 0.8, 0, 0, 0, 0]], "rows (0.6, 0.8, 0, 0, 0, 0)")):
        loop = mfc.ClosedLoop(planar(), L.TaskVelocity(4.0, axes=axes), T.ToolHold(planar().pose(q)), q_start=q)
        assert said in cells(view(loop))


@pytest.mark.parametrize(
    ("robot", "unit", "other"),
    [(joint(), "31 Nm", "N of"), (mfc.robots.slider(), "31 N", "Nm"), (mfc.robots.rp(), "31 Nm (N of sliding joints)", "kg)")],
)
def test_hardware_of_sliding_joints_has_the_units_of_forces(robot: mfc.Robot, unit: str, other: str) -> None:
    law, hardware = L.JointPID(50.0, kd=10.0), H(torque_limit=31.0, joint_stiffness=1900.0, motor_inertia=0.3)
    said = cells(view(mfc.ClosedLoop(robot, law, T.Hold(np.full(robot.n, 0.3)), hardware=hardware)))
    assert unit in said and other not in said and ("1900 N/m" in said) == (robot.name == "slider")


def test_the_model_is_told_by_the_payload_and_inertia_that_it_lacks() -> None:
    loop = mfc.ClosedLoop(planar().with_payload(3.0), L.ComputedTorque(64.0, kd=16.0), T.Hold([0.3, 0.2]), controller_model=planar())
    said = parameters.model_words(view(loop))
    M, lighter = loop.robot.mass(np.array([0.3, 0.2])), planar().mass(np.array([0.3, 0.2]))
    assert "3 kg" in said and f"{100 * np.abs(M - lighter).max() / np.abs(M).max():.2f} %" in said
    assert not any(x.isdigit() for x in parameters.model_words(links()))
    assert parameters.array_words(np.array([[1.0, 0.25], [0.0, 2.0]])) == "(1, 0.25); (0, 2)"


def test_a_force_law_has_a_whole_name_and_gains_of_the_tool():
    wall = mfc.Environment(stiffness=2e4, axes="z", preload=15.0)
    law = mfc.laws.DampedForcePI((0, 0, 15.0, 0, 0, 0), 0.5, 3.0, kdamp=(150, 150, 150, 8, 8, 8))
    loop = mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold([0.3, -1.25, 1.9, -2.2, -1.57, 0.2]), environment=wall)
    assert str(loop) == "DampedForcePI(kfp = 0.5, kfi = 3, kdamp = [150, 150, 150, 8, 8, 8]) [eq. 9.23] on ur5, 1 surface"
    gains = next(x for x in parameters.parameters(view(loop)) if isinstance(x, Table) and x.caption == "Controller gains.")
    assert gains.columns[2].head == "Value (scalar, diagonal or matrix)"
    assert gains.rows[2] == ("kdamp", "Ns/m, Nm s/rad", "(150, 150, 150, 8, 8, 8)")
    assert parameters._in_two_lines("DampedForcePI") == "Damped\nForcePI" and parameters._in_two_lines("Uninterrupted") == "Uninterrupted"
