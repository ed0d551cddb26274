"""Evaluation of loops with dead time: m points of a loop with their delayed wires cut, each at many s, all in a few calls.

Rows of A with a single entry, as q' = v, leave the linear systems before these are solved: x_i' = a x_j without an input gives x_j = (s/a) x_i.
Along a chain of them every state is a power of s times the state at its start, and what remains of sI - A is a polynomial in s of smaller
matrices. Each entry that leaves is as exact as that of A from which it comes. The wires leave too: det(sI - A) det(I - E G) is one determinant
of M - B E N, which has no poles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

CHUNK = 40_000  #: complex numbers at a time: these stay in the cache
BESIDE = 1e-11  #: relative distance from a pole of G below which G is taken beside it
SURE = 1e-9  #: relative distance from a limit at which a bound of a spectral radius settles on which side of it the radius is
SMALLEST, LARGEST = 1e-250, 1e250  #: of a product whose phase is taken


@dataclass(frozen=True, eq=False)
class Stacked:
    """m points with their nd delayed wires cut and the others closed; states balanced. s (k,) belong to the points ``at`` (k,)."""

    A: Array  #: (m, nx, nx)
    B: Array  #: (m, nx, nd)
    C: Array  #: (m, nd, nx)
    D: Array  #: (m, nd, nd)
    T: Array  #: (m, nd) [s] > 0; those that are equal at one point are equal at all
    dt: float = 0.0  #: [s] 0: continuous

    def some(self, index: Ints) -> Stacked:
        """The points ``index`` (p,), in increasing order."""
        if len(index) == len(self.A):
            return self
        return Stacked(self.A[index], self.B[index], self.C[index], self.D[index], self.T[index], self.dt)

    @cached_property
    def open_poles(self) -> Complex:
        """(m, nx) poles of G: eigenvalues of A."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @cached_property
    def closed_poles(self) -> Complex:
        """(m, nx) poles of the loop without dead time."""
        back = np.linalg.solve(np.eye(self.T.shape[1]) - self.D, self.C) if self.D.any() else self.C
        return np.linalg.eigvals(self.A + self.B @ back).astype(np.complex128)

    @cached_property
    def places(self) -> Complex:
        """[rad/s] (m, 2 nx + nd) the poles with and without dead time in the s plane, and 1/T: where f has features. NaN: none (a pole at 0)."""
        s = rates(np.concatenate([self.open_poles, self.closed_poles], axis=1), self.dt)
        s = np.where(np.isfinite(s) & (s != 0), s, np.nan)
        return np.asarray(np.concatenate([s, 1 / self.T], axis=1), np.complex128)

    @cached_property
    def one_delay(self) -> bool:
        """True where all dead times of a point are equal: E is then a number."""
        return bool((np.ptp(self.T, axis=1) <= 1e-12 * self.T.max(axis=1)).all())

    @cached_property
    def _condensed(self) -> tuple[Array, Array, Array]:
        """M (d + 1, m, r, r), N (d + 1, m, nd, r) and B (m, r, nd) with G = N(z) M(z)^-1 B + D, M and N polynomials with these coefficients."""
        nx = self.A.shape[-1]
        follows = {} if self.dt else _chains(self.A, self.B)
        starts = np.setdiff1d(np.arange(nx), list(follows.values()))
        rows = np.setdiff1d(np.arange(nx), list(follows))
        row_of = {int(i): k for k, i in enumerate(rows)}
        terms: list[tuple[int, int, int, Array]] = []  # state, column, power of z, factor (m,)
        for column, start in enumerate(starts):
            state, power, factor = int(start), 0, np.ones(len(self.A))
            terms.append((state, column, power, factor))
            while state in follows:
                factor, power, state = factor / self.A[:, state, follows[state]], power + 1, follows[state]
                terms.append((state, column, power, factor))
        degree = max((power for _, _, power, _ in terms), default=0) + 1
        M, N = np.zeros((degree + 1, len(self.A), rows.size, starts.size)), np.zeros((degree + 1, *self.D.shape[:2], starts.size))
        for state, column, power, factor in terms:
            M[power, :, :, column] -= factor[:, None] * self.A[:, rows, state]
            N[power, :, :, column] += factor[:, None] * self.C[:, :, state]
            if state in row_of:
                M[power + 1, :, row_of[state], column] += factor
        return M, N, self.B[:, rows]

    @cached_property
    def _characteristic(self) -> tuple[Array, Array, Array]:
        """The different dead times T (m, u), P (m, (u + 1) (d + 1), q q) and o (m,) of f = o det F, o = 1 or -1.

        F = [[M, -B], [-E N, I - E D]], without a direct term M - B E N, is the sum of P with the factors z^0 .. z^d and e^(-s T_j) z^0 .. z^d.
        """
        M, N, B = self._condensed
        kinds, kind = np.unique(self.T, axis=1, return_inverse=True)
        r, direct = M.shape[2], bool(self.D.any())
        q = r + self.T.shape[1] if direct else r
        P = np.zeros((kinds.shape[1] + 1, len(M), len(self.A), q, q))
        P[0, :, :, :r, :r] = M
        for j in range(1, len(P)):
            late = (np.ravel(kind) == j - 1).astype(float)
            if direct:
                P[j, :, :, r:, :r], P[j, 0, :, r:, r:] = -late[:, None] * N, -late[:, None] * self.D
            else:
                P[j] = -B @ (late[:, None] * N)
        if direct:
            P[0, 0, :, :r, r:], P[0, 0, :, r:, r:] = -B, np.eye(self.T.shape[1])
        beyond = 10 * (1 + np.abs(self.open_poles).max(axis=1, initial=0.0))  # det(zI - A) is above zero there
        sign = np.linalg.slogdet(_polynomial(M, np.arange(len(self.A)), beyond.astype(np.complex128)))[0].real
        return kinds, np.swapaxes(P.reshape(-1, len(self.A), q * q), 0, 1).copy(), np.where(sign < 0, -1.0, 1.0)

    def z(self, s: Complex) -> tuple[Complex, Complex]:
        """The variable of A at s (k,), and its derivative: s and 1, or z and dz/ds of a sampled loop."""
        if not self.dt:
            return s, np.ones(s.shape, np.complex128)
        z = np.asarray(np.exp(s * self.dt), np.complex128)
        return z, np.asarray(self.dt * z)

    def late(self, at: Ints, s: Complex) -> Complex:
        """(k, nd, 1) E = e^(-s T) at s (k,)."""
        return np.asarray(np.exp(-s[:, None] * self.T[at])[:, :, None], np.complex128)

    def gain(self, at: Ints, s: Complex) -> Complex:
        """G (k, nd, nd) at s (k,); where z lies on a pole of G, beside it on the unstable side."""
        z, _ = self.z(np.asarray(s, np.complex128))
        near = (np.abs(z[:, None] - self.open_poles[at]) <= BESIDE * np.abs(z)[:, None]).any(axis=1)
        if near.any():
            z = np.where(near, z + np.maximum(BESIDE * np.abs(z), 1e-300) * (np.exp(1j * np.angle(z)) if self.dt else 1.0), z)
        G = np.empty((z.size, *self.D.shape[1:]), np.complex128)
        for some in self._chunks(z.size):
            M, N, B = self._at(at[some], z[some])
            G[some] = N @ _solved(M, B) + self.D[at[some]]
        return G

    def _at(self, at: Ints, z: Complex) -> tuple[Complex, Complex, Complex]:
        M, N, B = self._condensed
        return _polynomial(M, at, z), _polynomial(N, at, z), B[at].astype(np.complex128)

    def _chunks(self, size: int) -> Iterator[slice]:
        r = max(self._condensed[0].shape[2], self.T.shape[1], 1)
        step = max(1, CHUNK // (r * r))
        return (slice(k, k + step) for k in range(0, size, step))

    def loop(self, at: Ints, s: Complex) -> Complex:
        """E G (k, nd, nd) at s (k,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self.late(at, s) * self.gain(at, s))

    def value(self, at: Ints, s: Complex, poles: Complex) -> tuple[Array, Complex]:
        """Of g = f / prod(s - poles) at s (k,): its phase [rad] modulo a turn and (dg/ds) / g, each (k,). ``poles``: (m, p)."""
        phase, rate = np.empty(s.size), np.empty(s.size, np.complex128)
        with np.errstate(all="ignore"):
            for some in self._chunks(s.size):
                phase[some], rate[some] = self._value(at[some], np.asarray(s[some], np.complex128), poles)
        return phase, rate

    def _value(self, at: Ints, s: Complex, poles: Complex) -> tuple[Array, Complex]:
        kinds, P, sign = self._characteristic
        z, slope = self.z(s)
        T = np.concatenate([np.zeros((len(kinds), 1)), kinds], axis=1)[at]
        power = np.arange(P.shape[1] // T.shape[1])
        late = np.exp(-s[:, None] * T)[:, :, None]
        powers = z[:, None] ** power
        slopes = slope[:, None] * power * np.concatenate([np.zeros((s.size, 1)), powers[:, :-1]], axis=1)
        raised = slopes[:, None] - T[:, :, None] * powers[:, None]
        factors = np.stack([late * powers[:, None], late * raised], axis=1).reshape(s.size, 2, -1)
        q = round(P.shape[2] ** 0.5)
        F, dF = np.moveaxis(times_own(factors, P, at).reshape(s.size, 2, q, q), 1, 0)
        down = z[:, None] - poles[at]
        turned = np.linalg.slogdet(F)[0]
        root = turned == 0
        F[root] = np.eye(q)
        rate = np.where(root, np.inf, _trace(np.asarray(np.linalg.solve(F, dF), np.complex128)) - slope * (1 / down).sum(axis=1))
        return np.angle(sign[at] * turned) - _phase(down), np.asarray(rate, np.complex128)

    def matrix(self, at: Ints, s: Complex) -> tuple[Complex, Complex]:
        """The characteristic matrix M (k, nx + nd, nx + nd) at s (k,), with det M = f, and its derivative."""
        nx, nd = self.A.shape[-1], self.T.shape[1]
        z, dz = self.z(s)
        E, C, D = self.late(at, s), self.C[at], self.D[at]
        M = np.zeros((s.size, nx + nd, nx + nd), np.complex128)
        slope = np.zeros_like(M)
        M[:, :nx, :nx], M[:, :nx, nx:] = z[:, None, None] * np.eye(nx) - self.A[at], -self.B[at]
        M[:, nx:, :nx], M[:, nx:, nx:] = -E * C, np.eye(nd) - E * D
        late = self.T[at, :, None] * E
        slope[:, :nx, :nx] = dz[:, None, None] * np.eye(nx)
        slope[:, nx:, :nx], slope[:, nx:, nx:] = late * C, late * D
        return M, slope

    def contraction(self, loop: Complex) -> Array:
        """(k,) bounds of the spectral radius of E G over all phases of E, from E G (k, nd, nd)."""
        if self.one_delay:
            return np.asarray(np.abs(np.linalg.eigvals(loop)).max(axis=1))
        return perron(np.abs(loop))

    def contracts(self, loop: Complex, limit: Array) -> Bools:
        """(k,) where ``contraction`` is below ``limit`` (k,). Where all dead times are equal, mostly without eigenvalues."""
        return _radius_below(loop, limit) if self.one_delay else np.asarray(perron(np.abs(loop)) < limit)


def _chains(A: Array, B: Array) -> dict[int, int]:
    """State i -> state j with x_i' = a x_j at all points (a not 0, no input): each j follows one i, and no chain is closed."""
    entries = (A != 0).any(axis=0)
    follows: dict[int, int] = {}
    for i in np.flatnonzero((entries.sum(axis=1) == 1) & ~B.any(axis=(0, 2))).tolist():
        j = end = int(entries[i].argmax())
        while end in follows:
            end = follows[end]
        if end != i and j not in follows.values() and A[:, i, j].all():
            follows[i] = j
    return follows


def times_own(rows: Complex, matrices: NDArray[Any], at: Ints) -> Complex:
    """(k, a, b) rows (k, a, c) times the matrices (m, c, b) of the points ``at`` (k,), all those of one point at once."""
    order = None if (at[1:] >= at[:-1]).all() else np.argsort(at, kind="stable")
    owner = at if order is None else at[order]
    new = np.concatenate([np.ones(min(at.size, 1), bool), owner[1:] != owner[:-1]])
    first, group = np.flatnonzero(new), np.cumsum(new) - 1
    column = np.arange(at.size) - first[group]
    if order is not None:
        group[order], column[order] = group.copy(), column.copy()
    some, most, (_, a, c) = owner[first], int(column.max(initial=0)) + 1, rows.shape
    padded = np.zeros((some.size, most, a, c), np.complex128)
    padded[group, column] = rows
    own = matrices if some.size == len(matrices) else matrices[some]
    product = padded.reshape(some.size, most * a, c) @ own
    return np.asarray(product.reshape(some.size, most, a, own.shape[2])[group, column], np.complex128)


def _polynomial(coefficients: Array, at: Ints, z: Complex) -> Complex:
    """(k, a, b) values at z (k,) from coefficients (d + 1, m, a, b) of points ``at`` (k,)."""
    there = [bool(one.any()) for one in coefficients]
    value: Complex = coefficients[-1][at].astype(np.complex128)
    for lower, some in zip(coefficients[-2::-1], there[-2::-1], strict=True):
        value *= z[:, None, None]
        if some:
            value += lower[at]
    return value


def _phase(x: Complex) -> Array:
    """(k,) [rad] of the products of x (k, n), modulo a turn."""
    product = x.prod(axis=1)
    phase, size = np.angle(product), np.abs(product)
    far = np.flatnonzero(~((size > SMALLEST) & (size < LARGEST)))
    phase[far] = np.angle(x[far]).sum(axis=1)
    return np.asarray(phase)


def _trace(M: Complex) -> Complex:
    return np.asarray(np.einsum("kii->k", M), np.complex128)


def _radius_below(M: Complex, limit: Array) -> Bools:
    """(k,) where the spectral radius of M (k, n, n) is below ``limit`` (k,): by norm and trace of its powers 2, 4, ..., 32, else by eigenvalues."""
    below, left = np.zeros(len(M), bool), np.arange(len(M))
    power, log = M, np.zeros(len(M))  # of those left: M^(2^j) = e^log power
    with np.errstate(all="ignore"):
        for j in range(6):
            size = np.linalg.norm(power, axis=(1, 2))
            power, log = power / size[:, None, None], log + np.log(size)
            if j:
                log[size < 1e-6] = np.nan  # few digits left: no bound settles these
            upper, lower = np.exp(log / 2**j), np.exp((log + np.log(np.abs(_trace(power)) / M.shape[1])) / 2**j)
            surely = (upper < limit[left] * (1 - SURE)) | ((size == 0) if j == 0 else False)
            below[left[surely]] = True
            unsure = ~surely & ~(lower > limit[left] * (1 + SURE))
            left, power, log = left[unsure], power[unsure], 2 * log[unsure]
            if not left.size:
                return below
            power = power @ power
    below[left] = np.abs(np.linalg.eigvals(M[left])).max(axis=1) < limit[left]
    return below


def perron(G: Array) -> Array:
    """Upper bounds (k,) of the spectral radii of nonnegative G (k, n, n), close after a few powers: Collatz-Wielandt quotients."""
    x = np.ones((*G.shape[:2], 1))
    bound = np.full(len(G), np.inf)
    for _ in range(12):
        y = G @ x
        bound = np.minimum(bound, (y / x).max(axis=(1, 2)))
        x = y + 1e-6 * y.max(axis=1, keepdims=True) + 1e-300
        x = x / x.max(axis=1, keepdims=True)
    return np.where(G.any(axis=(1, 2)), bound, 0.0)


def _solved(matrix: Complex, right: Complex) -> Complex:
    try:
        return np.asarray(np.linalg.solve(matrix, right), np.complex128)
    except np.linalg.LinAlgError:  # a few of them are singular to rounding
        return np.stack([_least_squares(a, b) for a, b in zip(matrix, right, strict=True)])


def _least_squares(matrix: Complex, right: Complex) -> Complex:
    if not np.isfinite(matrix).all():
        return np.full(right.shape, np.nan, np.complex128)
    tiny = 1e-14 * (np.abs(matrix).max() + 1e-300)
    try:
        return np.asarray(np.linalg.solve(matrix + tiny * np.eye(len(matrix)), right), np.complex128)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix) @ right, np.complex128)
