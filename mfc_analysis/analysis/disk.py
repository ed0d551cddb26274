r"""Disk margins: all loops at an analysis point perturbed at once.

Every channel i is multiplied by its own complex factor f_i = (1 + d_i/2) / (1 - d_i/2), abs(d_i) < alpha; alpha is the largest size for which
the loop is stable for all such f_i (skew 0, the balanced disk):

.. math:: 1/\alpha = \sup_\omega \mu\left(S(j\omega) - \tfrac12 I\right) = \sup_\omega \mu\left(\tfrac12 (S - T)\right)

It guarantees stability, in all channels simultaneously and independently, for gains between (1 - alpha/2)/(1 + alpha/2) and its inverse, or
for phases up to +-2 atan(alpha/2). At infinite frequency S = I, so that alpha is never above 2 (any gain, 90 degrees).

Sources: Seiler, Packard & Gahinet, "An introduction to disk margins", IEEE Control Systems 40 (2020) 78-95; Blight, Dailey & Gangsaas,
Int. J. Control 59 (1994) 189-221.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.frequency.peak import frequencies_of_interest
from mfc_analysis.analysis.frequency.sensitivity import Opened, opened, sensitivity, sensitivity_at_infinity
from mfc_analysis.analysis.mu import has_slycot, largest_bound, lower_bound
from mfc_analysis.analysis.spectrum import rates, spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex

EXACT = 1e-6  #: relative gap between the bounds of mu below which alpha counts as exact
CLIMB = 3  #: parabolic steps that refine the highest frequency of the grid


class Bound(Enum):
    """Which bound alpha is; the value is a sentence."""

    EXACT = "exact: the upper bound of mu is attained"
    UPPER = "a guarantee: from the upper bound of mu; the true margin may be slightly larger"
    BALANCED = "a guarantee: from the balancing bound of mu alone (slycot is not installed); the true margin may be slightly larger"
    NONE = "none: the loop is unstable"
    NOTHING = "none: every root is slow, nothing holds the loop within the horizon"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class DiskMargin:
    """Disk margins at m points: all channels perturbed at once, independently.

    NaN where a root that is not slow is unstable, or every root is slow.
    """

    times: Array  #: (m,) [s]
    at: tuple[str, ...]  #: the analysis points opened together
    channels: tuple[str, ...]  #: (k,) names
    stable: Bools  #: (m,) of the closed loop: the roots that are not slow decay, there are some, and nothing drifts; read this first
    drifts: Bools  #: (m,) the slow part keeps moving within the horizon; alpha is that of the other roots
    alpha: Array  #: (m,) guaranteed disk size, 0..2
    frequency: Array  #: (m,) [rad/s] where the disk is tightest; inf: nowhere below 2
    alpha_above: Array  #: (m,) the true disk size is at most this (a perturbation of this size that destabilises is known)
    bound: Bound  #: which bound alpha is at the worst point

    @property
    def gain_reduction(self) -> Array:
        """(m,) factor down to which all gains may fall simultaneously and independently."""
        return np.asarray((1 - self.alpha / 2) / (1 + self.alpha / 2))

    @property
    def gain_increase(self) -> Array:
        """(m,) factor up to which all gains may rise simultaneously and independently; inf for alpha = 2."""
        with np.errstate(divide="ignore"):
            return np.asarray((1 + self.alpha / 2) / np.maximum(1 - self.alpha / 2, 0.0))

    @property
    def gain_db(self) -> Array:
        """(m,) [dB] by which all gains may change simultaneously, up or down."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(self.gain_increase))

    @property
    def phase_deg(self) -> Array:
        """(m,) [deg] by which all phases may change simultaneously, lead or lag."""
        return np.asarray(np.degrees(2 * np.arctan(self.alpha / 2)))

    def worst(self) -> tuple[float, float, float]:
        """Smallest alpha, its time [s] and frequency [rad/s]; NaN where no point has one."""
        if np.isnan(self.alpha).all():
            return float("nan"), float("nan"), float("nan")
        k = int(np.nanargmin(self.alpha))
        return float(self.alpha[k]), float(self.times[k]), float(self.frequency[k])

    def __str__(self) -> str:
        alpha, time, w = self.worst()
        where = f"disk margin at {' and '.join(self.at)}, {len(self.channels)} channels at once"
        head = f"{where}; stable at {int(self.stable.sum())} of {self.times.size} times"
        if np.isnan(alpha):
            return head
        k = int(np.nanargmin(self.alpha))
        return (
            f"{head}\n  alpha {alpha:.4g} at t = {time:.4g} s, {w:.4g} rad/s: all gains by {self.gain_db[k]:.3g} dB, or all phases by "
            f"{self.phase_deg[k]:.3g} deg\n  {self.bound.value}"
        )

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class SingularValues:
    """Singular values of S and T = I - S over frequency, largest first."""

    times: Array  #: (m,) [s]
    frequencies: Array  #: (nf,) [rad/s]
    channels: tuple[str, ...]  #: (k,) names
    S: Array  #: (m, nf, k)
    T: Array  #: (m, nf, k)


def disk_margin(system: OpenSystem, at: str | Sequence[str], frequencies: ArrayLike | None = None) -> DiskMargin:
    """Disk margins at ``at``, a point or several together, e.g. ("torque", "position"): input and output at once.

    Args:
        frequencies: (nf,) [rad/s] > 0, increasing: mu is computed at these (and at infinity) only. None: from 1/horizon on, at frequencies
            placed by the poles of each point and refined around the peak.

    Dead time is exact. Raises ``UnknownPoint`` where the loop cannot be opened, ``BadArgument`` for other frequencies.
    """
    channels = opened(system, at)
    grid = None if frequencies is None else _frequencies(frequencies, system.dt)
    known = spectrum(without_idle(system))
    verdict = stability(system, known)
    m = len(system.times)
    alpha, where, above = (np.full(m, np.nan) for _ in range(3))
    placed = None if grid is not None else _placed(system, known.poles)
    for i in np.flatnonzero(verdict.nonzero_stable):
        mu, where[i], lower = _peak(channels, int(i), grid, None if placed is None else np.unique(placed[i]))
        alpha[i], above[i] = 1 / mu, 1 / lower
    tight = above - alpha <= EXACT * alpha
    judged = np.isfinite(alpha)
    if not judged.any():
        bound = Bound.NONE if verdict.held.any() else Bound.NOTHING
    elif tight[judged].all():
        bound = Bound.EXACT
    else:
        bound = Bound.UPPER if has_slycot() else Bound.BALANCED
    return DiskMargin(system.times, channels.points, channels.names, verdict.stable, verdict.drifts, alpha, where, above, bound)


def singular_values(system: OpenSystem, at: str | Sequence[str], frequencies: ArrayLike) -> SingularValues:
    """Singular values of S and T at ``at`` (a point or several together) over frequencies (nf,) [rad/s] > 0, dead time included.

    For an unstable loop they are not gains. Raises ``UnknownPoint``, ``BadArgument`` as ``disk_margin``.
    """
    channels = opened(system, at)
    grid = _frequencies(frequencies, system.dt)
    S = np.stack([sensitivity(channels, i, grid) for i in range(len(system.times))])
    T = np.eye(S.shape[-1]) - S
    sizes = [np.asarray(np.linalg.svd(X, compute_uv=False), float) for X in (S, T)]
    return SingularValues(system.times, grid, channels.names, *sizes)


def _frequencies(given: ArrayLike, dt: float) -> Array:
    out = checks.vector("frequencies", given, "positive, increasing frequencies [rad/s]")
    if out.size == 0 or out[0] <= 0 or np.any(np.diff(out) <= 0):
        raise BadArgument("frequencies", given, "positive, increasing frequencies [rad/s]")
    if dt and out[-1] > np.pi / dt * (1 + 1e-12):
        raise BadArgument("frequencies", given, f"frequencies up to half the sample rate, {np.pi / dt:.6g} rad/s")
    return out


def _placed(system: OpenSystem, poles: Complex) -> Array:
    """Frequencies (m, nf) that resolve every resonance of the closed loop, and the dead times."""
    s = rates(poles, system.dt)
    s = np.where(np.isfinite(s), s, -1.0 / system.dt if system.dt else -1.0)
    found = frequencies_of_interest(s, system.radius)
    if system.dt:
        return np.minimum(found, np.pi / system.dt)
    longest = float(system.wire_delay.max(initial=0.0))
    if longest:
        more = np.broadcast_to(np.linspace(0.05, 4.0, 80) * np.pi / longest, (len(found), 80))
        return np.sort(np.concatenate([found, more], axis=1), axis=1)
    return found


def _peak(channels: Opened, index: int, grid: Array | None, placed: Array | None) -> tuple[float, float, float]:
    """Largest upper bound of mu(S - I/2), its frequency, and a lower bound there; infinity included."""
    half = 0.5 * np.eye(channels.wires.size)

    def over(w: Array) -> tuple[float, float, float]:
        mu, k, lower = largest_bound(sensitivity(channels, index, w) - half)
        return mu, float(w[k]), lower

    w = grid if grid is not None else placed
    assert w is not None
    best = over(w)
    if grid is None:
        best = _climbed(over, best, w)
    far, _, lower = largest_bound((sensitivity_at_infinity(channels, index) - half)[None])
    if far >= best[0] * (1 - 1e-12):
        return far, np.inf if not channels.system.dt else float(np.pi / channels.system.dt), lower
    mu, where, lower = best
    if lower < mu * (1 - EXACT / 2):
        lower = max(lower, lower_bound(sensitivity(channels, index, np.array([where]))[0] - half, mu * (1 - EXACT / 2)))
    return mu, where, min(lower, mu)


def _climbed(over: Callable[[Array], tuple[float, float, float]], best: tuple[float, float, float], w: Array) -> tuple[float, float, float]:
    """From the highest of the frequencies w to the nearby peak, by parabolic interpolation."""
    k = int(np.searchsorted(w, best[1]))
    low, high = float(w[max(k - 1, 0)]), float(w[min(k + 1, w.size - 1)])
    seen = [over(np.array([(low + best[1]) / 2])), best, over(np.array([(best[1] + high) / 2]))]
    for _ in range(CLIMB):
        seen.sort(key=lambda found: -found[0])
        (y0, x0, _), (y1, x1, _), (y2, x2, _) = seen[:3]
        bend = (y1 - y0) * (x2 - x0) - (y2 - y0) * (x1 - x0)
        if bend == 0:
            break
        top = x0 + ((y1 - y0) * (x2 - x0) ** 2 - (y2 - y0) * (x1 - x0) ** 2) / (2 * bend)
        if not low < top < high or abs(top - x0) < 1e-5 * (high - low):
            break
        seen.append(over(np.array([top])))
    return max(seen, key=lambda found: found[0])
