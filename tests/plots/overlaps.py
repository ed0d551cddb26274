"""What lies on what in a figure: texts on texts, and texts on curves, in pixels of the sheet as it is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

LEAST = 1.0  #: [pixels] by which two boxes may touch
SPARE = 0.18  #: of the height of a box that holds no ink, above and below


def drawn_texts(figure: Figure, monkeypatch: Any) -> list[tuple[str, Bbox, Text]]:
    """Every text that is really drawn: its words, the box of its ink, and itself."""
    seen: list[Text] = []
    plain = Text.draw

    def draw(self: Text, renderer: Any) -> None:
        seen.append(self)
        plain(self, renderer)

    monkeypatch.setattr(Text, "draw", draw)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    monkeypatch.undo()
    out = []
    for text in seen:
        if text.get_visible() and text.get_text().strip():
            box = Text.get_window_extent(text, canvas.get_renderer())
            spare = SPARE * min(box.height, box.width)
            turned = text.get_rotation() % 180 == 90
            out.append((text.get_text(), box.padded(-spare, 0.0) if turned else box.padded(0.0, -spare), text))
    return out


def texts_on_texts(figure: Figure, monkeypatch: Any) -> list[str]:
    """Pairs of texts whose boxes overlap."""
    found = drawn_texts(figure, monkeypatch)
    out = []
    for i, (one, a, _) in enumerate(found):
        for other, b, _ in found[i + 1 :]:
            across, up = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
            if across > LEAST and up > LEAST:
                out.append(f"{one!r} on {other!r}")
    return out


def texts_on_curves(figure: Figure, monkeypatch: Any) -> list[str]:
    """Texts within axes (notes and legends) without a plate that a curve runs through. Straight lines across the axes and dotted ones are guides."""
    found = drawn_texts(figure, monkeypatch)
    out = []
    for ax in figure.axes:
        legend = ax.get_legend()
        inside = {id(t) for t in ax.texts if t.get_bbox_patch() is None} | ({id(t) for t in legend.get_texts()} if legend is not None else set())
        for line in ax.get_lines():
            path = pixels(line)
            if path is None:
                continue
            for words, box, text in found:
                if id(text) in inside and within(box, path).any():
                    out.append(f"{words!r} on a curve")
    return out


def pixels(line: Line2D) -> np.ndarray | None:
    """(k, 2) points along a curve in pixels, a pixel apart, within its axes; None for marks and for straight lines."""
    xy = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
    if len(xy) < 3 or line.get_linestyle() in ("None", "none", "", " ", ":"):
        return None
    points = line.get_transform().transform(xy)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 3:
        return None
    far = np.hypot(*np.diff(points, axis=0).T)
    at = np.concatenate(([0.0], np.cumsum(np.minimum(far, 1e5))))
    fine = np.linspace(0.0, at[-1], int(min(at[-1], 2e4)) + 2)
    path = np.column_stack([np.interp(fine, at, points[:, k]) for k in range(2)])
    assert line.axes is not None
    return path[within(line.axes.bbox, path)]


def within(box: Any, points: np.ndarray) -> np.ndarray:
    """(k,) which points lie in a box."""
    return (points[:, 0] > box.x0) & (points[:, 0] < box.x1) & (points[:, 1] > box.y0) & (points[:, 1] < box.y1)
