"""The actuators: what becomes of a commanded torque or velocity on its way to the joints.

::

    command -- dead time --> limit --> lag --> servo (velocity laws) --> joints

The dead time stands on the wire of the equations; here are the others, their states and rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mfc_analysis.dynamics.hardware import Hardware, JointHardware, JointServo
from mfc_analysis.laws.law import Slot
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Vector, elementwise

#: states of the actuators: part of the plant
ACTUATOR_SLOTS = ("lag", "servo", "servo_rate")


@dataclass(frozen=True, eq=False)
class Actuators:
    """The actuators of n joints under a torque or a velocity law."""

    delay: float  #: [s] dead time of the command
    limit: Array | None  #: (n,) saturation of the command
    lag: Array | None  #: (n,) [s] time constant
    servo: JointServo | None

    @classmethod
    def of(cls, kind: Literal["torque", "velocity"], hardware: Hardware, joints: JointHardware) -> Actuators:
        """Those of a law with this plant input."""
        if kind == "torque":
            return cls(hardware.command_delay, joints.torque_limit, joints.torque_lag, None)
        return cls(hardware.command_delay, joints.velocity_limit, joints.velocity_lag, joints.servo)

    def slots(self, joints: tuple[str, ...]) -> tuple[Slot, ...]:
        """Their states: the output of the lag; the velocity and acceleration of the servo."""
        lag = (Slot("lag", joints, False),) if self.lag is not None else ()
        return lag if self.servo is None else (*lag, Slot("servo", joints, False), Slot("servo_rate", joints, False))

    def limited(self, command: Vector) -> Vector:
        """The command, saturated."""
        limit = self.limit
        if limit is None:
            return command
        return elementwise(command, lambda u: np.clip(u, -limit, limit), lambda u: np.where(np.abs(u) <= limit, 1.0, 0.0))

    def drive(self, s: Mapping[str, Vector], command: Vector) -> tuple[Vector, dict[str, Vector]]:
        """The torque or velocity at the joints under the command that arrives, and the rates of the states."""
        drive = self.limited(command)
        rates: dict[str, Vector] = {}
        if self.lag is not None:
            rates["lag"] = (drive - s["lag"]) * (1 / self.lag)
            drive = s["lag"]
        if self.servo is not None:
            w, z = self.servo.frequency, self.servo.damping
            rates["servo"] = s["servo_rate"]
            rates["servo_rate"] = (drive - s["servo"]) * w**2 - s["servo_rate"] * (2 * z * w)
            drive = s["servo"]
        return drive, rates

    def output(self, s: Mapping[str, Vector]) -> Vector | None:
        """The torque or velocity at the joints where a state holds it, None where it is the command itself."""
        return s.get("servo", s.get("lag"))

    def settled(self, command: Array) -> dict[str, Array]:
        """The states under a command that has long been the same."""
        at = {"lag": command, "servo": command, "servo_rate": np.zeros_like(command)}
        return {name: at[name] for name in ACTUATOR_SLOTS if (name == "lag" and self.lag is not None) or (name != "lag" and self.servo is not None)}
