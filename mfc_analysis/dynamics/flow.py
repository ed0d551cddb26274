"""What an evaluation of the loop takes and gives: cut wires and external inputs; rates and signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mfc_analysis.dynamics.environment import Contact
from mfc_analysis.maths.dual import Vector


class Wires:
    """The wires of the loop. Without inputs no wire is cut. A cut wire records its signal and passes the given input on."""

    def __init__(self, inputs: Mapping[str, Vector] | None = None) -> None:
        self.inputs = dict(inputs or {})
        self.recorded: dict[str, Vector] = {}

    def __call__(self, name: str, signal: Vector) -> Vector:
        self.recorded[name] = signal
        return self.inputs.get(name, signal)

    def cuts(self, name: str) -> bool:
        """True if this wire is cut."""
        return name in self.inputs


def uncut(name: str, signal: Vector) -> Vector:
    """A wire that is not cut and records nothing."""
    return signal


@dataclass(frozen=True, eq=False)
class Inputs:
    """External inputs of an evaluation: reference shift, disturbance at the joints, F_d. Zero unless given."""

    reference: Vector | None = None  #: (..., n) added to q_d, or a body twist (..., 6) moving X_d
    disturbance: Vector | None = None  #: (..., n) [Nm], or [rad/s] on velocity plants
    F_d: Vector | None = None  #: (..., 6) replaces the F_d of the law


NO_INPUTS = Inputs()


@dataclass(frozen=True, eq=False)
class Flow:
    """The loop at a state: its rates and signals. Plain (..., k) or dual."""

    rates: Mapping[str, Vector]  #: slot -> rate
    error: Vector  #: e (..., n) or X_e (..., 6), (..., k) of k selected directions
    command: Vector  #: commanded torque or velocity (..., n)
    F_tip: Vector  #: (..., 6)
    contact: Contact
