"""Measured signals of a study or of the command line: columns of a CSV file, their frequency response, and the model beside it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths import checks, files
from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from mfc_analysis.analysis.comparison import Comparison
    from mfc_analysis.analysis.frf import FrequencyResponse
    from mfc_analysis.study.read import StudyLoop
    from mfc_analysis.study.schema import MeasuredTable

LARGEST = 500_000_000  #: bytes of a file of signals


def columns(path: str | os.PathLike[str]) -> dict[str, Array]:
    """The columns (N,) of a CSV file by the names in its first line; without such a line "1", "2", ...

    Cells are separated by commas, semicolons, tabs or blanks; empty lines and those that start with ``#`` are skipped. Raises BadArgument, which
    names file and line.
    """
    takes = "the path of a CSV file that can be read"
    try:
        text = files.read(checks.path("file", path, takes), LARGEST).decode("utf-8-sig")
    except (OSError, UnicodeError) as why:
        raise BadArgument("file", str(path), f"{takes} ({getattr(why, 'strerror', None) or 'it is not UTF-8 text'})") from why
    lines = [(i, line) for i, line in enumerate(text.splitlines(), start=1) if line.strip() and not line.lstrip().startswith("#")]
    cells = [(i, _cells(line)) for i, line in lines]
    if not cells:
        raise BadArgument("file", str(path), "a CSV file with numbers")
    first = cells[0][1]
    named = all(checks.decimal(cell) is None for cell in first)
    names = [cell.strip("\"' ") for cell in first] if named else [str(k + 1) for k in range(len(first))]
    if len(set(names)) < len(names):
        raise BadArgument(f"{path}, line {cells[0][0]}", ", ".join(names), "columns of different names")
    rows = []
    for number, row in cells[1:] if named else cells:
        values = [checks.decimal(cell) for cell in row]
        if len(row) != len(names) or None in values:
            wrong = next((cell for cell, value in zip(row, values, strict=True) if value is None), f"{len(row)} columns")
            raise BadArgument(f"{path}, line {number}", wrong, f"{len(names)} finite numbers")
        rows.append(values)
    table = np.array(rows, float).reshape(len(rows), len(names))
    return dict(zip(names, table.T, strict=True))


def _cells(line: str) -> list[str]:
    cells = re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else line.split()
    return [cell.strip() for cell in cells]


def signal(argument: str, wanted: str, table: Mapping[str, Array]) -> Array:
    """A column (N,), or a sum such as ``tau + r`` or ``-tau`` of columns by their names or numbers. Raises UnknownName."""
    if wanted in table:
        return table[wanted]
    numbered = dict(zip(map(str, range(1, len(table) + 1)), table.values(), strict=True))
    found = np.zeros(len(next(iter(table.values()))))
    parts = re.findall(r"([+-]?)\s*([^+-]+)", wanted)
    for sign, name in parts:
        name = name.strip()
        if name not in table and name not in numbered:
            raise UnknownName(argument, name, table)
        column = table[name] if name in table else numbered[name]
        found = found - column if sign == "-" else found + column
    if not parts:
        raise UnknownName(argument, wanted, table)
    return found


def response(folder: Path, table: MeasuredTable) -> FrequencyResponse:
    """The frequency response of the signals that a table names. Raises BadArgument."""
    from mfc_analysis.analysis.frf import estimate

    read = columns(folder / table.file)
    keys = {"t": table.time, "u": table.input, "y": table.output} | ({} if table.excitation is None else {"r": table.excitation})
    words = {"t": "time", "u": "input", "y": "output", "r": "excitation"}
    given = {key: signal(words[key], name, read) for key, name in keys.items()}
    return estimate(**given, period=table.period, averages=table.averages, cycles=table.cycles, window=table.window)


def compared(one: StudyLoop) -> tuple[tuple[FrequencyResponse, Comparison], ...]:
    """Each measured response of a loop of a study, and its comparison with the model. Raises StudyError."""
    out = []
    for i, table in enumerate(one.table.measured):
        with one.parts.within(f"measured[{i}]" if len(one.table.measured) > 1 else "measured"):
            found = response(one.parts.folder, table)
            when = one.times[:1] if table.when is None else np.array([table.when])
            out.append((found, one.loop.linearize(when, horizon=one.requirements.horizon).compare(found, table.at or one.at, table.channel)))
    return tuple(out)
