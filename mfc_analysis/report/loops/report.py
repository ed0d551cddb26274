"""The report of your own loops: ``mfc.report.write(loop, "out/", times, requirements=req)``, one loop or several."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.report.render.write import FORMATS, Progress, render

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.report.document.document import Document, Scope
    from mfc_analysis.report.loops.view import View
    from mfc_analysis.requirements.requirements import Requirements

Loops = Any  # ClosedLoop, a sequence of them, or a mapping name -> ClosedLoop


def write(
    loop: ClosedLoop | Sequence[ClosedLoop] | Mapping[str, ClosedLoop],
    folder: str | os.PathLike[str],
    times: ArrayLike | Mapping[str, ArrayLike] = (0.0,),
    formats: Sequence[str] = FORMATS,
    requirements: Requirements | Mapping[str, Requirements] | None = None,
    *,
    at: str | Mapping[str, str | None] | None = None,
    title: str = "",
    name: str = "",
    command: str = "",
    inputs: Mapping[str, bytes] | None = None,
    settings: Mapping[str, object] | None = None,
    date: str = "",
    timestamp: int = 0,
    progress: Progress | None = None,
) -> dict[str, Path]:
    """Writes the report of one loop or several as ``folder/name.html``, ``.pdf`` and ``.json``; returns the path of each format.

    Args:
        loop: a ``ClosedLoop``, a list of them, or a mapping from names to them.
        folder: created if necessary. times: (m,) [s] of the linearisations; or a mapping by the names of the loops.
        formats: some of "html", "pdf", "json".
        requirements: of all loops, or of each by name; omitted: stability only.
        at: analysis point of the margins, of all loops or of each by name; omitted: the plant input.
        title: of the report.
        name: of its files.
        command: provenance, as the page shows it.
        inputs: provenance, name to content; shown by their SHA-256.
        settings: provenance, name to value.
        date: provenance; the clock is not read.
        timestamp: the PDF's date [s since 1970].
        progress: called with (done, of how many).

    Raises BadArgument or a related error for invalid loops, times, formats or analysis points, and for a folder that is a file.
    """
    document = loop_document(loop, times, requirements, at=at, title=title, name=name, command=command, inputs=inputs, settings=settings, date=date)
    return render(document, folder, formats, timestamp=timestamp, progress=progress)


def loop_document(
    loop: Loops,
    times: ArrayLike | Mapping[str, ArrayLike] = (0.0,),
    requirements: Requirements | Mapping[str, Requirements] | None = None,
    *,
    at: str | Mapping[str, str | None] | None = None,
    title: str = "",
    name: str = "",
    command: str = "",
    inputs: Mapping[str, bytes] | None = None,
    settings: Mapping[str, object] | None = None,
    date: str = "",
    done: Callable[[str], None] | None = None,
) -> Document:
    """The document behind ``write``; ``done`` is called with the name of each analysed loop."""
    from mfc_analysis.report.document.document import Document
    from mfc_analysis.report.document.provenance import provenance
    from mfc_analysis.report.document.symbols import symbols
    from mfc_analysis.report.loops.sections import loop_section

    views = _views(loop, times, requirements, at)
    sections = []
    for view in views:
        sections.append(loop_section(view))
        if done is not None:
            done(view.name)
    one = views[0]
    tool = any(v.loop.law.space == "tool" for v in views)
    force = any(v.loop.equations.surfaces or hasattr(v.loop.law, "F_d") for v in views)
    kept = {"seed of the disturbed starts": 0, "tolerances of runs": "rtol 1e-7, atol 1e-9; comparison rtol 1e-10, atol 1e-12"}
    return Document(
        title or (one.name if len(views) == 1 else f"{len(views)} loops"),
        _subtitle(views),
        tuple(sections),
        name or ("loop-report" if len(views) > 1 else one.name),
        scope(views),
        provenance(command, inputs, kept | dict(settings or {}), date),
        symbols(tool=tool, force=force),
        names=_short_names(views),
    )


def _short_names(views: Sequence[View]) -> dict[str, str]:
    """Names of joints -> the same without what all of an arm begin with, as the figures have them."""
    from mfc_analysis.plots.figure import without_prefix

    arms = (v.loop.robot.joint_names for v in views)
    return {long: short for names in arms for long, short in zip(names, without_prefix(names), strict=True) if long != short}


def _subtitle(views: Sequence[View]) -> str:
    if len(views) > 1:
        return ", ".join(dict.fromkeys(f"{v.loop.law.numbered()} on {v.loop.robot.name}" for v in views))
    return str(views[0].loop)


def _views(loop: Loops, times: Any, requirements: Any, at: Any) -> tuple[View, ...]:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.report.loops.view import View
    from mfc_analysis.requirements.requirements import Requirements

    if isinstance(loop, ClosedLoop):
        named: dict[str, Any] = {_name(loop): loop}
    elif isinstance(loop, Mapping):
        named = {str(k): v for k, v in loop.items()}
    elif isinstance(loop, (list, tuple)):
        named = {}
        for i, one in enumerate(loop):
            base = _name(one) if isinstance(one, ClosedLoop) else f"loop {i + 1}"
            named[base if base not in named else f"{base} ({i + 1})"] = one
    else:
        raise BadArgument("loop", loop, "a ClosedLoop, a list of them, or a mapping from names to them")
    if not named:
        raise BadArgument("loop", loop, "at least one ClosedLoop")
    out = []
    for key, one in named.items():
        checks.instance(f"loop[{key!r}]", one, ClosedLoop, "a ClosedLoop")
        asked = _of(requirements, key, "requirements")
        asked = Requirements() if asked is None else asked
        checks.instance("requirements", asked, Requirements, "a Requirements, or a mapping from the loops' names to them")
        out.append(View(key, one, checks.times(_of(times, key, "times")), asked, _of(at, key, "at")))
    return tuple(out)


def _of(given: Any, key: str, argument: str) -> Any:
    if not isinstance(given, Mapping):
        return given
    if key not in given:
        raise BadArgument(argument, list(given), f"an entry for {key!r}")
    return given[key]


def _name(loop: ClosedLoop) -> str:
    return f"{type(loop.law).__name__} ({loop.law.numbered()}) on {loop.robot.name}"


# --- scope -----------------------------------------------------------------------------------------------------------------


def scope(views: Sequence[View]) -> Scope:
    """The basis of the verdicts and what is not checked, derived from the loops."""
    from mfc_analysis.report.document.document import Scope, written

    loops = [v.loop for v in views]
    model = [f"rigid arm with Pinocchio's dynamics: {x}" for x in dict.fromkeys(loop.robot.name for loop in loops)]
    if any(loop.equations.model is not loop.robot for loop in loops):
        model.append("the controller's model differs from the plant")
    elastic = any(loop.equations.hardware.elastic for loop in loops)
    model.append("elastic joints" if elastic else "rigid joints and links")
    points = []
    for v in views[:6]:
        t = v.times
        span = (
            f"t = {written(float(t[0]), exact=True)} s"
            if len(t) == 1
            else f"{len(t)} times from {written(float(t[0]), exact=True)} to {written(float(t[-1]), exact=True)} s"
        )
        points.append(
            f"{v.name if len(views) > 1 else 'on the reference'}: {span}, coordinates “{v.lin.coordinates}”, requirements on margins at “{v.point}”"
        )
    if len(views) > 6:
        points.append(f"and {len(views) - 6} more loops")
    assumed = [
        "linear results hold for small deviations from the operating points",
        "the integral states are trimmed so that the control torque equals the plant's inverse dynamics at the operating point",
    ]
    return Scope(tuple(model), tuple(assumed), tuple(points), tuple(not_checked(views)))


def not_checked(views: Sequence[View]) -> list[str]:
    """What these verdicts do not cover."""
    loops = [v.loop for v in views]
    hardware = [loop.equations.hardware for loop in loops]
    out = []
    if any(not loop.ref.is_hold for loop in loops):
        out.append("stability during motion: all metrics are frozen in time (floquet() and transient_growth() include the motion)")
    missing = [
        word
        for word, there in (
            ("actuator lag", "torque_lag"),
            ("dead time", "delay"),
            ("sampling", "sample_time"),
            ("joint flexibility", "joint_stiffness"),
            ("torque limits", "torque_limit"),
        )
        if all(getattr(h, there) is None for h in hardware) and not (there == "torque_lag" and any(h.velocity_lag is not None for h in hardware))
    ]
    if missing:
        out.append("not modelled in any loop: " + ", ".join(missing))
    out += [
        "friction other than the model's viscous and Coulomb terms",
        "payloads, poses and speeds other than those of the path",
        "sensor noise and quantisation",
    ]
    return out
