"""Bode, Nyquist and pole plots of a linearised loop at one time, dead time included."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis import plots
from mfc_analysis.analysis.channels import channel_number
from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.frequency.window import window
from mfc_analysis.analysis.margins import Margins, margins
from mfc_analysis.analysis.spectrum import poles as poles_of, spectrum
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Complex

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

FEWEST = 6  #: roots of a loop with dead time


def bode(system: OpenSystem, at: str, channel: int | str | None, ax: Axes | tuple[Axes, Axes] | None) -> Axes:
    """Implements ``Linearization.plot_bode`` of a system with one point."""
    found, k, w, L = _loop(system, at, channel)
    known = plots.of_channel(found, 0, k) | plots.frequencies_of(found, 0, k)
    return plots.bode(w, L, **known, index=k, title=_title(found, k), axes=plots.two_axes(ax))[0]


def nyquist(system: OpenSystem, at: str, channel: int | str | None, ax: Axes | None) -> Axes:
    """Implements ``Linearization.plot_nyquist`` of a system with one point."""
    found, k, w, L = _loop(system, at, channel)
    peak, known = float(found.sensitivity_peak[0, k]), plots.of_channel(found, 0, k)
    title = f"{found.channels[k]}, t = {found.times[0]:g} s"  # the sheet is narrow
    axes = plots.nyquist(w, L, sensitivity_peak=peak, **known, index=k, title=title, ax=plots.shown("nyquist", ax)[0])
    axes.set_xlabel(f"Re L at {found.at}")
    return axes


def poles(system: OpenSystem, damping: float | None, ax: Axes | None) -> Axes:
    """Implements ``Linearization.plot_poles`` of a system with one point."""
    ax, found, when = plots.shown("pole map", ax)[0], poles_of(system)[0], f"t = {system.times[0]:g} s"
    if not system.delayed:
        return plots.poles(found, damping=damping, discrete=bool(system.dt), title=f"Poles, {when}", ax=ax)
    roots = delay_roots(system, max(FEWEST, system.nx))[0]
    note = "grey: poles without dead time"
    return plots.poles(roots[np.isfinite(roots)], damping=damping, path=found, title=f"Roots with dead time, {when}", note=note, ax=ax)


def _loop(system: OpenSystem, at: str, channel: int | str | None) -> tuple[Margins, int, Array, Complex]:
    """Margins, channel, frequencies [rad/s] and L there; without a channel the one with the smallest phase margin."""
    found = margins(system, at)
    k = int(np.argmin(np.nan_to_num(found.phase_deg[0], nan=np.inf))) if channel is None else channel_number(channel, found.channels)
    marks = np.array([f[0, k] for f in (found.crossover, found.reduction_frequency, found.increase_frequency)])
    w = window(spectrum(system).rates[0], marks, float(found.crossover[0, k]), system.dt)
    return found, k, w, frequency_response(system, w, at, k)[0, 0]


def _title(found: Margins, k: int) -> str:
    return f"L at {found.at}, {found.channels[k]}, t = {found.times[0]:g} s"
