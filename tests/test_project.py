"""The project's own files agree with each other: one version, one script of checks, one ruff."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import mfc_analysis

ROOT = Path(__file__).resolve().parent.parent
WRITTEN = (".cff", ".cfg", ".ini", ".json", ".md", ".toml", ".txt", ".yaml", ".yml")
FOLDERS = (".ci", ".github", "benchmarks", "docs", "examples", "mfc_analysis", "reports")
FILES = sorted(
    path.relative_to(ROOT).as_posix() for path in [*ROOT.iterdir(), *(p for name in FOLDERS for p in (ROOT / name).rglob("*"))] if path.is_file()
)
CONFIGURATION = [name for name in FILES if Path(name).suffix in WRITTEN or name == ".ci/run"]
YAML = [name for name in FILES if Path(name).suffix in (".cff", ".yaml", ".yml")]
#: lines about the version of something else: a requirement, a hook, the format of the citation
OF_OTHERS = re.compile(r"[=<>~]=|^\s*rev:|^cff-version:")


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def parsed(name: str) -> Any:
    return pytest.importorskip("yaml").safe_load(read(name))


def project() -> dict[str, Any]:
    return tomllib.loads(read("pyproject.toml"))["project"]


def pinned(package: str) -> str:
    """The version of a package in constraints.txt."""
    found = re.findall(rf"^{package}==(\S+)$", read("constraints.txt"), re.MULTILINE)
    assert len(found) == 1, f"constraints.txt: {package}: {found}"
    return found[0]


# --- the version ---------------------------------------------------------------------------------------------------------


def lines_with(number: str, text: str) -> list[str]:
    """The lines that have this version of ours."""
    whole = re.compile(rf"(?<![\w.]){re.escape(number)}(?!\w|\.\d)|\bv{re.escape(number)}\b")
    return [line for line in text.splitlines() if whole.search(line) and not OF_OTHERS.search(line)]


def test_a_version_is_found_as_a_whole_and_only_where_it_is_ours() -> None:
    assert lines_with("1.2.0", 'version: "1.2.0"\nversion = 1.2.0\ntag v1.2.0.\n') == ['version: "1.2.0"', "version = 1.2.0", "tag v1.2.0."]
    assert lines_with("1.2.0", "11.2.0\n1.2.01\n1.2.0.1\n1.2.0rc1\ncff-version: 1.2.0\n    rev: v1.2.0\nother==1.2.0\n'other>=1.2.0'\n") == []


def test_the_installed_version_is_the_one_of_the_package() -> None:
    try:
        installed = version("mfc-analysis")
    except PackageNotFoundError:
        pytest.skip("not installed")
    assert installed == mfc_analysis.__version__, "install again: the metadata are of another version"


def test_the_version_is_read_from_the_package() -> None:
    assert "version" not in project() and "version" in project()["dynamic"]
    assert tomllib.loads(read("pyproject.toml"))["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "mfc_analysis.__version__"}
    assert lines_with(mfc_analysis.__version__, read("mfc_analysis/__init__.py")) == [f'__version__ = "{mfc_analysis.__version__}"']


@pytest.mark.parametrize("name", [name for name in CONFIGURATION if name != "CHANGELOG.md"])
def test_no_other_file_repeats_the_version(name: str) -> None:
    assert lines_with(mfc_analysis.__version__, read(name)) == []


def test_the_newest_heading_of_the_changelog_is_the_version() -> None:
    newest = re.findall(r"^## (.*)$", read("CHANGELOG.md"), re.MULTILINE)[0]
    assert re.fullmatch(rf"{re.escape(mfc_analysis.__version__)} \((unreleased|\d{{4}}-\d\d-\d\d)\)", newest)


# --- installing ----------------------------------------------------------------------------------------------------------


def test_the_conda_environment_has_the_ranges_of_the_package() -> None:
    extras = project()["optional-dependencies"]
    listed = [*project()["dependencies"], *(one for extra in ("report", "study", "sweep", "robots") for one in extras[extra])]
    ranges = {one.name: one.specifier for one in map(Requirement, listed) if one.name != "mfc-analysis"}
    environment = parsed("environment.yml")["dependencies"]
    (own,) = (one["pip"] for one in environment if isinstance(one, dict))
    asked = {one.name: one.specifier for one in map(Requirement, [*(x for x in environment if isinstance(x, str)), *own[:-1]])}
    assert own[-1] == "." and "pip" in environment
    assert asked.pop("pip") == "" and asked.pop("python") == project()["requires-python"]
    asked["pin"] = asked.pop("pinocchio")
    assert asked == ranges


def test_every_pin_of_the_constraints_is_in_the_range_of_the_package() -> None:
    listed = [*project()["dependencies"], *(one for extra in project()["optional-dependencies"].values() for one in extra)]
    pins = {canonicalize_name(one.name): one for one in map(Requirement, re.findall(r"^\w.*$", read("constraints.txt"), re.MULTILINE))}
    for one in map(Requirement, listed):
        if one.name != "mfc-analysis":
            (pin,) = pins[canonicalize_name(one.name)].specifier
            assert one.specifier.contains(pin.version), one


# --- the checks ----------------------------------------------------------------------------------------------------------


def test_the_workflow_runs_the_script_of_ci() -> None:
    assert (ROOT / ".ci" / "run").is_file()
    assert re.search(r"^ +run: bash \.ci/run$", read(".github/workflows/ci.yml"), re.MULTILINE)


def test_the_lowest_and_the_newest_versions_run_on_the_oldest_and_the_newest_python() -> None:
    matrix = parsed(".github/workflows/ci.yml")["jobs"]["versions"]["strategy"]["matrix"]
    named = [name.rpartition(":: ")[2] for name in project()["classifiers"] if re.search(r":: 3\.\d+$", name)]
    assert matrix == {"python": [named[0], named[-1]], "versions": ["lowest", "newest"]}
    assert re.search(r"^ +run: bash \.ci/versions \$\{\{ matrix\.versions \}\}$", read(".github/workflows/ci.yml"), re.MULTILINE)


def test_the_workflow_may_only_read_and_ends_in_time() -> None:
    workflow = parsed(".github/workflows/ci.yml")
    assert set(workflow[True]) == {"push", "pull_request"}  # YAML 1.1 reads the key `on` as a truth value
    assert workflow["permissions"] == {"contents": "read"}
    oldest = project()["requires-python"].removeprefix(">=")
    for name, job in workflow["jobs"].items():
        assert job["timeout-minutes"] <= 30 and "permissions" not in job
        pythons = [step["with"]["python-version"] for step in job["steps"] if step.get("uses", "").startswith("actions/setup-python@")]
        assert pythons == ["${{ matrix.python }}" if name == "versions" else oldest], "CI runs on the oldest Python that is supported"


def test_contributors_are_told_the_commands_of_ci() -> None:
    guide = read("CONTRIBUTING.md")
    checks = re.findall(r"^\.venv/bin/(?!python -m (?:pip|build) |twine )[^>\n]*[^>\s]", read(".ci/run"), re.MULTILINE)
    tests = re.findall(r"\.venv/bin/python -m pytest.*$", read("README.md"), re.MULTILINE)
    assert len(checks) >= 3 and len(tests) == 1  # lint, format, docs; the tests check the types
    for command in ['.venv/bin/pip install -c constraints.txt -e ".[dev]"', *checks, *tests]:
        assert command in guide


def test_the_hooks_use_the_ruff_of_the_constraints() -> None:
    hooks = read(".pre-commit-config.yaml")
    assert re.findall(r"/ruff-pre-commit\n +rev: (\S+)", hooks) == [f"v{pinned('ruff')}"]


# --- the files themselves ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", YAML)
def test_a_yaml_file_can_be_read(name: str) -> None:
    assert isinstance(parsed(name), dict)


def test_the_yaml_files_are_among_those_read() -> None:
    assert {".github/workflows/ci.yml", ".pre-commit-config.yaml", "CITATION.cff"} <= set(YAML)
    assert {Path(name).name for name in YAML if "ISSUE_TEMPLATE" in name} == {"bug_report.yml", "config.yml", "question.yml"}


@pytest.mark.parametrize("name", [name for name in YAML if "ISSUE_TEMPLATE" in name and not name.endswith("config.yml")])
def test_the_fields_of_an_issue_form_have_names_of_their_own(name: str) -> None:
    form = parsed(name)
    assert form["name"] and form["description"]
    fields = [part for part in form["body"] if part["type"] != "markdown"]
    assert fields and any(part["validations"]["required"] for part in fields)
    for key in (lambda part: part["id"], lambda part: part["attributes"]["label"]):
        assert len({key(part) for part in fields}) == len(fields)


def test_the_citation_says_what_the_metadata_say() -> None:
    citation, metadata = parsed("CITATION.cff"), project()
    assert citation["cff-version"] == "1.2.0" and "version" not in citation
    assert citation["authors"] == metadata["authors"]
    assert citation["license"] == metadata["license"]
    assert citation["repository-code"] == metadata["urls"]["Source"]


def test_every_address_of_the_project_is_below_its_source() -> None:
    source = project()["urls"]["Source"]
    for name in ("pyproject.toml", "CITATION.cff", ".github/ISSUE_TEMPLATE/config.yml"):
        found = re.findall(r"https://[^\s\"]+", read(name))
        assert found and all(address == source or address.startswith(f"{source}/") for address in found), name


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "README.md", ".github/pull_request_template.md", ".github/ISSUE_TEMPLATE/bug_report.yml"])
def test_what_a_page_names_exists(name: str) -> None:
    paths = set(re.findall(r"(?:mfc_analysis|tests|docs|benchmarks|\.ci)/[\w/.]*\w|\b[A-Z]{4,}\.\w+", read(name)))
    missing = sorted(path for path in paths if not (ROOT / path).exists())
    assert paths and not missing
