"""The linear loop with every wire cut, at m operating points: the model that ``analysis`` works on. It holds no robot.

A *wire* is a signal of the loop that can be cut: the commanded torques, the acceleration command, the encoder, the force
sensor. A cut wire is an output (the signal before the cut) and an input (the signal after it); closing the wire sets the
input equal to the output, delayed by ``wire_delay`` where there is dead time.

::

    x' = A x + B [u; w_in]         u: external inputs        w_in:  after the cut
    [y; w_out] = C x + D [u; w_in]  y: external outputs       w_out: before the cut

With ``dt > 0`` the model is discrete (x' is the next x) and includes the dead time (``wire_delay`` is zero).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Ints

HORIZON = 100.0  #: [s] default horizon of a verdict


@dataclass(frozen=True, eq=False)
class OpenSystem:
    """A loop with all its wires cut. ``m`` points, ``nx`` states, ``nu`` inputs, ``ny`` outputs, ``nw`` wires."""

    times: Array  #: (m,) [s]
    A: Array  #: (m, nx, nx)
    B: Array  #: (m, nx, nu + nw)
    C: Array  #: (m, ny + nw, nx)
    D: Array  #: (m, ny + nw, nu + nw)
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]  #: nu external inputs
    output_names: tuple[str, ...]  #: ny external outputs
    wires: Mapping[str, slice]  #: point name -> its wires among the nw, e.g. {"torque": slice(0, 6), "position": slice(6, 12), "rate": slice(12, 18)}
    wire_names: tuple[str, ...]  #: nw names of the channels (joint names, or fx..mz)
    wire_delay: Array  #: (nw,) [s] dead time on each wire; (m, nw) of a loop over its dead time, for ``stability`` and ``roots`` alone
    points: tuple[str, ...]  #: analysis points a user may open ("rate" is the v that goes with "position" and is never opened alone)
    integrals: tuple[int, ...] = ()  #: states that are integrals of a controller (dropped where they act on nothing)
    plant_states: tuple[int, ...] = ()  #: states of the plant (the others belong to the controller)
    stepped: tuple[int, ...] = ()  #: states of the controller that are sampled code: x + T x' at the next sample
    law: str = "the loop"  #: for messages
    dt: float = 0.0  #: [s] sample time, 0: continuous
    registers: int = 0  #: of a sampled loop: states that hold the samples in transit
    horizon: float = HORIZON  #: [s] of the verdict: roots with |s| < 1/horizon are slow; inf: none is
    held: OpenSystem | None = None  #: of a sampled loop: the continuous one, whose plant moves between the samples

    @property
    def nx(self) -> int:
        """Number of states."""
        return int(self.A.shape[-1])

    @property
    def nu(self) -> int:
        """Number of external inputs."""
        return len(self.input_names)

    @property
    def ny(self) -> int:
        """Number of external outputs."""
        return len(self.output_names)

    @property
    def nw(self) -> int:
        """Number of wires."""
        return len(self.wire_names)

    @property
    def delayed(self) -> bool:
        """True where the matrices leave out dead time. Without a sample time the loop then has infinitely many roots."""
        return bool(self.wire_delay.any())

    @property
    def radius(self) -> float:
        """[1/s] of the disc of slow roots: 1/horizon."""
        return 1.0 / self.horizon

    def at(self, index: slice | Ints | Bools) -> OpenSystem:
        """The same system at some of its points."""
        held = None if self.held is None else self.held.at(index)
        return replace(self, times=self.times[index], A=self.A[index], B=self.B[index], C=self.C[index], D=self.D[index], held=held)


def signals(names: Iterable[str]) -> list[str]:
    """Names as python-control takes them: it allows no full stop."""
    return [name.replace(".", "_") for name in names]


def checked_horizon(horizon: float, sample_time: float = 0.0) -> float:
    """The horizon [s] of a verdict; inf: every root is judged by its sign. Raises ``BadArgument`` below 1e-6 s or two sample times."""
    if isinstance(horizon, (float, np.floating)) and np.isposinf(horizon):
        return float("inf")
    return checks.number("horizon", horizon, low=max(1e-6, 2 * sample_time))


def close_wires(system: OpenSystem, keep: Bools | None = None) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D with the wires closed (dead time left out), except those in the mask ``keep`` (nw,), which stay cut.

    The kept wires remain the last columns of B and D and the last rows of C and D, in their order.
    """
    nu, ny, nw = system.nu, system.ny, system.nw
    kept = np.zeros(nw, bool) if keep is None else np.asarray(keep, bool)
    shut_in, shut_out = nu + np.flatnonzero(~kept), ny + np.flatnonzero(~kept)
    stay_in = np.concatenate([np.arange(nu), nu + np.flatnonzero(kept)])
    stay_out = np.concatenate([np.arange(ny), ny + np.flatnonzero(kept)])
    B2, C2 = system.B[:, :, shut_in], system.C[:, shut_out, :]
    D22 = system.D[:, shut_out[:, None], shut_in]
    D12, D21 = system.D[:, stay_out[:, None], shut_in], system.D[:, shut_out[:, None], stay_in]
    # w = C2 x + D21 u + D22 w
    right = np.concatenate([C2, D21], axis=2)
    w = np.linalg.solve(np.eye(shut_in.size) - D22, right) if D22.any() else right
    wx, wu = w[:, :, : system.nx], w[:, :, system.nx :]
    A = system.A + B2 @ wx
    B = system.B[:, :, stay_in] + B2 @ wu
    C = system.C[:, stay_out, :] + D12 @ wx
    D = system.D[:, stay_out[:, None], stay_in] + D12 @ wu
    return A, B, C, D


def without_idle(system: OpenSystem) -> OpenSystem:
    """The system without the controller integrals that act on nothing at any of its points: the same loops with fewer states."""
    used = np.ones(system.nx, bool)
    own = np.eye(system.nx) if system.dt else np.zeros((system.nx, system.nx))
    for i in system.integrals:
        used[i] = (system.A[:, :, i] != own[i]).any() or system.C[:, system.ny :, i].any()
    if used.all():
        return system
    new = np.cumsum(used) - 1

    def kept(states: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(int(new[i]) for i in states if used[i])

    return replace(
        system, A=system.A[:, used][:, :, used], B=system.B[:, used], C=system.C[:, :, used],
        state_names=tuple(n for n, keep in zip(system.state_names, used, strict=True) if keep),
        integrals=kept(system.integrals), plant_states=kept(system.plant_states), stepped=kept(system.stepped),
    )  # fmt: skip
