"""The response y(t) = steady + Re sum_j g_j exp(T_j t) v_j of decoupled modes, in sections that follow its time scales.

A mode that has died away is left behind, and the sections grow to the fastest of those that are left; on each of them y is the quintic of
its value, slope and curvature at both ends (error below 1e-9 of the modes' size). A sampled loop has I + dt T_j in the place of
exp(T_j dt), and y is held from sample to sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np
from scipy.linalg import block_diag, expm

from mfc_analysis.analysis.modes import Mode
from mfc_analysis.analysis.step_run import Piece
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Complex

FRACTION = 0.125  #: length of a section times the fastest rate of the modes alive
DEAD = 1e-13  #: of the largest: a mode below this has died away
LONGEST = 4096  #: sections of a piece
MOST = 2_000_000_000  #: sections of a response
FEW = 64  #: pieces that need no bounds
GRID = np.geomspace(1e-2, 60.0, 120)  #: time constants at which the size of a defective mode is known
#: quintic on 0..1 from y, h y', h^2 y'' at its start and at its end
QUINTIC = np.array(
    [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0.5, 0, 0, 0], [-10, -6, -1.5, 10, -4, 0.5], [15, 8, 1.5, -15, 7, -1], [-6, -3, -0.5, 6, -3, 0.5]]
)


@dataclass(frozen=True, eq=False)
class Term:
    """g exp(T t) v of one mode."""

    T: Complex  #: (k, k) [1/s]
    g: Complex  #: (k,)
    v: Complex  #: (k,)
    dt: float = 0.0  #: [s] of a sampled loop

    @property
    def fastest(self) -> float:
        """[1/s]."""
        return float(np.abs(np.diag(self.T)).max())

    @property
    def decay(self) -> float:
        """[1/s] rate at which the slowest part dies away."""
        s = np.diag(self.T)
        with np.errstate(divide="ignore"):
            return -float(np.log(np.abs(1 + self.dt * s).max()) / self.dt if self.dt else s.real.max())

    @cached_property
    def size(self) -> float:
        """A bound of the order of the term at its start."""
        return float(np.linalg.norm(self.g) * np.linalg.norm(self.v))

    def over(self, time: float) -> Complex:
        """(k, k) exp(T time); the mean rate apart, so that nothing overflows."""
        if self.dt:
            return np.asarray(np.linalg.matrix_power(np.eye(len(self.T)) + self.dt * self.T, round(time / self.dt)))
        mean = np.diag(self.T).mean()
        rest = self.T - mean * np.eye(len(self.T))
        return np.asarray(np.exp(mean * time) * (expm(rest * time) if len(rest) > 1 else np.ones((1, 1))))

    def bound(self, times: Array) -> Array:
        """(k,) of its size from each of ``times`` [s], increasing, on."""
        if len(self.T) == 1:
            with np.errstate(invalid="ignore"):  # z = 0: no decay is too fast
                return np.asarray(self.size * np.where(times > 0, np.exp(-self.decay * times), 1.0))
        grid = np.append(0.0, max(1 / self.decay, self.dt) * GRID)
        steps = [self.over(t) for t in grid]
        most = 2 * max(float(np.linalg.norm(E, 2)) for E in steps)
        sizes = np.array([np.linalg.norm(self.g @ E) for E in steps]) * np.linalg.norm(self.v) * most
        return np.asarray(sizes[np.searchsorted(grid, times, side="right") - 1])

    def death(self, level: float) -> float:
        """[s] from which on the term is below ``level``."""
        if self.size <= level:
            return 0.0
        if len(self.T) == 1:
            return float(np.log(self.size / level) / self.decay)
        time = max(8 / self.decay, self.dt)
        E = self.over(time)
        for _ in range(64):
            if np.linalg.norm(self.g @ E) * np.linalg.norm(self.v) < level:
                break
            time, E = 2 * time, E @ E
        return time


@dataclass(frozen=True)
class _Phase:
    start: float
    step: float
    sections: int
    alive: tuple[int, ...]


class ModalPieces(Sequence[Piece]):
    """The pieces of a response, computed when they are asked for."""

    def __init__(self, terms: Sequence[Term], steady: float, dt: float = 0.0) -> None:
        """``terms`` all decay. Raises ``NotConverged`` where the response takes too many sections."""
        self.steady, self.dt = steady, dt
        largest = max((term.size for term in terms), default=0.0)
        self._terms = [term for term in terms if term.size > DEAD * largest]
        self._bounded = all(len(term.T) == 1 for term in self._terms)
        self._phases = self._planned([term.death(DEAD * largest) for term in self._terms])
        if sum(p.sections for p in self._phases) > MOST:
            raise NotConverged("the metrics of a step response are not settled", "it takes too many swings, or samples, to die away")
        self._where = [(p, k) for p, phase in enumerate(self._phases) for k in range(0, phase.sections, LONGEST)]
        self._rows: dict[int, Complex] = {}
        self._kept: dict[int, Piece] = {}

    def _planned(self, deaths: list[float]) -> list[_Phase]:
        if self.dt:  # those at z = 0 take a sample for each state
            sections = int(min(max(deaths, default=0.0) / self.dt, 10.0 * MOST)) + 1 + sum(len(term.T) for term in self._terms)
            return [_Phase(0.0, self.dt, sections, tuple(range(len(deaths))))] if deaths else []
        phases, start = [], 0.0
        alive = [j for j, death in enumerate(deaths) if death > 0]
        while alive:
            fastest = max(alive, key=lambda j: self._terms[j].fastest)
            left = deaths[fastest] - start
            step = FRACTION / self._terms[fastest].fastest
            if left > 1e-9 * step:
                sections = int(min(np.ceil(left / step), 10.0 * MOST))
                phases.append(_Phase(start, left / sections, sections, tuple(alive)))
            start = deaths[fastest]
            alive = [j for j in alive if deaths[j] > start]
        return phases

    @property
    def end(self) -> float:
        """[s] where the last mode has died away."""
        return self._phases[-1].start + self._phases[-1].step * self._phases[-1].sections if self._phases else 0.0

    @property
    def reach(self) -> Array:
        """(pieces,) bound of abs(y - steady) from the start of each piece on; inf for a few pieces of defective modes, all looked at."""
        starts = np.array([self._phases[p].start + k * self._phases[p].step for p, k in self._where])
        if len(starts) <= FEW and not self._bounded:
            return np.full(len(starts), np.inf)
        out = np.full(len(starts), 2 * DEAD * sum(term.size for term in self._terms))
        for term in self._terms:
            out += term.bound(starts)
        return out

    def __len__(self) -> int:
        return len(self._where)

    @overload
    def __getitem__(self, index: int) -> Piece: ...
    @overload
    def __getitem__(self, index: slice) -> list[Piece]: ...
    def __getitem__(self, index: int | slice) -> Piece | list[Piece]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if index not in self._kept:
            if len(self._kept) > 64:
                self._kept.clear()
            self._kept[index] = self._piece(*self._where[index])
        return self._kept[index]

    def _piece(self, p: int, first: int) -> Piece:
        phase = self._phases[p]
        count = min(LONGEST, phase.sections - first)
        start, h = phase.start + first * phase.step, phase.step
        terms = [self._terms[j] for j in phase.alive]
        if p not in self._rows:
            self._rows = {p: self._powers(terms, h, min(LONGEST, phase.sections) + 1)}
        state = np.concatenate([term.over(start) @ term.v for term in terms])
        t = np.asarray(start + h * np.arange(count + 1), float)
        if self.dt:
            return Piece(t, (self._rows[p][:count, :1] @ state).real + self.steady)
        y = (self._rows[p][: count + 1] @ state).real * [1.0, h, h * h]  # (count + 1, 3)
        y[:, 0] += self.steady
        return Piece(t, np.concatenate([y[:-1], y[1:]], axis=1) @ QUINTIC.T)

    @staticmethod
    def _powers(terms: list[Term], h: float, count: int) -> Complex:
        """(count, 3, k): rows that give y, y' and y'' after 0, 1, 2, ... sections from the state."""
        T = np.asarray(block_diag(*(term.T for term in terms)), np.complex128)
        g = np.concatenate([term.g for term in terms])
        power = np.asarray(block_diag(*(term.over(h) for term in terms)), np.complex128)
        rows = np.stack([g, g @ T, g @ T @ T])[None]
        while len(rows) < count:
            rows, power = np.concatenate([rows, rows @ power]), power @ power
        return rows[:count]


def term(mode: Mode, b: Array, c: Array, dt: float = 0.0) -> Term:
    """The part of a mode in c x after a unit step of x' = A x + b u; what it leaves behind at rest is -g v."""
    return Term(mode.T, np.asarray(c @ mode.right, np.complex128), np.asarray(np.linalg.solve(mode.T, mode.left @ b), np.complex128), dt)
