"""The nonlinear loop as a system of python-control, with the inputs, outputs and states of the linearised loop in state coordinates."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.analysis.system import signals
from mfc_analysis.dynamics.equations import Equations, reference_channels, reference_moves
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.dynamics.jacobians import external
from mfc_analysis.errors import MfcWarning, Unsupported
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value

if TYPE_CHECKING:
    from control import NonlinearIOSystem


def nonlinear_system(e: Equations) -> NonlinearIOSystem:
    """Implements ``ClosedLoop.nlsys``. Raises Unsupported for a loop with a sample time; warns where dead time is left out."""
    import control

    if e.sample_time:
        raise Unsupported("hardware.sample_time", e.sample_time, "a loop in continuous time; lin.system() of a sampled loop is a discrete model")
    late = e.hardware.dead_time
    if late:
        warnings.warn(f"the dead time, {late}, is left out: simulate and validate include it exactly", MfcWarning, stacklevel=3)
    names = external(e)

    def rates(t: float, x: Array, u: Array, params: Any) -> Array:
        state = np.asarray(x, float)
        flow = e.flow(t, state, None, _inputs(e, t, state, u), lose_contact=True)
        return np.asarray(value(e.join(flow.rates)), float)

    def outputs(t: float, x: Array, u: Array, params: Any) -> Array:
        state, wires = np.asarray(x, float), Wires()
        flow = e.flow(t, state, wires, _inputs(e, t, state, u), lose_contact=True)
        found = [state[e.parts["q"].where], value(flow.error), np.broadcast_to(value(wires.recorded.get(e.actuator, flow.command)), (e.n,))]
        return np.concatenate([*found, value(flow.F_tip)] if e.surfaces else found)

    name = f"{type(e.law).__name__}_on_{e.robot.name}{'_without_dead_time' if late else ''}".replace(".", "_")
    return control.nlsys(rates, outputs, inputs=signals(names.inputs), outputs=signals(names.outputs), states=signals(names.states), name=name)


def _inputs(e: Equations, t: float, x: Array, u: Array) -> Inputs:
    """Deviations u (nu,) as inputs of the equations at the state x: reference, disturbance, and F_d where the law has one."""
    given = np.asarray(u, float)
    k, n, F_d = len(reference_channels(e)), e.n, e.law.desired_wrench
    moved = given[:k] if e.law.selection is None else reference_moves(e, np.array([t]), x[None])[0] @ given[:k]
    return Inputs(moved, given[k : k + n], None if F_d is None else F_d + given[k + n :])
