"""The linear loop with dead time, advanced by the method of steps: what a validation compares a delayed run with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.system import close_wires
from mfc_analysis.jacobians import open_system
from mfc_analysis.sampled_run import NODES, History

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.simulation import Simulation

Array = NDArray[np.float64]


def delayed_prediction(loop: ClosedLoop, base: Simulation, t: Array, direction: Array) -> Array:
    """(N, nx) x' = A(t) x + B w(t - T), w = C x + D w(t - T) along the base run, from ``direction``; before the start w is constant.

    Runge-Kutta of fourth order on segments no longer than the shortest dead time, A(t) a cubic through four points of each.
    """
    e = loop.equations
    delays = [float(d) for d in (e.hardware.delay, e.hardware.force_delay) if d is not None]  # type: ignore[arg-type]
    whole = max(int(np.ceil((t[-1] - t[0]) / min(delays) - 1e-9)), 1)
    edges = np.linspace(t[0], t[-1], whole + 1)
    at_thirds = np.linspace(t[0], t[-1], 3 * whole + 1)
    sent = None if base.arrived is None else {e.actuator: np.stack([base.arrived(float(ti)) for ti in at_thirds])}
    system = open_system(e, at_thirds, base.state(at_thirds), arriving=sent)
    late = system.wire_delay > 0
    nu, ny, T = system.nu, system.ny, system.wire_delay[late]
    A, B, C, D = close_wires(system, late)
    along = [_Cubic(M, edges) for M in (A, B[:, :, nu:], C[:, ny:], D[:, ny:, nu:])]
    At, Bt, Ct, Dt = along
    out = np.empty((len(t), e.nx))
    x = direction.copy()
    past = History(float(t[0]), np.linalg.solve(np.eye(late.sum()) - D[0, ny:, nu:], C[0, ny:] @ x))
    substeps = 8
    for k in range(whole):
        start, h = float(edges[k]), float(edges[k + 1] - edges[k]) / substeps
        states = [x]

        def arriving(at: float) -> Array:
            return np.array([past.at(at - Ti)[i] for i, Ti in enumerate(T)])

        for j in range(substeps):
            at = start + j * h
            w0, w1, w2 = arriving(at), arriving(at + h / 2), arriving(at + h)
            A0, A1, A2 = (At.at(k, ti) for ti in (at, at + h / 2, at + h))
            B0, B1, B2 = (Bt.at(k, ti) for ti in (at, at + h / 2, at + h))
            k1 = A0 @ x + B0 @ w0
            k2 = A1 @ (x + h / 2 * k1) + B1 @ w1
            k3 = A1 @ (x + h / 2 * k2) + B1 @ w1
            k4 = A2 @ (x + h * k3) + B2 @ w2
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            states.append(x)
        here = np.array(states)
        ticks = start + h * np.arange(substeps + 1)
        inside = (t >= start - 1e-12) & (t <= edges[k + 1] + 1e-12)
        out[inside] = _between(ticks, here, t[inside])
        nodes = start + NODES * (edges[k + 1] - start)
        pairs = zip(nodes, _between(ticks, here, nodes), strict=True)
        signals = np.stack([Ct.at(k, float(ti)) @ xi + Dt.at(k, float(ti)) @ arriving(float(ti)) for ti, xi in pairs])
        past.add(start, float(edges[k + 1] - start), signals)
    return out


class _Cubic:
    """Matrices along the path: in each segment the cubic through its ends and thirds."""

    def __init__(self, M: Array, edges: Array) -> None:
        self.M, self.edges = M, edges

    def at(self, k: int, t: float) -> Array:
        s = 3 * (t - self.edges[k]) / (self.edges[k + 1] - self.edges[k])
        w = [-(s - 1) * (s - 2) * (s - 3) / 6, s * (s - 2) * (s - 3) / 2, -s * (s - 1) * (s - 3) / 2, s * (s - 1) * (s - 2) / 6]
        return np.asarray(np.tensordot(w, self.M[3 * k : 3 * k + 4], axes=1))


def _between(ticks: Array, states: Array, t: Array) -> Array:
    from scipy.interpolate import make_interp_spline

    return np.asarray(make_interp_spline(ticks, states, k=5)(t))
