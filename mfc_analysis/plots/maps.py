"""Stability maps over two parameters: two flat regions with their boundary (no pixel image), and simulated points on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STABLE, _UNSTABLE = "#cfe8dc", "#f6d5d1"


def stability_map(
    x: ArrayLike,
    y: ArrayLike,
    growth: ArrayLike,
    *,
    xlabel: str,
    ylabel: str,
    log: str = "xy",
    points: Sequence[tuple[float, float, bool]] = (),
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """The stability region of a loop over two parameters.

    Args:
        x: (nx,), y: (ny,). growth: (ny, nx), negative where stable (e.g. the largest real part of the poles); its zero is the boundary,
            NaN counts as unstable.
        log: logarithmic axes: "x", "y", "xy" or "". points: (x, y, stable) of simulated runs, marked on top.
        xlabel, ylabel: with units. title: of the figure. ax: to draw in; None: a new sheet.

    Raises:
        BadArgument: ``growth`` of another shape.
    """
    across, up, values = np.asarray(x, float), np.asarray(y, float), np.asarray(growth, float)
    if values.shape != (up.size, across.size):
        raise BadArgument("growth", f"shape {values.shape}", f"shape ({up.size}, {across.size})")
    ax = ax if ax is not None else sheet.axes_for("map")
    bound = float(np.max(np.abs(values[np.isfinite(values)]), initial=1.0))
    flat = np.nan_to_num(values, nan=bound, posinf=bound, neginf=-bound)
    ax.contourf(across, up, flat, levels=[-2 * bound, 0.0, 2 * bound], colors=[_STABLE, _UNSTABLE])
    if flat.min() < 0 < flat.max():
        ax.contour(across, up, flat, levels=[0.0], colors=[sheet.INK], linewidths=1.2)
    sheet.logarithmic(ax, log)
    ax.set_xlim(across[0], across[-1])
    ax.set_ylim(up[0], up[-1])
    _mark(ax, points)
    _words(ax, flat)
    sheet.label(ax, xlabel, ylabel, title)
    return ax


def log_axes(x: ArrayLike, y: ArrayLike) -> str:
    """Which of two axes of positive values, x (nx,) and y (ny,), are to be logarithmic: those over more than a decade."""
    return "".join(name for name, a in (("x", np.asarray(x, float)), ("y", np.asarray(y, float))) if a.min() > 0 and a.max() > 10 * a.min())


def _mark(ax: Axes, points: Sequence[tuple[float, float, bool]]) -> None:
    for stable, marker, color, name in ((True, "o", sheet.GOOD, "run settles"), (False, "X", sheet.BAD, "run diverges")):
        kept = [(a, b) for a, b, good in points if bool(good) is stable]
        if kept:
            a, b = zip(*kept, strict=True)
            ax.plot(a, b, linestyle="none", marker=marker, markersize=5, markeredgecolor=sheet.INK, markeredgewidth=0.6, color=color, label=name)
    sheet.legend(ax, columns=2, above=True)


def _words(ax: Axes, flat: np.ndarray) -> None:
    """Labels each region at its middle, so that the plot does not depend on colour alone."""
    rows, columns = flat.shape
    for word, inside in (("stable", flat < 0), ("unstable", flat >= 0)):
        if inside.mean() < 0.04:
            continue
        depth = _depth(inside)
        i, j = np.unravel_index(int(np.argmax(depth)), depth.shape)
        at = (float(np.clip((j + 0.5) / columns, 0.14, 0.86)), float(np.clip((i + 0.5) / rows, 0.07, 0.93)))
        sheet.note(ax, word, at, ha="center", inside=True)


def _depth(inside: np.ndarray) -> np.ndarray:
    """Distance of each cell from the edge of its region, in cells."""
    depth = np.zeros(inside.shape)
    padded = np.pad(inside, 1)
    while padded.any():
        depth += padded[1:-1, 1:-1]
        inner = padded[1:-1, 1:-1] & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
        padded = np.pad(inner, 1)
    return depth
