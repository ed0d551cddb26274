"""The sensitivities of the channels of a loop with dead time, anywhere in the s plane.

With W(s) = (I - G(s))^-1, the closed loop without dead time from after each cut to after each cut (G: all wires cut), and
E = diag(e^(-s T)), they are

    (I - E G)^-1 = W [(I - E) W + E]^-1,        S_i = e_i W [(I - E) W + E]^-1 p_i,

p_i = e_i (at "position": e_q + s e_v).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mfc_analysis.analysis.channels import has_rate, point_wires
from mfc_analysis.analysis.delay.stacked import times_own
from mfc_analysis.analysis.frequency.resolvent import CONDITION
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

CHUNK = 250_000  #: complex numbers at a time: these stay in the cache
ON_POLE, BESIDE = 1e-12, 1e-9  #: relative distance from a pole at which a place lies on it, and by which it is moved


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Of n channels at m points: W(s) = M + C (sI - A)^-1 B of the k relevant wires, with the modes of A."""

    A: Array  #: (m, nx, nx)
    B: Array  #: (m, nx, k)
    C: Array  #: (m, k, nx)
    M: Array  #: (m, k, k)
    T: Array  #: (k,) [s] of these wires
    rows: Ints  #: (n,) indices of the channels among them, one after the other
    rates: Ints | None  #: (n,) indices of the wires with their rates
    modal: Bools  #: (m,) modes are well conditioned
    poles: Complex  #: (m, nx)
    residues: Complex  #: (m, nx, k k) not defined where not ``modal``

    @cached_property
    def one_delay(self) -> bool:
        """True where the dead times are the same."""
        return bool((self.T[0] == self.T).all())

    def H(self, point: Ints, s: Complex) -> Complex:
        """S_i - 1 (q, n) of all channels at s (q,), each of one point (q,)."""
        n, each = self.rows.size, np.arange(self.rows.size)
        out = np.empty((s.size, n), np.complex128)
        for some in self._chunks(s.size):
            W, matrix = self._loop(point[some], s[some])
            inject = np.zeros((1 if self.rates is None else len(W), len(self.T), n), np.complex128)
            inject[:, self.rows, each] = 1
            if self.rates is not None:
                inject[:, self.rates, each] = s[some, None]
            X = np.linalg.solve(matrix, inject)
            out[some] = np.einsum("qij,qji->qi", W[:, self.rows[0] : self.rows[-1] + 1], X) - 1
        return out

    def over(self, s: Complex) -> Complex:
        """S_i - 1 (m, n, q) of all channels at s (m, q) of each point."""
        return self.over_some(np.arange(len(s)), s)

    def over_some(self, points: Ints, s: Complex) -> Complex:
        """S_i - 1 (p, n, q) of all channels at s (p, q) of each of the ``points`` (p,). Neighbours that are equal are evaluated once."""
        new = np.ones(s.shape, bool)
        new[:, 1:] = np.diff(s, axis=1) != 0
        H = self.H(np.repeat(points, new.sum(axis=1)), s[new])
        return np.ascontiguousarray(H[np.cumsum(new.ravel()) - 1].reshape(*s.shape, self.rows.size).transpose(0, 2, 1))

    def one(self, point: Ints, channel: Ints, s: Complex) -> Complex:
        """S_i - 1 (q,) at s (q,), each of one point and channel (q,)."""
        out = np.empty(s.size, np.complex128)
        for some in self._chunks(s.size):
            W, matrix = self._loop(point[some], s[some])
            each, row = np.arange(len(W)), self.rows[channel[some]]
            inject = np.zeros((len(W), len(self.T), 1), np.complex128)
            inject[each, row, 0] = 1
            if self.rates is not None:
                inject[each, self.rates[channel[some]], 0] = s[some]
            out[some] = (W[each, row] * np.linalg.solve(matrix, inject)[:, :, 0]).sum(axis=1) - 1
        return out

    def _chunks(self, size: int) -> Iterator[slice]:
        step = max(1, CHUNK // max(self.A.shape[-1], len(self.T)) ** 2)
        return (slice(k, k + step) for k in range(0, size, step))

    def _loop(self, point: Ints, s: Complex) -> tuple[Complex, Complex]:
        k = len(self.T)
        gap = s[:, None] - self.poles[point]
        squared = gap.real**2 + gap.imag**2
        on_pole = (squared <= (ON_POLE * np.abs(s)[:, None]) ** 2).any(axis=1)
        if on_pole.any():  # of the loop without dead time: W is infinite there, S is not
            s = np.where(on_pole, s * (1 + BESIDE), s)
            gap[on_pole] = s[on_pole, None] - self.poles[point[on_pole]]
            squared[on_pole] = gap[on_pole].real ** 2 + gap[on_pole].imag ** 2
        inverse = gap.conj() / squared
        known = self.modal[point]
        if known.all():
            W = times_own(inverse[:, None], self.residues, point)[:, 0]
        else:
            W = np.empty((s.size, k * k), np.complex128)
            W[known] = times_own(inverse[known, None], self.residues, point[known])[:, 0]
        for i in np.unique(point[~known]).tolist():
            mine = point == i
            matrix = s[mine, None, None] * np.eye(len(self.A[i])) - self.A[i]
            W[mine] = (self.C[i] @ np.linalg.solve(matrix, self.B[i].astype(complex)[None])).reshape(-1, k * k)
        W = W.reshape(-1, k, k) + self.M[point]
        E = np.exp(-s[:, None] * (self.T[:1] if self.one_delay else self.T))
        matrix = (1 - E)[:, :, None] * W
        matrix[:, np.arange(k), np.arange(k)] += E
        return W, matrix


def sensitivities(system: OpenSystem, at: str, index: Ints) -> Sensitivities:
    """Those of the analysis point ``at``, at the points ``index``."""
    nu, ny, nw = system.nu, system.ny, system.nw
    wires = np.arange(nw)[point_wires(system, at)]
    cut = [wires, np.arange(nw)[system.wires["rate"]]] if has_rate(system, at) else [wires]
    matter = np.unique(np.concatenate([*cut, np.flatnonzero(system.wire_delay)]))
    through = np.linalg.inv(np.eye(nw) - system.D[index][:, ny:, nu:])
    into, out = system.B[index][:, :, nu:] @ through, through @ system.C[index][:, ny:]
    A = system.A[index] + into @ system.C[index][:, ny:]
    B, C = into[:, :, matter], out[:, matter]
    poles, V = np.linalg.eig(A)
    modal = np.asarray(np.linalg.cond(V) < CONDITION)
    left, right = C @ V, np.zeros(B.shape, np.complex128)
    right[modal] = np.linalg.solve(V[modal], B[modal].astype(complex))
    residues = (left.transpose(0, 2, 1)[:, :, :, None] * right[:, :, None, :]).reshape(*poles.shape, matter.size**2)
    where = [np.searchsorted(matter, c) for c in cut]
    return Sensitivities(
        A, B, C, np.asarray(through[:, matter[:, None], matter], float), system.wire_delay[matter], where[0], where[1] if len(where) > 1 else None,
        modal, poles.astype(np.complex128), residues.astype(np.complex128),
    )  # fmt: skip
