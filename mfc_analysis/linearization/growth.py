"""Transient growth along a path: the linear time-varying loop between its operating points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.floquet import STEPS, TransientGrowth, accumulated, transient_growth as growth_of, transitions
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array


def transient_growth(times: Array, dt: float, along: Callable[[Array], Array]) -> TransientGrowth:
    """Largest singular value of Phi(t, t_0) over times (m,) [s]; ``along`` gives A (k, nx, nx) at other times, of a loop sampled at ``dt`` or with 0.

    The path is also linearised between the times (steps no longer than the shortest given interval).
    Raises BadArgument for fewer than two times.
    """
    if len(times) < 2:
        raise BadArgument("times", times, "a linearisation at two or more times: growth is along a path")
    if dt:
        count = max(int(np.floor((times[-1] - times[0]) / dt + 1e-9)), 1)
        samples = times[0] + dt * np.arange(count + 1)
        return growth_of(accumulated(along(samples[:-1])), samples)
    count = max(STEPS, min(int(np.ceil((times[-1] - times[0]) / np.diff(times).min() - 1e-9)), 4000))
    edges = np.linspace(times[0], times[-1], count + 1)

    def at(times: Array) -> Array:  # a path takes each time once, in order
        once, back = np.unique(times, return_inverse=True)
        return along(once)[np.ravel(back)]

    return growth_of(accumulated(transitions(at, edges, smooth=False)), edges)
