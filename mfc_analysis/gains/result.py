"""Result of a gain design: gains that unpack into a law, with their formula and the metrics they achieve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from mfc_analysis.gains.joints import CoupledLoop

Value = float | Array


@dataclass(frozen=True, eq=False)
class Achieved:
    """Metrics of the loop with these gains, computed from its polynomials; shape () or that of ``inertia``."""

    bandwidth: Value  #: [rad/s] -3 dB of T = L/(1 + L)
    crossover: Value  #: [rad/s] |L| = 1
    settling_time: Value  #: [s] to 2 %, of a step of the reference with v_d = 0, as ``lin.step`` and ``Requirements`` take it
    loop_settling_time: Value  #: [s] to 2 %, of the step response of T
    natural_frequency: Value  #: [rad/s] of the dominant pair (of the pole of ``p``)
    damping: Value  #: damping ratio of the dominant pair (1 for ``p``)
    phase_deg: Value  #: [deg] phase margin at the crossover

    def __str__(self) -> str:
        def say(value: Value, scale: float = 1.0) -> str:
            low, high = float(np.min(value)) * scale, float(np.max(value)) * scale
            return f"{low:.4g}" if math.isclose(low, high, rel_tol=1e-6) or low == high else f"{low:.4g} .. {high:.4g}"

        hz = 1 / (2 * math.pi)
        return (
            f"bandwidth {say(self.bandwidth)} rad/s ({say(self.bandwidth, hz)} Hz), crossover {say(self.crossover)} rad/s, "
            f"phase margin {say(self.phase_deg)} deg,\n          natural frequency {say(self.natural_frequency)} rad/s, "
            f"damping {say(self.damping)},\n          2 % settling {say(self.settling_time)} s (step of the reference), "
            f"{say(self.loop_settling_time)} s (step of the loop, T)"
        )


@dataclass(frozen=True, eq=False)
class Gains(Mapping[str, Any]):  # Any: ** must fit every parameter of a law, those that are no gains as well
    """Gains that unpack into a law, with their derivation. A mapping of the gains of this design, in SI units."""

    gains: Mapping[str, Value]  #: the gains by the law's argument names
    units: Mapping[str, str]  #: unit of each gain
    formula: str  #: the gains in terms of the specification
    definition: str  #: the specification and its definition
    loop: str  #: the loop of the design
    achieved: Achieved | None  #: metrics of that loop; None where the loop is a matrix
    notes: tuple[str, ...] = field(default=())  #: remarks, a sentence each
    coupled: CoupledLoop | None = None  #: of independent joints: the loop of the arm with all joints closed

    def __getitem__(self, name: str) -> Any:
        return self.gains[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.gains)

    def __len__(self) -> int:
        return len(self.gains)

    def __hash__(self) -> int:
        return id(self)

    @property
    def kp(self) -> Value | None:
        """Proportional gain, None where this design has none."""
        return self.gains.get("kp")

    @property
    def ki(self) -> Value | None:
        """Integral gain, None where this design has none."""
        return self.gains.get("ki")

    @property
    def kd(self) -> Value | None:
        """Derivative gain, None where this design has none."""
        return self.gains.get("kd")

    @property
    def kfp(self) -> Value | None:
        """Proportional force gain [-], None where this design has none."""
        return self.gains.get("kfp")

    @property
    def kfi(self) -> Value | None:
        """Integral force gain [1/s], None where this design has none."""
        return self.gains.get("kfi")

    @property
    def kdamp(self) -> Value | None:
        """Velocity damping of the force law [N s/m], None where this design has none."""
        return self.gains.get("kdamp")

    def __str__(self) -> str:
        shown = {name: np.array2string(np.asarray(value), precision=6, separator=", ").rstrip(".") for name, value in self.gains.items()}
        lines = [f"{name} = {text} [{self.units[name]}]" for name, text in shown.items()]
        lines += [f"formula:  {self.formula}", f"asked:    {self.definition}", f"loop:     {self.loop}"]
        if self.coupled is not None:
            lines += [f"alone:    {self.achieved}", f"coupled:  {self.coupled}"]
        elif self.achieved is not None:
            lines.append(f"achieved: {self.achieved}")
        return "\n".join([*lines, *(f"note:     {note}" for note in self.notes)])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


class DampingMatrix(Gains, NDArrayOperatorsMixin):
    """A stiffness ``kp`` and its damping matrix ``kd``; in numpy it behaves as the damping matrix, (6, 6)."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.gains["kd"], dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, DampingMatrix) else x for x in inputs), **options)

    __hash__ = Gains.__hash__

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the damping matrix."""
        return np.shape(self.gains["kd"])
