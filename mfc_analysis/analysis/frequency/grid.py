r"""H_i = S_i - 1 on a grid of frequencies, with what it may do between them and above them.

Between two frequencies a distance h apart H deviates from its chord by at most h^2/4 times ``bend``. Above all poles, with u = 1/w,

.. math:: H(jw) = H_0 - j m_0 u - m_1 u^2 + j m_2 u^3 + m_3 u^4 - \dots, \qquad m_k = c A^k b

and for w of at least twice the fastest pole what follows the first K terms is at most 2 u^(K+1) sum |r| |s|^K. Where the first terms decide, no
frequency above needs a look, whatever the relative degree of the loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.frequency.resolvent import Resolvent
from mfc_analysis.maths.arrays import Array, Complex, Ints

MOMENTS = 7
LEVELS = 9  #: octaves above twice the fastest pole in which the end of the search for a peak is placed
CHUNK = 64  #: points at a time


@dataclass(frozen=True, eq=False)
class Grid:
    """m points, n channels, k increasing frequencies of each point."""

    found: Resolvent
    w: Array  #: (m, k) [rad/s]
    H: Complex  #: (m, n, k)
    bend: Array  #: (m, n, k - 1) bound of abs(H'')/2 over each step; 0 of points without modes

    def some(self, index: Ints) -> Grid:
        """The same at some of the points."""
        if index.size == len(self.w):
            return self
        return Grid(self.found.some(index), self.w[index], self.H[index], self.bend[index])

    def real_end(self) -> Array:
        """(m, n) [rad/s] above which Im H is not zero; inf where this is not known. Of points with modes.

        With 2 p + 1 the first odd power of u that is there: abs(m_2p) > abs(m_2p+2) u^2 + 2 u^4 sum |r| |s|^(2 p + 4).
        """
        m = self._moments()
        end, settled = np.full(m[0].shape, np.inf), np.zeros(m[0].shape, bool)
        for p in range(MOMENTS // 2):
            first, second, rest = np.abs(m[2 * p]), np.abs(m[2 * p + 2]), 2 * self._sum(2 * p + 4)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                w = np.sqrt((second + np.sqrt(second**2 + 4 * rest * first)) / (2 * first))
            some = ~settled & (first > 0)
            end[some], settled = w[some], settled | some
        return np.maximum(np.where(np.isfinite(end), end, np.inf), 2 * self._fastest())

    def peak_end(self, most: Array) -> Array:
        """(m, n) [rad/s] above which abs(1 + H) is at most ``most`` (m, n), at least abs(1 + H_0); inf where this is not known.

        With five moments the square of abs(1 + H), less that at infinity, is u^2 (a + b u^2 + ...), and where it is small enough so it is above.
        """
        S0 = 1 + self.found.ch.H0
        m0, m1, m2, m3, m4 = self._moments()[:5, :, :, None]
        s0, rest = S0[..., None], 2 * self._sum(5)[..., None]
        ends = 2 * self._fastest()[..., None] * 2.0 ** np.arange(LEVELS)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            v = 1 / ends**2
            terms = m0**2 - 2 * s0 * m1, m1**2 - 2 * m0 * m2 + 2 * s0 * m3, m2**2 - 2 * m1 * m3 + 2 * m0 * m4, m3**2 - 2 * m2 * m4, m4**2
            over = terms[0] + sum(np.abs(term) * v ** (k + 1) for k, term in enumerate(terms[1:]))
            size = np.abs(s0) + sum(np.abs(m) * v ** ((k + 1) / 2) for k, m in enumerate((m0, m1, m2, m3, m4)))
            left = rest * v**3
            below = v * over + 2 * left * (size + left) <= (most**2 - S0**2)[..., None]
        first = below.argmax(axis=2)
        return np.where(below.any(axis=2), np.take_along_axis(np.broadcast_to(ends, below.shape), first[..., None], 2)[..., 0], np.inf)

    def _moments(self) -> Array:
        """(MOMENTS, m, n) c A^k b."""
        ch = self.found.ch
        left, out = ch.C, []
        for _ in range(MOMENTS):
            out.append((left * np.swapaxes(ch.B, 1, 2)).sum(axis=2))
            left = left @ ch.A
        return np.stack(out)

    def _sum(self, power: int) -> Array:
        """(m, n) sum |r| |s|^power."""
        return np.asarray((np.abs(self.found.residues) @ (np.abs(self.found.poles) ** power)[:, :, None])[..., 0])

    def _fastest(self) -> Array:
        """(m, 1)."""
        return np.asarray(np.abs(self.found.poles).max(axis=1, keepdims=True))


def on_grid(found: Resolvent, w: Array) -> Grid:
    """H on the increasing frequencies w (m, k) [rad/s]."""
    bend = np.zeros((*found.ch.H0.shape, w.shape[1] - 1))
    modal = np.flatnonzero(found.modal)
    for k in range(0, modal.size, CHUNK):
        some = modal[k : k + CHUNK]
        bend[some] = np.abs(found.residues[some]) @ inverse_cubes(found.poles[some], w[some, :-1], w[some, 1:])
    return Grid(found, w, found.on(w), bend)


def inverse_cubes(poles: Complex, a: Array, b: Array) -> Array:
    """1/d^3 (m, nx, k) of poles (m, nx) from the segments j[a, b], (m, k) each."""
    height = poles.imag[:, :, None]
    away = np.maximum(np.maximum(a[:, None, :] - height, height - b[:, None, :]), 0.0)
    square = away * away + (poles.real**2)[:, :, None]
    return np.asarray(1 / (square * np.sqrt(square)))
