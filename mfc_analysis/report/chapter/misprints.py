"""The effect of the misprints in the joint-space equations: 9.1, 9.3, 9.9, 9.10 and 9.12, as printed and in standard form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from mfc_analysis import laws, plots
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.report.chapter.arms import Arm, Designs, arms, decibels, triple_pole
from mfc_analysis.report.document.document import (
    Badge,
    Column,
    Compare,
    Equation,
    Fact,
    Figure,
    KeyFacts,
    Math,
    Number,
    Paragraph,
    Row,
    Section,
    Side,
    Table,
    written,
)
from mfc_analysis.report.loops.view import View, place_words
from mfc_analysis.requirements.line import Status
from mfc_analysis.trajectories.joint import Hold

OFFSET = 0.05  #: [rad] initial error of each comparison
UPRIGHT = (np.pi / 2, 0.0)  #: [rad] the two-link arm standing on its base
SLOW = 0.8  #: fraction of the slowest triple pole for which the printed form of 9.12 is stable


@dataclass(frozen=True, eq=False)
class Form:
    """One form of an equation on one arm: its loop, and a run of it."""

    title: str
    source: str  #: Typst
    view: View
    run: Any  #: Simulation

    @property
    def status(self) -> Status:
        """Whether the loop is stable, regardless of its margins; INFO without feedback."""
        line = self.view.verdict.line("stable")
        return Status(line.status.value)

    @property
    def rightmost(self) -> float:
        """Largest real part [1/s] of all poles."""
        return float(self.view.evidence.spectrum.rates.real.max())

    @property
    def phase(self) -> float:
        """Smallest phase margin [deg]; NaN unstable, inf without a crossover."""
        return float(self.view.margins.phase_deg.min())

    @property
    def largest(self) -> float:
        """Largest error of the run [rad]."""
        return float(np.abs(self.run.error).max())

    @property
    def last(self) -> float:
        """Largest error at its end [rad]."""
        return float(np.abs(self.run.error[-1]).max())

    def numbers(self) -> dict[str, Any]:
        """For JSON."""
        m, i = self.view.margins, self.view.worst.row
        return {
            "poles": self.view.poles[i],
            "rightmost": self.rightmost,
            "stable": bool(self.view.lin.stable.all()),
            "phase_deg": self.phase,
            "gain_reduction": float(m.gain_reduction.max()),
            "largest_error": self.largest,
            "last_error": self.last,
        }


def sections(designs: Designs | None = None, *, full: bool = True) -> tuple[Section, ...]:
    """One section: a comparison for each misprinted equation; not ``full``: a table of what each costs."""
    given = designs or Designs()
    inner = (velocity_feedforward(given), velocity_pi(given), torque_feedforward(given), computed_torque(given), triple(given))
    missed = [s.title for s in inner if s.numbers["standard"]["stable"] and not s.numbers["printed"]["stable"]]
    turned = f"the following make a stable loop unstable: {', '.join(missed)}" if missed else "none makes a stable loop unstable"
    finding = f"Of {len(inner)} misprints in the joint-space equations, {turned}."
    title, shown = "Effect of the misprints in the joint-space equations", "the equations as printed"
    if full:
        return (Section(title, finding, sections=inner, key="misprints", shown=shown),)
    figure = next(f for b in inner[-1].body if isinstance(b, Row) for f in b.figures)
    return (Section(title, finding, (costs_table(inner), Row((figure,))), sections=folded(inner), key="misprints", shown=shown, folded=True),)


def costs_table(inner: Iterable[Section]) -> Table:
    """Each misprint: the equation as printed, as meant, and what the difference costs."""
    rows = []
    for section in inner:
        compare = next(b for b in section.body if isinstance(b, Compare))
        one, other = (next(b.source for b in side.body if isinstance(b, Equation)) for side in (compare.left, compare.right))
        where = section.title.partition(":")[0].partition(" on the ")[0]
        rows.append((where, (Math(one), "; standard: ", Math(other)), compare.cost))
    heads = (("Eq.", 1.3), ("As printed; standard", 4.5), ("Effect", 6.5))
    return Table("The misprints and what each costs.", tuple(Column(x, numeric=False, share=share) for x, share in heads), tuple(rows))


def folded(inner: Iterable[Section]) -> tuple[Section, ...]:
    """The sections without their pages: numbers and sources stay."""
    return tuple(replace(section, body=(), checks=()) for section in inner)


def _section(equation: str, what: str, arm: Arm, printed: Form, standard: Form, cost: str, more: str = "") -> Section:
    compare = Compare(_side(printed), _side(standard), cost)
    t = printed.run.t if len(printed.run.t) <= len(standard.run.t) else standard.run.t
    a, b = standard.run.error[: len(t)], printed.run.error[: len(t)]
    figure = Figure(
        partial(plots.traces, t, (plots.Panel("error [rad]", a, beside=b),), arm.robot.joint_names, said=("standard", "as printed")),
        f"The nonlinear {arm.name} on its path, initial error {written(OFFSET, exact=True)} rad: largest error {written(standard.largest)} rad in the"
        f" standard form, {written(printed.largest)} rad as printed.",
        f"Errors of both forms of {equation}: at most {written(standard.largest)} rad (standard) and {written(printed.largest)} rad (printed).",
    )
    body = (compare, figure, *((Paragraph(more),) if more else ()))
    return Section(
        f"{equation} on the {arm.name}",
        what,
        body,
        numbers={"printed": printed.numbers(), "standard": standard.numbers()},
        sources=("chapter, eq. " + equation, *standard.view.loop.law.sources),
        key=f"misprint-{equation}",
    )


def _side(form: Form) -> Side:
    m = form.view.margins
    w, worst = form.view.margins.worst(), form.view.worst
    without = "unstable" if form.rightmost > 1e-9 else "no feedback"
    facts = KeyFacts(
        (
            Fact("Rightmost pole", Number(form.rightmost, "1/s")),
            Fact(
                "Phase margin",
                Number(form.phase, "°", infinite="no crossover", undefined=without),
                place_words(w.phase_deg[2], w.phase_deg[1], len(m.times)) if np.isfinite(form.phase) else "",
            ),
            Fact("Gain margin, down", Number(float(-decibels(m.gain_reduction.max())), "dB", infinite="unlimited", undefined=without)),
            Fact("Largest error", Number(form.largest, "rad")),
        )
    )
    figure = Figure(
        partial(plots.poles, form.view.poles[worst.row]),
        f"Poles, t = {written(round(worst.time, 4), exact=True)} s.",
        f"Pole map, {form.title.lower()}: rightmost pole {written(form.rightmost)} per second.",
    )
    badge = Badge.DEMO if form.title == "As printed" else None
    said = {Status.FAIL: "not stable", Status.WATCH: "drifts"}.get(form.status, "")
    return Side(form.title, badge, (Equation(form.source, f"{form.view.name}, {form.title.lower()}"), facts, figure), said)


def _form(title: str, source: str, loop: ClosedLoop, arm: Arm, run: Callable[[ClosedLoop], Any] | None = None) -> Form:
    name = f"{loop.law.equation} {title.lower()}"
    t = np.linspace(0.0, 4.0, 201)
    made = loop.simulate(t, initial_error=OFFSET) if run is None else run(loop)
    return Form(title, source, View(name, loop, np.zeros(1) if arm.ref.is_hold else arm.times), made)


def _two(designs: Designs, equation: str, arm: Arm, sources: tuple[str, str], law: Any = None) -> tuple[Form, Form]:
    base = designs.loop(equation, arm) if law is None else replace(designs.loop(equation, arm), law=law)
    printed = replace(base, law=base.law.changed(form="printed"))
    return _form("As printed", sources[0], printed, arm), _form("Standard", sources[1], base, arm)


def _times(a: float, b: float) -> str:
    """The ratio of a to b as text."""
    if not np.isfinite(a) or not np.isfinite(b) or b == 0:
        return f"{written(a)} instead of {written(b)}"
    ratio = a / b
    said = "the same to 1 %" if abs(ratio - 1) < 0.01 else f"{written(ratio)} times as much" if ratio > 1 else f"{written(100 * (1 - ratio))} % less"
    return f"{written(a)} instead of {written(b)} rad, {said}"


def velocity_feedforward(designs: Designs) -> Section:
    """9.1: prints q_d instead of its derivative; the joint velocity is the desired angle."""
    arm = arms()[0]
    loop = designs.loop("9.1", arm)
    t = np.linspace(0.0, 4.0, 201)

    def printed_run(loop: ClosedLoop) -> Any:  # u = q_d is u = v_d with q_d - v_d added to it
        return loop.simulate(t, initial_error=OFFSET, disturbance=lambda s: loop.ref(s).q - loop.ref(s).v)

    printed = _form("As printed", "u = q_d", loop, arm, printed_run)
    standard = _form("Standard", "u = dot(q)_d", loop, arm)
    cost = (
        f"The desired position is commanded as a velocity: after 4 s the error is {written(printed.last)} rad instead of {written(standard.last)}"
        f" rad (initial error {written(OFFSET, exact=True)} rad). The two sides of the equation have different units. The poles"
        " are the same because neither form has feedback."
    )
    return _section("9.1", "The page prints the desired position instead of its derivative.", arm, printed, standard, cost)


def velocity_pi(designs: Designs) -> Section:
    """9.3: prints the integral without its gain, as if Ki were the identity."""
    arm = arms()[0]
    sources = ("u = K_p e + integral e dif t", "u = K_p e + K_i integral e dif t")
    printed, standard = _two(designs, "9.3", arm, sources)
    ki = float(designs.law("9.3", arm).gains()["ki"].matrix(1)[0, 0])
    slow = printed.rightmost / standard.rightmost
    cost = (
        f"The integral gain is 1 1/s² instead of the intended {written(ki, exact=True)} 1/s². The slowest pole moves from "
        f"{written(standard.rightmost)}"
        f" to {written(printed.rightmost)} 1/s, errors take {written(1 / slow)} times as long to decay, and the phase margin changes from"
        f" {written(standard.phase)}° to {written(printed.phase)}°."
    )
    return _section("9.3", "The page prints the integral of the error without K_i, as if K_i were the identity.", arm, printed, standard, cost)


def torque_feedforward(designs: Designs) -> Section:
    """9.9: prints the acceleration of the error instead of the desired one; the inertia doubles."""
    arm = arms()[0]
    sources = ("tau = hat(M)(q_d) dot.double(e) + hat(h)(q_d, dot(q)_d)", "tau = hat(M)(q_d) dot.double(q)_d + hat(h)(q_d, dot(q)_d)")
    printed, standard = _two(designs, "9.9", arm, sources)
    inertia = float(arm.robot.mass(arm.ref(0.0).q)[0, 0])
    hurt = f"the largest error on the path (initial error {written(OFFSET, exact=True)} rad) is {_times(printed.largest, standard.largest)}"
    cost = (
        f"The torque subtracts M̂ q″: the effective inertia is {written(2 * inertia)} instead of {written(inertia)} kg m², the rightmost "
        "pole moves from"
        f" {written(standard.rightmost)} to {written(printed.rightmost)} 1/s, and {hurt}. The torque also depends on the acceleration that it"
        " causes: an algebraic loop that cannot be implemented."
    )
    return _section("9.9", "The page prints the acceleration of the error instead of the desired acceleration.", arm, printed, standard, cost)


def computed_torque(designs: Designs) -> Section:
    """9.10: prints h^(q_d, v_d): dh/dq and dh/dv stay in the loop."""
    arm = arms()[2]
    printed, standard = _two(designs, "9.10", arm, _computed("tau"))
    return _section(
        "9.10",
        "The page evaluates the gravity and Coriolis terms at the desired state (q_d, v_d) instead of the measured state.",
        arm,
        printed,
        standard,
        _cost(printed, standard),
    )


def triple(designs: Designs) -> Section:
    """9.12: the same misprint under the triple pole, on the two-link arm held upright: unstable with slow gains."""
    arm = replace(arms()[1], name="planar 2R, upright", ref=Hold(UPRIGHT))
    limit = slowest_printed(arm)
    w = SLOW * limit
    printed, standard = _two(designs, "9.10", arm, _computed("u"), _triple_law(w))
    speeds = np.geomspace(0.4 * limit, 6.0 * limit, 25)
    roots = [[_rightmost(arm, float(x), form) / x for x in speeds] for form in ("printed", "standard")]
    figure = Figure(
        partial(
            plots.curves,
            speeds,
            (("as printed", roots[0]), ("standard", roots[1])),
            xlabel="w [rad/s]",
            ylabel="rightmost pole / w [-]",
            log="x",
            limit=0.0,
        ),
        f"Rightmost pole over the design speed, triple pole at −w: −1 in the standard form; as printed, unstable below {written(limit)} rad/s.",
        f"Rightmost pole over w: the printed form is unstable below {written(limit)} rad/s.",
    )
    cost = (
        f"In the upright pose, gravity is destabilising. The printed form is unstable for every triple pole slower than {written(limit)} rad/s, the"
        f" standard form for none. At {written(w)} rad/s: " + _cost(printed, standard)
    )
    found = _section(
        "9.12", "The same misprint in the law with PID and feedforward, with slow gains on an arm held upright.", arm, printed, standard, cost
    )
    return replace(found, body=(*found.body, Row((figure,))), numbers={**found.numbers, "slowest_printed": limit, "w": w})


def _computed(letter: str) -> tuple[str, str]:
    feedback = f"{letter} = hat(M)(q) (dot.double(q)_d + K_p e + K_i integral e dif t + K_d dot(e))"
    return f"{feedback} + hat(h)(q_d, dot(q)_d)", f"{feedback} + hat(h)(q, dot(q))"


def _triple_law(w: float, form: Literal["standard", "printed"] = "standard") -> laws.ComputedTorque:
    kp, ki, kd = triple_pole(w)
    return laws.ComputedTorque(kp=kp, ki=ki, kd=kd, form=form)


def _rightmost(arm: Arm, w: float, form: Literal["standard", "printed"]) -> float:
    return float(ClosedLoop(arm.robot, _triple_law(w, form), arm.ref).linearize([0.0]).poles().real.max())


def slowest_printed(arm: Arm) -> float:
    """Speed [rad/s] of the triple pole below which the printed form is unstable, by bisection on the poles."""
    low, high = 0.05, 50.0
    while high / low > 1.0001:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if _rightmost(arm, middle, "printed") > 0 else (low, middle)
    return high


def _cost(printed: Form, standard: Form) -> str:
    phase = "undefined (unstable)" if np.isnan(printed.phase) else f"{written(printed.phase)}°"
    moved = (
        f"the rightmost pole moves from {written(standard.rightmost)} to {written(printed.rightmost)} 1/s, the smallest phase margin from"
        f" {written(standard.phase)}° to {phase}"
    )
    if printed.rightmost > 0:
        return (
            f"dh/dq and dh/dv stay in the loop, {moved}, and with an initial error of {written(OFFSET, exact=True)} rad the error reaches"
            f" {_times(printed.largest, standard.largest)}."
        )
    down = [float(-decibels(x.view.margins.gain_reduction.max())) for x in (standard, printed)]
    return (
        f"dh/dq and dh/dv stay in the loop: {moved}, and the lower gain margin is {written(down[1])} instead of {written(down[0])} dB. In a "
        f"4 s run with an initial error of {written(OFFSET, exact=True)} rad the largest error is {_times(printed.largest, standard.largest)}."
    )
