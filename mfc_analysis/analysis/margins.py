"""Margins of one loop at a time, the others closed: gain interval, phase, delay, sensitivity peak.

Definitions. The closed loop stays stable while loop i is multiplied by a gain in (reduction, increase), the largest such
interval around 1; while its phase changes by less than ``phase_deg``, lead or lag, at any of its crossovers; while it is delayed
by less than ``delay``; of a sampled loop the fraction of a sample acts inside the hold (``sampled_delay``). The sensitivity peak
is the supremum of |1/(1 + L_i)| over all frequencies, zero and infinity included.

There is no frequency grid: every crossing comes from an eigenvalue problem (``crossings``) and is polished. The contour is Nyquist's,
indented at the origin by 1/horizon: no frequency below counts, and a gain interval also ends where a slow root leaves the disc
abs(s) < 1/horizon to the right (``arc``).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.channels import Channels, channels, continuous
from mfc_analysis.analysis.delay.margins import delayed_metrics
from mfc_analysis.analysis.frequency.arc import angles, arc_crossings, arc_delays, places
from mfc_analysis.analysis.frequency.crossings import crossings
from mfc_analysis.analysis.frequency.grid import on_grid
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, sensitivity_peak, thinned
from mfc_analysis.analysis.frequency.resolvent import resolvent
from mfc_analysis.analysis.margin_metrics import MarginMetrics, also_late, assembled, frequency, put
from mfc_analysis.analysis.sampled_delay import sampled_delays
from mfc_analysis.analysis.spectrum import rates, spectrum
from mfc_analysis.analysis.stability import Stability, stability
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes


@dataclass(frozen=True)
class Worst(Shown):
    """The smallest margins over all times and channels, each with its time [s] and channel."""

    gain_increase: tuple[float, float, str]  #: factor
    gain_reduction: tuple[float, float, str]  #: factor, the largest gain reduction
    phase_deg: tuple[float, float, str]  #: [deg]
    delay: tuple[float, float, str]  #: [s]
    sensitivity_peak: tuple[float, float, str]  #: the largest
    unstable: tuple[float, ...]  #: [s] times at which the closed loop is not ``stable``: no metrics there

    def __str__(self) -> str:
        if self.unstable and np.isnan(self.phase_deg[0]):
            return f"unstable at t = {self.unstable[0]:.4g} s"
        parts = (
            f"phase {_angle(self.phase_deg[0])} ({self.phase_deg[2]}, t = {self.phase_deg[1]:.4g} s)",
            f"gain up {_decibels(self.gain_increase[0])} ({self.gain_increase[2]}, t = {self.gain_increase[1]:.4g} s)",
            f"gain down {_decibels(_inverse(self.gain_reduction[0]))} ({self.gain_reduction[2]}, t = {self.gain_reduction[1]:.4g} s)",
            f"delay {_milliseconds(self.delay[0])} ({self.delay[2]}, t = {self.delay[1]:.4g} s)",
            f"Ms {self.sensitivity_peak[0]:.3g} ({self.sensitivity_peak[2]}, t = {self.sensitivity_peak[1]:.4g} s)",
        )
        times = "1 time" if len(self.unstable) == 1 else f"{len(self.unstable)} times"
        before = f"not stable at {times}, first t = {self.unstable[0]:.4g} s; where defined: " if self.unstable else ""
        return before + ", ".join(parts)

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class Margins:
    """One-loop-at-a-time margins, the other loops closed, dead time included. ``m`` times, ``n`` channels.

    A margin without a crossing is ``inf``. Where a root that is not slow is unstable, or every root is slow, all metrics are NaN; a channel
    of "force" that is not sensed is also NaN. Gains above 1e9 count as infinite, below 1e-9 as zero.
    """

    times: Array  #: (m,) [s]
    at: str  #: the analysis point
    channels: tuple[str, ...]  #: (n,) names
    stable: Bools  #: (m,) the roots that are not slow decay, and there are some; read this and ``drifts`` first
    drifts: Bools  #: (m,) the slow part keeps moving within the horizon; the metrics are those of the other roots
    gain_reduction: Array  #: (m, n) factor; stable for gains in (reduction, increase); 0: for all lower gains
    gain_increase: Array  #: (m, n) factor; inf where no increase destabilises
    reduction_frequency: Array  #: (m, n) [rad/s] of the root that crosses at the reduction; inf where there is none
    increase_frequency: Array  #: (m, n) [rad/s] of the root that crosses at the increase; inf where there is none
    phase_deg: Array  #: (m, n) smallest over all crossovers, lead or lag
    crossover: Array  #: (m, n) [rad/s] the gain crossover with the phase margin; inf where |L| is never one
    delay: Array  #: (m, n) [s] smallest over all crossovers; of a sampled loop that of the loop resampled with it
    delay_frequency: Array  #: (m, n) [rad/s] of the roots that reach the contour with the delay margin; 0: a real root
    sensitivity_peak: Array  #: (m, n) supremum of |1/(1 + L)|, at least 1
    peak_frequency: Array  #: (m, n) [rad/s] of the sensitivity peak, from 1/horizon to inf

    @property
    def gain_increase_db(self) -> Array:
        """(m, n) [dB] 20 log10 of the gain increase."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(self.gain_increase))

    @property
    def gain_reduction_db(self) -> Array:
        """(m, n) [dB] -20 log10 of the gain reduction: positive; inf where no reduction destabilises."""
        with np.errstate(divide="ignore"):
            return np.asarray(-20 * np.log10(self.gain_reduction))

    def channel(self, number: int) -> Margins:
        """The margins of one channel only, by its ``number``: (m, 1) metrics."""
        metrics = {f.name: getattr(self, f.name)[:, number, None] for f in fields(MarginMetrics)}
        return replace(self, channels=(self.channels[number],), **metrics)

    def worst(self) -> Worst:
        """The smallest margins (largest reduction and peak) with their times and channels; points that are not stable are listed separately."""

        def pick(values: Array, largest: bool) -> tuple[float, float, str]:
            some = np.flatnonzero(~np.isnan(values))
            if not some.size:
                return float("nan"), float("nan"), "-"
            found = values.ravel()[some]
            i, k = np.unravel_index(some[found.argmax() if largest else found.argmin()], values.shape)
            return float(values[i, k]), float(self.times[i]), self.channels[k]

        return Worst(
            gain_increase=pick(self.gain_increase, False),
            gain_reduction=pick(self.gain_reduction, True),
            phase_deg=pick(self.phase_deg, False),
            delay=pick(self.delay, False),
            sensitivity_peak=pick(self.sensitivity_peak, True),
            unstable=tuple(float(t) for t in self.times[~self.stable]),
        )

    def plot(self, metric: str = "phase_deg", *, asked: float | None = None, ax: Axes | None = None) -> Axes:
        """One metric against time, a line for each channel; at a single time a mark for each channel.

        Args:
            metric: "phase_deg", "gain_increase_db", "gain_reduction_db", "delay" (drawn in ms) or "sensitivity_peak".
            asked: a required value in the unit of the metric (a delay in s), drawn dashed. ax: to draw in; None: a new figure of pyplot.

        Raises UnknownName for another metric.
        """
        from mfc_analysis import plots

        plots.metric_values(self, metric)  # raises before there is a figure
        return plots.margins(self, metric=metric, asked=asked, title=f"Margins at {self.at}", ax=plots.shown("time history", ax)[0])

    def __str__(self) -> str:
        m = len(self.times)
        drift = f", drifting at {int(self.drifts.sum())}" if self.drifts.any() else ""
        worst = self.worst()
        times = "1 time" if m == 1 else f"{m} times"
        lines = [f"margins at {self.at!r}: {', '.join(self.channels)}; {times}, stable at {int(self.stable.sum())}{drift}"]
        if not np.isnan(worst.phase_deg[0]):
            low, high = worst.gain_reduction, worst.gain_increase
            lines += [
                f"  gain   down to {low[0]:.4g} ({low[2]}, t = {low[1]:.4g} s), up to {_factor(high[0])} ({high[2]}, t = {high[1]:.4g} s)",
                f"  phase  {_angle(worst.phase_deg[0])} ({worst.phase_deg[2]}, t = {worst.phase_deg[1]:.4g} s); "
                f"delay {_milliseconds(worst.delay[0])} ({worst.delay[2]}, t = {worst.delay[1]:.4g} s)",
                f"  sensitivity peak {worst.sensitivity_peak[0]:.4g} ({worst.sensitivity_peak[2]}, t = {worst.sensitivity_peak[1]:.4g} s)",
            ]
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        heads = ("channel", "gain down to", "gain up to", "phase", "delay", "Ms")
        rows = []
        for k, name in enumerate(self.channels):
            low, peak = (_worst_of(values[:, k], True) for values in (self.gain_reduction, self.sensitivity_peak))
            high, phase, delay = (_worst_of(values[:, k], False) for values in (self.gain_increase, self.phase_deg, self.delay))
            rows.append((name, f"{low:.4g}", _factor(high), _angle(phase), _milliseconds(delay), f"{peak:.4g}"))
        return table(str(self).splitlines()[0], heads, rows)


def margins(system: OpenSystem, at: str, verdict: Stability | None = None) -> Margins:
    """Margins of every channel of the analysis point ``at`` at every operating point, dead time included.

    ``verdict``: of the same loop with dead time, if already computed. Raises ``UnknownPoint`` where the loop cannot be opened there.
    Source: the crossings follow from S_i(s) = d + c (sI - A)^-1 b, see ``crossings``.
    """
    silent = channels(system, at).empty if at == "force" else None
    system = without_idle(system)
    ch = channels(system, at)
    if system.delayed:
        verdict = stability(system) if verdict is None else verdict
        metrics = delayed_metrics(system, at, verdict.nonzero_stable, verdict.walks)
    else:
        modes = np.linalg.eig(ch.A)
        verdict = stability(system, spectrum(system, modes[0].astype(np.complex128)))
        metrics = MarginMetrics(*(np.full(ch.H0.shape, np.nan) for _ in range(10)))
        some = np.flatnonzero(verdict.nonzero_stable)
        if some.size:
            put(metrics, some, _metrics(system.at(some), at, ch.at(some), (modes[0][some], modes[1][some])))
    if silent is not None:
        for values in vars(metrics).values():
            values[silent] = np.nan
    return Margins(system.times, at, ch.names, verdict.nonzero_stable, verdict.drifts, **vars(metrics))


Modes = tuple[NDArray[Any], NDArray[Any]]  # eigenvalues (m, nx) and vectors (m, nx, nx)


def _metrics(system: OpenSystem, at_point: str, ch: Channels, modes: Modes) -> MarginMetrics:
    """Metrics of stable channels (a sampled loop: in the w plane) on the contour with its indentation."""
    dt, radius = ch.dt, system.radius
    poles = (modes[0] - 1) / (modes[0] + 1) if dt else modes[0]
    lowest = float(np.tan(radius * dt / 2)) if dt else radius
    found = resolvent(continuous(ch), (poles.astype(np.complex128), modes[1].astype(np.complex128)), lowest)
    w = frequencies_of_interest(found.poles, lowest)
    if not found.modal.any():  # each of them costs a linear solution
        w = thinned(w, found.poles)
    grid = on_grid(found, w)
    gain, phase = crossings(grid)
    at = places(radius, dt)
    theta = angles(rates(modes[0], dt), radius)
    on_arc = found.over(at(theta))
    arc = arc_crossings(radius, theta, on_arc, at, lambda point, channel, s: found.at_place(point, channel, s)[0])
    peak, peak_at = sensitivity_peak(grid)
    metrics = assembled(gain, phase, arc, found.ch.H0, lambda w: frequency(w, dt))
    also_late(metrics, *arc_delays(radius, theta, on_arc, at, lambda point, channel, s: found.at_place(point, channel, s)[0], metrics["delay"]))
    if system.held is not None:
        known = modes[0].astype(np.complex128), modes[1].astype(np.complex128)
        metrics["delay"], metrics["delay_frequency"] = sampled_delays(system, at_point, 2 * np.arctan(w), known, found.modal)
    return MarginMetrics(**metrics, sensitivity_peak=np.maximum(peak, 1.0), peak_frequency=frequency(peak_at, dt))


def _worst_of(values: Array, largest: bool) -> float:
    some = values[~np.isnan(values)]
    return float("nan") if not some.size else float(some.max() if largest else some.min())


def _inverse(x: float) -> float:
    return np.inf if x == 0 else 1 / x


def _decibels(x: float) -> str:
    return "unlimited" if np.isinf(x) else f"{20 * np.log10(x):.1f} dB"


def _factor(x: float) -> str:
    return "any" if np.isinf(x) else f"{x:.4g}"


def _angle(x: float) -> str:
    return "unlimited" if np.isinf(x) else f"{x:.1f} deg"


def _milliseconds(x: float) -> str:
    return "unlimited" if np.isinf(x) else f"{1e3 * x:.3g} ms"
