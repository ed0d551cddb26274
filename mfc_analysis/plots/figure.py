"""Layout of figures: fixed rectangles per kind of figure, colours of joints, reproducible SVG.

``Figure`` without pyplot: no global state; only ``shown`` registers one with pyplot, for ``plt.show()`` and notebooks. Constrained or tight layout
would double the time, so each kind has its axes at fixed positions [inch]; a test checks that no text leaves the sheet.
"""

from __future__ import annotations

import io
import math
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import BadArgument, UnknownName

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure

JOINTS = ("#0072b2", "#c44e00", "#00795a", "#9b3f84", "#7a6200", "#5a4fcf", "#8a5a44", "#3b6470")  #: colours of the joints, the same on every page
LIMIT = "#3d444d"  #: required limits
GOOD, BAD = "#00795a", "#b3261e"
GREY, GRID, SHADE = "#6b7280", "#d5d9de", "#fbeee4"
INK, PAGE = "#000000", "#ffffff"

TEXT = 8.0  #: [pt] of all text, as printed
MINUS = "\N{MINUS SIGN}"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LETTER = 0.09  # [inch] of a title, about
_SHORTEST = 5  # letters of a shortened name in a legend
_DOTS = 150  # per inch on a screen


@dataclass(frozen=True)
class Sheet:
    """A kind of figure: its size and its axes (left, bottom, width, height), in inches from the lower left corner."""

    size: tuple[float, float]
    panels: tuple[tuple[float, float, float, float], ...]


def _stack(
    width: float, count: int, each: float, *, left: float = 0.74, right: float = 0.17, bottom: float = 0.44, top: float = 0.26, gap: float = 0.2
) -> Sheet:
    height = bottom + top + count * each + (count - 1) * gap
    panels = tuple((left, bottom + (count - 1 - i) * (each + gap), width - left - right, each) for i in range(count))
    return Sheet((width, height), panels)


SHEETS: dict[str, Sheet] = {
    "time history": _stack(6.5, 1, 1.7),
    "two histories": _stack(6.5, 2, 1.15),
    "three histories": _stack(6.5, 3, 1.0),
    "four histories": _stack(6.5, 4, 0.95),
    "bode": _stack(3.75, 2, 0.98),
    "nyquist": Sheet((2.75, 2.86), ((0.52, 0.44, 2.11, 2.16),)),
    "pole map": Sheet((2.75, 2.86), ((0.62, 0.44, 2.01, 2.16),)),
    "step": _stack(3.4, 2, 1.1),
    "response": _stack(3.4, 1, 1.9),
    "map": Sheet((3.25, 2.75), ((0.68, 0.46, 2.43, 2.03),)),
    "arm": Sheet((3.1, 3.1), ((0.6, 0.44, 2.38, 2.42),)),
    "disc": Sheet((3.1, 3.26), ((0.56, 0.44, 2.42, 2.42),)),
    "costs": Sheet((6.5, 3.0), ((1.3, 0.46, 5.08, 2.26),)),
    "block": Sheet((6.5, 1.9), ((0.0, 0.0, 6.5, 1.9),)),
}

_SAVING = threading.Lock()  # matplotlib uses global SVG settings while it writes


def colour(index: int) -> str:
    """The colour of joint ``index``; the colours repeat from the ninth joint on."""
    return JOINTS[index % len(JOINTS)]


def panels_for(kind: str) -> tuple[Axes, ...]:
    """The axes of a new sheet of this ``kind``, top first.

    A kind is "time history", "two histories", "three histories", "four histories", "bode", "nyquist", "pole map", "step", "response", "map",
    "arm", "disc", "costs" or "block". Raises ``UnknownName`` for another.
    """
    from matplotlib.figure import Figure

    if kind not in SHEETS:
        raise UnknownName("kind", kind, SHEETS)
    return _laid_out(Figure(figsize=SHEETS[kind].size, facecolor="none"), kind)


def given(ax: object, count: int = 1) -> tuple[Axes, ...]:
    """The axes that a caller draws in: one, or a tuple, list or array of ``count``. Raises BadArgument for anything else."""
    from matplotlib.axes import Axes

    found = tuple(ax) if isinstance(ax, (tuple, list)) else tuple(np.ravel(np.asarray(ax, object)))
    if len(found) != count or not all(isinstance(one, Axes) for one in found):
        got = f"shape ({len(found)},)" if found and all(isinstance(one, Axes) for one in found) else ax
        raise BadArgument("ax", got, "axes of matplotlib, as those of plt.subplots()" if count == 1 else f"a sequence of {count} axes of matplotlib")
    return found


def shown(kind: str, ax: object = None) -> tuple[Axes, ...]:
    """The given axes ``ax``, as many as a sheet of this kind has, or those of a new sheet that is registered with pyplot; top first.

    Raises BadArgument for other axes.
    """
    if ax is not None:
        return given(ax, len(SHEETS[kind].panels))
    from matplotlib import pyplot

    return _laid_out(pyplot.figure(figsize=SHEETS[kind].size, dpi=_DOTS), kind)


def _laid_out(figure: Figure, kind: str) -> tuple[Axes, ...]:
    sheet = SHEETS[kind]
    width, height = sheet.size
    axes = tuple(figure.add_axes((x / width, y / height, w / width, h / height)) for x, y, w, h in sheet.panels)
    for ax in axes:
        _dress(ax)
    return axes


def axes_for(kind: str) -> Axes:
    """The only (or uppermost) axes of a new sheet of this ``kind``, as in ``panels_for``."""
    return panels_for(kind)[0]


def _dress(ax: Axes) -> None:
    ax.set_facecolor("none")
    ax.grid(True, color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=TEXT, length=2.5, width=0.6, pad=2)
    from matplotlib.ticker import FuncFormatter

    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: tick(value)))
    for name, spine in ax.spines.items():
        spine.set_linewidth(0.7)
        spine.set_visible(name in ("left", "bottom"))


def label(ax: Axes, x: str = "", y: str = "", title: str = "", pad: float = 4.0) -> None:
    """Axis names with their units, and a title at the left, ``pad`` [pt] above the axes."""
    if x:
        ax.set_xlabel(x, fontsize=TEXT, labelpad=2)
    if y:
        ax.set_ylabel(y, fontsize=TEXT, labelpad=2)
    if title:
        ax.set_title(title, fontsize=TEXT, fontweight="bold", loc="left", pad=pad)


def hide_times(axes: Sequence[Axes]) -> None:
    """Only the lowest of stacked axes keeps its tick labels."""
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)


def note(
    ax: Axes,
    text: str,
    at: tuple[float, float],
    *,
    color: str = INK,
    ha: str = "left",
    va: str = "center",
    inside: bool = False,
    mixed: bool = False,
    shift: tuple[float, float] = (0.0, 0.0),
    plate: bool = False,
) -> None:
    """A text at data coordinates (``inside``: axes coordinates, 0 to 1; ``mixed``: x of the data, y of the axes), moved by ``shift`` [pt].

    ``plate``: on a plate in the colour of the page, where a curve would run through it.
    """
    box = {"facecolor": PAGE, "edgecolor": "none", "pad": 0.6} if plate else None
    where = ax.transAxes if inside else ax.get_xaxis_transform() if mixed else ax.transData
    ax.annotate(
        text, at, xycoords=where, xytext=shift, textcoords="offset points", fontsize=TEXT, color=color, ha=ha, va=va, annotation_clip=False, bbox=box
    )


def free_note(ax: Axes, text: str, at: tuple[float, float], *, color: str = INK, up: float = 7.0, ha: str = "left") -> None:
    """A text beside a point in data coordinates, where no curve and no other text of these axes runs through it, if there is such a place.

    Tried: above and below the point, at its right and left, each also further away. The limits of the axes must be final.

    Args:
        up: [pt] from the point to the middle of the text in the first place tried; ha: the side tried first ("left": the text is at the right).
    """
    import numpy as np

    points = float(figure_of(ax).dpi) / 72.0
    box, (x, y) = ax.get_window_extent(), ax.transData.transform(at)
    wide, high = 0.62 * TEXT * len(text) * points, 1.2 * TEXT * points
    curves = [_path(line) for line in ax.get_lines()]
    taken = [t.get_window_extent() for t in ax.texts]
    sides = (1, -1) if ha == "left" else (-1, 1)
    best: tuple[float, float, float, str] | None = None
    for step, out in ((1.0, 4.0), (1.9, 4.0), (3.0, 4.0), (1.0, 24.0), (4.5, 4.0), (1.9, 24.0), (1.0, 48.0), (6.0, 4.0), (3.0, 48.0)):
        for rise in (up * step, -up * step, 0.0):
            for side in sides:
                across = out if rise else 6.0 * step
                low = x + side * across * points - (wide if side < 0 else 0.0)
                base = y + rise * points - high / 2
                if low < box.x0 or low + wide > box.x1 + 2 or base < box.y0 or base + high > box.y1 + 2:
                    continue
                inside = [(c[:, 0] > low) & (c[:, 0] < low + wide) & (c[:, 1] > base) & (c[:, 1] < base + high) for c in curves]
                hit: float = sum(int(np.count_nonzero(some)) for some in inside)
                hit += sum(1000 for b in taken if min(b.x1, low + wide) > max(b.x0, low) and min(b.y1, base + high) > max(b.y0, base))
                if best is None or hit < best[0]:
                    best = (hit, side * across, rise, "left" if side > 0 else "right")
    struck, across, rise, side_of = best or (0.0, 4.0 * sides[0], up, ha)
    note(ax, text, at, color=color, ha=side_of, shift=(across, rise), plate=struck > 0)


def _path(line: Any) -> Any:
    """(k, 2) points along a curve in pixels, about two pixels apart; none of marks."""
    import numpy as np

    xy = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
    if len(xy) < 2 or line.get_linestyle() in ("None", ":"):
        return np.zeros((0, 2))
    found = line.get_transform().transform(xy)
    found = found[np.isfinite(found).all(axis=1)]
    if len(found) < 2:
        return np.zeros((0, 2))
    at = np.concatenate(([0.0], np.cumsum(np.minimum(np.hypot(*np.diff(found, axis=0).T), 3e3))))
    fine = np.linspace(0.0, at[-1], int(at[-1] / 2) + 2)
    return np.column_stack([np.interp(fine, at, found[:, k]) for k in range(2)])


def legend(ax: Axes, *, columns: int = 1, where: str = "best", above: bool = False) -> None:
    """A legend without a frame; ``above``: in one line above the axes, right of its title, with shortened names if these remain readable."""
    handles, labels = ax.get_legend_handles_labels()
    if not handles:
        return
    place: dict[str, Any] = {"loc": where}
    if above:
        box, width = ax.get_position(original=True), float(figure_of(ax).get_figwidth())
        room = min(box.x1 * width - 0.18, box.width * width + 0.52)
        room -= _LETTER * len(ax.get_title(loc="left"))
        short = fitting(labels, room)
        fits = sum(map(len, short)) <= _letters(room, len(short))
        above = fits and (short == labels or (len(labels) > 1 and min(map(len, short)) >= min(_SHORTEST, *map(len, labels))))
        labels, columns = (short, len(labels)) if above else ([x.removesuffix("_joint") for x in labels], 1 + (len(labels) > 3))
    if above:
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
    ax.legend(handles, labels, ncols=columns, fontsize=TEXT, frameon=False, handlelength=1.4, columnspacing=0.9, handletextpad=0.4, **place)


def without_prefix(names: Sequence[str]) -> list[str]:
    """Names of joints without what all of them begin with, up to a separator: panda_joint1, panda_joint2 are joint1, joint2.

    A number keeps the word before it (left_joint_1 is joint_1), and a prefix of up to two letters stays (q_elbow, X_e_vx).
    """
    out = [str(name) for name in names]
    if len(out) < 2:
        return out
    common = out[0]
    while not all(name.startswith(common) for name in out):
        common = common[:-1]
    cuts = [i + 1 for i, letter in enumerate(common) if letter in "_-./" and all(name[i + 1 :] for name in out)]
    while cuts and any(name[cuts[-1]].isdigit() for name in out):
        cuts.pop()
    return [name[cuts[-1] :] for name in out] if cuts and sum(map(str.isalnum, common[: cuts[-1]])) > 2 else out


def without_affixes(names: Sequence[str]) -> list[str]:
    """Names of joints without what all of them begin with, and without the ending _joint that all of them have."""
    out = [str(name) for name in names]
    if len(out) > 1 and all(name.endswith("_joint") and len(name) > len("_joint") for name in out):
        out = [name.removesuffix("_joint") for name in out]
    return without_prefix(out)


def fitting(labels: Sequence[str], room: float) -> list[str]:
    """Labels of a legend in one line of ``room`` [inch]: what is common to the names of the joints is removed first, then the ends of the longest.

    If shortened names are no longer unique (LWristRoll, LWristYaw), the middles are removed instead.
    """
    out = [" ".join(str(x).split()) for x in labels]
    letters = _letters(room, len(out))
    if sum(map(len, out)) > letters and sum(x.endswith("_joint") for x in out) > 1:
        out = [x.removesuffix("_joint") for x in out]
    if sum(map(len, out)) > letters:
        out = without_affixes(out)
    sizes = [len(x) for x in out]
    while sum(sizes) > letters and max(sizes) > 3:
        sizes[sizes.index(max(sizes))] -= 1
    ends = [x if len(x) <= size else x[: size - 1] + "…" for x, size in zip(out, sizes, strict=True)]
    if len(set(ends)) == len(set(out)):
        return ends
    return [x if len(x) <= size else f"{x[: size // 2]}…{x[len(x) - (size - 1 - size // 2) :]}" for x, size in zip(out, sizes, strict=True)]


def _letters(room: float, count: int) -> int:
    """Letters that a legend of ``count`` entries has room for in one line of ``room`` [inch]."""
    return int((room - 0.32 * count) / 0.065)


def logarithmic(ax: Axes, which: str) -> None:
    """Makes the axes ``which`` ("x", "y" or "xy") logarithmic, with labels by ``decade``: at decades, at 1, 2 and 5 if only one shows."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    class Decades(LogLocator):
        def tick_values(self, vmin: float, vmax: float) -> Any:
            low, high = sorted((vmin, vmax))
            few = low > 0 and math.floor(math.log10(high) + 1e-9) - math.ceil(math.log10(low) - 1e-9) < 1
            self.set_params(subs=(1.0, 2.0, 5.0) if few else (1.0,))
            return super().tick_values(vmin, vmax)

    for name in which:
        ax.set(**{f"{name}scale": "log"})
        axis = getattr(ax, f"{name}axis")
        axis.set_major_locator(Decades())
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: decade(value)))


def log_grid(ax: Axes, low: float, high: float) -> None:
    """A logarithmic frequency axis with its minor grid as one collection of lines, half the bytes of minor ticks."""
    import numpy as np
    from matplotlib.ticker import LogLocator

    logarithmic(ax, "x")
    ax.set_xlim(low, high)
    ax.xaxis.set_major_locator(LogLocator(10, numticks=8))
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    places = np.outer(decades, np.arange(2, 10)).ravel()
    places = places[(places > low) & (places < high)]
    if places.size and places.size <= 80:
        ax.vlines(places, 0, 1, transform=ax.get_xaxis_transform(), colors=GRID, linewidths=0.3, zorder=0.5)


def written(value: float, digits: int = 3) -> str:
    """A number for a text in a figure."""
    return f"{value:.{digits}g}".replace("-", MINUS)


def tick(value: float) -> str:
    """A tick label without an offset: plain from 0.001 to 99999, else with an exponent."""
    size = abs(value)
    if size < 1e-12 or 1e-3 <= size < 99999.5:
        said = f"{value:.5g}" if size >= 1e-12 else "0"
    else:
        mantissa, power = f"{value:.2e}".split("e")
        said = f"{float(mantissa):g}e{int(power)}"
    return said.replace("-", MINUS)


def empty(ax: Axes, text: str, color: str = INK) -> None:
    """Writes in empty axes why nothing is drawn, and removes the tick labels of the y axis."""
    ax.set_yticks([])
    note(ax, text, (0.5, 0.5), color=color, ha="center", inside=True)


def decade(value: float) -> str:
    """A tick label on a logarithmic or log-symmetric axis: plain to 1000, a power of ten beyond, with its factor where that is not 1."""
    size = abs(value)
    if size == 0.0 or 1e-3 <= size < 2e3:
        return written(value, 4)
    exponent = math.floor(math.log10(size) + 1e-6)
    factor = f"{size / 10.0**exponent:.3g}"
    power = str(exponent).translate(_RAISED)  # a formula would take ten times as long to set
    return f"{MINUS if value < 0 else ''}{'' if factor == '1' else factor + '×'}10{power}"


def figure_of(drawn: Any) -> Figure:
    """The figure of a recipe's result: Axes, several Axes, or a Figure."""
    if isinstance(drawn, (tuple, list)):
        drawn = drawn[0]
    found: Figure = getattr(drawn, "figure", drawn)
    return found


def font_folder() -> str:
    """The folder of the fonts of the figures: those of matplotlib."""
    import matplotlib

    return os.path.join(matplotlib.get_data_path(), "fonts", "ttf")


def settings() -> dict[str, Any]:
    """matplotlib's defaults with the settings of this package, independent of the user's matplotlibrc."""
    import matplotlib

    rc = {k: v for k, v in matplotlib.rcParamsDefault.items() if not k.startswith(("backend", "webagg", "tk.", "macosx", "date."))}
    rc |= {
        "svg.fonttype": "none",
        "svg.hashsalt": "mfc-analysis",
        "font.family": ["DejaVu Sans"],
        "path.simplify": True,
        "path.simplify_threshold": 0.3,
        "axes.unicode_minus": True,
        "axes.titley": 1.0,  # titles have a fixed place too: to look for one takes a tenth of the time
    }
    return rc


def svg(recipe: Any) -> str:
    """A figure as SVG: same input, same bytes. ``recipe``: a callable without arguments, or its result."""
    return svgs([recipe])[0]


def svgs(recipes: Sequence[Any]) -> list[str]:
    """Several figures as SVG, in order, in this process."""
    import matplotlib

    out = []
    with _SAVING, matplotlib.rc_context(settings()):  # pyright: ignore[reportArgumentType]  # any key of rcParams
        for recipe in recipes:
            figure = figure_of(recipe() if callable(recipe) else recipe)
            text = io.StringIO()
            figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
            out.append(text.getvalue())
    return out
