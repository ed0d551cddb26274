"""Assertions on loops, for pytest, notebooks and scripts alike (pytest is not needed).

A failure says the worst time and joint, what was asked and found, and code that makes the loop again. NaN fails. WATCH fails as
well: drift unless ``allow_drift``, a residual at the operating points unless ``allow_residual``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.replay import replay
from mfc_analysis.requirements.requirements import Requirements, Verdict

if TYPE_CHECKING:
    from mfc_analysis.simulation.validation import Validation

__all__ = ["Asserted", "assert_margins", "assert_requirements", "assert_stable", "assert_validated", "observed"]

ORDER = 0.05  #: how far below 2 the Taylor order may lie


@dataclass(frozen=True, eq=False)
class Asserted:
    """One assertion that was made, passed or not: what an observer is told."""

    what: str  #: "assert_margins", ...
    loop: ClosedLoop
    times: Any  #: (m,) [s]
    lines: tuple[Line, ...]  #: asked and found, failures first
    status: Status
    passed: bool  #: what the assertion decided: WATCH passes where it is allowed
    replay: str  #: code that makes the loop again and asks again
    verdict: Verdict | None = None
    validation: Validation | None = None


Observer = Callable[[Asserted], None]
_observers: list[Observer] = []


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Tell ``observer`` of every assertion made inside, passed or not: how a report collects them."""
    _observers.append(observer)
    try:
        yield
    finally:
        _observers.remove(observer)


def assert_stable(loop: ClosedLoop, times: ArrayLike = (0.0,), *, allow_drift: bool = False) -> None:
    """The loop linearised about its reference is stable at all times (m,) [s], dead time included.

    Nothing but neutral roots is not stable; a drifting loop passes with ``allow_drift`` if its other roots decay.
    Raises AssertionError, and BadArgument for what cannot be asked.
    """
    __tracebackhide__ = True
    verdict = Requirements().check(loop, times)
    lines = (verdict.line("stable"),)
    allowed = lines[0].status is Status.WATCH and allow_drift
    call = f"from mfc_analysis.testing import assert_stable\nassert_stable(loop, times{', allow_drift=True' if allow_drift else ''})"
    _decide("assert_stable", loop, verdict, lines, lines[0].status is Status.PASS or allowed, call)


def assert_margins(
    loop: ClosedLoop, times: ArrayLike = (0.0,), *, at: str | None = None, allow_drift: bool = False, allow_residual: bool = False, **asked: float
) -> None:
    """Margins (and whatever else ``Requirements`` knows) hold at all times (m,) [s] and channels of the analysis point.

    Args:
        at: analysis point; None: the plant input. asked: fields of ``Requirements``, such as ``phase_deg=45, gain_increase_db=6``.
        allow_drift, allow_residual: pass although the loop drifts, or does not rest at its operating points. A drifting loop without any rest
            point (an infinite error at rest) needs ``allow_drift`` alone.

    Raises AssertionError; UnknownName for a field that isn't one; BadArgument where nothing is asked.
    """
    __tracebackhide__ = True
    if not asked:
        raise BadArgument("asked", "nothing", "at least one field of Requirements, such as phase_deg=45; assert_stable asks for stability alone")
    _assert_requirements("assert_margins", loop, Requirements.from_mapping(asked), times, at, allow_drift, allow_residual)


def assert_requirements(
    loop: ClosedLoop,
    requirements: Requirements,
    times: ArrayLike = (0.0,),
    *,
    at: str | None = None,
    allow_drift: bool = False,
    allow_residual: bool = False,
) -> None:
    """The verdict of ``requirements`` is PASS at all times (m,) [s]; arguments as ``assert_margins``. Raises AssertionError."""
    __tracebackhide__ = True
    if not isinstance(requirements, Requirements):
        raise BadArgument("requirements", requirements, "a Requirements, such as mfc.Requirements(phase_deg=45)")
    _assert_requirements("assert_requirements", loop, requirements, times, at, allow_drift, allow_residual)


def assert_validated(loop: ClosedLoop, time: float = 1.0, *, nrmse: float = 0.05, order: float = 2.0, size: float = 1e-2, seed: int = 0) -> None:
    """The linear model predicts the nonlinear loop over ``time`` [s] from an operating point disturbed by ``size`` [rad, m].

    Args:
        nrmse: largest misfit, a fraction. order: of the Taylor remainder, met from 0.05 below (a linear loop has none: inf).

    Raises AssertionError, and BadArgument for values that cannot be asked.
    """
    __tracebackhide__ = True
    nrmse, order = checks.number("nrmse", nrmse, low=0.0), checks.number("order", order, low=0.0)
    if not isinstance(loop, ClosedLoop):
        raise BadArgument("loop", loop, "a ClosedLoop")
    found = loop.validate(time, size, seed)
    lines = [
        _compared("nrmse", "misfit of the linear model", nrmse, found.nrmse, nrmse - found.nrmse, found.nrmse <= nrmse, "≤"),
        _compared(
            "taylor_order",
            "Taylor order",
            order - ORDER,
            found.taylor_order,
            found.taylor_order - (order - ORDER),
            found.taylor_order >= order - ORDER,
            "≥",
        ),
    ]
    lines.sort(key=lambda line: line.severity, reverse=True)
    status = max((line.status for line in lines), key=lambda s: s.rank)
    call = f"print(loop.validate({time!r}, size={size!r}, seed={seed!r}))"
    code = str(replay(loop, None, call))
    asserted = Asserted("assert_validated", loop, np.zeros(1), tuple(lines), status, status is Status.PASS, code, validation=found)
    _tell(asserted)
    if not asserted.passed:
        raise AssertionError(_message(f"{status.value}: {loop}; {found}", lines, code))


def _assert_requirements(
    what: str, loop: ClosedLoop, requirements: Requirements, times: ArrayLike, at: str | None, allow_drift: bool, allow_residual: bool
) -> None:
    __tracebackhide__ = True
    verdict = requirements.check(loop, times, at)
    allowed = {name for name, yes in (("stable", allow_drift), ("residual", allow_residual)) if yes}
    if allow_drift and verdict.line("stable").status is Status.WATCH and any(line.name == "residual" and line.found == inf for line in verdict.lines):
        allowed.add("residual")  # no rest point within reach: that is the drift itself
    passed = all(line.status is Status.PASS or (line.status is Status.WATCH and line.name in allowed) for line in verdict.lines)
    asked = ", ".join(f"{name}={limit!r}" for name, limit in requirements.asked().items())
    _decide(what, loop, verdict, verdict.lines, passed, f"print(mfc.Requirements({asked}).check(loop, times, at={verdict.at!r}))")


def _decide(what: str, loop: ClosedLoop, verdict: Verdict, lines: tuple[Line, ...], passed: bool, call: str) -> None:
    __tracebackhide__ = True
    if passed and not _observers:
        return
    code = str(replay(loop, verdict.times, call))
    status = max((line.status for line in lines), key=lambda s: s.rank)
    _tell(Asserted(what, loop, verdict.times, lines, status, passed, code, verdict))
    if not passed:
        raise AssertionError(_message(str(verdict), lines, code))


def _message(table: str, lines: list[Line] | tuple[Line, ...], code: str) -> str:
    """The worst in a sentence, the table, and the code."""
    return "\n".join([_sentence(lines[0]), "", table, "", "to see it again:", "", *(f"    {line}".rstrip() for line in code.splitlines())])


def _sentence(line: Line) -> str:
    unit = f" {line.unit}" if line.unit else ""
    found = "is not defined" if isnan(line.found) else f"is {line.found:.6g}{unit}"
    place = f" ({line.place})" if line.place else ""
    note = f": {line.note}" if line.note else ""
    asked = {"≥": "at least", "≤": "at most", "<": "below"}[line.sense]
    head = line.label
    if line.name == "stable":
        head = "the loop drifts: of its other roots the rightmost" if line.status is Status.WATCH else "the loop is not stable: its rightmost root"
    return f"{head} {found}{place}, asked {asked} {line.asked:.6g}{unit}{note}"


def _compared(name: str, label: str, asked: float, found: float, distance: float, met: bool, sense: str) -> Line:
    return Line(name, asked, found, "", distance, Status.PASS if met else Status.FAIL, sense=sense, label=label)


def _tell(asserted: Asserted) -> None:
    for observer in tuple(_observers):
        observer(asserted)
