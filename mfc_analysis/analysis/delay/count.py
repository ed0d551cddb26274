"""How many characteristic roots lie in a region: the winding of the characteristic function along its edge.

With g = f / prod(s - c), c stable and of the order of f, g goes to 1 far away in the right half plane. The number of roots right of Nyquist's
contour, which is indented at the origin by the arc abs(s) = radius, is the winding of g along it. By symmetry half of it is enough:

    s = radius (real)  --arc-->  j radius  --axis-->  j w_end.

The samples are refined until on each step g changes by less than a quarter turn and the step is shorter than abs(g / g'), which near m roots
at the distance d is d/m: no root slips through. Where every loop gain is surely below one, det(I - E G) stays in the right half plane and
its phase is known however fast e^(-jwT) turns; the contour ends where this holds for good.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mfc_analysis.analysis.delay.characteristic import Delayed
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Bools, Complex, on_axis

MOST = 60_000  #: samples of one contour
CONTRACTS = 0.8  #: loop gain below which the phase of det(I - E G) is known; nearer to one where the direct gain is larger
FROM_POLES = 2.5  #: times 1 - that gain and the distance from the poles of G: the longest step between two samples on which it stays below one
NARROW = 1e-10  #: relative step at which a root lies on the contour
LADDER = 12  #: first samples in a decade
NUDGES = (1.0, 1 + 3e-4, 1 - 3e-4)  #: factors of the radius, tried in turn where a root lies on the circle
AROUND = np.array([-3.0, -1.0, -0.3, 0.3, 1.0, 3.0])  #: first samples around a pole, in units of its distance from the axis; never on a pole
LEAST = 1e-3  #: of that distance, as a fraction of its modulus


@dataclass(frozen=True, eq=False)
class Walk:
    """The samples along a part of a contour."""

    s: Complex  #: (k,)
    loop: Complex  #: (k, nd, nd) E G there
    turn: float  #: [rad] by which the phase of g changes
    on_it: Complex  #: roots on the contour, up to rounding


def unstable_roots(point: Delayed, radius: float, most: int = MOST) -> tuple[int, Walk]:
    """The number of roots with a real part above zero and abs(s) >= ``radius`` [1/s], roots on the axis included; and the walk along the axis.

    Raises ``NotConverged`` where the contour takes more than ``most`` samples.
    """
    poles, inner = _mirrored(point), 0
    if not radius:
        radius = 1e-9 * float(np.abs(point.places).min())
        inner = roots_within(point, radius, most=most)
    for nudge in NUDGES:
        arc = _walk(point, poles, _angles(point, nudge * radius, np.pi / 2), nudge * radius, most=most)
        if not arc.on_it.size:
            break
    else:
        raise _unsettled(f"a root lies on the circle of {radius:.4g} 1/s")
    axis = _along_axis(point, poles, nudge * radius, most)
    if axis.on_it.size:
        return axis.on_it.size, axis
    turn = arc.turn + axis.turn
    if not point.dt:  # from the last frequency to infinity
        end = axis.s[-1]
        turn -= _principal(axis.loop[-1:])[0] + float((np.angle(end - point.open_poles) - np.angle(end - poles)).sum())
    return _whole(-turn / np.pi) + inner, axis


def roots_within(point: Delayed, radius: float, center: complex = 0.0, most: int = MOST) -> int:
    """The number of roots in the disc abs(s - center) < ``radius`` [1/s]. Raises ``NotConverged``."""
    none, last = np.zeros(0, np.complex128), 2 * np.pi if center.imag else np.pi
    for nudge in NUDGES:
        size = nudge * radius
        u = np.linspace(0, last, 17) if center else _angles(point, size, last)
        walk = _walk(point, none, u, size, center, most=most)
        if not walk.on_it.size:
            return _whole(walk.turn / last)
    raise _unsettled(f"a root lies on the circle of {radius:.4g} 1/s")


def _whole(count: float) -> int:
    if not np.isfinite(count) or abs(count - round(count)) > 0.1 or count < -0.5:
        raise _unsettled(f"the winding number {count:.3f} is no whole number")
    return round(count)


def _unsettled(reason: str) -> NotConverged:
    return NotConverged("the number of unstable roots with dead time is not settled", reason)


def _mirrored(point: Delayed) -> Complex:
    """The poles without dead time, each in the left half plane (inside the unit circle) and not too close to its edge."""
    c = point.closed_poles
    if point.dt:
        size = np.maximum(np.abs(c), 1e-12)
        size = np.where(size > 1, 1 / size, size)
        return np.asarray(c / np.maximum(np.abs(c), 1e-12) * np.minimum(size, 0.98), np.complex128)
    least = 1e-3 * float(np.abs(point.places).min())
    return np.asarray(-np.maximum(np.abs(c.real), np.maximum(0.1 * np.abs(c), least)) + 1j * c.imag, np.complex128)


def _angles(point: Delayed, radius: float, last: float) -> Array:
    """First angles on an arc about zero: even ones, and around each root that lies near it."""
    s = point.places[(np.abs(point.places) < 3 * radius) & (np.abs(point.places) > 0.3 * radius)]
    gap = np.abs(np.abs(s) / radius - 1) + LEAST
    near = np.abs(np.angle(s))[:, None] + gap[:, None] * AROUND
    every = np.unique(np.concatenate([np.linspace(0, last, 9), near.ravel()]))
    return np.asarray(every[(every >= 0) & (every <= last)])


def _along_axis(point: Delayed, poles: Complex, edge: float, most: int) -> Walk:
    s = point.places
    size = np.abs(s)
    last = np.pi / point.dt if point.dt else 1e3 * float(size.max())
    first = [np.geomspace(edge, last, max(9, int(LADDER * np.log10(last / edge)))) if last > edge else np.array([edge, last])]
    first += [(np.abs(s.imag)[:, None] + np.maximum(np.abs(s.real), LEAST * size)[:, None] * AROUND).ravel(), 1.01 * size]
    w = np.unique(np.concatenate(first))
    w = w[(w >= edge) & (w <= last)]
    if not point.dt:
        w = _until_contracting(point, w)
    return _walk(point, poles, w, edge, axis=True, most=most)


def _contracts(point: Delayed) -> float:
    """The loop gain from which on the phase is not known: ``CONTRACTS``, or halfway from a larger direct gain to one."""
    direct = float(point.contraction(point.D[None].astype(complex))[0])
    return max(CONTRACTS, 0.5 * (1 + direct)) if direct < 1 else CONTRACTS


def _until_contracting(point: Delayed, w: Array) -> Array:
    """The frequencies to well above every pole and up to where the loop gain is below one for good; more are added where it is not at the last."""
    limit, above = _contracts(point), int(np.searchsorted(w, 3 * float(np.abs(point.places).max())))
    for _ in range(12):
        start = max(above - 1, 0)  # those below make no difference
        loud = ~point.contracts(point.gain(on_axis(w[start:])), limit)
        last = max(above, start + int(np.flatnonzero(loud).max(initial=0)) + 2 if loud.any() else 2)
        if last < w.size:
            return w[: last + 1]
        w = np.concatenate([w, w[-1] * np.geomspace(1, 1e3, 3 * LADDER)[1:]])
    raise _unsettled("the loop gain does not fall below one at high frequency")


def _walk(point: Delayed, poles: Complex, u: Array, radius: float, center: complex = 0.0, axis: bool = False, most: int = MOST) -> Walk:
    """Refines the samples u (k,): angles on a circle about ``center``, or frequencies on the axis."""

    def at(u: Array) -> tuple[Complex, Complex]:
        turned = np.exp(1j * u)
        if axis:
            return on_axis(u), np.full(u.size, 1j, np.complex128)
        return np.asarray(center + radius * turned, np.complex128), np.asarray(1j * radius * turned, np.complex128)

    def values(u: Array) -> tuple[Complex, Array, Complex, Complex, Bools, Bools, Array]:
        s, ds = at(u)
        phase, rate, loop = point.value(s, poles)
        gap = np.abs(s[:, None] - point.open_poles).min(axis=1, initial=np.inf) if leaps else np.zeros(u.size)
        return s, phase, rate * ds, loop, np.zeros(u.size, bool), np.full(u.size, not leaps), gap

    leaps = axis and not point.dt
    limit = _contracts(point) if leaps else 1.0
    s, phase, rate, loop, calm, asked, gap = values(u)
    narrow = NARROW if axis else NARROW / max(1.0, abs(center) / radius)
    while True:
        step = np.diff(u)
        turn = np.angle(np.exp(1j * np.diff(phase)))
        steep = np.maximum(np.abs(rate[:-1]), np.abs(rate[1:]))
        with np.errstate(invalid="ignore", over="ignore"):
            predicted = 0.5 * step * (rate[:-1] + rate[1:]).imag
            fine = (step * steep <= 1) & (np.abs(turn) <= np.pi / 4) & (np.abs(turn - predicted) <= 0.3)
        leap = ~fine & (step <= FROM_POLES * (1 - limit) * np.minimum(gap[:-1], gap[1:]))
        ask = np.flatnonzero((np.append(leap, False) | np.insert(leap, 0, False)) & ~asked)
        if ask.size:
            calm[ask], asked[ask] = point.contracts(loop[ask], limit), True
        leap &= calm[:-1] & calm[1:]
        done = step <= narrow * (np.abs(u[1:]) if axis else 1.0)
        bad = np.flatnonzero(~(fine | leap | done))
        if not bad.size:
            break
        if u.size + bad.size > most:
            raise _unsettled(f"the contour takes more than {most} samples: dead time x fastest frequency of the loop is too large")
        middle = 0.5 * (u[bad] + u[bad + 1])
        new = values(middle)
        u = np.insert(u, bad + 1, middle)
        old: tuple[Any, ...] = (s, phase, rate, loop, calm, asked, gap)
        s, phase, rate, loop, calm, asked, gap = (np.insert(one, bad + 1, add, axis=0) for one, add in zip(old, new, strict=True))
    if leap.any():
        ends = np.append(leap, False) | np.insert(leap, 0, False)
        known = np.zeros(u.size)
        known[ends] = _principal(loop[ends]) + _continuous(s[ends], point.open_poles) - _continuous(s[ends], poles)
        turn = np.where(leap, np.diff(known), turn)
    crossed = done & ~fine & ~leap
    return Walk(s, loop, float(np.where(crossed, 0.0, turn).sum()), _merged(s[:-1][crossed]))


def _principal(loop: Complex) -> Array:
    """(k,) [rad] sum of the phases of the eigenvalues of I - E G, each within a quarter turn where the loop gain is below one."""
    return np.asarray(np.angle(1 - np.linalg.eigvals(loop)).sum(axis=1))


def _continuous(s: Complex, poles: Complex) -> Array:
    """(k,) [rad] sum of the phases of s - pole along the axis, without jumps."""
    gap = s[:, None] - poles
    right = poles.real > 0
    return np.asarray(np.where(right, -np.arctan2(gap.imag, -gap.real), np.arctan2(gap.imag, gap.real)).sum(axis=1))


def _merged(roots: Complex) -> Complex:
    """Roots on the contour, each once."""
    if not roots.size:
        return roots
    new = np.concatenate([[True], np.abs(np.diff(roots)) > 1e-6 * np.abs(roots[1:])])
    return np.asarray(roots[new])
