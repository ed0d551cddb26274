"""A block diagram of the loop with its analysis points; the one in use is filled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TOP, _BOTTOM, _BOX = 1.12, 0.38, 0.52  # [inch] heights of the forward path and of the feedback path, and of a box


def block(
    chain: Sequence[tuple[str, str]],
    *,
    reference: str = "reference",
    output: str = "q, v",
    back: str = "",
    at: str = "",
    inputs: Sequence[tuple[int, str]] = (),
    ax: Axes | None = None,
) -> Axes:
    """A loop: reference, summing junction, the boxes of ``chain`` from left to right, and the feedback path.

    Args:
        chain: (text of a box, name of the analysis point on the wire after it or ""), at most six; a text may have two lines.
        reference, output: words at both ends. back: the analysis point on the feedback path. at: the one in use.
        inputs: (index of a box, text): another input of that box, from above. ax: to draw in; None: a new sheet.

    Raises:
        BadArgument: no box, or more than six.
    """
    if not 1 <= len(chain) <= 6:
        raise BadArgument("chain", len(chain), "one to six boxes")
    ax = ax if ax is not None else sheet.axes_for("block")
    width, height = sheet.SHEETS["block"].size
    ax.set_xlim(0, width)
    ax.set_ylim(0, height)
    ax.set_axis_off()
    left, right = 1.25, width - 0.75
    step = (right - left) / len(chain)
    box = step - 0.34
    _arrow(ax, (0.1, _TOP), (0.93, _TOP))
    sheet.note(ax, reference, (0.1, _TOP + 0.14))
    ax.plot([1.02], [_TOP], marker="o", markersize=13, markerfacecolor="none", markeredgecolor=sheet.INK, markeredgewidth=0.9)
    sheet.note(ax, "−", (1.1, _TOP - 0.2))
    start = 1.11
    for i, (text, point) in enumerate(chain):
        x = left + i * step + 0.06
        _arrow(ax, (start, _TOP), (x, _TOP))
        _box(ax, x, box, text)
        for which, word in inputs:
            if which == i:
                _arrow(ax, (x + box / 2, _TOP + _BOX / 2 + 0.3), (x + box / 2, _TOP + _BOX / 2))
                sheet.note(ax, word, (x + box / 2, _TOP + _BOX / 2 + 0.38), ha="center")
        start = x + box
        if point:
            _point(ax, start + 0.17, _TOP, point, point == at)
    _arrow(ax, (start, _TOP), (width - 0.1, _TOP))
    sheet.note(ax, output, (width - 0.1, _TOP + 0.14), ha="right")
    turn = width - 0.42
    ax.plot([turn, turn, 1.02], [_TOP, _BOTTOM, _BOTTOM], color=sheet.INK, linewidth=0.9)
    _arrow(ax, (1.02, _BOTTOM), (1.02, _TOP - 0.09))
    if back:
        _point(ax, width / 2, _BOTTOM, back, back == at)
    return ax


def _box(ax: Axes, x: float, width: float, text: str) -> None:
    from matplotlib.patches import Rectangle

    ax.add_patch(Rectangle((x, _TOP - _BOX / 2), width, _BOX, facecolor="none", edgecolor=sheet.INK, linewidth=1.0))
    room = max(int(width / 0.0615), 4)
    lines = [line if len(line) <= room else line[: room - 1] + "…" for line in text.split("\n")[:2]]
    sheet.note(ax, "\n".join(lines), (x + width / 2, _TOP), ha="center")


def _arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    ax.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": sheet.INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8})


def _point(ax: Axes, x: float, y: float, name: str, used: bool) -> None:
    color = sheet.BAD if used else sheet.GREY
    ax.plot([x], [y], marker="o", markersize=5.5, markerfacecolor=color if used else "none", markeredgecolor=color, markeredgewidth=1.2)
    sheet.note(ax, name, (x, y - (0.4 if y == _TOP else 0.17)), color=color, ha="center")
