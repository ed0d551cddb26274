"""Pole map: symmetric logarithmic axes that show slow and fast poles together, rays of equal damping, the unstable side shaded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def poles(
    values: ArrayLike,
    *,
    damping: float | None = None,
    path: ArrayLike | None = None,
    discrete: bool = False,
    index: int = 0,
    title: str = "Closed-loop poles",
    note: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Poles in the complex plane.

    Args:
        values: (nx,) complex [1/s], or in z. discrete: they are in z, and drawn on linear axes with the unit circle.
        damping: a required damping ratio, drawn as a dashed ray; default: rays of 0.3 and 0.7. path: (m, nx) the poles at other times, in grey.
        note: what the grey points are. index: the joint, for its colour. title: of the figure. ax: to draw in; None: a new sheet.
    """
    s = np.asarray(values, complex).ravel()
    ax = ax if ax is not None else sheet.axes_for("pole map")
    if path is not None:
        others = np.asarray(path, complex).ravel()
        ax.plot(np.real(others), np.imag(others), linestyle="none", marker=".", markersize=1.6, color=sheet.GREY)
    if discrete:
        _unit_circle(ax)
    else:
        _half_plane(ax, np.concatenate((s, np.asarray(path, complex).ravel())) if path is not None else s, damping)
    good = np.abs(s) < 1 if discrete else np.real(s) < 0
    for kept, color in ((good, sheet.colour(index)), (~good, sheet.BAD)):
        ax.plot(np.real(s)[kept], np.imag(s)[kept], linestyle="none", marker="x", markersize=6, markeredgewidth=1.5, color=color)
    unit = "" if discrete else " [1/s]"
    if note:
        sheet.note(ax, note, (0.02, 0.03), color=sheet.GREY, inside=True)
    sheet.label(ax, ("Re z" if discrete else "Re s") + unit, ("Im z" if discrete else "Im s") + unit, title)
    return ax


def _half_plane(ax: Axes, s: np.ndarray, damping: float | None) -> None:
    from matplotlib.ticker import NullLocator, SymmetricalLogLocator

    size = np.abs(s[np.isfinite(s)])
    size = size[size > 0]
    largest = float(size.max()) if size.size else 1.0
    threshold = 10.0 ** np.floor(np.log10(float(np.clip(np.quantile(size, 0.2) if size.size else 0.1, largest * 1e-4, largest / 5))))
    ax.set_xscale("symlog", linthresh=threshold, linscale=0.6)
    ax.set_yscale("symlog", linthresh=threshold, linscale=0.6)
    reach = largest * 2.2
    right = max(threshold * 1.5, 2.2 * float(max(np.real(s).max(initial=0.0), 0.0)))
    ax.set_xlim(-reach, right)
    up = max(2.2 * float(np.abs(np.imag(s)).max(initial=0.0)), threshold * 3)
    ax.set_ylim(-up, up)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=threshold))
        axis.set_minor_locator(NullLocator())
    ax.axvspan(0, right, color=sheet.SHADE, linewidth=0, zorder=0.2)
    ax.axvline(0, color=sheet.INK, linewidth=0.7)
    r = np.concatenate(([0.0], np.geomspace(threshold / 30, reach * 2, 80)))
    rays = [(0.3, ":"), (0.7, ":")] if damping is None else [(damping, "--")]
    for ratio, style in rays:
        for side in (1, -1):
            ax.plot(
                -r * ratio,
                side * r * np.sqrt(1 - min(ratio, 1.0) ** 2),
                color=sheet.LIMIT if damping is not None else sheet.GREY,
                linewidth=0.7,
                linestyle=style,
            )
    _thin(ax)


def _thin(ax: Axes) -> None:
    """At most five tick labels on the real axis: decades are close together in a small map."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    for axis, limits, most in ((ax.xaxis, ax.get_xlim(), 5), (ax.yaxis, ax.get_ylim(), 9)):
        ticks = [t for t in axis.get_majorticklocs() if limits[0] <= t <= limits[1]]
        size = sorted({abs(t) for t in ticks if t})
        step = max(1, -(-len(ticks) // most))
        kept = {x for i, x in enumerate(reversed(size)) if i % step == 0} | {0.0}
        axis.set_major_locator(FixedLocator(sorted(t for t in ticks if abs(t) in kept)))
        axis.set_major_formatter(FuncFormatter(lambda v, _: sheet.decade(v)))


def _unit_circle(ax: Axes) -> None:
    turn = np.linspace(0, 2 * np.pi, 181)
    ax.plot(np.cos(turn), np.sin(turn), color=sheet.INK, linewidth=0.8)
    ax.set_aspect("equal")
    ax.set_xlim(-1.25, 1.25)
    ax.set_ylim(-1.25, 1.25)
