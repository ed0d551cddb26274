"""Force control, equations 9.19 to 9.23: dynamic and quasi-static contact, unknown payload, free space, and margins in contact."""

from __future__ import annotations

from functools import cache, partial
from typing import NamedTuple

import numpy as np

from mfc_analysis import laws, plots, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.laws.force import ForceLaw
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.pieces import agreement, at_most, in_words, margins_at, pole_map, poles_table, response, validated
from mfc_analysis.report.chapter.smallest_margins import force_checks, force_facts, least, margin_numbers, tightest
from mfc_analysis.report.document.document import (
    Cell,
    Column,
    Equation,
    Figure,
    Math,
    Number,
    Paragraph,
    Section,
    Table,
    Text,
    written,
)
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import Hold

Z = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  #: the pressing direction, as gains with six components
POSE = np.array([0.3, -1.25, 1.9, -2.2, -1.57, 0.2])  #: [rad] UR5 with its tool pointing down
KFP, KFI, KDAMP, MASS = 1.0, 5.0, 60.0, 1.0  #: of the slider: [-], [1/s], [Ns/m], [kg]
ARM_DAMPING = np.array([200.0, 200.0, 200.0, 4.0, 4.0, 4.0])  #: of the arm: [Ns/m, Nm s/rad]
GRIP = np.array([2000.0, 2000.0, 50.0, 50.0, 20.0])  #: [N/m, Nm/rad] stiffness of a sticking rubber tip in x, y, rx, ry, rz
G = 9.81
CHOSEN = (("F_d", "the force asked for"), ("kfp", "chosen: half of the force error is left without the integral"), ("", "chosen"))
SOURCES = ("Lynch & Park, Modern Robotics, ch. 11.5", "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9")


def slider_loop(
    stiffness: float | None = 1e4, kfp: float = KFP, kfi: float | None = KFI, kdamp: float = KDAMP, hardware: Hardware | None = None
) -> ClosedLoop:
    """One mass of 1 kg under 9.23 (9.22 without damping), pressing with 10 N on a spring [N/m], or in free space."""
    law: ForceLaw = laws.DampedForcePI(10 * Z, kfp * Z, None if kfi is None else kfi * Z, kdamp * Z)
    if not kdamp:
        law = laws.ForcePI(10 * Z, kfp * Z, None if kfi is None else kfi * Z)
    surface = None if stiffness is None else Environment(stiffness, preload=10.0)
    return ClosedLoop(robots.slider(MASS), law, Hold([0.0]), environment=surface, hardware=hardware)


def arm_loop(
    stiffness: float | None = 1e4, law: ForceLaw | None = None, kfp: float = KFP, robot: Robot | None = None, hardware: Hardware | None = None
) -> ClosedLoop:
    """A UR5 pressing with 20 N on a surface [N/m] to which its rubber tip sticks, or in free space; the controller's model is the bare arm."""
    law = law or laws.DampedForcePI(20 * Z, kfp * Z, KFI * Z, ARM_DAMPING)
    surfaces = None if stiffness is None else [Environment(stiffness, preload=20.0), Environment(GRIP, axes="xyrxryrz")]
    model = arm()
    return ClosedLoop(robot or model, law, Hold(POSE), controller_model=model, environment=surfaces, hardware=hardware)


@cache
def arm() -> Robot:
    """The bare UR5."""
    return robots.ur5()


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections of 9.19-9.23 for the chapter report; not ``full``: without pictures that repeat what others show."""
    return (contact_section(), payload_section(), free_space_section(), slider_section(full), arm_section(full))


# --- 9.19 and 9.20 -----------------------------------------------------------------------------------------------


def contact_section() -> Section:
    """Deviation of the quasi-static model from the dynamic one over frequency."""
    w = np.geomspace(0.1, 300.0, 36)
    far = {"slider": slider_loop().quasi_static().departure(w), "UR5": arm_loop().quasi_static().departure(w)}
    tenth = {name: crossing(w, d, 0.1) for name, d in far.items()}
    spring = np.sqrt(1e4 / MASS)
    finding = (
        f"Neglecting the inertia causes a force error of 10 % at {written(tenth['slider'])} rad/s for the slider and at "
        f"{written(tenth['UR5'])} rad/s for the UR5. At lower frequencies 9.20 approximates 9.19."
    )
    figure = Figure(
        partial(
            plots.curves, w, list(far.items()), xlabel="ω [rad/s]", ylabel="deviation [-]", log="xy", limit=0.1, title="9.20 compared with 9.19"
        ),
        "Deviation of the quasi-static model: largest singular value of the difference between both transfers from desired to actual force.",
        f"Deviation over frequency: 10 % at {tenth['slider']:.3g} rad/s (slider) and {tenth['UR5']:.3g} rad/s (UR5).",
    )  # fmt: skip
    body = (
        Equation('M dot.double(q) + C dot(q) + g + J^top "F"_"tip" = tau', "dynamics in contact", "9.19"),
        Equation('g + J^top "F"_"tip" = tau', "quasi-static balance", "9.20"),
        Paragraph(
            (
                "Both loops use 9.23 on a surface of 10 kN/m. The slider's mass and surface alone resonate at ",
                Math("sqrt(k_e slash m)"),
                f" = {written(spring)} rad/s.",
            )
        ),
        figure,
    )
    return Section(
        "Dynamic and quasi-static contact: 9.19 and 9.20",
        finding,
        body,
        numbers={"frequencies": w, "departure": far, "one_tenth_at": tenth},
        sources=SOURCES,
        key="contact",
    )


def crossing(x: Array, y: Array, level: float) -> float:
    """Where y first rises through ``level``, on logarithmic axes; inf if it never does."""
    above = np.flatnonzero(y >= level)
    if not above.size:
        return float("inf")
    j = int(above[0])
    if j == 0:
        return float(x[0])
    lx, ly = np.log(x[j - 1 : j + 1]), np.log(y[j - 1 : j + 1])
    return float(np.exp(lx[0] + (lx[1] - lx[0]) * (np.log(level) - ly[0]) / (ly[1] - ly[0])))


# --- 9.21 --------------------------------------------------------------------------------------------------------


def payload_section() -> Section:
    """Force error due to an unknown payload: 9.21, 9.22 with kfp alone, and 9.23 with the integral."""
    masses = np.array([0.5, 1.0, 2.0, 3.0])
    open_law = laws.OpenLoopForce(20 * Z)
    by_law = {"9.21": open_law, "9.23, kfp = 1": laws.DampedForcePI(20 * Z, KFP * Z, kdamp=ARM_DAMPING), "9.23, kfp = 1, kfi = 5": None}
    heavier = [arm().with_payload(float(m)) for m in masses]
    slow = np.array([arm_loop(None, open_law, robot=r).quasi_static().error[2] for r in heavier])
    errors = {name: np.array([20 - arm_loop(law=law, robot=r).equilibrium().force[2] for r in heavier]) for name, law in by_law.items()}
    down = float(arm().pose(POSE)[2, 2])  # z of the tool against the vertical
    closed = masses * G * down
    share = errors["9.23, kfp = 1"][-1] / errors["9.21"][-1]
    finding: Text = (
        "Each kilogram of payload missing in ",
        Math("hat(g)"),
        f" adds {written(abs(closed[1]))} N to the force under 9.21. With kfp = 1 a fraction of {written(share, 2)} remains, "
        f"and with the integral {written(tiny(float(np.abs(errors['9.23, kfp = 1, kfi = 5']).max())), 2)} N at most.",
    )
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (Number(float(m), exact=True), float(c), float(s), *(tiny(float(errors[name][i])) for name in by_law))
        for i, (m, c, s) in enumerate(zip(masses, closed, slow, strict=True))
    )
    columns = (Column("Payload", "kg"), Column("closed form", "N"), Column("9.20", "N"), *(Column(name, "N") for name in by_law))
    body = (
        Equation('tau = hat(g)(q) + J^top "F"_d', "open-loop force", "9.21"),
        Paragraph(
            (
                "Force error ",
                Math('"F"_d - "F"_"tip"'),
                " along the tool axis of a UR5 that presses down with 20 N: from the weight alone, from 9.20, and at equilibrium in contact.",
            )
        ),
        Table("Steady-state force error for an unknown payload.", columns, rows),
    )
    proofs = (
        agreement("force error at rest, 3 kg", float(errors["9.21"][-1]), float(closed[-1]), 1e-6),
        agreement("force error by 9.20, 3 kg", float(slow[-1]), float(closed[-1]), 1e-6),
    )
    numbers = {"payload": masses, "closed_form": closed, "quasi_static": slow, "errors": errors}
    return Section("Open-loop force and an unknown payload: 9.21", finding, body, (), numbers, SOURCES, proofs=proofs, key="payload")


def tiny(value: float, floor: float = 1e-6) -> float:
    """The value, or 0 if it is rounding error."""
    return 0.0 if abs(value) < floor else value


# --- free space --------------------------------------------------------------------------------------------------


class Free(NamedTuple):
    """A force law in free space."""

    name: str
    loop: ClosedLoop
    t: Array  #: (m,) [s]
    speed: Array  #: (m,) [m/s] of the tool along its z axis
    expected: float  #: [m/s^2] acceleration at the end by the closed form; NaN where there is none
    end: float  #: [m/s] speed at the end by the closed form; NaN where there is none

    @property
    def acceleration(self) -> float:
        """[m/s^2] mean of the last tenth of the run."""
        last = self.t >= self.t[-1] - 0.1 * (self.t[-1] - self.t[0])
        return float(np.polyfit(self.t[last], self.speed[last], 1)[0])


@cache
def free_runs() -> tuple[Free, ...]:
    """9.22 and 9.23 in free space, slider and arm, 1 s from rest (the damped slider 2 s)."""
    nan = float("nan")
    t1, t2 = np.linspace(0, 1, 101), np.linspace(0, 2, 201)
    undamped = laws.ForcePI(20 * Z, KFP * Z, KFI * Z)
    ramp = 10 * ((1 + KFP) + KFI) / MASS  # F_d ((1 + kfp) + kfi t) / m at t = 1
    cases = (
        ("slider, 9.22", slider_loop(None, kdamp=0.0), t1, ramp, 10 * ((1 + KFP) + KFI / 2) / MASS),
        ("slider, 9.23", slider_loop(None), t2, KFI * 10 / KDAMP, nan),
        ("UR5, 9.22", arm_loop(None, undamped), t1, nan, nan),
        ("UR5, 9.23", arm_loop(None), t1, KFI * 20 / float(ARM_DAMPING[2]), nan),
    )
    return tuple(Free(name, loop, t, loop.simulate(t).twist[:, 2], a, v) for name, loop, t, a, v in cases)


def free_space_section() -> Section:
    """In free space 9.22 accelerates without limit; under 9.23 the speed still ramps."""
    runs = free_runs()
    drifts = [bool(r.loop.linearize().drifts[0]) for r in runs]
    a, b = runs[0], runs[1]
    finding = (
        f"In free space, 9.22 accelerates the slider to {written(float(a.speed[-1]))} m/s and the UR5 to "
        f"{written(float(runs[2].speed[-1]))} m/s within 1 s. Under 9.23 the slider's speed still ramps at {written(b.acceleration)} m/s², "
        f"because the force integral winds up. {sum(drifts)} of {len(runs)} loops drift, "
        f"{sum(not d for d in drifts)} {'is' if sum(not d for d in drifts) == 1 else 'are'} unstable; none is stable."
    )
    rows = tuple(
        (r.name, float(r.speed[-1]), r.acceleration, Number(r.expected, undefined="nonlinear"), in_words(False, d))
        for r, d in zip(runs, drifts, strict=True)
    )
    columns = (
        Column("Loop", numeric=False),
        Column("speed at the end", "m/s"),
        Column("acceleration", "m/s²"),
        Column("closed form", "m/s²"),
        Column("linear verdict", numeric=False),
    )
    fast = plots.Panel("9.22: speed [m/s]", np.stack([a.speed, runs[2].speed], axis=1))
    slow = plots.Panel("9.23: speed [m/s]", np.stack([b.speed[: len(a.t)], runs[3].speed], axis=1))
    figure = Figure(
        partial(plots.traces, a.t, (fast, slow), ("slider", "UR5"), title="Force control in free space"),
        "Speed along the tool axis after a force command in free space.",
        f"Speeds over one second: 9.22 slider {a.speed[-1]:.3g} m/s, UR5 {runs[2].speed[-1]:.3g} m/s; "
        f"9.23 slider {b.speed[100]:.3g} m/s, UR5 {runs[3].speed[-1]:.3g} m/s.",
    )
    body = (
        Equation('dot(v) -> (k_"fi" F_d)/(k_"damp" + b)', "the remaining acceleration under 9.23", "9.23"),
        Table("Force laws in free space.", columns, rows),
        figure,
    )
    proofs = (
        agreement("9.22, speed after 1 s", float(a.speed[-1]), a.end, 0.1),
        agreement("9.23, ramp of the speed", b.acceleration, b.expected, 0.1),
    )
    numbers = {
        "speed": {r.name: float(r.speed[-1]) for r in runs},
        "acceleration": {r.name: r.acceleration for r in runs},
        "closed_form": {r.name: r.expected for r in runs},
        "drifts": dict(zip((r.name for r in runs), drifts, strict=True)),
    }
    shown = "the chapter's warning: do not use these loops in free space"
    return Section("Free space: 9.22 and 9.23", finding, body, (), numbers, SOURCES, proofs=proofs, key="free-space", shown=shown)


# --- in contact --------------------------------------------------------------------------------------------------


def slider_section(full: bool = True) -> Section:
    """The one-mass force loop on a spring with a torque lag: poles, polynomial, margins."""
    lag, k = 2e-3, 2e3
    loop = slider_loop(k, hardware=Hardware(torque_lag=lag))
    lin = loop.linearize()
    p = lin.poles()[0]
    wanted = np.array([MASS * lag, MASS, KDAMP + k * lag, k * (1 + KFP), k * KFI]) / (MASS * lag)
    found = np.poly(p[np.abs(p) > 0]).real
    away = float(np.abs(found / wanted - 1).max())
    finding = f"On a spring of {written(k, exact=True)} N/m with a torque lag of 2 ms {tightest(lin)}."
    body = (
        Equation(
            'm T s^4 + m s^3 + (k_"damp" + k_e T) s^2 + k_e (1 + k_"fp") s + k_e k_"fi" = 0',
            "characteristic polynomial of one mass on a spring with a torque lag",
            "9.23",
        ),
        force_facts(lin),
        *((response(lin, "force", 2, "slider, 9.23", span=(0.1, 3e3)), pole_map(p, "slider, 9.23")) if full else ()),
    )
    checks = force_checks(lin, 45.0, 6.0, 2.0)
    proofs = (at_most("deviation from theory", 1e-6, 100 * away, "%", "characteristic polynomial"),)
    numbers = {KEY: record(loop, at="force"), "polynomial": found * MASS * lag, "closed_form": wanted * MASS * lag, "poles": p, **margin_numbers(lin)}
    name = "9.23 force PI, slider"
    title = "One mass pressing on a spring: 9.23"
    return Section(title, finding, body, checks, numbers, SOURCES, proofs=proofs, loop=name, key="slider-force", origins=CHOSEN)


def arm_section(full: bool = True) -> Section:
    """The UR5 under 9.21, 9.22 and 9.23 in contact: margins at the force sensor and at the torques."""
    lag = 2e-3
    by_name = {
        "9.21": laws.OpenLoopForce(20 * Z),
        "9.22": laws.ForcePI(20 * Z, KFP * Z, KFI * Z),
        "9.23": laws.DampedForcePI(20 * Z, KFP * Z, KFI * Z, ARM_DAMPING),
    }
    loops = {name: arm_loop(1e4, law, hardware=Hardware(torque_lag=lag)) for name, law in by_name.items()}
    lins = {name: loop.linearize() for name, loop in loops.items()}
    rows = []
    for name, lin in lins.items():
        phase, delay = (least(lin)[metric] for metric in ("phase_deg", "delay"))
        rows.append(
            (
                name,
                in_words(bool(lin.stable[0]), bool(lin.drifts[0])),
                Number(phase.value, undefined="unstable", infinite="no crossover"),
                phase.where if np.isfinite(phase.value) else "",
                Number(delay.value * 1e3, undefined="unstable", infinite="unlimited"),
                delay.where if np.isfinite(delay.value) else "",
            )
        )
    lin = lins["9.23"]
    t = margins_at(lin, "torque")
    j = int(np.argmin(t.phase_deg[0]))
    finding = (
        f"For the UR5 under 9.23 on 10 kN/m with a torque lag of 2 ms {tightest(lin)}; without damping (9.22) the same loop is "
        f"{in_words(bool(lins['9.22'].stable[0]), bool(lins['9.22'].drifts[0]))}."
    )
    columns = (
        Column("Law", numeric=False),
        Column("verdict", numeric=False),
        Column("phase margin", "°"),
        Column("where", numeric=False),
        Column("delay margin", "ms"),
        Column("where", numeric=False),
    )
    body = (
        Equation(laws.DampedForcePI.typst, "damped PI force control", "9.23"),
        *((force_facts(lin),) if full else ()),
        Table("A UR5 pressing with 20 N on a surface of 10 kN/m, torque lag 2 ms: smallest margins over all analysis points.", columns, tuple(rows)),
        *((response(lin, "force", 2, "UR5, 9.23, fz", span=(0.1, 3e3)),) if full else ()),
        response(lin, "torque", j, f"UR5, 9.23, {t.channels[j]}", span=(0.1, 3e3)),
        *((poles_table([(name, x.poles()[0]) for name, x in lins.items()], 5, "The slowest closed-loop poles that are not slow."),) if full else ()),
    )
    numbers = {
        KEY: record(loops["9.23"], at="torque"),
        "verdicts": {name: row[1] for name, row in zip(lins, rows, strict=True)},
        **margin_numbers(lin),
        "torque_phase_deg": t.phase_deg[0],
        "poles": lin.poles()[0],
        "validation": validated(arm_loop(1e4), 0.05),
    }
    return Section(
        "The UR5 pressing on a surface: 9.21 to 9.23",
        finding,
        body,
        force_checks(lin, 45.0, 6.0, 2.0),
        numbers,
        SOURCES,
        loop="9.23 force PI, UR5",
        key="arm-force",
        origins=CHOSEN,
    )
