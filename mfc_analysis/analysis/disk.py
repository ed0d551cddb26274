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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.frequency.sensitivity import Opened, opened, sensitivity, sensitivity_at_infinity
from mfc_analysis.analysis.mu import largest_bound, lower_bound
from mfc_analysis.analysis.mu_peak import Peak, mu_peaks
from mfc_analysis.analysis.spectrum import spectrum
from mfc_analysis.analysis.stability import stability
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

EXACT = 1e-6  #: relative gap between the bounds of mu below which alpha counts as exact
CHUNK = 200_000  #: complex numbers of the resolvents at a time


class Bound(Enum):
    """Which bound alpha is; the value is a sentence."""

    EXACT = "exact: the upper bound of mu is attained"
    UPPER = "a guarantee: from the upper bound of mu; the true margin may be slightly larger"
    GRID = "on a grid: the smallest of the frequencies computed; between them it may be smaller"
    NONE = "none: the loop is unstable"
    NOTHING = "none: every root is slow, nothing holds the loop within the horizon"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class DiskMargin(Shown):
    """Disk margins at m points: all channels perturbed at once, independently.

    NaN where a root that is not slow is unstable, or every root is slow.
    """

    times: Array  #: (m,) [s]
    at: tuple[str, ...]  #: the analysis points opened together
    channels: tuple[str, ...]  #: (k,) names
    stable: Bools  #: (m,) the roots that are not slow decay, and there are some; read this and ``drifts`` first
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

    def plot(self, index: int | None = None, *, ax: Axes | None = None) -> Axes:
        """The disk of factors f that all loops at once may have, at one point, or the tightest: f = 1 is the loop as it is.

        ``ax``: to draw in; None: a new figure of pyplot. Raises BadArgument for an index beyond the m points.
        """
        from mfc_analysis import plots

        m = len(self.times)
        k = int(np.argmin(np.nan_to_num(self.alpha, nan=np.inf))) if index is None else checks.whole("index", index, -m, m - 1) % m
        gain, title = (float(self.gain_reduction[k]), float(self.gain_increase[k])), f"All loops at {' and '.join(self.at)}, t = {self.times[k]:g} s"
        return plots.disk(gain, float(self.phase_deg[k]), alpha=float(self.alpha[k]), title=title, ax=plots.shown("disc", ax)[0])

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

    def plot(self, index: int = 0, *, ax: Axes | None = None) -> Axes:
        """The largest singular values of S and T at one point over frequency. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        lines = [(name, values[index, :, 0]) for name, values in (("S", self.S), ("T", self.T))]
        axes = plots.shown("map", ax)[0]
        return plots.curves(self.frequencies, lines, xlabel="ω [rad/s]", ylabel="largest singular value [-]", log="xy", limit=1.0, ax=axes)


def disk_margin(system: OpenSystem, at: str | Sequence[str], frequencies: ArrayLike | None = None) -> DiskMargin:
    """Disk margins at ``at``, a point or several together, e.g. ("torque", "position"): input and output at once.

    Args:
        frequencies: (nf,) [rad/s] > 0, increasing: mu is computed at these (and at infinity) only, and ``bound`` is ``GRID``. None: at all
            frequencies from 1/horizon on. The peak of mu is then certain to 1e-6 (``mu_peaks``); if it is not, ``bound`` says ``GRID``.

    Dead time is exact. Raises ``UnknownPoint`` where the loop cannot be opened, ``BadArgument`` for other frequencies.
    """
    channels = opened(system, at)
    grid = None if frequencies is None else _frequencies(frequencies, system.dt)
    lean = without_idle(system)
    known = spectrum(lean)
    verdict = stability(system, known)
    m = len(system.times)
    alpha, where, above = (np.full(m, np.nan) for _ in range(3))
    certain = np.ones(m, bool)
    kept = replace(channels, system=lean)
    some, rates = [int(i) for i in np.flatnonzero(verdict.nonzero_stable)], known.rates
    peaks = mu_peaks(kept, [(i, rates[i]) for i in some]) if grid is None else [_on_grid(kept, i, grid) for i in some]
    for i, peak in zip(some, peaks, strict=True):
        alpha[i], where[i], above[i], certain[i] = 1 / peak.value, peak.frequency, 1 / peak.lower, peak.certain
    tight = above - alpha <= EXACT * alpha
    judged = np.isfinite(alpha)
    if not judged.any():
        bound = Bound.NONE if verdict.held.any() else Bound.NOTHING
    elif not certain.all():
        bound = Bound.GRID
    else:
        bound = Bound.EXACT if tight[judged].all() else Bound.UPPER
    return DiskMargin(system.times, channels.points, channels.names, verdict.nonzero_stable, verdict.drifts, alpha, where, above, bound)


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


def _on_grid(channels: Opened, index: int, grid: Array) -> Peak:
    """Largest upper bound of mu(S - I/2) on the grid and at infinity."""
    system, half = channels.system, 0.5 * np.eye(channels.wires.size)
    step = max(1, CHUNK // (system.nx + system.nw) ** 2)
    found = [(*largest_bound(sensitivity(channels, index, w) - half), w) for w in (grid[k : k + step] for k in range(0, grid.size, step))]
    mu, k, lower, w = max(found, key=lambda one: one[0])
    far = sensitivity_at_infinity(channels, index) - half
    size, _, attained = largest_bound(far[None])
    if size >= mu * (1 - 1e-12):
        return Peak(size, np.inf if not system.dt else float(np.pi / system.dt), attained, certain=False)
    if lower < mu * (1 - EXACT / 2):
        lower = max(lower, lower_bound(sensitivity(channels, index, w[k : k + 1])[0] - half, mu * (1 - EXACT / 2)))
    return Peak(mu, float(w[k]), min(lower, mu), certain=False)
