"""Reports of one's own loops: every kind of loop gets its pages, the numbers are right, and names stay names."""

from __future__ import annotations

import json
import time
from functools import cache

import control
import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet
from mfc_analysis.report.document.document import Figure, Row
from mfc_analysis.report.loops.report import loop_document
from mfc_analysis.report.render.write import rendered
from mfc_analysis.robots.catalogue import ur5_urdf
from tests.plots.test_figure import texts
from tests.report.render.test_html import HOSTILE, Page

L, T, H = mfc.laws, mfc.trajectories, mfc.Hardware
Q = np.array([0.0, -1.2, 1.4, -0.7, 1.57, 0.0])
FORCE = np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
REQUIREMENTS = mfc.Requirements(phase_deg=45, gain_increase_db=6, gain_reduction_db=6, sensitivity_peak=2.0)
PATH = np.linspace(0.0, 2.0, 5)


@cache
def ur5() -> mfc.Robot:
    return mfc.robots.ur5()


def quintic() -> T.Quintic:
    return T.Quintic(Q, Q + np.array([0.8, 0.5, -0.6, 0.4, -0.3, 0.5]), 2.0)


def surface() -> mfc.Environment:
    return mfc.Environment(stiffness=1e4, damping=10.0, pose=ur5().pose(Q), axes="z", preload=5.0)


def pid(w: float = 8.0) -> dict:
    return dict(mfc.gains.pid(natural_frequency=w))


def joint() -> mfc.Robot:
    return mfc.robots.single_joint()


#: kind of loop -> (loop, times)
LOOPS = {
    "open loop, moving": lambda: (mfc.ClosedLoop(ur5(), L.VelocityFeedforward(), quintic()), PATH),
    "velocity, one time": lambda: (mfc.ClosedLoop(joint(), L.VelocityP(4.0), T.Hold([0.3])), [0.0]),
    "velocity, lag": lambda: (mfc.ClosedLoop(ur5(), L.VelocityPI(4.0, 4.0), quintic(), hardware=H(velocity_lag=5e-3)), PATH),
    "velocity, sampled": lambda: (
        mfc.ClosedLoop(joint(), L.VelocityFeedforwardPI(4.0, 4.0), T.Quintic([0.0], [1.0], 2.0), hardware=H(sample_time=8e-3)),
        PATH,
    ),
    "velocity, dead time": lambda: (mfc.ClosedLoop(joint(), L.VelocityPI(4.0, 4.0), T.Hold([0.3]), hardware=H(delay=2e-2)), [0.0]),
    "unstable": lambda: (mfc.ClosedLoop(joint(), L.JointPID(kp=10.0, ki=1e3, kd=1.0), T.Hold([0.3])), [0.0]),
    "unstable in part of the path": lambda: (mfc.ClosedLoop(joint(), L.JointPID(kp=0.4, kd=1.0), T.Quintic([-0.5], [1.3], 2.0)), PATH),
    "open loop, torque": lambda: (mfc.ClosedLoop(mfc.robots.planar_2r(), L.TorqueFeedforward(form="printed"), T.Hold([0.3, 0.2])), [0.0]),
    "drifting": lambda: (mfc.ClosedLoop(mfc.robots.slider(), L.DampedForcePI(FORCE, 1.0, 1.0, kdamp=20), T.Hold([0.0])), [0.0]),
    "neutral": lambda: (mfc.ClosedLoop(mfc.robots.slider(friction=1.0), L.OpenLoopForce(FORCE), T.Hold([0.0])), [0.0]),
    "elastic joint": lambda: (
        mfc.ClosedLoop(
            joint(),
            L.JointPID(**mfc.gains.joint_pid(joint(), [0.3], natural_frequency=5)),
            T.Hold([0.3]),
            hardware=H(joint_stiffness=2e3, motor_inertia=0.1, joint_damping=1.0),
        ),
        [0.0],
    ),
    "outer loop of python-control": lambda: (mfc.ClosedLoop(joint(), L.InverseDynamics(control.tf([20, 100], [0.01, 1])), T.Hold([0.3])), [0.0]),
    "an integral that acts on nothing": lambda: (
        mfc.ClosedLoop(mfc.robots.rp(), L.ComputedTorque(kp=100, ki=[0, 10.0], kd=20), T.Hold([0.3, 0.5])),
        [0.0],
    ),
    "wrong model, moving": lambda: (mfc.ClosedLoop(ur5().with_payload(2.0), L.ComputedTorque(**pid()), quintic(), controller_model=ur5()), PATH),
    "tool velocity": lambda: (
        mfc.ClosedLoop(ur5(), L.TaskVelocity(4.0, 2.0), T.ToolCircle(ur5().pose(Q), 0.05, 2.0), q_start=Q),
        np.linspace(0, 1, 4),
    ),
    "tool velocity on a joint path": lambda: (mfc.ClosedLoop(ur5(), L.TaskVelocity(4.0), quintic()), PATH),
    "force on a surface": lambda: (
        mfc.ClosedLoop(
            mfc.robots.slider(),
            L.DampedForcePI(FORCE, 1.0, 5.0, kdamp=60),
            T.Hold([0.0]),
            environment=mfc.Environment(1e3, 0.0, axes="z", preload=5.0),
        ),
        [0.0],
    ),
    "impedance on a surface": lambda: (
        mfc.ClosedLoop(
            mfc.robots.slider(),
            L.Impedance(500.0, 40.0, axes="z"),
            T.Hold([0.0]),
            environment=mfc.Environment(1e3, axes="z"),
            hardware=H(torque_lag=5e-3),
        ),
        [0.0],
    ),
    "admittance behind a servo": lambda: (
        mfc.ClosedLoop(
            mfc.robots.slider(),
            L.Admittance(FORCE, 4.0, 80.0, axes="z"),
            T.Hold([0.0]),
            environment=mfc.Environment(1e3, 0.0, axes="z", preload=5.0),
            hardware=H(servo=mfc.Servo(50.0, 0.7, 0.01), sample_time=5e-3),
        ),
        [0.0],
    ),
}


@cache
def document(kind: str):
    loop, times = LOOPS[kind]()
    return loop_document({kind: loop}, times, REQUIREMENTS)


def every_section(sections):
    for section in sections:
        yield section
        yield from every_section(section.sections)


def figures(kind: str) -> list[Figure]:
    found = []
    for section in every_section(document(kind).sections):
        for block in section.body:
            found += [block] if isinstance(block, Figure) else list(block.figures) if isinstance(block, Row) else []
    return found


@pytest.mark.parametrize("kind", LOOPS)
def test_every_kind_of_loop_has_its_pages(kind):
    data = json.loads(rendered(document(kind), ("json",))["json"])
    (section,) = data["sections"]
    titles = [s["title"] for s in section["sections"]]
    assert titles[:3] == ["The loop and its parameters", "Stability margins", "Poles"]
    assert titles[-2:] == ["Validity of the linear model", "Pose of the arm"]
    assert ("Along the path" in titles) == (len(LOOPS[kind]()[1]) > 1 and "open loop" not in kind)
    assert all(s["finding"] or s["title"] in ("The loop and its parameters", "Pose of the arm") for s in section["sections"])
    assert section["status"] == data["verdict"]["status"]


@pytest.mark.parametrize("kind", LOOPS)
def test_no_figure_is_empty_and_no_text_leaves_its_sheet(kind, monkeypatch):
    with matplotlib.rc_context(sheet.settings()):
        for drawing in figures(kind):
            figure = sheet.figure_of(drawing.draw())
            assert any(ax.lines or ax.patches or ax.collections for ax in figure.axes), drawing.alt
            for said, box, whole in texts(figure, monkeypatch):
                inside = box.x0 > -0.5 and box.y0 > -0.5 and box.x1 < whole.width + 0.5 and box.y1 < whole.height + 0.5
                assert inside, f"{said!r} in {drawing.alt}"
            monkeypatch.undo()


def test_pages_of_a_stable_and_an_unstable_loop_render_in_all_formats():
    for kind in ("wrong model, moving", "unstable"):
        pages = rendered(document(kind), ("html", "pdf"))
        Page(pages["html"].decode())
        assert pages["pdf"].startswith(b"%PDF")


def test_an_unstable_loop_fails_everywhere_it_is_told():
    pages = rendered(document("unstable"), ("html", "json"))
    data = json.loads(pages["json"])
    (section,) = data["sections"]
    assert data["verdict"]["status"] == section["status"] == "FAIL"
    assert "Not stable" in section["finding"]
    assert {c["name"]: c["found"] for c in section["checks"]}["phase margin"] == "unstable"
    assert "unstable" in next(f["alt"] for f in data["figures"] if f["alt"].startswith("Bode"))
    assert '<div class="banner fail"' in pages["html"].decode()


def test_a_drifting_loop_is_watched_and_says_so():
    (section,) = document("drifting").sections
    assert section.checks[0].status in ("WATCH", "FAIL")
    assert any("drifts" in str(b) for b in section.body)


def test_numbers_of_the_report_are_python_controls_and_the_closed_forms():
    I, B, MGR, theta = 0.5, 0.1, 0.981, 0.3
    kp, ki, kd = 96.0, 256.0, 12.0
    loop = mfc.ClosedLoop(joint(), L.JointPID(kp=kp, ki=ki, kd=kd), T.Hold([theta]))
    data = json.loads(rendered(loop_document({"one": loop}, [0.0], REQUIREMENTS), ("json",))["json"])
    (section,) = data["sections"]
    plant = [I, B, -MGR * np.sin(theta)]
    C, P = control.tf([kd, kp, ki], [1, 0]), control.tf([1], plant)
    low, phase, _, crossover = control.margin(C * P)
    n = section["numbers"]
    assert_allclose([n["gain_reduction"][0], n["phase_deg"][0], n["crossover"][0]], [low, phase, crossover], rtol=1e-6)
    poles = [complex(z["re"], z["im"]) if isinstance(z, dict) else z for z in n["poles"]]
    assert_allclose(np.poly(poles), np.array([I, B + kd, kp + plant[2], ki]) / I, rtol=1e-9)
    assert_allclose(n["delay"][0], np.radians(phase) / crossover, rtol=1e-6)
    step = next(s for s in section["sections"] if s["title"] == "Step response, linear and nonlinear")["numbers"]
    _, y = control.step_response(_from_reference(kp, ki, kd, plant), np.linspace(0, 4, 40001))
    assert_allclose(step["overshoot"], y.max() - 1, rtol=1e-4)
    assert step["misfit"] < 0.02


def _from_reference(kp: float, ki: float, kd: float, plant: list[float]) -> control.TransferFunction:
    """q over a step of q_d that the rate wanted doesn't know of: (kp s + ki) / (s plant + kd s^2 + kp s + ki)."""
    return control.tf([kp, ki], np.polyadd(np.polymul(plant, [1, 0]), [kd, kp, ki]))


def test_the_step_on_a_moving_path_is_compared_with_the_loop_frozen_there():
    (section,) = document("wrong model, moving").sections
    found = next(s for s in section.sections if s.title == "Step response, linear and nonlinear").numbers
    assert 0 < found["misfit"] < 0.1 and found["size"] == 0.05


def test_two_hundred_points_in_under_five_seconds_of_computing():
    loop = LOOPS["wrong model, moving"]()[0]
    start = time.process_time()
    rendered(loop_document(loop, np.linspace(0, 2, 200), REQUIREMENTS))
    assert time.process_time() - start < 5.0  # both wall and CPU on a free machine; CPU on a busy one


def test_several_loops_have_a_matrix_and_their_own_requirements_and_times(tmp_path):
    loops = {"slow": LOOPS["velocity, one time"]()[0], "unstable": LOOPS["unstable"]()[0]}
    asked = {"slow": mfc.Requirements(delay=0.1), "unstable": mfc.Requirements()}
    out = mfc.report.write(loops, tmp_path, {"slow": [0.0], "unstable": [0.0]}, ("html", "json"), asked)
    data = json.loads(out["json"].read_text())
    assert [s["status"] for s in data["sections"]] == ["PASS", "FAIL"]
    assert {c["name"] for c in data["sections"][0]["checks"]} == {"stable", "delay margin"}
    assert 'id="matrix"' in out["html"].read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["loop-report.html", "loop-report.json"]


def test_hostile_names_show_as_text_and_write_nothing_outside(tmp_path):
    urdf = f"""<robot name="r"><link name="base"/><link name="l"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="{HOSTILE.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")}" type="revolute"><parent link="base"/><child link="l"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="10" velocity="3"/></joint></robot>"""
    loop = mfc.ClosedLoop(mfc.Robot.from_urdf(urdf), L.ComputedTorque(kp=100, kd=20), T.Hold([0.1]))
    folder = tmp_path / "out"
    out = mfc.report.write({HOSTILE: loop}, folder, [0.0], name="../../" + HOSTILE, title=HOSTILE, command=HOSTILE)
    assert {p.parent for p in out.values()} == {folder} and [p.name for p in tmp_path.iterdir()] == ["out"]
    page = Page(out["html"].read_text())
    assert HOSTILE in page.all("h1")[0]["text"]
    assert not [e for e in page.all("script") if "alert" in e["text"]]
    assert out["pdf"].read_bytes().startswith(b"%PDF")


def test_the_same_loop_twice_is_the_same_bytes():
    loop = LOOPS["velocity, one time"]()[0]
    assert rendered(loop_document(loop, [0.0])) == rendered(loop_document(loop, [0.0]))


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"loop": 3}, "loop"),
        ({"loop": []}, "loop"),
        ({"loop": {"a": 1}}, "loop['a']"),
        ({"requirements": {"phase_deg": 45}}, "requirements"),
        ({"requirements": 45}, "requirements"),
        ({"times": {"other": [0.0]}}, "times"),
        ({"formats": "docx"}, "formats"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, change, argument):
    given = {"loop": LOOPS["velocity, one time"]()[0], "folder": tmp_path / "out", **change}
    with pytest.raises(BadArgument) as caught:
        mfc.report.write(**given)
    assert caught.value.argument == argument
    assert not (tmp_path / "out").exists()


def test_provenance_has_the_input_and_the_command_and_no_date_of_its_own(tmp_path):
    loop = LOOPS["velocity, one time"]()[0]
    out = mfc.report.write(loop, tmp_path, [0.0], "json", command="mfc-analysis report my.toml", inputs={"my.toml": b"x"})
    items = json.loads(out["json"].read_text())["provenance"]
    assert items["command"] == "mfc-analysis report my.toml"
    assert items["items"]["SHA-256 of my.toml"].startswith("2d711642b726b044")
    assert "date" not in items["items"] and "numpy" in items["items"]


def test_the_pages_name_joints_without_their_common_prefix_and_the_data_in_full():
    renamed = ur5_urdf().replace('<joint name="', '<joint name="cell_4_').replace("cell_4_world", "world")
    arm = mfc.Robot.from_urdf(renamed, tool="tool0")
    loop = mfc.ClosedLoop(arm, mfc.laws.ComputedTorque(**pid()), T.Hold([0.3, -1.0, 1.4, -1.9, -1.5, 0.2]))
    made = rendered(loop_document(loop, requirements=mfc.Requirements(phase_deg=45)), formats=("html", "json"))
    told, data = Page(made["html"].decode()), json.loads(made["json"])
    rows = [e["text"] for e in told.all("tr")]
    asked, where = next(row for row in rows if row.startswith("phase margin")), data["sections"][0]["checks"][0]["where"]
    assert where.startswith("cell_4_") and where.removeprefix("cell_4_") in asked and "cell_4_" not in asked
    short = ", ".join(name.removeprefix("cell_4_") for name in arm.joint_names)
    assert f"ur5, 6 joints ({short}; in full with cell_4_ before each), tool" in " ".join(rows)
    assert data["sections"][0]["numbers"]["loop"]["robot"]["joints"] == list(arm.joint_names)
