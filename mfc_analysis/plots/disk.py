"""Two disks: Floquet multipliers in the unit circle, and the simultaneous gain and phase variations of a disk margin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def multipliers(values: ArrayLike, *, title: str = "Floquet multipliers", ax: Axes | None = None) -> Axes:
    """Floquet multipliers and the unit circle; the largest is labelled.

    Args:
        values: (nx,) complex. title: of the figure. ax: to draw in; None: a new sheet.
    """
    found = np.asarray(values, complex).ravel()
    ax = ax if ax is not None else sheet.axes_for("disc")
    reach = 1.2 * max(1.0, float(np.abs(found).max(initial=0.0)))
    turn = np.linspace(0, 2 * np.pi, 181)
    ax.plot(np.cos(turn), np.sin(turn), color=sheet.INK, linewidth=0.9)
    inside = np.abs(found) < 1
    for kept, color in ((inside, sheet.colour(0)), (~inside, sheet.BAD)):
        ax.plot(np.real(found)[kept], np.imag(found)[kept], linestyle="none", marker="x", markersize=6, markeredgewidth=1.5, color=color)
    if found.size:
        top = found[int(np.argmax(np.abs(found)))]
        angle = np.degrees(np.angle(top))
        sheet.note(
            ax,
            f"largest {sheet.written(abs(top), 4)} at {sheet.written(abs(angle))}°",
            (0.02, 0.98),
            color=sheet.INK if inside.all() else sheet.BAD,
            va="top",
            inside=True,
        )
    ax.set_aspect("equal")
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach * 1.0)
    sheet.label(ax, "Re μ", "Im μ", title)
    return ax


def disk(
    gain: tuple[float, float],
    phase_deg: float,
    *,
    alpha: float,
    index: int = 0,
    title: str = "Allowed gain and phase",
    ax: Axes | None = None,
) -> Axes:
    """The disk of complex factors that are allowed in all loops at once.

    Args:
        gain: its limits on the real axis (factors; the upper may be inf). phase_deg: its pure phase [deg]. alpha: the disk margin.
        index: the joint, for its colour. title: of the figure. ax: to draw in; None: a new sheet.
    """
    low, high = gain
    ax = ax if ax is not None else sheet.axes_for("disc")
    if np.isnan(alpha):
        sheet.empty(ax, "no disk margin: not stable")
        sheet.label(ax, title=title)
        return ax
    turn = np.linspace(0, 2 * np.pi, 181)
    ax.plot(np.cos(turn), np.sin(turn), color=sheet.GREY, linewidth=0.7, linestyle=":")
    right = 2.6 if not np.isfinite(high) else max(1.6, min(high * 1.15, 6.0))
    if np.isfinite(high):
        centre, radius = (low + high) / 2, (high - low) / 2
        ax.fill(centre + radius * np.cos(turn), radius * np.sin(turn), facecolor="#cfe8dc", edgecolor=sheet.colour(index), linewidth=1.2)
    else:
        ax.axvspan(low, right, color="#cfe8dc", linewidth=0)
        ax.axvline(low, color=sheet.colour(index), linewidth=1.2)
    for side in (1, -1):
        angle = np.radians(phase_deg) * side
        ax.plot([0, np.cos(angle)], [0, np.sin(angle)], color=sheet.INK, linewidth=1.0)
    ax.plot([1], [0], marker="+", markersize=8, markeredgewidth=1.4, color=sheet.INK)
    upper = sheet.written(high) if np.isfinite(high) else "any"
    words = f"α = {sheet.written(alpha)}: gain {sheet.written(low)} to {upper}, ±{sheet.written(phase_deg)}°"
    sheet.note(ax, words, (0.0, 1.0), va="bottom", inside=True, shift=(0, 3))
    half = (right + 0.6) / 2
    ax.set_aspect("equal")
    ax.set_xlim(-0.6, right)
    ax.set_ylim(-half, half)
    sheet.label(ax, "Re f", "Im f", title, pad=15)
    return ax
