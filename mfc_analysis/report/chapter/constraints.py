"""Natural and artificial constraints, equations 9.17 and 9.18: tables, reciprocity, ranks, and the rows that 9.24 uses."""

from __future__ import annotations

import numpy as np

from mfc_analysis.laws.constraints import FORCE, MOTION, ConstraintSet, peg_in_hole, projection, surface_sliding
from mfc_analysis.maths.se3 import adjoint, exp6, inverse
from mfc_analysis.report.chapter.force import POSE, arm
from mfc_analysis.report.chapter.pieces import at_most
from mfc_analysis.report.document.document import Column, Equation, Fact, KeyFacts, Number, Paragraph, Section, Table, written

SOURCES = ("Siciliano et al., Robotics: Modelling, Planning and Control, ch. 9.4", "Lynch & Park, Modern Robotics, ch. 11.6")
AXES = ("x", "y", "z", "about x", "about y", "about z")


def sections(*, full: bool = True) -> tuple[Section, ...]:
    """Sections of 9.17-9.18 for the chapter report; not ``full``: without the second table of constraints."""
    return (
        constraint_section("Peg in a hole: 9.17 and 9.18", peg_in_hole(insertion_speed=0.01), "peg-in-hole"),
        *((constraint_section("A face sliding on a plane: 9.17 and 9.18", surface_sliding(force=20.0), "surface-sliding"),) if full else ()),
        invariance_section(),
    )


def constraint_section(title: str, given: ConstraintSet, key: str) -> Section:
    """The table of one task, its ranks and rows."""
    rows = tuple(
        (axis, f"{name} = 0", f"{other} = {written(given.artificial[other], exact=True)} {unit(other)}")
        for axis, v, f in zip(AXES, MOTION, FORCE, strict=True)
        for name, other in (((v, f),) if v in given.natural else ((f, v),))
    )
    A = given.rows
    finding = (
        f"{given.rank_free} directions are free and {given.rank_constraint} constrained, {given.rank_free + given.rank_constraint} in all. Every "
        "free twist is reciprocal to every constraint wrench: their product is zero."
    )
    P = projection(A, arm().task_inertia(POSE))
    residues = {"P P − P": float(np.abs(P @ P - P).max()), "P A^T": float(np.abs(P @ A.T).max()), "rank of P": float(np.round(np.trace(P), 9))}
    body = (
        Equation('"V" dot "F" = v^top f + omega^top m = 0', "reciprocity", "9.17"),
        Table(
            "Along each axis of the compliance frame, the environment sets either motion or force, and the controller sets the other.",
            (Column("Axis", numeric=False), Column("natural", numeric=False), Column("artificial", numeric=False)),
            rows,
        ),
        Table(
            "Rows A of 9.24, A V_b = 0, derived from the table.",
            (Column("Row", numeric=False), *(Column(name) for name in MOTION)),
            tuple((f"{i + 1}", *(Number(float(x), exact=True) for x in row)) for i, row in enumerate(A)),
        ),
        KeyFacts(
            (
                Fact("Rank, free", Number(float(given.rank_free), exact=True)),
                Fact("Rank, constrained", Number(float(given.rank_constraint), exact=True)),
                Fact("Rank of P on the UR5", Number(residues["rank of P"], exact=True), "its trace"),
            )
        ),
    )
    proofs = (
        at_most("reciprocity", 1e-12, given.reciprocity, "", "V · F"),
        at_most("projector", 1e-9, max(residues["P P − P"], residues["P A^T"]), "", "P P = P and P A^T = 0"),
    )
    numbers = {
        "natural": tuple(given.natural), "artificial": dict(given.artificial), "rank_free": given.rank_free, "rank_constraint": given.rank_constraint,
        "reciprocity": given.reciprocity, "rows": A, "projector": residues,
    }  # fmt: skip
    return Section(title, finding, body, (), numbers, SOURCES, proofs=proofs, key=key)


def unit(name: str) -> str:
    """The unit of a component of twist or wrench."""
    return {"v": "m/s", "w": "rad/s", "f": "N", "m": "Nm"}[name[0]]


def invariance_section() -> Section:
    """V . F does not depend on the frame; the usual product of two twists does."""
    frame = exp6(np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6]))
    moved = peg_in_hole(frame)
    rng = np.random.default_rng(9)
    V, F, W = rng.normal(size=(3, 6))
    Ad = adjoint(frame)
    same = abs(float((Ad @ V) @ (adjoint(inverse(frame)).T @ F) - V @ F))
    other = abs(float((Ad @ V) @ (Ad @ W) - V @ W))
    finding = (
        f"In a tool frame shifted by 0.37 m and rotated, the peg's twists and wrenches stay reciprocal. The change "
        f"of frame does not change V · F, and changes the product of two twists by {written(other)}."
    )
    body = (
        Paragraph(
            "Twists and wrenches transform differently, so their product is the power in every frame. A product of two twists, or of two wrenches, "
            "depends on the frame and on the unit of length. The page places V in SO(3) and F in its dual; they belong to se(3) and se*(3)."
        ),
        Table(
            "The peg in a hole: A in a tool frame that differs from the compliance frame.",
            (Column("Row", numeric=False), *(Column(name) for name in MOTION)),
            tuple((f"{i + 1}", *(float(np.round(x, 12)) for x in row)) for i, row in enumerate(moved.rows)),
        ),
    )
    proofs = (
        at_most("reciprocity", 1e-12, moved.reciprocity, "", "V · F, moved frame"),
        at_most("change of V · F with the frame", 1e-12, same),
    )
    numbers = {"change_of_work": same, "change_of_twist_product": other, "reciprocity": moved.reciprocity}
    return Section("Invariance under a change of frame: 9.17", finding, body, (), numbers, SOURCES, proofs=proofs, key="reciprocity")
