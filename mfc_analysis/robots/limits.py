"""Joint limits of a Pinocchio model, in the user's order of joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mfc_analysis.errors import BadRobot
from mfc_analysis.maths.arrays import Array

_NONE = 1e300  # a limit above is none


@dataclass(frozen=True, eq=False)
class Limits:
    """Joint limits; ``inf`` where the model has none (a 0 velocity or torque, an empty range, a continuous joint)."""

    lower: Array  #: (n,) [rad or m]
    upper: Array  #: (n,) [rad or m]
    velocity: Array  #: (n,) [rad/s or m/s]
    torque: Array  #: (n,) [Nm or N]

    @property
    def position(self) -> Array:
        """(n, 2) lower and upper position [rad or m]."""
        return np.stack([self.lower, self.upper], axis=-1)


def limits_of(model: pin.Model, order: NDArray[np.intp]) -> Limits:
    """The limits of the joints, ``order`` (n,) being Pinocchio's velocity index of each.

    Raises ``BadRobot``, which names the joint, where a lower limit is above the upper one, or a velocity or torque is negative or not a number.
    """
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    speed = np.array(model.upperVelocityLimit)
    torque = np.array(model.upperEffortLimit)
    for name, j in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        low, high = float(model.lowerPositionLimit[j.idx_q]), float(model.upperPositionLimit[j.idx_q])
        if j.nq == 1 and not low <= high:
            raise BadRobot(f"joint {name!r}: its lower limit {low:g} is not below its upper limit {high:g}")
        if j.nq == 1 and low < high:
            lower[j.idx_v], upper[j.idx_v] = (np.copysign(np.inf, x) if abs(x) > _NONE else x for x in (low, high))
        for what, value in (("velocity", speed[j.idx_v]), ("effort", torque[j.idx_v])):
            if not value >= 0:
                raise BadRobot(f"joint {name!r}: its {what} limit {value:g} is not a number >= 0")
    found = [values[order] for values in (lower, upper, _given(speed), _given(torque))]
    for values in found:
        values.setflags(write=False)
    return Limits(*found)


def _given(values: Array) -> Array:
    return np.where((values == 0) | (values > _NONE), np.inf, values)
