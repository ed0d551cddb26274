"""Hybrid motion/force control, equation 9.24: margins of motion and force, damping of the force directions, coupling, and the leak of X_e."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache, partial
from typing import Any, Literal, NamedTuple

import numpy as np

from mfc_analysis import laws, plots
from mfc_analysis.design.stiffness import over_stiffness
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.laws.constraints import projection
from mfc_analysis.linearization.coupling import coupling, leak
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.arrays import Array
from mfc_analysis.report.chapter.force import CHOSEN, KFI, KFP, POSE, Z, arm, tiny
from mfc_analysis.report.chapter.pieces import agreement, at_most, in_words, margins_at, response, validated
from mfc_analysis.report.chapter.smallest_margins import force_checks, least, margin_numbers, tightest
from mfc_analysis.report.document.document import Block, Column, Equation, Fact, Figure, KeyFacts, Math, Number, Paragraph, Section, Table, written
from mfc_analysis.report.loops.points import smallest
from mfc_analysis.report.loops.record import KEY, record
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import ToolHold, ToolSinusoid

NORMAL = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])  #: the row A of a point on a wall along the tool's z axis
FORCE, STIFFNESS, DAMPING, KP = 20.0, 1e4, 200.0, 100.0  #: [N], [N/m], [Ns/m] of kdamp along z, [1/s^2]
PROJECTORS: tuple[Literal["dynamic", "selection"], ...] = ("dynamic", "selection")
FREE = ("X_e_vx", "X_e_vy")
SOURCES = ("Lynch & Park, Modern Robotics, ch. 11.6", "Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9.4")


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections of 9.24 for the chapter report, the same whether ``full`` or not."""
    return (margins_section(), damping_section(), coupling_section(), leak_section())


def hybrid_loop(
    projector: Literal["dynamic", "selection"] = "dynamic",
    form: Literal["standard", "printed", "printed_eta"] = "standard",
    kdamp: float = DAMPING,
    robot: Robot | None = None,
    pose: Array | None = None,
    ref: Any = None,
    kfi: float | None = KFI,
    hardware: Hardware | None = None,
) -> ClosedLoop:
    """A UR5 pressing with 20 N along its tool's z axis on a wall of 10 kN/m and moving along it; the controller's model is the bare arm."""
    X = arm().pose(POSE)
    law = laws.HybridMotionForce(
        FORCE * Z, 100.0, kd=20.0, kfp=KFP * Z, kfi=None if kfi is None else kfi * Z, kdamp=kdamp * Z,
        constraints=NORMAL, projection=projector, form=form,
    )  # fmt: skip
    wall = Environment(STIFFNESS, preload=FORCE, pose=X if pose is None else pose)
    return ClosedLoop(robot or arm(), law, ref or ToolHold(X), controller_model=arm(), environment=wall, q_start=POSE, hardware=hardware)


def turned(degrees: float, shift: float = 0.0) -> Array:
    """The tool's pose, turned about its x axis and moved along its z axis [m]: a wall whose pose the controller does not know exactly."""
    X = np.array(arm().pose(POSE))
    X[:3, 3] += shift * X[:3, 2]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    X[:3, :3] = X[:3, :3] @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return X


# --- margins -----------------------------------------------------------------------------------------------------


def margins_section() -> Section:
    """Margins of both loops with both projections, torque lag 2 ms."""
    lag = Hardware(torque_lag=2e-3)
    loops = {p: hybrid_loop(p, hardware=lag) for p in PROJECTORS}
    lins = {p: loop.linearize() for p, loop in loops.items()}
    rows = []
    for name, lin in lins.items():
        for m in (margins_at(lin, point) for point in lin.opened.points):
            one = smallest([m])
            rows.append(
                (
                    name, in_words(bool(lin.stable[0]), bool(lin.drifts[0])), m.at, Number(one["phase_deg"].value), one["phase_deg"].channel,
                    Number(1e3 * one["delay"].value), one["delay"].channel,
                )
            )  # fmt: skip
    lin = lins["dynamic"]
    c = margins_at(lin, "command")
    finding = f"With a torque lag of 2 ms {tightest(lin)}; with the selection projection {tightest(lins['selection'])}."
    columns = (
        Column("Projection", numeric=False), Column("verdict", numeric=False), Column("analysis point", numeric=False),
        Column("phase margin", "°"), Column("of", numeric=False), Column("delay margin", "ms"), Column("of", numeric=False),
    )  # fmt: skip
    body = (
        Equation("tau = J_b^top (P hat(Lambda) a + (1 - P) f + hat(eta))", "hybrid motion and force control", "9.24"),
        Equation('a = dif/(dif t)(["Ad"] "V"_d) + K_p X_e + K_i integral X_e dif t + K_d "V"_e', "its motion part"),
        Equation('f = "F"_d + K_"fp" "F"_e + K_"fi" integral "F"_e dif t', "its force part"),
        Paragraph(
            (
                "The normal of the wall is the tool's z axis; the other five directions follow the motion reference. The part in ",
                Math("(1 - P)"),
                " includes the damping ",
                Math('K_"damp"'),
                ".",
            )
        ),
        Table("Smallest margins on a wall of 10 kN/m, at each analysis point.", columns, tuple(rows)),
        response(lin, "force", 2, "UR5, 9.24, fz", span=(0.1, 3e3)),
    )
    checks = force_checks(lin, 45.0, 6.0, 2.0)
    numbers = {
        KEY: record(loops["dynamic"], at="torque"),
        **margin_numbers(lin),
        "smallest_selection": {name: asdict(found) for name, found in least(lins["selection"]).items()},
        "motion_phase_deg": c.phase_deg[0],
        "poles": lin.poles()[0],
        "validation": validated(hybrid_loop(), 0.05),
    }
    title = "Hybrid motion and force control: 9.24"
    origins = (("kp", "double pole at −10 1/s: kp = w², kd = 2w"), ("kd", "double pole at −10 1/s"), *CHOSEN)
    return Section(title, finding, body, checks, numbers, SOURCES, loop="9.24 hybrid, UR5", key="hybrid", origins=origins)


def damping_section() -> Section:
    """As printed, the force directions have no damping: unstable for every wall stiffness. kdamp stabilises the loop."""
    k = np.geomspace(1e2, 1e6, 25)
    growth = {name: over_stiffness(hybrid_loop(kdamp=d), k).growth for name, d in (("as printed", 0.0), (f"kdamp = {DAMPING:g} Ns/m", DAMPING))}
    bare, repaired = growth.values()
    limit = KFI / (1 + KFP) / 2
    finding = (
        f"As printed, the force directions have no damping: from 0.1 kN/m to 1 MN/m the rightmost pole is at {written(float(bare.min()))} to "
        f"{written(float(bare.max()))} 1/s, so the loop is unstable for every stiffness. With kdamp = {DAMPING:g} Ns/m the loop is stable, "
        f"with its rightmost pole at most at {written(float(repaired.max()))} 1/s."
    )
    figure = Figure(
        partial(
            plots.curves,
            k,
            list(growth.items()),
            xlabel="stiffness [N/m]",
            ylabel="rightmost pole [1/s]",
            log="x",
            limit=0.0,
            title="9.24 without and with damping",
        ),
        "Rightmost pole that is not slow over the stiffness of the wall.",
        f"Rightmost pole over stiffness: {bare.min():.3g} to {bare.max():.3g} per second without damping, "
        f"{repaired.min():.3g} to {repaired.max():.3g} with it.",
    )
    body = (
        Equation('s -> k_"fi"/(2 (1 + k_"fp")) plus.minus j sqrt(k_e (1 + k_"fp") slash m)', "the pole pair without damping on a stiff wall", "9.24"),
        KeyFacts(
            (
                Fact("Growth on a stiff wall", Number(float(bare[-1]), "1/s"), "1 MN/m"),
                Fact("Closed form", Number(limit, "1/s"), "kfi / (2 (1 + kfp))"),
            )
        ),
        figure,
    )
    numbers = {"stiffness": k, "growth_without": bare, "growth_with": repaired, "closed_form": limit}
    return Section(
        "Force directions without damping: 9.24",
        finding,
        body,
        (),
        numbers,
        SOURCES,
        proofs=(agreement("growth on a stiff wall", float(bare[-1]), limit, 0.1),),
        key="hybrid-damping",
        shown="the force directions as printed have no damping",
    )


# --- coupling and leak -------------------------------------------------------------------------------------------


class Case(NamedTuple):
    """One model error: the transfers between motion and force, and a run along the wall."""

    force_to_motion: Array  #: (nf,) [m/N]
    motion_to_force: Array  #: (nf,) [N/m]
    stable: bool
    force_error: float  #: [N] largest, while sliding
    tracking: float  #: [m] largest along the wall, while sliding


@cache
def cases() -> tuple[Array, dict[str, Case]]:
    """Frequencies [rad/s] and the loop with an exact model, the selection, an unknown payload, and a wall turned by 5 degrees."""
    w = np.geomspace(0.3, 300.0, 40)
    X = arm().pose(POSE)
    slide = ToolSinusoid(X, 0.05 * X[:3, 0], 6.0)
    t = np.linspace(0, 0.6 * (slide.period or 1.0), 41)
    ways: dict[str, dict[str, Any]] = {
        "exact": {},
        "selection": {"projector": "selection"},
        "2 kg unknown": {"robot": arm().with_payload(2.0)},
        "wall turned 5°": {"pose": turned(5.0)},
    }
    out = {}
    for name, way in ways.items():
        lin = hybrid_loop(**way).linearize()
        run = hybrid_loop(**way, ref=slide).simulate(t, rtol=1e-4, atol=1e-7)
        settled = t > 0.1
        out[name] = Case(
            coupling(lin, ("F_d_fz",), FREE, w).gain[0],
            coupling(lin, ("X_d_vx", "X_d_vy"), ("F_tip_fz",), w).gain[0],
            bool(lin.stable[0]),
            float(np.abs(run.force[settled, 2] - FORCE).max()),
            float(np.abs(run.error[settled, :2]).max()),
        )
    return w, out


def coupling_section() -> Section:
    """Coupling from motion to force and from force to motion under model errors."""
    w, found = cases()
    exact, heavy, tilt, plain = found["exact"], found["2 kg unknown"], found["wall turned 5°"], found["selection"]
    finding = (
        "With an exact model, the dynamic projection decouples the force from the motion. "
        f"The coupling is {written(float(heavy.motion_to_force.max()))} N/m with an unknown payload of 2 kg, "
        f"{written(float(tilt.motion_to_force.max()))} N/m with a wall turned by 5°, and {written(float(plain.motion_to_force.max()))} N/m "
        "with the selection projection and an exact model."
    )
    columns = (
        Column("Loop", numeric=False), Column("motion to force, peak", "N/m"), Column("force to motion, peak", "mm/N"),
        Column("force error while sliding", "N"), Column("tracking error", "mm"), Column("verdict", numeric=False),
    )  # fmt: skip
    rows = tuple(
        (name, Number(tiny(float(c.motion_to_force.max())), digits=2), Number(1e3 * float(c.force_to_motion.max()), digits=2),
         Number(c.force_error, digits=2), Number(1e3 * c.tracking, digits=2), in_words(c.stable))
        for name, c in found.items()
    )  # fmt: skip
    shown = [(name, np.maximum(c.motion_to_force, 1e-3)) for name, c in found.items() if name != "exact"]
    figure = Figure(
        partial(plots.curves, w, shown, xlabel="ω [rad/s]", ylabel="motion to force [N/m]", log="xy", title="Coupling from motion to force"),
        "Transfer from the motion reference along the wall to the normal force; with an exact model and the dynamic projection it is zero.",
        "Coupling over frequency, peaks: " + ", ".join(f"{name} {c.motion_to_force.max():.3g} N/m" for name, c in found.items()) + ".",
    )
    body = (
        Paragraph(
            "The arm slides along the wall with an amplitude of 5 cm at 6 rad/s and presses with 20 N. Errors are maxima after the first 0.1 s."
        ),
        Table("Coupling between motion and force under 9.24.", columns, rows),
        figure,
    )
    numbers: dict[str, Any] = {
        name: {"motion_to_force": c.motion_to_force, "force_to_motion": c.force_to_motion, "force_error": c.force_error, "tracking": c.tracking}
        for name, c in found.items()
    }
    proofs = (at_most("motion-to-force coupling, exact model", 1e-6, float(exact.motion_to_force.max()), "N/m", "dynamic projection"),)
    return Section(
        "Coupling of motion and force: 9.24", finding, body, (), {"frequencies": w, **numbers}, SOURCES, proofs=proofs, key="hybrid-coupling"
    )


def leak_section() -> Section:
    """X_e is multiplied by Lambda before the projection: an error normal to the wall moves the tool along the wall."""
    shift = 2e-4
    rest = hybrid_loop(pose=turned(0.0, shift)).equilibrium()
    Lambda = arm().task_inertia(rest.q)
    leaks = {"dynamic": leak(NORMAL, Lambda)[:, 0], "selection": leak(NORMAL, Lambda, "selection")[:, 0]}
    across, along = float(rest.error[2]), np.asarray(rest.error)
    predicted = -leaks["dynamic"] * across
    sizes = {p: float(np.linalg.norm(x[:3])) for p, x in leaks.items()}
    finding = (
        f"The error is multiplied by Λ before the projection. A wall {1e3 * shift:g} mm behind the reference causes a normal error of "
        f"{written(1e3 * abs(across))} mm, which moves the tool {written(1e3 * float(np.linalg.norm(along[:2])))} mm sideways and turns it by "
        f"{written(1e3 * float(np.linalg.norm(along[3:])))} mrad at rest."
    )
    names = ("x [mm]", "y [mm]", "about x [mrad]", "about y [mrad]", "about z [mrad]")
    index = (0, 1, 3, 4, 5)
    rows = tuple((name, tiny(1e3 * float(along[i])), tiny(1e3 * float(predicted[i]))) for name, i in zip(names, index, strict=True))
    columns = (Column("Direction", numeric=False), Column("at rest"), Column("predicted"))
    body: tuple[Block, ...] = (
        Equation(
            'Lambda^(-1) P Lambda c != 0 quad "for" quad c = A^top',
            "the leak: a commanded acceleration normal to the wall causes an acceleration along it",
        ),
        KeyFacts(
            (
                Fact("Leak, dynamic", Number(sizes["dynamic"], "", 3), "tangential per unit normal"),
                Fact("Leak, selection", Number(sizes["selection"], "", 3), "tangential per unit normal"),
            )
        ),
        Table(f"Error in the free directions at rest, with the wall {1e3 * shift:g} mm behind the reference.", columns, rows),
    )
    left = projection(NORMAL, Lambda) @ (Lambda @ (KP * along) - rest.force)
    body += (Paragraph("The remaining difference is due to the wall force, whose direction changes relative to the turned tool."),)
    proofs = (at_most("balance at rest, P (Λ Kp X_e − F_tip)", 1e-8, float(np.abs(left).max()), "N"),)
    numbers = {"leak": leaks, "at_rest": along, "predicted": predicted}
    return Section("Leak of a normal error into the free directions: 9.24", finding, body, (), numbers, SOURCES, proofs=proofs, key="hybrid-leak")
