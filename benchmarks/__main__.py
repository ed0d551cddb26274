"""Measure run times and memory, as ratios to a lower bound or an alternative measured in the same run.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks --all --write

Both programs of a pair use one BLAS thread and take turns. Without ``--all`` long rows are not measured (three minutes in all), nor are rows
whose libraries (casadi, drake) are not installed. ``--write`` writes ``benchmarks/results.md``, which the page "Performance" shows.
"""

from __future__ import annotations

import argparse
import os
import platform
import warnings
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from benchmarks.table import ROOT, Row, markdown

ROOMS = ("linearization", "analysis", "simulation", "design", "report", "cli", "scaling")
RESULTS = ROOT / "benchmarks" / "results.md"
LIBRARIES = ("numpy", "scipy", "pin", "control", "casadi", "drake")


def rows(room: str) -> tuple[Row, ...]:
    """The rows of a room."""
    found: tuple[Row, ...] = import_module(f"benchmarks.{room}").ROWS
    return found


def installed(name: str) -> str | None:
    """The version of a distribution; None where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def machine() -> str:
    """What was measured on."""
    there = [f"{name} {found}" if (found := installed(name)) else f"without {name}" for name in LIBRARIES]
    busy = f", load average {os.getloadavg()[0]:.1f} at the start" if hasattr(os, "getloadavg") else ""
    return f"Python {platform.python_version()}, {', '.join(there)}; {os.cpu_count()} cores, one BLAS thread{busy}."


def main() -> None:
    """Measures the rows, prints each, and writes the table if asked."""
    takes = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    takes.add_argument("--all", action="store_true", help="long rows too")
    takes.add_argument("--only", nargs="*", choices=ROOMS, default=ROOMS, help="some of the rooms")
    takes.add_argument("--write", action="store_true", help="write benchmarks/results.md; with every room")
    asked = takes.parse_args()
    if asked.write and tuple(asked.only) != ROOMS:
        takes.error("--write needs every room: leave out --only")
    warnings.simplefilter("ignore")
    head = machine()
    print(head)
    sections = [head]
    for room in asked.only:
        cells = []
        for row in rows(room):
            missing = [name for name in row.needs if not installed(name)]
            left_out = f"{missing[0]} is not installed" if missing else "measured with --all" if row.slow and not asked.all else ""
            cells.append(row.cells(left_out or row.measure()))
            print(" | ".join(cells[-1]), flush=True)
        sections.append(f"**{room}**\n\n{markdown(cells)}".rstrip())
    if asked.write:
        RESULTS.write_text("\n\n".join(sections) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
