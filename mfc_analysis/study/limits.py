"""The limits of a study: those of stability that its ``[design]`` table asks for, and those at which its requirements are just met."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.errors import BadArgument, MfcError

if TYPE_CHECKING:
    from mfc_analysis.design.attribution import Attribution
    from mfc_analysis.design.searches import Limit
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.study.read import StudyLoop

Progress = Callable[[str, int, int], None]
Loops = Callable[[float], Sequence["ClosedLoop"]]

SEARCHES = ("max_stiffness", "max_delay", "max_payload", "min_sample_rate", "max_bandwidth")  #: keys of ``[design]``, searches of ``mfc.design``
COLUMNS = ("limit", "value", "as given", "binding requirement", "where", "when")
HEAVIEST, LATEST, SLOWEST, FASTEST = 1e3, 10.0, 10.0, 1e5  #: ends of a search: [kg], [s], [s] period, [1/s]
STIFFEST = 1e6  #: [N/m] end of a search, or a hundred times the wall as given
MOST_IN_TRANSIT = 16  #: samples of dead time of the fastest sampling searched
WIDEST = 1e3  #: factor on the bandwidth as given, up and down


def limits(one: StudyLoop, progress: Progress = lambda what, done, of: None) -> tuple[Limit, ...]:
    """The limits selected in the ``[design]`` table of a loop, in its order. Raises StudyError if a search does not apply."""
    from mfc_analysis import design

    asked = [name for name in SEARCHES if getattr(one.table.design, name)]
    out: list[Limit] = []
    for i, name in enumerate(asked):
        progress(f"{one.name}: {name}", i, len(asked))
        with one.parts.within(f"design.{name}"):
            if name == "max_bandwidth":
                out.append(design.max_bandwidth(_over_bandwidth(one)[0], one.requirements, one.times, at=one.at))
            else:
                out.append(getattr(design, name)(one.loop, times=one.times, horizon=one.requirements.horizon))
    return tuple(out)


# --- limits at which the requirements are met ----------------------------------------------------------------------------


class Searched(NamedTuple):
    """One quantity, and the limit found from its value in the study."""

    name: str  #: in words
    unit: str
    given: float  #: value in the study; a sample rate of inf: continuous
    limit: Limit | None  #: None where it cannot be searched
    why: str = ""  #: why it cannot


@dataclass(frozen=True, eq=False)
class LoopLimits:
    """The limits of a loop of a study."""

    loop: StudyLoop
    met: bool  #: the requirements, by the loop as given (over its ranges)
    found: tuple[Searched, ...]
    costs: Attribution  #: what each imperfection costs

    def rows(self) -> list[tuple[str, ...]]:
        """Cells of the table, in the order of COLUMNS."""
        out: list[tuple[str, ...]] = []
        for name, unit, given, limit, _ in self.found:
            line = None if limit is None else limit.binding
            value = "not found" if limit is None else _value(limit)
            when = "" if line is None or line.when is None else f"{line.when:.4g} s"
            start = "continuous" if given == np.inf else f"{given:.4g} {unit}"
            out.append((name, value, start, line.label if line else "none", line.where if line else "", when))
        return out

    def sentences(self) -> list[str]:
        """The pose of each limit in joint angles, what is missed as given, and why a limit cannot be found."""
        poses: dict[str, list[str]] = {}
        out = []
        for name, _, _, limit, why in self.found:
            if limit is None:
                out.append(f"{name}: not found: {why}")
                continue
            if limit.pose:
                units = limit.loop.robot.joint_units
                angles = ", ".join(f"{joint} {x:.4g} {unit}" for (joint, x), unit in zip(limit.pose.items(), units, strict=True))
                poses.setdefault(f"pose at t = {limit.binding.when if limit.binding else 0:.4g} s: {angles}", []).append(name)
            if limit.outcome.name == "NOWHERE":
                out.append(f"{name}: {limit.binds}")
            out += [f"{name}: {note}" for note in limit.notes]
        return [f"{pose} ({', '.join(names)})" for pose, names in poses.items()] + out


def _value(limit: Limit) -> str:
    return {"FOUND": f"{float(limit):.6g} {limit.unit}", "NOWHERE": "no value"}.get(limit.outcome.name, "no limit found")


def requirement_limits(one: StudyLoop, progress: Progress = lambda what, done, of: None) -> LoopLimits:
    """The largest payload, dead time, wall stiffness and bandwidth and the slowest sampling at which a loop meets its requirements, over its ranges.

    Each quantity alone is varied from its value in the study; a range of that quantity itself is left out. A wall is only searched where
    there is one, a payload for laws of torque, a bandwidth with ``law.gains``. Raises StudyError if the loop cannot be checked as it is.
    """
    from mfc_analysis.design.attribution import attribute
    from mfc_analysis.design.edges import QUANTITIES, Judge, requirement_limit

    judge = Judge(one.requirements, one.times, one.at)
    with one.parts.within(""):
        given = _cases(one, "")({})
        met = judge.worst(given)[0] >= 0
    found: list[Searched] = []
    which = _quantities(one)
    for i, quantity in enumerate(which):
        about = QUANTITIES[quantity]
        progress(f"{one.name}: {about.name}", i, len(which))
        start = np.nan
        try:
            loops, start, lower, upper = _varied(one, quantity, given)
            limit, why = requirement_limit(loops, quantity, start, judge, lower=lower, upper=upper), ""
        except MfcError as error:
            limit, why = None, str(error)
        found.append(Searched(about.name, about.unit, (1 / start if start else np.inf) if about.rate else start, limit, why))
    return LoopLimits(one, met, tuple(found), attribute(one.loop, one.requirements, one.times, at=one.at))


def as_json(loops: Sequence[LoopLimits]) -> str:
    """The limits as JSON; infinite and undefined values are words."""
    out = []
    for one in loops:
        limits = {}
        for name, unit, given, limit, why in one.found:
            line = None if limit is None else limit.binding
            limits[name] = {
                "value": "not found" if limit is None else number(float(limit)), "unit": unit, "as given": number(given),
                "binding": line.name if line else None, "where": line.where if line else None, "when": line.when if line else None,
                "pose": {} if limit is None else limit.pose, "notes": [why] if limit is None else list(limit.notes),
            }  # fmt: skip
        out.append({"loop": one.loop.name, "met": one.met, "limits": limits})
    return json.dumps(out, indent=2, ensure_ascii=False)


def number(value: float) -> float | str:
    """A number for JSON, in words where it is not finite."""
    return value if math.isfinite(value) else "undefined" if math.isnan(value) else "infinite" if value > 0 else "minus infinity"


def _quantities(one: StudyLoop) -> list[str]:
    torque, wall = one.loop.law.plant == "torque", bool(one.loop.equations.surfaces)
    some = {"payload": torque, "delay": True, "bandwidth": one.table.law.gains is not None, "stiffness": wall, "sample_time": True}
    return [name for name, there in some.items() if there]


def _cases(one: StudyLoop, without: str) -> Callable[[dict[str, float]], list[ClosedLoop]]:
    """Plant parameters -> the loops over the ranges, the range of ``without`` left out."""
    spans = {name: span.points() for name, span in one.table.ranges.given().items() if name != without}
    combinations = [dict(zip(spans, values, strict=True)) for values in itertools.product(*spans.values())]

    def loops(values: dict[str, float]) -> list[ClosedLoop]:
        changes = [combination | values for combination in combinations]
        return [one.parts.varied(change) if change else one.loop for change in changes]

    return loops


def _varied(one: StudyLoop, quantity: str, given: list[ClosedLoop]) -> tuple[Loops, float, float, float]:
    """The loops as a function of a quantity, its value in the study, and the ends of the search."""
    from mfc_analysis.design.limits import with_stiffness

    table, hardware = one.table, one.loop.equations.hardware
    if quantity == "bandwidth":
        loops, start = _over_bandwidth(one)
        return loops, start, start / WIDEST, start * WIDEST
    cases = _cases(one, quantity)
    if quantity == "stiffness":
        walls = [with_stiffness(loop, float(one.times[0])) for loop in (given if "stiffness" not in table.ranges.given() else cases({}))]
        start = walls[0][1]
        if start <= 0:
            raise BadArgument("environment.stiffness", start, "a positive stiffness, from which the search starts")
        return lambda k: [stiffer(k) for stiffer, _ in walls], start, 1e-6 * start, max(STIFFEST, 100 * start)
    start = float({
        "payload": table.robot.payload[0].mass if table.robot.payload else 0.0,
        "delay": hardware.delay or 0.0,
        "sample_time": hardware.sample_time or 0.0,
    }[quantity])  # fmt: skip
    late = max(hardware.command_delay, hardware.force_delay or 0.0) / MOST_IN_TRANSIT
    longest = LATEST if not hardware.sample_time else min(LATEST, 100 * hardware.sample_time)
    ends = {"payload": (0.0, HEAVIEST), "delay": (0.0, max(longest, 2 * start)), "sample_time": (max(1 / FASTEST, late), SLOWEST)}[quantity]
    ranged = quantity in table.ranges.given()
    return lambda x: given if x == start and not ranged else cases({quantity: x}), start, *ends


def _over_bandwidth(one: StudyLoop) -> tuple[Loops, float]:
    """The loops over the ranges as a function of the bandwidth [rad/s] of the gains helper, and its bandwidth. Raises BadArgument."""
    gains = one.table.law.gains
    if gains is None:
        raise BadArgument("design.max_bandwidth", True, "a study with law.gains, the helper whose bandwidth is varied")
    varied_keys = [key + unit for key in ("bandwidth", "natural_frequency", "crossover", "settling_time", "step") for unit in ("", "_hz")]
    kept = {key: value for key, value in gains.given().items() if key not in varied_keys}

    def loops(bandwidth: float) -> list[ClosedLoop]:
        law = one.table.law.model_copy(update={"gains": type(gains)(**kept, bandwidth=bandwidth)})
        parts = replace(one.parts, table=one.table.model_copy(update={"law": law}))
        varied = replace(one, loop=parts.loop(), table=parts.table, parts=parts)
        return [case.loop for case in varied.cases()] or [varied.loop]

    achieved = one.parts.designed(gains).achieved
    start = gains.si("bandwidth") or (float(np.min(achieved.bandwidth)) if achieved is not None else np.nan)
    return loops, float(start)
