"""Where a margin went: a bar for the cost of each imperfection, alone and on top of all the others, and of all together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ALONE, _LAST, _TOGETHER = "#0b6e99", "#9cc9dc", "#6b7280"


def costs(names: Sequence[str], alone: ArrayLike, last: ArrayLike, together: float, *, xlabel: str, title: str = "", ax: Axes | None = None) -> Axes:
    """The costs of f imperfections, such as those of a ``design.Attribution``.

    Args:
        names: (f,). alone: (f,) cost of each on top of the ideal loop; last: (f,) on top of all the others. together: of all of them.
            Positive: worse. What is not finite is written and not drawn.
        xlabel: of the costs, with their unit. title: of the figure. ax: to draw in; None: a new sheet.
    """
    ax = ax if ax is not None else sheet.axes_for("costs")
    first, then = np.asarray(alone, float), np.asarray(last, float)
    f = len(names)
    for values, shift, color, label in ((first, -0.19, _ALONE, "alone"), (then, 0.19, _LAST, "on top of all the others")):
        shown = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
        ax.barh(np.arange(f) + shift, shown, 0.36, color=color, label=label)
    ends = (("sum of those alone", float(first.sum())), ("all together", together))
    ax.barh(f + np.arange(2), [x if np.isfinite(x) else 0.0 for _, x in ends], 0.5, color=_TOGETHER)
    for row, x in (
        [(i - 0.19, x) for i, x in enumerate(first)] + [(i + 0.19, x) for i, x in enumerate(then)] + [(f + i, x) for i, (_, x) in enumerate(ends)]
    ):
        said = sheet.written(float(x)) if np.isfinite(x) else "not defined" if np.isnan(x) else "no limit left" if x > 0 else "no limit"
        ax.annotate(said, (max(x, 0.0) if np.isfinite(x) else 0.0, row), xytext=(3, 0), textcoords="offset points", va="center", fontsize=sheet.TEXT)
    low, high = ax.get_xlim()
    ax.set_xlim(low, high + 0.14 * ((high - low) or 1.0))
    ax.set_ylim(f + 1.6, -0.6)
    ax.set_yticks(range(f + 2), [*names, *(name for name, _ in ends)])
    ax.axvline(0.0, color=sheet.INK, linewidth=0.7)
    sheet.label(ax, xlabel, title=title)
    sheet.legend(ax, columns=2, above=True)
    return ax
