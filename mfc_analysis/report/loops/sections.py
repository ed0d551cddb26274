"""The sections of a loop's report, from a ``View``: margins, poles, path, step, validity, pose, after the loop as it was given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis import plots
from mfc_analysis.errors import MfcError
from mfc_analysis.report.document.document import (
    Block,
    Bullets,
    Column,
    Fact,
    Figure,
    KeyFacts,
    Number,
    Paragraph,
    Row,
    Section,
    Table,
    written,
)
from mfc_analysis.report.loops import blocks
from mfc_analysis.report.loops.parameters import the_loop
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.report.loops.step_runs import GROWTH, step_run
from mfc_analysis.report.loops.view import View, place_words
from mfc_analysis.requirements.line import Status

if TYPE_CHECKING:
    from mfc_analysis.simulation.validation import Validation


VALIDATED, SHORTEST = 1.0, 0.1  #: [s] longest comparison with the nonlinear loop, and the shortest one if a mode is lightly damped
SEGMENTS, PERIODS, RINGS = 60, 5.0, 0.2  #: samples or dead times; periods of the fastest mode whose damping ratio is below ...


def loop_section(view: View) -> Section:
    """All sections about one loop in order: requirements, the loop, margins, poles, step response, validity, pose."""
    found = validated(view)
    inner = [
        the_loop(view),
        frequency_section(view),
        pole_section(view),
        opinion_section(view),
        *path_section(view),
        time_section(view),
        validity_section(view, found),
        *pose_section(view),
    ]
    return Section(
        view.name,
        view.summary(),
        tuple(_notes(view)),
        view.checks,
        numbers=numbers(view, found),
        sources=view.loop.law.cited(),
        sections=tuple(inner),
        loop=view.name,
    )


def numbers(view: View, found: Validation | None = None) -> dict[str, Any]:
    """The numbers behind the pages, for JSON."""
    m, i = view.margins, view.worst.row
    w = view.worst
    out: dict[str, Any] = {
        "equation": view.loop.law.equation,
        "form": view.loop.law.chosen_form,
        "at": view.point,
        "times": view.times,
        "stable": view.lin.stable,
        "neutral": view.lin.neutral,
        "drifts": view.lin.drifts,
        "worst": {"time": w.time, "channel": w.name},
        "smallest": {name: asdict(found) for name, found in view.smallest.items()},
        "poles_without_dead_time" if view.delayed else "poles": view.evidence.spectrum.poles[i],
        **({"delay_roots": view.poles[i]} if view.delayed else {}),
        "channels": m.channels,
        "phase_deg": m.phase_deg[i],
        "crossover": m.crossover[i],
        "gain_reduction": m.gain_reduction[i],
        "gain_increase": m.gain_increase[i],
        "delay": m.delay[i],
        "sensitivity_peak": m.sensitivity_peak[i],
        "gains": {name: np.asarray(g.array) for name, g in view.loop.law.gains().items() if g},
        "largest_residual": float(np.abs(view.lin.residual).max(initial=0.0)),
        KEY: record(view.loop, view.times, view.point),
    }
    if found is not None:
        direction = dict(zip(view.loop.equations.state_names, found.direction, strict=True))
        out["validation"] = {
            "taylor_order": found.taylor_order,
            "nrmse": found.nrmse,
            "radius": found.radius,
            "size": found.size,
            "direction": direction,
        }
    return out


def validated(view: View, time: float = VALIDATED) -> Validation | None:
    """The comparison with the nonlinear loop over at most ``time`` [s]; None if the law cannot start from the operating point.

    It takes about sixteen simulations, so the time is shorter if a simulation is slow: at most ``SEGMENTS`` samples or dead times,
    ``PERIODS`` periods of the fastest lightly damped mode, and ``GROWTH`` time constants of an unstable loop.
    """
    hardware = view.loop.equations.hardware
    grain = min((float(x) for x in (hardware.sample_time, hardware.command_delay, hardware.force_delay) if x), default=np.inf)
    roots = view.evidence.roots[0][view.worst.row]
    ringing = np.abs(roots)[np.isfinite(roots) & (np.abs(roots.real) < RINGS * np.abs(roots))].max(initial=0.0)
    span = min(time, SEGMENTS * grain, max(PERIODS * 2 * np.pi / ringing, SHORTEST) if ringing else np.inf)
    if view.growth > 0:
        span = min(span, max(GROWTH / view.growth, 0.01))
    try:
        return view.loop.validate(view.calm(float(span)))
    except MfcError:
        return None


def _notes(view: View) -> list[Block]:
    notes = [f"{line.label}: {line.note}" for line in view.verdict.lines if line.note and not line.note.startswith("unstable")]  # in the finding
    said = [*notes, *view.verdict.notes]
    out: list[Block] = [Bullets(tuple(x[:1].upper() + x[1:] + "." for x in said))] if said else []
    if not view.requirements.asked():
        out.append(Paragraph("Only stability is required of this loop. Further requirements (margins, damping, settling, ...) would be listed here."))
    return out


# --- margins, poles, path -------------------------------------------------------------------------------------------------


def frequency_section(view: View) -> Section:
    """Bode and Nyquist plots of the worst case, the smallest margins, and those at every analysis point."""
    body: list[Block] = []
    if view.stable and view.fed_back.any():
        body.append(blocks.sensitivity(view))
    body += blocks.frequency_figures(view)
    table = blocks.points_table(view) if view.stable and view.fed_back.any() else None
    if table is not None:
        body.append(table)
    more: dict[str, Any] = {}
    if view.stable and view.fed_back.sum() > 1:
        block, more = disk_block(view)
        body += block
    finding = view.tightest()
    return Section("Stability margins", finding[:1].upper() + finding[1:] + ".", tuple(body), numbers=more)


def disk_block(view: View) -> tuple[tuple[Block, ...], dict[str, Any]]:
    """The disk margin in the worst case: all channels varied at once."""
    one = view.lin.again(view.times[view.worst.row : view.worst.row + 1])
    found = one.disk_margin(view.point)
    alpha = float(found.alpha[0])
    if not np.isfinite(alpha):
        return (), {}
    note = "all channels at once, independently"
    facts = KeyFacts(
        (
            Fact(
                "Disk margin α",
                Number(alpha),
                f"{found.bound.name.lower()}; at {Number(float(found.frequency[0]), 'rad/s', infinite='no frequency')}",
            ),
            Fact("Simultaneous gain variation", Number(float(found.gain_db[0]), "dB", sign="±", infinite="unlimited"), note),
            Fact("Simultaneous phase variation", Number(float(found.phase_deg[0]), "°", sign="±"), note),
        )
    )
    return (facts,), {"disk_margin": alpha, "disk_frequency": float(found.frequency[0])}


def pole_section(view: View) -> Section:
    """Pole map and table, slowest first; with dead time the rightmost characteristic roots instead."""
    root = view.evidence.slowest_root()
    line = view.verdict.line("stable")
    if np.isneginf(root.value) or np.isnan(root.value):
        finding = "Every root is slow: " + (line.note or "no error decays") + "."
    elif view.evidence.unstable:
        finding = f"Not stable{' (dead time included)' if view.delayed else ''}: {view.evidence.unstable}."
    else:
        what = "root that is not slow, dead time included," if view.delayed else "fast pole"
        finding = f"The rightmost {what} is at {Number(root.value, '1/s')} ({root.where}, t = {written(root.when or 0.0, exact=True)} s)."
    body: list[Block] = [Row((blocks.pole_map(view),)), blocks.pole_rows(view)]
    numbers: dict[str, Any] = {}
    if view.delayed:
        numbers["delay_roots"] = view.poles[view.worst.row]
    return Section("Poles", finding, tuple(body), numbers=numbers)


def opinion_section(view: View) -> Section:
    """The figures of python-control for the loop in its worst case, beside ours, and why they differ where they do."""
    w = view.worst
    found = view.lin.second_opinion(w.row, view.point, w.channel)
    words = {"AGREES": "none", "WATCH": "WATCH: no known reason"}
    rows = tuple(
        (c.name, Number(c.ours, undefined="–"), Number(c.theirs, undefined="–"), c.function, c.why or words[c.judgement.name])
        for c in found.comparisons
    )
    heads = (
        Column("Metric", numeric=False),
        Column("Here"),
        Column("python-control"),
        *(Column(x, numeric=False) for x in ("Its function", "Difference")),
    )
    where = place_words(w.name, w.time, len(view.times))
    table = Table(f"The same model at “{view.point}”, {where}, by python-control {found.version}.", heads, rows)
    agree, watch = sum(not c.why and c not in found.watch for c in found.comparisons), len(found.watch)
    said = f"{agree} of {len(rows)} metrics agree, {len(rows) - agree - watch} differ for a known reason"
    finding = f"{said}; {f'{watch} differ without one: WATCH' if watch else 'none differs without one'}."
    return Section("A second opinion by python-control", finding, (table,), numbers={"second_opinion_watch": [c.name for c in found.watch]})


def path_section(view: View) -> Sequence[Section]:
    """Margins along the path and the scrubber."""
    figure, moving = blocks.history(view), blocks.scrubber(view)
    if figure is None:
        return ()
    body: list[Block] = [figure]
    if moving is not None:
        body.append(moving)
    m = view.margins
    if not view.stable:
        bad = np.flatnonzero(~view.evidence.judged)
        finding = f"Unstable at {bad.size} of {len(view.times)} times, first at t = {written(float(view.times[bad[0]]), exact=True)} s."
        finding += f" The rightmost root: {view.evidence.unstable}." if view.evidence.unstable else ""
    elif np.isfinite(m.phase_deg).any():
        low, high = float(np.nanmin(m.phase_deg)), float(np.nanmax(np.where(np.isfinite(m.phase_deg), m.phase_deg, np.nan)))
        finding = (
            f"Over {len(view.times)} times and {len(m.channels)} channels the phase margin lies between {Number(low, '°')} and {Number(high, '°')}."
        )
    else:
        finding = "No channel has a crossover at any time."
    return (Section("Along the path", finding, tuple(body)),)


# --- time ------------------------------------------------------------------------------------------------------------------


def time_section(view: View) -> Section:
    """Linear and nonlinear step response; a free response if there is no feedback."""
    run = step_run(view)
    if run is None:
        return _free_run(view)
    numbers = {
        "channel": run.channel,
        "size": run.size,
        "step": "reference",
        "rise": run.linear.rise,
        "settling": run.linear.settling,
        "overshoot": run.linear.overshoot,
        "steady_state": run.linear.steady_state,
        "misfit": run.misfit,
        "outcome": run.linear.outcome.value,
    }
    said = blocks.step_words(run)
    return Section(
        "Step response, linear and nonlinear", said[:1].upper() + said[1:] + ".", (Row((blocks.step_figure(view, run),)),), numbers=numbers
    )


def _free_run(view: View) -> Section:
    """Nonlinear simulation along the path with an initial error."""
    loop = view.loop
    span = float(view.times[-1] - view.times[0]) or 2.0
    times = float(view.times[0]) + np.linspace(0.0, span, 301)
    try:
        run = loop.simulate(times, initial_error=0.05)
    except MfcError as why:
        return Section("Nonlinear simulation", f"Simulation not possible: {why}.")
    tool = loop.law.space == "tool"
    names = tuple(f"X_e_{c}" if tool else c for c in loop.law.error_channels(loop.robot.joint_names))
    selection = loop.law.selection
    units = ", ".join(sorted(set(selection.units if selection else ("m", "rad")))) if tool else ", ".join(sorted(set(loop.robot.joint_units)))
    first, last = np.abs(run.error[0]).max(), np.abs(run.error[-1]).max()
    said = (
        f"from an initial error of {written(float(first))} the largest error after {Number(float(run.t[-1] - run.t[0]), 's')} is"
        f" {written(float(last))} {units}"
    )
    if run.diverged:
        said += f" ({run.message})"
    drive = plots.Panel(f"{'velocity' if loop.equations.actuator == 'velocity' else 'torque'}", run.command)
    figure = Figure(
        partial(plots.traces, run.t, (plots.Panel(f"error [{units}]", run.error), drive), names),
        f"Nonlinear simulation: {said}.",
        f"Nonlinear simulation of {view.name}: {said}.",
    )
    return Section(
        "Nonlinear simulation", said[:1].upper() + said[1:] + ".", (figure,), numbers={"first_error": float(first), "last_error": float(last)}
    )


def validity_section(view: View, found: Validation | None) -> Section:
    """Linear prediction compared with the nonlinear simulation: model error and range of validity."""
    title = "Validity of the linear model"
    if found is None:
        return Section(title, "The nonlinear simulation cannot start from the operating point, so no comparison is made.", verdict=Status.WATCH)
    units = sorted(set(view.loop.robot.joint_units))
    unit = units[0] if len(units) == 1 else "rad, m"
    said = blocks.validation_words(found, unit)
    figure = blocks.validation_figure(view, found)
    facts = KeyFacts(
        (
            Fact(
                "Model error",
                Number(100 * found.nrmse, "%", infinite="diverged", undefined="not compared"),
                f"initial error {written(found.size, exact=True)} {unit}, over {written(found.time, exact=True)} s",
            ),
            Fact(
                "Valid up to",
                Number(found.radius, unit, infinite="all tested sizes", undefined="not compared"),
                "model error below 5 % in the worst direction",
            ),
            Fact("Taylor order", Number(found.taylor_order, infinite="exact", undefined="not compared"), "2 confirms the linearisation"),
        )
    )
    body: tuple[Block, ...] = (facts,) if figure is None else (facts, figure)
    return Section(title, said[:1].upper() + said[1:] + ".", body)


def pose_section(view: View) -> Sequence[Section]:
    """The arm as a stick figure."""
    return (Section("Pose of the arm", body=(Row((blocks.arm_figure(view),)),)),)
