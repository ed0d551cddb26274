"""Stability verdict: stable, neutral or drifting; dead time exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.delay.roots import delay_roots, delay_stable
from mfc_analysis.analysis.spectrum import Spectrum, inside, spectrum
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.maths.arrays import Array, Bools, Ints


@dataclass(frozen=True, eq=False)
class Stability:
    """Stability verdict at m points, dead time included."""

    stable: Bools  #: (m,) every root that is not neutral is stable, nothing drifts, and not all roots are neutral
    neutral: Ints  #: (m,) semisimple roots at zero (free positions)
    drifts: Bools  #: (m,) a Jordan chain at zero: a position that slides, a speed that ramps
    nonzero_stable: Bools  #: (m,) all roots that are not at zero are stable; margins and searches use this
    idle: Ints  #: (m,) integrals that act on nothing, left out of the verdict


def stability(system: OpenSystem, known: Spectrum | None = None) -> Stability:
    """Stable, neutral or drifting at each point, dead time included (see "Stable, neutral, drifting" in the guide).

    Integrals that act on nothing are dropped first. ``known``: the spectrum, if already computed.
    """
    known = spectrum(system) if known is None else known
    roots = known.roots
    others = delay_stable(system) if system.delayed else np.asarray((inside(known.poles, known.dt) | known.zero).all(axis=1))
    more = system.nx > roots.count
    stable = others & ~roots.drifts & more
    return Stability(stable, roots.neutral, roots.drifts, others, roots.dropped)


def growth(system: OpenSystem) -> Array:
    """(m,) [1/s] largest real part of the closed loop's roots that are not at zero (z = 1), dead time included."""
    system = without_idle(system)
    found = spectrum(system)
    if system.delayed:
        roots = delay_roots(system, int(found.roots.count.max(initial=0)) + 2)
        return np.asarray(np.where(roots == 0, -np.inf, roots.real).max(axis=1))
    return np.asarray(np.where(found.zero, -np.inf, found.rates.real).max(axis=1))
