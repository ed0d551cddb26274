r"""The one-mass force loop of 9.22-9.23 as polynomials, and its gains by exact pole placement.

One mass m with friction b pushes on a spring k_e through a torque lag T (first order); the law is
f = F_d + kfp F_e + kfi int F_e - kdamp v. Characteristic polynomial (chapter, eqs. 9.19, 9.23):

.. math:: m T s^4 + (m + b T) s^3 + (b + k_{damp} + k_e T) s^2 + k_e (1 + k_{fp}) s + k_e k_{fi}

The sum of its poles is fixed by the plant, 1/T + b/m, so that placing a pair and a pole also places the fourth.
"""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mfc_analysis.errors import BadArgument
from mfc_analysis.gains.scalar_loop import BOTH, LoopMetrics, loop_metrics
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.roots import root_between

_FAST = 1e3  # search range of the bandwidth, as a frequency ratio to the loop with kfp = 0 and its poles together


@dataclass(frozen=True, eq=False)
class ForceDesign:
    """Gains of the one-mass force loop, and the metrics of the loop."""

    kfp: float  #: [-]
    kfi: float  #: [1/s]
    kdamp: float  #: [N s/m]
    natural_frequency: float  #: [rad/s] of the pair of poles, verified on the polynomial
    damping: float  #: of the pair of poles, verified on the polynomial
    pole: float  #: [rad/s] the pole at -pole
    metrics: LoopMetrics  #: of L at the force sensor
    tracking_bandwidth: float  #: [rad/s] -3 dB from F_d to F_tip
    stiffness_range: tuple[float, float]  #: [N/m] range in which the loop is stable with these gains


class Placed(NamedTuple):
    """Gains and the poles they place: a pair, one at -pole, and the pole of the lag at -fast (inf without lag)."""

    kfp: float
    kfi: float
    kdamp: float
    natural_frequency: float
    damping: float
    pole: float
    fast: float


def characteristic(kfp: float, kfi: float, kdamp: float, k: float, m: float, T: float = 0.0, b: float = 0.0) -> list[float]:
    """Coefficients of the characteristic polynomial, highest power first (the first is 0 without lag)."""
    return [m * T, m + b * T, b + kdamp + k * T, k * (1 + kfp), k * kfi]


def stiffness_range(kfp: float, kfi: float, kdamp: float, m: float, T: float = 0.0, b: float = 0.0) -> tuple[float, float]:
    """Stiffnesses (low, high) [N/m] between which the loop is stable, by the Routh criterion; (nan, nan) if there are none."""
    M = m + b * T
    damped = (b + kdamp) * (1 + kfp) - M * kfi
    fight = T * (1 + kfp) * (m * (1 + kfp) - M) / M  # stable iff damped > fight k_e
    if fight == 0:
        return (0.0, math.inf) if damped > 0 else (math.nan, math.nan)
    if fight < 0:
        return max(damped / fight, 0.0), math.inf
    return (0.0, damped / fight) if damped > 0 else (math.nan, math.nan)


def force_design(name: str, value: float, k: float, m: float, T: float, b: float, zeta: float) -> ForceDesign:
    """Gains >= 0 for which the metric ``name`` (a field of ``LoopMetrics``, or "natural_frequency") is ``value``.

    Raises ``BadArgument`` with the reason where none exist.
    """
    if name == "natural_frequency":
        return _finished(name, value, _placed(value, 1.0, k, m, T, b, zeta), k, m, T, b)

    def metric(log_s: float) -> float:
        w, r = _family(math.exp(log_s), k, m, T, b, zeta)
        f = _metrics(*_placed(w, r, k, m, T, b, zeta)[:3], k, m, T, b, settle=(name,))
        return float(getattr(f, name)) if f.stable else math.nan

    grid = np.linspace(math.log(1e-5), math.log(_highest(k, m, T, b, zeta)), 121)
    known = np.full(grid.size, math.nan)
    for i, log_s in enumerate(grid):
        try:
            known[i] = metric(float(log_s))
        except BadArgument:
            continue
    sign = np.sign(known - value)
    crossed = sign[:-1] * sign[1:] <= 0
    if name in BOTH:  # where it grows with s, the integral is too weak to matter within the band, or the response begins to leave the band again
        crossed &= sign[:-1] > sign[1:]
    why = None
    for left, right in zip(grid[:-1][crossed], grid[1:][crossed], strict=True):
        s = math.exp(root_between(lambda x: metric(x) - value, float(left), float(right), xtol=1e-14, rtol=1e-14))
        w, r = _family(s, k, m, T, b, zeta)
        try:
            return _finished(name, value, _placed(w, r, k, m, T, b, zeta), k, m, T, b)
        except BadArgument as jumps:  # over the value, where an extreme of the response leaves the band
            why = why or jumps
    raise why or _unattainable(name, value, known, k, m, T, b, zeta)


def _placed(w: float, r: float, k: float, m: float, T: float, b: float, zeta: float) -> Placed:
    """Gains that place the poles at the pair (zeta, w) and at -r w."""
    p = r * w
    a2, a1, a0 = 2 * zeta * w + p, w * w + 2 * zeta * w * p, p * w * w
    f = (1 / T + b / m - a2) if T else math.inf
    if T and f < w:
        raise BadArgument(
            "lag", T, f"less than {1 / (a2 + w - b / m):.4g} s for poles at {w:.4g} rad/s: the lag must be the fastest part of the loop"
        )
    K, kkfi = (m * T * (a0 + f * a1), m * T * f * a0) if T else (m * a1, m * a0)
    kdamp = m * T * (a1 + f * a2) - k * T - b if T else m * a2 - b
    kfp = K / k - 1
    kfp = 0.0 if abs(kfp) < 1e-9 else kfp
    if kfp < 0:
        raise BadArgument(
            "natural_frequency",
            w,
            f"at least {_without_proportional(r, k, m, T, b, zeta):.6g} rad/s here, where kfp = 0: the spring alone is stiffer than the required "
            "loop; specify a bandwidth, which may be lower",
        )
    if kdamp < 0:
        raise BadArgument("damping", zeta, f"more: with friction {b:g} N s/m and lag {T:g} s it would need a negative kdamp ({kdamp:.4g} N s/m)")
    return Placed(kfp, kkfi / k, kdamp, w, zeta, p, f)


def _family(s: float, k: float, m: float, T: float, b: float, zeta: float) -> tuple[float, float]:
    """Natural frequency and pole ratio of the one-parameter family: s < 1: kfp = 0 and p = s w; s >= 1: p = w, kfp > 0."""
    w = _without_proportional(min(s, 1.0), k, m, T, b, zeta)
    return w * max(s, 1.0), min(s, 1.0)


def _without_proportional(r: float, k: float, m: float, T: float, b: float, zeta: float) -> float:
    """Natural frequency at which kfp = 0, the pole at r w."""
    if T == 0:
        return math.sqrt(k / (m * (1 + 2 * zeta * r)))
    c = 1 / T + b / m
    # m T (a0 + f a1) - k = 0 with f = c - (2 zeta + r) w: a cubic in w, its smallest positive root
    roots = np.roots([m * T * (r - (1 + 2 * zeta * r) * (2 * zeta + r)), m * T * c * (1 + 2 * zeta * r), 0.0, -k])
    real = np.sort(roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real)
    if not real.size or real[0] > c / (2 * zeta + r + 1):
        raise BadArgument("lag", T, f"a smaller lag: on {k:g} N/m no pair with damping {zeta:g} is slower than the lag")
    return float(real[0])


def _highest(k: float, m: float, T: float, b: float, zeta: float) -> float:
    """Largest parameter of the family."""
    if T == 0:
        return _FAST
    try:
        w = _without_proportional(1.0, k, m, T, b, zeta)
    except BadArgument:
        return 1.0
    return max(1.0, (1 / T + b / m) / (2 * zeta + 2) / w * (1 - 1e-9))


def _loop(kfp: float, kfi: float, kdamp: float, k: float, m: float, T: float, b: float) -> tuple[list[float], list[float]]:
    """L at the force sensor: k_e (kfp s + kfi) over s (m T s^3 + (m + b T) s^2 + (b + kdamp + k_e T) s + k_e)."""
    return [k * kfp, k * kfi], [m * T, m + b * T, b + kdamp + k * T, k, 0.0]


def _metrics(kfp: float, kfi: float, kdamp: float, k: float, m: float, T: float, b: float, settle: Container[str] = BOTH) -> LoopMetrics:
    """Of L; the reference is F_d, which is also fed forward: k_e ((1 + kfp) s + kfi) over the characteristic polynomial."""
    return loop_metrics(*_loop(kfp, kfi, kdamp, k, m, T, b), settle=settle, reference=[k * (1 + kfp), k * kfi])


def _finished(name: str, value: float, placed: Placed, k: float, m: float, T: float, b: float) -> ForceDesign:
    """The design, with metrics from its polynomial. Raises BadArgument where these differ from the specification."""
    kfp, kfi, kdamp, w, zeta, p, fast = placed
    closed = characteristic(kfp, kfi, kdamp, k, m, T, b)
    metrics = _metrics(kfp, kfi, kdamp, k, m, T, b)
    # the poles are verified on the polynomial of the final gains: multiplied out they must give its coefficients
    factors = np.polymul(np.polymul([1.0, 2 * zeta * w, w * w], [1.0, p]), [1 / fast, 1.0] if T else [1.0])
    actual = np.array(closed if T else closed[1:])
    confirmed = np.allclose(factors * (actual[-1] / factors[-1]), actual, rtol=1e-8, atol=0)
    found = w if name == "natural_frequency" else float(getattr(metrics, name))
    if not metrics.stable or not confirmed or not abs(found / value - 1) <= 1e-6:
        raise BadArgument(name.removeprefix("loop_"), value, f"another value: the nearest loop attains {found:.6g}")
    tracking = loop_metrics([k * (1 + kfp), k * kfi], [*closed[:3], 0.0, 0.0], settle=()).bandwidth
    return ForceDesign(kfp, kfi, kdamp, w, zeta, p, metrics, tracking, stiffness_range(kfp, kfi, kdamp, m, T, b))


def _unattainable(name: str, value: float, known: Array, k: float, m: float, T: float, b: float, zeta: float) -> BadArgument:
    fine = known[np.isfinite(known)]
    if not fine.size:
        _placed(*_family(1e-3, k, m, T, b, zeta), k, m, T, b, zeta)  # raises with a specific reason
        return BadArgument(name.removeprefix("loop_"), value, "a stiffness, mass, lag and friction for which some gains >= 0 are stable")
    forward = name == "settling_time" and bool(np.isfinite(known[0]))  # F_d is fed forward: without an integral the force settles all the same
    fine = known[np.nanargmax(known) :] if forward else fine
    slow = (value < np.nanmin(fine)) != (name in BOTH)
    why = f"less needs a negative kdamp at friction {b:g} N s/m: specify more damping" if slow else f"more is not possible with a lag of {T:g} s"
    why = "a slower loop settles sooner, because F_d is fed forward and its error is within the band" if slow and forward else why
    return BadArgument(name.removeprefix("loop_"), value, f"{np.nanmin(fine):.4g} to {np.nanmax(fine):.4g} on {k:g} N/m with gains >= 0; {why}")
