"""Design searches for the limits of stiffness, dead time, sample rate, payload and bandwidth.

Without ``requirements`` a limit is the edge of stability: that of the roots that are not slow (over ``horizon``), with exact dead time and
sampling, at all ``times``, by a scan over the whole range and bisection. With ``requirements`` (their own ``horizon`` counts) it is the edge at
which they are just met, from the loop as given: see ``edges``. Each result is a float, to a relative 1e-5, with what binds, its time, joint and
pose, and the loop at the limit in ``.loop``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.sampled import sampled as sampled_system
from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.design.dead_time import stable_over_delay
from mfc_analysis.design.edges import Judge, requirement_limit
from mfc_analysis.design.searches import CLOSE, WIDEST, Limit, Outcome, first_loss, scan, shown
from mfc_analysis.design.windows import TRANSIT, Growth, critical_delays, folding_times, growths, lost_between
from mfc_analysis.design.worst_case import WorstCase, worst_case
from mfc_analysis.dynamics.environment import STIFFEST, stiffened, stiffest
from mfc_analysis.dynamics.hardware import LONGEST, MOST_SAMPLES, SHORTEST, Hardware
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.linearization.linearization import linearize
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.requirements.evidence import Evidence
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import Requirements, residual_lines

__all__ = ["Limit", "Outcome", "WorstCase", "max_bandwidth", "max_delay", "max_payload", "max_stiffness", "min_sample_rate", "worst_case"]

SOFTEST = 1e-6  #: softest wall searched with requirements, as a fraction of the one given
MOST_IN_TRANSIT = 16  #: samples of dead time of the fastest sampling searched with requirements
FIRST = 8  #: dead times with a root on the axis beside which a search looks
HEAVIEST = 1e9  #: [kg] largest payload searched for
USUAL_RATE = 1e5  #: [1/s] highest sample rate searched at first
MOVING_TIMES = 21  #: times checked along a moving reference
WITHIN = 1 - 1e-12  #: of the most samples of dead time: below them by more than rounding
FEW_TIMES = 4  #: up to which dead times are judged together: a count of more points takes no less time for each


def max_stiffness(
    loop: ClosedLoop, upper: float = 1e6, *, requirements: Requirements | None = None, at: str | None = None, times: ArrayLike | None = None,
    horizon: float = HORIZON, progress: bool = False, n_jobs: int | None = None,
) -> Limit:  # fmt: skip
    """Largest environment stiffness [N/m] (rotations alone: [Nm/rad]) with which the loop is stable; inf if stable up to ``upper``.

    The search varies every environment with a preload (all of them where none has one): it scales the stiffness so that the largest
    translational entry has the value, and keeps the damping. The force at the reference does not change: the preload compensates
    penetration times the change of stiffness. The scan starts at 1e-8 ``upper`` and ends at the first loss; 0 if stable nowhere. A
    note says so where the loop is not stable on softer walls either, and from where on it is stable again. Where it is passive at the tool
    (``Linearization.passivity``) no stiffness is too large: none is searched, and a note says so.

    Other arguments as ``max_delay``. Raises BadArgument: a loop without an environment, ``upper`` not a positive number up to 1e15.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=0.0, high=STIFFEST, strict=True)
    t, judge = _asked(loop, times, requirements, at)
    stiffer, given = with_stiffness(loop, float(t[0]))
    if judge is None:
        name, unit, values = "largest stable stiffness", "N/m", scan(1e-8 * upper, upper)
        if linearize(stiffer(0.0).equations, t, horizon=horizon).passivity().passive.all():
            binds, why = f"stable up to {upper:g} {unit}", "passive at the tool without this stiffness, the force kept: stable however stiff it is"
            return Limit(np.inf, name, unit, Outcome.UNLIMITED, binds, stiffer(upper), None, 1, (why,))
        return _limit(stiffer, values, t, horizon, name, unit, progress, n_jobs)
    if not 0 < given <= upper:
        raise BadArgument("upper", upper, f"at least the stiffness of the loop, {given:g} N/m, which must be positive")
    return requirement_limit(stiffer, "stiffness", given, judge, lower=SOFTEST * given, upper=upper, progress=progress, n_jobs=n_jobs)


def with_stiffness(loop: ClosedLoop, time: float = 0.0) -> tuple[Callable[[float], ClosedLoop], float]:
    """The loop as a function of the stiffness [N/m] that ``max_stiffness`` varies, with the same force at ``time`` [s]; and its stiffness.

    Raises BadArgument for a loop without an environment.
    """
    surfaces = loop.equations.surfaces
    if not surfaces:
        raise BadArgument("loop", str(loop), "a loop with an environment: ClosedLoop(..., environment=mfc.Environment(...))")
    pressed = [s.f0.any() for s in surfaces]
    varied = pressed if any(pressed) else [True] * len(surfaces)
    X = loop.robot.pose(loop.nominal([time]).q[0])

    def stiffer(k: float) -> ClosedLoop:
        return replace(loop, environment=[stiffened(s, k, X) if vary else s for s, vary in zip(surfaces, varied, strict=True)])

    return stiffer, max(stiffest(s) for s, vary in zip(surfaces, varied, strict=True) if vary)


def max_delay(
    loop: ClosedLoop, upper: float = 10.0, *, requirements: Requirements | None = None, at: str | None = None, times: ArrayLike | None = None,
    horizon: float = HORIZON, progress: bool = False, n_jobs: int | None = None,
) -> Limit:  # fmt: skip
    """Largest dead time [s] of the actuators (``Hardware.delay``, in place of the given one) with which the loop is stable.

    inf if stable up to ``upper`` [s], 1e-9 to 1e9; 0 if it is not stable without dead time. The search of a sampled loop ends at 2000 samples;
    ``binds`` says where it ended. The scan looks on both sides of the first dead times that put a root on the axis (``windows.critical_delays``);
    of a sampled loop, of the smallest delay margins without dead time.

    Args:
        loop: as given. upper: [s] end of the search.
        requirements: the limit is where these are just met; None: the edge of stability. at: their analysis point; None: the plant input.
        times: (m,) [s] at which the loop is judged; None: 0 of a Hold, else 21 over the reference. horizon: [s] of the stability verdict.
        progress: a bar on the terminal. n_jobs: processes that judge the values ahead, as in ``sweep``; -1: one on each core. The result is the same.

    Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=SHORTEST, high=LONGEST)
    hardware = loop.hardware or Hardware()
    if hardware.sample_time:
        upper = min(upper, WITHIN * MOST_SAMPLES * hardware.sample_time - replace(hardware, delay=None).command_delay)

    def later(delay: float) -> ClosedLoop:
        return replace(loop, hardware=replace(hardware, delay=delay if delay >= SHORTEST else None))

    t, judge = _asked(loop, times, requirements, at)
    if judge is not None:
        return requirement_limit(later, "delay", hardware.delay or 0.0, judge, upper=upper, progress=progress, n_jobs=n_jobs)
    prompt = linearize(later(0.0).equations, t, horizon=horizon)
    first = prompt.margins().delay.ravel() if hardware.sample_time else critical_delays(prompt.opened, loop.default_at)
    first = np.sort(first[(first > 0) & (first < upper)])[:FIRST]
    values = np.union1d(scan(1e-6 * upper, upper), np.outer(first, 1 + 0.4 * CLOSE * np.array([-1, 1])))
    every = None if hardware.sample_time or t.size > FEW_TIMES else stable_over_delay(loop, t, horizon)

    def together(delays: Sequence[float]) -> list[bool] | None:
        return None if every is None or min(delays) < SHORTEST else every(delays)

    return _limit(later, np.concatenate([[0.0], values]), t, horizon, "largest stable dead time", "s", progress, n_jobs, together=together)


def max_payload(
    loop: ClosedLoop,
    upper: float = 1e3,
    *,
    com: ArrayLike = (0.0, 0.0, 0.0),
    requirements: Requirements | None = None,
    at: str | None = None,
    times: ArrayLike | None = None,
    horizon: float = HORIZON,
    progress: bool = False,
    n_jobs: int | None = None,
) -> Limit:
    """Largest payload [kg] at the tool, unknown to the controller, with which the loop is stable about its reference.

    The payload is a point mass at ``com`` (3,) [m] in tool axes, added to the payload of the plant; the controller's model does not
    change. inf if stable up to ``upper`` [kg], at most 1e9; 0 if it is not stable without. Where requirements are missed as given, the
    payload of the plant is reduced, and the limit is negative.

    Other arguments as ``max_delay``. Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    upper = checks.number("upper", upper, low=0.0, high=HEAVIEST, strict=True)
    com = checks.array("com", com, (3,))
    model = loop.equations.model

    held = sum(p.mass for p in loop.robot.payloads)

    def heavier(mass: float) -> ClosedLoop:
        plant = loop.robot
        robot = plant.with_payload(mass, com) if mass > 0 else plant.with_payloads_scaled(1 + mass / held) if mass else plant
        return replace(loop, robot=robot, controller_model=model)

    t, judge = _asked(loop, times, requirements, at)
    if judge is not None:
        return requirement_limit(heavier, "payload", 0.0, judge, lower=-held, upper=upper, progress=progress, n_jobs=n_jobs)
    return _limit(heavier, np.concatenate([[0.0], scan(1e-6 * upper, upper)]), t, horizon, "largest stable payload", "kg", progress, n_jobs)


def min_sample_rate(
    loop: ClosedLoop, lower: float = 0.1, upper: float | None = None, *,
    requirements: Requirements | None = None, at: str | None = None, times: ArrayLike | None = None,
    horizon: float = HORIZON, progress: bool = False, n_jobs: int | None = None,
) -> Limit:  # fmt: skip
    """Smallest rate [1/s] of a sampled controller (``Hardware.sample_time``, zero-order hold) with which the loop is stable.

    The search goes down from ``upper`` to the first loss; 0 if stable down to ``lower``, inf if not stable at any rate of the search, whose
    ends ``binds`` gives. Between the rates of the scan it looks where a resonance of the plant folds (``windows``). Rates are 1e-9 to 1e9 1/s.
    ``upper`` None: 1e5 1/s, and 1e9 1/s where no rate up to there is stable; with dead time at most the rate at which it takes 2000 samples.

    Other arguments as ``max_delay``. Raises BadArgument.
    """
    checks.instance("loop", loop, ClosedLoop, "a ClosedLoop")
    hardware = loop.hardware or Hardware()
    late = max(hardware.command_delay, hardware.force_delay or 0.0)
    most = min(1 / SHORTEST, WITHIN * MOST_SAMPLES / late) if late else 1 / SHORTEST
    ends = ("lower", lower), ("upper", min(USUAL_RATE, most) if upper is None else upper)
    low, high = (checks.number(name, rate, low=1 / LONGEST, high=1 / SHORTEST) for name, rate in ends)

    def sampled(period: float) -> ClosedLoop:
        return replace(loop, hardware=hardware.every(period))

    t, judge = _asked(loop, times, requirements, at)
    if judge is not None:
        fastest = max(1 / high, late / MOST_IN_TRANSIT)
        return requirement_limit(
            sampled, "sample_time", hardware.sample_time or 0.0, judge, lower=fastest, upper=1 / low, progress=progress, n_jobs=n_jobs
        )

    def search(low: float, high: float, extra: Array) -> Limit:
        values = np.union1d(scan(1 / high, 1 / low), extra)
        return _limit(sampled, values, t, horizon, "smallest stable sample rate", "1/s", progress, n_jobs, rate=True)

    found = search(low, high, np.zeros(0))
    if found.outcome is Outcome.NOWHERE and upper is None and high < most:
        high = most
        found = search(low, high, np.zeros(0))
    if found.outcome is not Outcome.NOWHERE:
        last = float(found) if found.outcome is Outcome.FOUND else 1 / low
        coded = hardware.integral_rule != "forward" or hardware.derivative_rule is not None
        prompt = linearize(sampled(last).equations if coded else replace(loop, hardware=hardware.every(None)).equations, t, horizon=horizon).opened

        def grown(h: float) -> Growth:
            return growths(linearize(sampled(h).equations, t, horizon=horizon).opened if coded else sampled_system(prompt, h))

        lost = lost_between(grown, folding_times(prompt.held or prompt, max(1 / high, late / TRANSIT), last))
        if lost.size:
            found = search(low, high, lost)
    value = {Outcome.FOUND: 1 / found if found else np.inf, Outcome.UNLIMITED: 0.0, Outcome.NOWHERE: np.inf}[found.outcome]
    above = f"above the upper end of the search, {high:g} 1/s: " if found.outcome is Outcome.NOWHERE and upper is not None else ""
    note = (f"sample time {float(found):.6g} s",) if found.outcome is Outcome.FOUND else ()
    binds, notes = above + found.binds, note + found.notes
    return Limit(value, found.name, found.unit, found.outcome, binds, found.loop, found.beyond, found.evaluations, notes, found.binding)


def max_bandwidth(
    make_loop: Callable[[float], ClosedLoop | Sequence[ClosedLoop]],
    requirements: Requirements,
    times: ArrayLike,
    *,
    nominal: float | None = None,
    at: str | None = None,
    lower: float = 0.1,
    upper: float = 1e4,
    progress: bool = False,
    n_jobs: int | None = None,
) -> Limit:
    """Largest bandwidth [rad/s] whose loop meets the requirements. ``.binding`` is the requirement missed just above it.

    Args:
        make_loop: bandwidth [rad/s] -> the loop, or several (payloads, surfaces) that must all meet the requirements.
        requirements: to be met. times, at: as for ``Requirements.check``. lower: [rad/s] start of the search. upper: [rad/s] its end.
        nominal: [rad/s] where the search starts, upwards if the requirements are met there; None: ``lower``.

    Other arguments as ``max_delay``. WATCH counts as met. Bandwidths from the start on that miss the requirements, because they are too slow for
    example, are skipped, and a note says so. 0 if met nowhere, inf if met up to ``upper``. Raises BadArgument, and any error of ``make_loop``.
    """
    if not callable(make_loop):
        raise BadArgument("make_loop", make_loop, "a function of the bandwidth [rad/s] that returns a ClosedLoop or several")
    lower, upper = checks.number("lower", lower, low=0.0, strict=True), checks.number("upper", upper, low=0.0, strict=True)
    start = lower if nominal is None else checks.number("nominal", nominal, low=lower, high=upper)
    if not lower < upper <= WIDEST * lower:
        raise BadArgument("upper", upper, f"a number above lower, {lower:g}, and at most {WIDEST:g} times as large")
    return requirement_limit(
        make_loop, "bandwidth", start, Judge(requirements, checks.times(times), at), lower=lower, upper=upper, progress=progress, n_jobs=n_jobs
    )


# --- the search on stability -----------------------------------------------------------------------------------------


def stable(loop: ClosedLoop, times: ArrayLike, horizon: float = HORIZON) -> bool:
    """True if all roots that are not slow are stable at all times (m,) [s], with exact dead time and sampling."""
    return bool(Evidence(loop.equations, checks.times(times), horizon=horizon).judged.all())


def _limit(
    make: Callable[[float], ClosedLoop], values: Array, t: Array, horizon: float, name: str, unit: str, progress: bool, n_jobs: int | None,
    rate: bool = False, together: Callable[[Sequence[float]], list[bool] | None] | None = None,
) -> Limit:  # fmt: skip
    """``together`` as in ``Ahead``. ``rate``: the values are times [s], and what is said of them is their rate."""

    def told(x: float) -> float:
        return 1 / x if rate else x

    on, ends = "down" if rate else "up", sorted(told(float(x)) for x in values[[0, -1]])

    def holds(x: float) -> bool:
        return stable(make(x), t, horizon)

    with shown(progress, name) as tick:
        bracket = first_loss(holds, values, skip=values[0] > 0, tick=lambda x: tick(told(x)), n_jobs=n_jobs, together=together)
    if bracket.outcome is Outcome.NOWHERE:
        there = make(float(values[0]))
        root, binding = _lost(there, t, horizon)
        said = f"not stable from {ends[0]:g} to {ends[1]:g} {unit}; {root}" if values[0] else f"not stable as given; {root}"
        return Limit(0.0, name, unit, bracket.outcome, said, there, there, bracket.evaluations, (), binding)
    last = make(bracket.holds)
    notes: tuple[str, ...] = ()
    if bracket.before is not None:
        notes += (f"also not stable from {told(float(values[0])):.4g} {on} to {told(bracket.before):.4g} {unit}",)
    evidence = Evidence(last.equations, t, horizon=horizon)
    if evidence.stability.drifts.any():
        notes += ("the loop drifts: the limit is that of the roots that are not slow",)
    for line in residual_lines(evidence, None):
        where = f" ({line.where})" if line.where else ""
        notes += (f"WATCH at the limit: {line.label} {line.found:.3g} {line.unit}{where}, {line.note}",)
    if bracket.outcome is Outcome.UNLIMITED:
        return Limit(np.inf, name, unit, bracket.outcome, f"stable {on} to {told(bracket.holds):g} {unit}", last, None, bracket.evaluations, notes)
    if bracket.before is not None:  # an island: what lies beyond it may be the larger part
        again = next((float(x) for x in values[values > bracket.lost] if holds(float(x))), None)
        notes += (f"stable again at {told(again):.4g} {unit}",) if again else ()
    beyond = make(bracket.lost)
    root, binding = _lost(beyond, t, horizon)
    return Limit(bracket.holds, name, unit, bracket.outcome, f"beyond it {root}", last, beyond, bracket.evaluations, notes, binding)


def _lost(loop: ClosedLoop, t: Array, horizon: float) -> tuple[str, Line]:
    """The root of a loop that is not stable, in words, and the line "stable" of its verdict."""
    try:
        verdict = Requirements(horizon=horizon).check(loop, t)
    except Unsupported:  # many samples in transit: the verdict counts the unstable roots, and does not need them
        said = "a root in the right half plane, not located: too many samples are in transit"
        when = float(t[np.argmin(Evidence(loop.equations, t, horizon=horizon).judged)])
        return said, Line("stable", 0.0, np.nan, "1/s", np.nan, Status.FAIL, "", when, "<", note=f"unstable: {said}")
    evidence = verdict.evidence
    return "every root is slow" if evidence.nothing_else else evidence.unstable or str(evidence.rightmost), verdict.line("stable")


def _asked(loop: ClosedLoop, times: ArrayLike | None, requirements: Requirements | None, at: str | None) -> tuple[Array, Judge | None]:
    """The times of a search, and the judge of its requirements, None without them."""
    t = _times(loop, times)
    if requirements is None and at is not None:
        raise BadArgument("at", at, "requirements= with it: stability has no analysis point")
    return t, None if requirements is None else Judge(requirements, t, at)


def _times(loop: ClosedLoop, times: ArrayLike | None) -> Array:
    if times is not None:
        return checks.times(times)
    span = loop.ref.duration or loop.ref.period or 0.0
    return np.zeros(1) if loop.ref.is_hold or not span else np.linspace(0.0, float(span), MOVING_TIMES)
