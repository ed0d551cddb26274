"""Linear prediction of disturbed runs with dead time or sampling, for a validation.

``directions`` of the start state are (nx,), or (nx, k) at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.floquet import gauss_nodes, transition_magnus
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import open_system
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.delayed import COEFFICIENTS, INTEGRALS, NODES, History, at_nodes, combined, segments
from mfc_analysis.simulation.sampled import own_states_step
from mfc_analysis.simulation.simulation import Motion

FINE = 1e-11  #: relative accuracy, below the tolerance of the runs of ``validate``
SUBSTITUTIONS, ROUNDING = 60, 1e-14  #: largest number of repetitions, and the relative change at which they end
SHORTEST = 1e-3  #: of a segment: its shortest part
OnSegment = Callable[[Array], Array]


def delayed(e: Equations, base: Motion, t: Array, directions: Array) -> Array:
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
    along = (A, B[:, :, nu:], C[:, ny:], D[:, ny:, nu:])
    out = np.empty((len(t), *directions.shape))
    x = directions.reshape(e.nx, -1)
    past = History(float(t[0]), np.asarray(np.linalg.solve(np.eye(late.sum()) - along[3][0], along[2][0] @ x), float))
    kinds = [(delay, delay == T) for delay in np.unique(T)]

    for k in range(whole):
        start, stop = float(edges[k]), float(edges[k + 1])

        def arriving(times: Array, middle: float = 0.5 * (start + stop)) -> Array:
            w = np.empty((len(times), *past.first.shape))
            for delay, channels in kinds:
                w[:, channels] = past.along(times - delay, middle - times)[:, channels]
            return w

        At, Bt, Ct, Dt = (_cubic(M[3 * k : 3 * k + 4]) for M in along)
        w = arriving(start + NODES * (stop - start))

        def forcing(s: Array, start: float = start, stop: float = stop, w: Array = w) -> Array:
            return np.asarray(Bt(s) @ (w if s is NODES else arriving(start + s * (stop - start))))  # noqa: B023  # called at once

        piece = solved(At, forcing, stop - start, x)
        inside = np.flatnonzero((t >= start - 1e-12) & (t <= stop + 1e-12))
        if inside.size:
            out[inside] = piece((t[inside] - start) / (stop - start)).reshape(-1, *directions.shape)
        past.add(start, stop - start, Ct(NODES) @ piece(NODES) + Dt(NODES) @ w)
        x = piece(NODES[-1:])[0]
    return out


def _cubic(M: Array) -> OnSegment:
    """s (m,) in [0, 1] -> (m, i, j): the cubic through matrices (4, i, j) at the ends and thirds of a segment."""

    def at(s: Array) -> Array:
        r = 3 * s
        w = [-(r - 1) * (r - 2) * (r - 3) / 6, r * (r - 2) * (r - 3) / 2, -r * (r - 1) * (r - 3) / 2, r * (r - 1) * (r - 2) / 6]
        return np.asarray(np.tensordot(np.stack(w, axis=1), M, axes=1))

    return at


def solved(A: OnSegment, forcing: OnSegment, length: float, x: Array, low: float = 0.0, high: float = 1.0) -> OnSegment:
    """x' = A x + forcing over a segment of ``length`` [s], from x (nx, k): s (m,) in [0, 1] -> (m, nx, k).

    The integral equation at the nodes by repeated substitution, which converges as a power series of an exponential does. Where the polynomial
    through the nodes is not accurate to ``FINE`` the segment is solved in halves.
    """
    s = NODES if high - low == 1.0 else low + (high - low) * NODES
    A_s, forced, h = A(s), forcing(s), (high - low) * length
    fixed = x + h * combined(INTEGRALS, forced)
    found = fixed
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(SUBSTITUTIONS):
            before, found = found, fixed + h * combined(INTEGRALS, A_s @ found)
            if not np.any(np.abs(found - before).max(axis=(0, 1)) > ROUNDING * np.abs(found).max(axis=(0, 1))):
                break
        rough = np.abs(combined(np.asarray(COEFFICIENTS[-2:], float), found)).max(axis=(0, 1)) > FINE * np.abs(found).max(axis=(0, 1))
    if not np.any(rough) or high - low < SHORTEST:
        return lambda at: combined(at_nodes((at - low) / (high - low)), found)
    middle = 0.5 * (low + high)
    first = solved(A, forcing, length, x, low, middle)
    second = solved(A, forcing, length, first(np.array([middle]))[0], middle, high)

    def joined(at: Array) -> Array:
        out = np.empty((len(at), *x.shape))
        early = at <= middle
        out[early], out[~early] = first(at[early]), second(at[~early])
        return out

    return joined


# --- sampled loops -----------------------------------------------------------------------------------------------


def sampled_at_rest(e: Equations, base: Motion, t: Array, directions: Array) -> Array:
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


def _first_signals(e: Equations, base: Motion, directions: Array) -> tuple[Array, Array]:
    """Command of the law (n[, k]) and reading of the force sensor (6[, k]) at the disturbed start, without dead time."""
    system = open_system(e, base.t[:1], base.x[:1])
    keep = np.zeros(system.nw, bool)
    keep[system.wires[e.actuator]] = True
    command = close_wires(system, keep)[2][0, system.ny :] @ directions
    force = system.C[0, system.ny :][system.wires["force"] if "force" in system.wires else slice(0)] @ directions
    return command, force


def sampled_along(e: Equations, base: Motion, t: Array, directions: Array) -> Array:
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


def _plant_steps(e: Equations, base: Motion, edges: Array) -> Array:
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


def _law_rows(e: Equations, base: Motion, samples: Array) -> tuple[Array, Array, Array, Array, Array]:
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
