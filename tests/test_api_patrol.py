"""The public names, patrolled: documented, strict about keywords, and cheap to import."""

from __future__ import annotations

import enum
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import mfc_analysis as mfc

ROOT = Path(__file__).resolve().parent.parent
FACADES = tuple(name for name in mfc.__all__ if inspect.ismodule(getattr(mfc, name)))
HEAVY = ("matplotlib", "control", "pinocchio", "scipy", "slycot", "xarray", "typer", "pydantic", "joblib", "jinja2", "typst", "rich", "pandas")
UNIT = re.compile(r"\[[^\]]*(?:rad|m|s|N|kg|deg|dB|-)[^\]]*\]|\([\w., ]+\)|dimensionless|scalar")


def public_names() -> Iterator[tuple[str, Any]]:
    """Every public name with its object: those of the package, and those of its public modules."""
    for name in mfc.__all__:
        yield f"mfc.{name}", getattr(mfc, name)
    for module in FACADES:
        found = getattr(mfc, module)
        names = getattr(found, "__all__", None) or [n for n in vars(found) if not n.startswith("_") and _own(getattr(found, n), found.__name__)]
        for name in names:
            yield f"mfc.{module}.{name}", getattr(found, name)


def _own(thing: Any, module: str) -> bool:
    return (inspect.isclass(thing) or inspect.isfunction(thing)) and thing.__module__ == module


PUBLIC = dict(public_names())
FUNCTIONS = {name: thing for name, thing in PUBLIC.items() if inspect.isfunction(thing)}
CLASSES = {name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing) and thing.__module__.startswith("mfc_analysis")}


def methods() -> Iterator[tuple[str, Any]]:
    """Public methods and properties that the classes define themselves."""
    for name, cls in CLASSES.items():
        for key, thing in vars(cls).items():
            if not key.startswith("_") and (inspect.isfunction(thing) or isinstance(thing, (property, classmethod, staticmethod))):
                yield f"{name}.{key}", thing


METHODS = dict(methods())


def described(thing: Any) -> str:
    return inspect.getdoc(thing) or ""


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_a_public_name_has_a_docstring_of_its_own(name: str) -> None:
    thing = PUBLIC[name]
    doc = thing.__doc__ or ""
    assert len(doc.strip()) > 15 and not doc.startswith(f"{thing.__name__}("), f"{name}: no docstring, or the one that dataclasses generate"


@pytest.mark.parametrize("name", METHODS)
def test_a_public_method_has_a_docstring(name: str) -> None:
    assert described(METHODS[name]).strip(), name


def wants_units(function: Callable[..., Any]) -> bool:
    return any("ArrayLike" in str(p.annotation) or "Array" in str(p.annotation) for p in inspect.signature(function).parameters.values())


@pytest.mark.parametrize("name", [name for name, f in {**FUNCTIONS, **METHODS}.items() if inspect.isfunction(f) and wants_units(f)])
def test_a_function_of_arrays_says_shapes_or_units(name: str) -> None:
    thing = {**FUNCTIONS, **METHODS}[name]
    owner = described(PUBLIC.get(name.rsplit(".", 1)[0]))  # a method may lean on what its class says
    assert UNIT.search(described(thing)) or UNIT.search(owner), name


def inherited(name: str) -> str:
    """The docstrings of a method in its class and the bases, and of those classes; of a class its own and those of its bases."""
    owner, _, key = name.rpartition(".")
    cls = CLASSES.get(name) or CLASSES[owner]
    bases = [base for base in cls.__mro__ if base.__module__.startswith("mfc_analysis")]
    return "\n".join(described(thing) for base in bases for thing in (base, vars(base).get(key)) if thing is not None)


def leaned_on(name: str, text: str) -> str:
    """The docstrings that a docstring names for more of its arguments: "arguments as ``margins``"."""
    rooms = [name.rpartition(".")[0], "mfc.ClosedLoop", "mfc.testing", "mfc"]
    found = [f"{room}.{other}" for other in re.findall(r"(?i)arguments as (?:``|:meth:`)([\w.]+)`", text) for room in rooms]
    known = {**FUNCTIONS, **METHODS}
    return "\n".join(described(known[other]) for other in found if other in known)


def commented(cls: type) -> set[str]:
    """The fields of a class that a ``#:`` comment on their line describes."""
    bases = [base for base in cls.__mro__ if base.__module__.startswith("mfc_analysis")]
    return {name for base in bases for name in re.findall(r"^    (\w+): .*#: \S", inspect.getsource(base), re.MULTILINE)}


def takes_arguments_of_ours(name: str) -> bool:
    bases = [base for base in CLASSES[name].__mro__ if base.__module__.startswith("mfc_analysis")] if name in CLASSES else []
    own = any(key in vars(base) for base in bases for key in ("__init__", "__new__")) and not issubclass(CLASSES[name], enum.Enum)
    return own or name in FUNCTIONS or (name in METHODS and not isinstance(METHODS[name], property))


@pytest.mark.parametrize("name", [name for name in (*FUNCTIONS, *CLASSES, *METHODS) if takes_arguments_of_ours(name)])
def test_every_parameter_is_described_by_its_name(name: str) -> None:
    thing = {**FUNCTIONS, **CLASSES, **METHODS}[name]
    text = described(thing) if name in FUNCTIONS else f"{described(thing)}\n{inherited(name)}"
    text += leaned_on(name, text)
    known = {"self", "cls", *(commented(thing) if name in CLASSES else ())}
    parameters = inspect.signature(getattr(thing, "__func__", thing)).parameters
    said = r"\b%s\b"
    if "Args:" in described(thing) and not re.search(r"(?i)arguments as", described(thing)):
        text, said = described(thing), r"(?:^ +|[,;.] )%s(?:, \w+)*: "  # an entry of its own, or one with others
    assert [other for other in parameters if other not in known and not re.search(said % other, text, re.MULTILINE)] == []


def takes_keywords(name: str) -> bool:
    cls = CLASSES.get(name)
    return cls is None or not issubclass(cls, (BaseException, tuple, enum.Enum))


@pytest.mark.parametrize("name", [name for name in (*FUNCTIONS, *CLASSES) if takes_keywords(name)])
def test_an_unknown_keyword_raises_type_error(name: str) -> None:
    thing = PUBLIC[name]
    if name in TAKES_ANY:
        pytest.skip(TAKES_ANY[name])
    with pytest.raises(TypeError):
        thing(no_such_keyword=1)


#: these take keywords of the caller's own, and check them themselves
TAKES_ANY = {
    "mfc.testing.assert_margins": "fields of Requirements by name: an unknown one is an UnknownName",
}


def test_an_unknown_figure_of_an_assertion_is_named() -> None:
    loop = mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(kp=1.0, kd=1.0), mfc.trajectories.Hold([0.0]))
    with pytest.raises(mfc.errors.UnknownName, match="phase_deg"):
        mfc.testing.assert_margins(loop, phase_degs=45)


def modules_after(code: str) -> set[str]:
    """The modules loaded by ``code`` in a fresh interpreter."""
    done = subprocess.run([sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


def test_importing_the_package_loads_nothing_heavy_and_little_at_all() -> None:
    before, after = modules_after("pass"), modules_after("import mfc_analysis")
    assert not after & {*HEAVY, "numpy"}
    ours = {name for name in after if name.startswith("mfc_analysis")}
    assert ours == {"mfc_analysis"}
    assert len(after - before) <= 10


def test_a_loop_and_its_poles_load_no_matplotlib_and_no_control() -> None:
    code = (
        "import mfc_analysis as mfc; "
        "mfc.ClosedLoop(mfc.robots.slider(), mfc.laws.JointPID(kp=1.0, kd=1.0), mfc.trajectories.Hold([0.0])).linearize().margins()"
    )
    assert not modules_after(code) & {"matplotlib", "control", "slycot", "pandas", "pydantic", "typer"}


def test_help_on_the_command_line_loads_no_science() -> None:
    assert not modules_after("import mfc_analysis.cli.app") & {"numpy", "scipy", "matplotlib", "control", "pinocchio", "pydantic"}


@pytest.mark.parametrize(
    "face",
    [
        "mfc_analysis",
        *(f"mfc_analysis.{name}" for name in ("dynamics", "linearization", *FACADES) if name not in ("constraints", "frf")),
    ],
)
def test_a_face_shows_its_public_names_and_nothing_else(face: str) -> None:
    found = importlib.import_module(face)
    assert sorted(dir(found)) == sorted(found.__all__)
    for name in found.__all__:
        assert not name.startswith("_") and hasattr(found, name)


def test_a_name_that_a_room_shares_with_its_file_is_the_thing_and_not_the_file() -> None:
    code = "import mfc_analysis.plots.margins, mfc_analysis.linearization.coupling; from mfc_analysis import linearization, plots; "
    code += "assert callable(plots.margins) and callable(linearization.coupling)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_attribute_is_named() -> None:
    with pytest.raises(AttributeError, match="ClosedLop"):
        mfc.ClosedLop  # noqa: B018
