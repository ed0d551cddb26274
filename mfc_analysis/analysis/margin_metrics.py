"""From crossings to margins: the part common to both searches, with and without dead time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import Channels
from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.zero_roots import without_zero_roots
from mfc_analysis.maths.arrays import Array, Bools, Ints

FARTHEST = 1e9  #: a gain above this counts as infinite, below its inverse as zero


@dataclass(frozen=True, eq=False)
class MarginMetrics:
    """The metrics of n channels at m points; each field (m, n)."""

    gain_reduction: Array  #: factor
    gain_increase: Array  #: factor
    reduction_frequency: Array  #: [rad/s] 0: a real root goes through zero; inf where there is no reduction
    increase_frequency: Array  #: [rad/s] inf: no increase, or a root comes from infinity
    phase_deg: Array  #: [deg]
    crossover: Array  #: [rad/s]
    delay: Array  #: [s]
    delay_frequency: Array  #: [rad/s]
    sensitivity_peak: Array
    peak_frequency: Array  #: [rad/s] 0 and inf are possible


def put(metrics: MarginMetrics, index: Ints, found: MarginMetrics) -> None:
    """Write the metrics found at the points ``index`` into those of all points."""
    for name, values in vars(metrics).items():
        values[index] = getattr(found, name)


def channels_without_zeros(ch: Channels, count: int) -> tuple[Channels, Bools]:
    """The channels without the roots at zero, and (m, n) which channels depend on these roots nevertheless."""
    one = np.eye(ch.A.shape[-1]) * (1.0 if ch.dt else 0.0)
    step = ch.dt or 1.0
    parts = [without_zero_roots((a - one) / step, b, c, count) for a, b, c in zip(ch.A, ch.B, ch.C, strict=True)]
    seen = np.zeros(ch.H0.shape, bool)
    for i, part in enumerate(parts):
        row, size = part.C_zero, np.abs(part.C_zero)
        rest = np.abs(part.C) @ np.abs(part.B)
        for _ in range(len(part.A_zero)):
            strength, scale = np.einsum("nk,kn->n", row, part.B_zero), np.einsum("nk,kn->n", size, np.abs(part.B_zero))
            seen[i] |= np.abs(strength) > 1e-9 * (scale + np.diagonal(rest)) + 1e-300
            row, size = row @ part.A_zero, size @ np.abs(part.A_zero)
    eye = np.eye(len(parts[0].A)) * (1.0 if ch.dt else 0.0)
    A, B, C = np.stack([p.A * step + eye for p in parts]), np.stack([p.B for p in parts]), np.stack([p.C for p in parts])
    return Channels(ch.names, A, B, C, ch.H0, ch.dt), seen


def frequency(w: Array, dt: float) -> Array:
    """Frequency [rad/s] of a point on the axis: w itself, or 2 atan(w) / dt in the w plane of a sampled loop."""
    return np.asarray(2 * np.arctan(w) / dt) if dt else w


def dc_sensitivity(ch: Channels, zeros: Ints) -> Array:
    """S_i(0) - 1 (m, n) without the ``zeros`` (m,) roots at zero; NaN where a channel depends on them nevertheless."""
    out = np.full(ch.H0.shape, np.nan)
    for count in np.unique(zeros):
        some = np.flatnonzero(zeros == count)
        if not count:
            out[some] = sensitivity_at_zero(ch.at(some))
            continue
        clean, seen = channels_without_zeros(ch.at(some), int(count))
        out[some] = np.where(seen, np.nan, sensitivity_at_zero(clean))
    return out


def sensitivity_at_zero(ch: Channels) -> Array:
    """S_i(0) - 1 (m, n); -1 exactly where an integrator makes S vanish, 0 exactly where L does."""
    try:
        x = np.linalg.solve(ch.A, ch.B)
    except np.linalg.LinAlgError:
        x = np.linalg.pinv(ch.A) @ ch.B
    terms = np.swapaxes(x, 1, 2) * ch.C
    H, size = ch.H0 - terms.sum(axis=2), np.abs(terms).sum(axis=2) + np.abs(ch.H0)
    H = np.where(np.abs(H + 1) < 1e-12 * (1 + size), -1.0, H)
    return np.asarray(np.where(np.abs(H) < 1e-13 * size, 0.0, H))


def assembled(gain: Crossings, phase: Crossings, at_zero: Array, at_infinity: Array, to_rads: Callable[[Array], Array]) -> dict[str, Array]:
    """Gain interval, phase and delay margin (m, n) from crossings and from S - 1 at w = 0 and infinity (m, n), which are real.

    ``to_rads`` converts a point on the axis to a frequency [rad/s] (``frequency``).
    """
    shape = at_zero.shape
    increase, reduction = np.full(shape, np.inf), np.zeros(shape)
    up_at, down_at = np.full(shape, np.inf), np.full(shape, np.inf)
    for point, channel, H, w in (
        (phase.point, phase.channel, phase.H.real, to_rads(phase.w)),
        (*np.indices(shape).reshape(2, -1), at_zero.ravel(), np.zeros(at_zero.size)),
        (*np.indices(shape).reshape(2, -1), at_infinity.ravel(), to_rads(np.full(at_zero.size, np.inf))),
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


def _least(best: Array, best_at: Array, point: Ints, channel: Ints, value: Array, at: Array) -> None:
    """Sets best[point, channel] to the minimum of itself and the values (NaN: none), and best_at to its location."""
    some = np.isfinite(value)
    order = np.argsort(-value[some], kind="stable")  # of several values for one entry the last one written, the smallest, stays
    p, c, v, w = point[some][order], channel[some][order], value[some][order], at[some][order]
    better = v < best[p, c]
    best[p[better], c[better]], best_at[p[better], c[better]] = v[better], w[better]
