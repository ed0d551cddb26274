"""The same gains on the diagonal of M: the model of an independent-joint design, to compare with the loop on the full M."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import open_system
from mfc_analysis.dynamics.operating_point import OperatingPoint
from mfc_analysis.errors import Unsupported
from mfc_analysis.maths.arrays import Array, Bools, Complex
from mfc_analysis.maths.dual import Dual
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.analysis.margins import Margins


@dataclass(frozen=True, eq=False)
class Decentralised(Shown):
    """n separate loops at m times, k states each: M_jj q'' + b_j q' + (dg/dq)_jj q = tau under the diagonal of the law."""

    times: Array  #: (m,) [s]
    joints: tuple[str, ...]  #: (n,) names
    A: Array  #: (m, n, k, k)
    b: Array  #: (m, n, k) column of the joint's torque (velocity) command
    c: Array  #: (m, n, k) row of the command: command = c x
    integrals: tuple[int, ...] = ()  #: which of the k states are integrals of the law
    delay: float = 0.0  #: [s] dead time of the loop, left out here

    def poles(self) -> Complex:
        """(m, n, k) closed-loop poles [1/s] of each joint alone, slowest first; dead time left out."""
        found: Complex = np.linalg.eigvals(self.A).astype(np.complex128)
        return np.take_along_axis(found, np.argsort(-found.real, axis=-1, kind="stable"), axis=-1)

    def __str__(self) -> str:
        slowest = self.poles().real.max(axis=-1)
        k = int(np.argmax(slowest.max(axis=0)))
        return (
            f"{len(self.joints)} separate loops at {len(self.times)} times: slowest pole{' without the dead time' if self.delay else ''} "
            f"{slowest.max():.4g} 1/s ({self.joints[k]})"
        )

    __repr__ = __str__

    @property
    def stable(self) -> Bools:
        """(m, n) True where every root of a joint alone is stable, without integrals that act on nothing and without the dead time."""
        from mfc_analysis.analysis.stability import stability

        return np.asarray(stability(self._alone()).stable.reshape(self.b.shape[:2]))

    def _alone(self) -> OpenSystem:
        """The loops of the joints as m n systems with one wire each."""
        m, n, k = self.b.shape
        b, c = self.b.reshape(m * n, k, 1), self.c.reshape(m * n, 1, k)
        return OpenSystem(
            times=np.arange(m * n, dtype=float),
            A=self.A.reshape(m * n, k, k) - b @ c,
            B=b,
            C=c,
            D=np.zeros((m * n, 1, 1)),
            state_names=tuple(map(str, range(k))),
            input_names=(),
            output_names=(),
            wires={"torque": slice(0, 1)},
            wire_names=("joint",),
            wire_delay=np.zeros(1),
            points=("torque",),
            integrals=self.integrals,
        )

    def margins(self) -> Margins:
        """Margins (m, n) of each joint loop at its torque (velocity) command; dead time left out. NaN where that joint alone is unstable."""
        from mfc_analysis.analysis.margins import margins

        m, n, _ = self.b.shape
        found = margins(self._alone(), "torque")
        per_joint = {f.name: getattr(found, f.name).reshape(m, n) for f in fields(found) if f.name not in ("times", "at", "channels")}
        whole = {name: per_joint.pop(name) for name in ("stable", "drifts")}
        return replace(
            found, times=self.times, channels=self.joints, stable=whole["stable"].all(axis=1), drifts=whole["drifts"].any(axis=1), **per_joint
        )


def decentralised(equations: Equations, point: OperatingPoint) -> Decentralised:
    """The loop joint by joint. Raises Unsupported for tool and force laws, sampled loops, and an n x n outer loop."""
    law, n = equations.law, equations.n
    if law.space == "tool" or not law.follows_motion or equations.sample_time or law.needs_acceleration:
        raise Unsupported("decentralised", type(law).__name__, "a joint-space law in continuous time, with one loop per joint")
    system = open_system(equations, point.times, point.x)
    m = len(point.times)
    picks: list[Array] = []
    integrals: list[int] = []
    for where, slot in equations.parts.values():
        size = where.stop - where.start
        if size % n or not law.joint_by_joint:
            raise Unsupported("decentralised", type(law).__name__, "an outer loop that is the same for each joint")
        if slot.integral:
            integrals += range(sum(p.shape[1] for p in picks), sum(p.shape[1] for p in picks) + size // n)
        picks.append(where.start + np.arange(size).reshape(n, -1))
    index = np.concatenate(picks, axis=1)  # (n, k) the states of each joint
    wire = system.wires[equations.actuator]
    torque = equations.actuator == "torque"
    keep = np.zeros(system.nw, bool)
    keep[wire] = True
    A_law, B_law, C_law, _ = close_wires(system, keep)
    b = np.stack([B_law[:, i, system.nu + j] for j, i in enumerate(index)], axis=1)
    c = np.stack([C_law[:, system.ny + j, :][:, i] for j, i in enumerate(index)], axis=1)
    A = np.stack([A_law[:, i[:, None], i] for i in index], axis=1)
    if torque:
        q, v = (equations.parts[name].where for name in ("q", "v"))
        x = point.x
        plant = equations.plant
        M = np.diagonal(plant.at(np.ascontiguousarray(x[:, q])).M, axis1=1, axis2=2)
        g = plant.gravity(Dual(np.ascontiguousarray(x[:, q]), np.broadcast_to(np.eye(n), (m, n, n))))
        friction = plant.friction(Dual(x[:, v], np.broadcast_to(np.eye(n), (m, n, n))))
        assert isinstance(g, Dual) and isinstance(friction, Dual)
        stiffness, viscous = np.diagonal(g.tangent, axis1=1, axis2=2), np.diagonal(friction.tangent, axis1=1, axis2=2)
        A[:, :, 1, :] = 0.0
        A[:, :, 1, 0], A[:, :, 1, 1] = -stiffness / M, -viscous / M
        springs = equations.joints.springs
        if springs is not None:
            K, D = springs.stiffness, springs.damping
            for column, gain in ((0, -K), (1, -D), (2, K), (3, D)):
                A[:, :, 1, column] += gain / M
        elif equations.actuators.lag is not None:
            A[:, :, 1, -1] += 1 / M
        else:
            b[:, :, 1] = 1 / M
    return Decentralised(
        point.times,
        equations.robot.joint_names,
        A + b[..., :, None] * c[..., None, :],
        b,
        c,
        tuple(integrals),
        equations.actuators.delay,
    )
