"""The design limits of a study: largest stiffness, delay, payload and bandwidth, and smallest sample rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from mfc_analysis.errors import BadArgument

if TYPE_CHECKING:
    from mfc_analysis.design.searches import Limit
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.study.read import StudyLoop

Progress = Callable[[str, int, int], None]


def limits(one: StudyLoop, progress: Progress = lambda what, done, of: None) -> tuple[Limit, ...]:
    """The limits selected in the ``[design]`` table of a loop, in its order. Raises StudyError if a search does not apply."""
    from mfc_analysis import design

    asked = [name for name in type(one.table.design).model_fields if getattr(one.table.design, name)]
    out: list[Limit] = []
    for i, name in enumerate(asked):
        progress(f"{one.name}: {name}", i, len(asked))
        with one.parts.within(f"design.{name}"):
            search = getattr(design, name) if name != "max_bandwidth" else None
            out.append(search(one.loop, times=one.times, horizon=one.requirements.horizon) if search else _bandwidth(one))
    return tuple(out)


def _bandwidth(one: StudyLoop) -> Limit:
    """Largest bandwidth of the gains helper, over all cases of the ranges."""
    from mfc_analysis import design

    gains = one.table.law.gains
    if gains is None:
        raise BadArgument("design.max_bandwidth", True, "a study with law.gains, the helper whose bandwidth is varied")
    kept = {key: value for key, value in gains.given().items() if key in ("helper", "damping", "inertia", "stiffness", "mass", "lag", "friction")}

    def loops(bandwidth: float) -> list[ClosedLoop]:
        law = one.table.law.model_copy(update={"gains": type(gains)(**kept, bandwidth=bandwidth)})
        parts = replace(one.parts, table=one.table.model_copy(update={"law": law}))
        varied = replace(one, loop=parts.loop(), table=parts.table, parts=parts)
        return [case.loop for case in varied.cases()] or [varied.loop]

    found: Limit = design.max_bandwidth(loops, one.requirements, one.times, at=one.at)
    return found
