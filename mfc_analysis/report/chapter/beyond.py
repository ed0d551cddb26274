"""Beyond the chapter: impedance behind a lag and what touches it, the admittance of an arm with a servo of its own, touching at speed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis import laws, plots, robots
from mfc_analysis.design.impact import impact
from mfc_analysis.design.stiffness import stable_up_to
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.report.chapter.force import MASS, Z, slider_loop
from mfc_analysis.report.chapter.pieces import agreement, at_most, in_words
from mfc_analysis.report.chapter.smallest_margins import force_checks, margin_numbers, smallest_numbers
from mfc_analysis.report.document.document import Block, Callout, Column, Equation, Figure, Number, Row, Section, Table, written
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.requirements.line import Status
from mfc_analysis.simulation.settling import settles
from mfc_analysis.trajectories.tool import ToolHold
from mfc_analysis.units import hertz

if TYPE_CHECKING:
    from mfc_analysis.analysis.passivity import Passivity
    from mfc_analysis.plots.figure import Axes

SOURCES = (
    "Hogan, Impedance control, J. Dyn. Sys. Meas. Control 107 (1985) 1-24",
    "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9",
)
K, LAG = 500.0, 0.02  #: [N/m], [s] of the impedance
RATIOS = (0.5, 0.9, 1.1, 2.0)  #: D/(T K)
WALLS = (1e2, 1e4, 1e6)  #: [N/m]
Q = np.radians([0.0, -60.0, 80.0, -110.0, -90.0, 0.0])  #: UR5, tool pointing down
PERIOD, SERVO = 0.008, Servo(bandwidth=hertz(8.0), damping=0.7, delay=0.016)
DRIVES = Hardware(sample_time=PERIOD, servo=SERVO, force_filter=0.002)
INERTIA, DAMPING = 60.0, 3700.0  #: [kg], [Ns/m] of the admittance along the force
FREE = ([1500.0, 1500.0], [100.0, 100.0, 100.0])  #: its damping along the other axes
WALL = 2e4  #: [N/m]
DAMPINGS = (DAMPING / 4, DAMPING / 2, DAMPING, 2 * DAMPING)
BESIDE = 1.1  #: simulated on walls at the limit divided and multiplied by this
RUN = 2.0  #: [s]
SURFACES = {"rubber": 2e3, "wood": 2e4, "steel": 2e5}  #: [N/m]
SPEEDS, TOUCHING = (0.05, 0.1, 0.2), 0.4  #: [m/s], [s]
DRIVE = Hardware(torque_lag=2e-3)
ONE_SIDED = Environment(1e4, preload=10.0, one_sided=True)


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections on impedance, admittance and impact; not ``full``: with fewer dampings and speeds."""
    return (impedance_section(), admittance_section(full), impact_section() if full else impact_section(SPEEDS[1:2], TOUCHING / 2))


# --- impedance -----------------------------------------------------------------------------------------------------------


def impedance_loop(damping: float, wall: float | None = None) -> ClosedLoop:
    """One mass under impedance control behind a torque lag, in free motion or on a spring [N/m]."""
    slider = robots.slider(MASS)
    surface = None if wall is None else Environment(wall)
    law = laws.Impedance(K, damping, axes="z")
    return ClosedLoop(slider, law, ToolHold(slider.pose([0.0])), environment=surface, q_start=[0.0], hardware=Hardware(torque_lag=LAG))


def damping_map(port: Passivity) -> Axes:
    """The damping of a port over frequency, on a sheet of its own; a function that can be sent to another process."""
    return port.plot(ax=plots.axes_for("map"))


def impedance_section() -> Section:
    """Stable, passive and how much damping is missing, against D > T K."""
    rows, worst, said = [], 0.0, []
    for ratio in RATIOS:
        D = ratio * LAG * K
        free = impedance_loop(D).linearize([0.0])
        port = free.passivity()
        on_walls = [bool(impedance_loop(D, k).linearize([0.0]).stable[0]) for k in WALLS]
        wanted = np.poly1d([MASS * LAG, MASS, D, K]).coeffs / (MASS * LAG)
        worst = max(worst, float(np.abs(np.poly(free.poles()[0]) / wanted - 1).max()))
        said.append((ratio > 1) == bool(free.stable[0]) == all(on_walls) == bool(port.passive[0]))
        count = f"{sum(on_walls)} of {len(WALLS)}"
        rows.append((Number(D), Number(ratio), in_words(bool(free.stable[0])), count, "passive" if port.passive[0] else "not passive"))
    columns = (
        Column("D", "Ns/m"), Column("D/(T K)"), Column("free motion", numeric=False), Column("stable on walls of 0.1, 10, 1000 kN/m", numeric=False),
        Column("port", numeric=False),
    )  # fmt: skip
    lin = impedance_loop(2 * LAG * K).linearize([0.0])
    drawn = Figure(
        partial(damping_map, lin.passivity()),
        "Damping of the port at the tool, D = 2 T K: positive at all frequencies, so no spring makes the loop unstable.",
        "Damping of the port over frequency: nowhere negative; it falls to zero above the lag.",
    )
    finding = (
        f"Behind a torque lag of {1e3 * LAG:g} ms an impedance with K = {K:g} N/m is stable if and only if its damping exceeds T K = "
        f"{LAG * K:g} Ns/m, for a wall of any stiffness; then it is passive too."
    )
    body = (
        Equation(laws.Impedance.typst, "impedance control"),
        Equation('m T s^3 + m s^2 + (D + k_e T) s + K + k_e = 0 quad "stable iff" quad D > T K', "one mass on a spring, behind a torque lag"),
        Table("One mass under impedance control behind a lag, around the limit D = T K.", columns, tuple(rows)),
        Row((drawn,)),
    )
    proofs = (
        at_most("deviation from theory", 1e-6, 100 * worst, "%", "characteristic polynomial"),
        at_most("cases that disagree with D > T K", 0.0, float(len(said) - sum(said))),
    )
    numbers = {KEY: record(impedance_loop(2 * LAG * K), at="torque"), "limit": LAG * K, **smallest_numbers(lin)}
    name = "impedance, slider"
    return Section(
        "Impedance behind a lag",
        finding,
        body,
        (),
        numbers,
        SOURCES,
        proofs=proofs,
        loop=name,
        key="impedance",
        origins=(("", "chosen: D = 2 T K, twice the limit of stability"),),
    )


# --- admittance ----------------------------------------------------------------------------------------------------------


def admittance_loop(wall: float = WALL, damping: float = DAMPING, hardware: Hardware = DRIVES) -> ClosedLoop:
    """A UR5 pressing with 20 N on a wall [N/m] by admittance control through its own servo; its tool stays upright by a soft position loop."""
    arm = robots.ur5()
    law = laws.Admittance(
        20 * Z,
        [INERTIA] * 3 + [4.0] * 3,
        [*FREE[0], damping, *FREE[1]],
        [3000.0, 3000.0, 0.0, 200.0, 200.0, 200.0],
    )
    surface = Environment(wall, 50.0, axes="z", preload=20.0)
    return ClosedLoop(arm, law, ToolHold(arm.pose(Q)), q_start=Q, environment=surface, hardware=hardware)


def admittance_section(full: bool = True) -> Section:
    """Which wall a UR5 at 125 Hz stands, at which damping, what takes the rest, and two sampled runs beside the limit."""
    dampings = DAMPINGS if full else DAMPINGS[1:3]
    limits = [stable_up_to(admittance_loop(damping=D), 1e7) for D in dampings]
    limit = limits[dampings.index(DAMPING)]
    costs = {
        "servo of 8 Hz alone": Hardware(servo=replace(SERVO, delay=None)),
        "and its 16 ms of dead time": Hardware(servo=SERVO),
        "and 125 Hz sampling": Hardware(servo=SERVO, sample_time=PERIOD),
        "and a force filter of 2 ms": DRIVES,
    }
    chain = {name: limit if drives is DRIVES else stable_up_to(admittance_loop(hardware=drives), 1e7) for name, drives in costs.items()}
    kick = np.linalg.solve(robots.ur5().jacobian(Q), 1e-4 * Z)
    holds = {}
    for factor in (1 / BESIDE, BESIDE):
        run = admittance_loop(factor * limit).simulate(np.linspace(0.0, RUN, 601), q=Q + kick, rtol=1e-5, atol=1e-8)
        holds[factor] = not run.diverged and settles(run.t, run.force[:, 2])
    lin = admittance_loop().linearize([0.0])
    finding = (
        f"With a damping of {DAMPING:g} Ns/m a UR5 at 125 Hz, with an inner servo of 8 Hz and 16 ms of dead time, is stable on walls "
        f"up to {written(limit / 1e3)} kN/m. On a wall a delayed motion is a delayed force. More damping makes the arm slower under the same "
        "force, and stable on a stiffer wall."
    )
    body = (
        Equation(laws.Admittance.typst, "admittance control through the servo of the arm"),
        Table(
            f"The stiffest wall over the damping of the admittance (inertia {INERTIA:g} kg).",
            (Column("damping", "Ns/m"), Column("stable on walls up to", "kN/m"), Column("free speed under 20 N", "mm/s")),
            tuple((Number(D), Number(k / 1e3, infinite="any"), Number(2e4 / D)) for D, k in zip(dampings, limits, strict=True)),
        ),
        Table(
            f"What limits it, each effect added to those above it, at {DAMPING:g} Ns/m.",
            (Column("the arm", numeric=False), Column("stable on walls up to", "kN/m")),
            tuple((name, Number(k / 1e3, infinite="any")) for name, k in chain.items()),
        ),
        Callout(
            Status.INFO,
            "Simulated beside the limit",
            f"The sampled arm settles on a wall of {written(limit / BESIDE / 1e3)} kN/m and does not on one of {written(BESIDE * limit / 1e3)} kN/m."
            if list(holds.values()) == [True, False]
            else "The sampled runs do not confirm the limit.",
        ),
    )
    proofs = (at_most("sampled runs that disagree with the limit", 0.0, float(not holds[1 / BESIDE]) + float(holds[BESIDE])),)
    numbers = {KEY: record(admittance_loop(), at="force"), "limit": limit, "limits": limits, "chain": chain, **margin_numbers(lin)}
    return Section(
        "Admittance: a UR5 at 125 Hz", finding, body, force_checks(lin, 45.0, 6.0, 2.0), numbers, SOURCES, proofs=proofs, loop="admittance, UR5",
        key="admittance", origins=(("", "gains.admittance: 1.5 Hz on 20 kN/m"),),
    )  # fmt: skip


# --- impact --------------------------------------------------------------------------------------------------------------


def impact_section(speeds: tuple[float, ...] = SPEEDS, duration: float = TOUCHING) -> Section:
    """Peak force, bounces and time to settle of one mass under 9.23 that touches rubber, wood and steel."""
    pressing = slider_loop(1e4, hardware=DRIVE)
    found = impact(replace(pressing, environment=ONE_SIDED), list(speeds), stiffness=list(SURFACES.values()), duration=duration)
    limit = stable_up_to(pressing)
    rows = tuple(
        (
            f"{name}, {k / 1e3:g} kN/m",
            Number(v),
            Number(float(found.peak[i, j])),
            Number(v * np.sqrt(k * MASS)),
            str(int(found.bounces[i, j])),
            Number(float(found.settling[i, j]), undefined=f"not in {duration:g} s"),
        )
        for i, (name, k) in enumerate(SURFACES.items())
        for j, v in enumerate(speeds)
    )
    columns = (
        Column("surface", numeric=False), Column("speed", "m/s"), Column("peak force", "N"), Column("elastic impact", "N"), Column("bounces"),
        Column("settles in", "s"),
    )  # fmt: skip
    thrown = replace(pressing, law=laws.OpenLoopForce(np.zeros(6)), environment=replace(ONE_SIDED, preload=0.0), hardware=None)
    elastic = impact(thrown, [0.1], stiffness=[2e4])
    soft, stiff = (int(found.bounces[i].max()) for i in (0, -1))
    finding = (
        f"Touching at up to {max(speeds):g} m/s, a mass of {MASS:g} kg that presses under 9.23 leaves rubber {soft} times and steel {stiff} times in "
        f"{duration:g} s. It bounces on steel because the loop in contact is stable only up to {written(limit / 1e3)} kN/m with this lag: on a "
        "stiffer surface the oscillation of the force grows until the tool lifts off."
    )
    body: tuple[Block, ...] = (
        Equation('F_"max" = v sqrt(k m)', "peak force of a mass that meets an elastic surface at speed v"),
        Table(
            "Touching at speed under 9.23 with a torque lag of 2 ms, one-sided contact; for comparison a mass without a controller.", columns, rows
        ),
    )
    if len(speeds) > 1:
        body += (Row((Figure(partial(_map, found), "Peak force over speed, a curve for each surface.", f"Peak force over speed: {found}."),)),)
    proofs = (agreement("peak force of an elastic impact", float(elastic.peak[0, 0]), 0.1 * np.sqrt(2e4 * MASS), 1.0),)
    numbers = {
        "stiffness": found.stiffness,
        "speeds": found.speeds,
        "peak": found.peak,
        "bounces": found.bounces,
        "settling": found.settling,
        "limit": limit,
    }
    return Section("Touching at speed", finding, body, (), numbers, SOURCES, proofs=proofs, key="impact")


def _map(found: object) -> object:
    return found.plot(ax=plots.axes_for("map"))  # type: ignore[attr-defined]
