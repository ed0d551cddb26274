"""Stability verdict over a horizon: the slow part apart, the other roots by Nyquist's contour indented by 1/horizon; dead time exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.delay.verdict import delayed_verdicts
from mfc_analysis.analysis.spectrum import Spectrum, spectrum
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints
from mfc_analysis.notebook import Shown


@dataclass(frozen=True, eq=False)
class Stability(Shown):
    """Stability verdict at m points over a horizon, dead time included.

    Roots with abs(s) < 1/horizon are slow. The others are judged by the sign of their real part.
    """

    stable: Bools  #: (m,) the roots that are not slow decay, there are such roots, and nothing drifts
    slow: Ints  #: (m,) slow roots with multiplicity: free positions, ramps, creep
    drifts: Bools  #: (m,) the slow part keeps moving within the horizon
    nonzero_stable: Bools  #: (m,) there are roots that are not slow, and all of them decay; margins and searches use this
    held: Bools  #: (m,) False where every root is slow: nothing holds the loop within the horizon
    idle: Ints  #: (m,) integrals that act on nothing, left out of the verdict
    slow_roots: tuple[Complex, ...]  #: (m,) arrays of the slow roots [1/s]
    motion: tuple[Array, ...]  #: (m,) (nx, nx) what the slow part keeps moving over the second half of the horizon; 0 where nothing drifts
    walks: tuple[Array, ...]  #: (m,) arrays [rad/s] of the frequencies of the count with dead time, which resolve the roots near the axis
    horizon: float  #: [s]

    def __str__(self) -> str:
        m = len(self.stable)
        drifting = f"; drifts at {int(self.drifts.sum())}" if self.drifts.any() else ""
        loose = "" if self.held.all() else f"; nothing holds the loop at {int((~self.held).sum())}"
        return (
            f"stable at {int(self.stable.sum())} of {m} points over {self.horizon:g} s; slow roots {int(self.slow.max(initial=0))}{drifting}{loose}"
        )

    __repr__ = __str__

    @property
    def neutral(self) -> Ints:
        """(m,) slow roots where nothing drifts: free positions and creep."""
        return np.where(self.drifts, 0, self.slow)


def stability(system: OpenSystem, known: Spectrum | None = None) -> Stability:
    """The verdict at each point, dead time included (see "A verdict holds over a horizon" in the guide).

    Integrals that act on nothing are dropped first. ``known``: the spectrum of the system without them, if already computed.
    Raises ``NotConverged`` where the number of unstable roots of a loop with dead time cannot be settled, or the slow part has no digits and
    nothing else settles the verdict.
    """
    whole, system = system, without_idle(system)
    known = spectrum(system) if known is None else known
    m, horizon = len(system.A), system.horizon
    if system.delayed:
        found = delayed_verdicts(system, known)
        slow, decay, held = (np.array([getattr(one, name) for one in found]) for name in ("slow", "decays", "held"))
        roots, motion, walks = (tuple(getattr(one, name) for one in found) for name in ("slow_roots", "motion", "walk"))
    else:
        slow, decay = known.slow.sum(axis=1), known.decays
        held = slow < system.nx - system.registers
        none, walks = np.zeros((system.nx, system.nx)), (np.zeros(0),) * m
        roots = tuple(each[some] for each, some in zip(known.rates, known.slow, strict=True))
        motion = tuple(none if part is None else part.slow.moves(horizon) for part in map(known.parts, range(m)))
    drifts = np.array([moved.any() for moved in motion], bool).reshape(m)
    good, idle = np.asarray(decay & held, bool), np.full(m, whole.nx - system.nx)
    return Stability(good & ~drifts, np.asarray(slow, np.int64), drifts, good, np.asarray(held, bool), idle, roots, motion, walks, horizon)


def roots(
    system: OpenSystem, count: int | None = None, known: Spectrum | None = None, verdict: Stability | None = None
) -> tuple[Complex, Bools]:  # fmt: skip
    """Roots [1/s] at each point and which of them are slow, (m, k) each: every pole (a sampled loop: ln(z) / dt), slowest first; with dead time
    the rightmost exact roots, rightmost first: ``count`` of them (default: the number of states) and as many more as there are slow ones.

    ``known``, ``verdict``: the spectrum of the system and its verdict, if already computed. Raises ``NotConverged`` as ``stability``.
    """
    if not system.delayed:
        known = spectrum(system) if known is None else known
        return known.rates, known.slow
    verdict = stability(system) if verdict is None else verdict
    found = delay_roots(system, (count or system.nx) + int(verdict.slow.max(initial=0)), verdict.slow_roots)
    return found, np.abs(found) < system.radius


def growth(system: OpenSystem) -> Array:
    """(m,) [1/s] largest real part of the closed loop's roots that are not slow, dead time included; NaN where every root is slow."""
    found, slow = roots(without_idle(system), 2)
    return np.asarray(np.where(slow.all(axis=1), np.nan, np.where(slow, -np.inf, found.real).max(axis=1)))
