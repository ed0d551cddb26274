"""Simulated runs and other traces against time: one line per joint, limits dashed, events marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MANY = 3  #: most names in a legend that leave room for the names of the line styles
_KINDS = ("time history", "two histories", "three histories", "four histories")


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel: quantity with unit, values (m,) or (m, n), and optionally a limit or a dashed comparison of the same shape."""

    quantity: str  #: "error [rad]"
    values: ArrayLike  #: (m,) or (m, n)
    limit: float | None = None  #: drawn with both signs unless all values have one sign
    beside: ArrayLike | None = None  #: another run of the same quantity, dashed in the same colours
    log: bool = False  #: a logarithmic axis


def traces(
    t: ArrayLike,
    panels: Sequence[Panel],
    names: Sequence[str] = (),
    *,
    events: Sequence[tuple[float, str]] = (),
    title: str = "",
    said: tuple[str, str] | None = None,
    first: int = 0,
    axes: tuple[Axes, ...] | None = None,
) -> tuple[Axes, ...]:
    """One to four stacked panels over time.

    Args:
        t: (m,) [s]. panels: from the top. names: one for each column. events: (time [s], word), drawn as vertical lines.
        said: names of the solid and the dashed lines. first: the joint of the first column, for its colour.
        title: of the figure. axes: to draw in; None: a new sheet.

    Raises:
        BadArgument: no panel, or more than four.
    """
    if not 1 <= len(panels) <= len(_KINDS):
        raise BadArgument("panels", len(panels), "one to four panels")
    time = np.asarray(t, float)
    axes = sheet.panels_for(_KINDS[len(panels) - 1]) if axes is None else axes
    for ax, panel in zip(axes, panels, strict=True):
        _draw(ax, time, panel, names, first)
        for when, _ in events:
            ax.axvline(when, color=sheet.GREY, linewidth=0.8, linestyle=":")
        if time.size > 1:
            ax.set_xlim(time[0], time[-1])
    for k, (when, word) in enumerate(events[:6]):
        right = (when - time[0]) > 0.75 * (time[-1] - time[0])
        sheet.note(
            axes[-1],
            word,
            (when, 0.92 - 0.14 * (k % 3)),
            color=sheet.GREY,
            ha="right" if right else "left",
            shift=(-3 if right else 3, 0),
            mixed=True,
        )
    sheet.hide_times(axes)
    sheet.label(axes[-1], "t [s]")
    sheet.label(axes[0], title=title)
    if said is not None and len(names) > MANY:  # no room for them among the joints
        sheet.note(axes[-1], f"solid: {said[0]}, dashed: {said[1]}", (1.0, 0.0), color=sheet.GREY, ha="right", inside=True, shift=(0, -23))
    elif said is not None:
        axes[0].plot([], [], color=sheet.GREY, linewidth=1.3, label=said[0])
        axes[0].plot([], [], color=sheet.GREY, linewidth=1.1, linestyle="--", label=said[1])
    sheet.legend(axes[0], columns=9, above=True)
    return axes


def _draw(ax: Axes, time: np.ndarray, panel: Panel, names: Sequence[str], first: int) -> None:
    values, labels = np.asarray(panel.values, float), sheet.without_affixes(names)
    values = values[:, None] if values.ndim == 1 else values
    for j in range(values.shape[1]):
        ax.plot(time, values[:, j], color=sheet.colour(first + j), linewidth=1.2, label=labels[j] if j < len(labels) else "_")
    if panel.beside is not None:
        other = np.asarray(panel.beside, float)
        other = other[:, None] if other.ndim == 1 else other
        for j in range(other.shape[1]):
            ax.plot(time, other[:, j], color=sheet.colour(first + j), linewidth=1.1, linestyle="--")
    if panel.limit is not None and np.isfinite(panel.limit):
        for side in (1, -1) if np.nanmin(values) < 0 < np.nanmax(values) else (1,):
            ax.axhline(side * panel.limit, color=sheet.LIMIT, linewidth=1.0, linestyle="--", zorder=1.5)
    sheet.logarithmic(ax, "y" if panel.log else "")
    sheet.label(ax, "", panel.quantity)


def curves(
    x: ArrayLike,
    series: Sequence[tuple[str, ArrayLike]],
    *,
    xlabel: str,
    ylabel: str,
    log: str = "",
    limit: float | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Curves of one quantity over a parameter, e.g. a margin over stiffness.

    Args:
        x: (k,); series: name and values (k,) of each curve. log: "x", "y" or "xy". limit: a value drawn as a line.
        xlabel, ylabel: with units. title: of the figure. ax: to draw in; None: a new sheet.
    """
    ax = ax if ax is not None else sheet.axes_for("map")
    at = np.asarray(x, float)
    for j, (name, y) in enumerate(series):
        ax.plot(at, np.asarray(y, float), color=sheet.colour(j), linewidth=1.3, label=name)
    sheet.logarithmic(ax, log)
    if limit is not None and np.isfinite(limit):
        ax.axhline(limit, color=sheet.LIMIT, linewidth=1.0, linestyle="--")
    sheet.label(ax, xlabel, ylabel, title)
    sheet.legend(ax)
    return ax
