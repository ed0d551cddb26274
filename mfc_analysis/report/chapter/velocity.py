"""Motion control with velocity inputs, equations 9.1 to 9.4, on the single joint, the planar two-link and the UR5."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mfc_analysis import plots
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.arms import NAMES, Arm, Designs, Polynomial, arms, per_joint
from mfc_analysis.report.chapter.force import tiny
from mfc_analysis.report.chapter.pages import loop_page
from mfc_analysis.report.chapter.pieces import agreement
from mfc_analysis.report.document.document import Column, Equation, Figure, Number, Section, Table, written
from mfc_analysis.report.loops.view import View

ERROR_OF_RUNS = 1e-5  #: [rad] error of a simulation; smaller errors are shown as 0
SLOPE, BEND, SETTLED = 0.2, 0.1, 8.0  #: [rad/s] of the ramp, [rad/s^2] of the parabola, [s] after which an error counts as settled
OFFSET, DISTURBANCE = 0.05, 0.01  #: [rad] initial error; [rad/s] velocity disturbance


def sections(designs: Designs | None = None, *, full: bool = True) -> tuple[Section, ...]:
    """The sections of 9.1 to 9.4; not ``full``: one for all four, on one arm, because these laws do not depend on the arm."""
    given = designs or Designs()
    if not full:
        return (summary(given),)
    return (open_loop(given), proportional(given), integral(given), feedforward(given))


def _views(designs: Designs, equation: str) -> list[tuple[Arm, View]]:
    return [(arm, designs.view(equation, arm)) for arm in arms()]


def _equation(designs: Designs, equation: str, alt: str) -> Equation:
    return Equation(designs.law(equation, arms()[0]).typst, alt, equation)


def tracking(view: View) -> float:
    """Largest error [rad] of the nonlinear run along the path, without initial error."""
    return float(np.abs(view.evidence.run.error).max())


def steady(designs: Designs, equation: str, arm: Arm, c1: float, c2: float) -> float:
    """Error [rad] of one joint on a ramp or parabola once it has settled."""
    loop = replace(designs.loop(equation, arm), ref=Polynomial(arm.robot.n, c1, c2))
    run = loop.simulate([0.0, SETTLED], rtol=1e-9, atol=1e-11)
    return float(run.error[-1, 0])


def summary(designs: Designs) -> Section:
    """9.1 to 9.4 on one arm: poles, margins, and errors on a path, a ramp and a parabola."""
    arm = arms()[0]
    views = {equation: designs.view(equation, arm) for equation in ("9.1", "9.2", "9.3", "9.4")}
    rows, pages = [], []
    found: dict[str, dict[str, float]] = {}
    for equation, view in views.items():
        away = {
            "tracking_error": tracking(view),
            "ramp_error": steady(designs, equation, arm, SLOPE, 0.0),
            "parabola_error": steady(designs, equation, arm, 0.0, BEND),
        }
        m = view.margins
        free = not view.fed_back.any()
        rows.append(
            (
                NAMES[equation],
                "slow (0)" if free else Number(view.evidence.slowest_root().value),
                *(Number(math.nan if free else float(x.min()) * k, undefined="no feedback") for x, k in ((m.phase_deg, 1.0), (m.delay, 1e3))),
                *(Number(tiny(x, ERROR_OF_RUNS)) for x in away.values()),
            )
        )
        found[equation] = away | {"phase": float(m.phase_deg.min()), "delay": float(m.delay.min())}
        shown = "open loop" if free else ""
        origins = designs.origins(equation, arm)
        pages.append(loop_page(view, NAMES[equation], shown=shown, compare=not free, brief=True, more=away, origins=origins))
    k = float(designs.law("9.2", arm).gains()["kp"].matrix(1)[0, 0])
    ki = float(designs.law("9.3", arm).gains()["ki"].matrix(1)[0, 0])
    t = np.linspace(0.0, 2.0, 81)
    kept = views["9.1"].loop.simulate(t, initial_error=OFFSET, rtol=1e-9, atol=1e-11).error[-1, 0]
    pushed = views["9.1"].loop.simulate(t, disturbance=DISTURBANCE, rtol=1e-9, atol=1e-11).error[-1, 0]
    table = Table(
        f"The four laws on the {arm.name}: largest error on the path, and error after {written(SETTLED, exact=True)} s on a ramp of {SLOPE} rad/s"
        f" and on a parabola of {BEND} rad/s².",
        (
            Column("Law", numeric=False),
            Column("Rightmost pole", "1/s"),
            Column("Phase margin", "°"),
            Column("Delay margin", "ms"),
            Column("Error on the path", "rad"),
            Column("Ramp", "rad"),
            Column("Parabola", "rad"),
        ),
        tuple(rows),
    )
    finding = (
        "The plant is an integrator in each joint, so these loops are the same on every arm (the full report has all three). 9.1 has no feedback:"
        f" an initial error of {written(OFFSET, exact=True)} rad is still {written(abs(float(kept)))} rad after 2 s, and a disturbance of"
        f" {written(DISTURBANCE, exact=True)} rad/s has become {written(abs(float(pushed)))} rad. With feedback the error at speed v is v/k"
        f" (9.2: {written(SLOPE / k)} rad on the ramp). The integral removes it (9.3: a/ki = {written(BEND / ki)} rad on the parabola is left)."
        f" Feedforward (9.4) removes both without a change of the margins ({written(found['9.4']['phase'])}°)."
    )
    proofs = (
        agreement("9.2, error on the ramp: v/k", found["9.2"]["ramp_error"], SLOPE / k, 1e-3),
        agreement("9.3, error on the parabola: a/ki", found["9.3"]["parabola_error"], BEND / ki, 1e-3),
        agreement("9.2, delay margin: π/(2k)", found["9.2"]["delay"], math.pi / (2 * k), 1e-6),
    )
    equations = tuple(_equation(designs, equation, NAMES[equation]) for equation in ("9.2", "9.4"))
    return Section(
        "Velocity control in joint space: 9.1 to 9.4",
        finding,
        (*equations, table, _compared(designs)),
        proofs=proofs,
        sections=tuple(pages),
        key="velocity",
        folded=True,
    )


def open_loop(designs: Designs) -> Section:
    """9.1: no feedback; the error stays, and a disturbance is integrated."""
    pages, rows = [], []
    for arm, view in _views(designs, "9.1"):
        t = np.linspace(0.0, 2.0, 81)
        kept = view.loop.simulate(t, initial_error=OFFSET, rtol=1e-10, atol=1e-12)
        pushed = view.loop.simulate(t, disturbance=DISTURBANCE, rtol=1e-10, atol=1e-12)
        change = float(np.abs(kept.error[-1] - kept.error[0]).max())
        drift = float(np.abs(pushed.error[-1]).max())
        rows.append((arm.name, arm.robot.n, Number(OFFSET, exact=True), Number(change), Number(drift), Number(DISTURBANCE * 2.0, exact=True)))
        figure = Figure(
            partial(
                plots.traces,
                t,
                (plots.Panel("error [rad]", kept.error[:, 0], beside=np.abs(pushed.error[:, 0])),),
                ("joint 1",),
                said=("initial error", "velocity disturbance"),
            ),
            f"Initial error of {written(OFFSET, exact=True)} rad, and disturbance of {written(DISTURBANCE, exact=True)} rad/s.",
            f"Error of {view.name}: it stays at {OFFSET} rad; a disturbance causes {written(drift)} rad in 2 s.",
        )
        said = (
            f"{arm.robot.n} pole{'s' if arm.robot.n > 1 else ''} at zero: an initial error of {written(OFFSET, exact=True)} rad changes by "
            f"{written(change)} rad in 2 s, and a disturbance of {written(DISTURBANCE, exact=True)} rad/s causes an error of {written(drift)} rad."
        )
        pages.append(
            loop_page(
                view,
                arm.name,
                origins=designs.origins("9.1", arm),
                shown="open loop",
                frequency=False,
                compare=False,
                finding=said,
                after=(figure,) if arm.robot.n == 1 else (),
                more={"error_change": change, "disturbance_error": drift},
            )
        )
    table = Table(
        "Open loop on three arms: the initial error stays, and a disturbance is integrated.",
        (
            Column("Arm", numeric=False),
            Column("Poles at 0"),
            Column("Initial error", "rad"),
            Column("Change", "rad"),
            Column("Disturbed, after 2 s", "rad"),
            Column("d t", "rad"),
        ),
        tuple(rows),
    )
    finding = "Every root is slow, so nothing holds the loops: errors are not corrected, and the loops are not stable."
    return Section(
        "9.1 Velocity feedforward: open loop",
        finding,
        (_equation(designs, "9.1", "velocity feedforward"), table),
        sections=tuple(pages),
        key="eq-9-1",
    )


def proportional(designs: Designs) -> Section:
    """9.2: pole -k, phase margin 90 degrees, delay margin pi / 2k, error v/k on a ramp."""
    pages, rows, lag = [], [], 0.0
    k = float(designs.law("9.2", arms()[0]).gains()["kp"].matrix(1)[0, 0])
    for arm, view in _views(designs, "9.2"):
        lag = steady(designs, "9.2", arm, SLOPE, 0.0)
        m = view.margins
        rows.append(
            (arm.name, Number(tracking(view)), Number(lag), Number(SLOPE / k), Number(float(m.delay.min()) * 1e3), Number(math.pi / (2 * k) * 1e3))
        )
        pages.append(
            loop_page(
                view,
                arm.name,
                origins=designs.origins("9.2", arm),
                frequency=arm.robot.n == 1,
                more={"ramp_error": lag, "ramp_error_theory": SLOPE / k, "delay_theory": math.pi / (2 * k), "tracking_error": tracking(view)},
            )
        )
    table = Table(
        f"P control with k = {written(k, exact=True)} 1/s: simulation and the closed forms v/k and π/(2k).",
        (
            Column("Arm", numeric=False),
            Column("Largest error on the path", "rad"),
            Column(f"Error on a ramp of {SLOPE} rad/s", "rad"),
            Column("v/k", "rad"),
            Column("Delay margin", "ms"),
            Column("π/(2k)", "ms"),
        ),
        tuple(rows),
    )
    finding = (
        f"Each joint has one pole at −{written(k, exact=True)} 1/s and a phase margin of 90° on every arm. "
        f"On a ramp of {SLOPE} rad/s the steady-state error is v/k: {written(lag)} rad."
    )
    return Section(
        "9.2 Proportional velocity control",
        finding,
        (_equation(designs, "9.2", "proportional velocity control"), table),
        sections=tuple(pages),
        key="eq-9-2",
    )


def integral(designs: Designs) -> Section:
    """9.3: s^2 + kp s + ki; error 0 on a ramp, a/ki on a parabola."""
    pages, rows, ramp = [], [], 0.0
    law = designs.law("9.3", arms()[0])
    kp, ki = (float(law.gains()[name].matrix(1)[0, 0]) for name in ("kp", "ki"))
    for arm, view in _views(designs, "9.3"):
        ramp, bend = steady(designs, "9.3", arm, SLOPE, 0.0), steady(designs, "9.3", arm, 0.0, BEND)
        rows.append((arm.name, Number(tracking(view)), Number(ramp), Number(bend), Number(BEND / ki)))
        pages.append(
            loop_page(
                view,
                arm.name,
                origins=designs.origins("9.3", arm),
                frequency=arm.robot.n == 1,
                more={"ramp_error": ramp, "parabola_error": bend, "parabola_theory": BEND / ki, "tracking_error": tracking(view)},
            )
        )
    table = Table(
        f"PI control with kp = {written(kp, exact=True)} 1/s, ki = {written(ki, exact=True)} 1/s²: after {written(SETTLED, exact=True)} s on a ramp"
        f" of {SLOPE} rad/s and a parabola of {BEND} rad/s².",
        (
            Column("Arm", numeric=False),
            Column("Largest error on the path", "rad"),
            Column("Ramp", "rad"),
            Column("Parabola", "rad"),
            Column("a/ki", "rad"),
        ),
        tuple(rows),
    )
    damping = kp / (2 * math.sqrt(ki))
    finding = (
        f"The error polynomial is s² + kp s + ki with damping ratio {written(damping)}. The steady-state error is zero on a ramp "
        f"({written(ramp)} rad) and a/ki = {written(BEND / ki)} rad on a parabola."
    )
    return Section(
        "9.3 Proportional-integral velocity control",
        finding,
        (_equation(designs, "9.3", "proportional-integral velocity control"), table),
        sections=tuple(pages),
        key="eq-9-3",
    )


def feedforward(designs: Designs) -> Section:
    """9.4: e'' + kp e' + ki e = 0 for any q_d; the laws on the same path."""
    pages = []
    worst: dict[str, dict[str, float]] = {}
    for arm, view in _views(designs, "9.4"):
        worst[arm.name] = {"9.4": tracking(view)}
        more = {"tracking_error": worst[arm.name]["9.4"]}
        pages.append(loop_page(view, arm.name, frequency=arm.robot.n == 1, more=more, origins=designs.origins("9.4", arm)))
        for equation in ("9.2", "9.3"):
            worst[arm.name][equation] = tracking(designs.view(equation, arm))
    rows = tuple((name, Number(found["9.2"]), Number(found["9.3"]), Number(found["9.4"])) for name, found in worst.items())
    table = Table(
        "Effect of feedforward: largest error along the same path, without initial error.",
        (Column("Arm", numeric=False), Column("9.2 P", "rad"), Column("9.3 PI", "rad"), Column("9.4 feedforward + PI", "rad")),
        rows,
    )
    first = worst[arms()[0].name]
    figure = _compared(designs)
    gain = first["9.2"] / max(first["9.4"], 1e-300)
    said = "more than a million times" if gain > 1e6 else f"{written(gain)} times"
    finding = (
        f"The error equation does not depend on the path. On the single joint the error is {said} smaller than under 9.2 "
        f"({written(first['9.4'])} against"
        f" {written(first['9.2'])} rad). The margins are those of 9.3 ({per_joint(_phase(designs))}°) because feedforward is not in the loop."
    )
    return Section(
        "9.4 Feedforward and proportional-integral velocity control",
        finding,
        (_equation(designs, "9.4", "feedforward and PI velocity control"), table, figure),
        sections=tuple(pages),
        key="eq-9-4",
    )


def _phase(designs: Designs) -> Array:
    return np.asarray(designs.view("9.4", arms()[0]).margins.phase_deg)


def _compared(designs: Designs) -> Figure:
    arm = arms()[0]
    runs: dict[str, Any] = {e: designs.loop(e, arm).simulate(np.linspace(0.0, 4.0, 161)) for e in ("9.2", "9.3", "9.4")}
    errors = np.column_stack([run.error[:, 0] for run in runs.values()])
    peaks = ", ".join(f"{e} {written(tiny(float(np.abs(x).max()), ERROR_OF_RUNS))} rad" for e, x in zip(runs, errors.T, strict=True))
    return Figure(
        partial(plots.traces, np.linspace(0.0, 4.0, 161), (plots.Panel("error [rad]", errors),), tuple(runs)),
        f"Error of the single joint on its path under three laws: at most {peaks}.",
        f"Errors against time: at most {peaks}.",
    )
