"""What stands in a figure: its words, lines and marks, for the tests of each kind."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex


def words(ax: Axes) -> list[str]:
    """The remarks in the axes."""
    return [text.get_text() for text in ax.texts if text.get_text()]


def lines(ax: Axes, *, style: str | None = None, color: str | None = None) -> list[np.ndarray]:
    """(k, 2) points of each line of this style and colour, in the order of drawing."""
    kept = [x for x in ax.get_lines() if style in (None, x.get_linestyle()) and color in (None, to_hex(x.get_color()))]
    return [np.column_stack([np.asarray(x.get_xdata(), float), np.asarray(x.get_ydata(), float)]) for x in kept]


def marks(ax: Axes, marker: str) -> list[np.ndarray]:
    """(k, 2) points of each series of this marker that is not empty."""
    found = [x for x in ax.get_lines() if x.get_marker() == marker and len(x.get_xdata())]
    return [np.column_stack([np.asarray(x.get_xdata(), float), np.asarray(x.get_ydata(), float)]) for x in found]


def levels(ax: Axes) -> list[float]:
    """Heights of the lines across the whole axes, rising."""
    across = [x for x in ax.get_lines() if list(x.get_xdata()) == [0, 1] and x.get_transform() == ax.get_yaxis_transform(which="grid")]
    return sorted(float(x.get_ydata()[0]) for x in across)


def uprights(ax: Axes) -> list[float]:
    """Places of the lines over the whole height of the axes, rising."""
    up = [x for x in ax.get_lines() if list(x.get_ydata()) == [0, 1] and x.get_transform() == ax.get_xaxis_transform(which="grid")]
    return sorted(float(x.get_xdata()[0]) for x in up)


def legend(ax: Axes) -> list[str]:
    """The words of the legend, none where there is none."""
    found = ax.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]
