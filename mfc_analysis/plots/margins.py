"""Margins against time: one line per channel, the required limit dashed, the worst case marked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import UnknownName
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_NAMES = {
    "phase_deg": "phase margin [deg]",
    "gain_increase_db": "gain increase [dB]",
    "gain_reduction_db": "gain reduction [dB]",
    "delay": "delay margin [ms]",
    "sensitivity_peak": "sensitivity peak [-]",
}
_TIGHTEST = {"sensitivity_peak": "high"}


def metric_values(found: Any, metric: str) -> Array:
    """One ``metric`` of a ``Margins`` (``found``) in the unit it is drawn in: (m, n). Raises ``UnknownName``."""
    if metric not in _NAMES:
        raise UnknownName("metric", metric, _NAMES)
    with np.errstate(divide="ignore"):
        if metric == "gain_increase_db":
            return np.asarray(20 * np.log10(found.gain_increase))
        if metric == "gain_reduction_db":
            return np.asarray(-20 * np.log10(found.gain_reduction))
    return np.asarray(getattr(found, metric), float) * (1e3 if metric == "delay" else 1.0)


def margins(found: Any, *, metric: str = "phase_deg", asked: float | None = None, title: str = "", ax: Axes | None = None) -> Axes:
    """One metric of a ``Margins`` against time, one line per channel, with the worst value marked.

    Args:
        found: ``times`` (m,) [s], ``channels`` (n,), ``stable`` (m,), and the metric (m, n); NaN where unstable, inf where there
            is no limit (stated, not drawn).
        metric: "phase_deg", "gain_increase_db", "gain_reduction_db", "delay" (drawn in ms, ``asked`` in s) or "sensitivity_peak".
        asked: a limit drawn as a line. title: of the figure. ax: to draw in; None: a new sheet.
    """
    ax = ax if ax is not None else sheet.axes_for("time history")
    _history(ax, found, metric, asked)
    sheet.label(ax, title=title)
    if len(found.channels) > 1 and len(found.times) > 1:
        sheet.legend(ax, above=True)
    return ax


def _history(ax: Axes, found: Any, metric: str, asked: float | None) -> None:
    values = metric_values(found, metric)
    times = np.asarray(found.times, float)
    shown, alone = np.where(np.isfinite(values), values, np.nan), times.size == 1
    across = np.arange(values.shape[1], dtype=float)[None] if alone else np.repeat(times[:, None], values.shape[1], axis=1)
    for j, name in enumerate(sheet.without_affixes(found.channels)):
        if np.isnan(shown[:, j]).all():
            continue
        ax.plot(across[:, j], shown[:, j], color=sheet.colour(j), linewidth=1.3, label=name, marker="o" if alone else None, markersize=4.5)
    if asked is not None and np.isfinite(asked):
        ax.axhline(asked * (1e3 if metric == "delay" else 1.0), color=sheet.LIMIT, linewidth=1.0, linestyle="--", zorder=1.5)
    _unstable(ax, times, np.asarray(found.stable, bool))
    if alone:
        ax.set_xlim(-0.5, values.shape[1] - 0.5)
        room = ax.get_position(original=True).width * float(sheet.figure_of(ax).get_figwidth())
        ax.set_xticks(across[0], sheet.fitting(sheet.without_affixes(found.channels), room - 0.1))
    else:
        ax.set_xlim(times[0], times[-1])
    _worst(ax, across, shown, high=metric in _TIGHTEST)
    if np.isnan(shown).all():
        said = "no limit at any time" if np.isposinf(values).any() else "unstable at every time"
        sheet.empty(ax, said)
    elif not np.isfinite(values[np.asarray(found.stable, bool)]).all():
        sheet.note(ax, "no line: no limit", (0.99, 0.93), color=sheet.GREY, ha="right", inside=True)
    sheet.label(ax, f"t = {sheet.written(times[0])} s" if alone else "t [s]", _NAMES[metric])


def margin_history(
    found: Any,
    asked: Mapping[str, float] | None = None,
    *,
    metrics: tuple[str, ...] | None = None,
    title: str = "",
) -> tuple[Axes, ...]:
    """Several metrics of a ``Margins`` in stacked axes, with their limits.

    Args:
        found: the ``Margins``. asked: limits by the names of ``Requirements``. title: of the figure.
        metrics: one to four of those of ``margins``; default: phase, the tighter side of the gain, delay, sensitivity peak.
    """
    metrics = metrics if metrics is not None else ("phase_deg", _tighter(found), "delay", "sensitivity_peak")
    kinds = {1: "time history", 2: "two histories", 3: "three histories", 4: "four histories"}
    if len(metrics) not in kinds:
        raise UnknownName("metrics", len(metrics), map(str, kinds))
    axes = sheet.panels_for(kinds[len(metrics)])
    for ax, metric in zip(axes, metrics, strict=True):
        _history(ax, found, metric, (asked or {}).get(metric))
        ax.set_ylabel(
            _NAMES[metric].replace(" margin", "").replace("sensitivity peak [-]", "Ms [-]").replace(" increase", " up").replace(" reduction", " down")
        )
    for ax in axes[:-1]:
        ax.set_xlabel("")
    sheet.hide_times(axes)
    sheet.label(axes[0], title=title)
    if len(found.times) > 1:
        sheet.legend(axes[0], columns=8, above=True)
    return axes


def _tighter(found: Any) -> str:
    both = ("gain_increase_db", "gain_reduction_db")
    least = [np.min(v, initial=np.inf, where=np.isfinite(v)) for v in (metric_values(found, name) for name in both)]
    return both[int(least[1] < least[0])]


def _unstable(ax: Axes, times: Array, stable: Bools) -> None:
    if stable.all():
        return
    edges = [float(t) for t in np.concatenate(([times[0]], (times[1:] + times[:-1]) / 2, [times[-1]]))]
    turns = np.flatnonzero(np.diff(np.concatenate(([0], ~stable, [0]))))
    for first, last in turns.reshape(-1, 2):
        ax.axvspan(edges[first], edges[last], color=sheet.SHADE, linewidth=0, zorder=0.2)
        if last - first > 0.08 * times.size and not stable.all() and stable.any():
            sheet.note(ax, "unstable", ((edges[first] + edges[last]) / 2, 0.9), color=sheet.BAD, ha="center", mixed=True, plate=True)


def _worst(ax: Axes, across: Array, values: Array, high: bool) -> None:
    if np.isnan(values).all():
        return
    flat = np.nanargmax(values) if high else np.nanargmin(values)
    i, j = np.unravel_index(int(flat), values.shape)
    at, (low, top) = across[i, j], (across.min(), across.max())
    ax.plot([at], [values[i, j]], marker="o", markersize=6, markerfacecolor="none", markeredgecolor=sheet.BAD, markeredgewidth=1.2)
    right = top > low and at - low > 0.8 * (top - low)
    sheet.free_note(ax, sheet.written(values[i, j]), (at, values[i, j]), color=sheet.BAD, ha="right" if right else "left", up=9)
