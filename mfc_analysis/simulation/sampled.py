"""Runs with a sample time: the torque held between samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.sampled import own_step
from mfc_analysis.dynamics.equations import Equations, timed
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, times, value
from mfc_analysis.simulation.run import HELD, Run


@dataclass(frozen=True, eq=False)
class Held:
    """The commands sent so far, as they arrive: each is held for one sample."""

    sent: list[Array]  #: (n,) each
    first: float  #: [s] when the first arrives
    T: float  #: [s]

    def __call__(self, t: float) -> Array:
        return self.sent[min(max(int(np.floor((t - self.first) / self.T + 1e-9)), 0), len(self.sent) - 1)]


@dataclass(frozen=True, eq=False)
class Constant:
    """A constant piece of dense output."""

    x: Array  #: (nx,)

    def __call__(self, t: float | Array) -> Array:
        return self.x if np.ndim(t) == 0 else np.repeat(self.x[:, None], np.size(t), axis=1)


def run_sampled(run: Run, asked: Array, x0: Array) -> None:
    """Runs sample by sample: the law reads at t_k, its torque is held (after the dead time), its own states advance with inputs held."""
    e = run.equations
    T = e.sample_time
    delay, force_delay = (e.delays.get(name, 0.0) for name in (e.actuator, "force"))
    start, end = float(asked[0]), float(asked[-1])
    plant = np.array(e.plant_states, int)
    own = np.setdiff1d(np.arange(e.nx), plant)
    advance = own_states_step(e, start, run.states(x0), T)
    x = x0.copy()
    sent: list[Array] = []  # commands of the samples so far
    whole, rest = int(np.floor(delay / T + 1e-9)), 0.0
    rest = delay - whole * T if delay - whole * T > 1e-9 * T else 0.0
    run.arrived = Held(sent, start + delay, T)
    count = max(int(np.ceil((end - start) / T - 1e-9)), 1)
    for k in range(count):
        t = start + k * T
        states = run.states(x)
        s = e.split(states)
        read = e.split(run.states(run.path.at(max(t - force_delay, start)))) if force_delay else s
        F = value(e.touch(read, lose_contact=True).wrench)
        try:
            with timed(t):
                action, rates = e.control(t, s, F, Wires(), Inputs())
        except MfcError as why:
            run.refuse(t, why)
            return
        sent.append(np.array(np.broadcast_to(value(action.command), (*states.shape[:-1], e.n))))
        own_next = states[..., own] + times(advance, e.state_rates(rates, states.shape[:-1])[..., own]) if own.size else states[..., own]
        before, now = sent[max(k - whole - 1, 0)], sent[max(k - whole, 0)]
        switches = [(t, t + rest, before), (t + rest, t + T, now)] if rest else [(t, t + T, now)]
        for begin, stop, held in switches:
            if begin >= end - 1e-12:
                break
            moved = run.integrate(run.held(held), begin, min(stop, end), x, short=True, cost=HELD)
            if moved is None:
                return
            x = moved
        run.states(x)[..., own] = own_next
    if start + count * T - end < 1e-9 * T:  # the run ends at a sampling instant: the law's own states have advanced
        run.path.add(end, Constant(x))


def own_states_step(e: Equations, t: float, x0: Array, T: float) -> Array:
    """The matrix (..., k, k) that takes the rates of the law's own states to their change over a sample with inputs held."""
    A = own_matrix(e, t, x0)
    own = np.setdiff1d(np.arange(e.nx), np.array(e.plant_states, int))
    return own_step(A, np.isin(own, e.stepped), T) if A.size else A


def own_matrix(e: Equations, t: float, x0: Array) -> Array:
    """A_own (..., k, k): the rates of the controller's k states by these states, at x0 (..., nx)."""
    own = np.setdiff1d(np.arange(e.nx), np.array(e.plant_states, int))
    tangent = np.zeros((*x0.shape, own.size))
    tangent[..., own, np.arange(own.size)] = 1.0
    _, rates = e.control(np.full(x0.shape[:-1], t), e.split(Dual(x0, tangent)), value(e.touch(e.split(x0)).wrench), Wires(), Inputs(), unwind=False)
    A = np.zeros((*x0.shape, own.size))
    for name, rate in rates.items():
        if isinstance(rate, Dual):
            A[..., e.parts[name].where, :] = rate.tangent
    return A[..., own, :]
