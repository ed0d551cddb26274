"""The arm as a stick figure at poses along its path, in the coordinate plane with the largest extent."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def arm(
    origins: ArrayLike,
    *,
    worst: int | None = None,
    worst_time: float | None = None,
    view: str = "widest",
    title: str = "Poses along the path",
    ax: Axes | None = None,
) -> Axes:
    """Stick figures through the joint origins at up to seven poses, with the worst one in colour and the tool path dotted.

    Args:
        origins: (m, k, 3) [m]: world positions of base, joints and tool at m times. worst, worst_time: index of the worst time, and that time [s].
        view: "xy", "xz", "yz", or "widest": the plane with the largest extent. title: of the figure. ax: to draw in; None: a new sheet.

    Raises:
        BadArgument: for another shape or view.
    """
    points = np.asarray(origins, float)
    if points.ndim != 3 or points.shape[2] != 3:
        raise BadArgument("origins", f"shape {points.shape}", "positions of shape (m, k, 3)")
    planes = {"xz": (0, 2), "xy": (0, 1), "yz": (1, 2)}
    if view == "widest":
        spread = np.ptp(points.reshape(-1, 3), axis=0)
        view = max(planes, key=lambda name: float(spread[planes[name][0]] * spread[planes[name][1]] + 1e-12))
    if view not in planes:
        raise BadArgument("view", view, "one of " + ", ".join(map(repr, ("widest", *planes))))
    a, b = planes[view]
    ax = ax if ax is not None else sheet.axes_for("arm")
    shown = np.unique(np.round(np.linspace(0, len(points) - 1, min(7, len(points)))).astype(int))
    for i in shown:
        ax.plot(points[i, :, a], points[i, :, b], color=sheet.GREY, linewidth=1.0, marker="o", markersize=2.0, alpha=0.55)
    ax.plot(points[:, -1, a], points[:, -1, b], color=sheet.colour(0), linewidth=1.2, linestyle=":")
    if worst is not None:
        ax.plot(points[worst, :, a], points[worst, :, b], color=sheet.BAD, linewidth=1.8, marker="o", markersize=3.2)
        said = "worst" if worst_time is None else f"worst: t = {sheet.written(worst_time)} s"
        sheet.note(ax, said, (0.02, 0.97), color=sheet.BAD, va="top", inside=True)
    _square(ax, points[..., a], points[..., b])
    sheet.label(ax, f"{view[0]} [m]", f"{view[1]} [m]", title)
    return ax


def _square(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    half = 0.56 * max(float(np.ptp(x)), float(np.ptp(y)), 1e-3)
    cx, cy = (float(x.max() + x.min()) / 2, float(y.max() + y.min()) / 2)
    ax.set_xlim(cx - half, cx + half)
    ax.set_ylim(cy - half, cy + half * 1.12)
    ax.set_aspect("auto")
