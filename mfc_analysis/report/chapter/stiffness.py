"""Force loops over stiffness: poles, margins and root locus over 1e2..1e6 N/m, and maps of stiffness x gain with simulated points."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from mfc_analysis import plots
from mfc_analysis.design.stiffness import StabilityMap, over_stiffness, stable_up_to, stiffness_map
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.arms import per_joint
from mfc_analysis.report.chapter.force import KDAMP, KFI, KFP, MASS, POSE, SOURCES, Z, arm_loop, slider_loop
from mfc_analysis.report.chapter.pieces import agreement, at_least, pole_map
from mfc_analysis.report.chapter.smallest_margins import least
from mfc_analysis.report.document.document import (
    Callout,
    Cell,
    Column,
    Equation,
    Fact,
    Figure,
    KeyFacts,
    Math,
    Number,
    Row,
    Section,
    Table,
    Text,
    written,
)
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.simulation.settling import settles

SPAN = np.geomspace(1e2, 1e6, 49)  #: [N/m]
LAG = 2e-3  #: [s]
LAGGED, FILTERED, ALL = Hardware(torque_lag=LAG), Hardware(torque_lag=LAG, force_filter=2e-3), Hardware(torque_lag=LAG, force_filter=2e-3, delay=1e-3)
MARGINS = (("phase_deg", 1.0), ("gain_increase_db", 1.0), ("delay", 1e3))  #: columns of the arm's table, with their factors
ASIDE = 2.0  #: simulated points lie at the boundary divided and multiplied by this


class Mapped(NamedTuple):
    """A map, its simulated points (stiffness, value, settles), and how many of them agree with it."""

    map: StabilityMap
    points: tuple[tuple[float, float, bool], ...]
    agree: int

    def figure(self, ylabel: str, title: str, said: str) -> Figure:
        """The map drawn, with its points."""
        grown = np.arcsinh(self.map.growth)
        draw = partial(plots.stability_map, self.map.stiffness, self.map.values, grown, xlabel="stiffness [N/m]", ylabel=ylabel, points=self.points)
        alt = f"Stability map, {title}: {said}; {self.agree} of {len(self.points)} simulated points agree."
        return Figure(draw, f"{title}: {said}.", alt)

    def check(self) -> Line:
        """That the simulated points agree with the map."""
        return at_least("simulated points that agree", float(len(self.points)), float(self.agree))


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections on stiffness for the chapter report; not ``full``: with coarser maps."""
    return (ideal_section(), lag_section(full), arm_section())


def mapped(make: Callable[[float, float], ClosedLoop], values: Array, at: tuple[tuple[float, float], ...], kick: Array, span: Array = SPAN) -> Mapped:
    """The map of ``make(stiffness, value)`` and runs at the points ``at``, started in contact with a kick [rad/s, m/s].

    Each run takes 2.5 time constants of the linear loop's slowest (or growing) root, within limits.
    """
    found = stiffness_map(lambda value: make(1e4, value), span, values)
    points, agree = [], 0
    for k, value in at:
        loop = make(k, value)
        rate = float(over_stiffness(loop, [k]).growth[0])
        duration = float(np.clip(2.5 / abs(rate), 0.04, 0.1))
        run = loop.simulate(np.linspace(0, duration, 200), v=kick, rtol=1e-4, atol=1e-7)
        settled = not run.diverged and settles(run.t, run.force[:, 2])
        points.append((k, value, settled))
        agree += settled == (rate < 0)
    return Mapped(found, tuple(points), agree)


# --- one mass, ideal ---------------------------------------------------------------------------------------------


def ideal_section() -> Section:
    """Without lag the stability boundary depends on the gains only, not on the stiffness."""
    limit = KDAMP * (1 + KFP) / MASS
    gains = np.geomspace(limit / 10, limit * 10, 25)

    def make(k: float, kfi: float) -> ClosedLoop:
        return slider_loop(k, kfi=kfi)

    found = mapped(make, gains, tuple((k, limit * f) for k in (2e4,) for f in (1 / ASIDE, ASIDE)), np.array([1e-3]))
    edges = np.array([edge(found.map.values, found.map.growth[:, j]) for j in range(len(SPAN))])
    finding: Text = (
        "The stability of the ideal loop does not depend on the stiffness: from 100 N/m to 1 MN/m the largest integral gain is ",
        f"{per_joint(edges)} 1/s; the closed form is ",
        Math('(b + k_"damp")(1 + k_"fp") slash m'),
        f" = {written(limit)} 1/s.",
    )
    body = (
        Equation('m s^3 + (b + k_"damp") s^2 + k_e (1 + k_"fp") s + k_e k_"fi" = 0 quad "stable iff" quad (b + k_"damp")(1 + k_"fp") > m k_"fi"',
                 "characteristic polynomial of the ideal loop and its Routh bound, in which the stiffness cancels", "9.23"),
        found.figure("kfi [1/s]", "One mass, no lag", f"the boundary is at kfi = {written(limit)} 1/s for every stiffness"),
    )  # fmt: skip
    proofs = (agreement("boundary at 1 MN/m", float(edges[-1]), limit, 1.0), found.check())
    numbers = {"limit": limit, "edges": edges, "stiffness": SPAN, "points": found.points}
    return Section("Stiffness without lag", finding, body, (), numbers, SOURCES, proofs=proofs, key="stiffness-ideal")


def edge(values: Array, growth: Array) -> float:
    """Where growth over a logarithmic parameter changes sign for the first time."""
    j = int(np.flatnonzero(np.diff(np.sign(growth)) != 0)[0])
    a, b = np.arcsinh(growth[j]), np.arcsinh(growth[j + 1])
    return float(np.exp(np.log(values[j]) + np.log(values[j + 1] / values[j]) * a / (a - b)))


# --- one mass with lag -------------------------------------------------------------------------------------------


def closed_form(kfp: float) -> float:
    """[N/m] the stiffness up to which one mass with a torque lag is stable (b = c_e = 0)."""
    return (KDAMP * (1 + kfp) - MASS * KFI) / (LAG * kfp * (1 + kfp))


def lag_section(full: bool = True) -> Section:
    """With lag, delay and filter the boundary depends on the stiffness: two maps, and the closed form."""
    gains = np.geomspace(0.1, 10, 21)
    kick = np.array([1e-3])
    limit = stable_up_to(slider_loop(hardware=LAGGED))
    sides = tuple((closed_form(g) * f, g) for g in (KFP,) for f in (1 / ASIDE, ASIDE))
    lagged = mapped(lambda k, g: slider_loop(k, kfp=g, hardware=LAGGED), gains, sides, kick)

    def late(k: float, g: float) -> ClosedLoop:
        return slider_loop(k, kfp=g, hardware=ALL)

    real_limit = stable_up_to(late(1e4, KFP))
    real = mapped(late, gains[:: 3 if full else 4], ((real_limit / ASIDE, KFP), (real_limit * ASIDE, KFP)), kick, SPAN[::4])
    wanted = closed_form(KFP)
    finding = (
        f"With a torque lag of 2 ms and kfp = {KFP:g}, the loop is stable up to {written(limit / 1e3)} kN/m "
        f"(closed form {written(wanted / 1e3)}). 1 ms of dead time and a force filter of 2 ms reduce this limit to {written(real_limit / 1e3)} kN/m."
    )
    body = (
        Equation('k_e < (k_"damp" (1 + k_"fp") - m k_"fi") / (T k_"fp" (1 + k_"fp"))', "largest stable stiffness with a torque lag", "9.23"),
        KeyFacts(
            (
                Fact("Torque lag 2 ms", Number(limit / 1e3, "kN/m", 4), "stable up to"),
                Fact("Closed form", Number(wanted / 1e3, "kN/m", 4)),
                Fact("With delay and filter", Number(real_limit / 1e3, "kN/m", 4), "stable up to"),
            )
        ),
        Row(
            (
                lagged.figure("kfp [-]", "Torque lag 2 ms", f"at kfp = {KFP:g} stable up to {written(limit / 1e3)} kN/m"),
                real.figure("kfp [-]", "Lag, 1 ms delay, filter", f"at kfp = {KFP:g} stable up to {written(real_limit / 1e3)} kN/m"),
            )
        ),
    )
    proofs = (agreement("largest stiffness, torque lag", limit, wanted, 0.01), Line(*_both(lagged, real)))
    numbers = {"limit": limit, "closed_form": wanted, "limit_with_delay_and_filter": real_limit, "points": lagged.points + real.points}
    return Section("Stiffness with lag, dead time and filter", finding, body, (), numbers, SOURCES, proofs=proofs, key="stiffness-lag")


def _both(*maps: Mapped) -> tuple[str, float, float, str, float, Status]:
    asked, found = float(sum(len(m.points) for m in maps)), float(sum(m.agree for m in maps))
    return "simulated points that agree", asked, found, "", found - asked, Status.PASS if found >= asked else Status.FAIL


# --- the arm -----------------------------------------------------------------------------------------------------


def arm_section() -> Section:
    """The UR5's force loop over stiffness: poles, margins, root locus, map."""
    loop = arm_loop(hardware=FILTERED)
    swept, ideal = over_stiffness(loop, SPAN), over_stiffness(arm_loop(), SPAN)
    limit, late_limit = stable_up_to(loop), stable_up_to(arm_loop(hardware=ALL))
    kick = np.asarray(np.linalg.solve(loop.robot.jacobian(POSE), 1e-3 * Z), float)
    found = mapped(lambda k, g: arm_loop(k, kfp=g, hardware=FILTERED), np.geomspace(0.3, 10, 12), ((limit / ASIDE, KFP), (limit * ASIDE, KFP)), kick)
    shown = [int(np.argmin(np.abs(SPAN - k))) for k in (1e2, 1e3, 1e4, 1e5, 1e6)]
    tried = [least(arm_loop(float(SPAN[i]), hardware=FILTERED).linearize()) for i in shown]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            f"{SPAN[i] / 1e3:g}",
            *(Number(scale * m[name].value, infinite="no crossover", undefined="unstable") for name, scale in MARGINS),
            "; ".join(dict.fromkeys(m[name].where for name, _ in MARGINS if np.isfinite(m[name].value))),
            float(swept.growth[i]),
            float(ideal.growth[i]),
        )
        for m, i in zip(tried, shown, strict=True)
    )
    columns = (
        Column("Stiffness", "kN/m", share=1.3),
        Column("phase margin", "°", share=1.2),
        Column("gain margin", "dB", share=1.2),
        Column("delay margin", "ms", share=1.2),
        Column("of", numeric=False, share=5),
        Column("rightmost pole", "1/s", share=1.4),
        Column("ideal loop", "1/s", share=1.3),
    )
    always = bool(ideal.stable.all())
    finding = (
        f"The UR5 pressing under 9.23 is stable up to {written(limit / 1e3)} kN/m with a torque lag and a force filter of 2 ms each, and up to "
        f"{written(late_limit / 1e3)} kN/m with an additional 1 ms of dead time. The ideal loop is {'stable' if always else 'not stable'} "
        "from 0.1 kN/m to 1 MN/m."
    )
    worst = int(np.argmin(np.abs(SPAN - limit)))
    body = (
        Table("Smallest margins over all analysis points, with their channels and points, and the rightmost pole over stiffness.", columns, rows),
        Row(
            (
                pole_map(swept.poles[worst], f"the UR5 at {written(float(SPAN[worst]) / 1e3)} kN/m (grey: from 0.1 kN/m to 1 MN/m)", swept.poles),
                found.figure("kfp [-]", "UR5, lag and filter", f"at kfp = {KFP:g} stable up to {written(limit / 1e3)} kN/m"),
            )
        ),
        Callout(
            Status.INFO,
            "Why stiff surfaces cause chatter",
            "A late torque acts in phase with the velocity once the contact resonance is faster than the lag. An ideal loop loses no phase.",
        ),
    )
    numbers = {
        "limit": limit,
        "limit_with_delay": late_limit,
        "stiffness": SPAN,
        "growth": swept.growth,
        "growth_ideal": ideal.growth,
        "points": found.points,
    }
    return Section("The UR5 over stiffness", finding, body, (), numbers, SOURCES, proofs=(found.check(),), key="stiffness-arm")
