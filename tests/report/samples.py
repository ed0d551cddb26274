"""A loop report made by hand with python-control: one joint under PID with a current loop and a delay of a sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from mfc_analysis import plots
from mfc_analysis.report.document.document import (
    Badge,
    Callout,
    Column,
    Compare,
    Document,
    Equation,
    Fact,
    Figure,
    KeyFacts,
    Math,
    Number,
    Provenance,
    Row,
    Scope,
    Scrubber,
    Section,
    Side,
    Symbol,
    Table,
    Trace,
    found_of,
)
from mfc_analysis.requirements.line import Line, Status


@dataclass(frozen=True, eq=False)
class Margins:
    times: np.ndarray
    channels: tuple[str, ...]
    stable: np.ndarray
    gain_reduction: np.ndarray
    gain_increase: np.ndarray
    phase_deg: np.ndarray
    delay: np.ndarray
    sensitivity_peak: np.ndarray
    crossover: np.ndarray


KP, KI, KD, J, B, TI = 820.0, 1900.0, 62.0, 1.35, 2.1, 0.637e-3


def loop(w: np.ndarray) -> np.ndarray:
    s = 1j * w
    return (KP + KI / s + KD * s / (1 + s / 400)) / (J * s**2 + B * s) / (TI * s + 1) * np.exp(-s * 0.75e-3)


def history(
    m: int = 201, channels: tuple[str, ...] = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"), shift: float = 0.0
) -> Margins:
    t = np.linspace(0, 2, m)
    n = len(channels)
    phase = np.stack([60 - 12 * np.cos(2 * np.pi * t / 2 + 0.6 * j) - 3 * j - shift for j in range(n)], axis=1)
    w = np.stack([48 + 6 * np.sin(np.pi * t + j) for j in range(n)], axis=1)
    return Margins(
        t,
        channels,
        np.ones(m, bool),
        np.full((m, n), 1 / 9) + 0.01 * phase / 60,
        8 + 0.05 * phase,
        phase,
        np.radians(phase) / w,
        1 / (2 * np.sin(np.radians(phase) / 2)) + 0.2,
        w,
    )


def checks(overshoot: float = 15.9) -> tuple[Line, ...]:
    return (
        Line("phase margin", 45.0, 66.0, "°", 21.0, Status.PASS, "elbow", 0.3),
        Line("gain increase", 6.0, 24.6, "dB", 18.6, Status.PASS, "elbow", 0.3),
        Line("sensitivity peak", 1.7, 1.17, "", 0.53, Status.PASS, "elbow", 0.3, "≤"),
        Line("overshoot", 10.0, overshoot, "%", 10 - overshoot, Status.FAIL if overshoot > 10 else Status.PASS, "elbow", 0.0, "≤"),
    )


def figures() -> tuple[Figure, ...]:
    w = np.geomspace(0.1, 1e4, 400)
    L = loop(w)
    known = {"crossover": 47.6, "phase_margin": 66.0, "gain_increase": 17.0}
    p = np.array([-2.97, -14.7, -40.9, -306.8, -1621.0, -3993 + 2308j, -3993 - 2308j])
    t = np.linspace(0, 0.6, 301)
    y = 0.2 * (1 - np.exp(-18 * t) * np.cos(9 * t))
    return (
        Figure(
            partial(plots.bode, w, L, **known),
            "Open-loop frequency response with gain and phase margin.",
            "Bode plot: phase margin 66 degrees at 47.6 rad/s, gain margin 24.6 dB.",
        ),
        Figure(
            partial(plots.nyquist, w, L, sensitivity_peak=1.17, **known),
            ("Nyquist curve; the circle is the disc of radius ", Math("1/M_s"), " about −1."),
            "Nyquist plot: Ms 1.17.",
        ),
        Figure(partial(plots.poles, p, damping=0.5), "Closed-loop poles with the ray of damping 0.5.", "Pole map: slowest pole -2.97 per second."),
        Figure(
            partial(plots.step, t, y, nonlinear=(t, y * 0.97), torque=(t, 60 * np.exp(-20 * t)), torque_limit=60, target=0.2, index=2),
            "Step of 200 mrad.",
            "Step response: overshoot 15.9 percent.",
        ),
        Figure(
            partial(plots.margin_history, history(), {"phase_deg": 45.0, "sensitivity_peak": 1.7, "delay": 2e-3}),
            "Margins along the path.",
            "Margins against time: smallest phase margin 33 degrees.",
        ),
    )


def document(overshoot: float = 15.9, title: str = "Joint 3 position loop") -> Document:
    bode, nyquist, pole_map, step, path = figures()
    p = (-2.97 + 0j, -14.7 + 0j, -40.9 + 0j, -306.8 + 0j, -3993 + 2308j)
    one = Section("Requirements", "The overshoot is 15.9 %, required: at most 10 %.", checks=checks(overshoot), loop="elbow PID")
    two = Section(
        "Loop",
        body=(
            Equation(
                r"L(s) = (K_p + K_i/s + (K_d s)/(1 + s slash N)) dot 1/(J s^2 + b s) dot 1/(T_i s + 1) dot e^(-s T_d)",
                "open loop transfer function",
                "1",
            ),
            Equation(
                r"bold(M)(bold(q)) dot.double(bold(q)) + bold(C)(bold(q), dot(bold(q))) dot(bold(q)) + "
                r'hat(bold(g))(bold(q)) = bold(tau) + bold(J)^top bold(f)_"ext"',
                "equation of motion",
                "2",
            ),
            Equation(r"M_s = max_omega abs(1/(1 + L(j omega))) = 1.17", "sensitivity peak", "3"),
            KeyFacts(
                (
                    Fact("Phase margin", Number(66.0, "°"), "at 47.6 rad/s"),
                    Fact("Gain margin", Number(24.6, "dB")),
                    Fact("Delay margin", Number(23.9, "ms")),
                )
            ),
            Table(
                "Parameters.",
                (Column(Math("K_p"), "Nm/rad"), Column(Math("K_i"), "Nm/(rad s)"), Column(Math("K_d"), "Nm s/rad")),
                ((820.0, 1900.0, 62.0),),
            ),
        ),
    )
    h = history()
    turn = 1 + 0.3 * np.sin(np.pi * h.times[:, None] + np.arange(7))
    moving = Scrubber(
        h.times,
        turn * np.array([-2.97, -14.7, -40.9, -306.8, -162 + 90j, -162 - 90j, -1600]),
        (
            Trace("PM", "°", h.phase_deg.min(axis=1), 45.0),
            Trace("GM", "dB", 20 * np.log10(h.gain_increase.min(axis=1)), 6.0),
            Trace("Ms", "", h.sensitivity_peak.max(axis=1), 1.7),
        ),
        int(h.phase_deg.min(axis=1).argmin()),
        "Poles (grey: their paths) and margins at one time of the path.",
        "Smallest phase margin 33 degrees at t = 1 s.",
    )
    three = Section("Frequency response", ("The loop crosses 0 dB at 47.6 rad/s; ", Math("M_s = 1.17"), "."), (Row((bode, nyquist)), path, moving))
    four = Section(
        "Poles and time response",
        body=(
            Row((pole_map, step)),
            Table("Closed-loop poles, slowest first.", (Column("Pole", "1/s"), Column("Damping")), tuple((z, -z.real / abs(z)) for z in p)),
        ),
        numbers={"poles": np.array(p), "gain_increase": np.inf},
    )
    return Document(
        title,
        "PID with current loop and sample delay",
        (one, two, three, four),
        "joint-3",
        Scope(("URDF of the arm, 2 kg payload",), ("rigid joints",), ("201 points of the path",), ("joint flexibility",)),
        Provenance((("mfc_analysis", "0.1.0"), ("Input SHA-256", "224902f45ecebf18")), "mfc-analysis report joint3.toml"),
        (Symbol(Math("K_p"), "proportional gain", "Nm/rad"), Symbol(Math("dot(q)"), "joint rates", "rad/s")),
    )


def one_loop(name: str, phase: float, asked: float = 45.0) -> Section:
    """A loop's section with one figure and two checks: unstable if ``phase`` is NaN."""
    status = Status.PASS if phase >= asked else Status.FAIL
    found = (
        Line("phase margin", asked, phase, "°", phase - asked, status, "elbow", 0.75),
        Line(
            "gain reduction", 6.0, 19.08 if phase == phase else float("nan"), "dB", 13.08 if phase == phase else float("nan"), status, "elbow", 0.75
        ),
    )
    values = np.array([-3.0 + 4j, -3.0 - 4j, -5.0]) if phase == phase else np.array([1.0, -3.0])
    return Section(
        f"Computed torque: {name}",
        (f"{name}: the phase margin is ", str(found_of(found[0])), "; required: ", Math("phi_m >= 45 degree"), "."),
        (
            Equation(
                r"tau = hat(M)(q)(dot.double(q)_d + K_p e + K_i integral e + K_d dot(e)) + hat(h)(q, dot(q))",
                "torque of computed torque control",
                "9.10",
            ),
            Figure(partial(plots.poles, values), "Poles.", f"Pole map of {name}: slowest pole {values[0].real:.3g} per second."),
        ),
        found,
        {"phase": phase, "poles": values},
        ("chapter, eq. 9.10",),
        loop=name,
    )


def side(title: str, badge: Badge | None, source: str, phase: float, poles: np.ndarray) -> Side:
    facts = KeyFacts((Fact("Phase margin", Number(phase, "°", undefined="unstable")),))
    drawing = Figure(partial(plots.poles, poles), "Poles.", f"Pole map, {title}: rightmost pole {poles.max():.3g} per second.")
    return Side(title, badge, (Equation(source, f"9.10 {title}", "9.10"), facts, drawing))


def misprint() -> Section:
    printed = side("As printed", Badge.DEMO, r"tau = hat(M) a + hat(h)(q_d, dot(q)_d)", float("nan"), np.array([0.4, -3.0]))
    standard = side("Standard", None, r"tau = hat(M) a + hat(h)(q, dot(q))", 62.0, np.array([-3.0, -5.0]))
    remark = Callout(Status.WATCH, "Read this", "The printed form is kept as form='printed'.")
    return Section("Effect of the misprint of 9.10", body=(Compare(printed, standard, "Every margin: the printed form is unstable."), remark))


def chapter(phase: float = 62.0, hostile: str = "UR5 + 2 kg") -> Document:
    sections = (one_loop(hostile, 51.2), one_loop("single joint", phase), one_loop("planar 2R", 47.0), misprint())
    return Document(
        "Motion control", "Equations 9.1 to 9.13", sections, "chapter", provenance=Provenance((("python", "3.11"),), "mfc-analysis report")
    )
