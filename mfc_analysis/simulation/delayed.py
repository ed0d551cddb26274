"""Runs with dead time by the method of steps."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from mfc_analysis.dynamics.equations import Inputs, Wires
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, value
from mfc_analysis.simulation.run import Run

#: Chebyshev-Lobatto points on [0, 1], at which the signals of a segment are recorded for later segments
NODES = 0.5 * (1 - np.cos(np.pi * np.arange(9) / 8))
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

    def at(self, t: float) -> Array:
        if t < self.t0 or not self.starts:
            return self.first
        i = max(bisect_right(self.starts, t) - 1, 0)
        apart = (t - self.starts[i]) / self.lengths[i] - NODES
        if np.abs(apart).min() < 1e-12:
            return np.asarray(self.samples[i][int(np.abs(apart).argmin())], float)
        w = _WEIGHTS / apart
        return np.asarray((w @ self.samples[i]) / w.sum())


@dataclass(frozen=True, eq=False)
class Late:
    """A recorded signal, delayed by a dead time."""

    signal: History
    delay: float  #: [s]

    def __call__(self, t: float) -> Array:
        return self.signal.at(t - self.delay)


def run_with_dead_time(run: Run, asked: Array, x0: Array) -> None:
    """Method of steps: in a segment no longer than the shortest dead time, every arriving signal was sent in an earlier segment."""
    e, lose = run.equations, run.one_sided
    delays = e.delays
    start, end = float(asked[0]), float(asked[-1])
    wires = Wires()
    e.flow(start, x0, wires, run.inputs(start), lose_contact=lose)
    history = {name: History(start, np.array(value(wires.recorded[name]))) for name in delays}

    def arriving(t: float) -> dict[str, Vector]:
        return {name: history[name].at(t - d) for name, d in delays.items()}

    if e.actuator in delays:
        run.arrived = Late(history[e.actuator], delays[e.actuator])

    def rates(t: float, x: Array) -> Array:
        rates_now: Array = value(e.join(e.flow(t, x, Wires(arriving(t)), run.inputs(t), lose_contact=lose).rates))
        return rates_now

    segment = min(delays.values())
    x = x0
    count = int(np.ceil((end - start) / segment - 1e-9))
    for k in range(count):
        begin, stop = start + k * segment, min(start + (k + 1) * segment, end)
        reached = run.integrate(rates, begin, stop, x, short=True)
        if reached is None:
            return
        x = reached
        t = begin + NODES * (stop - begin)
        states = np.stack([run.path.at(float(ti)) for ti in t])
        recorded = Wires({name: np.stack([history[name].at(float(ti) - d) for ti in t]) for name, d in delays.items()})
        try:
            e.flow(t, states, recorded, Inputs(), lose_contact=lose)
        except MfcError as why:
            run.refuse(stop, why)
            return
        for name in delays:
            history[name].add(begin, stop - begin, np.array(np.broadcast_to(value(recorded.recorded[name]), (len(t), history[name].first.size))))
