"""The reference of the guide: a page for each public name, with an example whose output is shown. ``pytest docs`` runs the examples."""

from __future__ import annotations

import importlib.util
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import mfc_analysis as mfc
from tests.test_api_patrol import PUBLIC as EVERY

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGES = sorted(path for path in (DOCS / "reference").glob("*.md") if path.stem != "index")
OTHER = {"errors", "behind"}  #: pages of several names
PUBLIC = {name.removeprefix("mfc."): thing for name, thing in EVERY.items() if not inspect.ismodule(thing)}


def named(name: str) -> Any:
    """The object of a name within the package. Attributes come first: a function can have the name of its file."""
    thing: Any = mfc
    for part in name.split("."):
        if not hasattr(thing, part):
            importlib.import_module(f"{thing.__name__}.{part}")
        thing = getattr(thing, part)
    return thing


def documented(page: Path) -> list[tuple[str, str]]:
    """(kind, name within the package) of what a page documents."""
    return re.findall(r"^\.\. auto(\w+):: mfc_analysis\.(\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)


def test_every_public_name_has_a_reference_page() -> None:
    there = [named(name) for page in PAGES for _, name in documented(page)]
    assert len(PUBLIC) > 150
    assert [name for name, thing in PUBLIC.items() if not any(thing is other for other in there)] == []


def test_names_of_pages_differ_by_more_than_capitals() -> None:
    names = [page.name.lower() for page in PAGES]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_documents_what_its_title_says(page: Path) -> None:
    found = documented(page)
    for kind, name in found:
        assert inspect.isclass(named(name)) if kind == "class" else inspect.isroutine(named(name)) == (kind != "data")
    assert found
    if page.stem not in OTHER:
        assert named(found[0][1]) == named(page.stem)
        assert page.read_text(encoding="utf-8").startswith(f"# mfc.{page.stem}\n")
        owner, _, method = page.stem.rpartition(".")
        assert page.stem in PUBLIC or (inspect.isclass(PUBLIC[owner]) and not method.startswith("_"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_an_example_with_its_output(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^## Example\n\n\w.*\n(?:.+\n)*\n```python\n(?:.*\n)+?```\n\n```text\n *\S", text, re.MULTILINE)


def test_the_index_lists_every_page_once() -> None:
    index = (DOCS / "reference" / "index.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[.*?\]\((\S+)\.md\) \| \S.* \|$", index, re.MULTILINE)
    assert sorted(rows) == sorted(page.stem for page in PAGES)


@pytest.fixture(scope="module")
def names() -> Any:
    """``docs/names.py``, which prepares the docstrings."""
    pytest.importorskip("sphinx")
    spec = importlib.util.spec_from_file_location("docs_names", DOCS / "names.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_enumeration_shows_its_members_and_an_error_in_a_sentence_is_a_name(names: Any) -> None:
    lines = ["Raises BadArgument for |x| > 1.", "", "Raises:", "    BadArgument: ``BadArgument`` stays."]
    names.prepare(None, "class", "Outcome", mfc.design.Outcome, None, lines)
    assert lines[:4] == ["Raises ``BadArgument`` for \\|x\\| > 1.", "", "Raises:", "    BadArgument: ``BadArgument`` stays."]
    assert lines[5] == f"- ``FOUND``: {mfc.design.Outcome.FOUND.value}" and len(lines) == 6 + len(mfc.design.Outcome)
    assert names.members(mfc.requirements.Status)[0] == "- ``PASS``"


def test_each_parameter_of_a_docstring_has_an_entry_of_its_own(names: Any) -> None:
    text = ["Args:", "    kp: [1/s^2], ki: [1/s^3]; scalar. q, v: at rest: 0.", "        More.", "    a, b, c: one, or b itself.", "", "End."]
    entries = ["    kp: [1/s^2]; scalar", "    ki: [1/s^3]; scalar", "    q: at rest: 0.", "        More.", "    v: at rest: 0.", "        More."]
    expected = ["Args:", *entries, *(f"    {x}: one, or b itself." for x in "abc"), "", "End."]
    assert names.one_each(text, {"kp", "ki", "q", "v", "a", "b", "c"}) == expected
    long = "what is measured, with a text of more than one line that would be read twice."
    assert names.one_each(["Args:", f"    q, v: {long}"], {"q", "v"}) == ["Args:", f"    q: {long}", "    v: see ``q``."]
