"""Stability on a moving reference: Floquet multipliers on the periodic orbit."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfc_analysis.analysis.floquet import Floquet, floquet as multipliers_of, period_map, shoot
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import open_system
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.errors import BadArgument, NotConverged, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.run import Outcome, most_evaluations
from mfc_analysis.simulation.simulation import Motion, motion

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
SETTLE = 20  #: periods of the run from whose end a second search starts

__all__ = ["Floquet", "floquet"]


class NotEnoughWork(NotConverged):
    """The limit on work ended the search."""


def floquet(e: Equations, period: float | None = None, max_evaluations: int | None = None) -> Floquet:
    """Floquet multipliers on the periodic orbit of the closed loop: Newton shooting, Phi along the run of a period.

    With a sample time the period must be a whole number of samples, and Phi is the product of the discrete steps. ``max_evaluations``
    of the equations over all runs of the search; None: about 10 s of work.
    Raises BadArgument (no period), Unsupported (dead time without a sample time), NotConverged (no orbit found).
    """
    T = e.reference_source.period if period is None else checks.number("period", period, low=0.0, strict=True)
    if T is None:
        raise BadArgument("period", None, "a period [s]: the reference does not define one")
    if e.sample_time:
        return _sampled(e, float(T))
    if e.delayed:
        takes = "a sample_time with it: the period map of a continuous loop with dead time has infinite dimension"
        raise Unsupported("hardware.delay", max(e.delays.values()), takes)
    most = most_evaluations(e) if max_evaluations is None else checks.whole("max_evaluations", max_evaluations, 1, 10**12)
    runs: list[Motion] = []

    def run(x: Array, end: float) -> Motion:
        left = most - sum(earlier.evaluations for earlier in runs)
        runs.append(motion(e, [0.0, end], x, max_evaluations=max(1, left), **TIGHT))
        if runs[-1].outcome is Outcome.STOPPED:
            used = (
                f"{most} evaluations of the equations are not enough: the limit was reached in run {len(runs)} of the search over a period of {T:g} s"
            )
            raise NotEnoughWork(f"no periodic orbit found: {used}; max_evaluations= allows more")
        if runs[-1].diverged:
            raise NotConverged(f"no periodic orbit found: {runs[-1].message}")
        return runs[-1]

    def advance(x: Array) -> tuple[Array, Array]:
        once = run(x, float(T))
        return once.x[-1], period_map(Along(e, once).Phi)

    start = on_reference(e, np.zeros(1)).x[0]
    try:
        orbit = shoot(advance, start, tolerance=1e-9)
    except NotEnoughWork:
        raise
    except NotConverged:  # too far from the reference; a stable orbit draws the loop towards it
        orbit = shoot(advance, run(start, SETTLE * float(T)).x[-1], tolerance=1e-9)
    return multipliers_of(orbit.Phi, float(T), orbit=orbit)


def _sampled(e: Equations, T: float) -> Floquet:
    dt = e.sample_time
    count = round(T / dt)
    if count < 1 or abs(T - count * dt) > 1e-9 * T:
        raise Unsupported("period", T, f"a whole number of samples of {dt:g} s in a sampled loop")
    times = np.asarray(dt * np.arange(count), float)
    A = close_wires(sampled(open_system(e, times, on_reference(e, times).x), dt))[0]
    return multipliers_of(period_map(A), T)
