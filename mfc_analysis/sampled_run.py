"""Runs with dead time (method of steps) and with a sample time (torque held between samples)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.equations import Equations, Inputs, Wires
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.dual import Dual, Vector, value
from mfc_analysis.maths.expm import expm_integral
from mfc_analysis.run import _Run

Array = NDArray[np.float64]

#: Chebyshev-Lobatto points on [0, 1]: where a segment's signals are recorded for the next ones
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


def run_with_dead_time(run: _Run, asked: Array, x0: Array) -> None:
    """Method of steps: in a segment no longer than the shortest dead time, what arrives was sent in segments already done."""
    e, lose = run.equations, run.one_sided
    actuator_delay, force_delay = (float(d or 0.0) for d in (e.hardware.delay, e.hardware.force_delay))
    delays = {name: d for name, d in ((e.actuator, actuator_delay), ("force", force_delay)) if d > 0}
    start, end = float(asked[0]), float(asked[-1])
    wires = Wires()
    e.flow(start, x0, wires, run.inputs(start), lose_contact=lose)
    history = {name: History(start, np.array(value(wires.recorded[name]))) for name in delays}

    def arriving(t: float) -> dict[str, Vector]:
        return {name: history[name].at(t - d) for name, d in delays.items()}

    if actuator_delay:
        run.arrived = lambda t: history[e.actuator].at(t - actuator_delay)

    def rates(t: float, x: Array) -> Array:
        rates_now: Array = value(e.join(e.flow(t, x, Wires(arriving(t)), run.inputs(t), lose_contact=lose).rates))
        return rates_now

    segment = min(delays.values())
    x: Array | None = x0
    count = int(np.ceil((end - start) / segment - 1e-9))
    for k in range(count):
        begin, stop = start + k * segment, min(start + (k + 1) * segment, end)
        x = run.integrate(rates, begin, stop, x, short=True)  # type: ignore[arg-type]
        if x is None:
            return
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


def run_sampled(run: _Run, asked: Array, x0: Array) -> None:
    """Sample by sample: the law reads at t_k, its torque is held (after the dead time), its own states advance with inputs held."""
    e, lose = run.equations, run.one_sided
    T = float(e.hardware.sample_time)  # type: ignore[arg-type]
    delay, force_delay = (float(d or 0.0) for d in (e.hardware.delay, e.hardware.force_delay))
    start, end = float(asked[0]), float(asked[-1])
    plant = np.array(e.plant_states, int)
    own = np.setdiff1d(np.arange(e.nx), plant)
    advance = own_states_step(e, start, x0, T)
    x = x0.copy()
    sent: list[Array] = []  # commands of the samples so far
    whole, rest = int(np.floor(delay / T + 1e-9)), 0.0
    rest = delay - whole * T if delay - whole * T > 1e-9 * T else 0.0
    run.arrived = lambda t: sent[min(max(int(np.floor((t - start - delay) / T + 1e-9)), 0), len(sent) - 1)]
    count = int(np.ceil((end - start) / T - 1e-9))
    for k in range(count):
        t = start + k * T
        s = e.split(x)
        read = e.split(run.path.at(max(t - force_delay, start))) if force_delay else s
        F = value(e.touch(read, lose_contact=lose).wrench)
        e.plant.times = e.controller.times = np.asarray(t)  # for messages
        try:
            action, rates = e.control(t, s, F, Wires(), Inputs())
        except MfcError as why:
            run.refuse(t, why)
            return
        sent.append(np.array(value(action.command)))
        own_next = x[own] + advance @ _own_rates(run, rates, own) if own.size else x[own]
        before, now = sent[max(k - whole - 1, 0)], sent[max(k - whole, 0)]
        switches = [(t, t + rest, before), (t + rest, t + T, now)] if rest else [(t, t + T, now)]
        for begin, stop, held in switches:
            if begin >= end - 1e-12:
                break
            moved = run.integrate(_held_rates(run, held), begin, min(stop, end), x, short=True)
            if moved is None:
                return
            x = moved
        x[own] = own_next
    if start + count * T - end < 1e-9 * T:  # the run ends at a sampling instant: the law's own states have moved on
        run.path.add(end, lambda t: x)


def _held_rates(run: _Run, held: Array) -> Callable[[float, Array], Array]:
    e, lose = run.equations, run.one_sided

    def rates(t: float, x: Array) -> Array:
        s = e.split(x)
        d = 0.0 if run.disturbance is None else run.disturbance(t)
        moved = e.move(s, held, e.touch(s, lose_contact=lose).wrench if e.surfaces else np.zeros(6), d)
        out = np.zeros(e.nx)
        for name, rate in moved.items():
            out[e.parts[name].where] = value(rate)
        return out

    return rates


def _own_rates(run: _Run, rates: dict[str, Vector], own: Array) -> Array:
    e = run.equations
    out = np.zeros(e.nx)
    for name, rate in rates.items():
        out[e.parts[name].where] = value(rate)
    return np.asarray(out[own], float)


def own_states_step(e: Equations, t: float, x0: Array, T: float) -> Array:
    """The matrix that takes the rates of the law's own states to their change over a sample with inputs held: T phi_1(T A_own)."""
    own = np.setdiff1d(np.arange(e.nx), np.array(e.plant_states, int))
    k = own.size
    if k == 0:
        return np.zeros((0, 0))
    tangent = np.zeros((e.nx, k))
    tangent[own, np.arange(k)] = 1.0
    _, rates = e.control(t, e.split(Dual(x0, tangent)), value(e.touch(e.split(x0)).wrench), Wires(), Inputs())
    A = np.zeros((e.nx, k))
    for name, rate in rates.items():
        if isinstance(rate, Dual):
            A[e.parts[name].where] = rate.tangent
    return np.asarray(expm_integral(A[own][None], np.eye(k)[None], T)[1][0])
