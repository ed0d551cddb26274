"""Runs with dead time by the method of steps."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise

import numpy as np

from mfc_analysis.dynamics.equations import Inputs, Wires
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, value
from mfc_analysis.simulation.run import Run

#: Chebyshev-Lobatto points on [0, 1], at which the signals of a segment are recorded for later segments
NODES = 0.5 * (1 - np.cos(np.pi * np.arange(9) / 8))
#: of the way to the middle of a segment: where the piece of a signal is chosen that arrives in it
ASIDE = 1e-6
#: dead times after which a kink comes back, smoother by one order each time, and still ends a segment
ORDERS = 5
#: evaluations of the equations that take about as long as the recording of a segment
RECORDING = 4
_WEIGHTS = np.array([0.5, -1, 1, -1, 1, -1, 1, -1, 0.5])


class History:
    """A signal recorded segment by segment, looked up by polynomial interpolation; constant before its start."""

    def __init__(self, t0: float, first: Array) -> None:
        self.starts: list[float] = []
        self.lengths: list[float] = []
        self.samples: list[Array] = []
        self.t0, self.first = t0, first

    def add(self, start: float, length: float, samples: Array) -> None:
        self.starts.append(start)
        self.lengths.append(length)
        self.samples.append(samples)

    def at(self, t: float, towards: float = 0.0) -> Array:
        """The signal at t [s]; where it jumps, on the side ``towards`` [s] from there."""
        side = t + ASIDE * towards
        if side < self.t0 or not self.starts:
            return self.first
        i = max(bisect_right(self.starts, side) - 1, 0)
        apart = (t - self.starts[i]) / self.lengths[i] - NODES
        if np.abs(apart).min() < 1e-12:
            return np.asarray(self.samples[i][int(np.abs(apart).argmin())], float)
        w = _WEIGHTS / apart
        return np.asarray(np.tensordot(w / w.sum(), self.samples[i], axes=1))


@dataclass(frozen=True, eq=False)
class Late:
    """A recorded signal, delayed by a dead time."""

    signal: History
    delay: float  #: [s]

    def __call__(self, t: float) -> Array:
        return self.signal.at(t - self.delay)


def run_with_dead_time(run: Run, asked: Array, x0: Array) -> None:
    """Method of steps on ``segments``: every signal that arrives in a segment was sent in an earlier one, and has no kink within it.

    A touch or a lift ends a segment too, and so do its echoes: the force jumps there.
    """
    e = run.equations
    delays = e.delays
    start, end = float(asked[0]), float(asked[-1])
    wires = Wires()
    e.flow(start, x0, wires, run.inputs(start), lose_contact=run.lose_contact)
    history = {name: History(start, np.array(value(wires.recorded[name]))) for name in delays}

    middle = start  # of the segment under way

    def arriving(t: float) -> dict[str, Vector]:
        return {name: history[name].at(t - d, middle - t) for name, d in delays.items()}

    if e.actuator in delays:
        run.arrived = Late(history[e.actuator], delays[e.actuator])

    def rates(t: float, x: Array) -> Array:
        rates_now: Array = value(e.join(e.flow(t, x, Wires(arriving(t)), run.inputs(t), lose_contact=run.lose_contact).rates))
        return rates_now

    def record(begin: float, stop: float) -> None:
        run.spent += RECORDING
        t = begin + NODES * (stop - begin)
        states = np.stack([run.path.at(float(ti)) for ti in t])
        recorded = Wires(
            {name: np.stack([history[name].at(float(ti) - d, 0.5 * (begin + stop) - float(ti)) for ti in t]) for name, d in delays.items()}
        )
        try:
            e.flow(t, states, recorded, Inputs(), lose_contact=run.lose_contact)
        except MfcError as why:
            run.refuse(stop, why)
            return
        for name in delays:
            history[name].add(begin, stop - begin, np.array(np.broadcast_to(value(recorded.recorded[name]), (len(t), history[name].first.size))))

    x, late, least = x0, echoes(list(delays.values())), min(delays.values())
    marks: list[float] = []  #: [s] echoes of touch and lift that are still to come
    for begin, stop in segments(start, end, list(delays.values())):
        marks = [mark for mark in marks if mark > begin]
        for a, b in pairwise(edges(begin, stop, marks, least)):
            middle, known = 0.5 * (a + b), len(run.events)
            reached = run.integrate(rates, a, b, x, short=True, record=record)
            if reached is None:
                return
            x = reached
            marks += [event.time + echo for event in run.events[known:] for echo in late]


def segments(start: float, end: float, delays: list[float]) -> Iterator[tuple[float, float]]:
    """(begin, end) [s] of segments no longer than the shortest dead time.

    A signal that is constant before the start has a kink there. It comes back after each dead time and after each sum of them, smoother by one
    order each time; the first ``ORDERS`` are ends of segments.
    """
    span, least = end - start, min(delays)
    for a, b in pairwise(edges(0.0, span, echoes(delays), least)):
        count = max(int(np.ceil((b - a) / least - 1e-9)), 1)
        ends = (b if k == count else a + (b - a) * k / count for k in range(count + 1))
        yield from pairwise(start + edge for edge in ends)


def echoes(delays: list[float]) -> list[float]:
    """[s] after a kink: each dead time and each sum of up to ``ORDERS`` of them."""
    return sorted(sum(some) for count in range(1, ORDERS + 1) for some in combinations_with_replacement(delays, count))


def edges(begin: float, stop: float, marks: list[float], least: float) -> list[float]:
    """``begin``, the marks between, and ``stop``, without marks that lie on another edge up to rounding; ``least``: the shortest dead time."""
    out = [begin]
    for mark in sorted(marks):
        if mark - out[-1] > 1e-9 * min(stop - begin, least) and stop - mark > 1e-9 * (stop - begin):
            out.append(mark)
    return [*out, stop]
