"""All loops at a glance: margins as bars against their limits, a row for each loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"PASS": sheet.GOOD, "WATCH": "#7a4b00", "FAIL": sheet.BAD, "DEMO": "#6a3d9a"}  #: of the bars and words
LONGEST = 3.0  #: in limits: longer bars end here
_ROW, _HEAD, _NAME, _WORD, _WIDTH = 0.165, 0.42, 2.45, 0.6, 6.7  # [inch]


def overview(loops: Sequence[str], metrics: Sequence[str], ratio: ArrayLike, words: Sequence[Sequence[str]], marks: Sequence[str]) -> Figure:
    """Bars of m metrics of n loops, in units of their limits: a bar must reach the dashed line at 1.

    Args:
        loops: (n,) names. metrics: (m,) heads, with units. ratio: (n, m) value over limit, or limit over value where it is an upper one; NaN: none.
        words: (n, m) the values as text. marks: (n,) "PASS", "WATCH", "FAIL" or "DEMO".
    """
    from matplotlib.figure import Figure

    values = np.asarray(ratio, float)
    n, m = values.shape
    height = _HEAD + n * _ROW + 0.08
    whole = Figure(figsize=(_WIDTH, height), facecolor="none")
    each = (_WIDTH - _NAME - _WORD) / m
    names = whole.add_axes((0, 0.08 / height, (_NAME + _WORD) / _WIDTH, n * _ROW / height))
    names.set_axis_off()
    names.set(xlim=(0, _NAME + _WORD), ylim=(n, 0))
    for i, (loop, mark) in enumerate(zip(loops, marks, strict=True)):
        names.text(0.02, i + 0.5, shortened(loop), fontsize=sheet.TEXT, va="center")
        names.text(
            _NAME + _WORD - 0.08, i + 0.5, mark, fontsize=sheet.TEXT, va="center", ha="right", color=COLOURS.get(mark, sheet.GREY), fontweight="bold"
        )
    for j, head in enumerate(metrics):
        left = _NAME + _WORD + j * each
        ax = whole.add_axes((left / _WIDTH, 0.08 / height, (each - 0.1) / _WIDTH, n * _ROW / height), facecolor="none")
        shown = np.clip(np.nan_to_num(values[:, j], nan=0.0, posinf=LONGEST, neginf=0.0), 0.0, LONGEST)
        colours = [COLOURS["DEMO"] if mark == "DEMO" else COLOURS["FAIL" if x < 1 else "PASS"] for x, mark in zip(values[:, j], marks, strict=True)]
        ax.barh(np.arange(n) + 0.5, shown, 0.72, color=colours, alpha=0.35, linewidth=0)
        ax.axvline(1.0, color=sheet.LIMIT, linewidth=1.0, linestyle="--")
        ax.set(xlim=(0, LONGEST), ylim=(n, 0), xticks=[], yticks=[])
        for name, spine in ax.spines.items():
            spine.set_visible(name == "left")
            spine.set_linewidth(0.7)
        for i in range(n):
            ax.text(LONGEST - 0.05, i + 0.5, words[i][j], fontsize=sheet.TEXT, va="center", ha="right")
        title, _, unit = head.partition(" [")
        ax.text(
            0.0, -0.35, title.replace(" margin", "").replace("sensitivity ", "") + (f"\n[{unit}" if unit else "\n"), fontsize=sheet.TEXT, va="bottom"
        )
    return whole


def shortened(name: str) -> str:
    """A name that fits beside the bars: the end of a long one is left out."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    def fits(text: str) -> bool:
        return bool(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0] / 72 <= _NAME - 0.02)

    font, end = FontProperties(size=sheet.TEXT), len(name)
    while end > 1 and not fits(name if end == len(name) else name[:end].rstrip() + "…"):
        end -= 1
    return name if end == len(name) else name[:end].rstrip() + "…"
