"""Study files: what they say becomes the loop that the library would have built, and what is wrong is named by file and key."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis import laws, trajectories
from mfc_analysis.errors import MfcError, UnknownName
from mfc_analysis.requirements.requirements import KINDS
from mfc_analysis.study.read import StudyError, overridden, read
from mfc_analysis.study.schema import HardwareTable, LawTable, RequirementsTable
from mfc_analysis.study.shipped import copied, folder, found, shipped
from mfc_analysis.study.tables import REFERENCES

pytestmark = pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")

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


def study(tmp_path: Path, text: str, name: str = "s.toml"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return read(tmp_path / name)


def refused(tmp_path: Path, text: str) -> StudyError:
    with pytest.raises(StudyError) as why:
        study(tmp_path, text)
    assert isinstance(why.value, ValueError) and isinstance(why.value, MfcError)
    assert why.value.file.endswith("s.toml") and why.value.file in str(why.value)
    return why.value


def test_a_study_is_the_loop_that_the_library_builds(tmp_path):
    one = study(tmp_path, BASE).loops[0]
    robot = mfc.robots.ur5()
    loop = mfc.ClosedLoop(
        robot.with_payload(2.0, (0, 0, 0.05), 0.005),
        laws.ComputedTorque(100, 200, 20),
        trajectories.Quintic(Q, [1.0, -1.4, 1.7, -2.0, -1.5, 0.5], 2.0),
        controller_model=robot,
        hardware=mfc.Hardware(torque_lag=2e-3),
    )
    times = np.linspace(0, 2, 5)
    assert_allclose(one.times, times)
    assert_allclose(one.loop.linearize(one.times).A, loop.linearize(times).A, rtol=1e-12, atol=1e-12)
    assert one.requirements.asked() == {"phase_deg": 30.0}


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


def test_every_law_requirement_hardware_field_and_reference_can_be_said():
    from dataclasses import fields

    said = set(LawTable.model_fields)
    for law in laws.LAWS.values():
        assert {f.name for f in fields(law) if f.init} <= said
    assert set(RequirementsTable.model_fields) == set(KINDS)
    assert set(HardwareTable.model_fields) == {f.name for f in fields(mfc.Hardware)}
    shown = {name for name in dir(trajectories) if isinstance(getattr(trajectories, name), type)}
    abstract_or_result = {"JointReference", "ToolReference", "JointPoint", "ToolPoint", "JointPath"}
    assert shown - abstract_or_result == set(REFERENCES) - {"csv"}


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
}


@pytest.mark.parametrize("number", LAWS)
def test_each_law_of_the_chapter_runs_from_a_study(tmp_path, number):
    law = laws.by_equation(number)
    kind = '"ToolHold"' if law.space == "tool" else '"Hold"'
    text = f'q_start = {Q}\n[robot]\nname = "ur5"\n[law]\nequation = "{number}"\n{LAWS[number]}\n[reference]\nkind = {kind}\n'
    if law.senses_force:
        text += '[environment]\nstiffness = 1e4\ndamping = 10\naxes = "z"\npreload = 5\n'
    one = study(tmp_path, text).loops[0]
    assert type(one.loop.law) is law
    assert np.isfinite(one.loop.linearize(one.times).A).all()


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


def test_loops_change_some_keys_and_a_table_that_names_itself_anew_is_replaced(tmp_path):
    text = BASE + '[[loop]]\nname = "soft"\nlaw.kp = 50\n[[loop]]\nlaw = { equation = "9.8", kp = 300 }\nhardware.delay = 1e-3\n'
    soft, other = study(tmp_path, text).loops
    assert (soft.name, float(soft.loop.law.kp.array), float(soft.loop.law.kd.array)) == ("soft", 50.0, 20.0)
    assert (other.name, other.loop.law.equation, other.loop.law.kd.array) == ("JointPID on ur5", "9.8", None)
    assert other.loop.hardware.delay == 1e-3 and other.loop.hardware.torque_lag == 2e-3
    assert overridden({"a": {"b": 1, "c": 2}}, {"a": {"b": 3}}) == {"a": {"b": 3, "c": 2}}


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


def test_the_controller_model_is_the_plant_with_its_keys_changed(tmp_path):
    one = study(tmp_path, BASE.replace("payload = false", "inertia_scale = 1.2")).loops[0]
    model = one.loop.equations.model
    assert sum(p.mass for p in model.payloads) == 2.0
    bare = mfc.robots.ur5().with_inertia_scaled(1.2).with_payload(2.0, (0, 0, 0.05), 0.005)
    assert_allclose(model.mass(Q), bare.mass(Q), rtol=1e-12)


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


WRONG = {
    "a misspelt key names the nearest": ("mass = 2.0", "masss = 2.0", "robot.payload.masss", "did you mean 'mass'?"),
    "a misspelt key at the top": ('title = "a study"', 'titel = "a study"', "titel", "did you mean 'title'?"),
    "a misspelt table": ("[hardware]", "[hardwear]", "hardwear", "did you mean 'hardware'?"),
    "a misspelt requirement": ("phase_deg", "phase_dg", "requirements.phase_dg", "did you mean 'phase_deg'?"),
    "a missing table": ("[law]", "[times2]", "times2", "no such key"),
    "a missing key": ("[reference]\nkind", "[reference]\n#", "reference.kind", "is missing"),
    "another kind of reference": ('"Quintic"', '"Quintc"', "reference.kind", "did you mean 'Quintic'?"),
    "an unknown equation": ('"9.10"', '"9.100"', "law.equation", "did you mean '9.10'?"),
    "a key of another law": ("kd = 20", "kd = 20\nkfp = 1", "law.kfp", "allowed: kp, ki, kd, form, mass"),
    "an unknown form": ("kd = 20", "kd = 20\nform = 'pritned'", "law.form", "'printed'"),
    "no number": ("kp = 100", "kp = 'large'", "law.kp", "a finite number"),
    "true is no number": ("kp = 100", "kp = true", "law.kp", "a finite number"),
    "not finite": ("kp = 100", "kp = nan", "law.kp", "a finite number"),
    "a word for a table": ("[times]", "[[loop]]\nhardware = 'fast'\n[times]", "loop[0].hardware", "takes a table"),
    "a list for a kind": ('"Quintic"', "[1]", "reference.kind", "takes one of 'Hold'"),
    "a number for a name": ('name = "ur5"', "name = 5", "robot.name", "takes a text"),
    "too many gains": ("kp = 100", "kp = [1, 2]", "law.kp", "shape (2,)"),
    "a negative lag": ("2e-3", "-2e-3", "hardware.torque_lag", "positive"),
    "two units": ("[robot]", f"q_start_deg = {Q}\n[robot]", "", "not both"),
    "a short start": (f"q_start = {Q}", "q_start = [1.0]", "q_start", "shape (6,)"),
    "two sources": ('name = "ur5"', 'name = "ur5"\nload = "panda"', "robot", "exactly one of name, load and urdf"),
    "an unknown robot": ('name = "ur5"', 'name = "ur6"', "robot.name", "did you mean 'ur5'?"),
    "an unknown tool": ('name = "ur5"', 'name = "ur5"\ntool = "tool1"', "robot.tool", "did you mean 'tool0'?"),
    "a file that is not there": ('name = "ur5"', 'urdf = "no.urdf"', "robot.urdf", "no.urdf"),
    "a parameter that is not one": ('name = "ur5"', 'name = "ur5"\nparameters = { lenght = 1 }', "robot.parameters.lenght", "takes"),
    "an unknown point": ("[robot]", 'at = "torqe"\n[robot]', "at", "'torque'"),
    "times that fall": ("stop = 2\ncount = 5", "values = [1.0, 0.5]", "times", "increasing"),
    "one time": ("count = 5", "count = 1", "times.count", "greater than or equal to 2"),
    "a range of words": ("[times]", "[ranges]\npayload = ['a']\n[times]", "ranges.payload", "a list of finite numbers"),
    "too many cases": ("[times]", "[ranges]\npayload = { low = 0, high = 1, count = 999 }\ndelay = [0, 1e-3]\n[times]", "ranges", "1998"),
    "a section that is not one": ("[times]", "[report]\nsections = ['poels']\n[times]", "report.sections[0]", "'poles'"),
    "an override that is wrong": ("[times]", "[[loop]]\nlaw.kpp = 3\n[times]", "loop[0].law.kpp", "did you mean 'kp'?"),
    "an override of the wrong kind": ("[times]", "[[loop]]\nlaw.kp = [1, 2]\n[times]", "loop[0].law.kp", "shape (2,)"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_by_file_and_key_with_what_is_allowed(tmp_path, what):
    old, new, key, said = WRONG[what]
    assert old in BASE
    why = refused(tmp_path, BASE.replace(old, new, 1))
    assert why.key == key
    assert said in str(why)


def test_a_file_that_is_not_there_or_not_toml_is_named(tmp_path):
    with pytest.raises(StudyError, match=r"none\.toml: cannot be read"):
        read(tmp_path / "none.toml")
    assert "is not TOML" in str(refused(tmp_path, "title = "))
    (tmp_path / "s.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(StudyError, match="UTF-8"):
        read(tmp_path / "s.toml")


def test_degrees_are_refused_where_a_joint_slides(tmp_path):
    text = 'q_start_deg = [10, 20]\n[robot]\nname = "rp"\n[law]\nequation = "9.8"\nkp = 10\n[reference]\nkind = "Hold"\n'
    why = refused(tmp_path, text)
    assert why.key == "q_start_deg" and "'d' slides" in str(why)


def test_a_bad_line_of_a_path_names_file_and_line(tmp_path):
    (tmp_path / "p.csv").write_text("0,1,2,3,4,5,6\n1,1,2,x,4,5,6\n")
    start, end = BASE.index("kind ="), BASE.index("[hardware]")
    why = refused(tmp_path, BASE[:start] + 'kind = "csv"\nfile = "p.csv"\n' + BASE[end:])
    assert why.key.startswith("reference") and "line 2" in str(why)


@pytest.mark.parametrize("name", sorted(p.stem for p in folder().glob("*.toml")))
def test_every_shipped_study_reads_and_says_what_it_asks(name):
    text = shipped()[name][0].read_text(encoding="utf-8")
    if 'load = "' in text:
        pytest.importorskip("importlib.metadata").version("example-robot-data")
    one = read(found(name))
    assert one.title and one.text and all(loop.asks for loop in one.loops)
    assert text.startswith("# ") and tomllib.loads(text)


def test_a_controllers_model_without_keys_is_the_plant(tmp_path):
    loop = study(tmp_path, BASE.replace("payload = false\n", "")).loops[0].loop
    assert loop.controller_model is loop.robot


def test_a_word_that_is_no_study_names_the_files_here_and_the_shipped_ones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").touch()
    with pytest.raises(UnknownName, match="did you mean 'ur5_payload'") as info:
        found("ur5-payload")
    assert info.value.known == ("mine.toml", *shipped())
    assert found("absent.toml") == Path("absent.toml") and found("folder/absent") == Path("folder/absent")


def test_shipped_studies_can_be_copied_and_nothing_is_overwritten(tmp_path):
    files = copied(tmp_path / "mine")
    assert {f.stem for f in files} == set(shipped()) >= {"ur5_payload", "panda_steel_and_rubber", "delay_budget_125hz", "sampled_computed_torque"}
    with pytest.raises(ValueError, match="--copy"):
        copied(tmp_path / "mine")
