"""S_i(jw) - 1 and its slope at many frequencies and channels: by modes where these are well conditioned, else by linear solves.

With a perfect model all poles coincide; the eigenvectors are ill conditioned (1e14) and the modes are not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import Channels
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

CONDITION = 1e5  #: largest condition number of the eigenvectors with which modes are used: ten digits remain
CHUNK = 4_000_000  #: complex numbers solved for at a time


@dataclass(frozen=True, eq=False)
class Resolvent:
    """H_i(jw) = S_i(jw) - 1 = H0_i + c_i (jwI - A)^-1 b_i of m points and n channels, ready for evaluation."""

    ch: Channels
    poles: Complex  #: (m, nx)
    residues: Complex  #: (m, n, nx) not defined where not ``modal``
    modal: Bools  #: (m,)

    def at(self, point: Ints, channel: Ints, w: Array) -> tuple[Complex, Complex]:
        """H and dH/dw, each (k,), of k cases: point, channel (k,) and w (k,) [rad/s]."""
        H, slope = self.at_place(point, channel, on_axis(w))
        return H, 1j * slope

    def at_place(self, point: Ints, channel: Ints, s: Complex) -> tuple[Complex, Complex]:
        """H and dH/ds, each (k,), of k cases: point, channel (k,) and s (k,)."""
        H, slope = np.empty(s.shape, np.complex128), np.empty(s.shape, np.complex128)
        modal = self.modal[point]
        for some, by in ((modal, self._by_modes), (~modal, self._by_solving)):
            if some.any():
                H[some], slope[some] = by(point[some], channel[some], s[some])
        H += self.ch.H0[point, channel]
        return H, slope

    def on(self, w: Array) -> Complex:
        """H (m, n, k) of all channels at frequencies w (m, k) [rad/s] of each point."""
        return self.over(on_axis(w))

    def over(self, s: Complex) -> Complex:
        """H (m, n, k) of all channels at s (m, k) of each point."""
        H = np.empty((*self.ch.H0.shape, s.shape[1]), np.complex128)
        if self.modal.any():
            gap = 1 / (s[self.modal, None, :] - self.poles[self.modal, :, None])
            H[self.modal] = self.residues[self.modal] @ gap
        for i in np.flatnonzero(~self.modal):
            places, which = np.unique(s[i], return_inverse=True)
            H[i] = np.einsum("nx,kxn->nk", self.ch.C[i], _solved(self.ch.A[i], places, self.ch.B[i]))[:, which]
        H += self.ch.H0[:, :, None]
        return H

    def _by_modes(self, point: Ints, channel: Ints, s: Complex) -> tuple[Complex, Complex]:
        gap = 1 / (s[:, None] - self.poles[point])
        part = self.residues[point, channel] * gap
        return part.sum(axis=1), -(part * gap).sum(axis=1)

    def _by_solving(self, point: Ints, channel: Ints, s: Complex) -> tuple[Complex, Complex]:
        nx = self.ch.A.shape[-1]
        H, slope = np.empty(s.shape, np.complex128), np.empty(s.shape, np.complex128)
        step = max(1, CHUNK // max(1, nx * nx))
        for k in range(0, s.size, step):
            p, c = point[k : k + step], channel[k : k + step]
            matrix = s[k : k + step, None, None] * np.eye(nx) - self.ch.A[p]
            row = self.ch.C[p, c]
            x = np.linalg.solve(matrix, self.ch.B[p, :, c][:, :, None].astype(complex))
            y = np.linalg.solve(matrix, x)
            H[k : k + step] = (row * x[:, :, 0]).sum(axis=1)
            slope[k : k + step] = -(row * y[:, :, 0]).sum(axis=1)
        return H, slope

    def some(self, index: Ints) -> Resolvent:
        """The same at some of the points."""
        return Resolvent(self.ch.at(index), self.poles[index], self.residues[index], self.modal[index])


def resolvent(ch: Channels, modes: tuple[Complex, Complex] | None = None) -> Resolvent:
    """Modes of the channels' common A, and the points where they are well conditioned. ``modes``: eigenvalues and vectors, if already known."""
    found = np.linalg.eig(ch.A) if modes is None else modes
    poles, V = np.asarray(found[0], np.complex128), np.asarray(found[1], np.complex128)
    try:
        inverse, modal = np.asarray(np.linalg.inv(V), np.complex128), np.ones(len(V), bool)
    except np.linalg.LinAlgError:
        modal = np.abs(np.linalg.det(V)) > 0
        inverse = np.zeros_like(V)
        inverse[modal] = np.linalg.inv(V[modal])
    modal = modal & (_condition(V, inverse) < CONDITION * ch.A.shape[-1])
    residues = (ch.C @ V) * np.swapaxes(inverse @ ch.B, 1, 2)
    return Resolvent(ch, poles, residues, modal)


def _condition(V: Complex, inverse: Complex) -> Array:
    """(m,) condition numbers of V with rows, then columns, scaled to one, so that the units of the states have no effect. NaN counts as large."""
    size, back = np.abs(V), np.abs(inverse)
    rows = np.sqrt((size * size).sum(axis=2))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = size / rows[:, :, None]
        columns = np.sqrt((size * size).sum(axis=1))
        back = back * rows[:, None, :] * columns[:, :, None]
        found = np.sqrt(V.shape[-1] * (back * back).sum(axis=(1, 2)))
    return np.asarray(np.where(np.isfinite(found), found, np.inf))


def _solved(A: Array, s: Complex, B: Array) -> Complex:
    """(sI - A)^-1 B, (k, nx, n), of one A at s (k,)."""
    nx = len(A)
    out = np.empty((s.size, *B.shape), np.complex128)
    step = max(1, CHUNK // max(1, nx * nx))
    for k in range(0, s.size, step):
        matrix = s[k : k + step, None, None] * np.eye(nx) - A
        out[k : k + step] = np.linalg.solve(matrix, np.broadcast_to(B.astype(complex), (len(matrix), *B.shape)))
    return out
