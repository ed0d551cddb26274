"""Measured frequency responses: with their coherence, and over the model's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Three = tuple["Axes", ...]  #: three of them


def response(found: Any, *, axes: Three | None = None) -> Three:
    """Gain [dB], phase [deg] and coherence of a ``FrequencyResponse`` (``found``) over the frequency [rad/s].

    ``axes``: three to draw in; None: a new sheet.
    """
    w = np.asarray(found.frequencies, float)
    panels = axes if axes is not None else sheet.panels_for("three histories")
    for ax, values in zip(panels, (found.gain_db, found.phase_deg, found.coherence), strict=True):
        sheet.log_grid(ax, w[0], w[-1])
        ax.plot(w, np.asarray(values, float), color=sheet.colour(0), linewidth=1.1)
    panels[2].set_ylim(0, 1.05)
    _labels(panels, ("gain [dB]", "phase [deg]", "coherence"), "Measured frequency response")
    return panels


def comparison(found: Any, *, axes: Three | None = None) -> Three:
    """Gain [dB] and phase [deg] of a measured loop (dots; grey where it is not trusted) and of the model (line), and the misfit of the phase.

    ``found``: a ``Comparison``. The band in which the gain is within 20 dB of 1, which decides the margins, is shaded.
    ``axes``: three to draw in; None: a new sheet.
    """
    w, good = np.asarray(found.frequencies, float), np.asarray(found.trusted, bool)
    model = np.degrees(np.unwrap(np.angle(found.model)))
    measured = model + np.asarray(found.phase_deg, float)
    panels = axes if axes is not None else sheet.panels_for("three histories")
    span = w[good] if good.any() else w
    low, high = max(w[0], span[0] / 2), min(w[-1], 2 * span[-1])
    gains = 20 * np.log10(np.abs(found.model))
    for ax, line, dots in ((panels[0], gains, gains + found.gain_db), (panels[1], model, measured)):
        ax.plot(w, line, color=sheet.colour(0), linewidth=1.3, label="model")
        _dots(ax, w, np.asarray(dots, float), good)
    _dots(panels[2], w, np.asarray(found.phase_deg, float), good)
    shown = (w >= low) & (w <= high)
    near = w[np.asarray(found.near, bool)]
    for ax in panels:
        sheet.log_grid(ax, low, high)
        if near.size:
            ax.axvspan(near[0], near[-1], color=sheet.SHADE, zorder=0)
    panels[0].axhline(0, color=sheet.INK, linewidth=0.7)
    panels[1].axhline(-180, color=sheet.INK, linewidth=0.7)
    panels[2].axhline(0, color=sheet.INK, linewidth=0.7)
    _room(panels[0], np.concatenate([gains[shown], (gains + found.gain_db)[good]]))
    _room(panels[1], np.concatenate([model[shown], measured[good]]))
    if good.any():
        _room(panels[2], np.append(np.asarray(found.phase_deg, float)[good], 0.0))
    sheet.legend(panels[0], above=True)
    _labels(panels, ("|L| [dB]", "arg L [deg]", "misfit [deg]"), "Measured loop over the model")
    return panels


def _dots(ax: Axes, w: Array, values: Array, good: Bools) -> None:
    for some, color, label in ((~good, sheet.GREY, "not trusted"), (good, sheet.colour(1), "measured")):
        if some.any():
            ax.plot(w[some], values[some], linestyle="none", marker=".", markersize=2.5, color=color, label=label)


def _room(ax: Axes, values: Array) -> None:
    low, high = float(values.min()), float(values.max())
    spare = 0.08 * max(high - low, 1.0)
    ax.set_ylim(low - spare, high + spare)


def _labels(panels: Three, names: tuple[str, str, str], title: str) -> None:
    sheet.hide_times(panels)
    for k, (ax, name) in enumerate(zip(panels, names, strict=True)):
        sheet.label(ax, "ω [rad/s]" if k == 2 else "", name, title if k == 0 else "")
