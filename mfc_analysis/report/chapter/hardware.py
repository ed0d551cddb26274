"""Effects of real hardware: the most critical imperfection, dead time x bandwidth, disk margins, Floquet multipliers on a moving reference."""

from __future__ import annotations

from functools import cache, partial
from typing import NamedTuple

import numpy as np

from mfc_analysis import design, laws, plots, robots
from mfc_analysis.design.dead_time import DelayMap, delay_map
from mfc_analysis.design.stiffness import stable_up_to
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import MfcError
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.force import POSE, arm, arm_loop
from mfc_analysis.report.chapter.pieces import LYNCH, agreement, at_least, at_most, margins_at
from mfc_analysis.report.chapter.smallest_margins import least, smallest_numbers
from mfc_analysis.report.document.document import Callout, Column, Equation, Fact, Figure, KeyFacts, Number, Paragraph, Row, Section, Table, written
from mfc_analysis.report.loops.checks import checks as as_checks, everywhere
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.requirements.line import Status
from mfc_analysis.requirements.requirements import Requirements
from mfc_analysis.robots.robot import Robot
from mfc_analysis.simulation.orbit import Floquet
from mfc_analysis.simulation.settling import settles
from mfc_analysis.trajectories import Hold, Sinusoid

SOURCES = (
    LYNCH,
    "Seiler, Packard, Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020)",
    "Franklin, Powell, Workman, Digital Control of Dynamic Systems",
)
LATE = "9.10 with torque lag, UR5 + 2 kg"
BANDWIDTH, PAYLOAD, LAG = 15.0, 2.0, 2e-3  #: [rad/s] triple pole, [kg] unknown, [s]
ASIDE = (0.8, 1.25)  #: fractions of a limit that are simulated
ASKED = Requirements(phase_deg=45.0, gain_increase_db=6.0, gain_reduction_db=6.0, delay=8e-3, sensitivity_peak=2.0, disk_margin=0.4)


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections on hardware and robustness for the chapter report; not ``full``: with a coarser map."""
    return (first_section(), delay_section(full), disk_section(), floquet_section(full))


def computed_torque(robot: Robot, model: Robot, q: Array, w: float = BANDWIDTH, hardware: Hardware | None = None) -> ClosedLoop:
    """9.10 with a triple pole at -w [rad/s]."""
    return ClosedLoop(robot, laws.ComputedTorque(3 * w**2, w**3, 3 * w), Hold(q), controller_model=model, hardware=hardware)


def loaded() -> ClosedLoop:
    """The UR5 under 9.10 with an unknown payload of 2 kg and a torque lag of 2 ms."""
    return computed_torque(arm().with_payload(PAYLOAD), arm(), POSE, hardware=Hardware(torque_lag=LAG))


# --- the most critical imperfection ------------------------------------------------------------------------------


class Limit(NamedTuple):
    """The limit of one imperfection, and the value expected in use."""

    name: str
    limit: float
    expected: float
    unit: str
    more: bool = True  #: the limit is an upper one

    @property
    def factor(self) -> float:
        """Limit over expectation (expectation over limit for a lower limit); below 1 the expected value exceeds the limit."""
        return self.limit / self.expected if self.more else self.expected / self.limit


@cache
def limits() -> tuple[Limit, ...]:
    """The limits of the loaded UR5 loop, one imperfection at a time, and of the force loop's stiffness."""
    loop = loaded()
    m = loop.linearize().margins("torque")
    return (
        Limit("gain of one torque, up", float(m.gain_increase.min()), 2.0, ""),
        Limit("gain of one torque, down", float(m.gain_reduction.max()), 0.5, "", more=False),
        Limit("phase of one torque", float(m.phase_deg.min()), 30.0, "°"),
        Limit("dead time of all torques", 1e3 * float(design.max_delay(loop)), 8.0, "ms"),
        Limit("unknown payload", PAYLOAD + float(design.max_payload(loop)), 5.0, "kg"),
        Limit("sample rate", float(design.min_sample_rate(loop)), 125.0, "Hz", more=False),
        Limit("stiffness pressed on (9.23)", stable_up_to(arm_loop(hardware=Hardware(torque_lag=LAG, force_filter=2e-3))) / 1e3, 10.0, "kN/m"),
    )


def first_section() -> Section:
    """The limit of each imperfection, the most critical first; sample rate and payload confirmed by simulation."""
    ranked = sorted(limits(), key=lambda x: x.factor)
    near = ranked[0]
    points = confirmed()
    agree = sum(stable == settled for _, _, stable, settled in points)
    finding = (
        f"The most critical imperfection is the {near.name}: the limit is {Number(near.limit, near.unit)}, and "
        f"{Number(near.expected, near.unit, exact=True)} is expected, a factor of {written(near.factor)}. "
        f"{agree} of {len(points)} simulated runs at 0.8 and 1.25 times a limit agree with it."
    )
    shown = tuple((f"{name}, {written(value)} {unit}", "stable" if stable else "unstable", "settles" if settled else "grows")
                  for (name, unit), value, stable, settled in points)  # fmt: skip
    body = (
        Paragraph(
            f"A UR5 under 9.10 (triple pole at {BANDWIDTH:g} rad/s) holds a pose with an unknown payload of {PAYLOAD:g} kg and a torque "
            "lag of 2 ms. Each imperfection is increased alone until the loop becomes unstable. The expected values are the rated payload of the "
            "arm, an interface at 125 Hz and a dead time of one sample. The limit must be beyond the expected value."
        ),
        Table(
            "Nonlinear simulations on both sides of two limits.",
            (Column("Run", numeric=False), Column("linear", numeric=False), Column("simulated", numeric=False)),
            shown,
        ),
    )
    checks = tuple((at_least if x.more else at_most)(f"limit of the {x.name}", x.expected, x.limit, x.unit) for x in ranked)
    proofs = (at_least("simulated points that agree", float(len(points)), float(agree)),)
    numbers = {"limits": {x.name: x.limit for x in ranked}, "factors": {x.name: x.factor for x in ranked}}
    return Section("The most critical imperfection", finding, body, checks, numbers, SOURCES, proofs=proofs, loop=LATE, key="breaks-first")


def confirmed() -> list[tuple[tuple[str, str], float, bool, bool]]:
    """((what, unit), value, stable by the limit, settles in simulation) at 0.8 and 1.25 of the limits of sampling and payload."""
    by_name = {x.name: x for x in limits()}
    out = []
    period, extra = 1 / by_name["sample rate"].limit, by_name["unknown payload"].limit
    for f in ASIDE:
        sampled = computed_torque(arm().with_payload(PAYLOAD), arm(), POSE, hardware=Hardware(torque_lag=LAG, sample_time=f * period))
        run = sampled.simulate(np.arange(0, 41) * f * period, initial_error=1e-4, integral="trimmed")
        out.append((("sample time", "s"), f * period, f < 1, not run.diverged and settles(run.t, run.error)))
        heavy = computed_torque(arm().with_payload(f * extra), arm(), POSE, hardware=Hardware(torque_lag=LAG))
        run = heavy.simulate(np.linspace(0, 3, 121), initial_error=1e-4, integral="trimmed", rtol=1e-4, atol=1e-7)
        out.append((("payload", "kg"), f * extra, f < 1, not run.diverged and settles(run.t, run.error)))
    return out


# --- dead time x bandwidth ---------------------------------------------------------------------------------------


def single(w: float, delay: float | None = None) -> ClosedLoop:
    """The single joint under 9.10 with a triple pole at -w [rad/s] and dead time [s]."""
    joint = robots.single_joint()
    return computed_torque(joint, joint, np.array([0.3]), w, Hardware(delay=delay))


def delay_section(full: bool = True) -> Section:
    """Largest product of dead time and bandwidth for computed torque on one joint."""
    w, T, at = np.geomspace(2, 50, 11 if full else 6), np.geomspace(2e-3, 0.5, 15 if full else 9), 10.0
    found: DelayMap = delay_map(single, T, w)
    limit = float(design.max_delay(single(at)))
    speeds = (at, 40.0) if full else (at,)
    product = np.array([w0 * (limit if w0 == at else float(design.max_delay(single(w0)))) for w0 in speeds])
    points = []
    for f in (1 / 1.5, 1.5):
        run = single(at, f * limit).simulate(np.linspace(0, 0.8, 81), initial_error=0.01, rtol=1e-4, atol=1e-7)
        points.append((f * limit, at, not run.diverged and settles(run.t, run.error)))
    agree = sum(settled == (late < limit) for late, _, settled in points)
    grown = np.arcsinh(found.growth)
    figure = Figure(
        partial(plots.stability_map, T, w, grown, xlabel="dead time [s]", ylabel="triple pole at [rad/s]", points=tuple(points)),
        "Stability region of 9.10 on the single joint from the exact roots. Circles and crosses: simulated runs.",
        f"Stability map: at {at:g} rad/s stable up to {1e3 * limit:.4g} ms of dead time; {agree} of {len(points)} simulated points agree.",
    )
    reach = ", ".join(f"at {w0:g} rad/s up to {written(1e3 * float(x) / w0)} ms" for w0, x in zip(speeds, product, strict=True))
    products = " and ".join(f"{written(float(x))} rad" for x in product)
    finding = f"The loop is stable {reach} of dead time: a product of bandwidth and dead time of {products}."
    body = (
        Equation("(s + omega)^3 = 0, quad tau -> e^(-s T) tau", "triple pole and dead time"),
        KeyFacts(
            (
                Fact("Dead time at 10 rad/s", Number(1e3 * limit, "ms")),
                *(Fact(f"Product at {w0:g} rad/s", Number(float(x), "rad")) for w0, x in zip(speeds, product, strict=True)),
            )
        ),
        figure,
    )
    proofs = (at_least("simulated points that agree", float(len(points)), float(agree)),)
    numbers = {"limit": limit, "product": product, "points": points}
    return Section("Dead time and bandwidth", finding, body, (), numbers, SOURCES, proofs=proofs, key="dead-time")


# --- all loops at once -------------------------------------------------------------------------------------------


def disk_section() -> Section:
    """One loop at a time, all loops at once, and inputs and outputs together."""
    loop = loaded()
    lin = loop.linearize()
    one, all_, both = margins_at(lin, "torque"), lin.disk_margin("torque"), lin.disk_margin(("torque", "position"))
    a, b = float(all_.alpha[0]), float(both.alpha[0])
    finding = (
        f"With one torque varied at a time, the loop tolerates {written(float(one.phase_deg.min()))}° of phase; with all six at once, "
        f"{written(float(all_.phase_deg[0]))}° or {written(float(all_.gain_db[0]))} dB; with torques and encoders together, "
        f"{written(float(both.phase_deg[0]))}° or {written(float(both.gain_db[0]))} dB."
    )

    def picture(title: str, alpha: float, gain: tuple[float, float], phase: float, w: float) -> Figure:
        return Figure(
            partial(plots.disk, gain, phase, alpha=alpha, title=title),
            f"{title}: allowed simultaneous factors of all channels; critical frequency {written(w)} rad/s.",
            f"Disk of {title.lower()}: alpha {alpha:.3g}, gains {gain[0]:.3g} to {gain[1]:.3g}, phase {phase:.3g} degrees.",
        )

    row = Row(
        tuple(
            picture(title, float(x.alpha[0]), (float(x.gain_reduction[0]), float(x.gain_increase[0])), float(x.phase_deg[0]), float(x.frequency[0]))
            for x, title in ((all_, "All torques"), (both, "Torques and encoders"))
        )
    )
    columns = (Column("Perturbed", numeric=False), Column("alpha"), Column("gain", "dB"), Column("phase", "°"), Column("critical frequency", "rad/s"))
    rows = tuple(
        (name, float(x.alpha[0]), float(x.gain_db[0]), float(x.phase_deg[0]), float(x.frequency[0]))
        for name, x in (("all torques at once", all_), ("torques and encoders at once", both))
    )
    body = (
        Table("Disk margins: independent gain and phase variations of all channels at once.", columns, rows),
        row,
        Callout(Status.INFO, "Accuracy of alpha", f"All torques: {all_.bound.value}. Torques and encoders: {both.bound.value}."),
    )
    checks = as_checks(everywhere(ASKED.check(loop, [0.0], at="torque").lines, least(lin)))
    numbers = {
        KEY: record(loop, at="torque"),
        **smallest_numbers(lin),
        "alpha_torque": a,
        "alpha_both": b,
        "phase_one": one.phase_deg[0],
        "gain_all_db": float(all_.gain_db[0]),
        "frequency": float(all_.frequency[0]),
    }
    origins = (("", f"triple pole at −{BANDWIDTH:g} rad/s: kp = 3w², ki = w³, kd = 3w"),)
    return Section("All loops at once: disk margins", finding, body, checks, numbers, SOURCES, loop=LATE, key="disk", origins=origins)


# --- stability on a moving reference -----------------------------------------------------------------------------


class Shaken(NamedTuple):
    """A loop with stable frozen poles and a period-doubling instability."""

    robot: str
    frozen: Array  #: (m,) [1/s] rightmost frozen pole along the periodic orbit
    floquet: Floquet
    simulated: float  #: growth of a small disturbance along the worst direction, over one simulated period
    t: Array
    run: Array  #: (m, n) [rad] deviation of a disturbed run from the orbit


@cache
def shaken() -> Shaken:
    """UR5 under 9.10 with a constant diagonal mass matrix and an unknown payload of 1 kg, oscillating at 5.66 rad/s."""
    try:
        model, name = robots.load("ur5"), "UR5 of example-robot-data"
    except MfcError:
        model, name = robots.ur5(), "the embedded UR5 (example-robot-data is not installed)"
    middle, w, zeta = np.array([0.0, -0.9, 1.6, -0.7, 1.57, 0.0]), 3.65, 0.16
    law = laws.ComputedTorque(w**2, 0.18 * w**2 * 2 * zeta * w, 2 * zeta * w, mass=np.diag(np.diag(model.mass(middle))))
    ref = Sinusoid(middle, np.array([0, 0.2, 0.2, 0, 0.15, 0]), 5.66)
    loop = ClosedLoop(model.with_payload(1.0, inertia=1e-3), law, ref, controller_model=model)
    found = loop.floquet()
    assert found.orbit is not None
    T = found.period
    t = np.linspace(0, T, 41)
    orbit = loop.simulate(t, x=found.orbit, rtol=1e-9, atol=1e-11)
    frozen = loop.linearize(t[:-1], about="simulation", simulation=orbit, coordinates="state").poles().real.max(axis=1)
    values, vectors = np.linalg.eig(found.Phi)
    worst = np.real(vectors[:, int(np.argmax(np.abs(values)))])
    start = found.orbit + 1e-4 * worst / np.linalg.norm(worst)
    away = loop.simulate(np.linspace(0, 4 * T, 121), x=start, rtol=1e-9, atol=1e-11)
    periods = np.linalg.norm(away.x[::30] - found.orbit, axis=1)
    return Shaken(
        name,
        np.asarray(frozen),
        found,
        float(periods[1] / periods[0]),
        away.t,
        away.x[:, 1:3] - np.stack([orbit.state([x % T])[0] for x in away.t])[:, 1:3],
    )


def floquet_section(full: bool = True) -> Section:
    """On a moving reference the Floquet multipliers of the periodic orbit decide stability; the frozen poles do not."""
    s = shaken()
    largest = s.floquet.multipliers[int(np.argmax(np.abs(s.floquet.multipliers)))]
    angle = float(np.degrees(abs(np.angle(largest))))
    frozen_says = "stable" if s.frozen.max() < 0 else "unstable"
    finding = (
        f"The frozen loop is {frozen_says} at every time (rightmost pole at most {written(float(s.frozen.max()))} 1/s). On the periodic orbit, a "
        f"disturbance is multiplied by {written(float(abs(largest)), 5)} per period at an angle of {written(angle)}°; in simulation it grows by "
        f"{written(s.simulated, 5)}."
    )
    disc = Figure(
        partial(plots.multipliers, s.floquet.multipliers),
        "Floquet multipliers of the periodic orbit, and the unit circle.",
        f"Floquet multipliers: largest modulus {abs(largest):.5g} at {angle:.3g} degrees, outside the unit circle.",
    )
    grows = Figure(
        partial(
            plots.traces,
            s.t,
            (plots.Panel("deviation [mrad]", 1e3 * s.run),),
            ("shoulder_lift", "elbow"),
            first=1,
            title="Deviation from the periodic orbit",
        ),
        "Deviation of the simulated run from the orbit over four periods, with a disturbance in the worst direction.",
        f"Deviation over four periods: it grows by {s.simulated:.5g} in the first.",
    )
    body = (
        Paragraph(
            f"{s.robot[0].upper()}{s.robot[1:]} under 9.10, oscillating at 5.66 rad/s. The controller uses the constant diagonal of the mass "
            "matrix in the middle of the path. A payload of 1 kg is unknown to it."
        ),
        KeyFacts(
            (
                Fact("Rightmost frozen pole", Number(float(s.frozen.max()), "1/s"), "along the periodic orbit"),
                Fact("Largest multiplier", Number(float(abs(largest)), "", 5), f"at {written(angle)}°"),
                Fact("Simulated growth", Number(s.simulated, "", 5), "per period"),
            )
        ),
        *((disc,) if full else ()),
        grows,
    )
    proofs = (agreement("growth per period, simulated", s.simulated, s.floquet.growth, 0.1),)
    numbers = {"frozen": s.frozen, "multipliers": s.floquet.multipliers, "growth": s.floquet.growth, "simulated": s.simulated, "angle_deg": angle}
    shown = "frozen poles do not decide the stability of a moving loop"
    return Section("Frozen poles and Floquet multipliers", finding, body, (), numbers, SOURCES, proofs=proofs, key="floquet", shown=shown)
