"""The JSON schema of studies: it takes what the reader takes, and names a wrong key."""

from __future__ import annotations

import json
import tomllib

import pytest

from mfc_analysis.robots.catalogue import load
from mfc_analysis.study import shipped
from mfc_analysis.study.init import study_for
from mfc_analysis.study.json_schema import json_schema
from tests.study.samples import BASE

jsonschema = pytest.importorskip("jsonschema")
CHECKED = jsonschema.Draft202012Validator(json_schema())


@pytest.mark.parametrize("name", shipped.shipped())
def test_a_shipped_study_is_one_by_the_schema(name: str) -> None:
    path, _ = shipped.shipped()[name]
    assert not list(CHECKED.iter_errors(tomllib.loads(path.read_text(encoding="utf-8"))))


def test_what_init_writes_is_one_by_the_schema() -> None:
    assert not list(CHECKED.iter_errors(tomllib.loads(study_for(load("panda"), 'load = "panda"', "panda.toml"))))


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"requirments": {}}, []),
        ({"law": {"equation": "9.10", "kp": "fast"}}, ["law", "kp"]),
        ({"hardware": {"delay": [1.0]}}, ["hardware", "delay"]),
        ({"loop": [{"robot": {"nme": "ur5"}}]}, ["loop", 0, "robot"]),
        ({"reference": {"kind": "Spin"}}, ["reference"]),
    ],
)
def test_a_wrong_key_or_value_is_found_where_it_stands(change: dict, where: list) -> None:
    study = tomllib.loads(BASE)
    CHECKED.validate(study)
    found = [list(error.absolute_path) for error in CHECKED.iter_errors({**study, **change})]
    assert found and all(path == where[: len(path)] for path in found)


def test_the_command_prints_it_or_writes_it(tmp_path) -> None:
    from typer.testing import CliRunner

    from mfc_analysis.cli.app import app

    file = tmp_path / "study.schema.json"
    printed, written = CliRunner().invoke(app, ["schema"]), CliRunner().invoke(app, ["schema", "--out", str(file)])
    assert printed.exit_code == written.exit_code == 0
    assert json.loads(printed.stdout) == json.loads(file.read_text(encoding="utf-8")) == json_schema()
