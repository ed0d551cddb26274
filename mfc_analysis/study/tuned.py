"""The gains that a study asks for in ``[design] tune``: those that meet its requirements over its ranges."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mfc_analysis.errors import BadArgument

if TYPE_CHECKING:
    from mfc_analysis.design.tuning import Tuned
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.study.read import StudyLoop

OF_THE_HELPER = ("bandwidth", "damping")  #: gains of ``law.gains``; the others are keys of the law
SPECIFICATIONS = ("bandwidth", "bandwidth_hz", "natural_frequency", "natural_frequency_hz", "crossover", "crossover_hz", "settling_time", "step")


def tuned(one: StudyLoop) -> Tuned | None:
    """The tuned gains of a loop; None where its study asks for none. Raises StudyError."""
    from mfc_analysis import design

    table = one.table.design.tune
    if table is None:
        return None
    with one.parts.within("design.tune"):
        names = [name for name in type(table).model_fields if not name.endswith("_hz") and name != "wanted" and table.si(name) is not None]
        if any(name in OF_THE_HELPER for name in names) and one.table.law.gains is None:
            raise BadArgument("tune", names, "bandwidth or damping with law.gains, or gains of the law, such as kp")
        ranges = {name: span.points() for name, span in one.table.ranges.given().items()}

        def loop(**given: float) -> ClosedLoop:
            return with_gains(one, {name: given[name] for name in names}, {name: given[name] for name in ranges})

        gains = {name: table.si(name) for name in names}
        found: Tuned = design.tune(loop, gains, one.requirements, one.times, ranges=ranges, wanted=table.si("wanted"), at=one.at)
    return found


def with_gains(one: StudyLoop, gains: dict[str, float], case: dict[str, float]) -> ClosedLoop:
    """The loop of a study with other gains, in a case of its ranges."""
    law = one.table.law
    helper = {name: value for name, value in gains.items() if name in OF_THE_HELPER}
    changes: dict[str, Any] = {name: value for name, value in gains.items() if name not in OF_THE_HELPER}
    if helper and law.gains is not None:
        dropped = SPECIFICATIONS if "bandwidth" in helper else ()
        kept = {name: value for name, value in law.gains.given().items() if name not in dropped}
        given: dict[str, Any] = kept | helper
        changes["gains"] = type(law.gains)(**given)
    parts = replace(one.parts, table=one.table.model_copy(update={"law": law.model_copy(update=changes)}))
    return parts.varied(case) if case else parts.loop()
