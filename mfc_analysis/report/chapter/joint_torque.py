"""Motion control with torque inputs in joint space, equations 9.8 to 9.13, on the single joint, the planar two-link and the UR5."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mfc_analysis import laws, plots
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.plots.figure import without_affixes
from mfc_analysis.report.chapter.arms import PAYLOAD, Arm, Designs, arms, decibels, per_joint, triple_pole
from mfc_analysis.report.chapter.coupling import coupling_figures, coupling_numbers, coupling_table, coupling_words, price
from mfc_analysis.report.chapter.feedforward import open_loop
from mfc_analysis.report.chapter.pages import loop_page
from mfc_analysis.report.chapter.pieces import at_most
from mfc_analysis.report.document.document import (
    Block,
    Cell,
    Column,
    Equation,
    Fact,
    Figure,
    KeyFacts,
    Math,
    Number,
    Paragraph,
    Section,
    Table,
    written,
)
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.view import View
from mfc_analysis.trajectories.joint import Hold

SIDES = (0.9, 1.1)  #: fractions of the lower gain limit that are simulated


def sections(designs: Designs | None = None, *, full: bool = True) -> tuple[Section, ...]:
    """The sections of 9.8 to 9.13; not ``full``: the arms of an equation share a page, and the figures are those of the UR5."""
    given = designs or Designs()
    return tuple(part(given, full) for part in (independent, open_loop, computed_torque, conditional, inverse_dynamics))


def shared(pages: list[Section], body: tuple[Block, ...], full: bool) -> dict[str, Any]:
    """Body, loops and folding of a section whose arms have a page each, or share one: then with the figures and tables of the last arm."""
    if full:
        return {"body": body, "sections": tuple(pages)}
    figures = Paragraph(f"The figures and tables below are those of the {arms()[-1].name}.")
    return {
        "body": (*body, figures, *(b for b in pages[-1].body if not isinstance(b, KeyFacts))),
        "sections": tuple(replace(page, body=()) for page in pages),
        "folded": True,
    }


# --- 9.8 -------------------------------------------------------------------------------------------------------------------


def independent(designs: Designs, full: bool = True) -> Section:
    """9.8: the decentralised design and the coupled arm, and the effect of the coupling on each margin."""
    views = [(arm, designs.view("9.8", arm)) for arm in arms()]
    pages = []
    for arm, view in views:
        after: tuple[Block, ...] = ()
        if full or last(arm):
            after = (coupling_table(view), *(coupling_figures(view) if full else ())) if arm.robot.n > 1 else (limit_of_ki(view),)
        pages.append(
            loop_page(
                view,
                arm.name,
                path=arm.robot.n > 1,
                brief=not (full or last(arm)),
                compare=full or last(arm),
                origins=designs.origins("9.8", arm),
                finding=coupling_words(view) if arm.robot.n > 1 else "",
                after=after,
                more=coupling_numbers(view),
            )
        )
    costs = [f"{arm.name}: {price(view)}" for arm, view in views if arm.robot.n > 1]
    finding = ("The gains are designed joint by joint on ", Math("M_(j j)"), f", without the coupling. Effect of the coupling: {'; '.join(costs)}.")
    equation = Equation(designs.law("9.8", arms()[0]).typst, "independent joint PID control", "9.8")
    first = () if full else (limit_of_ki(views[0][1]),)
    return Section("9.8 Independent joint PID", finding, key="eq-9-8", **shared(pages, (equation, *first), full))


def last(arm: Arm) -> bool:
    """Whether it is the arm whose figures a shared page has."""
    return arm is arms()[-1]


def limit_of_ki(view: View) -> Block:
    """The closed form of the chapter for one joint: ki < (b + kd)(kp - m g r sin th) / I, checked on both sides by the poles."""
    loop = view.loop
    q = loop.nominal(view.times).q
    stiffness = np.array([loop.robot.gravity(x + 1e-6) - loop.robot.gravity(x - 1e-6) for x in q])[:, 0] / 2e-6
    kp, ki, kd = (float(loop.law.gains()[name].matrix(1)[0, 0]) for name in ("kp", "ki", "kd"))
    limit = float((((float(loop.robot.viscous[0]) + kd) * (kp + stiffness)) / loop.robot.mass(q)[:, 0, 0]).min())
    found = []
    for part in (0.99, 1.01):
        other = replace(loop, law=loop.law.changed(ki=part * limit))
        found.append(bool(other.linearize(view.times).stable.all()))
    facts = (
        Fact("Largest integral gain", Number(limit, "Nm/(rad s)"), "(b + kd)(kp + dg/dq)/I, the smallest along the path"),
        Fact("Used", Number(ki, "Nm/(rad s)"), f"{written(100 * ki / limit)} % of the limit"),
        Fact("At 0.99 and 1.01 times the limit", f"{'stable' if found[0] else 'unstable'}, {'stable' if found[1] else 'unstable'}", "from the poles"),
    )
    return KeyFacts(facts)


# --- 9.10 and 9.12 ---------------------------------------------------------------------------------------------------------


def computed_torque(designs: Designs, full: bool = True) -> Section:
    """9.10 and 9.12: exact and wrong model; the loop opened at the torque and at the command."""
    pages, views = [], []
    for arm in arms():
        view = designs.view("9.10", arm)
        views.append(view)
        wide = arm.robot.n > 1
        pages.append(
            loop_page(
                view,
                arm.name,
                path=wide and full,
                moving=not arm.exact,
                after=(*two_points(view), *(() if arm.exact else wrong_model(designs, arm, view))),
                brief=not (full or last(arm)),
                compare=full or last(arm),
                origins=designs.origins("9.10", arm),
                more=_points_numbers(view),
            )
        )
    equation = Equation(designs.law("9.10", arms()[0]).typst, "computed torque control", "9.10, 9.12")
    polynomial = Equation("e^((3)) + K_d dot.double(e) + K_p dot(e) + K_i e = 0", "error dynamics with an exact model")
    away = max(off_design(designs, arm) for arm in arms() if arm.exact)
    proofs = (at_most("characteristic polynomial = design polynomial", 1e-6, away, "", "9.10, exact model"),)
    finding = _exactness(views[-1])
    return Section("9.10 and 9.12 Computed torque with PID", finding, proofs=proofs, key="eq-9-10", **shared(pages, (equation, polynomial), full))


def off_design(designs: Designs, arm: Arm) -> float:
    """Deviation of the characteristic polynomial along the path from the design polynomial, relative to its largest coefficient."""
    wanted = design_polynomial(designs, arm)
    return float(np.abs(characteristic(designs.loop("9.10", arm).linearize(arm.times).A) - wanted).max() / np.abs(wanted).max())


def _exactness(view: View) -> str:
    """The design with an exact model, and the effect of the unknown payload."""
    arm = arms()[-1]
    root = view.evidence.slowest_root().value
    return (
        "With an exact model, the characteristic polynomial is the design polynomial on every path. With an"
        f" unknown payload of {written(PAYLOAD, exact=True)} kg the UR5's rightmost pole is"
        f" at {written(root)} 1/s instead of the designed {written(-arm.speed, exact=True)} 1/s."
    )


def characteristic(A: Array) -> Array:
    """(m, nx + 1) characteristic polynomials, highest power first."""
    return np.asarray(np.stack([np.poly(a) for a in A]), float)


def design_polynomial(designs: Designs, arm: Arm) -> Array:
    """(3 n + 1,) the n-th power of s^3 + kd s^2 + kp s + ki."""
    found = designs.law("9.10", arm).gains()
    one = np.array([1.0, *(float(found[name].matrix(1)[0, 0]) for name in ("kd", "kp", "ki"))])
    out = np.ones(1)
    for _ in range(arm.robot.n):
        out = np.convolve(out, one)
    return out


def two_points(view: View) -> tuple[Block, ...]:
    """Margins of the loop opened at the torque and at the acceleration command."""
    if not view.stable:
        return ()
    torque, command = view.margins, next(m for m in view.every_margin if m.at == "command")
    rows: list[tuple[Cell, ...]] = []
    for name, m in (("torque", torque), ("command", command)):
        w = m.worst()
        rows.append(
            (
                name,
                Number(w.phase_deg[0], infinite="no crossover"),
                Number(float(-decibels(w.gain_reduction[0])), infinite="unlimited"),
                Number(float(decibels(w.gain_increase[0])), infinite="unlimited"),
                Number(w.delay[0] * 1e3, infinite="unlimited"),
                Number(w.sensitivity_peak[0]),
            )
        )
    columns = (
        Column("Analysis point", numeric=False),
        Column("Phase", "°"),
        Column("Gain down", "dB"),
        Column("Gain up", "dB"),
        Column("Delay", "ms"),
        Column(Math("M_s")),
    )
    gap = float(torque.phase_deg.min() - command.phase_deg.min())
    why = (
        f"At the acceleration command, the open loop is the PID with a double integrator ({written(float(command.phase_deg.min()))}°). At the torque,"
        " it also contains the terms that cancel gravity and coupling: this is the loop through one motor amplifier. Its phase margin differs"
        f" by {written(gap)}°."
    )
    return (Table("The same loop at two analysis points, smallest margins along the path.", columns, tuple(rows)), Paragraph(why))


def _points_numbers(view: View) -> dict[str, object]:
    command = next(m for m in view.every_margin if m.at == "command")
    i = view.worst.row
    return {
        "command_phase_deg": command.phase_deg[i],
        "command_gain_reduction": command.gain_reduction[i],
        "command_sensitivity_peak": command.sensitivity_peak[i],
    }


def wrong_model(designs: Designs, arm: Arm, view: View) -> tuple[Block, ...]:
    """Margins of each joint with the exact model and with the unknown payload."""
    exact = View("exact", ClosedLoop(arm.robot, designs.law("9.10", arm), arm.ref), arm.times)
    return (
        margins_table(
            exact,
            view,
            f"Controller with and without the {written(PAYLOAD, exact=True)} kg in its model: smallest margins of each joint along the path.",
        ),
    )


def margins_table(first: View, second: View, caption: str) -> Table:
    """Margins joint by joint of a loop with the exact model and with the wrong one."""
    a, b = first.margins, second.margins
    rows: list[tuple[Cell, ...]] = []
    for j, name in enumerate(without_affixes(a.channels)):
        rows.append(
            (
                name,
                *(Number(float(x.phase_deg[:, j].min()), undefined="unstable", infinite="no crossover") for x in (a, b)),
                *(Number(float(-decibels(x.gain_reduction[:, j]).max()), undefined="unstable", infinite="unlimited") for x in (a, b)),
                *(Number(float(x.delay[:, j].min()) * 1e3, undefined="unstable", infinite="unlimited") for x in (a, b)),
                *(Number(float(x.sensitivity_peak[:, j].max()), undefined="unstable") for x in (a, b)),
            )
        )
    heads = (
        Column("Joint", numeric=False),
        Column("Phase, known", "°"),
        Column("payload unknown", "°"),
        Column("Gain down, known", "dB"),
        Column("payload unknown", "dB"),
        Column("Delay, known", "ms"),
        Column("payload unknown", "ms"),
        Column("Ms, known"),
        Column("payload unknown"),
    )
    return Table(caption, heads, tuple(rows))


# --- conditional stability ---------------------------------------------------------------------------------------------------


def conditional(designs: Designs, full: bool = True) -> Section:
    """9.12 has a lower gain limit: 1/9 for a triple pole; simulated on both sides."""
    arm = arms()[0]
    w = arm.speed
    kp, ki, kd = triple_pole(w)
    law = laws.ComputedTorque(kp=kp, ki=ki, kd=kd)
    hold = Hold(arm.ref(0.0).q)
    view = View("9.12 triple pole on single joint", ClosedLoop(arm.robot, law, hold), np.zeros(1), at="command")
    low = float(view.margins.gain_reduction[0, 0])
    runs, growth = [], []
    t = np.linspace(0.0, 6.0, 301)
    for side in SIDES:
        f = side * low
        loop = ClosedLoop(arm.robot, laws.ComputedTorque(kp=f * kp, ki=f * ki, kd=f * kd), hold)
        run = loop.simulate(t, initial_error=0.1)
        runs.append(run.error[:, 0])
        growth.append(float(np.abs(run.error[t > 5.0]).max() / np.abs(run.error[t < 1.0]).max()))
    words = ("grows" if growth[0] > 1 else "decays", "grows" if growth[1] > 1 else "decays")
    figure = Figure(
        partial(plots.traces, t, (plots.Panel("error [rad]", np.column_stack(runs)),), tuple(f"{s:g} × {written(low)}" for s in SIDES)),
        f"The nonlinear joint, initial error 0.1 rad, all three gains at {SIDES[0]:g} and {SIDES[1]:g} times the lower limit: the error {words[0]}"
        f" and {words[1]}, respectively.",
        f"Errors against time: amplitude in the last second over that in the first {written(growth[0])} and {written(growth[1])}.",
    )
    finding = (
        f"With kp = 3w², ki = w³, kd = 3w all three poles are at −{written(w, exact=True)} 1/s. The loop is stable only for gains above"
        f" {written(low, 4)} = 1/{written(1 / low, 4)} of these: reducing the gain makes it unstable. In simulation at {SIDES[0]:g} and {SIDES[1]:g}"
        f" times this limit, the error {words[0]} and {words[1]}, respectively."
    )
    return Section(
        "9.12 Conditional stability: a lower gain limit",
        finding,
        (*blocks.frequency_figures(view), figure),
        numbers={
            "gain_reduction": low,
            "theory": 1 / 9,
            "growth_below": growth[0],
            "growth_above": growth[1],
            "phase_deg": float(view.margins.phase_deg[0, 0]),
        },
        sources=("chapter, eq. 9.12",),
        key="eq-9-12",
    )


# --- 9.11 and 9.13 ---------------------------------------------------------------------------------------------------------


def inverse_dynamics(designs: Designs, full: bool = True) -> Section:
    """9.11 and 9.13: the double integrator, and the coupling due to an unknown payload."""
    pages = []
    for arm in arms():
        view = designs.view("9.11", arm)
        after: tuple[Block, ...] = ()
        more: dict[str, object] = {"double_integrator": double_integrator_gap(view)}
        if not arm.exact:
            known = View("exact", ClosedLoop(arm.robot, designs.law("9.11", arm), arm.ref), arm.times)
            after = (
                margins_table(
                    known,
                    view,
                    "Decoupled double integrators (exact model) and the arm with the unknown payload: smallest margins of each joint along the path.",
                ),
            )
            more |= {"exact_phase_deg": known.margins.phase_deg.min(axis=0), "smallest_phase_deg": view.margins.phase_deg.min(axis=0)}
        pages.append(
            loop_page(
                view,
                arm.name,
                after=after,
                more=more,
                brief=not (full or last(arm)),
                compare=full or last(arm),
                origins=designs.origins("9.11", arm),
            )
        )
    gaps = [float(page.numbers["double_integrator"]) for page in pages]
    wrong = pages[-1].numbers
    exact = np.asarray(wrong["exact_phase_deg"], float)
    true = np.asarray(wrong["smallest_phase_deg"], float)
    change = exact - true
    j = int(np.nanargmax(np.abs(change))) if np.isfinite(change).any() else 0
    finding = (
        "From the command, the exact arms are decoupled double integrators 1/s². With the"
        f" unknown payload the open loop of the UR5 differs from them by up to {written(100 * gaps[-1])} %, and the phase margins of its joints,"
        f" {per_joint(exact)}° by design, become {per_joint(true)}° (largest change {written(float(change[j]))}°, {arms()[-1].robot.joint_names[j]})."
    )
    equations = (
        Equation(designs.law("9.11", arms()[0]).typst, "inverse dynamics", "9.11"),
        Equation("dot.double(q) = a_q", "the double integrator", "9.13"),
    )
    proofs = (at_most("loop at the command = PD with a double integrator", 1e-6, max(gaps[:-1]), "", "9.11, exact model"),)
    title = "9.11 and 9.13 Inverse dynamics and the double integrator"
    return Section(title, finding, proofs=proofs, key="eq-9-11", **shared(pages, equations, full))


def double_integrator_gap(view: View) -> float:
    """Largest relative deviation of the loops at the command from the PD with a double integrator, over times, joints and five frequencies."""
    found = view.loop.law.gains()
    n = view.loop.robot.n
    kp, kd = (np.diag(found[name].matrix(n))[:, None] for name in ("kp", "kd"))
    w = view.margins.crossover[0, 0] if np.isfinite(view.margins.crossover[0, 0]) else 10.0
    grid = float(w) * np.array([0.1, 0.3, 1.0, 3.0, 10.0])
    few = view.lin.again(view.times[:: max(1, len(view.times) // 5)])
    L = few.frequency_response(grid, "command")
    ideal = (kp + kd * 1j * grid) / (1j * grid) ** 2
    return float(np.abs(L / ideal - 1).max())


__all__ = ["sections"]
