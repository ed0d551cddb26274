"""Design searches for the limits of stiffness, dead time, sample rate, payload and bandwidth, by bisection on exact stability.

Stability is that of the roots that are not slow (over ``horizon`` [s]), with exact dead time and sampling, at all ``times`` (a Hold: at 0;
else 21 times over the duration or period of the reference). Each result is a float with the limiting condition, and the loop at the limit in
``.loop``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.design.searches import CLOSE, Bracket, Limit, Outcome, first_loss, scan, shown
from mfc_analysis.design.worst_case import WorstCase, worst_case
from mfc_analysis.dynamics.environment import STIFFEST, stiffened
from mfc_analysis.dynamics.hardware import LONGEST, SHORTEST, Hardware
from mfc_analysis.errors import BadArgument
from mfc_analysis.linearization.linearization import linearize
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.requirements.evidence import Evidence
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import Requirements

__all__ = ["Limit", "Outcome", "WorstCase", "max_bandwidth", "max_delay", "max_payload", "max_stiffness", "min_sample_rate", "worst_case"]

HEAVIEST = 1e9  #: [kg] largest payload searched for
USUAL_RATE = 1e5  #: [1/s] highest sample rate searched at first
MOVING_TIMES = 21  #: times checked along a moving reference


def max_stiffness(loop: ClosedLoop, upper: float = 1e6, *, times: ArrayLike | None = None, horizon: float = HORIZON, progress: bool = False) -> Limit:
    """Largest environment stiffness [N/m] (rotations alone: [Nm/rad]) with which the loop is stable; inf if stable up to ``upper``.

    The search varies every environment with a preload (all of them where none has one): it scales the stiffness so that the largest
    translational entry has the value, and keeps the damping. The force at the reference does not change: the preload compensates
    penetration times the change of stiffness. The scan starts at 1e-8 ``upper`` and ends at the first loss; 0 if stable nowhere. Notes say
    where softer walls, or stiffer ones beyond a loop that holds on some in between only, differ.

    Raises BadArgument: a loop without an environment, ``upper`` not a positive number up to 1e15.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=0.0, high=STIFFEST, strict=True)
    surfaces = loop.equations.surfaces
    if not surfaces:
        raise BadArgument("loop", str(loop), "a loop with an environment: ClosedLoop(..., environment=mfc.Environment(...))")
    pressed = [s.f0.any() for s in surfaces]
    varied = pressed if any(pressed) else [True] * len(surfaces)
    X = loop.robot.pose(loop.nominal(_times(loop, times)[:1]).q[0])

    def stiffer(k: float) -> ClosedLoop:
        return replace(loop, environment=[stiffened(s, k, X) if vary else s for s, vary in zip(surfaces, varied, strict=True)])

    return _limit(stiffer, scan(1e-8 * upper, upper), loop, times, horizon, "largest stable stiffness", "N/m", progress)


def max_delay(loop: ClosedLoop, upper: float = 10.0, *, times: ArrayLike | None = None, horizon: float = HORIZON, progress: bool = False) -> Limit:
    """Largest dead time [s] of the actuators (``Hardware.delay``, in place of the given one) with which the loop is stable.

    inf if stable up to ``upper`` [s], 1e-9 to 1e9; 0 if it is not stable without dead time. The smallest delay margin of the loop without
    dead time is one of the values of the scan, so that the limit of a single joint is that of ``margins``. Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=SHORTEST, high=LONGEST)
    hardware = loop.hardware or Hardware()

    def later(delay: float) -> ClosedLoop:
        return replace(loop, hardware=replace(hardware, delay=delay if delay >= SHORTEST else None))

    alone = linearize(later(0.0).equations, _times(loop, times), horizon=horizon).margins().delay
    first = alone[(alone > 0) & (alone < upper)]
    values = np.union1d(scan(1e-6 * upper, upper), first.min(keepdims=True) * (1 + CLOSE) if first.size else first)
    return _limit(later, np.concatenate([[0.0], values]), loop, times, horizon, "largest stable dead time", "s", progress)


def max_payload(
    loop: ClosedLoop,
    upper: float = 1e3,
    *,
    com: ArrayLike = (0.0, 0.0, 0.0),
    times: ArrayLike | None = None,
    horizon: float = HORIZON,
    progress: bool = False,
) -> Limit:
    """Largest payload [kg] at the tool, unknown to the controller, with which the loop is stable about its reference.

    The payload is a point mass at ``com`` (3,) [m] in tool axes, added to the payload of the plant; the controller's model does not
    change. inf if stable up to ``upper`` [kg], at most 1e9; 0 if it is not stable without. Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=0.0, high=HEAVIEST, strict=True)
    com = checks.array("com", com, (3,))
    model = loop.equations.model

    def heavier(mass: float) -> ClosedLoop:
        return replace(loop, robot=loop.robot.with_payload(mass, com) if mass else loop.robot, controller_model=model)

    return _limit(heavier, np.concatenate([[0.0], scan(1e-6 * upper, upper)]), loop, times, horizon, "largest stable payload", "kg", progress)


def min_sample_rate(
    loop: ClosedLoop, lower: float = 0.1, upper: float | None = None, *, times: ArrayLike | None = None, horizon: float = HORIZON,
    progress: bool = False,
) -> Limit:  # fmt: skip
    """Smallest rate [1/s] of a sampled controller (``Hardware.sample_time``, zero-order hold) with which the loop is stable.

    The search goes down from ``upper`` to the first loss; 0 if stable down to ``lower``, inf if not stable at any rate of the search, whose
    ends ``binds`` gives. Rates are 1e-9 to 1e9 1/s. ``upper`` None: 1e5 1/s, and 1e9 1/s where no rate up to there is stable.
    Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    ends = ("lower", lower), ("upper", USUAL_RATE if upper is None else upper)
    low, high = (checks.number(name, rate, low=1 / LONGEST, high=1 / SHORTEST) for name, rate in ends)
    hardware = loop.hardware or Hardware()

    def sampled(period: float) -> ClosedLoop:
        return replace(loop, hardware=replace(hardware, sample_time=period))

    def search(low: float, high: float) -> Limit:
        return _limit(sampled, scan(1 / high, 1 / low), loop, times, horizon, "smallest stable sample rate", "1/s", progress, rate=True)

    found = search(low, high)
    if found.outcome is Outcome.NOWHERE and upper is None:
        found = search(low, 1 / SHORTEST)
    value = {Outcome.FOUND: 1 / found if found else np.inf, Outcome.UNLIMITED: 0.0, Outcome.NOWHERE: np.inf}[found.outcome]
    above = f"above the upper end of the search, {high:g} 1/s: " if found.outcome is Outcome.NOWHERE and upper is not None else ""
    note = (f"sample time {float(found):.6g} s",) if found.outcome is Outcome.FOUND else ()
    return Limit(value, found.name, found.unit, found.outcome, above + found.binds, found.loop, found.beyond, found.evaluations, note + found.notes)


def max_bandwidth(
    make_loop: Callable[[float], ClosedLoop | Sequence[ClosedLoop]],
    requirements: Requirements,
    times: ArrayLike,
    *,
    at: str | None = None,
    lower: float = 0.1,
    upper: float = 1e4,
    progress: bool = False,
) -> Bandwidth:
    """Largest bandwidth [rad/s] whose loop meets the requirements. ``.binding`` is the requirement missed just above it.

    Args:
        make_loop: bandwidth [rad/s] -> the loop, or several (payloads, surfaces) that must all meet the requirements.
        times, at: as for ``Requirements.check``. lower, upper: [rad/s] ends of the search.

    WATCH counts as met. Bandwidths from ``lower`` on that miss the requirements (too slow, for example) are skipped and noted. 0 if met
    nowhere, inf if met up to ``upper``. Raises BadArgument, and any error of ``make_loop``.
    """
    if not isinstance(requirements, Requirements):
        raise BadArgument("requirements", requirements, "a Requirements, such as mfc.Requirements(phase_deg=45)")
    if not callable(make_loop):
        raise BadArgument("make_loop", make_loop, "a function of the bandwidth [rad/s] that returns a ClosedLoop or several")
    lower, upper = checks.number("lower", lower, low=0.0, strict=True), checks.number("upper", upper, low=0.0, strict=True)
    t = checks.times(times)
    with shown(progress, "largest bandwidth [rad/s]") as tick:

        def missed(bandwidth: float) -> tuple[ClosedLoop, Line | None]:
            tick(bandwidth)
            return _missed(make_loop(bandwidth), requirements, t, at)

        bracket = first_loss(lambda w: missed(w)[1] is None, scan(lower, upper, 6))
        return _bandwidth(bracket, missed, lower)


class Bandwidth(Limit):
    """The result of ``max_bandwidth``: a ``Limit`` [rad/s] with the limiting requirement."""

    binding: Line | None = None  #: the requirement missed just above the limit; None where none is


def _bandwidth(bracket: Bracket, missed: Callable[[float], tuple[ClosedLoop, Line | None]], lower: float) -> Bandwidth:
    name, unit = "largest bandwidth", "rad/s"
    count = bracket.evaluations
    if bracket.outcome is Outcome.UNLIMITED:
        return Bandwidth(
            np.inf, name, unit, bracket.outcome, f"every requirement is met up to {bracket.holds:.6g} rad/s", missed(bracket.holds)[0], None, count
        )
    beyond, line = missed(bracket.lost)
    assert line is not None
    said = f"above it {line.label} is missed: {_shown(line)}"
    if bracket.outcome is Outcome.NOWHERE:
        out = Bandwidth(
            0.0,
            name,
            unit,
            bracket.outcome,
            f"no bandwidth meets every requirement; at {bracket.lost:.6g} rad/s {_shown(line)}",
            beyond,
            beyond,
            count,
        )
    else:
        slow = "" if bracket.before is None else f"at {lower:.4g}" if bracket.before <= lower else f"from {lower:.4g} up to {bracket.before:.4g}"
        notes = (f"the requirements are also missed {slow} rad/s",) if slow else ()
        out = Bandwidth(bracket.holds, name, unit, bracket.outcome, said, missed(bracket.holds)[0], beyond, count, notes)
    out.binding = line
    return out


def _missed(made: ClosedLoop | Sequence[ClosedLoop], requirements: Requirements, times: Array, at: str | None) -> tuple[ClosedLoop, Line | None]:
    """The worst loop and its failed line, if any."""
    loops = [made] if isinstance(made, ClosedLoop) else list(made)
    if not loops or not all(isinstance(x, ClosedLoop) for x in loops):
        raise BadArgument("make_loop", made, "a function that returns a ClosedLoop or several")
    worst: tuple[ClosedLoop, Line | None] = (loops[0], None)
    for loop in loops:
        line = requirements.check(loop, times, at).worst
        if line.status is Status.FAIL and (worst[1] is None or line.severity > worst[1].severity):
            worst = loop, line
    return worst


def _shown(line: Line) -> str:
    return f"found {line.found:.6g} {line.unit}, asked {line.sense} {line.asked:.6g} {line.unit}".replace("  ", " ") + (
        f" ({line.place})" if line.place else ""
    )


# --- the search on stability -----------------------------------------------------------------------------------------


def stable(loop: ClosedLoop, times: ArrayLike, horizon: float = HORIZON) -> bool:
    """True if all roots that are not slow are stable at all times (m,) [s], with exact dead time and sampling."""
    return bool(Evidence(loop.equations, checks.times(times), horizon=horizon).judged.all())


def _limit(
    make: Callable[[float], ClosedLoop], values: Array, loop: ClosedLoop, times: ArrayLike | None, horizon: float, name: str, unit: str,
    progress: bool, rate: bool = False,
) -> Limit:  # fmt: skip
    """``rate``: the values are times [s], and what is said of them is their rate."""
    t = _times(loop, times)

    def told(x: float) -> float:
        return 1 / x if rate else x

    on, ends = "down" if rate else "up", sorted(told(float(x)) for x in values[[0, -1]])

    def holds(x: float) -> bool:
        return stable(make(x), t, horizon)

    with shown(progress, name) as tick:

        def seen(x: float) -> bool:
            tick(told(x))
            return holds(x)

        bracket = first_loss(seen, values, skip=values[0] > 0)
    if bracket.outcome is Outcome.NOWHERE:
        there = make(float(values[0]))
        said = (
            f"not stable from {ends[0]:g} to {ends[1]:g} {unit}; {_root(there, t, horizon)}"
            if values[0]
            else f"not stable as given; {_root(there, t, horizon)}"
        )
        return Limit(0.0, name, unit, bracket.outcome, said, there, there, bracket.evaluations)
    last = make(bracket.holds)
    notes: tuple[str, ...] = ()
    if bracket.before is not None:
        notes += (f"also not stable from {told(float(values[0])):.4g} {on} to {told(bracket.before):.4g} {unit}",)
    if Evidence(last.equations, t, horizon=horizon).stability.drifts.any():
        notes += ("the loop drifts: the limit is that of the roots that are not slow",)
    if bracket.outcome is Outcome.UNLIMITED:
        return Limit(np.inf, name, unit, bracket.outcome, f"stable {on} to {told(bracket.holds):g} {unit}", last, None, bracket.evaluations, notes)
    if bracket.before is not None:  # an island: what lies beyond it may be the larger part
        again = next((float(x) for x in values[values > bracket.lost] if holds(float(x))), None)
        notes += (f"stable again at {told(again):.4g} {unit}",) if again else ()
    beyond = make(bracket.lost)
    return Limit(bracket.holds, name, unit, bracket.outcome, f"beyond it {_root(beyond, t, horizon)}", last, beyond, bracket.evaluations, notes)


def _root(loop: ClosedLoop, t: Array, horizon: float) -> str:
    evidence = Evidence(loop.equations, t, horizon=horizon)
    if evidence.nothing_else:
        return "every root is slow"
    return evidence.unstable or str(evidence.rightmost)


def _times(loop: ClosedLoop, times: ArrayLike | None) -> Array:
    if times is not None:
        return checks.times(times)
    span = loop.ref.duration or loop.ref.period or 0.0
    return np.zeros(1) if loop.ref.is_hold or not span else np.linspace(0.0, float(span), MOVING_TIMES)
