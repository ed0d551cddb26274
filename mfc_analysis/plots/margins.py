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
    """One metric of a ``Margins`` in the unit it is drawn in: (m, n). Raises ``UnknownName``."""
    if metric not in _NAMES:
        raise UnknownName("metric", metric, _NAMES)
    with np.errstate(divide="ignore"):
        if metric == "gain_increase_db":
            return np.asarray(20 * np.log10(found.gain_increase))
        if metric == "gain_reduction_db":
            return np.asarray(-20 * np.log10(found.gain_reduction))
    return np.asarray(getattr(found, metric), float) * (1e3 if metric == "delay" else 1.0)


def margins(found: Any, *, metric: str = "phase_deg", asked: float | None = None, ax: Axes | None = None) -> Axes:
    """One metric of a ``Margins`` against time, one line per channel, with the worst value marked.

    Args:
        found: ``times`` (m,) [s], ``channels`` (n,), ``stable`` (m,), and the metric (m, n); NaN where unstable, inf where there
            is no limit (stated, not drawn).
        metric: "phase_deg", "gain_increase_db", "gain_reduction_db", "delay" (drawn in ms, ``asked`` in s) or "sensitivity_peak".
    """
    alone = ax is None
    ax = ax if ax is not None else sheet.axes_for("time history")
    values = metric_values(found, metric)
    times = np.asarray(found.times, float)
    shown = np.where(np.isfinite(values), values, np.nan)
    for j, name in enumerate(found.channels):
        if np.isnan(shown[:, j]).all():
            continue
        ax.plot(times, shown[:, j], color=sheet.colour(j), linewidth=1.3, label=str(name), marker="o" if times.size == 1 else None, markersize=3.5)
    if asked is not None and np.isfinite(asked):
        ax.axhline(asked * (1e3 if metric == "delay" else 1.0), color=sheet.LIMIT, linewidth=1.0, linestyle="--", zorder=1.5)
    _unstable(ax, times, np.asarray(found.stable, bool))
    _worst(ax, times, shown, high=metric in _TIGHTEST)
    if times.size > 1:
        ax.set_xlim(times[0], times[-1])
    else:
        ax.set_xlim(times[0] - 1, times[0] + 1)
        ax.set_xticks([times[0]])
    if np.isnan(shown).all():
        said = "no limit at any time" if np.isposinf(values).any() else "unstable at every time"
        sheet.empty(ax, said)
    elif not np.isfinite(values[np.asarray(found.stable, bool)]).all():
        sheet.note(ax, "no line: no limit", (0.99, 0.93), color=sheet.GREY, ha="right", inside=True)
    sheet.label(ax, "t [s]", _NAMES[metric])
    if alone and len(found.channels) > 1:
        sheet.legend(ax, above=True)
    return ax


def margin_history(
    found: Any,
    asked: Mapping[str, float] | None = None,
    *,
    metrics: tuple[str, ...] | None = None,
    title: str = "",
) -> tuple[Axes, ...]:
    """Several metrics of a ``Margins`` in stacked axes, with the limits of ``asked`` (by the names of ``Requirements``).

    ``metrics``: one to four of those of ``margins``; default: phase, the tighter side of the gain, delay, sensitivity peak.
    """
    metrics = metrics if metrics is not None else ("phase_deg", _tighter(found), "delay", "sensitivity_peak")
    kinds = {1: "time history", 2: "two histories", 3: "three histories", 4: "four histories"}
    if len(metrics) not in kinds:
        raise UnknownName("metrics", len(metrics), map(str, kinds))
    axes = sheet.panels_for(kinds[len(metrics)])
    for ax, metric in zip(axes, metrics, strict=True):
        margins(found, metric=metric, asked=(asked or {}).get(metric), ax=ax)
        ax.set_ylabel(
            _NAMES[metric].replace(" margin", "").replace("sensitivity peak [-]", "Ms [-]").replace(" increase", " up").replace(" reduction", " down")
        )
        ax.set_xlabel("")
    sheet.hide_times(axes)
    sheet.label(axes[-1], "t [s]")
    sheet.label(axes[0], title=title)
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
            sheet.note(ax, "unstable", ((edges[first] + edges[last]) / 2, 0.9), color=sheet.BAD, ha="center", mixed=True)


def _worst(ax: Axes, times: Array, values: Array, high: bool) -> None:
    if np.isnan(values).all():
        return
    flat = np.nanargmax(values) if high else np.nanargmin(values)
    i, j = np.unravel_index(int(flat), values.shape)
    ax.plot([times[i]], [values[i, j]], marker="o", markersize=5, markerfacecolor="none", markeredgecolor=sheet.BAD, markeredgewidth=1.2)
    span = times[-1] - times[0]
    right = span > 0 and (times[i] - times[0]) > 0.8 * span
    sheet.note(
        ax, sheet.written(values[i, j]), (times[i], values[i, j]), color=sheet.BAD, ha="right" if right else "left", shift=(-5 if right else 5, 4)
    )
