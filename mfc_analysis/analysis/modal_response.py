"""The responses y(t) = steady + Re sum_j f_j(t) a_j of decoupled modes, in sections that follow their time scales.

The part g exp(T t) v that a mode of k eigenvalues leaves in a response is f(t) a in Newton's form: f(t) (k,) is the first row of exp(J t),
J with the eigenvalues on its diagonal and the mode's rate above it, the same for all responses; a (k,) are their own.

A mode that has died away in all responses is left behind, and the sections grow to the fastest of those that are left; on each of them y is
the quintic of its value, slope and curvature at both ends (error below 1e-9 of the modes' size). A sampled loop has I + dt J in the place of
exp(J dt), and y is held from sample to sample.

Source: Higham, Functions of Matrices (2008), 4.3 (Newton's divided differences of exp).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import expm

from mfc_analysis.analysis.modes import Mode
from mfc_analysis.analysis.step_run import HELD, Piece
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Complex, Ints

FRACTION = 0.125  #: length of a section times the fastest rate of the modes alive
DEAD = 1e-13  #: of the largest: a mode below this has died away
LONGEST = 4096  #: sections of a piece
MOST = 2_000_000_000  #: sections of a response
VALUES = 1 << 18  #: of all responses in a piece
FEW = 64  #: pieces that need no bounds
KEPT = 8  #: pieces that are kept
GRID = np.geomspace(1e-2, 60.0, 120)  #: time constants at which the size of a defective mode is known
#: quintic on 0..1 from y, h y', h^2 y'' at its start and at its end
QUINTIC = np.array(
    [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0.5, 0, 0, 0], [-10, -6, -1.5, 10, -4, 0.5], [15, 8, 1.5, -15, 7, -1], [-6, -3, -0.5, 6, -3, 0.5]]
)


@dataclass(frozen=True, eq=False)
class Terms:
    """What modes of K eigenvalues in all leave in P responses: Re f(t) a. Modes of one eigenvalue come first."""

    rates: Complex  #: (K,) [1/s] diagonal of J
    above: Array  #: (K,) [1/s] J above it; 0 from one mode to the next
    a: Complex  #: (K, P)
    size: Array  #: (modes, P) a bound of the order of each mode's part at its start
    blocks: tuple[slice, ...]  #: (modes,) of the K
    dt: float = 0.0  #: [s] of a sampled loop

    def of(self, which: Ints) -> Terms:
        """The same modes in some of the responses."""
        return self if which.size == self.a.shape[1] else replace(self, a=self.a[:, which], size=self.size[:, which])

    @cached_property
    def starts(self) -> Ints:
        """(modes,) where each begins."""
        return np.array([block.start for block in self.blocks], int)

    @cached_property
    def alone(self) -> int:
        """Number of modes of one eigenvalue."""
        return sum(block.stop - block.start == 1 for block in self.blocks)

    @cached_property
    def fastest(self) -> Array:
        """(modes,) [1/s]."""
        return np.maximum.reduceat(np.abs(self.rates), self.starts)

    @cached_property
    def decay(self) -> Array:
        """(modes,) [1/s] rates at which their slowest parts die away."""
        return _decay(self.rates, self.starts, self.dt)

    def along(self, a: Complex) -> Complex:
        """J a."""
        out = self.rates[:, None] * a
        out[:-1] += self.above[:-1, None] * a[1:]
        return out

    def over(self, mode: int, time: float) -> Complex:
        """(k, k) exp(J time) of one mode; its slowest rate apart, so that nothing overflows."""
        at = self.blocks[mode]
        J = np.diag(self.rates[at]) + np.diag(self.above[at][:-1], 1)
        if self.dt:
            return np.asarray(np.linalg.matrix_power(np.eye(len(J)) + self.dt * J, round(time / self.dt)))
        slowest = self.rates[at][self.rates[at].real.argmax()]
        return np.asarray(np.exp(slowest * time) * expm((J - slowest * np.eye(len(J))) * time))

    def rows(self, modes: list[int], start: float, h: float, count: int) -> Complex:
        """(k, count): f of these modes at ``start`` and after 1, 2, ... sections of ``h``, by doubling."""
        k = int(np.searchsorted(modes, self.alone))
        s = self.rates[modes[:k]]
        first = [(1 + self.dt * s) ** round(t / self.dt) if self.dt else np.exp(s * t) for t in (start, h)]
        parts = [_doubled(first[0][:, None], first[1][:, None], count, np.multiply)]
        parts += [_doubled(self.over(mode, start)[0, :, None], self._section(mode, h).T, count, np.matmul) for mode in modes[k:]]
        return np.concatenate(parts)

    def _section(self, mode: int, h: float) -> Complex:
        """``over`` a section, whose length comes again in every piece of a phase."""
        if (mode, h) not in self._sections:
            self._sections[mode, h] = self.over(mode, h)
        return self._sections[mode, h]

    @cached_property
    def _sections(self) -> dict[tuple[int, float], Complex]:
        return {}

    def bounds(self, times: Array) -> Array:
        """(times, P) of their size from each of ``times`` [s], increasing, on."""
        with np.errstate(invalid="ignore"):  # z = 0: no decay is too fast
            out = np.where(times[:, None] > 0, np.exp(-self.decay[: self.alone] * times[:, None]), 1.0) @ np.abs(self.a[: self.alone])
        for mode in range(self.alone, len(self.blocks)):
            grid = np.append(0.0, max(1 / self.decay[mode], self.dt) * GRID)
            steps = [self.over(mode, t) for t in grid]
            most = 2 * max(float(np.linalg.norm(E, 2)) for E in steps)
            sizes = np.array([np.linalg.norm(E[0]) for E in steps]) * most
            out += np.multiply.outer(sizes[np.searchsorted(grid, times, side="right") - 1], np.linalg.norm(self.a[self.blocks[mode]], axis=0))
        return np.asarray(out)

    def deaths(self, level: Array) -> Array:
        """(modes,) [s] from which on each is below ``level`` (P,) in all responses."""
        times = np.log((self.size / np.where(level > 0, level, np.inf)).max(axis=1, initial=1.0)) / self.decay
        for mode in range(self.alone, len(self.blocks)):
            above = self.size[mode] > level
            if not above.any():
                continue
            time = max(8 / self.decay[mode], self.dt)
            E, a = self.over(mode, time), np.abs(self.a[self.blocks[mode]][:, above])
            for _ in range(64):
                if (np.abs(E[0]) @ a < level[above]).all():
                    break
                time, E = 2 * time, E @ E
            times[mode] = time
        return np.asarray(times)


def _decay(rates: Complex, starts: Ints, dt: float) -> Array:
    with np.errstate(divide="ignore"):
        return -np.maximum.reduceat(np.log(np.abs(1 + dt * rates)) / dt if dt else rates.real, starts)


def _doubled(first: Complex, power: Complex, count: int, times: Callable[..., Complex]) -> Complex:
    """(k, count) from ``first`` (k, 1), each the ``power`` times the one before."""
    out, done = np.empty((len(first), count), np.complex128), 1
    out[:, :1] = first
    while done < count:
        more = min(done, count - done)
        out[:, done : done + more] = times(power, out[:, :more])
        done, power = done + more, times(power, power)
    return out


def terms(modes: Sequence[Mode], b: Array, c: Array, dt: float = 0.0) -> Terms:
    """The modes in the responses c_p x (c: (P, nx)) to unit steps of x' = A x + b_p u (b: (nx, P)).

    The part of a mode starts at Re a of its first eigenvalue; what it leaves behind at rest is the negative of that.
    """
    modes = sorted(modes, key=lambda mode: len(mode.T) > 1)
    ends = np.cumsum([0, *(len(mode.T) for mode in modes)])
    blocks = tuple(slice(int(i), int(j)) for i, j in pairwise(ends))
    if not modes:
        return Terms(np.zeros(0, complex), np.zeros(0), np.zeros((0, len(c)), complex), np.zeros((0, len(c))), blocks, dt)
    rates = np.concatenate([np.diag(mode.T) for mode in modes])
    g, v = (c @ np.concatenate([mode.right for mode in modes], axis=1)).T, np.concatenate([mode.left for mode in modes]) @ b  # (K, P)
    above, a = np.zeros(len(rates)), g * v / rates[:, None]
    size = np.abs(g * v / rates[:, None])[ends[:-1]]
    decay = _decay(rates, ends[:-1], dt)
    for j, (mode, at) in enumerate(zip(modes, blocks, strict=True)):
        if (k := len(mode.T)) > 1:
            scale = decay[j] if np.isfinite(decay[j]) and decay[j] > 0 else 1 / dt if dt else 1.0
            above[at.start : at.stop - 1] = scale
            w = np.linalg.solve(mode.T, v[at])
            size[j] = np.linalg.norm(g[at], axis=0) * np.linalg.norm(w, axis=0)
            for i in range(k):
                a[at.start + i] = (g[at] * w).sum(axis=0)
                w = (mode.T @ w - rates[at.start + i] * w) / scale
    return Terms(rates, above, a, size, blocks, dt)


@dataclass(frozen=True)
class _Phase:
    start: float
    step: float
    sections: int
    alive: list[int]  #: modes, in their order


class ModalPieces:
    """The pieces of P responses with the same sections, computed when they are asked for."""

    def __init__(self, terms: Terms, steady: Array) -> None:
        """``terms`` all decay. Raises ``NotConverged`` where the responses take too many sections."""
        self._terms, self._steady, self._dt = terms, steady, terms.dt
        deaths = terms.deaths(DEAD * terms.size.max(axis=0, initial=0.0)) if terms.blocks else np.zeros(0)
        self._phases = self._planned(deaths)
        if sum(p.sections for p in self._phases) > MOST:
            raise NotConverged("the metrics of a step response are not settled", "it takes too many swings, or samples, to die away")
        self._longest = min(LONGEST, max(FEW, VALUES // steady.size))
        self._before = np.cumsum([0] + [p.sections for p in self._phases])  # sections before each phase
        self._derivatives = [terms.a]
        for _ in range(0 if self._dt else 2):
            self._derivatives.append(terms.along(self._derivatives[-1]))
        self._kept: dict[int, Piece] = {}

    def _planned(self, deaths: Array) -> list[_Phase]:
        terms = self._terms
        if self._dt:  # those at z = 0 take a sample for each state
            sections = int(min(deaths.max(initial=0.0) / self._dt, 10.0 * MOST)) + 1 + len(terms.rates)
            return [_Phase(0.0, self._dt, sections, list(range(len(deaths))))]
        phases, start = [], 0.0
        alive = np.flatnonzero(deaths > 0)
        while alive.size:
            fastest = alive[terms.fastest[alive].argmax()]
            left, step = float(deaths[fastest]) - start, FRACTION / float(terms.fastest[fastest])
            if left > 1e-9 * step:
                sections = int(min(np.ceil(left / step), 10.0 * MOST))
                phases.append(_Phase(start, left / sections, sections, alive.tolist()))
            start = float(deaths[fastest])
            alive = alive[deaths[alive] > start]
        return phases or [_Phase(0.0, 1.0, 1, [])]

    @property
    def end(self) -> float:
        """[s] where the last mode has died away."""
        return self._phases[-1].start + self._phases[-1].step * self._phases[-1].sections

    @property
    def reach(self) -> Array:
        """(pieces, P) bounds of abs(y - steady) from the start of each piece on; inf for a few pieces, all looked at."""
        if len(self) <= FEW and self._terms.alone < len(self._terms.blocks):
            return np.full((len(self), self._steady.size), np.inf)
        starts = np.array([self._start(k * self._longest) for k in range(len(self))])
        return np.asarray(self._terms.bounds(starts) + 2 * DEAD * self._terms.size.sum(axis=0))

    def _start(self, section: int) -> float:
        p = int(np.searchsorted(self._before, section, side="right")) - 1
        return self._phases[p].start + (section - int(self._before[p])) * self._phases[p].step

    def __len__(self) -> int:
        return -(-int(self._before[-1]) // self._longest)

    def piece(self, index: int, which: Ints | None = None) -> Piece:
        """Piece ``index`` of the responses ``which``; None: of all."""
        which = np.arange(self._steady.size) if which is None else which
        if len(self) > KEPT:
            return self._piece(index, which)
        if index not in self._kept:
            self._kept[index] = self._piece(index, np.arange(self._steady.size))
        return self._kept[index].of(which)

    def _piece(self, index: int, which: Ints) -> Piece:
        first = index * self._longest
        last = min(first + self._longest, int(self._before[-1]))
        times, ends = [], []
        for phase, before in zip(self._phases, self._before, strict=False):
            low, high = max(first - int(before), 0), min(last - int(before), phase.sections)
            if low < high:
                start = phase.start + low * phase.step
                times.append(start + phase.step * np.arange(high - low))
                ends.append(self._run(phase, start, high - low, which))
        times.append(np.array([self._start(last) if last < self._before[-1] else self.end]))
        return Piece(np.concatenate(times), np.concatenate(ends, axis=2), HELD if self._dt else QUINTIC)

    def _run(self, phase: _Phase, start: float, sections: int, which: Ints) -> Array:
        """(q, P, sections): what is known of each section, the values and their derivatives by h at its ends."""
        orders = len(self._derivatives)
        y = np.zeros((orders, which.size, sections + 1))
        if phase.alive:
            rows = self._terms.rows(phase.alive, start, phase.step, sections + 1)  # (k, sections + 1)
            entries = np.concatenate([np.arange(self._terms.blocks[j].start, self._terms.blocks[j].stop) for j in phase.alive])
            a = np.concatenate([phase.step**i * one[np.ix_(entries, which)] for i, one in enumerate(self._derivatives)], axis=1).T
            y = (np.hstack([a.real, -a.imag]) @ np.vstack([rows.real, rows.imag])).reshape(y.shape)
        y[0] += self._steady[which, None]
        return y[:, :, :-1] if self._dt else np.concatenate([y[:, :, :-1], y[:, :, 1:]])
