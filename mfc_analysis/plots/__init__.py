"""Figures of results. A plot takes values and returns axes; it computes no control theory. matplotlib loads at first use."""

from mfc_analysis.plots.arm import arm
from mfc_analysis.plots.batch import drawn
from mfc_analysis.plots.block import block
from mfc_analysis.plots.disc import disk, multipliers
from mfc_analysis.plots.figure import axes_for, panels_for, svg
from mfc_analysis.plots.frequency import bode, frequencies_of, nyquist, of_channel
from mfc_analysis.plots.maps import stability_map
from mfc_analysis.plots.margins import margin_history, margins
from mfc_analysis.plots.poles import poles
from mfc_analysis.plots.runs import Panel, curves, traces
from mfc_analysis.plots.steps import step

__all__ = [
    "Panel",
    "arm",
    "axes_for",
    "block",
    "bode",
    "curves",
    "disk",
    "drawn",
    "frequencies_of",
    "margin_history",
    "margins",
    "multipliers",
    "nyquist",
    "of_channel",
    "panels_for",
    "poles",
    "stability_map",
    "step",
    "svg",
    "traces",
]
