"""Start state of a simulation: initial error or joint position, integrals and hardware states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.operating_point import nominal, on_reference
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.law import ToolReference
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.trajectories.inverse_kinematics import displaced, follow
from mfc_analysis.trajectories.tool import ToolLine


def start_state(
    equations: Equations,
    t: float,
    initial_error: ArrayLike = 0.0,
    q: ArrayLike | None = None,
    v: ArrayLike | None = None,
    integral: Any = 0.0,
    force_integral: ArrayLike = 0.0,
    actuator: ArrayLike | None = None,
) -> Array:
    """(nx,) start state of a run; see ``ClosedLoop.simulate``. Raises BadArgument."""
    e, n = equations, equations.robot.n
    asked = nominal(equations, np.array([t]))
    slots: dict[str, Array] = {name: np.zeros(where.stop - where.start) for name, (where, _) in e.parts.items()}
    slots["q"] = checks.array("q", q, (n,)) if q is not None else _displaced(equations, t, asked.q[0], initial_error)
    if "v" in slots:
        slots["v"] = checks.array("v", v, (n,)) if v is not None else asked.v[0]
    elif v is not None:
        raise BadArgument("v", v, f"nothing for {type(equations.law).__name__}: under a velocity law the joint velocity is not a state")
    if "z" in slots:
        slots["z"] = _integral(equations, t, integral, slots["z"].size)
    elif not (isinstance(integral, str) and integral == "trimmed"):
        _nothing("integral", integral, f"{type(equations.law).__name__} has no integral of the error here")
    if "z_f" in slots:
        slots["z_f"] = np.array(checks.per_joint("force_integral", force_integral, 6))
    else:
        _nothing("force_integral", force_integral, f"{type(equations.law).__name__} has no integral of the force error here")
    F = value(e.touch(slots).wrench)
    springs = e.joints.springs
    if springs is not None:
        static = value(e.plant.rnea(slots["q"], slots["v"], asked.a[0])) + value(e.plant.jacobian_transpose(slots["q"], F))
        slots["theta"], slots["omega"] = slots["q"] + static / springs.stiffness, np.array(slots["v"])
    motor = springs is not None and springs.motor_encoder
    if "q_before" in slots:
        slots["q_before"] = slots["theta" if motor else "q"] - e.sample_time * slots["omega" if motor else "v"]
    if "v_filter" in slots:
        slots["v_filter"] = np.array(slots["omega" if motor else "v"])
    if "F_filter" in slots:
        slots["F_filter"] = np.array(F)
    if e.actuators.slots(e.robot.joint_names):
        if actuator is None:
            slots |= e.actuators.settled(np.array(value(e.actuators.limited(e.flow(t, value(e.join(slots))).command))))
        else:
            slots |= e.actuators.settled(checks.array("actuator", actuator, (n,)))
        if "v" not in slots and "F_filter" in slots:  # the surface feels the velocity of the drives
            slots["F_filter"] = np.array(value(e.touch(slots).wrench))
    elif actuator is not None:
        raise BadArgument("actuator", actuator, "nothing here: the actuators have neither lag nor servo (Hardware(torque_lag=), velocity_lag, servo)")
    return value(e.join(slots))


def _nothing(argument: str, given: ArrayLike, why: str) -> None:
    """Raises BadArgument unless the start value of a state that does not exist is 0."""
    if np.any(checks.array(argument, given) != 0):
        raise BadArgument(argument, given, f"0: {why}")


def _integral(equations: Equations, t: float, integral: Any, size: int) -> Array:
    if isinstance(integral, str):
        checks.choice("integral", integral, ("trimmed",))
        where = equations.parts["z"].where
        return on_reference(equations, np.array([t])).x[0, where]
    return np.array(checks.per_joint("integral", integral, size))


def _displaced(equations: Equations, t: float, q_d: Array, initial_error: ArrayLike) -> Array:
    """The joint position with this initial error: e = q_d - q, or X_e = log6(X^-1 X_d) for tool laws."""
    n = equations.robot.n
    error = checks.array("initial_error", initial_error)
    tool = equations.law.space == "tool"
    if not np.any(error):
        return q_d
    selection = equations.law.selection
    if tool and error.ndim == 0:
        error = np.full(6 if selection is None else len(selection.rows), float(error))
    if selection is not None and error.shape == (len(selection.rows),):
        ref = equations.reference(t)
        assert isinstance(ref, ToolReference)
        return displaced(equations.robot, ref.X.matrix, error, q_d, selection)
    whole = tool and selection is None
    if whole and error.shape == (6,) and not (np.abs(error).max() < 1e6 and np.linalg.norm(error[3:]) < np.pi - 1e-3):
        raise BadArgument("initial_error", initial_error, "X_e with a rotation of less than pi - 1e-3 rad")
    if whole and error.shape == (6,):
        ref = equations.reference(t)
        assert isinstance(ref, ToolReference)
        X_d = ref.X.matrix
        line = ToolLine(X_d, X_d @ exp6(-error), 1.0)
        return np.array(follow(equations.robot, line, q_d, np.array([1.0]))[0][0])
    if error.ndim == 1 and error.shape != (n,):
        size = len(equations.law.error_channels(equations.robot.joint_names))
        raise BadArgument("initial_error", f"shape {error.shape}", f"a scalar or shape ({n},)" + (f" or X_e of shape ({size},)" if tool else ""))
    if error.ndim > 1:
        raise BadArgument("initial_error", f"shape {error.shape}", f"a scalar or shape ({n},)")
    return np.asarray(q_d - error)
