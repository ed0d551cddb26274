"""Step responses of the closed loop, with their metrics.

Samples come from one matrix exponential by doubling (x[k + 2^p] from x[k] in one product). The metrics are those of the sum of the modes, to
where the last has died away: they depend on no grid and no duration. For dead time see ``delay.steps``.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.delay.steps import delayed_runner, longest_step
from mfc_analysis.analysis.modal_response import ModalPieces, Term, term
from mfc_analysis.analysis.modes import Mode, modes
from mfc_analysis.analysis.slow import MOVES
from mfc_analysis.analysis.spectrum import Spectrum, rates, spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.step_run import BAND, METRICS, Piece, metrics
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.checks import number
from mfc_analysis.maths.zero_order_hold import zero_order_hold

SAMPLES = 1000  #: fewest samples of a response
MOST_SAMPLES = 60_000_000  #: of a sampled loop
BLOCK = 4096  #: samples computed at once
DIED = 14.0  #: time constants of the slowest characteristic root in a run with dead time,
ROOTS = 8  #: of those that are looked at
AFFORDED = 50_000  #: steps of such a run, unless it takes more to settle


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
    peak: float  #: largest |y|, the final value where that is never exceeded; NaN where it does not settle
    peak_time: float  #: [s]; inf where the response comes nearest to its peak at the end

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
    The metrics do not depend on it: they are those of the sum of all modes, or, with dead time, of a run to where the slowest root has
    died away. Raises ``UnknownName`` and ``BadArgument``.
    """
    if not -len(system.A) <= index < len(system.A):
        raise BadArgument("index", index, f"a point from 0 to {len(system.A) - 1}")
    into, out = _number("input", input, system.input_names), _number("output", output, system.output_names)
    if duration is not None:
        duration = number("duration", duration, low=0.0, strict=True)
    return point_of(system, index).step(into, out, duration)


def _number(argument: str, name: str | int, known: tuple[str, ...]) -> int:
    if isinstance(name, (int, np.integer)) and not isinstance(name, (bool, np.timedelta64)):
        if not 0 <= name < len(known):
            raise UnknownName(argument, name, [*known, *map(str, range(len(known)))])
        return int(name)
    if not isinstance(name, str) or name not in known:
        raise UnknownName(argument, name, known)
    return known.index(name)


@dataclass(frozen=True, eq=False)
class _End:
    """Behaviour of a response within the horizon."""

    outcome: Outcome
    steady: float = np.nan
    terms: tuple[Term, ...] = ()  #: what dies away, without dead time
    slow: bool = False  #: some of that is slow


def point_of(system: OpenSystem, index: int) -> Point:
    """The loop at one of its points, of which several responses are asked."""
    return Point(system.at(np.array([index % len(system.A)])))


@dataclass(frozen=True, eq=False)
class Point:
    """A loop at one point, and what all its responses share."""

    system: OpenSystem

    @cached_property
    def closed(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of the closed loop, without dead time."""
        A, B, C, D = (x[0] for x in close_wires(self.system))
        return A, B, C, D

    @cached_property
    def modes(self) -> list[Mode]:
        """Of the rates: of A, or (A - I) / dt."""
        A, dt = self.closed[0], self.system.dt
        return modes((A - np.eye(len(A))) / dt if dt else A, self.system.radius)

    @cached_property
    def known(self) -> Spectrum:
        """Poles without dead time."""
        return spectrum(self.system)

    @cached_property
    def others_decay(self) -> bool:
        """Whether no root grows that is not slow: also where every root is slow."""
        verdict = stability(self.system)
        return bool(verdict.nonzero_stable[0] or not verdict.held[0])

    def step(self, into: int, out: int, duration: float | None = None) -> Step:
        """The response of output number ``out`` to input number ``into``."""
        system, end = self.system, self._end(into, out)
        outcome, steady, found = end.outcome, end.steady, dict.fromkeys(METRICS, np.nan)
        run = delayed_runner(system, into, out) if system.delayed else None
        longest = 0.0
        if outcome is Outcome.SETTLES:
            found, longest = self._delayed_metrics(run, steady) if run else self._metrics(end)
            if found["settling"] > system.horizon and end.slow:
                outcome, steady = Outcome.RAMPS, float(np.copysign(np.inf, steady))
                found = dict.fromkeys(METRICS, np.nan)
        if outcome is Outcome.RAMPS:
            found["settling"] = np.inf
        if duration is None:
            turned = found["peak_time"] if found["overshoot"] > 0 else 0.0
            duration = max(2 * found["settling"], 1.2 * turned) or longest if outcome is Outcome.SETTLES else self._unsettled()
        samples = self._samples(duration)
        t, y = run(duration, samples).samples if run else self._run(into, out, duration, samples)
        return Step(t, y, system.input_names[into], system.output_names[out], float(system.times[0]), outcome, steady, settling_band=BAND, **found)

    def _end(self, into: int, out: int) -> _End:
        """The final value, on which dead time has no effect. A slow mode that is not sure to decay leaves no trace, or ramps."""
        if not self.others_decay:
            return _End(Outcome.GROWS)
        system, dt = self.system, self.system.dt
        _, B, C, D = self.closed
        b, c, d = B[:, into] / (dt or 1.0), C[out], float(D[out, into])
        slow = [bool((np.abs(mode.rates) < system.radius).all()) for mode in self.modes]
        loose = [mode for mode, creeps in zip(self.modes, slow, strict=True) if creeps and not mode.decays(dt)]
        terms = tuple(term(mode, b, c, dt) for mode in self.modes if mode not in loose)
        settled = np.array([float((one.g @ one.v).real) for one in terms])
        steady = d - settled.sum()
        horizon = system.horizon if np.isfinite(system.horizon) else 1.0
        moved = [sum(float((c @ m.right @ m.integral(t, dt) @ m.left @ b).real) for m in loose) for t in (horizon, horizon / 2)]
        scale = sum(one.size for one in terms) + abs(d)
        if max(map(abs, moved)) > MOVES * scale + 1e-300:
            return _End(Outcome.RAMPS, float(np.copysign(np.inf, moved[0])))
        if abs(steady) < 1e-13 * (np.abs(settled).sum() + abs(d)):
            steady = 0.0
        return _End(Outcome.SETTLES, float(steady), terms, sum(slow) > len(loose))

    def _metrics(self, end: _End) -> tuple[dict[str, float], float]:
        """The metrics, and a time [s] at which everything has died away."""
        dt = self.system.dt
        pieces = ModalPieces(end.terms, end.steady, dt)
        if not len(pieces):
            return metrics([Piece(np.array([0.0, dt or 1.0]), np.array([[end.steady]]))], end.steady), 10 * dt or 1.0
        return metrics(pieces, end.steady, pieces.reach), pieces.end

    def _delayed_metrics(self, run: Callable[[float, int], Piece], steady: float) -> tuple[dict[str, float], float]:
        """The same with dead time, from a run to where the slowest characteristic root has died away, or as far as ``AFFORDED`` steps go."""
        system = self.system
        roots = delay_roots(system, ROOTS)[0]
        decay = -roots.real[np.isfinite(roots.real) & (np.abs(roots) >= system.radius)]
        longest = min(max([DIED / x for x in decay if x > 0], default=0.0), AFFORDED * longest_step(system))
        duration = max(longest, 10 * float(system.wire_delay.max()))
        while True:
            found = metrics([run(duration, SAMPLES)], steady)
            if found["settling"] < 0.9 * duration:
                return found, duration
            duration *= 2

    def _unsettled(self) -> float:
        """[s] duration that shows how a response grows, or moves on."""
        system = self.system
        s = rates(self.known.poles, system.dt)[~self.known.slow]
        rate = s.real[np.isfinite(s.real) & (np.abs(s.real) > 1e-12 * np.abs(s))]
        slowest = rate.max() if (rate > 0).any() else np.abs(rate).min() if rate.size else 1.0
        enough = 8 / float(slowest)
        if not system.delayed:
            return enough
        enough = max(enough, 10 * float(system.wire_delay.max()))
        growth = float(delay_roots(system, 1)[0, 0].real) if not self.others_decay else 0.0
        return min(max(enough, min(3 / growth, 20 * enough)) if growth > 0 else enough, AFFORDED * longest_step(system))

    def _samples(self, duration: float) -> int:
        if self.system.dt:
            return max(1, round(duration / self.system.dt))
        turns = duration * np.abs(self.known.poles.imag).max(initial=0.0) / (2 * np.pi)
        return int(np.clip(16 * turns, SAMPLES, 20 * SAMPLES))

    def _run(self, into: int, out: int, duration: float, samples: int) -> tuple[Array, Array]:
        """Times [s] and values of the response, without dead time."""
        (A, B, C, D), dt = self.closed, self.system.dt
        b, c, d = B[:, [into]], C[out], float(D[out, into])
        if dt:
            return _sampled(A, b, c, d, dt, max(2, int(np.ceil(duration / dt * (1 - 1e-12)))))
        move, push = zero_order_hold(A, b, duration / samples)
        x = _doubled(move, push[:, 0], samples)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(duration / samples * np.arange(samples + 1), float), np.asarray(c @ x + d)


def _sampled(A: Array, b: Array, c: Array, d: float, dt: float, samples: int) -> tuple[Array, Array]:
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
    return np.linspace(0.0, dt * samples, samples + 1), y


def _doubled(move: Array, push: Array, samples: int) -> Array:
    """x[k + 1] = move x[k] + push from x[0] = 0: (nx, samples + 1), by doubling."""
    x = np.zeros((len(push), 1))
    with np.errstate(over="ignore", invalid="ignore"):
        while x.shape[1] <= samples:
            x = np.hstack([x, move @ x + push[:, None]])
            push = move @ push + push
            move = move @ move
    return x[:, : samples + 1]
