"""The chapter's report: the loops of all equations on the embedded arms, checked against one set of requirements."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mfc_analysis.plots.batch import in_two_processes, second_process
from mfc_analysis.report.document.document import Column, Document, Number, Scope, Section, Table, written
from mfc_analysis.report.loops.record import gains_section, setups_section
from mfc_analysis.report.render.write import FORMATS, Progress, render

ROOM = "mfc_analysis.report.chapter"
#: the modules of the chapter, in order; each has ``sections(full=...) -> tuple[Section, ...]``
PARTS = ("velocity", "joint_torque", "task", "constraints", "force", "hybrid", "stiffness", "hardware", "beyond", "misprints", "errata")
#: two processes share these better than in the order of the pages
LONGEST_FIRST = ("beyond", "joint_torque", "stiffness", "hardware", "task", "hybrid", "errata", "force")
TOOL, FORCE = ("task",), ("constraints", "force", "hybrid", "stiffness")

DELAYED = " (rightmost roots, dead time included)"

Part = Callable[[], Iterable[Section]]


def chapter_document(progress: Progress | None = None, parts: Sequence[Part] | None = None, *, full: bool = False) -> Document:
    """The chapter as a document.

    Args:
        progress: called with (done, of how many) after each part.
        parts: callables that return sections; omitted: those of ``PARTS``.
        full: a page for each arm and misprint, all pictures, and the poles of all loops.
    """
    from mfc_analysis.report.document.provenance import provenance
    from mfc_analysis.report.document.symbols import symbols

    if parts is None:
        names = set(PARTS)
        order = [*LONGEST_FIRST, *(name for name in PARTS if name not in LONGEST_FIRST)]
        tasks: Iterable[Iterable[Section]] = in_two_processes([partial(part_sections, name, full) for name in order])
    else:
        names = {getattr(part, "__module__", "").rpartition(".")[2] for part in parts}
        order, tasks = [str(k) for k in range(len(parts))], (part() for part in parts)
    found: dict[str, Iterable[Section]] = {}
    for name, some in zip(order, tasks, strict=True):
        found[name] = some
        if progress is not None:
            progress(len(found), len(order))
    sections = [section for name in (order if parts is not None else PARTS) for section in found[name]]
    tool, force = bool(names & set(TOOL)), bool(names & set(FORCE))
    settings = {"seed of the disturbed starts": 0, "tolerances of runs": "rtol 1e-6, atol 1e-9; comparison rtol 1e-10, atol 1e-12"}
    last = "9.24" if force else "9.16" if tool else "9.13"
    overview = validity(sections)
    return Document(
        "Motion and force control of robot arms",
        f"Stability, margins and validity of the linear model for all loops of equations 9.1 to {last} on the embedded arms",
        (*sections, *(() if overview is None else (overview,))),
        "chapter",
        _scope(),
        provenance("mfc-analysis report --full" if full else "mfc-analysis report", settings=settings),
        symbols(tool=tool, force=force),
        (*setups_section(sections), *(x for x in (all_poles(sections) if full else None,) if x is not None)),
        front=gains_section(sections),
    )


def write_chapter(
    folder: str | os.PathLike[str] = "out",
    formats: Sequence[str] = FORMATS,
    progress: Progress | None = None,
    *,
    timestamp: int = 0,
    full: bool = False,
) -> dict[str, Path]:
    """Writes the chapter's report as ``folder/chapter.html``, ``.pdf`` and ``.json``; returns the path of each format.

    ``full``: a page for each arm and misprint, and all pictures. ``progress``: called with (done, of how many): parts of the chapter first, then
    figures and formats. Raises BadArgument as ``render``.
    """
    share = len(PARTS) * 8  # analysing takes about as long as drawing

    def analysed(done: int, total: int) -> None:
        if progress is not None:
            progress(share * done // total, 2 * share)

    def drawn(done: int, total: int) -> None:
        if progress is not None:
            progress(share + share * done // total, 2 * share)

    with second_process():
        return render(chapter_document(analysed, full=full), folder, formats, timestamp=timestamp, progress=drawn)


def part_sections(name: str, full: bool) -> tuple[Section, ...]:
    """The sections of a module of ``PARTS``; it is loaded by the process that makes them."""
    found: tuple[Section, ...] = import_module(f"{ROOM}.{name}").sections(full=full)
    return found


# --- over all loops ----------------------------------------------------------------------------------------------------------


def every_section(sections: Iterable[Section]) -> Iterable[Section]:
    """The sections and those within, in page order."""
    for section in sections:
        yield section
        yield from every_section(section.sections)


def validity(sections: Iterable[Section]) -> Section | None:
    """Linear model compared with nonlinear simulation: model error and range of validity of every loop."""
    rows: list[tuple[Any, ...]] = []
    nearest: tuple[float, str] | None = None
    for section in every_section(sections):
        found = section.numbers.get("validation")
        if not found or not section.loop:
            continue
        radius = float(found["radius"])
        rows.append(
            (
                section.loop,
                Number(0.0 if np.isinf(found["taylor_order"]) else 100 * float(found["nrmse"]), infinite="diverged", undefined="not compared"),
                Number(radius, infinite="all tested sizes"),
                Number(float(found["taylor_order"]), infinite="exact", undefined="not compared"),
            )
        )
        if radius >= 0 and (nearest is None or radius < nearest[0]):
            nearest = (radius, section.loop)
    if not rows or nearest is None:
        return None
    columns = (Column("Loop", numeric=False), Column("Model error at 0.01", "%"), Column("Valid up to", "rad, m"), Column("Taylor order"))
    table = Table(
        "Linear model compared with nonlinear simulation, initial error 0.01 rad (m) in the worst direction. The model is valid while its error is"
        " below 5 %.",
        columns,
        tuple(rows),
    )
    reach = str(Number(nearest[0], "rad", infinite="all tested sizes"))
    finding = f"Of {len(rows)} loops, the linear model of {nearest[1]} has the smallest range of validity: {reach}."
    return Section("Linear model and nonlinear simulation", finding, (table,), key="linear-against-nonlinear")


def all_poles(sections: Iterable[Section]) -> Section | None:
    """Appendix: the poles of every loop in its worst case, slowest first."""
    rows: list[tuple[Any, ...]] = []
    for section in every_section(sections):
        late = section.numbers.get("delay_roots")
        poles = section.numbers.get("poles") if late is None else late
        if poles is None or not section.loop:
            continue
        place = section.numbers.get("worst", {})
        said = poles_words(poles) + ("" if late is None else DELAYED)
        rows.append((section.loop, Number(float(place["time"]), exact=True) if "time" in place else "", said))
    if not rows:
        return None
    columns = (Column("Loop", numeric=False), Column("t", "s"), Column("Poles [1/s]", numeric=False))
    return Section(
        "All poles",
        body=(Table("Closed-loop poles of every loop in its worst case, slowest first; ×n marks n equal poles.", columns, tuple(rows)),),
        key="all-poles",
    )


def poles_words(poles: Iterable[complex]) -> str:
    """Poles on one line, pairs with ±, poles equal to three digits counted."""
    count: dict[str, int] = {}
    for value in poles:
        z = complex(value)
        if z.imag >= -1e-9 * abs(z):
            word = written(z.real) if abs(z.imag) <= 1e-4 * abs(z) else f"{written(z.real)} ± {written(abs(z.imag))}j"
            count[word] = count.get(word, 0) + 1
    return ",  ".join(word if some == 1 else f"{word} (×{some})" for word, some in count.items())


def _scope() -> Scope:
    from mfc_analysis.report.chapter.arms import LIMITS, PAYLOAD, POINTS, arms

    last = arms()[-1]
    return Scope(
        model=(
            "rigid arms with Pinocchio's dynamics: the joint of eq. 9.6, Siciliano's planar two-link arm with its motors, the UR5",
            f"the UR5 carries a payload of {PAYLOAD:g} kg that its controller does not model; the other controllers have an exact model",
            f"requirements of the loops: {LIMITS}; of 9.5 and 9.16 no delay margin is required",
        ),
        assumptions=(
            "linear results hold for small deviations from the operating points; the section on nonlinear simulation says how small",
            "ideal actuators and sensors, unless a section says otherwise",
            "loops shown for demonstration (open loops) are not counted in the verdict",
        ),
        operating_points=(
            f"{POINTS} times along a quintic path of {last.ref.duration:g} s for each arm, integral states trimmed",
            (
                "one channel opened at a time, the others closed; quoted margins are the smallest over all analysis points. The checks of 9.1 to"
                " 9.16 are at the plant's input (torque, or velocity for 9.1 to 9.5), or at the point that they name"
            ),
        ),
        not_checked=(
            "stability during motion: all metrics are frozen in time",
            (
                "actuator lag, dead time, sampling, joint flexibility and torque limits in the joint-space loops (their delay margins give the"
                " allowed delay)"
            ),
            "payloads, poses and speeds other than those of the paths; sensor noise and quantisation",
        ),
    )
