"""Linear prediction of disturbed runs with dead time or sampling, for a validation.

``directions`` of the start state are (nx,), or (nx, k) at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from mfc_analysis.analysis.floquet import gauss_nodes, transition_magnus
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import open_system
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.delayed import NODES, History, segments
from mfc_analysis.simulation.sampled import own_states_step
from mfc_analysis.simulation.simulation import Simulation

FINE: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-13}  #: below the tolerance of the runs of ``validate``


def delayed(e: Equations, base: Simulation, t: Array, directions: Array) -> Array:
    """(N, nx[, k]) x' = A(t) x + B w(t - T), w = C x + D w(t - T) along the base run, from ``directions``; before the start w is constant.

    The segments and the record of the signals are those of the nonlinear run, so that what they leave out is the same in both; A(t) is a cubic
    through four points of each segment.
    """
    edges = np.array([float(t[0]), *(stop for _, stop in segments(float(t[0]), float(t[-1]), list(e.delays.values())))])
    whole = len(edges) - 1
    at_thirds = np.interp(np.arange(3 * whole + 1) / 3, np.arange(whole + 1), edges)
    sent = None if base.arrived is None else {e.actuator: np.stack([base.arrived(float(ti)) for ti in at_thirds])}
    system = open_system(e, at_thirds, base.state(at_thirds), arriving=sent)
    late = system.wire_delay > 0
    nu, ny, T = system.nu, system.ny, system.wire_delay[late]
    A, B, C, D = close_wires(system, late)
    along = [_Cubic(M, edges) for M in (A, B[:, :, nu:], C[:, ny:], D[:, ny:, nu:])]
    At, Bt, Ct, Dt = along
    out = np.empty((len(t), *directions.shape))
    x = directions.copy()
    past = History(float(t[0]), np.asarray(np.linalg.solve(np.eye(late.sum()) - D[0, ny:, nu:], C[0, ny:] @ x), float))

    def arriving(at: float) -> Array:
        return np.array([past.at(at - Ti)[i] for i, Ti in enumerate(T)])

    for k in range(whole):
        start, stop = float(edges[k]), float(edges[k + 1])

        def rates(at: float, flat: Array, k: int = k) -> Array:
            return np.asarray(np.ravel(At.at(k, at) @ flat.reshape(directions.shape) + Bt.at(k, at) @ arriving(at)))

        found = solve_ivp(rates, (start, stop), np.ravel(x), method="DOP853", first_step=stop - start, dense_output=True, **FINE)
        inside = np.flatnonzero((t >= start - 1e-12) & (t <= stop + 1e-12))
        if inside.size:
            out[inside] = found.sol(t[inside]).T.reshape(-1, *x.shape)
        nodes = np.asarray(start + NODES * (stop - start), float)
        pairs = zip(nodes, found.sol(nodes).T.reshape(-1, *x.shape), strict=True)
        past.add(start, stop - start, np.stack([Ct.at(k, float(ti)) @ xi + Dt.at(k, float(ti)) @ arriving(float(ti)) for ti, xi in pairs]))
        x = found.y[:, -1].reshape(x.shape)
    return out


class _Cubic:
    """Matrices along the path: in each segment the cubic through its ends and thirds."""

    def __init__(self, M: Array, edges: Array) -> None:
        self.M, self.edges = M, edges

    def at(self, k: int, t: float) -> Array:
        s = 3 * (t - self.edges[k]) / (self.edges[k + 1] - self.edges[k])
        w = [-(s - 1) * (s - 2) * (s - 3) / 6, s * (s - 2) * (s - 3) / 2, -s * (s - 1) * (s - 3) / 2, s * (s - 1) * (s - 2) / 6]
        return np.asarray(np.tensordot(w, self.M[3 * k : 3 * k + 4], axes=1))


# --- sampled loops -----------------------------------------------------------------------------------------------


def sampled_at_rest(e: Equations, base: Simulation, t: Array, directions: Array) -> Array:
    """(N, nx[, k]) by powers of the discrete model of the loop; the base run is at rest."""
    opened, nx = sampled(open_system(e, t[:1], base.state(t[:1])), e.sample_time), e.nx
    A = close_wires(opened)[0][0]
    command, sensed = _first_signals(e, base, directions)
    x = np.zeros((opened.nx, *directions.shape[1:]))
    x[:nx] = directions
    for i, name in enumerate(opened.state_names[nx:], start=nx):  # samples in transit at the start
        point, _, channel = name.partition("[")
        j = opened.wire_names[opened.wires[point]].index(channel.partition("] ")[2])
        x[i] = sensed[j] if point == "force" else command[j]
    out = np.empty((len(t), *directions.shape))
    for k in range(len(t)):
        out[k] = x[:nx]
        x = A @ x
    return out


def _first_signals(e: Equations, base: Simulation, directions: Array) -> tuple[Array, Array]:
    """Command of the law (n[, k]) and reading of the force sensor (6[, k]) at the disturbed start, without dead time."""
    system = open_system(e, base.t[:1], base.x[:1])
    keep = np.zeros(system.nw, bool)
    keep[system.wires[e.actuator]] = True
    command = close_wires(system, keep)[2][0, system.ny :] @ directions
    force = system.C[0, system.ny :][system.wires["force"] if "force" in system.wires else slice(0)] @ directions
    return command, force


def sampled_along(e: Equations, base: Simulation, t: Array, directions: Array) -> Array:
    """(N, nx[, k]) along a moving base run: the plant linearised at Gauss nodes within each sample, the law at the samples.

    The order of events is that of ``sampled.run_sampled``: read, command, hold after the dead time, own states advanced with inputs held.
    """
    T = e.sample_time
    delay, force_delay = (e.delays.get(name, 0.0) for name in (e.actuator, "force"))
    start, nx = float(t[0]), e.nx
    samples = np.asarray(start + T * np.arange(len(t)), float)
    edges = np.unique(np.round(np.concatenate([samples, samples + delay % T, samples - force_delay]), 13))
    edges = edges[(edges >= start) & (edges <= samples[-1])]
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9 * T])]
    steps = _plant_steps(e, base, edges)
    command_x, command_f, own_x, own_f, sense = _law_rows(e, base, samples[:-1])
    plant = np.array(e.plant_states, int)
    own = np.setdiff1d(np.arange(nx), plant)
    advance = own_states_step(e, start, base.x[0], T)
    out = np.empty((len(t), *directions.shape))
    x = directions.copy()
    sent: list[Array] = []
    seen = {0: sense[0] @ x}  # force at the edges, by index
    at = 0
    for k in range(len(t) - 1):
        out[k] = x
        asked = int(np.abs(edges - max(samples[k] - force_delay, start)).argmin())
        force = seen[asked]
        sent.append(command_x[k] @ x + command_f[k] @ force)
        own_next = x[own] + advance @ (own_x[k] @ x + own_f[k] @ force)[own] if own.size else x[own]
        while at < len(edges) - 1 and edges[at] < samples[k + 1] - 1e-9 * T:
            age = max(int(np.floor((edges[at] - start - delay) / T + 1e-6)), 0)
            x[plant] = steps[at] @ np.concatenate([x[plant], sent[min(age, k)]])
            at += 1
            seen[at] = sense[min(k + 1, len(sense) - 1)] @ x
        x[own] = own_next
    out[-1] = x
    return out


def _plant_steps(e: Equations, base: Simulation, edges: Array) -> Array:
    """(N, np, np + n) matrices from the plant states and the held command to the plant states at the next edge; two Gauss nodes a step."""
    nodes = np.ravel(gauss_nodes(edges))
    assert base.arrived is not None
    arriving = {e.actuator: np.stack([base.arrived(float(ti)) for ti in nodes])}
    system = open_system(e, nodes, base.state(nodes), arriving=arriving)
    plant, n = np.array(e.plant_states, int), e.n
    wires = system.nu + np.arange(system.nw)[system.wires[e.actuator]]
    size = plant.size
    block = np.zeros((len(nodes), size + n, size + n))
    block[:, :size, :size] = system.A[:, plant[:, None], plant]
    block[:, :size, size:] = system.B[:, plant[:, None], wires]
    return transition_magnus(block.reshape(-1, 2, size + n, size + n), np.diff(edges))[:, :size]


def _law_rows(e: Equations, base: Simulation, samples: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Matrices at the samples: command and state rates from the state and, separately, from the measured force; and the force from the state."""
    assert base.arrived is not None
    x = base.state(samples + 1e-7 * np.min(np.diff(base.t)))  # just after the sample, where the law's own states have jumped
    system = open_system(e, samples, x, arriving={e.actuator: np.stack([base.arrived(float(ti)) for ti in samples])})
    keep = np.zeros(system.nw, bool)
    keep[system.wires[e.actuator]] = True
    if "force" in system.wires:
        keep[system.wires["force"]] = True
    A, B, C, D = close_wires(system, keep)
    n, first = e.n, system.ny
    has_force = "force" in system.wires
    command_f = D[:, first : first + n, system.nu + n :] if has_force else np.zeros((len(samples), n, 6))
    own_f = B[:, :, system.nu + n :] if has_force else np.zeros((len(samples), e.nx, 6))
    sense = C[:, first + n :] if has_force else np.zeros((len(samples), 6, e.nx))
    return C[:, first : first + n], command_f, A, own_f, sense
