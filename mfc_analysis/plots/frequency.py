"""Bode and Nyquist plots of one loop with its margins. The margins are given; they are not computed here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.plots import figure as sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def phase_deg(L: ArrayLike, frequencies: ArrayLike, crossover: float = np.nan) -> Array:
    """Unwrapped phase [deg], shifted by multiples of 360 so that it is within 180 degrees of -180 at the crossover. L: (nf,) complex."""
    w, values = np.asarray(frequencies, float), np.asarray(L, complex)
    out: Array = np.degrees(np.unwrap(np.angle(values)))
    if np.isfinite(crossover) and crossover > 0:
        at = float(np.interp(np.log(crossover), np.log(w), out))
    else:
        at = float(out[np.argmin(np.abs(np.log(np.maximum(np.abs(values), 1e-300))))])
    out -= 360.0 * np.round((at + 180.0) / 360.0)
    return out


def bode(
    frequencies: ArrayLike,
    L: ArrayLike,
    *,
    crossover: float = np.nan,
    phase_margin: float = np.nan,
    gain_increase: float = np.inf,
    gain_reduction: float = 0.0,
    increase_frequency: float | None = None,
    reduction_frequency: float | None = None,
    index: int = 0,
    title: str = "Open-loop response L(jω)",
    axes: tuple[Axes, Axes] | None = None,
) -> tuple[Axes, Axes]:
    """Magnitude and phase of L over frequency [rad/s], with the phase margin at its crossover and both gain margins marked.

    Args:
        frequencies: (nf,) [rad/s].
        L: (nf,) complex.
        crossover: [rad/s], as in ``Margins``.
        phase_margin: [deg].
        gain_increase: factor.
        gain_reduction: factor.
        increase_frequency: [rad/s]; omitted: where the curve crosses the negative real axis.
        reduction_frequency: [rad/s]; omitted: where the curve crosses the negative real axis.
        index: the joint, for its colour.
        title: of the figure.
        axes: to draw in; None: a new sheet.
    """
    w, values = np.asarray(frequencies, float), np.asarray(L, complex)
    upper, lower = axes if axes is not None else sheet.panels_for("bode")
    gain = 20 * np.log10(np.maximum(np.abs(values), 1e-12))
    phase = phase_deg(values, w, crossover)
    for ax, line in ((upper, gain), (lower, phase)):
        sheet.log_grid(ax, w[0], w[-1])
        ax.plot(w, line, color=sheet.colour(index), linewidth=1.3)
    upper.axhline(0, color=sheet.INK, linewidth=0.7)
    lower.axhline(-180, color=sheet.INK, linewidth=0.7)
    _phase_ticks(lower, phase)
    upper.set_ylim(max(gain.min(), -100) - 5, min(gain.max(), 120) + 5)
    if np.isfinite(crossover) and np.isfinite(phase_margin):
        _phase_arrow(upper, lower, w, phase, crossover, phase_margin)
    for factor, where in ((gain_increase, increase_frequency), (gain_reduction, reduction_frequency)):
        _gain_arrow(upper, lower, w, values, factor, where)
    sheet.hide_times((upper, lower))
    sheet.label(upper, "", "|L| [dB]", title)
    sheet.label(lower, "ω [rad/s]", "arg L [deg]")
    return upper, lower


def two_axes(ax: Axes | Sequence[Axes] | None) -> tuple[Axes, Axes]:
    """Axes for ``bode``: those given (``ax``), the upper and lower half of one, or with None those of a new sheet registered with pyplot."""
    if ax is None or np.size(np.asarray(ax, object)) == 2:
        upper, lower = sheet.shown("bode", ax)
        return upper, lower
    (ax,) = sheet.given(ax)
    figure, spec = ax.get_figure(root=False), ax.get_subplotspec()
    assert figure is not None
    if spec is not None:
        halves = spec.subgridspec(2, 1, hspace=0.12)
        ax.set_subplotspec(halves[0])
        return ax, figure.add_subplot(halves[1])
    box = ax.get_position(original=True)
    ax.set_position((box.x0, box.y0 + 0.53 * box.height, box.width, 0.47 * box.height))
    return ax, figure.add_axes((box.x0, box.y0, box.width, 0.47 * box.height))


def _phase_ticks(ax: Axes, phase: Array) -> None:
    from matplotlib.ticker import MultipleLocator

    low, high = max(phase.min(), -380.0), min(phase.max(), 100.0)
    ax.set_ylim(min(low, -190.0) - 15, max(high, -90.0) + 15)
    ax.yaxis.set_major_locator(MultipleLocator(90))


def _phase_arrow(upper: Axes, lower: Axes, w: Array, phase: Array, crossover: float, margin: float) -> None:
    at = float(np.interp(np.log(crossover), np.log(w), phase))
    for ax in (upper, lower):
        ax.axvline(crossover, color=sheet.INK, linewidth=0.8, linestyle="--")
    lower.annotate(
        "", (crossover, at), (crossover, -180), arrowprops={"arrowstyle": "<->", "color": sheet.INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    )
    below = at > -180
    _beside(lower, w, f"PM {sheet.written(margin)}°", crossover, -180, sheet.INK, -7 if below else 7)


def _gain_arrow(upper: Axes, lower: Axes, w: Array, values: Complex, factor: float, where: float | None) -> None:
    if not np.isfinite(factor) or factor <= 0:
        return
    where = _crossing(w, values, factor) if where is None else where
    if where is None or not w[0] <= where <= w[-1]:
        return
    db = 20 * np.log10(factor)
    for ax in (upper, lower):
        ax.axvline(where, color=sheet.INK, linewidth=0.8, linestyle=":")
    upper.annotate("", (where, -db), (where, 0), arrowprops={"arrowstyle": "<->", "color": sheet.INK, "lw": 1.0, "shrinkA": 0, "shrinkB": 0})
    _beside(upper, w, f"GM {sheet.written(db)} dB", where, 0, sheet.INK, 7 if db > 0 else -7, left=db < 0)


def _beside(ax: Axes, w: Array, text: str, x: float, y: float, color: str, up: float, left: bool = False) -> None:
    part = np.log(x / w[0]) / np.log(w[-1] / w[0])
    right = part > 0.75 or (left and part > 0.25)
    sheet.free_note(ax, text, (x, y), color=color, ha="right" if right else "left", up=up)


def _crossing(w: Array, values: Complex, factor: float) -> float | None:
    """The frequency on the drawn curve where L crosses the negative real axis nearest to -1/factor."""
    flips = np.nonzero(np.diff(np.signbit(np.imag(values))) & (np.real(values)[:-1] < 0))[0]
    if flips.size == 0:
        return None
    a, b = np.imag(values)[flips], np.imag(values)[flips + 1]
    part = a / np.where(a == b, 1.0, a - b)
    real = np.real(values)[flips] + part * np.diff(np.real(values))[flips]
    best = int(np.argmin(np.abs(np.log(np.maximum(-real, 1e-300) * factor))))
    if abs(np.log(max(-real[best], 1e-300) * factor)) > 0.25:
        return None
    return float(w[flips[best]] * (w[flips[best] + 1] / w[flips[best]]) ** part[best])


def nyquist(
    frequencies: ArrayLike,
    L: ArrayLike,
    *,
    sensitivity_peak: float = np.nan,
    phase_margin: float = np.nan,
    crossover: float = np.nan,
    gain_increase: float = np.inf,
    gain_reduction: float = 0.0,
    index: int = 0,
    title: str = "Nyquist",
    ax: Axes | None = None,
) -> Axes:
    """L in the complex plane for positive (solid) and negative (dashed) frequencies, the unit circle, and the disk of radius 1/Ms about -1.

    L stays outside that disk. ``sensitivity_peak``: Ms. ``ax``: to draw in; None: a new sheet. Other arguments as ``bode``.
    """
    w, values = np.asarray(frequencies, float), np.asarray(L, complex)
    ax = ax if ax is not None else sheet.axes_for("nyquist")
    turn = np.linspace(0, 2 * np.pi, 181)
    ax.plot(np.cos(turn), np.sin(turn), color=sheet.GREY, linewidth=0.7, linestyle=":")
    near = np.abs(values) < 40
    shown = np.where(near, values, np.nan)
    ax.plot(np.real(shown), np.imag(shown), color=sheet.colour(index), linewidth=1.3)
    ax.plot(np.real(shown), -np.imag(shown), color=sheet.colour(index), linewidth=0.8, linestyle="--")
    ax.plot([-1], [0], marker="+", markersize=7, markeredgewidth=1.4, color=sheet.BAD)
    half = 2.05
    ax.set_aspect("equal")
    ax.set_ylim(-half, half)
    box = ax.get_position(original=True)
    whole = sheet.figure_of(ax)
    ratio = box.width * whole.get_figwidth() / (box.height * whole.get_figheight())
    ax.set_xlim(-0.8 - half * ratio, -0.8 + half * ratio)
    ax.axhline(0, color=sheet.GRID, linewidth=0.8)
    if np.isfinite(sensitivity_peak) and sensitivity_peak > 0:
        radius = 1 / sensitivity_peak
        ax.plot(-1 + radius * np.cos(turn), radius * np.sin(turn), color=sheet.INK, linewidth=1.0)
        sheet.note(ax, f"circle: 1/Ms = {sheet.written(radius)}", (1.0, 0.0), ha="right", va="bottom", inside=True, shift=(-3, 4), plate=True)
    if np.isfinite(crossover) and np.isfinite(phase_margin):
        at = complex(np.interp(np.log(crossover), np.log(w), np.real(values)), np.interp(np.log(crossover), np.log(w), np.imag(values)))
        arc = np.linspace(np.pi, np.pi + np.radians(phase_margin) * (1 if at.imag < 0 else -1), 60)
        ax.plot(np.cos(arc), np.sin(arc), color=sheet.INK, linewidth=1.6)
        ax.plot([at.real], [at.imag], marker="o", markersize=3.5, color=sheet.INK)
    for factor in (gain_increase, gain_reduction):
        if np.isfinite(factor) and factor > 0 and 1 / factor < 4:
            ax.plot([-1 / factor], [0], marker="|", markersize=9, markeredgewidth=1.4, color=sheet.INK)
    sheet.label(ax, "Re L", "Im L", title)
    return ax


def of_channel(found: Any, row: int, channel: int) -> dict[str, float]:
    """Keywords of both ``bode`` and ``nyquist`` from a ``Margins`` (``found``), at one time (``row``) and ``channel``, both from 0."""
    return {
        "crossover": float(found.crossover[row, channel]),
        "phase_margin": float(found.phase_deg[row, channel]),
        "gain_increase": float(found.gain_increase[row, channel]),
        "gain_reduction": float(found.gain_reduction[row, channel]),
    }


def frequencies_of(found: Any, row: int, channel: int) -> dict[str, float]:
    """The frequencies [rad/s] of the gain margins, for ``bode``, from a ``Margins``. Arguments as ``of_channel``."""
    return {name: float(getattr(found, name)[row, channel]) for name in ("increase_frequency", "reduction_frequency")}
