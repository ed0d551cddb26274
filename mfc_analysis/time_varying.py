"""The truth on a moving reference: transition matrices along a run, Floquet multipliers on the true orbit, transient growth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.floquet import Floquet, TransientGrowth, accumulated, gauss_nodes, period_map, shoot, transition_magnus
from mfc_analysis.analysis.floquet import floquet as multipliers_of
from mfc_analysis.analysis.floquet import transient_growth as growth_of
from mfc_analysis.errors import BadArgument, NotConverged, Unsupported
from mfc_analysis.jacobians import closed_matrix
from mfc_analysis.maths import checks

if TYPE_CHECKING:
    from mfc_analysis.linearization import Linearization
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.simulation import Simulation

Array = NDArray[np.float64]

STEPS = 80  #: Magnus steps a period: 6.5e-8 of the multipliers on a UR5 loop
TIGHT = {"rtol": 1e-10, "atol": 1e-12}

__all__ = ["Floquet", "TransientGrowth", "floquet", "transient_growth", "transitions_along"]


def transitions_along(loop: ClosedLoop, run: Simulation, edges: Array) -> Array:
    """(N, nx, nx) transition matrices of the linearised loop along a run, one for each step between the N + 1 ``edges`` [s]."""
    nodes = gauss_nodes(edges)
    flat = np.ravel(nodes)
    A = closed_matrix(loop.equations, flat, run.state(flat))
    return transition_magnus(A.reshape(*nodes.shape, *A.shape[1:]), np.diff(edges))


def floquet(loop: ClosedLoop, period: float | None = None) -> Floquet:
    """Multipliers of the closed loop on its true periodic orbit: Newton shooting, Phi by fourth-order Magnus steps.

    With a sample time the period must be a whole number of samples, and Phi is the product of the discrete steps.
    Raises BadArgument (no period), Unsupported (dead time without a sample time), NotConverged (no orbit found).
    """
    T = loop.ref.period if period is None else checks.number("period", period, low=0.0, strict=True)
    if T is None:
        raise BadArgument("period", None, "a period [s]: this reference has none of its own")
    hardware = loop.equations.hardware
    if hardware.sample_time is not None:
        return _sampled(loop, float(T))
    if hardware.delay is not None or hardware.force_delay is not None:
        takes = "a sample_time beside it: the period map of a continuous loop with dead time has no finite matrix"
        raise Unsupported("hardware.delay", hardware.delay or hardware.force_delay, takes)
    edges = np.linspace(0.0, float(T), STEPS + 1)

    def advance(x: Array) -> tuple[Array, Array]:
        run = loop.simulate([0.0, float(T)], x=x, **TIGHT)  # type: ignore[arg-type]
        if run.diverged:
            raise NotConverged(f"no periodic orbit found: {run.message}")
        return run.x[-1], period_map(transitions_along(loop, run, edges))

    start = loop.linearize([0.0]).point.x[0]
    orbit = shoot(advance, start, tolerance=1e-9)
    return multipliers_of(orbit.Phi, float(T), orbit=orbit)


def _sampled(loop: ClosedLoop, T: float) -> Floquet:
    dt = float(loop.equations.hardware.sample_time)  # type: ignore[arg-type]
    count = round(T / dt)
    if count < 1 or abs(T - count * dt) > 1e-9 * T:
        raise Unsupported("period", T, f"a whole number of samples of {dt:g} s in a sampled loop")
    lin = loop.linearize(dt * np.arange(count), coordinates="state")
    return multipliers_of(period_map(lin.A), T)


def transient_growth(lin: Linearization) -> TransientGrowth:
    """Largest singular value of Phi(t, t_0) over the times of a linearisation, in its own coordinates.

    The path between the times is linearised too (two Gauss nodes a step, steps no longer than the shortest of the given ones).
    Raises BadArgument for fewer than two times.
    """
    times = lin.times
    if len(times) < 2:
        raise BadArgument("times", times, "a linearisation at two times or more: growth is along a path")
    if lin.delay or lin.force_delay:
        takes = "a sample_time beside it: transition matrices of a continuous loop with dead time are not finite"
        raise Unsupported("hardware.delay", lin.delay or lin.force_delay, takes)
    if lin.dt:
        count = max(int(np.floor((times[-1] - times[0]) / lin.dt + 1e-9)), 1)
        at = times[0] + lin.dt * np.arange(count)
        return growth_of(accumulated(lin.again(at).A), times[0] + lin.dt * np.arange(count + 1))
    count = max(STEPS, min(int(np.ceil((times[-1] - times[0]) / np.diff(times).min() - 1e-9)), 4000))
    edges = np.linspace(times[0], times[-1], count + 1)
    nodes = gauss_nodes(edges)
    A = lin.again(np.ravel(nodes)).A
    return growth_of(accumulated(transition_magnus(A.reshape(*nodes.shape, *A.shape[1:]), np.diff(edges))), edges)
