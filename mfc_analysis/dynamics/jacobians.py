"""Exact Jacobians of ``equations.py`` at m points, by one evaluation with dual arrays: the closed A, or the loop with every wire cut.

In coordinates "error" the joint states (q, v) are replaced by (X_e, V_e) of a tool law, or (e, e') of a joint law. The new
rates are exact along a moving path: they are the linearised rates of the error itself, not T A T^-1. These states are errors
from the nominal reference: an external reference input changes the input of the law, and its jumps do not make a state jump.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.dynamics.environment import LoseContact
from mfc_analysis.dynamics.equations import Equations, reference_channels, reference_moves
from mfc_analysis.dynamics.flow import Flow, Inputs, Wires
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.law import WRENCH, ToolReference
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Seed, Vector, concatenate, value
from mfc_analysis.robots.tool_task import tool_task

Coordinates = Literal["state", "error"]


class _Change(NamedTuple):
    """Error coordinates: their leading states and the rates of these, dual over all columns."""

    states: Vector  #: (m, k)
    rates: Vector  #: (m, k)
    replaced: int  #: number of leading states of x that they replace


def _tangent(x: Vector, shape: tuple[int, ...], width: int) -> Array:
    """Tangent (..., k, width) of a dual, zeros of a plain array."""
    return x.tangent if isinstance(x, Dual) else np.zeros((*shape, width))


def closed_matrix(equations: Equations, times: Array, x: Array, coordinates: Coordinates = "state", *, lose_contact: LoseContact = False) -> Array:
    """A of the closed loop (m, nx, nx), dead time left out."""
    if equations.law.needs_acceleration:
        return close_wires(open_system(equations, times, x, coordinates))[0]
    nx = equations.nx
    seeded = Seed(x, 0, nx)
    flow = equations.flow(times, seeded, lose_contact=lose_contact)
    rates = equations.join(flow.rates)
    A = _finite(_tangent(rates, x.shape, nx))
    if coordinates == "state":
        return A
    change = _error_coordinates(equations, times, seeded, flow.rates)
    return _changed(A, change, nx)[0]


class Closed(NamedTuple):
    """The closed loop at m points, dead time left out."""

    A: Array  #: (m, nx, nx)
    B: Array  #: (m, nx, nu) from the external inputs
    C: Array  #: (m, ny, nx) to the outputs
    D: Array  #: (m, ny, nu)


def closed_system(equations: Equations, times: Array, x: Array, coordinates: Coordinates = "state") -> Closed:
    """A, B, C, D of the closed loop at (times, x), dead time left out: no wire is cut. Names as in ``external``."""
    if equations.law.needs_acceleration:
        return Closed(*close_wires(open_system(equations, times, x, coordinates)))
    names = external(equations)
    nx = equations.nx
    width = nx + len(names.inputs)
    wires, seeded = Wires(), Seed(x, 0, width)
    flow = equations.flow(times, seeded, wires, _inputs(equations, times, x, width))
    outputs = _outputs(equations, seeded, flow, wires)
    C = _tangent(outputs, (len(times), len(names.outputs)), width)
    T = _finite(_tangent(equations.join(flow.rates), x.shape, width))
    if coordinates == "error":
        T, C = _changed_open(T, C, _error_coordinates(equations, times, seeded, flow.rates), nx)
    return Closed(T[:, :, :nx], T[:, :, nx:], C[:, :, :nx], C[:, :, nx:])


class External(NamedTuple):
    """Names of the states in the coordinates asked for, the external inputs and the outputs."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def external(equations: Equations, coordinates: Coordinates = "state") -> External:
    """What the closed loop is between, in the order of the columns and rows of its A, B, C, D."""
    joints = equations.robot.joint_names
    tool = equations.law.space == "tool"
    inputs = [*reference_channels(equations), *(f"disturbance_{j}" for j in joints)]
    if equations.law.desired_wrench is not None:
        inputs += [f"F_d_{c}" for c in WRENCH]
    channels = equations.law.error_channels(joints)
    error = [f"{'X_e' if tool else 'e'}_{c}" for c in channels]
    outputs = [*(f"q_{j}" for j in joints), *error, *(f"{'tau' if equations.actuator == 'torque' else 'u'}_{j}" for j in joints)]
    if equations.surfaces:
        outputs += [f"F_tip_{c}" for c in WRENCH]
    states = equations.state_names
    if coordinates == "error":
        if equations.actuator == "torque":
            error += [f"{'V_e' if tool else 'e_dot'}_{c}" for c in channels]
        states = (*error, *states[len(error) :])
    return External(states, tuple(inputs), tuple(outputs))


def _inputs(equations: Equations, times: Array, x: Array, width: int) -> Inputs:
    """The external inputs, each a direction after the states."""
    m, n, nx, references = len(times), equations.n, equations.nx, len(reference_channels(equations))
    F_d = equations.law.desired_wrench
    return Inputs(
        _reference_shift(equations, times, x, width),
        Seed(np.zeros((m, n)), nx + references, width),
        None if F_d is None else Seed(np.broadcast_to(F_d, (m, 6)), nx + references + n, width),
    )


def _reference_shift(equations: Equations, times: Array, x: Array, width: int) -> Dual:
    """The inputs of the reference, by what each adds to it."""
    m, nx, k = len(times), equations.nx, len(reference_channels(equations))
    if equations.law.selection is None:
        return Seed(np.zeros((m, k)), nx, width)
    shift = np.zeros((m, 6, width))
    shift[..., nx : nx + k] = reference_moves(equations, times, x)
    return Dual(np.zeros((m, 6)), shift)


def matrix_at(equations: Equations, t: float, x: Array, *, lose_contact: LoseContact = False) -> Array:
    """A (nx, nx) as ``closed_matrix`` at one time [s] and state x (nx,): the batch of one would cost a tenth more."""
    if equations.law.needs_acceleration:
        return np.asarray(closed_matrix(equations, np.full(1, t), x[None], lose_contact=lose_contact)[0], float)
    nx = equations.nx
    flow, A = equations.flow(t, Seed(x, 0, nx, _identity(nx)), lose_contact=lose_contact), np.zeros((nx, nx))
    for name, (where, _) in equations.parts.items():
        rate = flow.rates[name]
        if isinstance(rate, Dual):
            A[where] = rate.tangent
    return _finite(A)


@cache
def _identity(n: int) -> Array:
    out = np.eye(n)
    out.flags.writeable = False  # shared
    return out


def open_system(
    equations: Equations, times: Array, x: Array, coordinates: Coordinates = "state", arriving: Mapping[str, Array] | None = None
) -> OpenSystem:
    """The loop at (times, x) with every wire cut: external inputs (reference, disturbance, F_d) and all wires as columns.

    ``arriving`` gives the values (m, k) after a wire where they differ from those before it (dead time on a moving path).
    """
    m, nx = len(times), equations.nx
    held_wires = Wires()
    held = equations.flow(times, x, held_wires)  # values on the wires
    sizes = equations.wire_sizes()
    names = external(equations, coordinates)
    nu, nw = len(names.inputs), sum(sizes.values())
    width = nx + nu + nw
    cut: dict[str, Vector] = {}
    wires_at: dict[str, slice] = {}
    start = 0
    for name, size in sizes.items():
        signal = held.command if name == equations.actuator else held_wires.recorded[name]
        signal = (arriving or {}).get(name, signal)
        cut[name] = Seed(np.broadcast_to(value(signal), (m, size)), nx + nu + start, width)
        wires_at[name] = slice(start, start + size)
        start += size
    wires = Wires(cut)
    seeded = Seed(x, 0, width)
    flow = equations.flow(times, seeded, wires, _inputs(equations, times, x, width))
    rows = [_tangent(_outputs(equations, seeded, flow, wires), (m, len(names.outputs)), width)]
    rows += [_tangent(wires.recorded[name], (m, size), width) for name, size in sizes.items()]
    T = _finite(_tangent(equations.join(flow.rates), (m, nx), width))
    C = np.concatenate(rows, axis=1)
    if coordinates == "error":
        T, C = _changed_open(T, C, _error_coordinates(equations, times, seeded, flow.rates), nx)
    delay = np.zeros(nw)
    for name, late in equations.delays.items():
        delay[wires_at[name]] = late
    return OpenSystem(
        times=times,
        A=T[:, :, :nx],
        B=T[:, :, nx:],
        C=C[:, :, :nx],
        D=C[:, :, nx:],
        state_names=names.states,
        input_names=names.inputs,
        output_names=names.outputs,
        wires=wires_at,
        wire_names=tuple(c for name in sizes for c in equations.wire_channels(name)),
        wire_delay=delay,
        points=equations.law.opens_at,
        integrals=equations.integrals,
        plant_states=equations.plant_states,
        stepped=equations.stepped,
        law=type(equations.law).__name__,
    )


def without_wires(equations: Equations, times: Array, A: Array) -> OpenSystem:
    """A closed A (m, nx, nx) alone, as a system without wires: sufficient for poles and stability without dead time."""
    m, nx = A.shape[:2]
    empty = np.zeros
    return OpenSystem(
        times=times, A=A, B=empty((m, nx, 0)), C=empty((m, 0, nx)), D=empty((m, 0, 0)), state_names=equations.state_names, input_names=(),
        output_names=(), wires={}, wire_names=(), wire_delay=empty(0), points=(), integrals=equations.integrals,
        plant_states=equations.plant_states, law=type(equations.law).__name__,
    )  # fmt: skip


def _finite(A: Array) -> Array:
    """A, unchanged. Raises BadArgument where it overflows."""
    if not np.isfinite(A).all():
        raise BadArgument("the operating point", "derivatives that are not finite", "positions, velocities and gains of realistic size")
    return A


def _outputs(equations: Equations, x: Dual, flow: Flow, wires: Wires) -> Array | Dual:
    parts: list[Vector] = [equations.split(x)["q"], flow.error, wires.recorded[equations.actuator]]
    return concatenate([*parts, flow.F_tip] if equations.surfaces else parts)


# --- error coordinates -------------------------------------------------------------------------------------------


def _error_coordinates(equations: Equations, times: Array, x: Dual, rates: object) -> _Change:
    assert isinstance(rates, dict)
    s = equations.split(x)
    q, torque = s["q"], equations.actuator == "torque"
    ref = equations.reference(times)
    if not isinstance(ref, ToolReference):
        if torque:
            return _Change(concatenate([ref.q - q, ref.v - s["v"]]), concatenate([ref.v - rates["q"], ref.a - rates["v"]]), 2 * equations.n)
        return _Change(ref.q - q, ref.v - rates["q"], equations.n)
    plant = equations.plant
    task = tool_task(equations.law.selection, plant, q, ref.X, ref.V, ref.dV)
    V = plant.jacobian(q, rates["q"])
    X_e_dot = task.error_rate(V)
    if not torque:
        return _Change(task.error, X_e_dot, equations.n)
    V_dot = plant.jacobian(q, rates["v"]) + plant.jacobian_dot(q, s["v"])
    V_e, V_e_dot = task.carried - task.through(V), task.feedforward(V) - task.through(V_dot)
    return _Change(concatenate([task.error, V_e]), concatenate([X_e_dot, V_e_dot]), 2 * equations.n)


def _changed(A: Array, change: _Change, nx: int) -> tuple[Array, Array]:
    """A in the new coordinates, and T = d(new states)/d(old states)."""
    k = change.replaced
    T = np.broadcast_to(np.eye(nx), A.shape).copy()
    T[:, :k] = _tangent(change.states, (len(A), k), nx)[..., :nx]
    G = A.copy()
    G[:, :k] = _tangent(change.rates, (len(A), k), nx)[..., :nx]
    return _over(G, T), T


def _over(G: Array, T: Array) -> Array:
    """G T^-1."""
    return np.asarray(np.swapaxes(np.linalg.solve(np.swapaxes(T, 1, 2), np.swapaxes(G, 1, 2)), 1, 2), float)


def _changed_open(rates: Array, outputs: Array, change: _Change, nx: int) -> tuple[Array, Array]:
    """Rows of rates and outputs over [states, inputs, wires], with the new states as columns."""
    k = change.replaced
    _, T = _changed(rates[:, :, :nx], change, nx)
    new = rates.copy()
    new[:, :k] = _tangent(change.rates, (len(rates), k), rates.shape[2])

    def over(rows: Array) -> Array:
        return np.concatenate([_over(rows[:, :, :nx], T), rows[:, :, nx:]], axis=2)

    return over(new), over(outputs)
