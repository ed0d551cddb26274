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
    """A step response and, below, its torque.

    Args:
        t: (m,) [s], y: (m,) of the linear model. nonlinear: (t, y) of the simulated run. torque: (t, tau) [Nm], of the
            nonlinear run, if given.
        target: the final value; band: half width of the settling band, in the unit of y.
    """
    upper, lower = axes if axes is not None else sheet.panels_for("step")
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
        lower.plot(
            np.asarray(torque[0], float),
            np.asarray(torque[1], float),
            color=sheet.colour(index),
            linewidth=1.2,
        )
    else:
        sheet.empty(lower, "not recorded", sheet.GREY)
    if torque_limit is not None and np.isfinite(torque_limit):
        for side in (1, -1):
            lower.axhline(side * torque_limit, color=sheet.INK, linewidth=0.8, linestyle=":")
    for ax in (upper, lower):
        ax.set_xlim(time[0], time[-1])
    sheet.hide_times((upper, lower))
    sheet.label(upper, "", quantity, title)
    sheet.label(lower, "t [s]", drive)
    sheet.legend(upper, columns=2, above=True)
    return upper, lower
