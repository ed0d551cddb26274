"""How many characteristic roots lie in a region: the winding of the characteristic function along its edge.

With g = f / prod(s - c), c stable and of the order of f, g goes to 1 far away in the right half plane. The number of roots right of Nyquist's
contour, which is indented at the origin by the arc abs(s) = radius, is the winding of g along it. By symmetry half of it is enough:

    s = radius (real)  --arc-->  j radius  --axis-->  j w_end.

The samples are refined until on each step g changes by less than a quarter turn and the step is shorter than abs(g / g'), which near m roots
at the distance d is d/m: no root slips through. Where every loop gain is surely below one, det(I - E G) stays in the right half plane and
its phase is known however fast e^(-jwT) turns; the contour ends where this holds for good.

The contours of all points of a linearisation are refined together. Each step is tested once: one that passes is left behind.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.delay.characteristic import Delayed
from mfc_analysis.analysis.delay.grid import apart, between
from mfc_analysis.analysis.delay.stacked import Stacked
from mfc_analysis.analysis.frequency.peak import thinned
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

MOST = 60_000  #: samples of one contour
CONTRACTS = 0.8  #: loop gain below which the phase of det(I - E G) is known; nearer to one where the direct gain is larger
FROM_POLES = 2.5  #: times 1 - that gain and the distance from the poles of G: the longest step between two samples on which it stays below one
NARROW = 1e-10  #: relative step at which a root lies on the contour
STILL = 1e-13  #: of the fastest place: a root below it is 0 but for rounding, and unstable
LADDER = 12  #: first samples in a decade, where there are no others
SPARSE = 3  #: above all poles G has no features: one of so many samples is enough to see whether the loop gain falls
NUDGES = (1.0, 1 + 3e-4, 1 - 3e-4)  #: factors of the radius, tried in turn where a root lies on the circle
AROUND = np.array([-1.0, 1.0])  #: first samples around a pole, in units of its distance from the axis; never on a pole
LEAST = 1e-3  #: of that distance, as a fraction of its modulus

Found = TypeVar("Found")


class Walk(NamedTuple):
    """The samples along a part of the contour of one point."""

    s: Complex  #: (k,)
    turn: float  #: [rad] by which the phase of g changes
    on_it: Complex  #: roots on the contour, up to rounding


class Count(NamedTuple):
    """The unstable roots of one point."""

    number: int  #: with a real part above zero and abs(s) >= radius, roots on the axis included
    axis: Walk  #: along the axis


def unstable_roots(point: Delayed, radius: float, most: int = MOST) -> Count:
    """The number of roots with a real part above zero and abs(s) >= ``radius`` [1/s], roots on the axis included; and the walk along the axis.

    Raises ``NotConverged`` where the contour takes more than ``most`` samples.
    """
    return _only(unstable_counts(point.alone, radius, most))


def roots_within(point: Delayed, radius: float, center: complex = 0.0, most: int = MOST) -> int:
    """The number of roots in the disc abs(s - center) < ``radius`` [1/s]. Raises ``NotConverged``."""
    return _only(disc_counts(point.alone, np.array([radius]), center, most))


def _only(found: list[Found | NotConverged]) -> Found:
    (one,) = found
    if isinstance(one, NotConverged):
        raise one
    return one


def unstable_counts(points: Stacked, radius: float, most: int = MOST) -> list[Count | NotConverged]:
    """``unstable_roots`` of each point; where it does not converge: why not."""
    m, poles = len(points.A), _mirrored(points)
    edge, inner = np.full(m, radius), np.zeros(m)
    found: list[Count | NotConverged | None] = [None] * m
    if not radius:
        size = np.abs(points.places)
        edge = np.maximum(1e-9 * np.nanmin(size, axis=1), STILL * np.nanmax(size, axis=1))
        for i, one in enumerate(disc_counts(points, edge, 0.0, most)):
            if isinstance(one, NotConverged):
                found[i] = one
            else:
                inner[i] = one
    arcs, edge = _circles(points, poles, edge, np.pi / 2, 0.0, most)
    for i, arc in enumerate(arcs):
        if isinstance(arc, NotConverged) and found[i] is None:
            found[i] = arc
    some = np.array([i for i in range(m) if found[i] is None], np.int64)
    axes = dict(zip(some.tolist(), _along_axis(points, poles, edge, some, most), strict=True))
    beyond = _beyond(points, poles, {i: axis.s[-1] for i, axis in axes.items() if isinstance(axis, Walk)})
    for i, axis in axes.items():
        arc = arcs[i]
        if isinstance(axis, Walk) and isinstance(arc, Walk):
            number = axis.on_it.size or _whole(-(arc.turn + axis.turn + beyond[i]) / np.pi + float(inner[i]))
            found[i] = number if isinstance(number, NotConverged) else Count(number, axis)
        else:
            found[i] = axis if isinstance(axis, NotConverged) else None
    return [one for one in found if one is not None]


def _beyond(points: Stacked, poles: Complex, last: dict[int, complex]) -> dict[int, float]:
    """[rad] by which the phase of g changes from the ``last`` places on the axis to infinity."""
    if points.dt or not last:
        return dict.fromkeys(last, 0.0)
    at, end = np.array(list(last), np.int64), np.array(list(last.values()), np.complex128)
    turn = _principal(points.loop(at, end)) + (np.angle(end[:, None] - points.open_poles[at]) - np.angle(end[:, None] - poles[at])).sum(axis=1)
    return dict(zip(last, (-turn).tolist(), strict=True))


def disc_counts(points: Stacked, radius: Array, center: complex = 0.0, most: int = MOST) -> list[int | NotConverged]:
    """``roots_within`` the circle of ``radius`` (m,) of each point; where it does not converge: why not."""
    last = 2 * np.pi if center.imag else np.pi
    found, _ = _circles(points, np.zeros((len(points.A), 0), np.complex128), radius, last, center, most)
    return [one if isinstance(one, NotConverged) else _whole(one.turn / last) for one in found]


def _circles(points: Stacked, poles: Complex, radius: Array, last: float, center: complex, most: int) -> tuple[list[Walk | NotConverged], Array]:
    """The walk of each point along its circle about ``center`` from the angle 0 to ``last``, and the radius, nudged where a root lies on it."""
    m, radius = len(points.A), radius.copy()
    found: list[Walk | NotConverged] = [_unsettled(f"a root lies on the circle of {one:.4g} 1/s") for one in radius]
    left, wanted = np.arange(m), radius.copy()
    for nudge in NUDGES:
        radius[left] = nudge * wanted[left]
        u = np.broadcast_to(np.linspace(0, last, 17), (left.size, 17)) if center else _angles(points, radius, left, last)
        path = _Circle(center, radius)
        walks = _walked(points, poles, path, *_flat(left, u), most)
        again = []
        for i in left.tolist():
            walk = walks[i]
            if isinstance(walk, Walk) and walk.on_it.size:
                again.append(i)
            else:
                found[i] = walk
        left = np.array(again, np.int64)
        if not left.size:
            break
    return found, radius


def _whole(count: float) -> int | NotConverged:
    if not np.isfinite(count) or abs(count - round(count)) > 0.1 or count < -0.5:
        return _unsettled(f"the winding number {count:.3f} is no whole number")
    return round(count)


def _unsettled(reason: str) -> NotConverged:
    return NotConverged("the number of unstable roots with dead time is not settled", reason)


def _mirrored(points: Stacked) -> Complex:
    """(m, nx) the poles without dead time, each in the left half plane (inside the unit circle) and not too close to its edge."""
    c = points.closed_poles
    if points.dt:
        size = np.maximum(np.abs(c), 1e-12)
        size = np.where(size > 1, 1 / size, size)
        return np.asarray(c / np.maximum(np.abs(c), 1e-12) * np.minimum(size, 0.98), np.complex128)
    least = 1e-3 * np.nanmin(np.abs(points.places), axis=1, keepdims=True)
    return np.asarray(-np.maximum(np.abs(c.real), np.maximum(0.1 * np.abs(c), least)) + 1j * c.imag, np.complex128)


def _flat(index: Ints, u: Array) -> tuple[Ints, Array]:
    """The point and the value of each of the different values in the rows of u (p, k), in increasing order; NaN: none."""
    u = np.sort(u, axis=1)
    new = np.isfinite(u)
    new[:, 1:] &= np.diff(u, axis=1) != 0
    return np.repeat(index, new.sum(axis=1)), u[new]


def _within(u: Array, low: Array | float, high: Array | float) -> Array:
    """u, NaN where it is not between ``low`` and ``high``."""
    with np.errstate(invalid="ignore"):
        return np.where((u >= low) & (u <= high), u, np.nan)


def _angles(points: Stacked, radius: Array, some: Ints, last: float) -> Array:
    """(p, k) first angles on an arc about zero: even ones, and around each root that lies near it."""
    s, r = points.places[some], radius[some, None]
    with np.errstate(invalid="ignore"):
        s = np.where((np.abs(s) < 3 * r) & (np.abs(s) > 0.3 * r), s, np.nan)
    s = s[:, np.isfinite(s).any(axis=0)]
    gap = np.abs(np.abs(s) / r - 1) + LEAST
    near = np.abs(np.angle(s))[..., None] + gap[..., None] * AROUND
    even = np.broadcast_to(np.linspace(0, last, 9), (len(s), 9))
    return _within(np.concatenate([even, near.reshape(len(s), -1)], axis=1), 0, last)


def _along_axis(points: Stacked, poles: Complex, edge: Array, some: Ints, most: int) -> list[Walk | NotConverged]:
    """The walks of ``some`` points from j ``edge`` up the axis."""
    if not some.size:
        return []
    s = points.places[some]
    low = edge[some, None]
    high = np.full(low.shape, np.pi / points.dt) if points.dt else np.maximum(1e3 * np.nanmax(np.abs(s), axis=1, keepdims=True), low)
    s = apart(np.asarray(s.real + 1j * np.abs(s.imag), np.complex128))
    around = np.abs(s.imag)[..., None] + np.maximum(np.abs(s.real), LEAST * np.abs(s))[..., None] * AROUND
    w = _within(np.concatenate([around.reshape(len(s), -1), 1.01 * np.abs(s)], axis=1), low, high)
    w = thinned(np.sort(np.concatenate([low, np.where(np.isnan(w), high, w), high], axis=1), axis=1), s)
    ladder = _within(np.exp(between(np.log(w), np.full(len(w), np.log(10) / LADDER))), low, high)
    owner, w = _flat(some, np.concatenate([w, ladder], axis=1))
    if points.dt:
        walks = _walked(points, poles, _Axis(), owner, w, most)
        return [walks[i] for i in some.tolist()]
    owner, w, refused = _until_contracting(points, owner, w)
    walks = _walked(points, poles, _Axis(), owner, w, most, leaps=True)
    return [refused.get(i) or walks[i] for i in some.tolist()]


def _contracts(points: Stacked) -> Array:
    """(m,) the loop gain from which on the phase is not known: ``CONTRACTS``, or halfway from a larger direct gain to one."""
    direct = points.contraction(points.D.astype(np.complex128)) if points.D.any() else np.zeros(len(points.A))
    return np.where(direct < 1, np.maximum(CONTRACTS, 0.5 * (1 + direct)), CONTRACTS)


def _until_contracting(points: Stacked, owner: Ints, w: Array) -> tuple[Ints, Array, dict[int, NotConverged]]:
    """The frequencies to well above every pole and up to where the loop gain is below one for good; more are added where it is not at the last.

    And the points where it never is.
    """
    limit, top = _contracts(points), 3 * np.nanmax(np.abs(points.places), axis=1)
    parts, done = {int(i): w[owner == i] for i in np.unique(owner)}, {}
    for _ in range(12):
        above = {i: int(np.searchsorted(one, top[i])) for i, one in parts.items()}
        tails = [one[max(above[i] - 1, 0) :: SPARSE] for i, one in parts.items()]  # those below make no difference
        at = np.repeat(np.array(list(parts), np.int64), [tail.size for tail in tails])
        loud = ~points.contracts(points.gain(at, on_axis(np.concatenate(tails))), limit[at])
        further = {}
        for i, part in zip(list(parts), np.split(loud, np.cumsum([tail.size for tail in tails])[:-1]), strict=True):
            one = parts[i]
            last = max(above[i], max(above[i] - 1, 0) + SPARSE * (int(np.flatnonzero(part)[-1]) + 1) + 1 if part.any() else 2)
            if last < one.size:
                done[i] = one[: last + 1]
            else:
                further[i] = np.concatenate([one, one[-1] * np.geomspace(1, 1e3, 3 * LADDER)[1:]])
        parts = further
        if not parts:
            break
    order = sorted(done)
    refused = {i: _unsettled("the loop gain does not fall below one at high frequency") for i in parts}
    w = np.concatenate([done[i] for i in order]) if order else np.zeros(0)
    return np.repeat(np.array(order, np.int64), [done[i].size for i in order]), w, refused


class _Axis:
    """s = j u."""

    def __call__(self, at: Ints, u: Array) -> tuple[Complex, Complex]:
        """s and ds/du of the points ``at`` (k,) at u (k,)."""
        return on_axis(u), np.full(u.size, 1j, np.complex128)

    def narrow(self, at: Ints, u: Array) -> Array:
        """(k,) step to u at which a root lies on the contour."""
        return NARROW * np.abs(u)


@dataclass(frozen=True, eq=False)
class _Circle:
    """s = center + radius e^(j u)."""

    center: complex
    radius: Array  #: (m,)

    def __call__(self, at: Ints, u: Array) -> tuple[Complex, Complex]:
        out = self.radius[at] * np.exp(1j * u)
        return np.asarray(self.center + out, np.complex128), np.asarray(1j * out, np.complex128)

    def narrow(self, at: Ints, u: Array) -> Array:
        return NARROW / np.maximum(1.0, abs(self.center) / self.radius[at])


@dataclass(eq=False)
class _Samples:
    """Samples of g along the contours of several points, in the order in which they were taken."""

    at: Ints = field(default_factory=lambda: np.zeros(0, np.int64))  #: (k,) point
    u: Array = field(default_factory=lambda: np.zeros(0))
    s: Complex = field(default_factory=lambda: np.zeros(0, np.complex128))
    phase: Array = field(default_factory=lambda: np.zeros(0))
    rate: Complex = field(default_factory=lambda: np.zeros(0, np.complex128))  #: (dg/du) / g
    gap: Array = field(default_factory=lambda: np.zeros(0))  #: distance from the poles of G
    asked: Bools = field(default_factory=lambda: np.zeros(0, bool))  #: whether the loop gain is known to be low, or not
    calm: Bools = field(default_factory=lambda: np.zeros(0, bool))  #: it is low

    def add(self, **more: NDArray[Any]) -> Ints:
        """The indices of new samples."""
        first = self.u.size
        for name, values in more.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))
        return np.arange(first, self.u.size)


def _walked(
    points: Stacked, poles: Complex, path: _Axis | _Circle, owner: Ints, u: Array, most: int, leaps: bool = False
) -> dict[int, Walk | NotConverged]:
    """The walks of the points ``owner`` (k,) along ``path``, from its samples u (k,), which increase for each point, refined.

    ``leaps``: a step on which the loop gain is surely low passes however fast the phase turns.
    """
    known = _Samples()

    def take(at: Ints, u: Array) -> Ints:
        s, ds = path(at, u)
        phase, rate = points.value(at, s, poles)
        gap = np.abs(s[:, None] - points.open_poles[at]).min(axis=1, initial=np.inf) if leaps else np.zeros(u.size)
        new = np.zeros(u.size, bool)
        return known.add(at=at, u=u, s=s, phase=phase, rate=rate * ds, gap=gap, asked=new, calm=new)

    limit = _contracts(points) if leaps else np.ones(len(points.A))
    every = take(owner, u)
    inside = np.flatnonzero(np.diff(owner) == 0)
    left, right = every[inside], every[inside + 1]
    turns, roots, leapt = np.zeros(len(points.A)), [np.zeros(0, np.int64)], [np.zeros((2, 0), np.int64)]
    refused: dict[int, NotConverged] = {}
    while left.size:
        at, step = known.at[left], known.u[right] - known.u[left]
        turn = np.angle(np.exp(1j * (known.phase[right] - known.phase[left])))
        before, after = known.rate[left], known.rate[right]
        with np.errstate(invalid="ignore", over="ignore"):
            predicted = 0.5 * step * (before + after).imag
            fine = (step * np.maximum(np.abs(before), np.abs(after)) <= 1) & (np.abs(turn) <= np.pi / 4) & (np.abs(turn - predicted) <= 0.3)
        leap = ~fine & (step <= FROM_POLES * (1 - limit[at]) * np.minimum(known.gap[left], known.gap[right])) if leaps else np.zeros(fine.shape, bool)
        ask = np.unique(np.concatenate([left[leap], right[leap]]))
        ask = ask[~known.asked[ask]]
        if ask.size:
            known.calm[ask], known.asked[ask] = points.contracts(points.loop(known.at[ask], known.s[ask]), limit[known.at[ask]]), True
        leap &= known.calm[left] & known.calm[right]
        narrow = step <= path.narrow(at, known.u[right])
        np.add.at(turns, at[fine], turn[fine])
        leapt.append(np.stack([left[leap], right[leap]]))
        roots.append(left[narrow & ~fine & ~leap])
        bad = np.flatnonzero(~(fine | leap | narrow))
        taken = np.bincount(known.at, minlength=len(turns)) + np.bincount(at[bad], minlength=len(turns))
        for i in np.flatnonzero(taken > most).tolist():
            refused.setdefault(i, _unsettled(f"the contour takes more than {most} samples: dead time x fastest frequency of the loop is too large"))
        bad = bad[taken[at[bad]] <= most]
        left, right = left[bad], right[bad]
        middle = take(known.at[left], 0.5 * (known.u[left] + known.u[right])) if bad.size else left
        left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
    start, end = np.concatenate(leapt, axis=1)
    np.add.at(turns, known.at[start], _known(points, poles, known, end) - _known(points, poles, known, start))
    crossed = np.concatenate(roots)
    order = np.lexsort((known.u, known.at))
    edges = np.searchsorted(known.at[order], np.arange(len(turns) + 1))
    found: dict[int, Walk | NotConverged] = {}
    for i in np.unique(owner).tolist():
        mine = order[edges[i] : edges[i + 1]]
        on_it = crossed[known.at[crossed] == i]
        found[i] = refused[i] if i in refused else Walk(known.s[mine], float(turns[i]), _merged(known.s[on_it[np.argsort(known.u[on_it])]]))
    return found


def _known(points: Stacked, poles: Complex, known: _Samples, which: Ints) -> Array:
    """[rad] phase of g at samples where the loop gain is low, without jumps along the axis."""
    at, s = known.at[which], known.s[which]
    if not which.size:
        return np.zeros(0)
    return _principal(points.loop(at, s)) + _continuous(s, points.open_poles[at]) - _continuous(s, poles[at])


def _principal(loop: Complex) -> Array:
    """(k,) [rad] sum of the phases of the eigenvalues of I - E G, each within a quarter turn where the loop gain is below one."""
    return np.asarray(np.angle(1 - np.linalg.eigvals(loop)).sum(axis=1))


def _continuous(s: Complex, poles: Complex) -> Array:
    """(k,) [rad] sum of the phases of s - pole along the axis, without jumps; poles (k, p)."""
    gap = s[:, None] - poles
    right = poles.real > 0
    return np.asarray(np.where(right, -np.arctan2(gap.imag, -gap.real), np.arctan2(gap.imag, gap.real)).sum(axis=1))


def _merged(roots: Complex) -> Complex:
    """Roots on the contour, each once."""
    if not roots.size:
        return roots
    new = np.concatenate([[True], np.abs(np.diff(roots)) > 1e-6 * np.abs(roots[1:])])
    return np.asarray(roots[new])
