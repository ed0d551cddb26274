"""The page of one loop within a chapter: verdict, key metrics, frequency response, poles, and the comparison with the nonlinear simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mfc_analysis.report.document.document import Block, Bullets, Row, Section, Text
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.checks import checks, everywhere
from mfc_analysis.report.loops.sections import numbers, validated
from mfc_analysis.report.loops.view import View
from mfc_analysis.simulation.validation import Validation

COMPARED = 0.6  #: [s] of the comparison with the nonlinear loop


def loop_page(
    view: View,
    title: str = "",
    *,
    shown: str = "",
    path: bool = False,
    moving: bool = False,
    frequency: bool = True,
    compare: bool = True,
    finding: Text = "",
    before: tuple[Block, ...] = (),
    after: tuple[Block, ...] = (),
    more: Mapping[str, Any] | None = None,
    origins: tuple[tuple[str, str], ...] = (),
    brief: bool = False,
) -> Section:
    """The section of one loop.

    Args:
        title: of the section; omitted: the loop's name. shown: why a loop is shown for demonstration only; its verdict does not count.
        path: margins along the path; moving: the scrubber; frequency: Bode and poles; compare: the nonlinear loop.
        finding: omitted: made from the verdict. before, after: blocks around the figures. more: numbers for JSON.
        origins: (gain, where its value comes from). brief: no blocks, for a section that folds its loops.
    """
    found = validated(view, COMPARED) if compare else None
    body = () if brief else _body(view, found, path, moving, frequency, before, after)
    law = view.loop.law
    return Section(
        title[:1].upper() + title[1:] or view.name,
        finding or view.summary(),
        body,
        checks(everywhere(view.verdict.lines, view.smallest)),
        numbers=numbers(view, found) | dict(more or {}),
        sources=law.cited(),
        loop=view.name,
        key=view.name,
        shown=shown,
        origins=origins,
    )


def _body(
    view: View, found: Validation | None, path: bool, moving: bool, frequency: bool, before: tuple[Block, ...], after: tuple[Block, ...]
) -> tuple[Block, ...]:
    body: list[Block] = [blocks.three_numbers(view), *before]
    notes = [line.note for line in view.verdict.lines if line.note and line.name in ("stable", "residual") and line is not view.verdict.worst]
    if notes:
        body.append(Bullets(tuple(x[:1].upper() + x[1:] + "." for x in notes)))
    if frequency:
        rows = blocks.frequency_figures(view)
        first = rows[0]
        if isinstance(first, Row):
            body.append(Row((first.figures[0], blocks.pole_map(view))))
        else:
            body += [*rows, Row((blocks.pole_map(view),))]
    if path and (figure := blocks.history(view, most=3)) is not None:
        body.append(figure)
    if moving and (scrubber := blocks.scrubber(view)) is not None:
        body.append(scrubber)
    if found is not None:
        drawing = blocks.validation_figure(view, found) if figure_wanted(found) else None
        body.append(drawing if drawing is not None else _said(view, found))
    return (*body, *after)


def figure_wanted(found: Validation) -> bool:
    """Whether the comparison needs a figure: not if both results agree to rounding."""
    return bool(found.nrmse > 1e-6)


def _said(view: View, found: Validation) -> Block:
    from mfc_analysis.report.document.document import Paragraph

    units = sorted(set(view.loop.robot.joint_units))
    said = blocks.validation_words(found, units[0] if len(units) == 1 else "rad, m")
    return Paragraph(f"Comparison with the nonlinear simulation: {said}.")
