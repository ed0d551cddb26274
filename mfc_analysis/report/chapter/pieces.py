"""Parts shared by several sections: checks of a number against a limit, response figures of one channel, tables of poles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis import plots
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.maths.arrays import Complex
from mfc_analysis.plots.frequency import of_channel
from mfc_analysis.report.document.document import Cell, Column, Figure, Row, Table, written
from mfc_analysis.requirements.line import Line, Status

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.linearization.linearization import Linearization
    from mfc_analysis.loop import ClosedLoop


LYNCH = "Lynch & Park, Modern Robotics, ch. 11"
SICILIANO = "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 8-9"

SLOW = 1 / HORIZON  #: [1/s] poles below this are slow


def at_most(name: str, asked: float, found: float, unit: str = "", where: str = "", when: float | None = None) -> Line:
    """A check that ``found`` is not above ``asked``; a NaN fails."""
    status = Status.PASS if found <= asked else Status.FAIL
    return Line(name, asked, found, unit, asked - found, status, where, when, "≤", "unlimited", "not defined")


def at_least(name: str, asked: float, found: float, unit: str = "", where: str = "", when: float | None = None) -> Line:
    """A check that ``found`` is not below ``asked``; a NaN fails."""
    status = Status.PASS if found >= asked else Status.FAIL
    return Line(name, asked, found, unit, found - asked, status, where, when, "≥", "no limit", "unstable")


def agreement(what: str, found: float, expected: float, percent: float) -> Line:
    """A check that a number differs from its closed form by at most ``percent`` [%] of that."""
    return at_most("deviation from theory", percent, 100 * abs(found - expected) / abs(expected), "%", what)


def verdict_of(stable: bool, drifts: bool = False) -> Status:
    """The status of one side of a comparison: stable, drifting or neither."""
    return Status.PASS if stable else Status.WATCH if drifts else Status.FAIL


def in_words(stable: bool, drifts: bool = False) -> str:
    """'stable', 'drifts' or 'unstable'."""
    return "stable" if stable else "drifts" if drifts else "unstable"


@lru_cache(maxsize=16)
def margins_at(lin: Linearization, point: str) -> Margins:
    """``lin.margins(point)``, once for all that a page says of them."""
    return lin.margins(point)


def response(lin: Linearization, at: str, channel: int, name: str, index: int = 0, span: tuple[float, float] = (1e-1, 1e4)) -> Row:
    """Bode and Nyquist figures of one channel of a linearised loop, with its margins marked."""
    w = np.geomspace(*span, 240)
    here = lin if len(lin) == 1 else lin.again(lin.times[[index]])
    L = frequency_response(here.opened_for(at), w, at, channel)[0, 0]
    found = margins_at(here, at)
    known: dict[str, Any] = dict(of_channel(found, 0, channel))
    peak = float(found.sensitivity_peak[0, channel])
    said = (
        f"phase margin {written(known['phase_margin'], undefined='not defined')} degrees at {written(known['crossover'])} rad/s, "
        f"gain increase {written(known['gain_increase'])}, sensitivity peak {written(peak)}"
    )
    bode = Figure(
        partial(plots.bode, w, L, **known, index=channel), f"{name}: open-loop frequency response at {at!r}.", f"Bode plot of {name}: {said}."
    )
    nyquist = Figure(
        partial(plots.nyquist, w, L, sensitivity_peak=peak, **known, index=channel),
        f"{name}: Nyquist curve and disk of radius 1/Ms.",
        f"Nyquist plot of {name}: {said}.",
    )
    return Row((bode, nyquist))


def pole_map(values: Complex, name: str, path: Complex | None = None) -> Figure:
    """The poles (nx,) in the plane; ``path`` (m, nx): the poles at other operating points."""
    kept = np.asarray(values)[np.abs(values) >= SLOW]
    rightmost = float(kept.real.max()) if kept.size else math.nan
    others = None if path is None else path[np.abs(path) >= SLOW]
    return Figure(
        partial(plots.poles, kept, path=others),
        f"Poles of {name}.",
        f"Pole map of {name}: rightmost pole that is not slow {written(rightmost)} per second.",
    )


def poles_table(rows: Sequence[tuple[str, Complex]], count: int, caption: str) -> Table:
    """One row per loop: its ``count`` slowest poles that are not slow roots, one of each pair."""
    columns = (Column("Loop", numeric=False), *(Column(f"Pole {i + 1}", "1/s") for i in range(count)))
    out: list[tuple[Cell, ...]] = []
    for name, values in rows:
        kept = [complex(p) for p in np.asarray(values) if abs(p) >= SLOW and p.imag >= 0][:count]
        out.append((name, *kept, *("" for _ in range(count - len(kept)))))
    return Table(caption, columns, tuple(out))


def validated(loop: ClosedLoop, time: float) -> dict[str, float]:
    """Linear model compared with nonlinear simulation over ``time`` [s]: model error, range of validity and Taylor order."""
    found = loop.validate(time=time)
    return {"nrmse": found.nrmse, "radius": found.radius, "taylor_order": found.taylor_order}


def slowest(values: Complex) -> complex:
    """The rightmost pole that is not a slow root."""
    kept = np.asarray(values)[np.abs(values) >= SLOW]
    return complex(kept[int(np.argmax(kept.real))])
