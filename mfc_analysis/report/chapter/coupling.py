"""The effect of coupling on independent joints (9.8): decentralised design and coupled arm, and the coupling of the inertia."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis import plots
from mfc_analysis.maths.arrays import Array
from mfc_analysis.plots.figure import without_affixes
from mfc_analysis.report.chapter.arms import decibels
from mfc_analysis.report.document.document import Block, Cell, Column, Figure, Math, Number, Table, written
from mfc_analysis.report.loops.view import View
from mfc_analysis.robots.coupling import relative_gain

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.linearization.decentralised import Decentralised


@lru_cache(maxsize=1)
def _alone(view: View) -> tuple[Decentralised, Margins]:
    """The loop joint by joint, and the margins of the joints."""
    alone = view.lin.decentralised()
    return alone, alone.margins()


def price(view: View) -> str:
    """The effect of coupling on the rightmost pole and on the phase margin that changes most, as text."""
    alone, margins = _alone(view)
    designed, real = float(alone.poles().real.max()), view.evidence.slowest_root().value
    slower = f"the rightmost pole moves from {written(designed)} to {written(real)} 1/s"
    change = view.margins.phase_deg - margins.phase_deg
    if not view.stable or not np.isfinite(change).any():
        return slower
    j = int(np.unravel_index(int(np.nanargmin(change)), change.shape)[1])
    low = float(np.nanmin(change))
    word = (
        f"no phase margin decreases (smallest increase {written(low)}°)"
        if low > 0
        else f"the phase margin of {view.margins.channels[j]} decreases by {written(-low)}°"
    )
    return f"{slower}, {word}"


def coupling_words(view: View) -> str:
    """The effect of coupling in a sentence: each joint alone, and the whole arm."""
    alone, margins = _alone(view)
    designed, real = float(alone.poles().real.max()), view.evidence.slowest_root().value
    low = float(margins.phase_deg.min()) if alone.stable.all() else float("nan")
    if not view.stable:
        return (
            f"Each joint alone is {'stable' if alone.stable.all() else 'unstable'} with its rightmost pole at {written(designed)} 1/s; coupled, the"
            f" arm is unstable, with a pole at {written(real)} 1/s."
        )
    true = float(view.margins.phase_deg.min())
    cost = low - true
    change = f"coupling reduces it by {written(cost)}°" if cost > 0 else f"coupling increases it by {written(-cost)}°"
    return (
        f"The decentralised design has a phase margin of {written(low)}°, the coupled arm {written(true)}°: {change}. The rightmost pole is at"
        f" {written(real)} 1/s instead of {written(designed)} 1/s."
    )


def coupling_numbers(view: View) -> dict[str, object]:
    """The same for the JSON: poles and phase margins of the joints alone and coupled, relative gains."""
    alone, margins = _alone(view)
    return {
        "decentralised_poles": alone.poles()[view.worst.row],
        "decentralised_phase_deg": margins.phase_deg.min(axis=0),
        "coupled_phase_deg": view.margins.phase_deg.min(axis=0),
        "relative_gain": _gain_along(view).max(axis=0),
    }


def coupling_table(view: View) -> Table:
    """Each joint's smallest margins along the path, in the decentralised design and in the coupled arm."""
    alone, m = _alone(view)[1], view.margins
    gain = _gain_along(view)
    rows: list[tuple[Cell, ...]] = []
    for j, name in enumerate(without_affixes(m.channels)):
        with np.errstate(divide="ignore"):
            low = [float(decibels(x.gain_reduction[:, j]).max()) for x in (alone, m)]
        rows.append(
            (
                name,
                *(Number(float(x.phase_deg[:, j].min()), infinite="no crossover", undefined="unstable") for x in (alone, m)),
                *(Number(-x, infinite="unlimited", undefined="unstable") for x in low),
                *(Number(float(x.delay[:, j].min()) * 1e3, infinite="unlimited", undefined="unstable") for x in (alone, m)),
                Number(float(gain[:, j].max())),
            )
        )
    heads = (
        Column("Joint", numeric=False),
        Column("Phase, alone", "°"),
        Column("coupled", "°"),
        Column("Gain down, alone", "dB"),
        Column("coupled", "dB"),
        Column("Delay, alone", "ms"),
        Column("coupled", "ms"),
        Column(("Relative gain ", Math("lambda_(j j)"))),
    )
    return Table(
        "Decentralised design (each joint alone, diagonal of the inertia) and coupled arm: smallest margins of each joint along the path.",
        heads,
        tuple(rows),
    )


def _gain_along(view: View) -> Array:
    """(m, n) relative gain of the plant along the path."""
    return relative_gain(view.loop.robot, view.loop.nominal(view.times).q)


def coupling_figures(view: View) -> tuple[Block, ...]:
    """The coupling of M(q) along the path, and phase margins alone and coupled."""
    gain, names = _gain_along(view), view.margins.channels
    alone = _alone(view)[1]
    i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
    said = f"largest {written(float(gain[i, j]))} ({names[j]}, t = {written(float(view.times[i]), exact=True)} s)"
    panels = [plots.Panel("relative gain [-]", gain)]
    if np.isfinite(view.margins.phase_deg).all() and np.isfinite(alone.phase_deg).all():
        panels.append(plots.Panel("phase margin [deg]", view.margins.phase_deg, beside=alone.phase_deg))
    return (
        Figure(
            partial(plots.traces, view.times, tuple(panels), names, said=("coupled", "joint alone")),
            ("Coupling of the inertia along the path, ", Math("lambda_(j j) = M_(j j) (M^(-1))_(j j)"), f": 1 for a decoupled joint; {said}."),
            f"Relative gain of M(q) of {view.loop.robot.name}: {said}.",
        ),
    )
