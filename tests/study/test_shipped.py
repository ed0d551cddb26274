"""The studies that ship: where they are, found by name, copied without overwriting."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.study.read import read
from mfc_analysis.study.shipped import copied, folder, found, shipped

pytestmark = pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")


@pytest.mark.parametrize("name", sorted(p.stem for p in folder().glob("*.toml")))
def test_every_shipped_study_reads_and_says_what_it_asks(name):
    text = shipped()[name][0].read_text(encoding="utf-8")
    if 'load = "' in text:
        pytest.importorskip("importlib.metadata").version("example-robot-data")
    one = read(found(name))
    assert one.title and one.text and all(loop.asks for loop in one.loops)
    assert text.startswith("# ") and tomllib.loads(text)


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
    before = {f.name: f.read_bytes() for f in files}
    assert before == {f.name: f.read_bytes() for f, _ in shipped().values()}
    with pytest.raises(BadArgument) as why:
        copied(tmp_path / "mine")
    assert why.value.argument == "--copy" and {f.name: f.read_bytes() for f in files} == before


def test_a_file_that_is_there_is_found_before_a_shipped_study_of_its_name(tmp_path, monkeypatch):
    assert found("ur5_payload") == shipped()["ur5_payload"][0]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ur5_payload").touch()
    assert found("ur5_payload") == Path("ur5_payload")


def test_shipped_studies_stand_in_the_order_of_the_alphabet_with_their_titles():
    assert list(shipped()) == sorted(p.stem for p in folder().glob("*.toml"))
    for file, title in shipped().values():
        assert title and f'title = "{title}"' in file.read_text(encoding="utf-8")
