"""What the environment feels of a loop: its admittance, and the damping that its port shows over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def admittance(
    frequencies: ArrayLike, series: Sequence[tuple[str, ArrayLike]], *, title: str = "Admittance", axes: tuple[Axes, Axes] | None = None
) -> tuple[Axes, Axes]:
    """Magnitude and phase of velocity per force over frequency; outside +-90 deg a channel gives energy.

    Args:
        frequencies: (k,) [rad/s] > 0. series: name and values (k,) complex of each channel.
        title: of the figure. axes: to draw in; None: a new sheet.
    """
    order = np.argsort(np.asarray(frequencies, float))
    w = np.asarray(frequencies, float)[order]
    upper, lower = axes if axes is not None else sheet.panels_for("bode")
    for j, (name, values) in enumerate(series):
        Y = np.asarray(values, complex)[order]
        upper.plot(w, np.where(Y == 0, np.nan, np.abs(Y)), color=sheet.colour(j), linewidth=1.3, label=name)
        lower.plot(w, np.degrees(np.angle(Y)), color=sheet.colour(j), linewidth=1.3)
    from matplotlib.ticker import MultipleLocator

    for ax in (upper, lower):
        if w.size > 1 and w[-1] > w[0]:
            sheet.log_grid(ax, w[0], w[-1])
        else:
            sheet.logarithmic(ax, "x")
    sheet.logarithmic(upper, "y")
    lower.set_ylim(-195, 195)
    lower.yaxis.set_major_locator(MultipleLocator(90))
    for angle in (90, -90):
        lower.axhline(angle, color=sheet.LIMIT, linewidth=1.0, linestyle="--")
    sheet.hide_times((upper, lower))
    sheet.label(upper, "", "|Y|", title)
    sheet.label(lower, "ω [rad/s]", "arg Y [deg]")
    sheet.legend(upper, columns=9, above=True)
    return upper, lower


def passivity(
    frequencies: ArrayLike, damping: ArrayLike, *, crossings: ArrayLike = (), said: str = "", title: str = "Damping of the port",
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Smallest eigenvalue of the real part of the impedance over frequency: below 0 the port gives energy.

    Args:
        frequencies: (k,) [rad/s] > 0; damping: (k,) [Ns/m, Nm s/rad], drawn over asinh. crossings: [rad/s] of its zeros. said: the finding.
        title: of the figure. ax: to draw in; None: a new sheet.
    """
    w, b = np.asarray(frequencies, float), np.asarray(damping, float)
    ax = ax if ax is not None else sheet.axes_for("map")
    sheet.label(ax, "ω [rad/s]", "damping [Ns/m, Nm s/rad]", title)
    if not w.size:
        sheet.empty(ax, said or "nothing to draw")
        return ax
    b = np.where(np.isfinite(b), b, np.nan)
    ax.plot(w, b, color=sheet.colour(0), linewidth=1.3)
    ax.fill_between(w, b, 0, where=b < 0, color="#f6d5d1", linewidth=0)
    sheet.log_grid(ax, w[0], w[-1])
    size = np.abs(b[np.isfinite(b) & (b != 0)])
    ax.set_yscale("asinh", linear_width=float(np.median(size)) if size.size else 1.0)
    _thinned(ax)
    ax.axhline(0, color=sheet.LIMIT, linewidth=1.0, linestyle="--")
    for at in np.asarray(crossings, float).ravel()[:20]:
        ax.axvline(at, color=sheet.GREY, linewidth=0.8, linestyle=":")
    if said:
        sheet.note(ax, said, (0.02, 0.98), va="top", inside=True, plate=True)
    return ax


def _thinned(ax: Axes) -> None:
    """The ticks of the y axis that are a line of text apart, 0 first: near 0 the decades of an asinh axis are close together."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    low, high = ax.get_ylim()
    ticks = sorted((float(y) for y in ax.yaxis.get_majorticklocs() if low <= y <= high), key=abs)
    apart, kept = 1.6 * sheet.TEXT * float(sheet.figure_of(ax).dpi) / 72, list[float]()
    for y in ticks:
        places = ax.transData.transform([(1.0, other) for other in (*kept, y)])[:, 1]
        if not kept or np.abs(places[:-1] - places[-1]).min() >= apart:
            kept.append(y)
    ax.yaxis.set_major_locator(FixedLocator(sorted(kept)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: sheet.decade(v)))
