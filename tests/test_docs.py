"""What the documentation's checker lets pass, and what it doesn't; and the paths that the guide names."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import traceback
from pathlib import Path
from types import ModuleType

import pytest
from sybil import Document

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "reports" / "README.md", *(ROOT / "docs").rglob("*.md")])
SOURCES = sorted(path for folder in ("mfc_analysis", "docs", "examples", "benchmarks") for path in (ROOT / folder).rglob("*.py"))


def of_docs(name: str) -> ModuleType:
    """A module of the build of the guide."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def checker() -> ModuleType:
    return of_docs("conftest")


def wrong(checker: ModuleType, path: Path, text: str) -> str | None:
    """What is wrong with a page of this text, or None."""
    path.write_text(text, encoding="utf-8")
    try:
        page = Document.parse(str(path), checker.blocks)
        checker.enter(page.namespace)
        try:
            for block in page:
                block.evaluate()
        finally:
            checker.leave(page.namespace)
    except Exception as why:  # whatever a page raises
        return "".join(traceback.format_exception(why))
    return None


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        ("phase 54.0 deg", "phase 54.0 deg", True),
        ("phase 54.0 deg", "phase 54.1 deg", True),  # one unit of the last digit shown
        ("phase 54.0 deg", "phase 54.2 deg", False),
        ("3 of 9 times", "4 of 9 times", False),  # whole numbers are counts
        ("x = 1.23e-04", "x = 1.24e-04", True),
        ("x = 1.23e-04", "x = 1.23e-05", False),
        ("kp=498.6198352658189", "kp=498.6198352658190", True),  # no more than six digits are held against a machine
        ("stable True", "stable False", False),
        ("gain  up", "gain up", True),  # columns may be wider
        ("a\n...\nd", "a\nb\nc\nd", True),
        ("a\n...", "a", True),
        ("a\n...\nd", "a\nb", False),
        ("a", "a\nb", False),
        ("inf", "nan", False),
        ("1.0 2.0", "1.0", False),
    ],
)
def test_what_is_shown_agrees_with_what_is_printed(checker: ModuleType, shown: str, printed: str, same: bool) -> None:
    assert checker.agree(shown, printed) is same


def test_a_page_falls_into_its_blocks(checker: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text("# A\n\n```python\nprint(1)\n```\n\n```text\n1\n```\n\n```toml\n# file: a.toml\nx = 1\n```\n\nwords\n\n```text\nfree\n```\n")
    python, toml = Document.parse(str(page), checker.blocks)
    assert (python.line, python.parsed, python.region.lexemes["shown"]) == (3, "print(1)\n", "1\n")
    toml.evaluate()
    assert Path("a.toml").read_text() == "# file: a.toml\nx = 1\n"


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("```python\nx = 1\n```\n\n```python\nprint(x)\n```\n\n```text\n1\n```\n", None),  # one namespace
        ("```python\nprint(1)\n```\n\n```text\n2\n```\n", "the page shows"),
        ("words\n\n```python\nx = 1\nassert x == 2\n```\n", "AssertionError"),
        ("```python\nimport warnings\nfrom mfc_analysis.errors import MfcWarning\nwarnings.warn('odd', MfcWarning)\n```\n", "MfcWarning: odd"),
        ("```console\n$ rm -rf nothing\n```\n", "neither run nor known"),
        ("```console\n$ mfc-analysis gains pid\n```\n", "exit code 2"),
        ("```console\n$ mfc-analysis gains pid   # exit code 2\n```\n", None),
        ("```python\nx = 1\n", "a fence that never closes"),
    ],
)  # fmt: skip
def test_a_page_that_does_not_do_what_it_says_is_wrong(checker: ModuleType, page: str, said: str | None, tmp_path: Path) -> None:
    found = wrong(checker, tmp_path / "page.md", page)
    assert found is None if said is None else said in str(found)


def test_an_error_names_the_line_of_the_page(checker: ModuleType, tmp_path: Path) -> None:
    assert 'page.md", line 5' in str(wrong(checker, tmp_path / "page.md", "words\n\n```python\nx = 1\nassert x == 2\n```\n"))
    assert "page.md, line 3, column 1 did not evaluate" in str(
        wrong(checker, tmp_path / "page.md", "a\n\n```python\nprint(1)\n```\n\n```text\n2\n```\n")
    )


def test_a_block_draws_a_picture_beside_the_page(checker: ModuleType, tmp_path: Path) -> None:
    page = "```python\nfrom matplotlib import pyplot\npyplot.plot([0, 1])  # picture: line.png\n```\n"
    assert wrong(checker, tmp_path / "page.md", page) is None
    assert (tmp_path / "pictures" / "line.png").read_bytes()[:4] == b"\x89PNG"


def missing(text: str, *folders: Path) -> list[str]:
    """The paths of a text that do not exist: files and folders of the project, ``name.py`` in code quotes, dotted names of the package."""
    files = re.findall(r"(?<![\w/.-])(?:mfc_analysis|benchmarks|docs|examples|reports|tests)/[\w./]*\w", text)
    lost = [name for name in files if not (ROOT / name).exists()]
    lost += [name for name in re.findall(r"``([\w/]+\.py)``", text) if not any((folder / name).exists() for folder in folders)]
    for name in set(re.findall(r"(?<![\w/.-])(?:mfc|mfc_analysis)(?:\.[A-Za-z_]\w*)+", text)):
        try:
            pkgutil.resolve_name(re.sub(r"^mfc\.", "mfc_analysis.", name))
        except (ImportError, AttributeError):
            lost.append(name)
    return sorted(set(lost))


@pytest.mark.parametrize(
    "name", ["mfc_analysis/equations.py", "docs/no_such_page.md", "``no_such_file.py``", "mfc.laws.NoSuchLaw", "mfc_analysis.no_such_room.file"]
)
def test_a_path_that_does_not_exist_is_found(name: str) -> None:
    assert missing(f"see `mfc_analysis/loop.py`, mfc.laws.JointPID and {name}.", ROOT) == [name.strip("`")]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_path_that_the_guide_names_exists(page: Path) -> None:
    assert missing(page.read_text(encoding="utf-8")) == []


def test_every_path_that_a_source_names_exists() -> None:
    found = {path.name: missing(path.read_text(encoding="utf-8"), path.parent, ROOT / "mfc_analysis", ROOT) for path in SOURCES}
    assert {name: lost for name, lost in found.items() if lost} == {}


@pytest.mark.parametrize(
    "page", [page for page in PAGES if re.search(r"\]\(pictures/\S+\.png", page.read_text(encoding="utf-8"))], ids=lambda page: page.name
)
def test_every_picture_of_a_page_is_drawn_by_one_of_its_blocks(checker: ModuleType, page: Path) -> None:
    shown = re.findall(r"\]\(pictures/(\S+\.png)\)", page.read_text(encoding="utf-8"))
    drawn = [name for block in Document.parse(str(page), checker.blocks) for name in re.findall(r"#.*\bpicture: (\S+)", block.parsed)]
    assert shown and shown == drawn


def test_the_picture_of_the_house_has_every_room_above_those_that_it_imports() -> None:
    house = of_docs("house")
    below, _ = house.table()
    place = {name: float(y) for y, name in re.findall(r'class="room" x="\S+" y="(\S+)">(\w+)<', house.svg())}
    assert place.keys() == below.keys()
    assert all(place[room] < place[b] for room, under in below.items() for b in under)


def test_an_absolute_value_in_a_docstring_is_no_substitution_and_equations_stay() -> None:
    pytest.importorskip("sphinx")
    lines = ["|s| < 1 and :math:`|L|` and ``|x|``", "", ".. math:: |T|", "", "|e|"]
    of_docs("names").prepare(None, "module", "", None, None, lines)
    assert lines == [r"\|s\| < 1 and :math:`|L|` and ``|x|``", "", ".. math:: |T|", "", r"\|e\|"]
