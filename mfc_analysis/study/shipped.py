"""Where the studies that ship are: ``reports/`` of the checkout, ``mfc_analysis/study/files`` of an installed package."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

from mfc_analysis.errors import BadArgument, UnknownName

_HERE = Path(__file__).resolve().parent


def folder() -> Path:
    """The folder of the studies."""
    inside = _HERE / "files"  # in a checkout a link to reports/; where links are not made, a file
    return inside if inside.is_dir() else _HERE.parents[1] / "reports"


def shipped() -> dict[str, tuple[Path, str]]:
    """name -> (file, title) of each study that ships, in alphabetical order."""
    out = {}
    for file in sorted(folder().glob("*.toml")):
        out[file.stem] = (file, str(tomllib.loads(file.read_text(encoding="utf-8")).get("title", "")))
    return out


def found(path: str | os.PathLike[str]) -> Path:
    """The path itself where a file is there or it looks like one; else the shipped study of that name.

    Raises UnknownName for a bare word that is neither; it lists the study files of this folder and the shipped ones.
    """
    given = Path(path)
    if given.exists() or given.suffix or given.parent != Path("."):
        return given
    there = shipped()
    if given.name not in there:
        raise UnknownName("study", given.name, (*sorted(file.name for file in Path().glob("*.toml")), *there))
    return there[given.name][0]


def copied(target: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Copies of all shipped studies in a folder, made if it isn't there. Raises BadArgument rather than overwrite one."""
    out = []
    to = Path(target)
    to.mkdir(parents=True, exist_ok=True)
    for file, _ in shipped().values():
        copy = to / file.name
        if copy.exists():
            raise BadArgument("--copy", str(copy), "a folder without files of these names")
        copy.write_bytes(file.read_bytes())
        out.append(copy)
    return tuple(out)
