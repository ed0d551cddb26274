"""Equation 9.9, torque feedforward without feedback, on the single joint, the planar two-link and the UR5."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mfc_analysis import plots
from mfc_analysis.report.chapter.arms import PAYLOAD, Arm, Designs, arms
from mfc_analysis.report.chapter.force import tiny
from mfc_analysis.report.chapter.pages import loop_page
from mfc_analysis.report.chapter.velocity import ERROR_OF_RUNS
from mfc_analysis.report.document.document import Block, Cell, Column, Equation, Figure, Number, Section, Table, written
from mfc_analysis.report.loops.view import View
from mfc_analysis.simulation.simulation import Simulation

OFFSET, LONG = 0.05, 3.0  #: [rad] initial error; [s] of a run: the path, then rest at its end
COLUMNS = (
    Column("Arm", numeric=False),
    Column("Rightmost pole", "1/s"),
    Column("Doubling time", "s"),
    Column("Error, no initial error", "rad"),
    Column("Error from 0.05 rad", "rad"),
    Column("Growth", "times"),
)


@dataclass(frozen=True, eq=False)
class _Runs:
    """An arm under 9.9, and its runs without and with an initial error."""

    arm: Arm
    view: View
    on: Simulation
    off: Simulation

    @property
    def right(self) -> float:
        """[1/s] the rightmost pole."""
        return float(self.view.evidence.spectrum.rates.real.max())

    @property
    def own(self) -> float:
        """[rad] largest error without an initial one."""
        return float(np.abs(self.on.error).max())

    @property
    def grown(self) -> float:
        """[rad] largest error with one."""
        return float(np.abs(self.off.error).max())


def open_loop(designs: Designs, full: bool = True) -> Section:
    """9.9: feedforward only; the poles are those of the plant."""
    runs = [_runs(designs, arm) for arm in arms()]
    pages = [_page(designs, one, full) for one in runs]
    table = Table(f"Feedforward only, {LONG:g} s: along the path, then at rest at its end.", COLUMNS, tuple(_row(one) for one in runs))
    equation = Equation(designs.law("9.9", arms()[0]).typst, "feedforward torque", "9.9")
    finding = "There is no feedback: the poles are those of the arm, and the error grows where gravity destabilises a link."
    body: tuple[Block, ...] = (equation, table)
    if full:
        return Section("9.9 Torque feedforward: open loop", finding, body, sections=tuple(pages), key="eq-9-9")
    body += tuple(b for b in pages[1].body if isinstance(b, Figure))
    inner = tuple(replace(page, body=()) for page in pages)
    return Section("9.9 Torque feedforward: open loop", finding, body, sections=inner, key="eq-9-9", folded=True)


def _runs(designs: Designs, arm: Arm) -> _Runs:
    view, t = designs.view("9.9", arm), np.linspace(0.0, LONG, 101)
    return _Runs(arm, view, view.loop.simulate(t), view.loop.simulate(t, initial_error=OFFSET))


def _row(one: _Runs) -> tuple[Cell, ...]:
    doubling = float(np.log(2) / one.right) if one.right > 1e-9 else np.inf
    errors = Number(tiny(one.own, ERROR_OF_RUNS)), Number(one.grown), Number(one.grown / OFFSET)
    return (one.arm.name, Number(one.right), Number(doubling, infinite="–"), *errors)


def _page(designs: Designs, one: _Runs, full: bool) -> Section:
    offset, length, payload = (written(x, exact=True) for x in (OFFSET, LONG, PAYLOAD))
    wrong = f"; with an unknown payload of {payload} kg it reaches {written(one.own)} rad even without an initial error."
    said = (
        f"The poles are those of the arm, the rightmost at {written(one.right)} 1/s. With an initial error of {offset} "
        f"rad the largest error in {length} s is {written(one.grown)} rad" + ("." if one.arm.exact else wrong)
    )
    return loop_page(
        one.view,
        one.arm.name,
        shown="open loop",
        frequency=False,
        compare=False,
        finding=said,
        after=(_figure(one),) if full or one.arm is arms()[1] else (),
        origins=designs.origins("9.9", one.arm),
        more={"rightmost": one.right, "error_off_path": one.grown, "error_on_path": one.own},
    )


def _figure(one: _Runs) -> Figure:
    panel = plots.Panel("error [rad]", one.off.error, beside=one.on.error[: len(one.off.t)])
    said = f"initial error {OFFSET:g} rad", "no initial error"
    return Figure(
        partial(plots.traces, one.off.t, (panel,), one.arm.robot.joint_names, said=said),
        f"Open loop: with an initial error of {written(OFFSET, exact=True)} rad the error reaches {written(one.grown)} rad, without it"
        f" {written(tiny(one.own, ERROR_OF_RUNS))} rad.",
        f"Errors of {one.view.name}: up to {written(one.grown)} rad.",
    )
