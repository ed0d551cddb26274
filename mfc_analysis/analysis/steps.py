"""Step responses of the closed loop, with their metrics.

Samples come from one matrix exponential by doubling (x[k + 2^p] from x[k] in one product). Metrics come from the exact response
between the samples: rise, settling and peak do not depend on the grid. For dead time see ``delay.steps``.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.delay.steps import delayed_runner
from mfc_analysis.analysis.slow import KEEPS_MOVING, MOVES
from mfc_analysis.analysis.spectrum import Spectrum, rates, spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_run import Run
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.checks import number
from mfc_analysis.maths.roots import root_between
from mfc_analysis.maths.zero_order_hold import zero_order_hold

BAND = 0.02  #: settling band
SAMPLES = 1000  #: fewest samples of a response
MOST_SAMPLES = 60_000_000  #: of a sampled loop
BLOCK = 4096  #: samples computed at once


class Outcome(enum.Enum):
    """Long-term behaviour of the response."""

    SETTLES = "the response settles"
    RAMPS = "the response does not settle within the horizon: a slow root integrates the input"
    GROWS = "the response grows: the closed loop is unstable"


@dataclass(frozen=True, eq=False)
class Step:
    """Response of one output to a unit step of one input. NaN: not defined (it does not settle, or it settles at zero)."""

    t: Array  #: (k,) [s]
    y: Array  #: (k,) output per unit of the input
    input: str
    output: str
    time: float  #: [s] of the operating point
    outcome: Outcome
    steady_state: float  #: final value; inf with its sign where it ramps, NaN where it grows
    rise: float  #: [s] from the first 10 % to the first 90 % of the final value; NaN if that is zero
    settling: float  #: [s] last time outside ``settling_band``; inf where it ramps, NaN where it grows
    settling_band: float  #: 0.02: of the final value, or of the peak where that is zero
    overshoot: float  #: fraction of the final value by which the peak exceeds it; NaN if that is zero
    undershoot: float  #: fraction of the final value by which the response first moves in the wrong direction
    peak: float  #: largest |y|; NaN where it does not settle
    peak_time: float  #: [s]

    def __str__(self) -> str:
        if self.outcome is not Outcome.SETTLES:
            return f"step {self.input} -> {self.output} at t = {self.time:.4g} s: {self.outcome.value}"
        return (
            f"step {self.input} -> {self.output} at t = {self.time:.4g} s: final value {self.steady_state:.4g}, rise {self.rise:.4g} s (10-90 %), "
            f"settling {self.settling:.4g} s ({100 * self.settling_band:g} %), overshoot {100 * self.overshoot:.3g} %"
        )

    __repr__ = __str__


def step(system: OpenSystem, index: int, input: str | int, output: str | int, duration: float | None = None) -> Step:
    """Unit step response from ``input`` to ``output`` of the closed loop at point ``index``, dead time included.

    ``input``, ``output``: names or numbers; ``duration`` [s] of the samples returned; omitted: about twice the settling time.
    The metrics do not depend on it. Raises ``UnknownName`` and ``BadArgument``.
    """
    if not -len(system.A) <= index < len(system.A):
        raise BadArgument("index", index, f"a point from 0 to {len(system.A) - 1}")
    into, out = _number("input", input, system.input_names), _number("output", output, system.output_names)
    if duration is not None:
        duration = number("duration", duration, low=0.0, strict=True)
    one = system.at(np.array([index % len(system.A)]))
    known, run_for = spectrum(one), _runner(one, into, out)
    outcome, steady = _end(one, into, out, known)
    first = None
    if one.delayed:
        first = first_duration(one, into, out)
    run = _settled_run(run_for, known, steady if outcome is Outcome.SETTLES else None, one.dt, first)
    metrics = _metrics(run, steady, one.dt) if outcome is Outcome.SETTLES else dict.fromkeys(METRICS, np.nan)
    if outcome is Outcome.RAMPS:
        metrics["settling"] = np.inf
    shown = run if duration is None else run_for(duration, _samples(duration, known, one.dt))
    return Step(
        shown.t, shown.y, system.input_names[into], system.output_names[out], float(one.times[0]), outcome, steady, settling_band=BAND, **metrics
    )


METRICS = ("rise", "settling", "overshoot", "undershoot", "peak", "peak_time")


def _number(argument: str, name: str | int, known: tuple[str, ...]) -> int:
    if isinstance(name, (int, np.integer)) and not isinstance(name, (bool, np.timedelta64)):
        if not 0 <= name < len(known):
            raise UnknownName(argument, name, [*known, *map(str, range(len(known)))])
        return int(name)
    if not isinstance(name, str) or name not in known:
        raise UnknownName(argument, name, known)
    return known.index(name)


def _end(system: OpenSystem, into: int, out: int, known: Spectrum) -> tuple[Outcome, float]:
    """Behaviour of the response within the horizon and its final value, on which dead time has no effect."""
    if not _others_decay(system):
        return Outcome.GROWS, np.nan
    A, B, C, D = (x[0] for x in close_wires(system))
    step, split = system.dt or 1.0, known.parts[0]
    a, b, c = (A - np.eye(system.nx)) / step if system.dt else A, B[:, into] / step, C[out]
    moved = 0.0
    if split is not None and split.slow.block.size:
        slow, push, seen = split.slow, split.slow.left @ b, c @ split.slow.right
        moved, half = (float(seen @ slow.integral(t) @ push) for t in (system.horizon, system.horizon / 2))
        scale = float(np.abs(c) @ np.abs(split.fast_right) @ np.abs(np.linalg.solve(split.fast, split.fast_left @ b))) + abs(float(D[out, into]))
        if abs(moved) > MOVES * scale + 1e-300 and abs(moved) > KEEPS_MOVING * abs(half):
            return Outcome.RAMPS, float(np.copysign(np.inf, moved))
        a, b, c = split.fast, split.fast_left @ b, c @ split.fast_right
    terms = c * np.linalg.solve(a, b) if len(a) else np.zeros(1)
    steady = float(D[out, into] - terms.sum()) + moved
    return Outcome.SETTLES, 0.0 if abs(steady) < 1e-13 * np.abs(terms).sum() else steady


def _others_decay(system: OpenSystem) -> bool:
    """Whether no root grows that is not slow: also where every root is slow."""
    verdict = stability(system)
    return bool(verdict.nonzero_stable[0] or not verdict.held[0])


def _runner(system: OpenSystem, into: int, out: int) -> Callable[[float, int], Run]:
    if system.delayed:
        return delayed_runner(system, into, out)
    A, B, C, D = (x[0] for x in close_wires(system))
    b, c, d = B[:, [into]], C[out], float(D[out, into])
    if system.dt:
        return lambda duration, samples: _sampled(A, b, c, d, system.dt, max(2, int(np.ceil(duration / system.dt * (1 - 1e-12)))))

    def run(duration: float, samples: int) -> Run:
        h = duration / samples
        move, push = zero_order_hold(A, b, h)
        x = _doubled(move, push[:, 0], samples)

        def between(k: int, ahead: float) -> tuple[float, float]:
            part, more = zero_order_hold(A, b, ahead)
            here = part @ x[:, k] + more[:, 0]
            return float(c @ here + d), float(c @ (A @ here + b[:, 0]))

        with np.errstate(over="ignore", invalid="ignore"):
            return Run(np.asarray(h * np.arange(samples + 1), float), c @ x + d, c @ (A @ x + b), between)

    return run


def _sampled(A: Array, b: Array, c: Array, d: float, dt: float, samples: int) -> Run:
    """The samples in blocks: within one, y[k] = c A^k x of the state x at its start, so that only the outputs are kept."""
    if samples > MOST_SAMPLES:
        raise BadArgument("duration", samples * dt, f"at most {MOST_SAMPLES * dt:.4g} s, {MOST_SAMPLES} samples of {dt:.3g} s")
    n = len(A)
    whole = np.block([[A, b], [np.zeros((1, n)), np.ones((1, 1))]])  # the input is a state that stays
    rows = np.append(c, d)[None, :]
    block = whole
    while len(rows) < min(BLOCK, samples + 1):
        rows, block = np.concatenate([rows, rows @ block]), block @ block
    x, y = np.append(np.zeros(n), 1.0), np.empty(samples + 1)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(0, samples + 1, len(rows)):
            y[k : k + len(rows)] = (rows @ x)[: samples + 1 - k]
            x = block @ x
    return Run(np.linspace(0.0, dt * samples, samples + 1), y, np.broadcast_to(0.0, samples + 1), lambda k, ahead: (float(y[k]), 0.0))


def _doubled(move: Array, push: Array, samples: int) -> Array:
    """x[k + 1] = move x[k] + push from x[0] = 0: (nx, samples + 1), by doubling."""
    x = np.zeros((len(push), 1))
    with np.errstate(over="ignore", invalid="ignore"):
        while x.shape[1] <= samples:
            x = np.hstack([x, move @ x + push[:, None]])
            push = move @ push + push
            move = move @ move
    return x[:, : samples + 1]


def _samples(duration: float, known: Spectrum, dt: float) -> int:
    if dt:
        return max(1, round(duration / dt))
    turns = duration * np.abs(known.poles.imag).max(initial=0.0) / (2 * np.pi)
    return int(np.clip(16 * turns, SAMPLES, 20 * SAMPLES))


def first_duration(system: OpenSystem, into: int, out: int) -> float:
    """First duration [s]: that of the loop without dead time, at least a few dead times, and long enough to show growth."""
    free = delay_free_duration(replace(system, wire_delay=np.zeros_like(system.wire_delay)), into, out)
    enough = max(free, 10 * float(system.wire_delay.max()))
    growth = float(delay_roots(system, 1)[0, 0].real) if not _others_decay(system) else 0.0
    return max(enough, min(3 / growth, 20 * enough)) if growth > 0 else enough


def delay_free_duration(system: OpenSystem, into: int, out: int) -> float:
    """[s] about twice the settling time of a system with one point, without dead time; eight slowest time constants if it does not settle."""
    known = spectrum(system)
    outcome, steady = _end(system, into, out, known)
    run = _settled_run(_runner(system, into, out), known, steady if outcome is Outcome.SETTLES else None, system.dt)
    return float(run.t[-1])


def _settled_run(run_for: Callable[[float, int], Run], known: Spectrum, steady: float | None, dt: float, first: float | None = None) -> Run:
    """A run of about twice the settling time; eight slowest time constants if it does not settle. ``first``: [s] first duration."""
    s = rates(known.poles, dt)[~known.slow]
    rate = np.abs(s.real[np.isfinite(s.real) & (np.abs(s.real) > 1e-12 * np.abs(s))])
    if steady is None:
        grows = s.real[s.real > 1e-12 * np.abs(s)]
        slowest = grows.max() if grows.size else rate.min() if rate.size else 1.0
        duration = first or 8 / slowest
        return run_for(duration, _samples(duration, known, dt))
    duration = first or (10 / rate.min() if rate.size else max(1.0, 10 * dt))
    run = run_for(duration, _samples(duration, known, dt))
    for _ in range(40):
        left = _last_outside(run, steady)
        if left >= 0.9 * duration:
            duration *= 2
        elif 0 < left < duration / 4:
            duration = 2 * left
        elif left == 0 and (run.y[1:] == run.y[1]).all():
            break
        elif left == 0:
            duration /= SAMPLES / 2
        else:
            break
        if dt and duration < 2 * dt:
            break
        run = run_for(duration, _samples(duration, known, dt))
    return run


def _band(run: Run, steady: float) -> float:
    """Half width of the settling band: of the final value, or of the peak where that is zero."""
    peak = float(np.abs(run.y).max())
    return BAND * (abs(steady) if abs(steady) > 1e-9 * peak else peak)


def _last_outside(run: Run, steady: float) -> float:
    outside = np.flatnonzero(np.abs(run.y - steady) > _band(run, steady))
    return float(run.t[outside[-1]]) if outside.size else 0.0


def _metrics(run: Run, steady: float, dt: float) -> dict[str, float]:
    exact = not dt
    peak, peak_time = _extreme(run, 1.0 if abs(run.y.max()) >= abs(run.y.min()) else -1.0, exact)
    band = _band(run, steady)
    outside = np.flatnonzero(np.abs(run.y - steady) > band)
    settling = 0.0
    if outside.size and outside[-1] + 1 < run.t.size:
        k = int(outside[-1])
        level = steady + np.copysign(band, run.y[k] - steady)
        settling = _crossing(run, k, level) if exact else float(run.t[k + 1])
    none = band == 0 or abs(steady) <= 1e-9 * abs(peak)
    if none:
        return dict(zip(METRICS, (np.nan, settling, np.nan, np.nan, abs(peak), peak_time), strict=True))
    sign = np.copysign(1.0, steady)
    top, low = sign * _extreme(run, sign, exact)[0], sign * _extreme(run, -sign, exact)[0]
    rise = _first(run, 0.9 * steady, exact) - _first(run, 0.1 * steady, exact)
    over, under = max(0.0, top / abs(steady) - 1), max(0.0, -low / abs(steady))
    over = over if over > 1e-9 else 0.0
    return dict(zip(METRICS, (rise, settling, over, under, abs(peak), peak_time), strict=True))


def _first(run: Run, level: float, exact: bool) -> float:
    """[s] the first time at which y reaches the level; zero if it starts above it."""
    beyond = run.y >= level if level > 0 else run.y <= level
    k = int(np.argmax(beyond))
    if not beyond[k]:
        return float("nan")
    return float(run.t[k]) if k == 0 or not exact else _crossing(run, k - 1, level)


def _crossing(run: Run, k: int, level: float) -> float:
    """[s] time at which y crosses the level between samples k and k + 1."""
    h = float(run.t[k + 1] - run.t[k])
    if (run.y[k] - level) * (run.y[k + 1] - level) > 0:
        return float(run.t[k + 1])

    def gap(ahead: float) -> float:
        return float(run.y[k]) - level if ahead == 0 else float(run.y[k + 1]) - level if ahead == h else run.between(k, ahead)[0] - level

    return float(run.t[k] + root_between(gap, 0.0, h, xtol=1e-13 * max(h, float(run.t[k])), rtol=1e-14))


def _slope(run: Run, k: int, ahead: float) -> float:
    return run.between(k, ahead)[1]


def _extreme(run: Run, sign: float, exact: bool) -> tuple[float, float]:
    """The largest sign * y and its time [s], from the zero of the slope between the samples."""
    best = int(np.argmax(sign * run.y))
    for k in (best - 1, best):
        if exact and 0 <= k < run.t.size - 1 and run.slope[k] * sign > 0 > run.slope[k + 1] * sign:
            h = float(run.t[k + 1] - run.t[k])
            ahead = root_between(partial(_slope, run, k), 0.0, h, xtol=1e-13 * h, rtol=8.881784197001252e-16)
            value = run.between(k, ahead)[0]
            if sign * value >= sign * run.y[best]:
                return value, float(run.t[k] + ahead)
    return float(run.y[best]), float(run.t[best])
