"""The folder of the shipped studies: ``reports/`` of a checkout, ``mfc_analysis/study/files`` of an installed package."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths import files

_HERE = Path(__file__).resolve().parent


def folder() -> Path:
    """The folder of the studies."""
    inside = _HERE / "files"  # in a checkout, a link to reports/; a file on systems without links
    return inside if inside.is_dir() else _HERE.parents[1] / "reports"


def shipped() -> dict[str, tuple[Path, str]]:
    """name -> (file, title) of each shipped study, in alphabetical order."""
    out = {}
    for file in sorted(folder().glob("*.toml")):
        out[file.stem] = (file, str(tomllib.loads(file.read_text(encoding="utf-8")).get("title", "")))
    return out


def found(path: str | os.PathLike[str]) -> Path:
    """The path itself if it exists or looks like a path; else the shipped study of that name.

    Raises UnknownName for any other name; the error lists the study files of this folder and the shipped ones.
    """
    given = Path(path)
    if given.exists() or given.suffix or given.parent != Path("."):
        return given
    there = shipped()
    if given.name not in there:
        raise UnknownName("study", given.name, (*sorted(file.name for file in Path().glob("*.toml")), *there))
    return there[given.name][0]


def copied(target: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Copies all shipped studies into a folder, which is created if necessary. Raises BadArgument if a file exists."""
    out = []
    to = Path(target)
    to.mkdir(parents=True, exist_ok=True)
    for file, _ in shipped().values():
        copy = to / file.name
        if copy.exists():
            raise BadArgument("--copy", str(copy), "a folder that has no file of this name")
        files.write(copy, file.read_bytes())
        out.append(copy)
    return tuple(out)
