"""The figures of the sections on tool space, contact, stiffness and hardware: nothing leaves its sheet, nothing lies on another text."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from mfc_analysis.plots.figure import figure_of
from mfc_analysis.report.document.document import Compare, Figure, Row, Section
from tests.plots.test_figure import texts

MODULES = ("task", "force", "hybrid", "stiffness", "errata", "hardware")


def figures(sections: tuple[Section, ...]) -> Iterator[Figure]:
    """All figures of some sections, those in rows and comparisons included."""
    for section in sections:
        blocks = list(section.body)
        for block in blocks:
            if isinstance(block, Compare):
                blocks += [*block.left.body, *block.right.body]
            elif isinstance(block, Row):
                blocks += block.figures
            elif isinstance(block, Figure):
                yield block
        yield from figures(section.sections)


@pytest.mark.parametrize("module", MODULES)
def test_no_text_of_a_section_leaves_its_sheet_or_lies_on_its_title(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for figure in figures(import_module(f"mfc_analysis.report.chapter.{module}").sections()):
        drawn = figure_of(figure.draw())
        for said, box, sheet in texts(drawn, monkeypatch):
            assert "…" not in said, (figure.alt, said)
            assert sheet.x0 - 1 <= box.x0 and box.x1 <= sheet.x1 + 1 and sheet.y0 - 1 <= box.y0 and box.y1 <= sheet.y1 + 1, (figure.alt, said)
        canvas = FigureCanvasAgg(drawn)
        for ax in drawn.axes:
            legend, title = ax.get_legend(), ax.get_title(loc="left")
            if legend is not None and title:
                a, b = (x.get_window_extent(canvas.get_renderer()) for x in (legend, ax._left_title))
                assert not a.overlaps(b), (figure.alt, title)
