"""``mfc-analysis compare``: the tables of two studies, and the pictures of what each imperfection costs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.cli import terminal

if TYPE_CHECKING:
    from mfc_analysis.design.attribution import Attribution
    from mfc_analysis.study.read import Study


def run(first: Study, second: Study, out: Path | None, progress: Callable[[str, int, int], None]) -> None:
    """Compares the loops of two studies and prints their tables; writes the pictures into ``out``."""
    from mfc_analysis.study import compare as study_compare

    for i, pair in enumerate(study_compare.compare(first, second, progress)):
        if pair.changes:
            terminal.table(study_compare.CHANGES, pair.changes, pair.heading)
        else:
            terminal.say(f"{pair.heading}: the same loop and requirements", "")
        terminal.table(study_compare.REQUIREMENTS, pair.rows())
        if pair.did is not None:
            costs("what each change did: cost alone (in brackets: on top of all the others); positive: worse", pair.did)
        for study, found in zip((first, second), pair.costs, strict=True):
            costs(f"{study.file.name}: what each imperfection costs", found)
        if out is not None:
            drawn = [("changes", pair.did), *zip(("first", "second"), pair.costs, strict=True)]
            terminal.say(*(str(_picture(out, f"{name}-{i + 1}", found)) for name, found in drawn if found is not None and found.factors))


def costs(title: str, found: Attribution) -> None:
    """Prints a table of costs; nothing where there is no imperfection."""
    if found.factors:
        head, *rows = found.rows()
        terminal.table(head, rows, title)


def _picture(out: Path, name: str, found: Attribution) -> Path:
    from mfc_analysis import plots
    from mfc_analysis.maths import files

    out.mkdir(parents=True, exist_ok=True)
    path = out / f"costs-{name}.svg"
    files.write(path, plots.svg(lambda: found.plot(ax=plots.axes_for("costs"))).encode("utf-8"))
    return path
