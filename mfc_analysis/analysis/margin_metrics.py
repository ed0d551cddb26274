"""From crossings to margins: the part common to both searches, with and without dead time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.maths.arrays import Array, Ints

FARTHEST = 1e9  #: a gain above this counts as infinite, below its inverse as zero


@dataclass(frozen=True, eq=False)
class MarginMetrics:
    """The metrics of n channels at m points; each field (m, n)."""

    gain_reduction: Array  #: factor
    gain_increase: Array  #: factor
    reduction_frequency: Array  #: [rad/s] of the root that leaves; 0: a real root; inf where there is no reduction
    increase_frequency: Array  #: [rad/s] inf: no increase, or a root comes from infinity
    phase_deg: Array  #: [deg]
    crossover: Array  #: [rad/s]
    delay: Array  #: [s]
    delay_frequency: Array  #: [rad/s]
    sensitivity_peak: Array
    peak_frequency: Array  #: [rad/s] from 1/horizon to inf


def put(metrics: MarginMetrics, index: Ints, found: MarginMetrics) -> None:
    """Write the metrics found at the points ``index`` into those of all points."""
    for name, values in vars(metrics).items():
        values[index] = getattr(found, name)


def frequency(w: Array, dt: float) -> Array:
    """Frequency [rad/s] of a point on the axis: w itself, or 2 atan(w) / dt in the w plane of a sampled loop."""
    return np.asarray(2 * np.arctan(w) / dt) if dt else w


def assembled(gain: Crossings, phase: Crossings, arc: Crossings, at_infinity: Array, to_rads: Callable[[Array], Array]) -> dict[str, Array]:
    """Gain interval, phase and delay margin (m, n).

    ``gain``, ``phase``: crossings on the axis; ``arc``: points of the indentation at which L is real, with w = 0 where s is real;
    ``at_infinity``: S - 1 at infinity (m, n), which is real. ``to_rads`` converts a point on the axis to a frequency [rad/s] (``frequency``).
    """
    shape = at_infinity.shape
    increase, reduction = np.full(shape, np.inf), np.zeros(shape)
    up_at, down_at = np.full(shape, np.inf), np.full(shape, np.inf)
    for point, channel, H, w in (
        (phase.point, phase.channel, phase.H.real, to_rads(phase.w)),
        (arc.point, arc.channel, arc.H.real, arc.w),
        (*np.indices(shape).reshape(2, -1), at_infinity.ravel(), to_rads(np.full(at_infinity.size, np.inf))),
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = (1 + H) / H
        factor = np.where((factor > 1 / FARTHEST) & (factor < FARTHEST), factor, np.nan)
        _least(increase, up_at, point, channel, np.where(factor > 1, factor, np.nan), w)
        _least(reduction, down_at, point, channel, np.where(factor <= 1, -factor, np.nan), w)
    turn = np.angle(-gain.L)
    lag = np.where(turn > 0, turn, turn + 2 * np.pi)
    rads = to_rads(gain.w)
    phase_deg, crossover = np.full(shape, np.inf), np.full(shape, np.inf)
    delay, delay_at = np.full(shape, np.inf), np.full(shape, np.inf)
    _least(phase_deg, crossover, gain.point, gain.channel, np.degrees(np.abs(turn)), rads)
    _least(delay, delay_at, gain.point, gain.channel, lag / rads, rads)
    with np.errstate(divide="ignore", invalid="ignore"):
        direct = np.abs(at_infinity / (1 + at_infinity)) >= 1
    if np.isinf(to_rads(np.array([np.inf]))[0]):  # a continuous loop: with any dead time it has a chain of roots in the right half plane
        delay[direct], delay_at[direct] = 0.0, np.inf
    return {
        "gain_reduction": -reduction + 0.0,
        "gain_increase": increase,
        "reduction_frequency": down_at,
        "increase_frequency": up_at,
        "phase_deg": phase_deg,
        "crossover": crossover,
        "delay": delay,
        "delay_frequency": delay_at,
    }


def also_late(metrics: dict[str, Array], found: Crossings, delay: Array) -> None:
    """Take the dead times ``delay`` (k,) [s] into the delay margin, which move a root to the places found on the arc (``arc_delays``)."""
    _least(metrics["delay"], metrics["delay_frequency"], found.point, found.channel, delay, found.w)


def _least(best: Array, best_at: Array, point: Ints, channel: Ints, value: Array, at: Array) -> None:
    """Sets best[point, channel] to the minimum of itself and the values (NaN: none), and best_at to its location."""
    some = np.isfinite(value)
    order = np.argsort(-value[some], kind="stable")  # of several values for one entry the last one written, the smallest, stays
    p, c, v, w = point[some][order], channel[some][order], value[some][order], at[some][order]
    better = v < best[p, c]
    best[p[better], c[better]], best_at[p[better], c[better]] = v[better], w[better]
