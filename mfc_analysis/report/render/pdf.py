"""PDF by Typst from the same tree as the HTML: PDF/A-2a and PDF/UA-1, matplotlib's fonts, no system fonts, nothing downloaded.

Texts reach Typst as JSON and are set as strings; only equations (``section.Math`` checks them) are written as source.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

from mfc_analysis.plots.figure import font_folder
from mfc_analysis.report.document.scrubber import Moving
from mfc_analysis.report.document.tree import Tree
from mfc_analysis.report.render.html import asset

STANDARDS: Final[list[Literal["a-2a", "ua-1"]]] = ["a-2a", "ua-1"]


def pdf(tree: Tree, drawings: Mapping[str, str], scrubbers: Mapping[str, Moving], version: str, timestamp: int = 0) -> bytes:
    """The PDF's bytes. ``drawings``: SVG text by figure id. ``timestamp`` [s since 1970] is the document's date.

    The date is an input, so that the same input gives the same bytes.
    """
    import typst

    pictures = dict(drawings)
    for key, moving in scrubbers.items():
        pictures |= {f"{key}-poles": moving.poles, f"{key}-traces": moving.traces}
    widths = {key: _width(text) for key, text in pictures.items()}
    with TemporaryDirectory() as folder:
        root = Path(folder)
        for key, text in pictures.items():
            (root / f"{key}.svg").write_text(text, encoding="utf-8")
        data = {"root": tree.root, "widths": widths, "version": version}
        (root / "data.json").write_text(json.dumps(data, allow_nan=False), encoding="utf-8")
        (root / "equations.typ").write_text(_equations(tree), encoding="utf-8")
        (root / "report.typ").write_bytes(asset("report.typ"))
        made = typst.compile(
            str(root / "report.typ"),
            root=str(root),
            font_paths=[font_folder()],
            ignore_system_fonts=True,
            format="pdf",
            pdf_standards=list(STANDARDS),
            timestamp=timestamp,
        )
    return bytes(made)


def _width(svg: str) -> float:
    """The width of a drawing [pt]."""
    head = svg[: svg.index(">", svg.index("<svg"))]
    return float(head.split('width="', 1)[1].split("pt", 1)[0])


def _equations(tree: Tree) -> str:
    lines = ["#let formulas = ("]
    for key, (source, display) in tree.equations.items():
        lines.append(f'  "{key}": $ {source} $,' if display else f'  "{key}": ${source}$,')
    return "\n".join([*lines, '  "none": none,', ")"]) + "\n"
