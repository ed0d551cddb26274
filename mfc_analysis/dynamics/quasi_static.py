"""Equation 9.20: slow motion, g + J^T F_tip = tau. The force of the loop without inertia, friction and Coriolis terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.dynamics.jacobians import closed_system, external
from mfc_analysis.dynamics.operating_point import nominal
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.maths.dual import Dual, Vector, value
from mfc_analysis.notebook import Shown

LOWEST, HIGHEST = 1e-12, 1e12  #: [rad/s] at which 9.20 is compared with 9.19


@dataclass(frozen=True, eq=False)
class QuasiStatic(Shown):
    """The quasi-static model of a force loop."""

    force: Array  #: (6,) F_tip, tool frame [N, Nm]
    error: Array  #: (6,) F_d - F_tip
    q: Array  #: (n,) joint position at rest
    equations: Equations = field(repr=False)
    x: Array | None = field(repr=False)  #: (1, nx) the equilibrium; None without an environment

    def __str__(self) -> str:
        return f"quasi-static: force {_row(self.force)}, error {_row(self.error)} [N, Nm], at q = {_row(self.q)}"

    __repr__ = __str__

    def departure(self, frequencies: ArrayLike) -> Array:
        """(nf,) deviation of 9.20 from 9.19 at w [rad/s]: largest singular value of T_dynamic - T_static, both from F_d to F_tip.

        0: the quasi-static model is exact; 1: its error is as large as the force. Needs an environment.
        """
        takes = f"frequencies from {LOWEST:g} to {HIGHEST:g} rad/s"
        w = checks.vector("frequencies", frequencies, takes)
        if np.any(w < LOWEST) or np.any(w > HIGHEST):
            raise BadArgument("frequencies", frequencies, takes)
        if not self.equations.surfaces or self.x is None:
            raise Unsupported("frequencies", frequencies, "a loop with an environment: without one the tool is held rigidly")
        A, B, C, D = (M[0] for M in closed_system(self.equations, np.zeros(1), self.x))
        names = external(self.equations)
        inputs = [names.inputs.index(f"F_d_{c}") for c in ("fx", "fy", "fz", "mx", "my", "mz")]
        outputs = [names.outputs.index(f"F_tip_{c}") for c in ("fx", "fy", "fz", "mx", "my", "mz")]
        B, C, D = B[:, inputs], C[outputs], D[np.ix_(outputs, inputs)]
        static = _massless(self.equations, A, B, C, D)
        out = np.empty(len(w))
        for i, wi in enumerate(w):
            dynamic = C @ np.linalg.solve(1j * wi * np.eye(len(A)) - A, B) + D
            out[i] = np.linalg.norm(dynamic - static(1j * wi), 2)
        return out


def _row(x: Array) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in x) + ")"


def _massless(e: Equations, A: Array, B: Array, C: Array, D: Array) -> Callable[[complex], Complex]:
    """Transfer F_d -> F_tip without M q'' in the torque balance: the rows of v' read 0 = torques."""
    v = e.parts["v"].where
    left = np.eye(len(A))
    left[v, v] = 0.0

    def at(s: complex) -> Complex:
        found = np.linalg.lstsq(s * left - A, B.astype(complex), rcond=1e-12)[0]
        return np.asarray(C @ found + D)

    return at


def quasi_static(e: Equations, rest: Array | None) -> QuasiStatic:
    """The static force of g + J^T F_tip = tau (9.20) under the law of the loop.

    With an environment: at ``rest`` (1, nx), the equilibrium of the loop, which satisfies 9.20 exactly. Without one the tool is held rigidly in
    all six directions at the reference: F_tip solves J^T F_tip = tau(F_tip) - g by least squares; with a force integral
    F_tip = F_d. Raises Unsupported for velocity laws.
    """
    if e.actuator != "torque":
        raise Unsupported("law", type(e.law).__name__, "a law with torque inputs")
    F_d = np.zeros(6) if e.law.desired_wrench is None else e.law.desired_wrench
    if rest is not None:
        force = np.array(value(e.flow(0.0, rest[0]).F_tip))
        return QuasiStatic(force, F_d - force, rest[0][: e.n], e, rest)
    asked = nominal(e, np.zeros(1))
    slots: dict[str, Array] = {name: np.zeros((1, where.stop - where.start)) for name, (where, _) in e.parts.items()}
    slots["q"] = asked.q
    if "theta" in slots:
        slots["theta"] = asked.q
    if "z_f" in slots:
        return QuasiStatic(F_d.copy(), np.zeros(6), asked.q[0], e, None)
    F = Dual(np.zeros((1, 6)), np.eye(6)[None])
    seeded: dict[str, Vector] = {**slots}
    if "F_filter" in seeded:
        seeded["F_filter"] = F
    action, _ = e.control(np.zeros(1), seeded, F, Wires(), Inputs())
    tau = action.command
    J_T = e.plant.at(asked.q).J_T[0]
    left = value(tau)[0] - value(e.plant.gravity(asked.q))[0]
    slope = tau.tangent[0] if isinstance(tau, Dual) else np.zeros((e.n, 6))
    force = np.linalg.lstsq(J_T - slope, left, rcond=1e-12)[0]
    return QuasiStatic(force, F_d - force, asked.q[0], e, None)
