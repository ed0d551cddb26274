"""Blocks of a page about one loop: figures with captions, tables and key metrics. Made from a ``View``; nothing is computed twice."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis import plots
from mfc_analysis.analysis.spectrum import root_rows
from mfc_analysis.plots.frequency import of_channel
from mfc_analysis.report.document.document import (
    Block,
    Column,
    Fact,
    Figure,
    KeyFacts,
    Math,
    Number,
    Paragraph,
    Row,
    Scrubber,
    Table,
    Trace,
    written,
)
from mfc_analysis.report.loops.points import smallest
from mfc_analysis.report.loops.view import View, place_words
from mfc_analysis.robots.skeleton import skeleton

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins
    from mfc_analysis.report.loops.step_runs import StepRun
    from mfc_analysis.simulation.validation import Validation


WORTH = 0.2  #: of a limit: a torque above it is drawn with the limit
MOST_TRACES = 121  #: times of the margin histories
POLES, ROOTS = "Closed-loop poles", "Rightmost characteristic roots, dead time included exactly"  #: heads of captions without and with dead time
_LIMITS = ("phase_deg", "gain_increase_db", "gain_reduction_db", "delay", "sensitivity_peak")


# --- numbers ---------------------------------------------------------------------------------------------------------


def sensitivity(view: View) -> KeyFacts:
    """The smallest gain, phase and delay margins and the sensitivity peak over all analysis points, each with point, channel and time."""

    def fact(name: str, metric: str, unit: str, scale: float = 1.0, infinite: str = "unlimited") -> Fact:
        found = view.smallest[metric]
        value = Number(found.value * scale, unit, infinite=infinite, undefined="unstable")
        return Fact(name, value, view.place(found) if np.isfinite(found.value) else "")

    return KeyFacts(
        (
            fact("Gain margin, down", "gain_reduction_db", "dB"),
            fact("Gain margin, up", "gain_increase_db", "dB"),
            fact("Phase margin", "phase_deg", "°", infinite="no crossover"),
            fact("Delay margin", "delay", "ms", 1e3),
            fact("Sensitivity peak", "sensitivity_peak", ""),
        )
    )


def three_numbers(view: View) -> KeyFacts:
    """The three key metrics of a loop: rightmost pole that is not slow, and the smallest phase and delay margin over all analysis points."""
    root, loose = view.evidence.slowest_root(), view.evidence.nothing_else
    value = Number(np.nan if loose else root.value, "1/s", undefined="every root is slow")
    place = "nothing holds the loop" if loose else place_words(root.where, root.when or 0.0, len(view.times))
    without = "no feedback" if not view.fed_back.any() else "unstable"

    def fact(name: str, metric: str, unit: str, scale: float, infinite: str) -> Fact:
        found = view.smallest[metric]
        known = scale if view.stable else np.nan  # margins are not defined if the loop is unstable at any time
        size = Number(known * found.value, unit, infinite=infinite, undefined=without)
        return Fact(name, size, view.place(found) if np.isfinite(size.value) else "")

    return KeyFacts(
        (
            Fact("Rightmost root, dead time included" if view.delayed else "Rightmost pole", value, place),
            fact("Phase margin", "phase_deg", "°", 1.0, "no crossover"),
            fact("Delay margin", "delay", "ms", 1e3, "unlimited"),
        )
    )


def pole_rows(view: View, most: int = 24) -> Table:
    """Poles in the worst case, slowest first, or the rightmost roots with dead time: natural frequency, damping ratio and time constant."""
    i = view.worst.row
    rows = []
    for p in root_rows(view.poles[i], view.evidence.horizon) if view.delayed else view.lin.pole_table(i):
        if p.value.imag < 0 and p.kind != "slow":
            continue
        kind = "" if p.kind == "stable" else p.kind
        rows.append((p.value, Number(p.frequency), Number(p.damping, undefined="–"), Number(p.time_constant, infinite="never decays"), kind))
    order = "rightmost" if view.delayed else "slowest"
    cut = f"; the {order} {most} of {len(rows)}" if len(rows) > most and not view.delayed else ""
    where = "" if len(view.times) == 1 else f" at t = {written(round(view.worst.time, 4), exact=True)} s"
    unit = "z" if view.lin.dt else "1/s"
    name = "Pole" if not view.delayed else "Root"
    columns = (Column(name, unit), Column(Math("omega_n"), "rad/s"), Column(Math("zeta")), Column("Time constant", "s"), Column("", numeric=False))
    return Table(f"{ROOTS if view.delayed else POLES}{where}, {order} first{cut}.", columns, tuple(rows[:most]))


def points_table(view: View) -> Table | None:
    """The smallest margins at each analysis point of the law; None if there is only one."""
    if len(view.every_margin) < 2:
        return None
    by_point = {m.at: smallest([m]) for m in view.every_margin}
    rows = tuple(
        (
            point,
            Number(by_point[point]["gain_reduction_db"].value, infinite="unlimited"),
            Number(by_point[point]["gain_increase_db"].value, infinite="unlimited"),
            Number(by_point[point]["phase_deg"].value, infinite="no crossover"),
            Number(by_point[point]["delay"].value * 1e3, infinite="unlimited"),
            Number(by_point[point]["sensitivity_peak"].value),
        )
        for point in view.lin.opened.points
    )
    columns = (
        Column("Analysis point", numeric=False),
        Column("Gain down", "dB"),
        Column("Gain up", "dB"),
        Column("Phase", "°"),
        Column("Delay", "ms"),
        Column(Math("M_s")),
    )
    return Table("Smallest margins at each analysis point, one loop at a time.", columns, rows)


# --- figures ---------------------------------------------------------------------------------------------------------


def frequency_figures(view: View, at: str | None = None, label: str = "") -> tuple[Block, ...]:
    """Bode and Nyquist plots of the worst case with the margins marked; a sentence if there is no feedback."""
    point = at or view.point
    if not view.fed_back.any():
        return (Paragraph(f"There is no feedback at “{point}”: L = 0, so the loop has no frequency response and no margins."),)
    w = view.worst
    m = next(found for found in view.every_margin if found.at == point)
    k = w.channel if point == view.point or m.channels == view.margins.channels else 0
    grid = view.frequencies()
    L = view.response(grid, point, k)
    if np.abs(L).max() < 1e-9:
        return (Paragraph(f"There is no feedback at “{point}” in {m.channels[k]}: L = 0."),)
    known: dict[str, Any] = dict(of_channel(m, w.row, k))
    ms = float(m.sensitivity_peak[w.row, k])
    where = place_words(m.channels[k], w.time, len(view.times))
    said = margins_words(m, w.row, k) if view.stable else "the closed loop is unstable, so its margins are not defined"
    head = f"{label}: " if label else ""
    bode = Figure(
        partial(plots.bode, grid, L, index=k, **known),
        f"{head}Open-loop response L(jω) at “{point}”, {where}: {said}.",
        f"Bode plot of {view.name} at {point}, {where}: {said}.",
    )
    nyquist = Figure(
        partial(plots.nyquist, grid, L, sensitivity_peak=ms, index=k, **known),
        (
            ("The same open loop. L stays outside the disk about −1 of radius ", Math("1/M_s"), ".")
            if np.isfinite(ms)
            else "The same open loop; −1 is marked."
        ),
        f"Nyquist plot of {view.name}: {'sensitivity peak ' + written(ms) if np.isfinite(ms) else 'the loop is unstable'}.",
    )
    return (Row((bode, nyquist)),)


def margins_words(m: Margins, i: int, k: int) -> str:
    """The margins at one time and channel as text."""
    phase, reduction, increase = float(m.phase_deg[i, k]), float(m.gain_reduction[i, k]), float(m.gain_increase[i, k])
    first = "no crossover" if not np.isfinite(phase) else f"phase margin {Number(phase, '°')} at {Number(float(m.crossover[i, k]), 'rad/s')}"
    low, high = reduction > 0, bool(np.isfinite(increase))
    if not low and not high:
        return f"{first}, stable for any positive gain"
    if not high:
        return f"{first}, stable for gains from {written(reduction)} times the nominal one upwards"
    if not low:
        return f"{first}, stable for gains up to {written(increase)} times the nominal one"
    return f"{first}, stable for gains from {written(reduction)} to {written(increase)} times the nominal one"


def pole_map(view: View) -> Figure:
    """Poles in the worst case; those at the other times in grey."""
    w, found = view.worst, view.poles
    rates = found if view.delayed else view.evidence.spectrum.rates
    slow = found[w.row][np.argmax(rates[w.row].real)] if found.shape[1] else 0
    path = found if len(found) > 1 and np.abs(found - found[:1]).max() > 1e-6 * np.abs(found).max(initial=1e-9) else None
    what = "rightmost" if not view.lin.dt else "outermost"
    title, alt = ("Roots with dead time", "Map of the roots with dead time") if view.delayed else (POLES, "Pole map")
    asked = view.requirements.damping_ratio
    where = "" if len(view.times) == 1 else f" at t = {written(round(w.time, 4), exact=True)} s"
    return Figure(
        partial(plots.poles, found[w.row], damping=asked, path=path, discrete=bool(view.lin.dt), index=w.channel, title=title),
        f"{ROOTS if view.delayed else POLES}{where}" + ("; grey: at the other times." if path is not None else "."),
        f"{alt} of {view.name}{where}: {what} {'root' if view.delayed else 'pole'} {complex_words(complex(slow))};"
        f" {'stable' if view.verdict.line('stable').status == 'PASS' else 'not stable'}.",
    )


def complex_words(z: complex) -> str:
    """A pole as text."""
    return written(z.real) if abs(z.imag) < 1e-9 * max(abs(z), 1e-300) else f"{written(z.real)} ± {written(abs(z.imag))}j"


def step_figure(view: View, run: StepRun) -> Figure:
    """The linear and the nonlinear step response, and the torque or velocity of the joint that works hardest."""
    velocity = view.loop.equations.actuator == "velocity"
    equations = view.loop.equations
    limits = np.array(view.loop.robot.limits.velocity if velocity else view.loop.robot.limits.torque)
    if equations.actuators.limit is not None:
        limits = np.minimum(limits, equations.actuators.limit)
    limit = float(limits[run.joint])
    shown = np.isfinite(limit) and np.abs(run.whole).max(initial=0.0) > WORTH * limit  # a far limit would flatten the curve
    joint = view.loop.robot.joint_names[run.joint]
    quantity = f"{'F' if run.channel.startswith('F_') else 'X' if run.channel.startswith('X_') else 'q'} [{run.unit}]"
    drive = "u" if velocity else "τ"
    unit = view.loop.robot.joint_units[run.joint]
    said = f"step of {written(run.size, exact=True)} {run.unit} in {run.channel}: {step_words(run)}"
    return Figure(
        partial(
            plots.step,
            run.t,
            run.predicted,
            nonlinear=(run.t[: run.nonlinear.size], run.nonlinear),
            torque=(run.t[: run.whole.size], run.whole),
            torque_limit=limit if shown else None,
            target=run.size if run.linear.outcome.name == "SETTLES" else None,
            band=0.02 * run.size if run.linear.outcome.name == "SETTLES" else None,
            index=view.worst.channel,
            quantity=quantity,
            drive=f"{drive} [{drive_unit(unit, velocity)}]",
        ),
        f"A {said}. Below: the {'velocity' if velocity else 'torque'} of {joint}"
        + (
            f"; limit {Number(limit, drive_unit(unit, velocity), exact=True)}{' (dotted)' if shown else ', not reached'}."
            if np.isfinite(limit)
            else "."
        ),
        f"Step response of {view.name}: {said}.",
    )


def drive_unit(unit: str, velocity: bool) -> str:
    """Unit of the torque, force or velocity that drives a joint."""
    return f"{unit}/s" if velocity else "Nm" if unit == "rad" else "N"


def step_words(run: StepRun) -> str:
    """A step response as text."""
    found = run.linear
    if found.outcome.name == "RAMPS":
        first = "the linear response does not settle within the horizon (a slow root integrates it)"
    elif found.outcome.name == "GROWS":
        first = "the linear response grows"
    elif not np.isfinite(found.overshoot):
        first = "the linear response returns to zero"
    else:
        first = (
            f"linear model, step of the reference: rise time {Number(found.rise, 's')}, settling time {Number(found.settling, 's')}, overshoot"
            f" {written(100 * found.overshoot)} %"
        )
    if run.said:
        return f"{first}; the nonlinear simulation stopped: {run.said}"
    return f"{first}; the nonlinear response differs by at most {written(100 * run.misfit)} % of the step"


def history(view: View, most: int = 4) -> Figure | None:
    """Up to ``most`` margins along the path with the required limits; None for a single time or without feedback."""
    if len(view.times) < 2 or not view.fed_back.any():
        return None
    m, asked = view.margins, view.requirements.asked()
    w = m.worst()
    said = str(w) if view.stable else f"unstable at {int((~view.evidence.judged).sum())} of {len(view.times)} times"
    figures = tuple(f for f in ("phase_deg", "gain_reduction_db", "gain_increase_db", "delay", "sensitivity_peak") if _worth(m, f))[:most] or (
        "phase_deg",
    )
    return Figure(
        partial(plots.margin_history, m, {k: v for k, v in asked.items() if k in _LIMITS}, metrics=figures),
        f"Margins along the path at “{view.point}”. Dashed: required limit; ring: worst case.",
        f"Margins of {view.name} against time: {said}.",
    )


def _worth(m: Margins, figure: str) -> bool:
    return bool(np.isfinite(getattr(m, figure)).any())


def scrubber(view: View) -> Scrubber | None:
    """Poles and margins at a selectable time; None for a single time or a discrete loop."""
    m, asked = view.margins, view.requirements.asked()
    if len(view.times) < 2 or view.lin.dt or not view.fed_back.any():
        return None
    traces = []
    for name, unit, values, limit in (
        ("Phase margin", "°", m.phase_deg.min(axis=1), asked.get("phase_deg")),
        ("Gain down", "dB", m.gain_reduction_db.min(axis=1), asked.get("gain_reduction_db")),
        ("Gain up", "dB", m.gain_increase_db.min(axis=1), asked.get("gain_increase_db")),
        ("Peak Ms", "", m.sensitivity_peak.max(axis=1), asked.get("sensitivity_peak")),
    ):
        if np.isfinite(values).any():
            traces.append(Trace(name, unit, values, limit))
    if not traces:
        return None
    said = view.tightest()
    return Scrubber(
        view.times.tolist(),
        view.poles,
        tuple(traces[:3]),
        view.worst.row,
        f"{ROOTS if view.delayed else 'Poles'} (grey: their loci) and the smallest margins at “{view.point}” at one time along the path.",
        f"{'Roots with dead time' if view.delayed else 'Poles'} and margins of {view.name} along the path; {said}.",
        "Roots with dead time" if view.delayed else "Poles",
    )


def arm_figure(view: View) -> Figure:
    """The arm as a stick figure along the path."""
    keep = np.unique(np.append(np.round(np.linspace(0, len(view.times) - 1, min(len(view.times), 60))).astype(int), view.worst.row))
    q = view.loop.nominal(view.times).q[keep]
    origins = skeleton(view.loop.robot, q)
    tool = origins[-1, -1]
    worst = int(np.searchsorted(keep, view.worst.row))
    moving = len(keep) > 1 and np.abs(q - q[0]).max() > 1e-9
    said = (
        f"the tool ends at ({', '.join(written(float(x)) for x in tool)}) m"
        if moving
        else f"the tool is at ({', '.join(written(float(x)) for x in tool)}) m"
    )
    return Figure(
        partial(
            plots.arm,
            origins,
            worst=worst if moving else None,
            worst_time=float(view.worst.time) if moving else None,
            title="Poses along the path" if moving else "Pose",
        ),
        f"{'The arm along its path, the pose of the worst case in colour' if moving else 'The arm in its pose'}; {said}.",
        f"Stick figure of {view.loop.robot.name}: {said}.",
    )


def validation_figure(view: View, found: Validation) -> Figure | None:
    """Linear prediction and nonlinear simulation from an initial error; None if the simulation diverged."""
    if not np.isfinite(found.nonlinear).all() or found.t.size < 2:
        return None
    units = set(view.loop.robot.joint_units)
    unit = units.pop() if len(units) == 1 else "rad, m"
    said = validation_words(found, unit)
    panel = plots.Panel(f"deviation [{unit}]", found.nonlinear, beside=found.linear)
    return Figure(
        partial(plots.traces, found.t, (panel,), view.loop.robot.joint_names, said=("nonlinear", "linear")),
        f"Initial error of {written(found.size, exact=True)} {unit}: {said}.",
        f"Deviations of {view.name}, nonlinear and linear: {said}.",
    )


def validation_words(found: Validation, unit: str = "rad") -> str:
    """The comparison with the nonlinear simulation as text."""
    if np.isnan(found.nrmse):
        return f"no comparison with the nonlinear simulation from the operating point is possible: {found.message}"
    reach = (
        f"all tested initial errors (up to 3 {unit})"
        if np.isinf(found.radius)
        else "none of the tested initial errors"
        if found.radius <= 0
        else f"initial errors up to {written(found.radius)} {unit} in the worst direction"
    )
    order = (
        "the remainder is rounding error (the loop is linear)"
        if np.isinf(found.taylor_order)
        else "a disturbance grows too much in that time for a Taylor order"
        if np.isnan(found.taylor_order)
        else f"the remainder has order {written(found.taylor_order)} in the initial error"
    )
    error = 0.0 if np.isinf(found.taylor_order) else 100 * found.nrmse  # of a linear loop: rounding
    off = f"over {written(found.time, exact=True)} s the error of the linear model is {written(error)} %"
    if np.isinf(found.nrmse):
        off = f"from an initial error of {written(found.size, exact=True)} {unit} the nonlinear simulation does not reach its end ({found.message})"
    return f"{off}; it stays below 5 % for {reach}; {order}"
