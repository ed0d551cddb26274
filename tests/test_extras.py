"""The extras: what works without them, and what says which one it needs. Other libraries are blocked as if they were not installed."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import mfc_analysis as mfc
from mfc_analysis import errors
from tests.cli.commands import small

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

#: refuses to find some modules; then, in the same process, the code of a test
BLOCKED = """
import sys
class Blocked:
    def find_spec(name, path=None, target=None):
        if name in NAMES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
NAMES = set(sys.argv.pop(1).split(","))
sys.meta_path.insert(0, Blocked)
"""

CORE = """
import numpy as np
import mfc_analysis as mfc
from mfc_analysis import testing
robot = mfc.robots.ur5()
q0 = [0.0, -1.2, 1.5, -0.8, 1.57, 0.0]
gains = mfc.gains.pid(natural_frequency=mfc.hertz(2), damping=1.0)
loop = mfc.ClosedLoop(robot.with_payload(2.0), mfc.laws.ComputedTorque(**gains), mfc.trajectories.Hold(q0), controller_model=robot)
lin = loop.linearize([0.0])
assert lin.margins(at="torque").stable.all() and lin.poles().shape == (1, 18)
assert loop.simulate(np.linspace(0.0, 0.1, 5)).q.shape == (5, 6)
assert abs(loop.validate(time=0.1).taylor_order - 2.0) < 0.2
assert lin.margins().plot().lines
assert mfc.Requirements(phase_deg=30).check(loop, [0.0]).passed
testing.assert_margins(loop, [0.0], phase_deg=30)
assert float(mfc.design.max_payload(loop)) > 2.0
slider = mfc.robots.slider()
wall = mfc.Environment(1e4, axes="z", preload=5.0, one_sided=True)
law = mfc.laws.DampedForcePI([0, 0, 5.0, 0, 0, 0], 0.5, 3.0, 20.0)
touch = mfc.ClosedLoop(slider, law, mfc.trajectories.Hold([0.0]), environment=wall)
assert mfc.design.impact(touch, [0.1], duration=0.05).peak.shape == (1, 1)
from mfc_analysis import *

def missing(asked):
    try:
        asked()
    except mfc.errors.MissingExtra as why:
        return why.extra

asked = (lambda: mfc.study.read("study.toml"), lambda: mfc.report.write(loop, "out"), lambda: mfc.sweep(lambda k: k, {"k": [1.0]}, float))
assert [missing(one) for one in asked] == ["study", "report", "sweep"]
"""

COMMANDS = """
import json
from typer.testing import CliRunner
from mfc_analysis.cli.app import app
out = []
for arguments in json.loads(sys.argv.pop(1)):
    done = CliRunner().invoke(app, arguments)
    out.append((done.exit_code, done.stdout, done.stderr))
print(json.dumps(out))
"""


def canonical(name: str) -> str:
    return str(canonicalize_name(name))


@cache
def needed(name: str) -> frozenset[str]:
    """A distribution and all that it needs where no extra is asked for."""
    todo, out = [name], set()
    while todo:
        one = canonical(todo.pop())
        if one in out:
            continue
        out.add(one)
        try:
            listed = [Requirement(text) for text in requires(one) or []]
        except PackageNotFoundError:  # of another platform
            continue
        todo += [r.name for r in listed if r.marker is None or r.marker.evaluate({"extra": ""})]
    return frozenset(out)


def others() -> set[str]:
    """Modules installed here that an installation without extras does not have."""
    core = {one for text in PROJECT["dependencies"] for one in needed(Requirement(text).name)} | {"mfc-analysis"}
    return {module for module, owners in packages_distributions().items() if not core & set(map(canonical, owners))}


def without(modules: set[str], code: str, *arguments: str, folder: Path) -> str:
    """What this code prints in a process that has none of these modules."""
    command = [sys.executable, "-c", BLOCKED + code, ",".join(sorted(modules)), *arguments]
    paths = [str(ROOT), *(path for path in sys.path if path.endswith("site-packages"))]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, env={"PYTHONPATH": ":".join(paths), "OPENBLAS_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def commands(modules: set[str], asked: list[list[str]], folder: Path) -> list[Any]:
    """Exit code, standard output and standard error of each command line without these modules."""
    found: list[Any] = json.loads(without(modules, COMMANDS, json.dumps(asked), folder=folder))
    return found


def test_the_optional_libraries_are_blocked_and_those_of_the_core_are_not() -> None:
    blocked = others()
    assert {"ruamel", "jinja2", "typst", "xarray", "mpmath", "pytest"} <= blocked
    assert not blocked & {"numpy", "scipy", "control", "pinocchio", "matplotlib", "typer", "rich", "joblib", "lazy_loader", "mfc_analysis"}


def test_the_core_works_without_any_extra(tmp_path: Path) -> None:
    optional = {library for _, libraries in errors.EXTRAS.values() for library in libraries}  # newer typer has pydantic, the library does not use it
    assert without(others() | optional, CORE + "\nprint('all of it')", folder=tmp_path).endswith("all of it\n")


def test_the_command_line_works_without_any_extra_or_names_the_one_it_needs(tmp_path: Path) -> None:
    study = str(small(tmp_path))
    exercise = ["exercise", "9.4", "--theta-deg", "30", "--d", "0.5", "--fx", "1", "--fy", "2"]
    core = [["--help"], ["laws"], ["robots"], ["gains", "pid", "--bandwidth-hz", "4"], exercise, ["studies"], ["init", "slider"]]
    studies = [["check", study], ["limits", study], ["compare", study, study], ["export", study], ["schema"]]
    reports = [["report", study], ["report"]]
    found = commands(others(), [*core, *studies, *reports], tmp_path)
    for one, (code, said, complained) in zip(core, found[: len(core)], strict=True):
        assert code == 0 and said and not complained, one
    need = 'error: {} need {}: pip install "mfc-analysis[{}]"\n'
    for one, answer in zip(studies, found[len(core) :], strict=False):
        assert answer == [2, "", need.format("studies", "pydantic and ruamel.yaml", "study")], one
    for answer in found[len(core) + len(studies) :]:
        assert answer == [2, "", need.format("reports", "jinja2 and typst", "report")]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["slider.toml", Path(study).name], "no command that fails writes a file"


@pytest.mark.parametrize(("extra", "lost"), [(extra, name) for extra, (_, names) in errors.EXTRAS.items() for name in names])
def test_a_missing_library_of_an_extra_is_an_import_error_with_its_name(extra: str, lost: str, monkeypatch: pytest.MonkeyPatch) -> None:
    errors.require(extra)
    monkeypatch.setitem(errors.EXTRAS, extra, (errors.EXTRAS[extra][0], (*errors.EXTRAS[extra][1], "no_such_library.part")))
    with pytest.raises(ImportError, match=rf"{lost}.*no_such_library.part: pip install \"mfc-analysis\[{extra}\]\"$") as why:
        errors.require(extra)
    assert isinstance(why.value, mfc.errors.MissingExtra) and why.value.missing == ("no_such_library.part",) and why.value.extra == extra


# --- the metadata --------------------------------------------------------------------------------------------------------


def listed(extra: str) -> set[str]:
    return {Requirement(text).name for text in PROJECT["optional-dependencies"][extra]}


def own(*extras: str) -> str:
    return f"mfc-analysis[{','.join(extras)}]"


def test_the_extras_of_the_metadata_are_those_that_the_errors_name() -> None:
    for extra, (_, libraries) in errors.EXTRAS.items():
        assert listed(extra) - {"mfc-analysis"} == set(libraries)
    assert PROJECT["optional-dependencies"]["all"] == [own(*errors.EXTRAS)]
    assert own("all", "robots") in PROJECT["optional-dependencies"]["test"] and own("test") in PROJECT["optional-dependencies"]["docs"]


def test_a_report_of_a_study_can_be_written_with_the_extra_of_reports() -> None:
    assert own("study") in PROJECT["optional-dependencies"]["report"]
