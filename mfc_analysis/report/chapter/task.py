"""Motion control in tool space: equations 9.5 and 9.14 to 9.16."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from mfc_analysis import laws, plots, robots
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import MfcError
from mfc_analysis.linearization.linearization import Linearization
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.force import POSE, arm, tiny
from mfc_analysis.report.chapter.pieces import LYNCH, SICILIANO, at_most, in_words, margins_at, poles_table, response, validated
from mfc_analysis.report.chapter.smallest_margins import least, smallest_numbers, tightest
from mfc_analysis.report.document.document import Column, Equation, Fact, Figure, KeyFacts, Math, Number, Paragraph, Section, Table, Text, written
from mfc_analysis.report.loops.checks import checks as as_checks, everywhere
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.requirements.requirements import Requirements
from mfc_analysis.trajectories import ToolHold, ToolSinusoid, from_tool_path

SOURCES = (LYNCH, SICILIANO)
FAR = np.array(
    [-0.04, -1.25, 1.5, -2.16, -0.7, 2.19]
)  #: [rad] a pose 2.3 rad and 0.32 m away from the desired one, with a path without singularities
SLOW = 1.0  #: [1/s] kp of 9.5 on the moving path
GAINS: dict[str, Any] = {"kp": 100.0, "ki": 100.0, "kd": 20.0}  #: of 9.16
ASKED = Requirements(phase_deg=45.0, gain_increase_db=6.0, gain_reduction_db=6.0, sensitivity_peak=2.0)


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections of 9.5 and 9.14-9.16 for the chapter report; not ``full``: without pictures that repeat what others show."""
    parts = (velocity_section, coordinates_section, joint_path_section, dynamics_section, torque_section, redundant_section)
    return tuple(part(full) for part in parts)


@cache
def path() -> ToolSinusoid:
    """A tool path that oscillates by 8 and 5 cm and by 0.4 rad about the pose, at 6 rad/s."""
    return ToolSinusoid(arm().pose(POSE), np.array([0.0, 0.08, 0.05]), 6.0, axis=(1, 0, 0), angle=0.4)


def times(count: int) -> Array:
    """``count`` times over one period of the path."""
    return np.asarray(np.linspace(0, path().period or 1.0, count + 1)[:-1])


# --- 9.5 ---------------------------------------------------------------------------------------------------------


def velocity_section(full: bool = True) -> Section:
    """9.5 from a large error: it decays as exp(-k t), exactly."""
    k = 4.0
    loop = ClosedLoop(arm(), laws.TaskVelocity(k), ToolHold(arm().pose(POSE)), q_start=POSE)
    run = loop.simulate(np.linspace(0, 1.2, 121), q=FAR, rtol=1e-9, atol=1e-11)
    first = run.error[0]
    exact = np.exp(-k * run.t)[:, None] * first
    away = float(np.abs(run.error - exact).max())
    size = np.linalg.norm(run.error[:, 3:], axis=1), np.linalg.norm(run.error[:, :3], axis=1)
    finding = (
        f"From an initial error of {written(float(size[0][0]))} rad and {written(float(size[1][0]))} m, the simulated error follows exp(−{k:g} t) "
        "exactly. In logarithmic coordinates the law is linear for all rotation errors below π."
    )
    figure = Figure(
        partial(
            plots.traces, run.t, (plots.Panel("rotation [rad]", size[0], beside=np.linalg.norm(exact[:, 3:], axis=1)),
                                  plots.Panel("position [m]", size[1], beside=np.linalg.norm(exact[:, :3], axis=1))),
            said=("simulated", "exp(−k t)"), title="9.5 from a large error",
        ),
        "Size of the tool's error on the UR5; the dashed lines are the closed form.",
        f"Error over time: from {size[0][0]:.3g} rad and {size[1][0]:.3g} m to {size[0][-1]:.2g} rad and {size[1][-1]:.2g} m in {run.t[-1]:.2g} s.",
    )  # fmt: skip
    lin = loop.linearize()
    body = (
        Equation(laws.TaskVelocity.typst, "tool velocity control", "9.5"),
        Equation('X_e = log(X^(-1) X_d), quad dot(X)_e = -k X_e quad "for" quad K_p = k, K_i = 0', "the error in the logarithm decays exactly"),
        figure,
        *((response(lin, "command", 0, "UR5, 9.5, vx", span=(1e-1, 1e2)),) if full else ()),
    )
    m = margins_at(lin, "command")
    proofs = (
        at_most("deviation from theory", 1e-6, 100 * away / float(np.abs(first).max()), "%", "error over time"),
        at_most("deviation from theory", 1e-6, float(np.abs(m.phase_deg[0] / 90 - 1).max()) * 100, "%", "phase margin 90°"),
        at_most("deviation from theory", 1e-6, float(np.abs(m.delay[0] / (np.pi / (2 * k)) - 1).max()) * 100, "%", "delay margin π/(2k)"),
    )
    checks = as_checks(everywhere(ASKED.check(loop, [0.0], at="command").lines, least(lin)))
    numbers = {
        "times": run.t,
        "error": run.error,
        "departure": away,
        "phase_deg": m.phase_deg[0],
        "delay": m.delay[0],
        "poles": lin.poles()[0],
        "validation": validated(loop, 1.0 if full else 0.4),
        KEY: record(loop, at="command"),
        **smallest_numbers(lin),
    }
    return Section(
        "Tool velocity control: 9.5",
        finding,
        body,
        checks,
        numbers,
        SOURCES,
        proofs=proofs,
        loop="9.5 tool velocity, UR5",
        key="tool-velocity",
        origins=(("", f"bandwidth of {k:g} rad/s: kp = {k:g}"),),
    )


class Frozen(NamedTuple):
    """Rightmost frozen poles along the moving path in both coordinates, and the true growth over one period."""

    t: Array
    error: Array  #: (m,) [1/s] rightmost, coordinates (X_e, ...)
    state: Array  #: (m,) [1/s] rightmost, coordinates (q, ...)
    truth: float  #: [1/s] growth per second along the periodic orbit (Floquet)


@cache
def frozen(equation: str) -> Frozen:
    """Of 9.5 or 9.16 on the moving path with an exact model."""
    law = laws.TaskVelocity(SLOW) if equation == "9.5" else laws.TaskComputedTorque(**GAINS)
    loop, t = ClosedLoop(arm(), law, path(), q_start=POSE), times(60)
    found = [loop.linearize(t, coordinates=c).poles().real.max(axis=1) for c in ("error", "state")]
    return Frozen(t, found[0], found[1], loop.floquet().exponent)


def coordinates_section(full: bool = True) -> Section:
    """On a moving tool path the frozen poles depend on the coordinates; the growth along the orbit does not."""
    two = {name: frozen(name) for name in ("9.5", "9.16")}
    slow = {"9.5": -SLOW, "9.16": float(np.roots([1, GAINS["kd"], GAINS["kp"], GAINS["ki"]]).real.max())}
    f = two["9.5"]
    finding = (
        f"On the moving path, the rightmost frozen pole of 9.5 varies in joint coordinates from {written(float(f.state.min()))} to "
        f"{written(float(f.state.max()))} 1/s; in error coordinates it stays at {written(float(f.error.max()))} 1/s. Over one period of the "
        f"orbit the error decays at {written(f.truth)} 1/s, in agreement with the error coordinates."
    )
    panels = tuple(plots.Panel(f"{name}: Re s [1/s]", np.stack([x.error, x.state], axis=1)) for name, x in two.items())
    figure = Figure(
        partial(plots.traces, f.t, panels, ("error coordinates", "state coordinates"), title="Rightmost frozen pole"),
        "The same loops, linearised at the same times, in two coordinate systems.",
        f"Rightmost frozen poles over one period: 9.5 {f.error.max():.3g} in error coordinates, up to {f.state.max():.3g} in state coordinates; "
        f"9.16 {two['9.16'].error.max():.3g} and up to {two['9.16'].state.max():.3g} per second.",
    )
    columns = (
        Column("Law", numeric=False), Column("error coordinates", "1/s"), Column("state, min", "1/s"), Column("state, max", "1/s"),
        Column("periodic orbit", "1/s"), Column("design", "1/s"),
    )  # fmt: skip
    rows = tuple((name, float(x.error.max()), float(x.state.min()), float(x.state.max()), x.truth, slow[name]) for name, x in two.items())
    body = (
        Paragraph("Both laws use an exact model on a tool path that oscillates and rotates, so the error obeys the design polynomial on any path."),
        Table("Rightmost pole: frozen in both coordinates, and growth per second along the periodic orbit (Floquet).", columns, rows),
        figure,
    )
    proofs = tuple(
        at_most("deviation from theory", 1e-3, 100 * abs(getattr(x, kind) / slow[name] - 1), "%", f"{name}, {word}")
        for name, x in ((n, y._replace(error=y.error.max())) for n, y in two.items())
        for kind, word in (("error", "error coordinates"), ("truth", "periodic orbit"))
    )
    numbers = {name: {"error": x.error, "state": x.state, "floquet_exponent": x.truth, "design": slow[name]} for name, x in two.items()}
    return Section("Coordinates on a moving tool path", finding, body, (), numbers, SOURCES, proofs=proofs, key="coordinates")


# --- 9.14 and 9.15 -----------------------------------------------------------------------------------------------


@cache
def followed() -> tuple[Array, Array, Array, Array, Array, Array]:
    """9.14 along the path: (t, q, v, a) and the resulting tool twist and its rate, each (m, ...)."""
    t = np.asarray(np.linspace(0, path().period or 1.0, 61))
    point = from_tool_path(arm(), path(), POSE, t)(t)
    q, v, a = (np.asarray(x) for x in point)
    J = arm().jacobian(q)
    drift = apply(arm().jacobian_rate(q, v), v)
    return t, q, v, a, apply(J, v), apply(J, a) + drift


def apply(matrix: Array, x: Array) -> Array:
    """matrix (m, k, n) on x (m, n)."""
    return np.asarray((matrix @ x[..., None])[..., 0])


def joint_path_section(full: bool = True) -> Section:
    """9.14: the joint path of a tool path, checked by forward kinematics."""
    t, q, v, a, V, dV = followed()
    asked = path()(t)
    missed = {
        "pose": float(np.abs(arm().pose(q) - asked.X).max()),
        "twist": float(np.abs(V - asked.V).max()),
        "rate of twist": float(np.abs(dV - asked.dV).max()),
    }
    loop = ClosedLoop(arm(), laws.ComputedTorque(**GAINS), from_tool_path(arm(), path(), POSE, t))
    run = loop.simulate(t)
    finding = (
        "The joint path reproduces the tool's pose, its twist and the rate of its twist. Under 9.10 in joint space its largest error is "
        f"{written(tiny(float(np.abs(run.error).max())), 2)} rad; the fastest joint moves at {written(float(np.abs(v).max()))} rad/s."
    )
    names = arm().joint_names
    figure = Figure(
        partial(
            plots.traces,
            t,
            (plots.Panel("q [rad]", q - q[0]), plots.Panel("v [rad/s]", v), plots.Panel("a [rad/s²]", a)),
            names,
        ),
        "Joint motion for one period of the tool path; positions relative to the start.",
        f"Joint motion over one period: largest speed {np.abs(v).max():.3g} rad/s, largest acceleration {np.abs(a).max():.3g} rad/s².",
    )
    body = (
        Equation(
            'q = f^(-1)(X), quad dot(q) = J_b^dagger "V"_b, quad dot.double(q) = J_b^dagger (dot("V")_b - dot(J)_b dot(q))',
            "inverse kinematics",
            "9.14",
        ),
        *((figure,) if full else ()),
    )
    proofs = (at_most("round trip of 9.14", 1e-9, max(missed.values()), "", "pose, twist and its rate"),)
    numbers = {"missed": missed, "q": q, "v": v, "a": a}
    return Section("A tool path in joint space: 9.14", finding, body, (), numbers, SOURCES, proofs=proofs, key="joint-path")


def dynamics_section(full: bool = True) -> Section:
    """9.15: the equation of motion in tool space agrees with 9.7."""
    _, q, v, a, _, dV = followed()
    Lambda, eta = arm().task_inertia(q), arm().task_bias(q, v)
    tau = apply(np.swapaxes(arm().jacobian(q), 1, 2), apply(Lambda, dV) + eta)
    wanted = apply(arm().mass(q), a) + arm().bias(q, v)
    away = float(np.abs(tau - wanted).max())
    weight = np.linalg.eigvalsh(Lambda[:, :3, :3])
    finding = (
        f"Along the path both forms give the same torques (largest torque {written(float(np.abs(wanted).max()))} Nm). The "
        f"effective mass at the tool is {written(float(weight.min()))} to {written(float(weight.max()))} kg, depending on the direction."
    )
    body = (
        Equation(
            '"F"_b = Lambda(q) dot("V")_b + eta(q, "V"_b), quad Lambda = J_b^(-top) M J_b^(-1), quad tau = J_b^top "F"_b',
            "dynamics in tool space",
            "9.15",
        ),
        KeyFacts(
            (
                Fact("Smallest effective mass", Number(float(weight.min()), "kg"), "translation"),
                Fact("Largest effective mass", Number(float(weight.max()), "kg"), "translation"),
            )
        ),
    )
    proofs = (at_most("deviation from theory", 1e-8, 100 * away / float(np.abs(wanted).max()), "%", "tool form and 9.7"),)
    numbers = {"departure": away, "task_mass": weight}
    return Section("Dynamics in tool space: 9.15", finding, body, (), numbers, SOURCES, proofs=proofs, key="tool-dynamics")


# --- 9.16 --------------------------------------------------------------------------------------------------------


def torque_section(full: bool = True) -> Section:
    """9.16: the error polynomial with an exact model, and the margins with an unknown payload and a torque lag."""
    t = times(12)
    law = laws.TaskComputedTorque(**GAINS)
    exact = ClosedLoop(arm(), law, path(), q_start=POSE).linearize(t)
    six = np.polynomial.polynomial.polypow([GAINS["ki"], GAINS["kp"], GAINS["kd"], 1.0], 6)[::-1]
    away = float(max(np.abs(np.poly(A) / six - 1).max() for A in exact.A))
    real = ClosedLoop(arm().with_payload(2.0), law, path(), controller_model=arm(), q_start=POSE, hardware=Hardware(torque_lag=2e-3))
    lin = real.linearize(t)
    still = ClosedLoop(arm().with_payload(2.0), law, ToolHold(arm().pose(POSE)), controller_model=arm(), q_start=POSE)
    at = {point: margins_at(lin, point) for point in lin.opened.points}
    worst = {point: m.worst().phase_deg for point, m in at.items()}
    finding = (
        f"With an exact model the error polynomial is the design polynomial to the sixth power at all {len(t)} times. With an "
        f"unknown payload of 2 kg and a torque lag of 2 ms {tightest(lin)}."
    )
    i = int(np.argmin(np.abs(t - worst["torque"][1])))
    j = at["torque"].channels.index(worst["torque"][2])
    columns = (Column("Analysis point", numeric=False), Column("phase", "°"), Column("gain down", "dB"), Column("delay", "ms"), Column("peak Ms"))
    rows = tuple(
        (
            point,
            Number(float(m.phase_deg.min())),
            Number(float(m.gain_reduction_db.min())),
            Number(1e3 * float(m.delay.min())),
            Number(float(m.sensitivity_peak.max())),
        )
        for point, m in at.items()
    )  # fmt: skip
    history = Figure(
        partial(plots.margin_history, at["torque"], {"phase_deg": 45.0, "sensitivity_peak": 2.0}, metrics=("phase_deg", "sensitivity_peak")),
        "Margins at the torques along one period, unknown payload of 2 kg.",
        f"Margins along the path: smallest phase margin {worst['torque'][0]:.3g} degrees at {worst['torque'][1]:.3g} s ({worst['torque'][2]}).",
    )
    body = (
        Equation(laws.TaskComputedTorque.typst, "computed torque in tool space", "9.16"),
        Equation("(s^3 + k_d s^2 + k_p s + k_i)^6 = 0", "error polynomial of the exact model"),
        Table("Smallest margins along the path, unknown payload of 2 kg, torque lag 2 ms.", columns, rows),
        *((history,) if full else ()),
        response(lin, "torque", j, f"UR5, 9.16, {worst['torque'][2]}", i),
    )
    proofs = (at_most("deviation from theory", 1e-6, 100 * away, "%", "error polynomial"),)
    checks = as_checks(everywhere(ASKED.check(real, t, at="torque").lines, least(lin)))
    numbers = {
        KEY: record(real, t, "torque"),
        **smallest_numbers(lin),
        "times": t,
        "polynomial_departure": away,
        "phase_deg": {p: m.phase_deg for p, m in at.items()},
        "coordinates": lin.coordinates,
        "poles": lin.poles()[i],
        "worst": {"time": float(t[i])},
        "validation": validated(still, 0.2),
    }
    note: Text = ("Poles and margins are in ", Math("(X_e, V_e, z)", "error coordinates"), ", frozen at each time.")
    return Section(
        "Computed torque in tool space: 9.16",
        finding,
        (*body, Paragraph(note)),
        checks,
        numbers,
        SOURCES,
        proofs=proofs,
        loop="9.16 tool computed torque, UR5 + 2 kg",
        key="tool-torque",
        origins=(("", "chosen: poles at −1.33, −5.87 and −12.8 1/s"),),
    )


def said(lin: Linearization) -> str:
    """'is stable', 'drifts' or 'is unstable', at the first time."""
    word = in_words(bool(lin.stable[0]), bool(lin.drifts[0]))
    return word if word == "drifts" else f"is {word}"


def redundant_section(full: bool = True) -> Section:
    """9.16 on a seven-joint arm, with and without null-space damping."""
    title = "Seven joints: 9.16 with a null space"
    try:
        robot = robots.load("panda")
    except MfcError as why:
        return Section(title, f"Left out: {why}", key="redundant")
    q = np.array([0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8])
    X = robot.pose(q)
    forms = {
        "0 1/s": laws.TaskComputedTorque(**GAINS),
        "10 1/s": laws.TaskComputedTorque(**GAINS, null_damping=10.0),
        "10 1/s, Euclidean inverse": laws.TaskComputedTorque(**GAINS, null_damping=10.0, inverse="euclidean"),
    }
    loops = {name: ClosedLoop(robot, law, ToolHold(X), q_start=q) for name, law in forms.items()}
    lins = {name: loop.linearize() for name, loop in loops.items()}
    without, damped, _ = lins.values()
    start = q + np.array([0.2, 0, 0, 0, 0, 0, 0])
    run, other = (loops[name].simulate(np.linspace(0, 1, 51), q=start) for name in list(forms)[1:])
    apart = float(np.abs(run.q[-1] - other.q[-1]).max())
    finding = (
        f"Without null-space damping the Panda's loop {said(without)}; with 10 1/s it {said(damped)}, "
        f"with {int(damped.neutral[0])} slow root: the posture in the null space."
    )
    columns = (
        Column("Null-space damping", numeric=False),
        Column("verdict", numeric=False),
        Column("slow roots that do not drift"),
        Column("coordinates", numeric=False),
    )
    rows = tuple((name, in_words(bool(x.stable[0]), bool(x.drifts[0])), int(x.neutral[0]), x.coordinates) for name, x in lins.items())
    body = (
        Table("Panda holding its tool pose.", columns, rows),
        *((poles_table([(name, x.poles()[0]) for name, x in lins.items()], 4, "The slowest poles that are not slow roots."),) if full else ()),
        Paragraph(
            f"With an initial error of 0.2 rad at the first joint, the tool error decreases from {written(float(np.linalg.norm(run.error[0])))} to "
            f"{written(float(np.linalg.norm(run.error[-1])), 2)} in 1 s; the arm comes to rest in another posture. "
            "Both inverses give the tool the same "
            f"acceleration. They differ in the self-motion: after 1 s the postures are {written(apart, 2)} rad apart at the joint that differs most."
        ),
    )
    slowest = float(np.roots([1, GAINS["kd"], GAINS["kp"], GAINS["ki"]]).real.max())
    found = float(damped.poles()[0].real[np.abs(damped.poles()[0]) >= 1 / damped.horizon].max())
    proofs = (at_most("deviation from theory", 1e-6, 100 * abs(found / slowest - 1), "%", "slowest pole"),)
    numbers = {
        "neutral": [int(x.neutral[0]) for x in lins.values()],
        "drifts": [bool(x.drifts[0]) for x in lins.values()],
        "poles": damped.poles()[0],
    }
    return Section(title, finding, body, (), numbers, SOURCES, proofs=proofs, key="redundant")
