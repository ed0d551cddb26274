"""``mfc-analysis frf``: the frequency response of measured signals, and a study's model beside it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.analysis.frf import COLUMNS as COLUMNS
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import files

if TYPE_CHECKING:
    from mfc_analysis.analysis.comparison import Comparison
    from mfc_analysis.analysis.frf import FrequencyResponse
    from mfc_analysis.study.read import Study


def response(
    file: Path, columns: Mapping[str, str | None], period: float | None, averages: int, study: Study | None, at: str | None, channel: str | None
) -> tuple[FrequencyResponse, Comparison | None]:
    """The response of the columns, and its comparison with the first loop of a study, at its first time. Raises BadArgument."""
    from mfc_analysis.study import measured
    from mfc_analysis.study.schema import MeasuredTable

    if averages < 2:
        raise BadArgument("--averages", averages, "2 or more")
    table = MeasuredTable(file=str(file.resolve()), period=period, averages=averages, **{k: v for k, v in columns.items() if v is not None})  # type: ignore[arg-type]
    found = measured.response(Path(), table)
    if study is None:
        return found, None
    one = study.loops[0]
    return found, one.loop.linearize(one.times[:1], horizon=one.requirements.horizon).compare(found, at or one.at, channel)


def drawn(what: FrequencyResponse | Comparison, path: Path) -> str:
    """Draws a result into an SVG file; returns the path. Raises BadArgument for another ending."""
    from mfc_analysis import plots
    from mfc_analysis.analysis.comparison import Comparison

    if path.suffix.lower() != ".svg":
        raise BadArgument("--plot", str(path), "a file name that ends in .svg")
    files.write(path, plots.svg(partial(plots.comparison if isinstance(what, Comparison) else plots.response, what)).encode("utf-8"))
    return str(path)
