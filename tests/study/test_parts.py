"""The parts of a loop from the tables of a study: what the library would have built, and errors that name their key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis import laws
from mfc_analysis.maths.se3 import exp3
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.parts import POINTS, Parts
from mfc_analysis.study.read import read
from mfc_analysis.study.schema import LoopTable
from mfc_analysis.study.tables import REFERENCES, PoseTable
from tests.study.samples import BASE, Q, refused, study

pytestmark = pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")


def parts(folder: Path = Path("."), prefix: str = "", **tables: object) -> Parts:
    """The parts of these tables; a UR5 under 9.10 where they say nothing else."""
    least = {"robot": {"name": "ur5"}, "law": {"equation": "9.10", "kp": 100.0, "kd": 20.0}, "reference": {"kind": "Hold"}, "q_start": Q}
    return Parts(LoopTable.model_validate({**least, **tables}), folder, "s.toml", prefix)


# --- robots ------------------------------------------------------------------------------------------------------------------


def test_robots_come_by_name_by_file_and_with_parameters(tmp_path):
    from mfc_analysis.robots.catalogue import ur5_urdf

    (tmp_path / "arms").mkdir()
    (tmp_path / "arms" / "arm.urdf").write_text(ur5_urdf())
    law = '[law]\nequation = "9.8"\nkp = 100\nkd = 10\n[reference]\nkind = "Hold"\n'
    for place in (tmp_path, tmp_path / "deep"):  # relative to the study, wherever the command runs
        place.mkdir(exist_ok=True)
        path = "arms/arm.urdf" if place == tmp_path else "../arms/arm.urdf"
        (place / "s.toml").write_text(f'q_start = {Q}\n[robot]\nurdf = "{path}"\ntool = "tool0"\ngravity = [0, 0, -3.7]\nfriction = "none"\n{law}')
        robot = read(place / "s.toml").loops[0].loop.robot
        assert_allclose(robot.gravity(Q), mfc.robots.ur5().gravity(Q) * 3.7 / 9.81, rtol=1e-12, atol=1e-12)
        assert [p.name for p in read(place / "s.toml").files()] == ["s.toml", "arm.urdf"]
    one = study(tmp_path, f'q_start = [0.3]\n[robot]\nname = "single_joint"\nparameters = {{ inertia = 0.7 }}\nfriction = {{ coulomb = 0.1 }}\n{law}')
    assert_allclose(one.loops[0].loop.robot.mass([0.3]), [[0.7]])
    assert_allclose([one.loops[0].loop.robot.viscous, one.loops[0].loop.robot.coulomb], [[0.1], [0.1]])
    changed = study(tmp_path, f'q_start = {Q}\n[robot]\nname = "ur5"\ntool = "wrist_1_link"\nfriction = {{ viscous = 0.5 }}\n{law}')
    assert changed.loops[0].loop.robot.tool == "wrist_1_link"


def test_the_controller_model_is_the_plant_with_its_keys_changed(tmp_path):
    one = study(tmp_path, BASE.replace("payload = false", "inertia_scale = 1.2")).loops[0]
    model = one.loop.equations.model
    assert sum(p.mass for p in model.payloads) == 2.0
    bare = mfc.robots.ur5().with_inertia_scaled(1.2).with_payload(2.0, (0, 0, 0.05), 0.005)
    assert_allclose(model.mass(Q), bare.mass(Q), rtol=1e-12)


def test_a_controllers_model_without_keys_is_the_plant(tmp_path):
    loop = study(tmp_path, BASE.replace("payload = false\n", "")).loops[0].loop
    assert loop.controller_model is loop.robot


def test_ranges_vary_the_plant_and_not_what_the_controller_believes(tmp_path):
    ranges = "[ranges]\npayload = [1.0, 3.0]\ndelay = { low = 0.0, high = 0.004, count = 3 }\n"
    text = BASE.replace("[controller_model]\npayload = false\n", "") + ranges
    one = study(tmp_path, text).loops[0]
    cases = list(one.cases())
    assert [dict(case.values) for case in cases][:2] == [{"payload": 1.0, "delay": 0.0}, {"payload": 1.0, "delay": 0.002}]
    assert len(cases) == 6
    for case in cases:
        assert sum(p.mass for p in case.loop.robot.payloads) == case.values["payload"]
        assert sum(p.mass for p in case.loop.equations.model.payloads) == 2.0


def test_ranges_change_the_quantity_they_name_and_keep_the_rest():
    made = parts(robot={"name": "ur5", "payload": [{"mass": 1.0, "com": [0, 0, 0.1]}, {"mass": 0.5}], "friction": {"viscous": 1.0, "coulomb": 0.2}},
                 environment={"stiffness": 1e3, "damping": 5.0}, hardware={"torque_lag": 2e-3, "delay": 1e-3})  # fmt: skip
    loop = made.varied({"payload": 3.0, "viscous": 0.4, "stiffness": 2e3, "delay": 4e-3})
    assert [p.mass for p in loop.robot.payloads] == [3.0, 0.5] and loop.robot.payloads[0].com.tolist() == [0, 0, 0.1]
    assert_allclose([loop.robot.viscous, loop.robot.coulomb], [[0.4] * 6, [0.2] * 6])
    (surface,) = loop.equations.surfaces
    plain = made.loop()
    assert_allclose(surface.stiffness, 2 * plain.equations.surfaces[0].stiffness)
    assert_allclose(surface.damping, plain.equations.surfaces[0].damping)
    assert (loop.hardware.delay, loop.hardware.torque_lag) == (4e-3, 2e-3)
    assert [p.mass for p in made.robot.payloads] == [1.0, 0.5] and plain.hardware.delay == 1e-3
    heavy = made.varied({"inertia_scale": 1.5})
    assert_allclose(heavy.robot.mass(Q) - plain.robot.mass(Q), 0.5 * mfc.robots.ur5().mass(Q), rtol=1e-9, atol=1e-12)


# --- poses and references ----------------------------------------------------------------------------------------------------


def test_a_pose_by_angles_by_a_quaternion_and_by_a_matrix_is_the_same():
    angles = np.array([0.3, -0.5, 1.1])
    R = exp3(np.array([0, 0, angles[2]])) @ exp3(np.array([0, angles[1], 0])) @ exp3(np.array([angles[0], 0, 0]))  # Rz Ry Rx
    w = 0.5 * np.sqrt(1 + np.trace(R))
    xyz = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, [0.4, 0.1, 0.3]
    said = [{"rpy": angles.tolist()}, {"rpy_deg": np.degrees(angles).tolist()}, {"quaternion_xyzw": [*xyz.tolist(), float(w)]}]
    tables = [PoseTable.model_validate({"position": [0.4, 0.1, 0.3], **one}) for one in said] + [PoseTable.model_validate({"matrix": X.tolist()})]
    for table in tables:
        assert_allclose(parts().pose("pose", table), X, atol=1e-12)


def test_a_pose_of_joint_angles_is_that_of_the_tool_then_shifted_in_base_axes_and_turned_in_its_own():
    robot, other = mfc.robots.ur5(), [0.1, -1.1, 1.2, -1.7, -1.4, 0.3]
    assert_allclose(parts().pose("pose", PoseTable()), robot.pose(Q))
    moved = parts().pose("pose", PoseTable.model_validate({"q": other, "shift": [0.1, 0, -0.2], "turn_deg": [0, 0, 90]}))
    assert_allclose(moved[:3, 3], robot.pose(other)[:3, 3] + [0.1, 0, -0.2])
    assert_allclose(moved[:3, :3], robot.pose(other)[:3, :3] @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize(("length", "taken"), [(1.0009, True), (1.0011, False)])
def test_a_quaternion_has_length_one_to_a_thousandth_and_is_normalised(length, taken):
    table = PoseTable.model_validate({"position": [0, 0, 0], "quaternion_xyzw": [0.0, 0.6 * length, 0.0, 0.8 * length]})
    if taken:
        R = parts().pose("pose", table)[:3, :3]
        assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        return
    with pytest.raises(ValueError, match="length 1"):
        parts().pose("pose", table)


def test_where_nothing_is_said_a_moving_reference_is_analysed_along_its_way_and_a_hold_once():
    assert parts().times().tolist() == [0.0]
    assert_allclose(parts(reference={"kind": "Quintic", "q1": [0.1] * 6, "duration": 3.0}).times(), np.linspace(0, 3, POINTS))
    sinusoid = {"kind": "Sinusoid", "amplitude": 0.1, "frequency_hz": 0.5}
    assert_allclose(parts(reference=sinusoid).times(), np.linspace(0, 2, POINTS))
    assert parts(reference=sinusoid, times=[0.5]).times().tolist() == [0.5]


def test_what_is_not_said_starts_at_q_start_and_without_one_it_is_asked_for():
    assert_allclose(parts().reference(0.0).q, Q)
    with pytest.raises(StudyError) as why:
        _ = parts(q_start=None).reference
    assert why.value.key == "reference.q" and "q_start" in why.value.problem


def test_degrees_hertz_and_si_say_the_same(tmp_path):
    a = study(tmp_path, BASE).loops[0]
    text = BASE.replace(f"q_start = {Q}", f"q_start_deg = {np.degrees(Q).tolist()}").replace(
        "q1 = [1.0, -1.4, 1.7, -2.0, -1.5, 0.5]", f"q1_deg = {np.degrees([1.0, -1.4, 1.7, -2.0, -1.5, 0.5]).tolist()}"
    )
    b = study(tmp_path, text).loops[0]
    assert_allclose(a.loop.ref(0.7).q, b.loop.ref(0.7).q, rtol=1e-14)
    gains = 'gains = { helper = "pid", bandwidth_hz = 4.0 }'
    c = study(tmp_path, BASE.replace("kp = 100\nki = 200\nkd = 20", gains)).loops[0]
    wanted = mfc.gains.pid(bandwidth=mfc.hertz(4.0))
    assert_allclose([c.loop.law.kp.array, c.loop.law.ki.array, c.loop.law.kd.array], [wanted.kp, wanted.ki, wanted.kd])


REFERENCE_TEXTS = {
    "Hold": "",
    "Quintic": f"q1 = {[*Q[:5], 1.0]}",
    "Sinusoid": "amplitude = 0.1\nfrequency_hz = 0.5",
    "Waypoints": f"times = [0, 1, 3]\npositions = [{Q}, {[*Q[:5], 0.4]}, {Q}]",
    "csv": 'file = "data/path.csv"',
    "ToolHold": "",
    "ToolLine": "X1 = { shift = [0.05, 0, 0], turn_deg = [0, 0, 10] }",
    "ToolSinusoid": "amplitude = [0.02, 0, 0]\nfrequency = 2.0\nangle_deg = 5",
    "ToolCircle": "radius = 0.05\nfrequency_hz = 0.25",
}


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("kind", REFERENCES)
def test_each_reference_runs_from_a_study_and_tool_paths_become_joint_paths(tmp_path, kind, inverse):
    tool = kind.startswith("Tool")
    if inverse and not tool:
        pytest.skip("a joint reference needs no inverse kinematics")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "path.csv").write_text("t,a,b,c,d,e,f\n" + "\n".join(f"{t}," + ",".join(map(str, Q)) for t in (0, 1, 2)))
    extra = "inverse_kinematics = true\n" if inverse else ""
    law = "9.16" if tool and not inverse else "9.10"
    text = f'q_start = {Q}\n[robot]\nname = "ur5"\n[law]\nequation = "{law}"\nkp = 100\nkd = 20\n[reference]\nkind = "{kind}"\n{extra}'
    if inverse:
        text = text.replace("[law]", "[times]\nstop = 1.0\ncount = 21\n[law]")
    loop = study(tmp_path, text + REFERENCE_TEXTS[kind]).loops[0].loop
    assert loop.ref.space == ("tool" if tool and not inverse else "joint")
    start = loop.ref(0.0)
    if loop.ref.space == "tool":
        assert_allclose(start.X, loop.robot.pose(Q), atol=1e-12)
    elif kind != "Sinusoid":
        assert_allclose(start.q, Q, atol=1e-9)


def test_degrees_are_refused_where_a_joint_slides(tmp_path):
    text = 'q_start_deg = [10, 20]\n[robot]\nname = "rp"\n[law]\nequation = "9.8"\nkp = 10\n[reference]\nkind = "Hold"\n'
    why = refused(tmp_path, text)
    assert why.key == "q_start_deg" and "'d' slides" in str(why)


def test_a_bad_line_of_a_path_names_file_and_line(tmp_path):
    (tmp_path / "p.csv").write_text("0,1,2,3,4,5,6\n1,1,2,x,4,5,6\n")
    start, end = BASE.index("kind ="), BASE.index("[hardware]")
    why = refused(tmp_path, BASE[:start] + 'kind = "csv"\nfile = "p.csv"\n' + BASE[end:])
    assert why.key.startswith("reference") and "line 2" in str(why)


def test_a_study_says_which_step_settles(tmp_path):
    text = f'q_start = {Q}\n[robot]\nname = "ur5"\n[law]\nequation = "9.10"\ngains = {{{{ helper = "pid", settling_time = 0.5{{gains}} }}}}\n'
    text += '[reference]\nkind = "Hold"\n[requirements]\nsettling_time = 0.501\n{asked}'
    loop = 'step = "loop"'
    one = study(tmp_path, text.format(gains=f", {loop}", asked=loop)).loops[0]
    assert one.requirements == mfc.Requirements(settling_time=0.501, step="loop")
    assert one.loop.law.kp.array == mfc.gains.pid(settling_time=0.5, step="loop").kp
    assert one.requirements.check(one.loop, [0.0], at="command").passed
    default = study(tmp_path, text.format(gains="", asked="")).loops[0]
    assert default.requirements.step == "reference" and default.requirements.check(default.loop, [0.0]).passed
    assert "requirements.step" in str(refused(tmp_path, text.format(gains="", asked='step = "q_d"')))
    assert "a settling_time or an overshoot with it" in str(refused(tmp_path, text.format(gains="", asked=loop).replace("settling_time = 0.501", "")))


# --- laws --------------------------------------------------------------------------------------------------------------------


LAWS = {
    "9.1": "",
    "9.2": "kp = 5",
    "9.3": "kp = 5\nki = [1, 1, 1, 1, 1, 1]\nform = 'printed'",
    "9.4": "kp = 5",
    "9.5": "kp = 5\nform = 'no_adjoint'\ndamping = 0.01",
    "9.8": "gains = { helper = 'joint_pid', natural_frequency_hz = 3 }",
    "9.9": "",
    "9.10": "kp = 100\nmass = [[4,0,0,0,0,0],[0,4,0,0,0,0],[0,0,2,0,0,0],[0,0,0,1,0,0],[0,0,0,0,1,0],[0,0,0,0,0,1]]",
    "9.11": "outer = { num = [100, 20], den = [0.01, 1] }",
    "9.12": "gains = { helper = 'pid', settling_time = 0.5, damping = 0.8 }",
    "9.13": "outer = { kp = 100, kd = 20 }",
    "9.16": "kp = 100\nkd = 20",
    "9.21": "F_d = [0, 0, 5, 0, 0, 0]",
    "9.22": "F_d = [0, 0, 5, 0, 0, 0]\nkfp = 0.5\nkfi = 1",
    "9.23": "F_d = [0, 0, 5, 0, 0, 0]\ngains = { helper = 'force_pi', bandwidth_hz = 2, stiffness = 1e4, mass = 3.0, lag = 0.002 }",
    "9.24": "F_d = [0, 0, 5, 0, 0, 0]\nkp = 100\nkd = 20\nconstraints = 'surface_sliding'\nprojection = 'selection'\nform = 'printed_eta'",
    "impedance": "stiffness = [8, 8, 8, 1, 1, 1]\ndamping = 80\ninertia = 4\nF_d = [0, 0, 5, 0, 0, 0]\nnull_damping = 2\ninverse_damping = 0.01",
    "joint impedance": "stiffness = 300\ndamping = 30",
    "admittance": "F_d = [0, 0, 5, 0, 0, 0]\ninertia = 5\ndamping = 300\nstiffness = [300, 300, 0, 30, 30, 30]\ninverse_damping = 0.01",
}


@pytest.mark.parametrize("number", LAWS)
def test_each_law_of_the_chapter_runs_from_a_study(tmp_path, number):
    law = laws.by_equation(number)
    kind = '"ToolHold"' if law.space == "tool" else '"Hold"'
    text = f'q_start = {Q}\n[robot]\nname = "ur5"\n[law]\nequation = "{number}"\n{LAWS[number]}\n[reference]\nkind = {kind}\n'
    if law.senses_force:
        text += '[environment]\nstiffness = 1e4\ndamping = 10\naxes = "z"\npreload = 5\n'
    if law.plant == "velocity":
        text += "[hardware]\nservo = { bandwidth_hz = 8, damping = 0.7, delay = 0.016 }\nvelocity_limit = 1.0\n"
    one = study(tmp_path, text).loops[0]
    assert type(one.loop.law) is law
    assert np.isfinite(one.loop.linearize(one.times).A).all()


def test_a_sampled_controller_as_it_is_coded():
    hardware = {"sample_time": 0.01, "integral_rule": "tustin", "derivative_rule": "backward", "velocity_filter": 0.02}
    outer = {"num": [10.0, -9.0], "den": [1.0, -0.5], "dt": 0.01}
    made = parts(law={"equation": "9.11", "outer": outer}, hardware=hardware)
    assert made.law.sample_time == 0.01
    assert (made.hardware().integral_rule, made.hardware().derivative_rule) == ("tustin", "backward")
    for bad in ({"kp": 1.0, "dt": 0.01}, {"num": [1.0], "dt": 0.01}):
        with pytest.raises(ValueError, match="dt"):
            parts(law={"equation": "9.11", "outer": bad})


def test_the_gains_of_an_impedance_and_an_admittance_are_those_of_their_helpers():
    soft = parts(law={"name": "Impedance", "gains": {"helper": "impedance", "stiffness": [900.0, 900.0, 900.0, 40.0, 40.0, 40.0], "ratio": 0.7}})
    q = soft.reference(0.0).q if soft.reference.space == "joint" else soft.q_start
    want = mfc.gains.impedance(soft.model, q, [900.0, 900.0, 900.0, 40.0, 40.0, 40.0], 0.7)
    assert_allclose(soft.law.damping.array, want["damping"], rtol=1e-12)
    helper = {"helper": "admittance", "bandwidth_hz": 1.0, "stiffness": 3000.0, "servo_hz": 8.0, "servo_damping": 0.7, "delay": 0.016}
    arm = parts(law={"name": "Admittance", "F_d": [0.0, 0, 5, 0, 0, 0], "gains": helper}, hardware={"servo": {"bandwidth_hz": 8.0, "delay": 0.016}})
    want = mfc.gains.admittance(bandwidth=mfc.hertz(1), stiffness=3000.0, servo=mfc.hertz(8), servo_damping=0.7, delay=0.016)
    assert_allclose([arm.law.inertia.array, arm.law.damping.array], [want["inertia"], want["damping"]], rtol=1e-12)
    servo = arm.hardware().servo
    assert (servo.bandwidth, servo.delay) == (pytest.approx(mfc.hertz(8)), 0.016)
    with pytest.raises(ValueError, match="bandwidth"):
        parts(hardware={"servo": {"damping": 0.7}})


def test_the_inverse_of_a_redundant_arm_is_a_key():
    law = {"equation": "9.16", "kp": 100.0, "kd": 20.0, "null_damping": 5.0}
    assert parts(law=law).law.inverse == "dynamic"
    assert parts(law={**law, "inverse": "euclidean"}).law.inverse == "euclidean"
    with pytest.raises(StudyError, match="'euclidean'") as why:
        _ = parts(law={**law, "inverse": "moore"}).law
    assert why.value.key == "law.inverse"


def test_the_directions_of_a_tool_law_are_a_key():
    law = {"equation": "9.16", "kp": 100.0, "kd": 20.0}
    assert parts(law=law).law.selection is None
    assert parts(law={**law, "axes": "xyz"}).law.selection.names == ("vx", "vy", "vz")
    assert parts(law={**law, "axes": [[0.6, 0.8, 0, 0, 0, 0]]}).law.selection.names == ("row1",)
    for axes in ("xyw", [[1, 1, 0, 0, 0, 0]]):
        with pytest.raises(StudyError, match="orthonormal rows") as why:
            _ = parts(law={**law, "axes": axes}).law
        assert why.value.key == "law.axes"


def test_the_anti_windup_of_a_law_is_a_key():
    law = {"equation": "9.10", "kp": 100.0, "ki": 50.0, "kd": 20.0, "anti_windup": 0.05}
    assert parts(law=law).law.anti_windup == 0.05 and parts(law={**law, "equation": "9.8"}).law.anti_windup == 0.05
    with pytest.raises(StudyError, match="a gain ki") as why:
        _ = parts(law={key: value for key, value in law.items() if key != "ki"}).law
    assert why.value.key == "law.anti_windup"


def test_joints_follow_the_directions_of_a_tool_path_that_a_study_names(tmp_path):
    text = f"""q_start = {Q}
    [robot]
    name = "ur5"
    [law]
    equation = "9.10"
    kp = 100
    kd = 20
    [reference]
    kind = "ToolHold"
    inverse_kinematics = true
    X = {{ shift = [0.02, 0.0, 0.0], turn = [0.0, 0.3, 0.0] }}
    axes = "xyz"
    [times]
    stop = 1.0
    """
    loop = study(tmp_path, text).loops[0].loop
    X, wanted = loop.robot.pose(loop.nominal([0.0]).q[0]), loop.robot.pose(Q)
    assert_allclose(X[:3, 3], wanted[:3, 3] + [0.02, 0, 0], atol=1e-12)
    assert np.abs(X[:3, :3] - wanted[:3, :3]).max() < 0.2  # the turn of 0.3 rad is not followed
    why = refused(tmp_path, text.replace("    inverse_kinematics = true\n", ""))
    assert why.key == "reference" and "inverse_kinematics" in str(why)


def test_a_law_by_name_is_the_one_by_number():
    one, other = parts(law={"name": "JointPID", "kp": 5.0}).law, parts(law={"equation": "9.8", "kp": 5.0}).law
    assert type(one) is type(other) is laws.JointPID and float(one.kp.array) == float(other.kp.array) == 5.0


def test_joint_gains_are_those_of_what_the_controller_believes():
    gains = {"helper": "joint_pid", "natural_frequency": 5.0}
    made = parts(robot={"name": "ur5", "payload": {"mass": 3.0}}, controller_model={"payload": False}, law={"equation": "9.8", "gains": gains})
    assert_allclose(made.law.kp.array, 75 * np.diag(mfc.robots.ur5().mass(Q)), rtol=1e-12)


def test_hardware_that_a_study_does_not_name_is_ideal():
    assert parts().hardware() is None and parts().loop().equations.hardware.ideal
    assert parts().hardware({"delay": 2e-3}).delay == 2e-3


# --- what is wrong -----------------------------------------------------------------------------------------------------------


WRONG = {
    "an unknown equation": ('"9.10"', '"9.100"', "law.equation", "did you mean '9.10'?"),
    "a key of another law": ("kd = 20", "kd = 20\nkfp = 1", "law.kfp", "allowed: kp, ki, kd, form, mass"),
    "an unknown form": ("kd = 20", "kd = 20\nform = 'pritned'", "law.form", "'printed'"),
    "too many gains": ("kp = 100", "kp = [1, 2]", "law.kp", "shape (2,)"),
    "a negative lag": ("2e-3", "-2e-3", "hardware.torque_lag", "positive"),
    "a short start": (f"q_start = {Q}", "q_start = [1.0]", "q_start", "shape (6,)"),
    "an unknown robot": ('name = "ur5"', 'name = "ur6"', "robot.name", "did you mean 'ur5'?"),
    "an unknown tool": ('name = "ur5"', 'name = "ur5"\ntool = "tool1"', "robot.tool", "did you mean 'tool0'?"),
    "a file that is not there": ('name = "ur5"', 'urdf = "no.urdf"', "robot.urdf", "no.urdf"),
    "a parameter that is not one": ('name = "ur5"', 'name = "ur5"\nparameters = { lenght = 1 }', "robot.parameters.lenght", "takes"),
    "an unknown point": ("[robot]", 'at = "torqe"\n[robot]', "at", "'torque'"),
    "times that fall": ("stop = 2\ncount = 5", "values = [1.0, 0.5]", "times", "increasing"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_with_a_part_is_named_by_file_and_key(tmp_path, what):
    old, new, key, said = WRONG[what]
    assert old in BASE
    why = refused(tmp_path, BASE.replace(old, new, 1))
    assert why.key == key
    assert said in str(why)


@pytest.mark.parametrize(("law", "key"), [
    ({"equation": "9.10", "kp": 1.0, "gains": {"helper": "pid", "bandwidth": 3.0}}, "law.kp"),  # given twice
    ({"equation": "9.10"}, "law.kp"),  # not given at all
    ({"equation": "9.10", "gains": {"helper": "pid", "bandwidth": 3.0, "stiffness": 1.0}}, "law.gains.stiffness"),
    ({"equation": "9.10", "gains": {"helper": "pid"}}, "law"),
    ({"name": "ComputedTorqe", "kp": 1.0}, "law.name"),
])  # fmt: skip
def test_gains_that_do_not_go_together_are_named_under_their_loop(law, key):
    for prefix in ("", "loop[2]"):
        with pytest.raises(StudyError) as why:
            _ = parts(prefix=prefix, law=law).law
        assert why.value.key == ".".join(part for part in (prefix, key) if part)


def test_a_robot_of_an_mjcf_file_is_found_beside_the_study(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        '<mujoco model="own"><worldbody><body name="b"><joint name="j" axis="0 1 0" damping="0.3"/><geom size=".1" mass="2" pos=".2 0 0"/></body>'
        "</worldbody></mujoco>"
    )
    text = 'q_start = [0.3]\n[robot]\nmjcf = "arm.xml"\n[law]\nequation = "9.8"\nkp = 40\nkd = 5\n[reference]\nkind = "Hold"\n'
    found = study(tmp_path, text)
    robot = found.loops[0].loop.robot
    assert robot.name == "own" and robot.total_mass == pytest.approx(2.0) and robot.viscous == pytest.approx([0.3])
    assert tmp_path / "arm.xml" in found.files()
    why = refused(tmp_path, text.replace("arm.xml", "none.xml"))
    assert why.key == "robot.mjcf" and "MJCF" in str(why)
