"""The stability verdict of a loop with dead time: a root found in the unstable region, or a count of the roots there that cannot miss."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from mfc_analysis.analysis.delay.characteristic import Delayed, delayed_points, in_a_loop, stacked
from mfc_analysis.analysis.delay.count import NARROW, Count, disc_counts, roots_within, unstable_counts, unstable_roots
from mfc_analysis.analysis.delay.slow import slow_part
from mfc_analysis.analysis.delay.stacked import Stacked
from mfc_analysis.analysis.spectrum import Spectrum
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.maths.arrays import Array, Complex, on_axis

CERTAINLY = 1 - 1e-9  #: a direct gain round a dead time from here on has an infinite chain of unstable roots
BESIDE = np.arange(-16, 17) + 0.5  #: half turns of e^(-sT) beside a place at which an unstable root is sought,
SAME = 1e-3  #: two places nearer than this over the dead time are one,
NEWTON = 9  #: and steps, the first three from eigenvalue to eigenvalue
MOST_GROWTH = 50.0  #: largest growth in one dead time of a root that is sought
LONGEST = 20.0  #: horizons: the largest dead time that is judged
FEW = 2_000  #: samples of a contour up to which the roots are counted before one is sought
TRIED = 6  #: places at which an unstable root is sought


@dataclass(frozen=True, eq=False)
class DelayedVerdict:
    """The verdict at one point."""

    slow: int  #: slow roots with multiplicity
    decays: bool  #: every root that is not slow
    held: bool  #: some root is not slow
    slow_roots: Complex  #: [1/s]
    motion: Array  #: (nx, nx) what keeps moving over the second half of the horizon
    walk: Array  #: (k,) [rad/s] frequencies of the count along the axis, which resolve the roots near it; none where nothing was counted


def delayed_verdicts(system: OpenSystem, known: Spectrum) -> list[DelayedVerdict]:
    """The verdict at each point of a loop with dead time, without idle integrals.

    Raises ``BadArgument`` for a dead time much longer than the horizon, ``NotConverged`` where the verdict cannot be settled.
    """
    longest = float(system.wire_delay.max(initial=0.0))
    if system.horizon < longest / LONGEST:
        raise BadArgument("horizon", system.horizon, f"at least {longest / LONGEST:g} s, a twentieth of the dead time")
    points, radius = delayed_points(system), system.radius
    every = stacked(points)
    circling = np.flatnonzero(in_a_loop(every))
    looped, some = every.some(circling), [points[i] for i in circling]
    counts = dict(zip(circling.tolist(), _counted(looped, some, radius), strict=True))
    discs: list[int | NotConverged] = disc_counts(looped, np.full(len(some), radius)) if some and radius else [0] * len(some)
    slow = dict(zip(circling.tolist(), discs, strict=True))
    return [_verdict(system, known, i, point, counts[i], slow[i]) if i in counts else _outside(system, known, i) for i, point in enumerate(points)]


def _outside(system: OpenSystem, known: Spectrum, index: int) -> DelayedVerdict:
    """The verdict where no dead time lies in a loop."""
    part, nx, roots = known.parts(index), system.nx, known.rates[index][known.slow[index]]
    motion = np.zeros((nx, nx)) if part is None else part.slow.moves(system.horizon)
    return DelayedVerdict(roots.size, bool(known.decays[index]), roots.size < nx - system.registers, roots, motion, np.zeros(0))


def _verdict(system: OpenSystem, known: Spectrum, index: int, point: Delayed, counted: tuple[int, Array], slow: int | NotConverged) -> DelayedVerdict:
    nx, (unstable, walk) = system.nx, counted
    if isinstance(slow, NotConverged):
        if not unstable:
            raise slow
        slow = int(known.slow[index].sum())  # the verdict is settled; how many are slow is known without dead time only
    slow_roots, motion = slow_part(point, system.radius, slow) if slow else (np.zeros(0, np.complex128), np.zeros((nx, nx)))
    return DelayedVerdict(slow, not unstable, bool(not system.dt or slow < nx - system.registers), slow_roots, motion, walk)


def unstable_count(point: Delayed, radius: float) -> int:
    """The number of unstable roots that are not slow, or, where one is easily found, at least one. Raises ``NotConverged``."""
    return _counted(point.alone, [point], radius)[0][0]


def _counted(every: Stacked, points: list[Delayed], radius: float) -> list[tuple[int, Array]]:
    """That number of each point, and the frequencies [rad/s] of the count along the axis."""
    surely = 1, np.zeros(0)
    some = np.flatnonzero([point.strongest_direct < CERTAINLY for point in points])
    found = iter(unstable_counts(every.some(some), radius, FEW) if some.size else [])
    out, last = [], np.zeros(0, np.complex128)
    for point in points:
        count = surely if point.strongest_direct >= CERTAINLY else next(found)
        if isinstance(count, NotConverged):  # a long contour: a root that is easily found saves it
            root = some_unstable(point, radius, last)
            count, last = (unstable_roots(point, radius), last) if root is None else (surely, np.array([root]))
        out.append((count.number, count.axis.s.imag) if isinstance(count, Count) else count)
    return out


def some_unstable(point: Delayed, radius: float, near: Complex) -> complex | None:
    """A root in the unstable region, proved by the winding about it: close to ``near`` (k,), those of a similar loop, or else near a place at which
    an eigenvalue of E G is above one. None where none is found."""
    for s in (root for search in (partial(_polished, point, near), partial(chain, point)) for root in search()[:TRIED]):
        size = min(0.5 * s.real, 0.5 / float(point.T.max()))
        if abs(s) - size <= radius:
            continue
        try:
            if roots_within(point, size, s):
                return complex(s)
        except NotConverged:
            continue
    return None


def chain(point: Delayed) -> Complex:
    """Approximate unstable roots, rightmost first: s = jw + log(lambda) / T, lambda the eigenvalues of E G, then Newton."""
    T, places = float(point.T.max()), point.places
    even = np.geomspace(0.3 / T, max(1e2 * float(np.abs(places).max()), 3 / T), 160)
    beside = _apart(np.abs(places.imag), SAME / T)[:, None] + np.pi / T * BESIDE
    w = np.unique(np.concatenate([even, beside.ravel()])).astype(float)
    w = w[(w >= 0.3 / T) & (w * point.dt < np.pi)]
    with np.errstate(all="ignore"):
        s = np.asarray((1j * w[:, None] + np.log(_eigenvalues(point, on_axis(w))) / T).ravel(), np.complex128)
        step = np.full(s.shape, np.inf, np.complex128)
        for k in range(NEWTON):
            s = s[np.isfinite(s) & (s.real > -1 / T) & (s.real * T < MOST_GROWTH) & (s.imag > 0)]
            if not s.size:
                return s
            s = s[np.unique(np.round(s * T / SAME), return_index=True)[1]]
            if k < 3:
                found = _eigenvalues(point, s)
                step = np.asarray(-np.log(found[np.arange(s.size), np.abs(np.log(found)).argmin(axis=1)]) / T, np.complex128)
            else:
                step = _newton_step(point, s)
            s = np.asarray(s - step, np.complex128)
    s = _unstable(s, step)
    return np.asarray(s[np.concatenate([[True], np.abs(np.diff(s)) > 1e-9 * np.abs(s[1:])])] if s.size else s, np.complex128)


def _polished(point: Delayed, near: Complex) -> Complex:
    """Unstable roots by Newton from ``near`` (k,)."""
    s, step = near, np.zeros(near.shape, np.complex128)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON if near.size else 0):
            step = _newton_step(point, s)
            s = np.asarray(s - step, np.complex128)
    return _unstable(s, step)


def _newton_step(point: Delayed, s: Complex) -> Complex:
    return np.asarray(1 / point.value(s, np.zeros(0, np.complex128))[1], np.complex128)


def _unstable(s: Complex, step: Complex) -> Complex:
    """Of the ends (k,) of a search and its last steps: those that have settled at an unstable root, rightmost first."""
    s = s[np.isfinite(s) & (s.real > NARROW * np.abs(s)) & (s.imag > 0) & (np.abs(step) < 1e-3 * s.real)]
    return np.asarray(s[np.argsort(-s.real)], np.complex128)


def _apart(x: Array, gap: float) -> Array:
    """Values of x, once where they are the same to within ``gap``."""
    return np.asarray(np.unique(np.round(x / gap)) * gap)


def _eigenvalues(point: Delayed, s: Complex) -> Complex:
    """(k, nd) eigenvalues of E G at s (k,)."""
    return np.asarray(np.linalg.eigvals(point.gain(s) * np.exp(-s[:, None] * point.T)[:, :, None]), np.complex128)
