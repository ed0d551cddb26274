"""Reports: a neutral document (``section``) rendered as HTML, PDF and JSON (``write``)."""

from mfc_analysis.report.write import render, rendered
from mfc_analysis.report.loop_report import write  # noqa: E402, I001 - after the module of the same name

__all__ = ["render", "rendered", "write"]
