"""The trajectory scrubber: poles and margins at a selectable time, with about 1 kB of plain JavaScript; without scripts, at the worst time.

Two SVG drawings, side by side (stacked on a phone), and the positions of the moving marks as data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.report.document.document import Number, Scrubber, Trace, written

Element = ElementTree.Element

_W1, _W2, _H = 232.0, 248.0, 215.0  # [pt] widths of the two drawings and their height
_MOST = 121  # most times kept for the page
_INK, _GRID, _GREY, _SHADE, _LINE, _DOT, _LIMIT = "#000000", "#d5d9de", "#6b7280", "#fbeee4", "#0072b2", "#c44e00", "#3d444d"


@dataclass(frozen=True)
class Moving:
    """A drawn scrubber: two SVG texts at the worst time, and the data for the script."""

    poles: str
    traces: str
    data: dict[str, Any]


def moving(given: Scrubber) -> Moving:
    """Draws a scrubber."""
    times = np.asarray(given.times, float)
    kept = _kept(times.size, given.worst)
    now = int(np.searchsorted(kept, given.worst))
    poles = _followed(np.asarray(given.poles, complex).reshape(times.size, -1)[kept])
    plane, px, py = _plane(poles, now, given.heading)
    charts, cx, ys = _charts(times[kept], [_only(t, kept) for t in given.traces], now)
    words = [[f"{t.name} {Number(float(v), t.unit)}" for v in np.asarray(t.values, float)[kept]] for t in given.traces]
    said = [f"t = {written(float(t), exact=True)} s: " + ", ".join(w[i] for w in words) for i, t in enumerate(np.round(times[kept], 4))]
    data = {"worst": now, "say": said, "px": _rounded(px), "py": _rounded(py), "cx": _rounded(cx), "cy": _rounded(ys)}
    return Moving(plane, charts, data)


def _kept(count: int, worst: int) -> NDArray[np.intp]:
    step = np.unique(np.round(np.linspace(0, count - 1, min(count, _MOST))).astype(int))
    return np.unique(np.append(step, worst))


def _only(trace: Trace, kept: NDArray[np.intp]) -> tuple[Trace, Array]:
    values = np.asarray(trace.values, float)[kept]
    return trace, np.where(np.isfinite(values), values, np.nan)


def _rounded(values: Array) -> list[Any]:
    flat = [[None if np.isnan(v) else round(float(v), 1) for v in row] for row in np.atleast_2d(values)]
    return flat if values.ndim == 2 else flat[0]


# --- poles -------------------------------------------------------------------------------------------------------


def _followed(poles: Complex) -> Complex:
    """Each column is one pole, matched from time to time by nearest neighbours."""
    from scipy.optimize import linear_sum_assignment

    out = poles.copy()
    for i in range(1, len(out)):
        far = np.abs(out[i - 1][:, None] - out[i][None, :])
        if np.isfinite(far).all():
            out[i] = out[i][linear_sum_assignment(far / (1e-9 + np.abs(out[i - 1])[:, None]))[1]]
    return out


def _plane(poles: Complex, now: int, heading: str) -> tuple[str, Array, Array]:
    size = np.abs(poles[np.isfinite(poles)])
    largest = float(size.max(initial=1e-3))
    slow = float(np.quantile(size, 0.1)) if size.size else 1.0
    unit = 10.0 ** np.floor(np.log10(np.clip(slow, largest * 1e-4, largest / 3)))

    def bent(x: Any) -> Any:
        return np.arcsinh(np.asarray(x, float) / unit)

    left, right, top, bottom = 46.0, _W1 - 8.0, 18.0, _H - 40.0
    reach = bent(largest * 1.8)
    ahead = max(float(bent(poles.real.max(initial=0.0))) * 1.15, 0.12 * reach)

    def at_x(x: Any) -> Any:
        return left + (bent(x) + reach) / (reach + ahead) * (right - left)

    def at_y(y: Any) -> Any:
        return (top + bottom) / 2 - bent(y) / reach * (bottom - top) / 2

    svg = _svg(_W1)
    _rect(svg, float(at_x(0)), top, right - float(at_x(0)), bottom - top, _SHADE)
    decades = [d for d in 10.0 ** np.arange(-9, 9) if unit <= d <= largest * 1.8][-4:]
    for v in (*(-d for d in decades), 0.0, *decades):
        y = float(at_y(v))
        _line(svg, left, y, right, y, _GRID)
        _text(svg, left - 4, y + 3, written(v, exact=True), "end")
        if v <= 0:
            x = float(at_x(v))
            _line(svg, x, top, x, bottom, _GRID if v else _INK)
            if v == 0 or len(decades) <= 3 or decades.index(-v) % 2 == 1:
                _text(svg, x, bottom + 12, written(v, exact=True), "middle")
    px, py = at_x(poles.real), at_y(poles.imag)
    for k in range(poles.shape[1]):
        _path(svg, px[:, k], py[:, k], _GREY, 0.6)
    for k in range(poles.shape[1]):
        x, y = (float(px[now, k]), float(py[now, k])) if np.isfinite(poles[now, k]) else (-99.0, -99.0)
        mark = ElementTree.SubElement(
            svg, "path", {"class": "pole", "d": "M-3.5-3.5 3.5 3.5M-3.5 3.5 3.5-3.5", "transform": f"translate({x:.1f} {y:.1f})"}
        )
        mark.set("style", f"fill: none; stroke: {_LINE}; stroke-width: 1.6")
    _text(svg, left, 11, heading, "start", bold=True)
    _text(svg, (left + right) / 2, bottom + 27, "Re s [1/s], symmetric log scales", "middle")
    _text(svg, 10, (top + bottom) / 2, "Im s [1/s]", "middle", turned=True)
    return _said(svg), px, py


# --- margins -----------------------------------------------------------------------------------------------------


def _charts(times: Array, traces: list[tuple[Trace, Array]], now: int) -> tuple[str, Array, Array]:
    svg = _svg(_W2)
    left, right, bottom = 40.0, _W2 - 12.0, _H - 40.0
    span = times[-1] - times[0] or 1.0
    x = left + (times - times[0]) / span * (right - left)
    count = max(len(traces), 1)
    each = (bottom - 18.0 - 14.0 * (count - 1)) / count
    ys = np.full((len(traces), times.size), np.nan)
    for k, (trace, values) in enumerate(traces):
        top = 18.0 + k * (each + 14.0)
        ys[k] = _chart(svg, trace, values, x, (left, right, top, top + each))
    cursor = ElementTree.SubElement(svg, "path", {"class": "cursor", "d": f"M0 {18.0:.1f}V{bottom:.1f}", "transform": f"translate({x[now]:.1f} 0)"})
    cursor.set("style", f"fill: none; stroke: {_INK}; stroke-width: 0.8")
    for k in range(len(traces)):
        y = ys[k, now] if np.isfinite(ys[k, now]) else -99.0
        dot = ElementTree.SubElement(svg, "circle", {"class": "dot", "r": "3", "transform": f"translate({x[now]:.1f} {y:.1f})"})
        dot.set("style", f"fill: {_DOT}")
    for tick in _ticks(float(times[0]), float(times[-1])):
        _text(svg, left + (tick - times[0]) / span * (right - left), bottom + 12, written(float(tick), exact=True), "middle")
    _text(svg, (left + right) / 2, bottom + 27, "t [s]", "middle")
    return _said(svg), x, ys


def _ticks(low: float, high: float) -> Array:
    """Round numbers from low to high, three to six of them; low where both are the same."""
    if high <= low:
        return np.array([low])
    each = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(each))
    step = power * min(x for x in (1.0, 2.0, 2.5, 5.0, 10.0) if x * power >= each * (1 - 1e-9))
    return np.asarray(np.round(step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1), 12), float)


def _chart(svg: Element, trace: Trace, values: Array, x: Array, box: tuple[float, float, float, float]) -> Array:
    left, right, top, bottom = box
    known = [float(v) for v in values[np.isfinite(values)]] + ([trace.limit] if trace.limit is not None and np.isfinite(trace.limit) else [])
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    pad = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    low, high = low - pad, high + pad
    y = bottom - (values - low) / (high - low) * (bottom - top)
    ElementTree.SubElement(
        svg,
        "rect",
        {
            "x": f"{left:.1f}",
            "y": f"{top:.1f}",
            "width": f"{right - left:.1f}",
            "height": f"{bottom - top:.1f}",
            "style": f"fill: none; stroke: {_GRID}; stroke-width: 0.7",
        },
    )
    for v in (low + pad, high - pad):
        _text(svg, left - 4, bottom - (v - low) / (high - low) * (bottom - top) + 3, written(v), "end")
    if trace.limit is not None and np.isfinite(trace.limit):
        at = bottom - (trace.limit - low) / (high - low) * (bottom - top)
        _line(svg, left, at, right, at, _LIMIT, dashed=True)
    _path(svg, x, y, _LINE, 1.3)
    _text(svg, left + 2, top - 4, f"{trace.name} [{trace.unit}]" if trace.unit else trace.name, "start", bold=True)
    return np.asarray(y)


# --- SVG ---------------------------------------------------------------------------------------------------------


def _svg(width: float) -> Element:
    return Element("svg", {"xmlns": "http://www.w3.org/2000/svg", "width": f"{width:g}pt", "height": f"{_H:g}pt", "viewBox": f"0 0 {width:g} {_H:g}"})


def _said(svg: Element) -> str:
    return ElementTree.tostring(svg, encoding="unicode")


def _rect(svg: Element, x: float, y: float, width: float, height: float, color: str) -> None:
    ElementTree.SubElement(
        svg, "rect", {"x": f"{x:.1f}", "y": f"{y:.1f}", "width": f"{width:.1f}", "height": f"{height:.1f}", "style": f"fill: {color}"}
    )


def _line(svg: Element, x1: float, y1: float, x2: float, y2: float, color: str, dashed: bool = False) -> None:
    style = f"fill: none; stroke: {color}; stroke-width: 0.8" + ("; stroke-dasharray: 4 3" if dashed else "")
    ElementTree.SubElement(svg, "path", {"d": f"M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}", "style": style})


def _path(svg: Element, x: Array, y: Array, color: str, width: float) -> None:
    parts, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if np.isnan(a) or np.isnan(b):
            pen = "M"
            continue
        parts.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    if parts:
        ElementTree.SubElement(
            svg, "path", {"d": "".join(parts), "style": f"fill: none; stroke: {color}; stroke-width: {width}; stroke-linejoin: round"}
        )


def _text(svg: Element, x: float, y: float, text: str, anchor: str, *, bold: bool = False, turned: bool = False) -> None:
    weight = "bold " if bold else ""
    node = ElementTree.SubElement(
        svg, "text", {"x": f"{x:.1f}", "y": f"{y:.1f}", "style": f"font: {weight}8.5px 'DejaVu Sans', sans-serif; text-anchor: {anchor}"}
    )
    if turned:
        node.set("transform", f"rotate(-90 {x:.1f} {y:.1f})")
    node.text = text
