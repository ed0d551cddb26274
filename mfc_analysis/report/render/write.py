"""Writes a document as HTML, PDF and JSON from one tree into one folder: the same bytes for the same input."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version as version_of
from pathlib import Path
from typing import TYPE_CHECKING

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks, files
from mfc_analysis.maths.garbage import rare_collections
from mfc_analysis.report.document.document import Document

if TYPE_CHECKING:
    from mfc_analysis.report.document.scrubber import Moving

Progress = Callable[[int, int], None]
LATEST = 2**33  #: [s since 1970] latest date of a PDF
FORMATS = ("html", "pdf", "json")


def render(
    document: Document, folder: str | os.PathLike[str], formats: Sequence[str] = FORMATS, *, timestamp: int = 0, progress: Progress | None = None
) -> dict[str, Path]:
    """Writes ``folder/name.html``, ``.pdf`` and ``.json``; returns the path of each format.

    Args:
        folder: created if necessary. Nothing is written outside it: the file name is ``document.name`` reduced to a-z, 0-9 and hyphens.
        document: as ``report.document`` defines it. formats: some of "html", "pdf", "json".
        timestamp: the PDF's date [s since 1970]; an input, never the clock.
        progress: called with (done, of how many) after each figure and each format.

    Raises:
        BadArgument: for an unknown format, or a folder that is a file.
    """
    from mfc_analysis.report.document.tree import slug

    if isinstance(formats, str):
        formats = formats.replace(",", " ").split()
    formats = checks.names("formats", formats, FORMATS)
    target = checks.path("folder", folder, "a folder to write into")
    if target.exists() and not target.is_dir():
        raise BadArgument("folder", str(folder), "a folder to write into")
    with rare_collections():
        pages = rendered(document, formats, timestamp=timestamp, progress=progress)
    target.mkdir(parents=True, exist_ok=True)
    name = slug(document.name)
    out = {}
    for kind, content in pages.items():
        out[kind] = target / f"{name}.{kind}"
        files.write(out[kind], content)
    return out


def rendered(document: Document, formats: Sequence[str] = FORMATS, *, timestamp: int = 0, progress: Progress | None = None) -> dict[str, bytes]:
    """The bytes of each format, in the given order. Arguments as ``render``."""
    from concurrent.futures import ThreadPoolExecutor

    from mfc_analysis.report.document.tree import tree
    from mfc_analysis.report.render.numbers import numbers, to_json

    timestamp = checks.whole("timestamp", timestamp, 0, LATEST)
    flat = tree(document)
    version = package_version()
    drawings: dict[str, str] = {}
    moving: dict[str, Moving] = {}
    pages = "html" in formats or "pdf" in formats
    count = _Count(progress, len(formats) + (len(flat.figures) if pages else 0))
    if pages:
        from mfc_analysis.plots.batch import drawn
        from mfc_analysis.report.document import scrubber

        drawings = dict(zip(flat.figures, drawn([f.draw for f in flat.figures.values()], progress=count), strict=True))
        moving = {key: scrubber.moving(s) for key, s in flat.scrubbers.items()}

    make: dict[str, Callable[[], bytes]] = {"json": lambda: to_json(numbers(document, flat, version)).encode("utf-8")}
    if "html" in formats:  # imported before there are two threads: under pytest an import parses, and CPython 3.11 does not parse in two at once
        from mfc_analysis.report.render.html import html
        from mfc_analysis.report.render.mathml import mathml

        make["html"] = lambda: html(flat, drawings, mathml(flat.equations), moving, version).encode("utf-8")
    if "pdf" in formats:
        from mfc_analysis.report.render.pdf import pdf

        make["pdf"] = lambda: pdf(flat, drawings, moving, version, timestamp)
    out: dict[str, bytes] = {}
    with ThreadPoolExecutor(1) as beside:  # Typst needs no lock of Python: the other formats are made at the same time
        printed = beside.submit(make["pdf"]) if "pdf" in formats else None
        for kind in sorted(formats, key="pdf".__eq__):
            out[kind] = make[kind]() if kind != "pdf" or printed is None else printed.result()
            count(1)
    return {kind: out[kind] for kind in formats}


class _Count:
    """Counts finished figures and formats."""

    def __init__(self, told: Progress | None, total: int) -> None:
        self.told, self.total, self.done = told, total, 0

    def __call__(self, some: int) -> None:
        self.done += some
        if self.told is not None:
            self.told(self.done, self.total)


def package_version() -> str:
    """The installed version of this package."""
    try:
        return version_of("mfc-analysis")
    except PackageNotFoundError:
        return "unknown"
