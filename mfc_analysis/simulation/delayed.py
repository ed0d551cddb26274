"""Runs with dead time by the method of steps."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise

import numpy as np
from numpy.polynomial import chebyshev

from mfc_analysis.dynamics.equations import timed
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.dual import Vector, value
from mfc_analysis.simulation.run import HELD, Outcome, Piece, Run
from mfc_analysis.simulation.sampled import own_matrix

#: Chebyshev-Lobatto points on [0, 1], at which the signals of a segment are recorded for later segments
NODES = 0.5 * (1 - np.cos(np.pi * np.arange(9) / 8))
#: of the way to the middle of a segment: where the piece of a signal is chosen that arrives in it
ASIDE = 1e-6
#: dead times after which a kink comes back, smoother by one order each time, and still ends a segment
ORDERS = 5
#: evaluations of the equations that take about as long as the recording of a segment
RECORDING = 4
#: largest norm of A_own h at which the controller's own states are found after those of the plant, segment by segment
COUPLED = 0.1
#: repetitions of that until they agree, and how closely: part of the solver's tolerance
REPEATED, AGREED = 30, 0.01
NO_ZERO = 1.2345e-30
_WEIGHTS = np.array([0.5, -1, 1, -1, 1, -1, 1, -1, 0.5])
#: (9, 9) from samples at the nodes to the Chebyshev coefficients of their polynomial
COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(2 * NODES - 1, 8))
#: (9, 9) from samples at the nodes to the integrals from 0 to the nodes
INTEGRALS = 0.5 * chebyshev.chebval(2 * NODES - 1, chebyshev.chebint(np.eye(9), lbnd=-1.0)).T @ COEFFICIENTS


def at_nodes(s: Array) -> Array:
    """(..., 9) weights of the samples at the nodes, for their polynomial at s (...,) in [0, 1]."""
    w = _WEIGHTS / (s[..., None] - NODES + NO_ZERO)  # at a node its weight outdoes the others
    return np.asarray(w / w.sum(axis=-1, keepdims=True))


def combined(weights: Array, samples: Array) -> Array:
    """(m, ...) sums of samples (9, ...) with weights (m, 9)."""
    return np.asarray(weights @ samples.reshape(len(samples), -1)).reshape(-1, *samples.shape[1:])


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
        self.samples.append(samples.reshape(len(NODES), -1))

    def at(self, t: float, towards: float = 0.0) -> Array:
        """The signal at t [s]; where it jumps, on the side ``towards`` [s] from there."""
        side = t + ASIDE * towards
        if side < self.t0 or not self.starts:
            return self.first
        i = max(bisect_right(self.starts, side) - 1, 0)
        return np.asarray(np.dot(at_nodes(np.asarray((t - self.starts[i]) / self.lengths[i])), self.samples[i])).reshape(self.first.shape)

    def along(self, times: Array, towards: Array) -> Array:
        """The signal at times (m,) [s], each on its side."""
        sides = (times + ASIDE * towards).tolist()
        i = bisect_right(self.starts, sides[0]) - 1
        if i < 0 or any(bisect_right(self.starts, side) - 1 != i for side in sides[1:]):
            return np.stack([self.at(*one) for one in zip(times.tolist(), towards.tolist(), strict=True)])
        return np.asarray(at_nodes((times - self.starts[i]) / self.lengths[i]) @ self.samples[i]).reshape(-1, *self.first.shape)


@dataclass(frozen=True, eq=False)
class WithOwn:
    """Dense output of a segment: the plant by the solver, the controller's own states by the polynomials through the nodes."""

    nx: int  #: states of one run
    plant: Piece
    begin: float  #: [s]
    length: float  #: [s]
    own: Ints  #: (r,) indices of the controller's states
    samples: Array  #: (9, ..., r)

    def __call__(self, t: float | Array) -> Array:
        out = np.array(self.plant(t))
        w = at_nodes((np.atleast_1d(t) - self.begin) / self.length)
        own = combined(w, self.samples)  # (m, ..., r)
        each = out.reshape(*self.samples.shape[1:-1], self.nx, -1)
        each[..., self.own, :] = np.moveaxis(own, 0, -1)
        return out


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
    start, end = float(asked[0]), float(asked[-1])
    late = _LateSignals(run, start, x0)
    delays = list(run.equations.delays.values())
    x, after, least = x0, echoes(delays), min(delays)
    marks: list[float] = []  #: [s] echoes of touch and lift that are still to come
    for begin, stop in segments(start, end, delays):
        marks = [mark for mark in marks if mark > begin]
        for a, b in pairwise(edges(begin, stop, marks, least)):
            late.middle, known = 0.5 * (a + b), len(run.events)
            reached = run.integrate(late.rates, a, b, x, short=True, cost=HELD if late.apart else 1.0, record=late.record)
            if reached is None:
                return
            x = reached
            marks += [event.time + echo for event in run.events[known:] for echo in after]


class _LateSignals:
    """The signals of a run that arrive late, recorded segment by segment.

    Where the commands arrive late, nothing of the law acts on the plant within a segment. The solver then sees the plant alone, and the law is
    evaluated at the nodes of the segment: for the record of its commands, and for its own states, which are the integrals of their rates there.
    """

    def __init__(self, run: Run, start: float, x0: Array) -> None:
        e, first, wires = run.equations, run.states(x0), Wires()
        e.flow(start, first, wires, run.inputs(start), lose_contact=run.lose_contact)
        self.run, self.delays = run, e.delays
        self.middle = start  #: [s] of the segment under way
        self.shapes = {name: (*first.shape[:-1], e.wire_sizes()[name]) for name in self.delays}
        self.history = {name: History(start, np.array(np.broadcast_to(value(wires.recorded[name]), shape))) for name, shape in self.shapes.items()}
        self.own = np.setdiff1d(np.arange(e.nx), np.array(e.plant_states, int))
        least = min(self.delays.values())
        self.apart = e.actuator in self.delays and float(np.abs(own_matrix(e, start, first)).sum(axis=-1).max(initial=0.0)) * least < COUPLED
        if e.actuator in self.delays:
            run.arrived = Late(self.history[e.actuator], self.delays[e.actuator])

    def rates(self, t: float, x: Array) -> Array:
        """For the solver, within the segment under way."""
        if self.apart:
            return self.run.plant_rates(t, x, self._arriving(self.run.equations.actuator, t))
        return self.run.rates(t, x, Wires({name: self._arriving(name, t) for name in self.delays}))

    def _arriving(self, name: str, t: float) -> Array:
        return self.history[name].at(t - self.delays[name], self.middle - t)

    def record(self, begin: float, stop: float, x: Array) -> Array:
        """Records the last piece of the run, from ``begin`` to ``stop`` [s], that ends at x. Returns its last state."""
        run, length = self.run, stop - begin
        run.spent += RECORDING * run.weight
        t = begin + NODES * length
        states = run.path.pieces[-1](t).T.reshape(len(t), *run.states(x).shape)
        wires = Wires({name: self.history[name].along(t - delay, begin + 0.5 * length - t) for name, delay in self.delays.items()})
        try:
            command = self._settled(t, states, wires, length)
        except MfcError as why:
            run.refuse(stop, why)
            return x
        wires.recorded[run.equations.actuator] = command
        for name, shape in self.shapes.items():
            self.history[name].add(begin, length, np.array(np.broadcast_to(value(wires.recorded[name]), (len(t), *shape))))
        if self.apart and self.own.size:
            run.path.pieces[-1] = WithOwn(run.equations.nx, run.path.pieces[-1], begin, length, self.own, states[..., self.own])
            run.states(x)[..., self.own] = states[-1][..., self.own]
        return x

    def _settled(self, t: Array, states: Array, wires: Wires, length: float) -> Vector:
        """The command at the nodes t; where the plant is apart the law's own part of ``states`` there becomes the integral of its rates."""
        run, e = self.run, self.run.equations
        each = t if states.ndim == 2 else np.repeat(t[:, None], states.shape[1], axis=1)
        repeated = 0
        while True:
            with timed(each):
                s = e.split(states)
                action, changes = e.control(each, s, e.touch(s, lose_contact=run.lose_contact).wrench, wires, Inputs())
            if not self.apart or not self.own.size:
                return action.command
            before = states[..., self.own]
            found = before[:1] + length * combined(INTEGRALS, e.state_rates(changes, states.shape[:-1])[..., self.own])
            states[..., self.own] = found
            if np.abs(found - before).max() <= AGREED * (run.options["atol"] + run.options["rtol"] * np.abs(found).max()):
                return action.command
            repeated += 1
            if repeated == REPEATED:
                run.stop(Outcome.SOLVER, float(t[0]), "the states of the law do not converge within the dead time")
                return action.command


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
