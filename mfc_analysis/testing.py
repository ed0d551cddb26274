"""Assertions on loops, for pytest, notebooks and scripts (pytest is not required).

A failure reports the worst time and joint, the limit and the value found, and code that rebuilds the loop. NaN fails. WATCH also
fails: drift unless ``allow_drift``, a residual at the operating points unless ``allow_residual``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.loop_step import SettlingStep
from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.replay import replay
from mfc_analysis.requirements.requirements import Requirements, Verdict

if TYPE_CHECKING:
    from mfc_analysis.simulation.validation import Validation

__all__ = ["Asserted", "assert_margins", "assert_requirements", "assert_stable", "assert_validated", "observed"]


def __dir__() -> list[str]:
    return __all__


ORDER = 0.05  #: how far the Taylor order may lie below the required one


@dataclass(frozen=True, eq=False)
class Asserted:
    """One assertion, passed or not, as an observer receives it."""

    what: str  #: "assert_margins", ...
    loop: ClosedLoop  #: asserted on
    times: Any  #: (m,) [s]
    lines: tuple[Line, ...]  #: limits and values found, failures first
    status: Status  #: the worst of the lines
    passed: bool  #: result of the assertion: WATCH passes where it is allowed
    replay: str  #: code that rebuilds the loop and repeats the check
    verdict: Verdict | None = None  #: of margins and requirements
    validation: Validation | None = None  #: of ``assert_validated``


Observer = Callable[[Asserted], None]
_observers: list[Observer] = []


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Passes every assertion made in the context, passed or not, to ``observer``. Reports collect assertions in this way."""
    _observers.append(observer)
    try:
        yield
    finally:
        _observers.remove(observer)


def assert_stable(loop: ClosedLoop, times: ArrayLike = (0.0,), *, allow_drift: bool = False, horizon: float = HORIZON) -> None:
    """Asserts that the loop linearised about its reference is stable at all times (m,) [s] over ``horizon`` [s], dead time included.

    A loop with slow roots only is not stable; a drifting loop passes with ``allow_drift`` if its other roots are stable.
    Raises AssertionError, and BadArgument for bad input.
    """
    __tracebackhide__ = True
    asked = Requirements(horizon=horizon)
    verdict = asked.check(loop, times)
    lines = (verdict.line("stable"),)
    allowed = lines[0].status is Status.WATCH and allow_drift
    more = ["allow_drift=True"] if allow_drift else []
    more += [asked.code.removeprefix("mfc.Requirements(").removesuffix(")")] if asked.horizon != HORIZON else []
    call = f"from mfc_analysis.testing import assert_stable\nassert_stable({', '.join(['loop', 'times', *more])})"
    _decide("assert_stable", loop, verdict, lines, lines[0].status is Status.PASS or allowed, call)


def assert_margins(
    loop: ClosedLoop,
    times: ArrayLike = (0.0,),
    *,
    at: str | None = None,
    step: SettlingStep = "reference",
    allow_drift: bool = False,
    allow_residual: bool = False,
    **asked: float,
) -> None:
    """Asserts margins (and any other field of ``Requirements``) at all times (m,) [s] and channels of the analysis point.

    Args:
        loop: to be tested. times: (m,) [s]. at: analysis point; None: the plant input.
        asked: fields of ``Requirements``, such as ``phase_deg=45, gain_increase_db=6``;
            ``horizon`` [s] is one of them.
        step: of ``settling_time`` and ``overshoot``, "reference" or "loop" (T = L/(1 + L) at the analysis point), as in ``Requirements``.
        allow_drift: pass although the loop drifts, which then has no rest point within the horizon. allow_residual: pass although the loop does not
            stay at its operating points; a loop that drifts does not need it.

    Raises AssertionError; UnknownName for an unknown field; BadArgument without any field.
    """
    __tracebackhide__ = True
    if not set(asked) - {"horizon"}:
        raise BadArgument("asked", "nothing", "at least one field of Requirements, such as phase_deg=45; assert_stable checks stability alone")
    _assert_requirements("assert_margins", loop, Requirements.from_mapping({**asked, "step": step}), times, at, allow_drift, allow_residual)


def assert_requirements(
    loop: ClosedLoop,
    requirements: Requirements,
    times: ArrayLike = (0.0,),
    *,
    at: str | None = None,
    allow_drift: bool = False,
    allow_residual: bool = False,
) -> None:
    """Asserts that the verdict of ``requirements`` is PASS at all times (m,) [s]. Other arguments as ``assert_margins``.

    Raises AssertionError.
    """
    __tracebackhide__ = True
    if not isinstance(requirements, Requirements):
        raise BadArgument("requirements", requirements, "a Requirements, such as mfc.Requirements(phase_deg=45)")
    _assert_requirements("assert_requirements", loop, requirements, times, at, allow_drift, allow_residual)


def assert_validated(loop: ClosedLoop, time: float = 1.0, *, nrmse: float = 0.05, order: float = 2.0, size: float = 1e-2, seed: int = 0) -> None:
    """Asserts that the linear model predicts the nonlinear loop over ``time`` [s], from an operating point disturbed by ``size`` [rad, m].

    Args:
        loop: to be tested. time: [s] of the runs. size: [rad, m] of the disturbance. nrmse: largest misfit, a fraction.
        order: of the Taylor remainder, with a tolerance of 0.05 (inf for a linear loop, which has none).
        seed: of the search for the worst disturbance, as in ``ClosedLoop.validate``.

    Raises AssertionError, and BadArgument for bad values.
    """
    __tracebackhide__ = True
    nrmse, order = checks.number("nrmse", nrmse, low=0.0), checks.number("order", order, low=0.0)
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
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
    if allow_drift and verdict.drifts and verdict.line("stable").status is Status.WATCH:
        allowed.add("residual")  # what the residual moves within the horizon is the drift itself
    passed = all(line.status is Status.PASS or (line.status is Status.WATCH and line.name in allowed) for line in verdict.lines)
    _decide(what, loop, verdict, verdict.lines, passed, f"print({requirements.code}.check(loop, times, at={verdict.at!r}))")


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
    """The worst line as a sentence, the table and the code."""
    return "\n".join([_sentence(lines[0]), "", table, "", "to reproduce it:", "", *(f"    {line}".rstrip() for line in code.splitlines())])


def _sentence(line: Line) -> str:
    unit = f" {line.unit}" if line.unit else ""
    found = "is not defined" if isnan(line.found) else f"is {line.found:.6g}{unit}"
    place = f" ({line.place})" if line.place else ""
    note = f": {line.note}" if line.note else ""
    if line.name == "stable" and line.note.startswith("unstable"):
        return f"the loop is not stable{note.removeprefix(': unstable')}"
    asked = {"≥": "at least", "≤": "at most", "<": "below"}[line.sense]
    head = line.label
    if line.name == "stable":
        head = "the loop drifts: the rightmost of its other roots" if line.status is Status.WATCH else "the loop is not stable: its rightmost root"
    return f"{head} {found}{place}, asked {asked} {line.asked:.6g}{unit}{note}"


def _compared(name: str, label: str, asked: float, found: float, distance: float, met: bool, sense: str) -> Line:
    return Line(name, asked, found, "", distance, Status.PASS if met else Status.FAIL, sense=sense, label=label)


def _tell(asserted: Asserted) -> None:
    for observer in tuple(_observers):
        observer(asserted)
