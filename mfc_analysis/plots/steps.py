"""Step responses: linear prediction, nonlinear simulation, and the torque."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def step(
    t: ArrayLike,
    y: ArrayLike,
    *,
    nonlinear: tuple[ArrayLike, ArrayLike] | None = None,
    torque: tuple[ArrayLike, ArrayLike] | None = None,
    torque_limit: float | None = None,
    target: float | None = None,
    band: float | None = None,
    index: int = 0,
    quantity: str = "q [rad]",
    drive: str = "τ [Nm]",
    title: str = "Step response",
    axes: tuple[Axes, ...] | None = None,
) -> tuple[Axes, ...]:
    """A step response and, below, its torque where it is given.

    Args:
        t: (m,) [s], y: (m,) of the linear model. nonlinear: (t, y) of the simulated run. torque: (t, tau) [Nm], of the
            nonlinear run, if given.
        torque_limit: [Nm], drawn with both signs.
        target: the final value; band: half width of the settling band, in the unit of y. quantity, drive: names and units of y and of the torque.
        index: the joint, for its colour. title: of the figure. axes: to draw in; None: a new sheet.
    """
    upper, *below = axes if axes is not None else sheet.panels_for("response" if torque is None else "step")
    time = np.asarray(t, float)
    if target is not None:
        upper.axhline(target, color=sheet.INK, linewidth=0.7)
        if band is not None:
            upper.axhspan(target - band, target + band, color=sheet.GRID, alpha=0.5, linewidth=0, zorder=0.3)
    upper.plot(time, np.asarray(y, float), color=sheet.colour(index), linewidth=1.4, label="linear")
    if nonlinear is not None:
        upper.plot(
            np.asarray(nonlinear[0], float), np.asarray(nonlinear[1], float), color=sheet.INK, linewidth=1.1, linestyle="--", label="nonlinear"
        )
    if torque is not None:
        lower = below[0]
        lower.plot(np.asarray(torque[0], float), np.asarray(torque[1], float), color=sheet.colour(index), linewidth=1.2)
        if torque_limit is not None and np.isfinite(torque_limit):
            for side in (1, -1):
                lower.axhline(side * torque_limit, color=sheet.INK, linewidth=0.8, linestyle=":")
        sheet.label(lower, "", drive)
    drawn = (upper, *below)
    for ax in drawn:
        ax.set_xlim(time[0], time[-1])
    sheet.hide_times(drawn)
    sheet.label(upper, "", quantity, title)
    sheet.label(drawn[-1], "t [s]")
    if len(upper.get_lines()) > 1 and nonlinear is not None:
        sheet.legend(upper, columns=2, above=True)
    return drawn


def responses(
    t: ArrayLike, y: ArrayLike, *, worst: int = 0, worst_time: float = 0.0, quantity: str = "q [rad]", title: str = "", ax: Axes | None = None
) -> Axes:
    """The responses at m times of a path in grey, one of them in colour.

    Args:
        t: (k,) [s]. y: (m, k). worst, worst_time: the row in colour, and its time [s]. quantity: name and unit of y.
        title: of the figure. ax: to draw in; None: a new sheet.
    """
    ax = ax if ax is not None else sheet.axes_for("response")
    time, values = np.asarray(t, float), np.asarray(y, float)
    for row in values:
        ax.plot(time, row, color=sheet.GREY, linewidth=0.7, alpha=0.5)
    ax.plot(time, values[worst], color=sheet.colour(0), linewidth=1.4, label=f"t = {sheet.written(worst_time)} s")
    ax.set_xlim(time[0], time[-1])
    sheet.label(ax, "t [s]", quantity, title)
    sheet.legend(ax, above=True)
    return ax
