"""Reports: a neutral document (``section``) rendered as HTML, PDF and JSON (``write``)."""

from mfc_analysis.report.loop_report import write
from mfc_analysis.report.write import render, rendered

__all__ = ["render", "rendered", "write"]
