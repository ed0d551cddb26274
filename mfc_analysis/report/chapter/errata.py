"""The effect of the misprints in tool space, contact and hybrid control (9.5, 9.14-9.17, 9.24), and minor errors in the text."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from mfc_analysis import laws, plots
from mfc_analysis.laws.constraints import projection
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import inverse as inverse_pose, log6
from mfc_analysis.report.chapter.constraints import invariance_section
from mfc_analysis.report.chapter.force import POSE, arm, tiny
from mfc_analysis.report.chapter.hybrid import KP, NORMAL, hybrid_loop
from mfc_analysis.report.chapter.misprints import costs_table, folded
from mfc_analysis.report.chapter.pieces import LYNCH, at_most, in_words, slowest, verdict_of
from mfc_analysis.report.chapter.task import GAINS, SLOW, apply, followed, path
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
    Section,
    Side,
    Table,
    Text,
    written,
)
from mfc_analysis.requirements.line import Status
from mfc_analysis.trajectories import ToolHold

SOURCES = (LYNCH, "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 8-9")


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """The misprints in tool space, force and hybrid control, and minor errors in the text; not ``full``: a table of what each costs."""
    inner = (logarithm_section(), adjoint_section(), kinematics_section(), task_torque_section(), reciprocity_section(), hybrid_section())
    lost = [s.title for s in inner for b in s.body if isinstance(b, Compare) and b.left.note == "not stable"]
    verdict = f"{', '.join(lost)} makes a stable loop unstable" if lost else "none makes a stable loop unstable"
    finding = f"Of {len(inner)} misprints in tool space and contact, {verdict}."
    title = "Effect of the misprints in tool space and contact"
    shown = "the equations as printed"
    if full:
        return (Section(title, finding, sections=inner, sources=SOURCES, key="misprints-tool", shown=shown), slips_section())
    body = (costs_table(inner),)
    return (Section(title, finding, body, sections=folded(inner), sources=SOURCES, key="misprints-tool", shown=shown, folded=True), slips_section())


def two(left: tuple[str, Status, tuple[Any, ...]], right: tuple[str, Status, tuple[Any, ...]], cost: str) -> Compare:
    """Printed and standard form side by side."""

    def side(badge: Badge | None, title: str, status: Status, body: tuple[Any, ...]) -> Side:
        return Side(title, badge, body, "not stable" if status is Status.FAIL else "")

    return Compare(side(Badge.DEMO, *left), side(None, *right), cost)


def facts(*pairs: tuple[str, Number | str]) -> KeyFacts:
    """Named numbers of one side."""
    return KeyFacts(tuple(Fact(name, value) for name, value in pairs))


# --- 9.5 ---------------------------------------------------------------------------------------------------------


def logarithm_section() -> Section:
    """9.5: X_d - X instead of the logarithm, for a large rotation."""
    k, start = 4.0, 2.9
    runs = {}
    t = np.linspace(0, 2.0, 101)
    X = arm().pose(POSE)
    forms: tuple[Literal["standard", "printed"], ...] = ("standard", "printed")
    for form in forms:
        loop = ClosedLoop(arm(), laws.TaskVelocity(k, form=form), ToolHold(X), q_start=POSE)
        run = loop.simulate(t, q=POSE + np.array([0, 0, 0, 0, 0, start]), rtol=1e-9, atol=1e-11)
        runs[form] = np.array([float(np.linalg.norm(log6(inverse_pose(arm().pose(q)) @ X)[3:])) for q in run.q])
    closed = 2 * np.arctan(np.tan(start / 2) * np.exp(-k * t))
    away = float(np.abs(runs["printed"] - closed).max())
    took = {form: float(np.interp(-0.01 * start, -angle, t)) for form, angle in runs.items()}
    cost = (
        f"From {start:g} rad, the printed difference takes {written(took['printed'])} s to reach 1 %, the logarithm {written(took['standard'])} s. "
        "The angular part of the difference is sin(angle), which vanishes as the angle approaches π. Near the reference both forms agree."
    )
    figure = Figure(
        partial(plots.traces, t, (plots.Panel("angle [rad]", runs["standard"], beside=runs["printed"]),), ("UR5",), said=("standard", "as printed")),
        "Angle between the tool and its reference, initial error 2.9 rad.",
        f"Angle over time: to 1 % in {took['standard']:.3g} s (standard) and {took['printed']:.3g} s (printed).",
    )
    poles = Number(-k, "1/s")
    compare = two(
        (
            "As printed",
            Status.WATCH,
            (
                Equation("X_e = X_d - X", "difference of poses", "9.5"),
                facts(("Time to 1 % of 2.9 rad", Number(took["printed"], "s")), ("Poles", poles)),
            ),
        ),
        (
            "Standard",
            Status.PASS,
            (Equation("X_e = log(X^(-1) X_d)", "logarithm"), facts(("Time to 1 % of 2.9 rad", Number(took["standard"], "s")), ("Poles", poles))),
        ),
        cost,
    )
    more = Paragraph(
        (
            "The difference of two poses is not a pose. For the vector of ",
            Math("X^(-1) (X_d - X)"),
            ", the angle obeys ",
            Math("tan(theta slash 2) = tan(theta_0 slash 2) e^(-k t)"),
            ".",
        )
    )
    proofs = (at_most("deviation from theory", 1e-4, 100 * away / start, "%", "9.5 as printed"),)
    return Section(
        "9.5: the difference of two poses",
        cost,
        (compare, figure, more),
        (),
        {"time_to_1_percent": took, "departure": away},
        SOURCES,
        proofs=proofs,
        key="misprint-9.5",
    )


def adjoint_section() -> Section:
    """9.5 without the adjoint: the twist of the reference in the wrong frame."""
    t = np.linspace(0, path().period or 1.0, 81)
    found = {}
    forms: tuple[Literal["standard", "no_adjoint"], ...] = ("standard", "no_adjoint")
    for form in forms:
        loop = ClosedLoop(arm(), laws.TaskVelocity(SLOW, form=form), path(), q_start=POSE)
        run = loop.simulate(t, initial_error=[0, 0, 0, 0.2, 0, 0], rtol=1e-8, atol=1e-11)
        found[form] = (run, loop.linearize(t).poles(), loop.floquet().exponent)
    sideways = {form: 1e3 * float(np.abs(run.error[:, :3]).max()) for form, (run, _, _) in found.items()}
    turn = float(np.abs(found["no_adjoint"][1].imag).max())
    speed = float(np.linalg.norm(path()(t).V[:, 3:], axis=1).max())
    cost = (
        f"A pure rotation error of 0.2 rad moves the tool {written(sideways['no_adjoint'])} mm off its path; with the standard form it stays within "
        f"{written(tiny(sideways['standard'], 1e-5), 2)} mm. The frozen poles have imaginary parts up to ±{written(turn)} rad/s; the growth over one "
        "period is the same."
    )
    right, wrong = found["standard"][0], found["no_adjoint"][0]
    panel = plots.Panel("position error [mm]", 1e3 * right.error[:, :3], beside=1e3 * wrong.error[:, :3])
    figure = Figure(
        partial(plots.traces, t, (panel,), ("x", "y", "z"), said=("standard", "no adjoint")),
        "Position error caused by a rotation error of 0.2 rad on the moving path.",
        f"Position error: at most {sideways['no_adjoint']:.3g} mm without the adjoint, {sideways['standard']:.2g} mm with it.",
    )
    sides = {
        form: facts(
            ("Largest position error", Number(sideways[form], "mm", 2)),
            ("Growth over one period", Number(g, "1/s")),
            ("Imaginary part", Number(tiny(float(np.abs(p.imag).max())), "rad/s", 2)),
        )
        for form, (_, p, g) in found.items()
    }
    compare = two(
        ("Without the adjoint", Status.WATCH, (Equation('"V"_b = "V"_d + K_p X_e', "twist of the reference, not transformed"), sides["no_adjoint"])),
        (
            "Standard",
            Status.PASS,
            (Equation('"V"_b = ["Ad"_(X^(-1) X_d)] "V"_d + K_p X_e', "twist of the reference in the tool frame", "9.5"), sides["standard"]),
        ),
        cost,
    )
    proofs = (at_most("deviation from theory", 0.1, 100 * abs(turn / speed - 1), "%", "imaginary part = angular speed"),)
    numbers = {"position_error_mm": sideways, "imaginary": turn, "angular_speed": speed, "exponent": {f: g for f, (_, _, g) in found.items()}}
    return Section(
        "9.5 without the adjoint: a common error", cost, (compare, figure), (), numbers, SOURCES, proofs=proofs, key="misprint-9.5-adjoint"
    )


# --- 9.14 to 9.17 ------------------------------------------------------------------------------------------------


def kinematics_section() -> Section:
    """9.14 and 9.15: typing errors, and the effect of leaving the term out."""
    _, q, v, _, _, dV = followed()
    drift = apply(arm().jacobian_rate(q, v), v)
    torque = apply(np.swapaxes(arm().jacobian(q), 1, 2), apply(arm().task_inertia(q), drift))
    missed, share = float(np.abs(torque).max()), float(np.abs(drift[:, 3:]).max() / np.abs(dV[:, 3:]).max())
    cost = (
        f"Without the term that the missing plus sign removes, the torques along the path are wrong by up to {written(missed)} Nm "
        f"and the angular acceleration by {written(100 * share)} % of its largest value."
    )
    compare = two(
        (
            "As printed", Status.WATCH,
            (Equation('dot("V")_b = dot(J)_b dot(q) J_b dot.double(q), quad "F"_b = Lambda dot("V") + dot(eta)', "missing plus, dot on eta", "9.15"),
             facts(("Torque error without the term", Number(missed, "Nm")))),
        ),
        (
            "Standard", Status.PASS,
            (Equation('dot("V")_b = dot(J)_b dot(q) + J_b dot.double(q), quad "F"_b = Lambda dot("V")_b + eta', "sum of both terms"),
             facts(("Torque error", Number(0.0, "Nm")))),
        ),
        cost,
    )  # fmt: skip
    more = Paragraph("9.14 prints the rate of q with the index b of a twist. Joints have no frame, so this index has no meaning.")
    return Section(
        "9.14 and 9.15: a missing sign", cost, (compare, more), numbers={"torque": missed, "share": share}, sources=SOURCES, key="misprint-9.15"
    )


def task_torque_section() -> Section:
    """9.16: V_d' and X_e' instead of the rates in the derivation."""
    t = np.linspace(0, path().period or 1.0, 41)
    design = np.roots([1, GAINS["kd"], GAINS["kp"], GAINS["ki"]])
    found: dict[str, dict[str, float]] = {}
    forms: tuple[Literal["standard", "printed"], ...] = ("standard", "printed")
    for form in forms:
        loop = ClosedLoop(arm(), laws.TaskComputedTorque(**GAINS, form=form), path(), q_start=POSE)
        p = loop.linearize(t).poles()
        run = loop.simulate(t, initial_error=[0, 0, 0, 0.3, 0, 0], rtol=1e-7, atol=1e-9)
        found[form] = {
            "rightmost": float(p.real.max()),
            "imaginary": float(np.abs(p.imag).max()),
            "away": float(max(np.abs(p[..., None] - design).min(axis=-1).max(axis=-1))),
            "sideways": 1e3 * float(np.abs(run.error[:, :3]).max()),
        }
    a, b = found["printed"], found["standard"]
    cost = (
        f"On the moving path the poles of the printed form differ from the design by up to {written(a['away'])} 1/s (standard: "
        f"{written(tiny(b['away']), 2)}), and a rotation error of 0.3 rad moves the tool by {written(a['sideways'])} mm instead of "
        f"{written(b['sideways'])}. "
        "At rest both forms have the same poles."
    )
    shown = {
        form: facts(
            ("Rightmost pole", Number(x["rightmost"], "1/s", 4)),
            ("Largest imaginary part", Number(tiny(x["imaginary"]), "rad/s", 2)),
            ("Position error", Number(x["sideways"], "mm")),
        )
        for form, x in found.items()
    }
    compare = two(
        ("As printed", verdict_of(a["rightmost"] < 0) if a["away"] < 1e-6 else Status.WATCH,
         (Equation('dot("V")_d + K_p X_e + K_i integral X_e dif t + K_d dot(X)_e', "as printed", "9.16"), shown["printed"])),
        ("Standard", verdict_of(b["rightmost"] < 0),
         (Equation('dif/(dif t)(["Ad"] "V"_d) + K_p X_e + K_i integral X_e dif t + K_d "V"_e', "standard"), shown["standard"])),
        cost,
    )  # fmt: skip
    return Section("9.16: rates of the reference twist and of the error", cost, (compare,), numbers=found, sources=SOURCES, key="misprint-9.16")


def reciprocity_section() -> Section:
    """9.17: SO(3) instead of se(3) and its dual."""
    n = invariance_section().numbers
    same, other = float(n["change_of_work"]), float(n["change_of_twist_product"])
    cost = (
        f"As vectors of one space, their product changes by {written(other)} under a change of frame; as twist and wrench it does not "
        "change. 9.18 also lacks its right-hand side, 0."
    )
    compare = two(
        (
            "As printed",
            Status.WATCH,
            (
                Equation('"V" in S O(3), quad "F" in S O^*(3)', "rotations instead of twists", "9.17"),
                facts(("Change with the frame", Number(other, ""))),
            ),
        ),
        (
            "Standard",
            Status.PASS,
            (Equation('"V" in "se"(3), quad "F" in "se"^*(3)', "twists and wrenches"), facts(("Change with the frame", Number(same, "", 2)))),
        ),
        cost,
    )
    return Section("9.17: the spaces of twists and wrenches", cost, (compare,), numbers=dict(n), sources=SOURCES, key="misprint-9.17")


# --- 9.24 --------------------------------------------------------------------------------------------------------


class Rest(NamedTuple):
    """One form of 9.24 under PD in contact."""

    stable: bool
    rightmost: float  #: [1/s]
    error: Array  #: (6,) X_e at rest
    balance: float  #: [N] deviation of P Lambda Kp X_e from P (eta + F_tip) (standard: from P F_tip)


def at_rest(form: Literal["standard", "printed", "printed_eta"]) -> Rest:
    """The equilibrium of one form, its stability, and the force balance of its position error."""
    loop = hybrid_loop(form=form)
    rest, lin = loop.equilibrium(), loop.linearize(about="equilibrium")
    Lambda, eta = arm().task_inertia(rest.q), arm().task_bias(rest.q, np.zeros(6))
    P = projection(NORMAL, Lambda)
    wanted = P @ (rest.force + (eta if form != "standard" else 0.0))
    off = float(np.abs(P @ Lambda @ (KP * rest.error) - wanted).max())
    return Rest(bool(lin.stable[0]), slowest(lin.poles()[0]).real, rest.error, off)


def hybrid_section() -> Section:
    """9.24: eta inside (I - P)."""
    forms: tuple[Literal["printed", "printed_eta", "standard"], ...] = ("printed", "printed_eta", "standard")
    found = {form: at_rest(form) for form in forms}
    mm = {form: 1e3 * float(np.linalg.norm(x.error[:3])) for form, x in found.items()}
    mrad = {form: 1e3 * float(np.linalg.norm(x.error[3:])) for form, x in found.items()}
    cost = (
        f"As printed, the motion directions have no gravity compensation: under PD on the wall the error at rest is {written(mm['printed'])} mm and "
        f"{written(mrad['printed'])} mrad; with the standard form it is {written(mm['standard'], 2)} mm."
    )
    shown = {
        form: facts(
            ("Position error at rest", Number(mm[form], "mm")),
            ("Rotation error at rest", Number(mrad[form], "mrad")),
            ("Rightmost pole", Number(x.rightmost, "1/s")),
        )
        for form, x in found.items()
    }

    def side(title: str, form: Literal["printed", "standard"], source: str) -> tuple[str, Status, tuple[Any, ...]]:
        x = found[form]
        status = Status.FAIL if not x.stable else Status.WATCH if mm[form] > 1e-3 else Status.PASS
        return title, status, (Equation(source, title, "9.24"), shown[form])

    compare = two(
        side("As printed", "printed", 'P hat(Lambda)(...) + (I - P)("F"_d + ... + hat(eta))'),
        side("Standard", "standard", 'P hat(Lambda)(...) + (I - P)("F"_d + ...) + hat(eta)'),
        cost,
    )
    columns = (
        Column("Form", numeric=False),
        Column("verdict", numeric=False),
        Column("position error", "mm"),
        Column("rotation error", "mrad"),
        Column("balance error", "N"),
    )
    rows = tuple((form, in_words(x.stable), Number(mm[form]), Number(mrad[form]), Number(x.balance, digits=2)) for form, x in found.items())
    body = (
        compare,
        Paragraph(
            "At equilibrium, the printed form obeys P Λ Kp X_e = P (η + F_tip). With η outside (I − P), only the rates V_d' and X_e' "
            "differ from the standard form; they vanish at rest."
        ),
        Table("The three forms under PD on a wall of 10 kN/m.", columns, rows),
    )
    proofs = (at_most("balance at rest, P Λ Kp X_e = P (η + F_tip)", 1e-6, max(x.balance for x in found.values()), "N"),)
    numbers = {
        "off_mm": mm,
        "turned_mrad": mrad,
        "balance": {f: x.balance for f, x in found.items()},
        "error": {f: x.error for f, x in found.items()},
    }
    return Section("9.24: the bias term in the wrong subspace", cost, body, (), numbers, SOURCES, proofs=proofs, key="misprint-9.24")


# --- the text ----------------------------------------------------------------------------------------------------

SLIPS: tuple[tuple[str, Text, Text], ...] = (
    ("9.1", (Math("q_t (t) in S O(3)"), " for a vector of joint positions"), (Math("q_d in RR^n"), ": joint positions are not a rotation")),
    ("9.1", Math("dot(q) = q_d"), Math("dot(q) = dot(q)_d")),
    ("9.7", (Math("C(q, dot(q))"), " linear in q"), (Math("C"), " is linear in the velocities, ", Math("C dot(q)"), " quadratic")),
    (
        "9.3.2",
        "a diagonal mass matrix means independent joints",
        ("the RP arm has a diagonal M(q) and is coupled through ", Math("C"), " and ", Math("g")),
    ),
    ("9.12", "combines 9.7 and 9.8", "it combines 9.8 (PID) and 9.9 (feedforward)"),
    ("9.17", (Math('"V" in S O(3), "F" in S O^*(3)')), (Math('"V" in "se"(3), "F" in "se"^*(3)'))),
    ("9.18", "the sum ends without a right-hand side", "... = 0"),
    (
        "9.19",
        (Math('"F"_"tip"'), " is the environment's action on the tool"),
        "with the sign of 9.19 it is the wrench of the robot on the environment",
    ),
    ("9.24", (Math('K_"fd"'), " in front of ", Math('"F"_e')), (Math('K_"fp"'), ", as in 9.22")),
    ("exercise 9.3", "repeat 9.1 and 9.3", "repeat 9.1 and 9.2"),
)  #: location, as printed, corrected


def slips_section() -> Section:
    """Minor errors in the text that change no control law."""
    finding = f"{len(SLIPS)} minor errors in the text change no control law but can mislead. Two of them are checked by computation below the table."
    coupled = _coupled_by_gravity()
    body = (
        Table(
            "Minor errors in the text.", (Column("Where", numeric=False), Column("Printed", numeric=False), Column("Correct", numeric=False)), SLIPS
        ),
        facts(
            ("RP arm: off-diagonal of M(q)", Number(coupled["mass"], "kg m", 2)),
            ("RP arm: gravity torque per length", Number(coupled["gravity"], "Nm/m")),
            ("Coriolis torque at twice the speed", Number(coupled["quadratic"], "times")),
        ),
    )
    proofs = (
        at_most("off-diagonal of M of the RP arm", 1e-12, coupled["mass"], "kg m"),
        at_most("deviation from theory", 1e-9, 25 * abs(coupled["quadratic"] - 4), "%", "C q' is quadratic"),
    )
    return Section("Minor errors in the text", finding, body, (), coupled, SOURCES, proofs=proofs, key="slips")


def _coupled_by_gravity() -> dict[str, float]:
    from mfc_analysis import robots

    robot, q, v, step = robots.rp(), np.array([0.4, 0.7]), np.array([0.8, 0.3]), np.array([0.0, 1e-6])
    M = robot.mass(q)
    g = (robot.gravity(q + step)[0] - robot.gravity(q - step)[0]) / (2 * step[1])
    still = robot.bias(q, np.zeros(2))
    once, twice = robot.bias(q, v) - still, robot.bias(q, 2 * v) - still
    return {"mass": float(abs(M[0, 1])), "gravity": float(g), "quadratic": float(np.linalg.norm(twice) / np.linalg.norm(once))}
