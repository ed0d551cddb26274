"""A loop rebuilt from the JSON of its report alone has the margins that the report gives, and so has its Python code."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.report.document.document import Document
from mfc_analysis.report.loops.record import KEY, gains_section, record, recorded, setups_section
from mfc_analysis.report.loops.report import loop_document
from mfc_analysis.report.render.numbers import plain
from mfc_analysis.report.render.write import rendered
from tests.report.loops.test_report import LOOPS

NAMESPACES: tuple[Any, ...] = (mfc.laws, mfc.trajectories, mfc)


def value(data: Any) -> Any:
    """A value of the JSON: a class with its arguments, a list as an array."""
    if isinstance(data, dict) and "class" in data:
        home = next(space for space in NAMESPACES if hasattr(space, data["class"]))
        own = {k: value(v) for k, v in data.items() if k not in ("class", "equation")}
        return getattr(home, data["class"])(**own)
    if isinstance(data, dict):
        return {k: value(v) for k, v in data.items()}
    return np.array(data) if isinstance(data, list) else data


def arm(data: dict[str, Any]) -> mfc.Robot:
    """The robot of the JSON: by its name, with its friction and payloads."""
    robot = getattr(mfc.robots, data["name"])()
    robot = robot.with_friction(np.array(data["viscous"]), np.array(data["coulomb"]))
    for load in data["payloads"]:
        robot = robot.with_payload(load["mass"], load["com"], load["inertia"])
    return robot


def rebuilt(data: dict[str, Any]) -> mfc.ClosedLoop:
    """The loop of a record in the JSON, from gains, arm, path and hardware."""
    model = None if data["controller_model"] == data["robot"] else arm(data["controller_model"])
    start = None if data["q_start"] is None else np.array(data["q_start"])
    surfaces = [value(x) for x in data["surfaces"]] or None
    return mfc.ClosedLoop(
        arm(data["robot"]), value(data["law"]), value(data["reference"]), model, surfaces, q_start=start, hardware=value(data["hardware"])
    )


def assert_same_margins(found: dict[str, Any], loop: mfc.ClosedLoop) -> None:
    """The smallest phase and delay margins of the JSON are those of the loop."""
    lin = loop.linearize(found[KEY]["times"])
    for name in ("phase_deg", "delay"):
        values = np.concatenate([getattr(lin.margins(point), name).ravel() for point in lin.opened.points])
        smallest, given = np.min(values[~np.isnan(values)], initial=np.inf), found["smallest"][name]["value"]
        assert given == ("not defined" if np.isnan(values).all() else "infinite" if np.isinf(smallest) else pytest.approx(smallest, rel=1e-9))


@pytest.mark.parametrize(
    "kind", ["velocity, lag", "velocity, dead time", "wrong model, moving", "tool velocity", "force on a surface", "elastic joint"]
)
def test_a_loop_rebuilt_from_its_json_has_the_same_margins(kind: str) -> None:
    loop, times, *_ = LOOPS[kind]()
    data = json.loads(rendered(loop_document({"one": loop}, times), ("json",))["json"])
    assert_same_margins(data["sections"][-1]["numbers"], rebuilt(data["sections"][-1]["numbers"][KEY]))


def test_the_python_code_of_a_record_builds_the_loop_too() -> None:
    loop, times, *_ = LOOPS["wrong model, moving"]()
    made: dict[str, Any] = {}
    exec(record(loop, times)["python"], made)
    assert_allclose(made["loop"].linearize(times).A, loop.linearize(times).A, rtol=1e-12)


def test_a_record_has_only_what_differs_from_the_defaults_and_no_array_of_a_default() -> None:
    arm = mfc.robots.slider()
    loop = mfc.ClosedLoop(arm, mfc.laws.JointPID(25.0, kd=6.0), mfc.trajectories.Hold([0.1]), hardware=mfc.Hardware(delay=1e-3))
    data = json.loads(json.dumps(plain(record(loop, [0.0], "torque"))))
    assert data["law"] == {"class": "JointPID", "kp": 25.0, "kd": 6.0, "equation": "9.8"}
    assert data["gains"] == {"kp": {"value": 25.0, "unit": "Nm/rad"}, "kd": {"value": 6.0, "unit": "Nm s/rad"}}
    assert data["hardware"] == {"class": "Hardware", "delay": 1e-3} and data["reference"] == {"class": "Hold", "q": [0.1]}
    assert (data["at"], data["surfaces"], data["q_start"], data["times"]) == ("torque", [], None, [0.0])


def test_the_table_of_setups_has_units_by_joint_axis_and_quantity() -> None:
    wall = mfc.Environment(np.array([1e3, 20.0]), axes="zrx", preload=np.array([5.0, 0.0]))
    law = mfc.laws.DampedForcePI((0, 0, 20.0, 0, 0, 0), 1.0, 5.0, kdamp=60.0)
    lag = mfc.Hardware(torque_lag=2e-3)
    found = loop_document(mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(np.zeros(6)), environment=wall, hardware=lag))
    ((table,),) = (s.body for s in setups_section(found.sections))
    ((_, arm, path, hardware, at),) = table.rows
    assert (arm, path, at) == ("ur5; model exact", "Hold: q (0, 0, 0, 0, 0, 0) rad; t = 0 s", "torque")
    assert hardware == "torque lag 0.002 s; surface: stiffness (1000, 20) N/m, Nm/rad, axes zrx, preload (5, 0) N"


def test_a_reference_of_ones_own_is_named_and_many_numbers_are_counted() -> None:
    class Own(mfc.trajectories.Hold):
        """Not of this package."""

    arm = mfc.robots.slider()
    law = mfc.laws.JointPID(25.0, kd=6.0)
    long = mfc.trajectories.Waypoints(np.linspace(0, 1, 70), np.linspace(0, 1, 70)[:, None])
    found = loop_document([mfc.ClosedLoop(arm, law, ref) for ref in (Own([0.1]), long)])
    ((table,),) = (s.body for s in setups_section(found.sections))
    own, many = table.rows
    assert own[2].startswith("Own") and "70 numbers (in the JSON)" in many[2] and "70 × 1 numbers" in many[2]
    json.dumps(plain(record(mfc.ClosedLoop(arm, law, Own([0.1])))), allow_nan=False)


def test_gains_and_setups_name_every_loop_and_share_rows_where_they_are_the_same() -> None:
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(25.0, kd=6.0), mfc.trajectories.Hold([0.1]))
    document = loop_document({"9.8, a": loop, "9.8, b": loop, "other": mfc.ClosedLoop(loop.robot, mfc.laws.TorqueFeedforward(), loop.ref)})
    assert list(recorded(document.sections)) == ["9.8, a", "9.8, b", "other"]
    ((gains,),), ((setups,),) = ([s.body for s in make(document.sections)] for make in (gains_section, setups_section))
    assert [row[0] for row in gains.rows] == ["9.8, a and b", "other"]
    assert gains.rows[0][1:] == ("JointPID, eq. 9.8", "kp = 25 Nm/rad; kd = 6 Nm s/rad", "as given") and gains.rows[1][2] == "none"
    assert setups.rows == (("9.8, a and b; other", "slider; model exact", "Hold: q 0.1 m; t = 0 s", "ideal", "torque"),)
    assert gains_section(()) == setups_section(()) == () and Document("t", "s", ()).front == ()


def test_gains_of_forces_have_the_units_along_and_about_the_axes_that_they_act_on() -> None:
    def said(law: mfc.laws.Law) -> str:
        ((table,),) = (s.body for s in gains_section(loop_document(mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(q))).sections))
        return str(table.rows[0][2])

    q = np.array([0.3, -1.25, 1.9, -2.2, -1.57, 0.2])
    both = said(mfc.laws.DampedForcePI((0, 0, 20.0, 0, 0, 1.0), 1.0, 5.0, kdamp=(200.0, 200.0, 200.0, 4.0, 4.0, 4.0)))
    assert "kdamp = (200, 200, 200, 4, 4, 4) Ns/m, Nm s/rad" in both and both.endswith("F_d = (0, 0, 20, 0, 0, 1) N, Nm")
    assert said(mfc.laws.DampedForcePI((0, 0, 20.0, 0, 0, 0), 1.0, 5.0, kdamp=60.0)).endswith(
        "kdamp = 60 Ns/m, Nm s/rad; F_d = (0, 0, 20, 0, 0, 0) N"
    )
    assert said(mfc.laws.DampedForcePI((0, 0, 0, 0, 0, 1.0), 1.0, kdamp=(0, 0, 0, 0, 0, 4.0))).endswith(
        "kdamp = (0, 0, 0, 0, 0, 4) Nm s/rad; F_d = (0, 0, 0, 0, 0, 1) Nm"
    )


def test_the_servo_of_a_setup_has_its_own_units() -> None:
    law = mfc.laws.VelocityP(4.0)
    hardware = mfc.Hardware(servo=mfc.Servo(bandwidth=50.0, damping=0.7, delay=0.016))
    loop = mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.1]), hardware=hardware)
    ((table,),) = (s.body for s in setups_section(loop_document(loop).sections))
    assert table.rows[0][3] == "servo (bandwidth 50 rad/s, damping 0.7 (ratio), delay 0.016 s)"
