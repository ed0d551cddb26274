"""Metrics of one scalar loop L = num/den from its polynomials, without a frequency grid.

Crossings are roots of polynomials in w^2, polished by Newton. A settling time is the last root of |1 - y(t)| = tolerance, by
matrix exponentials, so that repeated poles are allowed. There are two, with the same poles: of a step of the reference, whose
derivative the law does not get (v_d = 0), and of the step response of T = L/(1 + L).
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.roots import root_between

CLOSE = 0.9  #: part of the band above which a sample may stand beside a peak outside it: 20 samples a period miss 1.2 % of a sinusoid
SETTLING: Mapping[str, str] = {"reference": "settling_time", "loop": "loop_settling_time"}  #: step -> field of ``LoopMetrics`` and ``Achieved``
BOTH = tuple(SETTLING.values())


@dataclass(frozen=True, eq=False)
class LoopMetrics:
    """Metrics of a loop L in negative feedback, T = L/(1 + L); ``inf`` where there is no such crossing, all NaN when T is unstable."""

    stable: bool
    bandwidth: float  #: [rad/s] lowest frequency where |T| falls to 1/sqrt(2) (-3 dB)
    crossover: float  #: [rad/s] highest frequency where |L| = 1
    phase_deg: float  #: [deg] phase margin at that crossover
    settling_time: float  #: [s] last time at which the response to a step of the reference is ``tolerance`` away from 1
    loop_settling_time: float  #: [s] the same of the step response of T
    tolerance: float = 0.02  #: settling band: 2 %


def loop_metrics(
    num: ArrayLike, den: ArrayLike, tolerance: float = 0.02, settle: Container[str] = BOTH, reference: ArrayLike | None = None
) -> LoopMetrics:
    """Metrics of the loop L = num/den (coefficients, highest power first; strictly proper, T(0) = 1); settling times not in ``settle`` are NaN.

    ``reference``: numerator of the response to the reference, over num + den; omitted: num, as where the law sees the error alone.
    """
    n, d = np.trim_zeros(np.asarray(num, float), "f"), np.trim_zeros(np.asarray(den, float), "f")
    follows = n if reference is None else np.trim_zeros(np.asarray(reference, float), "f")
    closed = np.polyadd(n, d)
    poles = np.roots(closed)
    if np.any(poles.real >= 0):
        nan = math.nan
        return LoopMetrics(False, nan, nan, nan, nan, nan, tolerance)
    unit = float(np.exp(np.mean(np.log(np.abs(poles)))))  # time in units of the mean pole
    n, d, follows, closed = (_scaled(p, unit) / (closed[0] * unit ** (closed.size - 1)) for p in (n, d, follows, np.asarray(closed, float)))
    falls = _crossings(n, closed, 0.5)
    ones = _crossings(n, d, 1.0)
    crossover = ones[-1] if ones.size else math.inf
    phase = math.inf
    if ones.size:
        L = np.polyval(n, 1j * crossover) / np.polyval(d, 1j * crossover)
        phase = math.degrees(float(np.angle(-L)))
    errors = {"settling_time": np.polysub(closed, follows), "loop_settling_time": d}
    settling = {name: _settling(error, closed, tolerance) / unit if name in settle else math.nan for name, error in errors.items()}
    bandwidth = float(falls[0] * unit) if falls.size else math.inf
    return LoopMetrics(True, bandwidth, float(crossover * unit), phase, **settling, tolerance=tolerance)


def _scaled(p: Array, unit: float) -> Array:
    return p * unit ** np.arange(p.size - 1, -1, -1)


def _modulus_squared(p: Array) -> Array:
    """Coefficients of |p(jw)|^2 in w^2."""
    even = np.polymul(p, p * (-1.0) ** np.arange(p.size - 1, -1, -1))[::2]
    return even * (-1.0) ** np.arange(even.size - 1, -1, -1)


def _crossings(num: Array, den: Array, level: float) -> Array:
    """Frequencies > 0 where |num/den|^2 = level, ascending."""
    f = np.polysub(_modulus_squared(num), level * _modulus_squared(den))
    roots = np.roots(f)
    x = roots[(np.abs(roots.imag) <= 1e-7 * np.abs(roots)) & (roots.real > 0)].real
    slope = np.polyder(f)
    for _ in range(3):
        step = np.polyval(slope, x)
        x = x - np.divide(np.polyval(f, x), step, out=np.zeros_like(x), where=step != 0)
    return np.asarray(np.sort(np.sqrt(x)))


def _settling(error: Array, closed: Array, tolerance: float) -> float:
    """Last time of |e(t)| = tolerance, e the error of a unit step: E = error / (closed s), ``error`` with a root at zero."""
    from scipy.linalg import expm

    if closed[-1] == 0 or abs(error[-1]) > 1e-12 * abs(closed[-1]):
        return math.inf  # a constant steady-state error
    k = closed.size - 1
    A = np.diag(np.ones(k - 1), -1)
    A[0] = -closed[1:] / closed[0]
    c = np.zeros(k)
    c[k - error.size + 1 :] = error[:-1] / closed[0]
    poles = np.linalg.eigvals(A)
    horizon = 16.0 / float(np.min(-poles.real))
    samples = int(min(4e5, max(4000, 20 * horizon * np.max(np.abs(poles.imag)) / (2 * np.pi))))
    step = horizon / samples
    e, slope = _error_samples(np.stack([c, c @ A]), A, step, samples)

    def excess(t: float) -> float:
        return abs(float(c @ expm(A * t)[:, 0])) - tolerance

    above = np.flatnonzero(np.abs(e) > tolerance)
    last = int(above[-1]) if above.size else -1
    left, right = max(last, 0) * step, (last + 1) * step
    size = np.abs(e[last + 1 :])
    turns = (slope[last + 1 : -1] * slope[last + 2 :] < 0) & (np.maximum(size[1:], size[:-1]) > CLOSE * tolerance)
    for k in last + 1 + np.flatnonzero(turns)[::-1]:  # a peak between two samples may leave the band
        peak = root_between(lambda t: float(c @ A @ expm(A * t)[:, 0]), float(k * step), float((k + 1) * step))
        if excess(peak) > 0:
            left, right = peak, float((k + 1) * step)
            break
    else:
        if not above.size:
            return 0.0

    for end, outside in ((left, True), (right, False)):
        if (excess(end) > 0) != outside:
            return float(end)  # on the band, to rounding
    return root_between(excess, left, right, xtol=1e-14 * horizon, rtol=1e-13)


def _error_samples(c: Array, A: Array, h: float, count: int) -> Array:
    """c exp(A k h) e_1 for k = 0 .. count, by doubling; a row for each row of c."""
    from scipy.linalg import expm

    X, step = np.eye(A.shape[0])[:, :1], expm(A * h)
    while X.shape[1] <= count:
        X, step = np.hstack([X, step @ X]), step @ step
    return np.asarray(c @ X[:, : count + 1], float)
