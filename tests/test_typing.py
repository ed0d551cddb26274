"""mypy --strict and pyright have nothing to say of the package, of the code of README and docs/adding.md, and of gains unpacked into laws."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
UNPACKED = """
import mfc_analysis as mfc

arm = mfc.robots.ur5()
laws: list[mfc.laws.Law] = [
    mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(4))),
    mfc.laws.JointPID(**mfc.gains.joint_pid(arm, [0.0] * 6, bandwidth=20.0)),
    mfc.laws.VelocityPI(kp=4, ki=[1.0] * 6),
    mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], kfp=0.5, kdamp=200.0),
]
first: mfc.laws.Gain = mfc.laws.JointPID(kp=100, kd=20).kp
"""
WRONG = """
import mfc_analysis as mfc

mfc.laws.JointPID(kd=20)
mfc.laws.ComputedTorque(kp=100, form="prnted")
mfc.laws.TaskComputedTorque(kp=object())
"""


def blocks(page: str) -> str:
    """The Python blocks of a page, one after the other."""
    return "\n".join(re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL))


CODE = {"readme": blocks("README.md"), "adding": blocks("docs/adding.md"), "unpacked": UNPACKED}


def checked(tool: str, folder: Path, *files: str) -> subprocess.CompletedProcess[str]:
    """The checker on files, mypy with the settings and the cache of the project, pyright with those of the folder."""
    options = {"mypy": ["-m", "mypy", "--strict", "--no-error-summary"], "pyright": ["-m", "pyright", "--pythonpath", sys.executable]}[tool]
    environment = os.environ | {"PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    where = folder if tool == "pyright" else ROOT
    return subprocess.run([sys.executable, *options, *files], cwd=where, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="session", autouse=True)
def pyright() -> None:
    """pyright is there, or npm can bring it."""
    there = subprocess.run([sys.executable, "-m", "pyright", "--version"], capture_output=True).returncode == 0
    if not there and not os.environ.get("MFC_PYRIGHT_REQUIRED"):
        pytest.skip("pyright cannot be run here: no npm, or no network")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's folder, whose checkers know where the package is."""
    (tmp_path / "pyproject.toml").write_text(
        f'[tool.pyright]\nextraPaths = ["{ROOT.as_posix()}"]\nreportMissingImports = false\nreportUnusedExpression = false\n',
        encoding="utf-8",
    )
    return tmp_path


@pytest.mark.parametrize("tool", ["mypy", "pyright"])
def test_the_checkers_are_silent_on_the_package(tool: str) -> None:
    done = checked(tool, ROOT, *(["mfc_analysis"] if tool == "mypy" else []))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("tool", ["mypy", "pyright"])
def test_the_checkers_are_silent_on_a_users_code(tool: str, folder: Path) -> None:
    for name, code in CODE.items():
        (folder / f"{name}.py").write_text(code, encoding="utf-8")
    done = checked(tool, folder, *(str(folder / f"{name}.py") for name in CODE if tool == "mypy"))
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("tool", ["mypy", "pyright"])
def test_the_checkers_see_a_missing_gain_a_form_misspelt_and_what_is_no_gain(tool: str, folder: Path) -> None:
    (folder / "wrong.py").write_text(WRONG, encoding="utf-8")
    done = checked(tool, folder, *([str(folder / "wrong.py")] if tool == "mypy" else []))  # files named to pyright would make it forget its settings
    assert done.returncode != 0
    for line in (4, 5, 6):
        assert re.search(rf"wrong\.py:{line}\b.*error", done.stdout), done.stdout
