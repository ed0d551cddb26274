"""The command line: exit codes, what is said where, and that nothing is written outside of --out."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.version import Version

from mfc_analysis import __version__
from mfc_analysis.laws import LAWS
from mfc_analysis.study.shipped import folder
from tests.cli.commands import SMALL, run, small
from tests.study.samples import URDF

ROOT = Path(__file__).resolve().parents[2]

# --- check ---------------------------------------------------------------------------------------------------------------


def test_check_ends_with_0_when_met_and_shows_asked_found_where_when(tmp_path):
    done = run("check", small(tmp_path))
    assert done.exit_code == 0, done.output
    row = next(line for line in done.stdout.splitlines() if "phase margin" in line)
    assert "PASS" in row and "≥ 30 deg" in row and re.search(r"\d deg .*joint +0 s", row)


def test_check_ends_with_1_when_not_met_and_says_what_where_when(tmp_path):
    done = run("check", small(tmp_path, 89.0))
    assert done.exit_code == 1
    assert re.search(r"FAIL: JointPID on single_joint: phase margin: found [\d.]+ deg, required ≥ 89 deg \(joint, t = 0 s\)", done.stdout)


def test_check_ends_with_2_for_bad_input_and_names_the_nearest_key(tmp_path):
    done = run("check", small(tmp_path, more="overshot = 0.1\n"))
    assert done.exit_code == 2
    assert done.stdout == "" and "Traceback" not in done.stderr
    assert re.search(r"error: .*small\.toml: requirements\.overshot: no such key; did you mean 'overshoot'\?", done.stderr)


def test_check_as_json_has_the_same_lines(tmp_path):
    done = run("check", "--json", small(tmp_path, 89.0))
    found = json.loads(done.stdout)
    assert done.exit_code == 1 and found[0]["status"] == "FAIL"
    line = next(x for x in found[0]["lines"] if x["requirement"] == "phase_deg")
    assert line["asked"] == 89 and line["found"] < 89 and line["where"] == "joint" and line["when"] == 0


def test_limits_ends_as_check_does_and_lists_what_binds(tmp_path):
    done = run("limits", small(tmp_path))
    assert done.exit_code == 0, done.output
    row = next(line for line in done.stdout.splitlines() if "largest dead time" in line)
    assert re.search(r"largest dead time +[\d.]+ s +0 s +phase margin +joint +0 s", row) and "pose at t = 0 s: joint 0.3 rad" in done.stdout
    assert run("limits", small(tmp_path, 89.0)).exit_code == 1
    found = json.loads(run("limits", "--json", small(tmp_path)).stdout)[0]["limits"]["largest dead time"]
    assert found["binding"] == "phase_deg" and found["pose"] == {"joint": 0.3}


def test_check_over_ranges_names_the_worst_case(tmp_path):
    done = run("check", small(tmp_path, 10.0, "[ranges]\ntorque_lag = [0.0, 0.05]\n"))
    assert "2 cases" in done.stdout
    assert "torque_lag = 0.05" in next(line for line in done.stdout.splitlines() if "phase margin" in line)


def test_a_reservation_is_not_met_unless_it_is_allowed(tmp_path):
    path = small(tmp_path)
    path.write_text(path.read_text().replace("ki = 100.0\n", "").replace("kp = 50.0", "kp = 30.0"))  # sags under gravity: WATCH
    assert run("check", path).exit_code == 1
    assert "WATCH" in run("check", path).stdout
    assert run("check", "--allow-watch", path).exit_code == 0


def test_the_commented_study_is_met_and_with_a_doubled_payload_it_is_not(tmp_path):
    done = run("check", "ur5_payload")
    assert done.exit_code == 0, done.output
    text = (folder() / "ur5_payload.toml").read_text(encoding="utf-8")
    assert "\nmass = 2.0 " in text
    heavy = tmp_path / "heavy.toml"
    heavy.write_text(text.replace("\nmass = 2.0 ", "\nmass = 4.0 "), encoding="utf-8")
    done = run("check", heavy)
    assert done.exit_code == 1
    found = r"FAIL: ComputedTorque on ur5: tracking error: found [\d.]+ rad, required ≤ 0\.05 rad"
    assert re.search(found + r" \(\w+_joint, t = [\d.]+ s\)", done.stdout)


@pytest.mark.parametrize("name", ["delay_budget_125hz", "panda_steel_and_rubber", "sampled_computed_torque", "panda_impedance", "kinova_servo"])
def test_the_shipped_studies_are_met_and_fail_as_their_comments_say(tmp_path, name):
    text = (folder() / f"{name}.toml").read_text(encoding="utf-8")
    if 'load = "' in text:
        pytest.importorskip("importlib.metadata").version("example-robot-data")
    if name == "panda_impedance":
        worse = text.replace("ratio = 0.8", "ratio = 0.2")
    elif name == "kinova_servo":
        worse = text.replace("bandwidth_hz = 1.0", "bandwidth_hz = 2.0").replace("max_delay = true", "")
    elif "panda" in name:
        worse = text.replace("kfp = 0.2\nkfi = 5.0\n", "").replace("[loop.law]\n", "")
    else:
        worse = text.replace("bandwidth_hz = 8.0", "bandwidth_hz = 16.0").replace("bandwidth_hz = 3.0", "bandwidth_hz = 8.0")
        worse = worse.replace("[0.001, 0.002, 0.004, 0.008]", "[0.008]").replace("count = 9", "count = 3")
    assert run("check", name).exit_code == 0
    assert "exit code 1" in text or "unstable on steel" in text
    (tmp_path / "worse.toml").write_text(worse, encoding="utf-8")
    assert run("check", tmp_path / "worse.toml").exit_code == 1


@pytest.mark.parametrize("argument", ["nowhere.toml", "."])
def test_a_study_that_is_not_there_is_bad_input(tmp_path, monkeypatch, argument):
    monkeypatch.chdir(tmp_path)
    done = run("check", argument)
    assert done.exit_code == 2 and "cannot be read" in done.stderr


def test_every_error_of_a_study_names_its_file_and_key(tmp_path):
    deep = "a = " + "[" * 3000 + "]" * 3000
    cases = {
        "requirements.overshoot: got -1.0": small(tmp_path, more="overshoot = -1.0\n"),
        "design.max_stiffness: loop: got ": small(tmp_path, more="[design]\nmax_stiffness = true\n", name="b.toml"),
        "law.gains.stiffness: got None": small(tmp_path, name="c.toml"),
        "law.kp: got 1000": small(tmp_path, name="d.toml"),
        "has lists or tables nested too deeply": tmp_path / "e.toml",
        "is not TOML: ": tmp_path / "f.toml",
        "cannot be read .it is larger than 4 MB.": tmp_path / "g.toml",
        "has lists or tables nested": tmp_path / "h.toml",
    }
    for name, old, new in (("c", "kp = 50.0\nki = 100.0\nkd = 10.0", 'gains = {helper = "force_pi"}'), ("d", "kp = 50.0", "kp = 1" + "0" * 400)):
        path = tmp_path / f"{name}.toml"
        path.write_text(path.read_text().replace(old, new))
    (tmp_path / "e.toml").write_text(deep)
    (tmp_path / "f.toml").write_text("a = 1" + "0" * 5000)
    (tmp_path / "g.toml").write_text("#" * 5_000_000)
    (tmp_path / "h.toml").write_text("a" + ".a" * 4000 + " = 1")
    for said, path in cases.items():
        done = run("check", path)
        assert done.exit_code == 2 and done.exception.__class__ is SystemExit, said
        assert re.search(rf"^error: .*{path.name}: {said}", done.stderr), done.stderr


@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
@pytest.mark.parametrize("key", ["study", "urdf", "csv"])
def test_a_pipe_or_a_device_is_refused_at_once(tmp_path, key):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, "/dev/zero"):
        study = small(tmp_path)
        text = study.read_text()
        if key == "urdf":
            study.write_text(text.replace('name = "single_joint"', f'urdf = "{path}"'))
        elif key == "csv":
            study.write_text(text.replace('kind = "Hold"', f'kind = "csv"\nfile = "{path}"'))
        done = run("check", path if key == "study" else study)
        assert done.exit_code == 2 and "it is not a regular file" in done.stderr
    assert run("init", pipe, "--out", tmp_path / "first.toml").exit_code == 2 and not (tmp_path / "first.toml").exists()


# --- report --------------------------------------------------------------------------------------------------------------


def test_a_report_of_a_study_is_the_formats_asked_for_and_stays_in_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small(tmp_path)
    done = run("report", "small.toml", "--out", "pages", "--format", "json,html")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in (tmp_path / "pages").iterdir()) == ["small.html", "small.json"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pages", "small.toml"]


def test_hostile_words_in_a_study_are_text_and_write_nothing_outside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hostile = '<script>alert(1)</script> "q" $x$ #import "/etc/passwd" ../../up `'
    title, name = json.dumps(hostile), json.dumps("../../escape/<b>")
    text = SMALL.format(phase=30).replace('title = "small"', f"title = {title}\ntext = {title}\nname = {title}") + f"[report]\nname = {name}\n"
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "study.toml").write_text(text, encoding="utf-8")
    done = run("report", "in/study.toml", "--out", "in/pages")
    assert done.exit_code == 0, done.output
    assert [p for p in tmp_path.rglob("*") if p.is_file() and p.parent != tmp_path / "in" / "pages"] == [tmp_path / "in" / "study.toml"]
    page = next((tmp_path / "in" / "pages").glob("*.html")).read_text(encoding="utf-8")
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)" in page
    assert json.loads(next((tmp_path / "in" / "pages").glob("*.json")).read_text(encoding="utf-8"))["title"] == hostile


def test_report_refuses_formats_and_folders_that_are_none(tmp_path):
    path = small(tmp_path)
    assert run("report", path, "--out", tmp_path / "o", "--format", "docx").exit_code == 2
    assert not (tmp_path / "o").exists()
    assert run("report", path, "--out", path, "--format", "json").exit_code == 2


def test_a_report_shows_ranges_and_limits_and_only_the_sections_asked_for(tmp_path):
    more = "[ranges]\ntorque_lag = [0.0, 0.01]\n[design]\nmax_delay = true\n[report]\nsections = ['poles']\nformats = ['json']\n"
    done = run("report", small(tmp_path, 20.0, more), "--out", tmp_path / "o")
    assert done.exit_code == 0, done.output
    text = (tmp_path / "o" / "small.json").read_text(encoding="utf-8")
    titles = [section["title"] for section in json.loads(text)["sections"]]
    assert any("parameter ranges" in t for t in titles) and "Design limits" in titles
    assert '"Poles"' in text and "Validity of the linear model" not in text


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
def test_a_link_in_the_output_folder_is_replaced_and_nothing_is_written_outside(tmp_path):
    out = tmp_path / "o"
    out.mkdir()
    for suffix in ("html", "pdf", "json"):
        (tmp_path / f"victim.{suffix}").write_text("precious")
        (out / f"small.{suffix}").symlink_to(f"../victim.{suffix}")
    done = run("report", small(tmp_path), "--out", out)
    assert done.exit_code == 0, done.output
    assert all((tmp_path / f"victim.{suffix}").read_text() == "precious" for suffix in ("html", "pdf", "json"))
    assert sorted(p.name for p in out.iterdir() if not p.is_symlink()) == ["small.html", "small.json", "small.pdf"]


def test_a_report_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    path, out = small(tmp_path), tmp_path / "o"
    assert run("report", path, "--out", out, "--format", "json").exit_code == 0
    before = (out / "small.json").read_bytes()
    monkeypatch.setattr(os, "fsync", full)
    for arguments in (("report", path, "--out", out, "--format", "json"), ("init", "ur5", "--out", tmp_path / "ur5.toml")):
        done = run(*arguments)
        assert done.exit_code == 2 and re.search(r"error: .*(small\.json|ur5\.toml): No space left on device", done.stderr)
    assert (out / "small.json").read_bytes() == before and sorted(p.name for p in tmp_path.rglob("*")) == ["o", "small.json", "small.toml"]


# --- init, studies -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", ["turn", 'a"b $x# <i>'])
def test_init_writes_a_study_that_runs_as_it_is(tmp_path, monkeypatch, joint):
    from xml.sax.saxutils import quoteattr

    monkeypatch.chdir(tmp_path)
    (tmp_path / "my arm.urdf").write_text(URDF.replace('"{joint}"', quoteattr(joint)).replace("{name}", "arm"))
    done = run("init", "my arm.urdf", "--out", "studies/first.toml")
    assert done.exit_code == 0, done.output
    text = (tmp_path / "studies" / "first.toml").read_text(encoding="utf-8")
    assert 'urdf = "../my arm.urdf"' in text and text.count("#") > 20
    done = run("check", "studies/first.toml")
    assert done.exit_code == 0, done.output
    again = run("init", "my arm.urdf", "--out", "studies/first.toml")
    assert again.exit_code == 2 and "--force" in again.stderr
    assert run("init", "my arm.urdf", "--out", "studies/first.toml", "--force").exit_code == 0


def test_init_of_what_is_no_robot_is_bad_input(tmp_path):
    (tmp_path / "bad.urdf").write_text("<robot")
    for robot in (tmp_path / "bad.urdf", tmp_path / "none.urdf", "no_such_robot"):
        done = run("init", robot, "--out", tmp_path / "s.toml")
        assert done.exit_code == 2 and done.stderr.startswith("error: ") and not (tmp_path / "s.toml").exists()


def test_studies_lists_and_copies_what_ships(tmp_path):
    assert "UR5 with a payload" in run("studies").stdout
    assert run("studies", "--copy", tmp_path / "mine").exit_code == 0
    assert (tmp_path / "mine" / "ur5_payload.toml").is_file()
    listed = run("studies", "--keys").stdout
    for table, key in (("requirements", "disk_margin"), ("law", "kdamp"), ('reference, kind = "ToolCircle"', "radius"), ("(a pose)", "rpy_deg")):
        assert re.search(rf"^{re.escape(table)} .*\b{key}\b", listed, re.MULTILINE)


def test_the_chapter_is_written_into_the_folder_in_the_formats_asked_for(tmp_path, monkeypatch):
    from mfc_analysis.report.chapter import chapter

    seen = []

    def write_chapter(folder, formats, progress, full):
        seen.append((folder, formats, full))
        return {"json": folder / "chapter.json"}

    monkeypatch.setattr(chapter, "write_chapter", write_chapter)
    done = run("report", "--out", tmp_path / "o", "--format", "json")
    assert done.exit_code == 0 and done.stdout.strip() == str(tmp_path / "o" / "chapter.json")
    assert run("report", "--full", "--out", tmp_path / "o").exit_code == 0
    assert seen == [(tmp_path / "o", ("json",), False), (tmp_path / "o", ("html", "pdf", "json"), True)]
    refused = run("report", "some.toml", "--full")
    assert refused.exit_code == 2 and "without a study" in refused.output and len(seen) == 2


# --- gains, exercises, lists ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["gains", "exercise"])
def test_help_says_the_units(command):
    said = " ".join(run(command, "--help").stdout.split())
    for unit in {"gains": ("in rad/s.", "in s.", "in N/m", "in kg."), "exercise": ("in degrees.", "in kg m^2.", "in m.", "in s.")}[command]:
        assert unit in said
    assert " ." not in said  # an empty place where a unit in brackets was taken for markup


def test_laws_and_robots_list_what_there_is():
    laws, robots = run("laws").stdout, run("robots").stdout
    for number, law in LAWS.items():
        assert re.search(rf"{re.escape(number)} +{law.__name__}", laws)
    for name in ("single_joint", "ur5", "panda", "xarm7"):
        assert re.search(rf"^ ?{name} ", robots, re.MULTILINE)
    assert ":math:" not in robots and "``" not in robots


# --- habits --------------------------------------------------------------------------------------------------------------


def test_help_loads_nothing_heavy_and_cuts_no_line():
    heavy = ["numpy", "scipy", "pinocchio", "control", "matplotlib", "pydantic"]
    if Version(version("typer")) >= Version("0.19"):  # before, typer itself loads rich
        heavy.append("rich")
    code = f"import atexit, sys, mfc_analysis.cli as cli; atexit.register(lambda: print([m for m in {heavy} if m in sys.modules])); cli.main()"
    done = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "80"})
    assert done.stdout.endswith("\n[]\n")
    commands = done.stdout.partition("Commands:")[2]
    assert "check" in commands and "exercise" in commands and "..." not in commands


def test_the_version_is_said():
    assert run("--version").stdout.strip() == f"mfc-analysis {__version__}"


def shell(command: str, folder) -> tuple[int, str]:
    """Exit code and standard error of a command line in a shell, where $M is the command of this package."""
    environment = os.environ | {"M": f"{sys.executable} -m mfc_analysis", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, timeout=100)
    return done.returncode, done.stderr


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")
def test_an_output_that_is_closed_full_or_left_gives_no_traceback_and_keeps_the_verdict(tmp_path):
    small(tmp_path)
    small(tmp_path, 89.0, name="bad.toml")
    for command, code in {
        "$M check small.toml >&-": 0,
        "$M check bad.toml >&-": 1,
        "$M check small.toml <&- >&- 2>&-": 0,
        "$M check bad.toml | head -0; exit ${PIPESTATUS[0]}": 1,
        "$M --help | head -0; exit ${PIPESTATUS[0]}": 0,
        "$M nonsense 2>&-": 2,
    }.items():
        found, said = shell(command, tmp_path)
        assert (found, said) == (code, ""), command
    if os.path.exists("/dev/full"):
        assert shell("$M check small.toml >/dev/full", tmp_path)[0] == 2
        assert shell("$M check none.toml 2>/dev/full", tmp_path)[0] == 2


def test_an_error_of_our_own_is_a_sentence_and_never_exit_code_1():
    code = "import mfc_analysis.cli.app as cli\ndef app(): raise ZeroDivisionError('x')\ncli.app = app\ncli.main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and re.fullmatch(
        r"error: internal error \(app\.py, line \d+\): ZeroDivisionError: x; please report .*\n", done.stderr
    )


@pytest.mark.skipif(os.name == "nt", reason="SIGTERM ends a Windows process at once")
def test_a_command_that_is_asked_to_end_takes_its_processes_with_it():
    code = """import os, signal, time; import mfc_analysis.cli.app as cli
from mfc_analysis.plots.batch import in_two_processes; from tests.plots.test_batch import where
def work(**_):
    for k, number in enumerate(in_two_processes([where] * 30)):
        print(number, flush=True)
        if k == 20:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
cli.app = work
cli.main()"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50)
    assert done.returncode == 128 + signal.SIGTERM and done.stderr == ""
    numbers = {int(line) for line in done.stdout.split()}
    assert numbers
    for number in numbers:
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)


def test_the_shell_completes_commands():
    words = {"_MFC_ANALYSIS_COMPLETE": "complete_bash", "COMP_WORDS": "mfc-analysis che", "COMP_CWORD": "1"}
    code = "import sys; sys.argv = ['mfc-analysis']; from mfc_analysis.cli import main; main()"  # as the script does
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, **words}, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["check"]


def test_a_robot_given_for_a_study_is_told_how_to_become_one(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("<robot name='arm'/>")
    done = run("check", path)
    assert done.exit_code == 2 and f"mfc-analysis init {path}" in done.stderr


def test_init_says_which_joints_it_locks(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inertial = '<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("base", "one", "two"))
    joint = '<joint name="j{i}" type="revolute"><parent link="{p}"/><child link="{c}"/>'
    joint += '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>{m}</joint>'
    joints = joint.format(i=1, p="base", c="one", m="") + joint.format(i=2, p="one", c="two", m='<mimic joint="j1"/>')
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
    assert run("init", "arm.urdf").stdout == "arm.toml\nlocked at 0: j2\nnext: mfc-analysis check arm.toml\n"
