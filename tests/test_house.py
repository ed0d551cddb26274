"""The floors of the house: who may import whom, lazy and type-only imports included."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "mfc_analysis"

#: room -> the rooms below it that it may import; errors are below everything
FLOORS: dict[str, set[str]] = {
    "errors": set(),
    "notebook": set(),
    "maths": set(),
    "units": {"maths"},
    "plots": {"maths"},
    "robots": {"maths"},
    "trajectories": {"robots", "maths"},
    "laws": {"robots", "maths"},
    "analysis": {"maths", "notebook", "plots"},
    "gains": {"analysis", "robots", "maths", "notebook", "plots", "units"},
}
FLOORS["dynamics"] = {"trajectories", "laws", *FLOORS["gains"]} | {"gains"}
FLOORS["simulation"] = FLOORS["dynamics"] | {"dynamics"}
FLOORS["linearization"] = FLOORS["simulation"] | {"simulation"}
FLOORS["loop"] = FLOORS["linearization"] | {"linearization"}
FLOORS["requirements"] = FLOORS["loop"] | {"loop"}
FLOORS["design"] = FLOORS["requirements"] | {"requirements"}
FLOORS["testing"] = FLOORS["requirements"] | {"requirements"}
FLOORS["exercises"] = FLOORS["loop"] | {"loop", "plots"}
FLOORS["study"] = FLOORS["design"] | {"design"}
FLOORS["report"] = FLOORS["study"] | {"study", "plots", "testing"}
FLOORS["pytest_plugin"] = FLOORS["report"] | {"report"}
FLOORS["cli"] = FLOORS["report"] | {"report", "exercises"}
FLOORS["__main__"] = {"cli"}

FILES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in FILES.items()}
#: what is imported in one room; those of an extra in the room that asks for it
LIBRARIES = {"pinocchio": "robots", "matplotlib": "plots", "solve_ivp": "simulation", "typer": "cli"}
LIBRARIES |= {"pydantic": "study", "ruamel": "study", "jinja2": "report", "typst": "report", "xarray": "design"}


def imports(name: str) -> set[tuple[str, str]]:
    """(module, name taken from it) of every import of a file, wherever it stands; ``from package import module`` names the module."""
    out = set()
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Import):
            out |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                out.add((whole, "") if whole in FILES else (str(node.module), alias.name))
    return out


def room(name: str) -> str:
    return name.split(".")[1] if "." in name else ""


@pytest.mark.parametrize("name", [name for name in FILES if room(name)])
def test_a_file_imports_only_from_its_own_room_and_from_floors_below(name: str) -> None:
    for module, taken in imports(name):
        if module == PACKAGE:  # a face of the top: its rooms count, and the version
            module = f"{PACKAGE}.{taken}" if taken in FLOORS else ""
        if module.startswith(f"{PACKAGE}."):
            assert room(module) in {room(name), "errors", *FLOORS[room(name)]}, f"{name} imports {module}"


def test_no_circle_of_imports_not_even_lazy_or_for_types() -> None:
    graph = {name: {module for module, _ in imports(name) if module in FILES and module != name} for name in FILES}
    free: set[str] = set()
    while ready := {name for name in graph.keys() - free if graph[name] <= free}:
        free |= ready
    assert graph.keys() == free, f"in or above a circle: {sorted(graph.keys() - free)}"


@pytest.mark.parametrize("library", LIBRARIES)
def test_a_library_is_imported_in_one_room(library: str) -> None:
    users = {room(name) for name in FILES for module, taken in imports(name) if library in (module.split(".")[0], taken)}
    assert users == {LIBRARIES[library]}


@pytest.mark.parametrize("name", FILES)
def test_no_private_name_is_reached_for_from_another_file(name: str) -> None:
    for module, taken in imports(name):
        assert not (module.startswith(PACKAGE) and re.match(r"_(?!_)", taken)), f"{name} takes {taken} of {module}"


@pytest.mark.parametrize("name", FILES)
def test_no_private_attribute_is_used_away_from_the_file_that_makes_it(name: str) -> None:
    text = FILES[name].read_text(encoding="utf-8")
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Attribute) and re.match(r"_(?!_)", node.attr) and not (isinstance(node.value, ast.Name) and node.value.id == "self"):
            made = re.search(rf"def {node.attr}\b|^\s*{node.attr}\b.*[:=]|self\.{node.attr}(:.*)? = |\"{node.attr}\"", text, re.MULTILINE)
            assert made or node.attr in ("_replace", "_fields"), f"{name}:{node.lineno} uses {node.attr}"


def test_every_file_of_the_package_has_a_test_file_at_the_mirrored_path() -> None:
    files = [path.relative_to(ROOT / PACKAGE) for path in FILES.values() if path.name not in ("__init__.py", "__main__.py")]
    missing = [str(path) for path in files if not (ROOT / "tests" / path.with_name(f"test_{path.name}")).is_file()]
    assert files and not missing


def test_the_top_holds_the_door_and_what_belongs_to_no_room() -> None:
    flat = {path.name for path in (ROOT / PACKAGE).iterdir() if path.suffix == ".py"} - {"__init__.py"}
    assert flat == {f"{name}.py" for name in ("__main__", "errors", "exercises", "loop", "notebook", "pytest_plugin", "testing", "units")}
