"""Studies: a TOML file with robot, law, path, hardware and requirements, turned into loops.

``read(path)`` checks the file against ``schema`` and builds its loops. File names in it are relative to it.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mfc_analysis.maths import checks, files
from mfc_analysis.maths.arrays import Array
from mfc_analysis.study.errors import StudyError
from mfc_analysis.study.messages import explained, has
from mfc_analysis.study.schema import LoopTable, SpanTable, StudyTable
from mfc_analysis.study.tables import REFERENCES, PoseTable, Table, ValidationError, tables_of

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.requirements.requirements import Requirements
    from mfc_analysis.study.parts import Parts


LARGEST = 4_000_000  #: bytes of a study file
ROBOTS = (".urdf", ".xml", ".mjcf", ".xacro")  #: endings of files that hold a robot
DEEPEST = 20  #: tables and lists within one another
MOST_CASES = 1000  #: most combinations of ranges in a study

#: keys that define a table: a ``[[loop]]`` with one of them replaces the table; otherwise it changes some of its keys
DECIDING: dict[str, Sequence[str]] = {"robot": ("name", "load", "urdf", "mjcf"), "law": ("equation", "name"), "reference": ("kind",)}


@dataclass(frozen=True, eq=False)
class Case:
    """A loop with some plant parameters changed, from the ranges of a study."""

    values: Mapping[str, float]  #: quantity -> value [SI]
    loop: ClosedLoop

    def __str__(self) -> str:
        return ", ".join(f"{name} = {value:g}" for name, value in self.values.items())


@dataclass(frozen=True, eq=False)
class StudyLoop:
    """A loop of a study, and its requirements."""

    name: str  #: in reports
    loop: ClosedLoop
    times: Array  #: (m,) [s]
    at: str | None  #: analysis point; None: the plant input
    table: LoopTable  #: the tables of the file
    parts: Parts = field(repr=False)  #: what the loop is built of

    @property
    def requirements(self) -> Requirements:
        """The requirements."""
        return self.parts.requirements

    @property
    def asks(self) -> bool:
        """Whether the file has requirements."""
        return bool(self.table.requirements.model_fields_set)

    def cases(self) -> Iterator[Case]:
        """Every combination of the ranges, with the controller's model unchanged. Empty if the study has no ranges."""
        spans = {name: span.points() for name, span in self.table.ranges.given().items()}
        if not spans:
            return
        for combination in itertools.product(*spans.values()):
            values = dict(zip(spans, combination, strict=True))
            yield Case(values, self.parts.varied(values))


@dataclass(frozen=True, eq=False)
class Study:
    """A study file and its loops."""

    title: str  #: of the report
    name: str  #: of the report's files
    text: str  #: a paragraph for the report, or empty
    file: Path
    sha256: str  #: of the file's bytes
    loops: tuple[StudyLoop, ...]
    table: StudyTable  #: the tables of the first loop

    def files(self) -> tuple[Path, ...]:
        """The study file and the files named in it."""
        return tuple(dict.fromkeys([self.file, *(path for one in self.loops for path in one.parts.files())]))

    @property
    def formats(self) -> tuple[str, ...]:
        """Formats of the report."""
        return tuple(self.table.report.formats)


def read(path: str | os.PathLike[str]) -> Study:
    """The study in a TOML file at ``path``, with its loops built.

    Raises StudyError (a ``ValueError``): not a file, not TOML, an unknown key (names the nearest), a value of the wrong type,
    files, joints or gains that do not fit together.
    """
    file = checks.path("path", path, "the path of a study file")
    try:
        content = files.read(file, LARGEST)
        raw = tomllib.loads(content.decode("utf-8-sig"))
    except OSError as why:
        raise StudyError(str(path), "", f"cannot be read ({why.strerror or type(why).__name__})") from why
    except UnicodeDecodeError as why:
        raise StudyError(str(path), "", "is not UTF-8 text") from why
    except RecursionError as why:
        raise StudyError(str(path), "", "has lists or tables nested too deeply") from why
    except ValueError as why:  # also a whole number of thousands of digits
        robot = f"; a study of this robot is written by: mfc-analysis init {path}" if Path(file).suffix in ROBOTS else ""
        raise StudyError(str(path), "", f"is not TOML: {why}{robot}") from why
    _check_depth(str(path), raw)
    tables = raw.pop("loop", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise StudyError(str(path), "loop", "must be [[loop]] tables")
    merged = [overridden(raw, t) for t in tables] or [raw]
    checked = [_checked(str(path), one, tables[i] if tables else None, i) for i, one in enumerate(merged)]
    from mfc_analysis.study.parts import Parts

    loops: list[StudyLoop] = []
    for i, table in enumerate(checked):
        _check_cases(str(path), table)
        parts = Parts(table, file.parent, str(path), f"loop[{i}]" if tables else "")
        loop, _ = parts.loop(), parts.requirements
        name = table.name or f"{type(loop.law).__name__} on {loop.robot.name}"
        if any(name == other.name for other in loops):
            name = f"{name} ({i + 1})"
        loops.append(StudyLoop(name, loop, parts.times(), parts.at(), table, parts))
    first = checked[0]
    title = first.title or file.stem
    return Study(title, first.report.name or file.stem, first.text or "", file, hashlib.sha256(content).hexdigest(), tuple(loops), first)


def overridden(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The base with some keys changed, table by table; a table with a key of DECIDING is replaced."""
    out = dict(base)
    for key, value in changes.items():
        old = out.get(key)
        anew = isinstance(value, dict) and any(word in value for word in DECIDING.get(key, ()))
        out[key] = overridden(old, value) if isinstance(old, dict) and isinstance(value, dict) and not anew else value
    return out


def _check_depth(file: str, raw: dict[str, Any]) -> None:
    inner: list[Any] = [raw]
    for _ in range(DEEPEST):
        inner = [x for one in inner for x in (one.values() if isinstance(one, dict) else one) if isinstance(x, (dict, list))]
    if inner:
        raise StudyError(file, "", "has lists or tables nested too deeply")


def _check_cases(file: str, table: LoopTable) -> None:
    count = 1
    for span in table.ranges.given().values():
        count *= len(span.points())
    if count > MOST_CASES:
        raise StudyError(file, "ranges", f"{count} combinations; at most {MOST_CASES} are allowed")


# --- validation ----------------------------------------------------------------------------------------------------------


def _checked(file: str, raw: dict[str, Any], changes: dict[str, Any] | None, index: int) -> StudyTable:
    try:
        return StudyTable.model_validate(raw)
    except ValidationError as why:
        first = min(why.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")  # a misspelt key is the cause of a missing one
        key, problem, allowed = explained(first, raw)
        if changes is not None and (has(changes, key) or not has(raw, key)):
            key = f"loop[{index}].{key}" if key else f"loop[{index}]"
        raise StudyError(file, key, problem, allowed) from None


def keys() -> dict[str, tuple[str, ...]]:
    """Every table of a study with its keys; the kinds of ``reference`` one by one, poses and ranges once."""
    shared: dict[type[Table], str] = {PoseTable: "(a pose)", SpanTable: "(a range)"}
    out: dict[str, tuple[str, ...]] = {}

    def add(name: str, table: type[Table]) -> None:
        inner = {key: tables_of(f.annotation) for key, f in table.model_fields.items()}
        out[name] = tuple(inner)
        for key, found in inner.items():
            for one in found:
                kind = next((f'{key}, kind = "{word}"' for word, table in REFERENCES.items() if table is one), key)
                if one not in shared:
                    add(kind if name == "study" else f"{name}.{kind}", one)

    add("study", StudyTable)
    for table, name in shared.items():
        add(name, table)
    return out
