"""Operating points of a loop: on its reference with the integral trimmed, at its equilibrium, or along a simulation."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfc_analysis.dynamics.equations import Equations, solve_command_for_slots, timed
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.errors import MfcWarning, NotConverged
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, value
from mfc_analysis.trajectories.inverse_kinematics import follow

CHUNK = 500  #: operating points whose matrices are held at a time


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """Operating points of a linearisation at m times. They need not be equilibria: ``residual`` is the residual acceleration.

    The linear loop is in deviations: states x - x0, inputs u - u0, outputs y - y0, and rates x' - x0'.
    """

    times: Array  #: (m,) [s]
    x: Array  #: (m, nx) in the order of ``state_names``
    residual: Array | None  #: (m, n) q'' - a_d [rad/s^2] (q' - v_d [rad/s] on velocity plants); None: not yet computed


@dataclass(frozen=True, eq=False)
class Nominal:
    """Joint motion of the reference."""

    q: Array  #: (m, n)
    v: Array
    a: Array


def nominal(equations: Equations, times: Array) -> Nominal:
    """Reference motion of the joints (q, v, a), (m, n) each; tool references are followed from ``q_start`` (eq 9.14)."""
    if equations.reference_source.space == "joint":
        point = equations.reference_source(times)
        return Nominal(*(np.ascontiguousarray(x) for x in point))
    assert equations.q_start is not None
    law = equations.law
    found = Nominal(*follow(equations.robot, equations.reference_source, equations.q_start, times, law.inverse_damping, law.selection))
    limits = equations.robot.limits
    over = np.maximum(found.q - limits.upper, limits.lower - found.q)
    if np.any(over > 1e-9):
        i, j = np.unravel_index(int(np.argmax(over)), over.shape)
        text = f"the tool reference takes joint {equations.robot.joint_names[j]} {over[i, j]:.3g} beyond its limit at t = {times[i]:.4g} s"
        warnings.warn(text, MfcWarning, stacklevel=4)
    return found


def on_reference(equations: Equations, times: Array) -> OperatingPoint:
    """Operating points on the reference, integrals trimmed."""
    motion = nominal(equations, times)
    found = []
    for k in range(0, len(times), CHUNK):
        some = slice(k, k + CHUNK)
        found.append(trimmed(equations, times[some], Nominal(motion.q[some], motion.v[some], motion.a[some])).x)
    return OperatingPoint(times, np.concatenate(found), None)


def chunks(point: OperatingPoint) -> Iterator[OperatingPoint]:
    """The operating points, ``CHUNK`` at a time."""
    for k in range(0, len(point.times), CHUNK):
        some = slice(k, k + CHUNK)
        yield OperatingPoint(point.times[some], point.x[some], None if point.residual is None else point.residual[some])


def trimmed(equations: Equations, times: Array, nominal: Nominal) -> OperatingPoint:
    """(q, v) of the reference; integrals such that the law's torque is the plant's inverse dynamics there; force integral at 0.

    Where Ki is singular z is the least-squares solution of smallest norm. Actuators start at that torque, filters at their input.
    """
    plant, springs = equations.plant, equations.joints.springs
    q, v, a = nominal.q, nominal.v, nominal.a
    slots: dict[str, Array] = {name: np.zeros((len(times), where.stop - where.start)) for name, (where, _) in equations.parts.items()}
    slots["q"] = q
    wanted = v
    if equations.actuator == "torque":
        slots["v"] = v
        F = value(equations.touch(slots).wrench)
        wanted = value(plant.rnea(q, v, a)) + value(plant.friction(v))
        if equations.surfaces:
            wanted = wanted + value(plant.jacobian_transpose(q, F))
        encoder = v
        if springs is not None:
            slots["theta"] = q + wanted / springs.stiffness
            slots["omega"] = v
            wanted = wanted + springs.motor_inertia * a
        if "q_before" in slots:
            motor = springs is not None and springs.motor_encoder
            slots["q_before"] = (slots["theta"] if motor else q) - equations.sample_time * v
        if "v_filter" in slots:
            slots["v_filter"] = encoder
    slots |= equations.actuators.settled(wanted)
    if "F_filter" in slots:
        slots["F_filter"] = value(equations.touch(slots).wrench)
    with timed(times):
        for name, (_, slot) in equations.parts.items():
            if slot.trimmed.size:
                slots[name] = _trim(equations, times, slots, name, slot.trimmed, wanted)
    return OperatingPoint(times, value(equations.join(slots)), None)


def residual(equations: Equations, times: Array, x: Array, nominal: Nominal) -> Array:
    """(m, n) residual of the law at x: q'' - a_d, or q' - v_d on velocity plants.

    Elastic joints: the residual acceleration of joint and motor together, as if the springs were rigid.
    """
    rates = _rates(equations, times, x)
    if equations.joints.springs is not None:
        B = equations.joints.springs.motor_inertia
        both = equations.plant.at(np.ascontiguousarray(x[:, equations.parts["q"].where])).M + np.diag(B)
        lacking = B * (rates["omega"] - nominal.a)
        return np.asarray(np.linalg.solve(both, lacking[..., None])[..., 0] + rates["v"] - nominal.a)
    return rates["v"] - nominal.a if equations.actuator == "torque" else rates["q"] - nominal.v


def _rates(equations: Equations, times: Array, x: Array) -> dict[str, Array]:
    """Rates without lag and servo: the command drives the joints directly, so that the residual appears at once."""
    found = equations.flow(times, x)
    command = value(found.command)
    settled = equations.actuators.settled(command)
    if not settled:
        return {name: value(r) for name, r in found.rates.items()}
    slots = {name: value(s) for name, s in equations.split(x).items()} | settled
    return {name: value(r) for name, r in equations.move(slots, command, value(found.F_tip), 0.0).items()}


def _trim(equations: Equations, times: Array, slots: dict[str, Array], name: str, basis: Array, wanted: Array) -> Array:
    size = slots[name].shape[-1]
    tangent = np.broadcast_to(basis, (len(times), *basis.shape))
    seeded: dict[str, Any] = {**slots, name: Dual(np.zeros((len(times), size)), tangent)}
    F = value(equations.touch(slots).wrench)
    action, _ = equations.control(times, seeded, F, Wires(), Inputs())
    if not isinstance(action.command, Dual):
        return slots[name]
    return solve_command_for_slots(action.command.tangent, wanted - action.command.value) @ basis.T


def rest_point(equations: Equations, start: OperatingPoint, closed: Any) -> OperatingPoint:
    """The equilibrium near the start by Newton with line search: every rate is zero, except those of integrals that act on nothing.

    ``closed(x)`` gives the closed-loop A (1, nx, nx) at x. Raises NotConverged where none is near (an arm that pushes into free space).
    """
    t = start.times[:1]
    x = start.x[:1].copy()
    if equations.actuator == "torque":
        x[:, equations.parts["v"].where] = 0.0

    def rates(x: Array) -> Array:
        return np.asarray(equations.rates(t, x)[0], float)

    f = rates(x)
    for _ in range(60):
        A = closed(x)[0]
        keep = _acting(A, equations.integrals)
        gap = keep @ f
        scale = 1.0 + np.abs(keep @ A @ keep.T).max()
        if np.abs(gap).max(initial=0.0) <= 1e-12 * scale:
            return OperatingPoint(t, x, np.zeros((1, equations.n)))
        step = keep.T @ np.linalg.lstsq(keep @ A @ keep.T, -gap, rcond=1e-13)[0]
        size = 1.0
        while True:
            new = x + size * step
            f_new = rates(new)
            if np.linalg.norm(keep @ f_new) < np.linalg.norm(gap) * (1 - 1e-4 * size):
                x, f = new, f_new
                break
            size /= 2
            if size < 1e-6:
                if np.abs(gap).max() <= 1e-8 * scale:
                    return OperatingPoint(t, x, np.zeros((1, equations.n)))
                worst = int(np.argmax(np.abs(keep.T @ gap)))
                raise NotConverged(
                    f"equilibrium: not found near the reference; the rate of {equations.state_names[worst]} stays at {f[worst]:.3g} "
                    "(a force reference in free space, or gains too low to hold the arm?)"
                )
    raise NotConverged(f"equilibrium: not found near the reference after 60 Newton steps; largest rate {np.abs(f).max():.3g}")


def _acting(A: Array, integrals: tuple[int, ...]) -> Array:
    """(k, nx) orthonormal rows: all state directions except the integrals that act on nothing."""
    nx = A.shape[0]
    index = np.array(integrals, int)
    if index.size == 0:
        return np.eye(nx)
    _, sigma, right = np.linalg.svd(A[:, index])
    rank = int(np.sum(sigma > 1e-12 * max(1.0, float(sigma.max(initial=0.0)))))
    if rank == index.size:
        return np.eye(nx)
    rest = np.delete(np.arange(nx), index)
    out = np.zeros((rest.size + rank, nx))
    out[np.arange(rest.size), rest] = 1.0
    out[rest.size :, index] = right[:rank]
    return out
