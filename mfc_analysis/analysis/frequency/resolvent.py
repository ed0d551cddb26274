"""S_i(jw) - 1 and its slope at many frequencies and channels: by modes where these have their digits, else by linear solves.

With a perfect model all poles coincide; the eigenvectors are ill conditioned (1e14) and the modes are not used. Nor are they where a pole is so
near the contour that rounding of it or of its residue matters there, as of the slow poles of a stiff contact. Where this may be seen, the modes
are compared with a linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mfc_analysis.analysis.channels import Channels
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

EPS = float(np.finfo(float).eps)
CONDITION = 1e5  #: largest condition number of the eigenvectors with which modes are used: ten digits remain
DOUBT = 1e-9  #: predicted relative error of a mode at the contour above which it is compared with a linear solve
COMPARED = 3  #: places of each point at which they are compared, those with the largest predicted errors
AGREE, FLOOR = 1e-7, 1e-10  #: of abs(H) and of abs(1 + H), and of one: they agree
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
        return H, slope

    def on(self, w: Array) -> Complex:
        """H (m, n, k) of all channels at frequencies w (m, k) [rad/s] of each point."""
        return self.over(on_axis(w))

    def over(self, s: Complex) -> Complex:
        """H (m, n, k) of all channels at s (m, k) of each point."""
        H = np.empty((*self.ch.H0.shape, s.shape[1]), np.complex128)
        if self.modal.any():
            gap = 1 / (s[self.modal, None, :] - self.poles[self.modal, :, None])
            H[self.modal] = self.residues[self.modal] @ gap + self.ch.H0[self.modal, :, None]
        B, H0, rate = self._driven()
        n, rates = B.shape[2], rate.any()
        for i in np.flatnonzero(~self.modal):
            places, which = np.unique(s[i], return_inverse=True)
            X = _solved(self.ch.A[i], places, np.concatenate([B[i], rate[i]], axis=1) if rates else B[i])
            if rates:
                X = X[:, :, :n] + places[:, None, None] * X[:, :, n:]
            H[i] = np.einsum("nx,kxn->nk", self.ch.C[i], X)[:, which] + H0[i, :, None]
        return H

    def _driven(self) -> tuple[Array, Array, Array]:
        """b (m, nx, n), H0 (m, n) and r (m, nx, n) with H = H0 + c (sI - A)^-1 (b + s r)."""
        return (self.ch.B, self.ch.H0, np.zeros_like(self.ch.B)) if self.ch.apart is None else self.ch.apart

    def _by_modes(self, point: Ints, channel: Ints, s: Complex) -> tuple[Complex, Complex]:
        gap = 1 / (s[:, None] - self.poles[point])
        part = self.residues[point, channel] * gap
        return part.sum(axis=1) + self.ch.H0[point, channel], -(part * gap).sum(axis=1)

    def _by_solving(self, point: Ints, channel: Ints, s: Complex) -> tuple[Complex, Complex]:
        nx = self.ch.A.shape[-1]
        B, H0, rate = self._driven()
        H, slope = np.empty(s.shape, np.complex128), np.empty(s.shape, np.complex128)
        step = max(1, CHUNK // max(1, nx * nx))
        for k in range(0, s.size, step):
            p, c = point[k : k + step], channel[k : k + step]
            matrix = s[k : k + step, None, None] * np.eye(nx) - self.ch.A[p]
            row = self.ch.C[p, c]
            r = rate[p, :, c][:, :, None]
            x = np.linalg.solve(matrix, B[p, :, c][:, :, None] + s[k : k + step, None, None] * r)
            y = np.linalg.solve(matrix, x - r)
            H[k : k + step] = (row * x[:, :, 0]).sum(axis=1) + H0[p, c]
            slope[k : k + step] = -(row * y[:, :, 0]).sum(axis=1)
        return H, slope

    def some(self, index: Ints) -> Resolvent:
        """The same at some of the points."""
        return Resolvent(self.ch.at(index), self.poles[index], self.residues[index], self.modal[index])


def resolvent(ch: Channels, modes: tuple[Complex, Complex] | None = None, lowest: float = 0.0) -> Resolvent:
    """Modes of the channels' common A, and the points where they have their digits on the contour, at w >= ``lowest`` [rad/s] and round it.

    ``modes``: eigenvalues and vectors, if already known.
    """
    found = np.linalg.eig(ch.A) if modes is None else modes
    poles, V = np.asarray(found[0], np.complex128), np.asarray(found[1], np.complex128)
    try:
        inverse, modal = np.asarray(np.linalg.inv(V), np.complex128), np.ones(len(V), bool)
    except np.linalg.LinAlgError:
        modal = np.abs(np.linalg.det(V)) > 0
        inverse = np.zeros_like(V)
        inverse[modal] = np.linalg.inv(V[modal])
    condition, uncertain, scale = _conditions(ch.A, V, inverse)
    modal = modal & (condition < CONDITION * ch.A.shape[-1])
    residues = (ch.C @ V) * np.swapaxes(inverse @ ch.B, 1, 2)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.linalg.norm(ch.C * scale[:, None, :], axis=2) * np.linalg.norm(ch.B / scale[:, :, None], axis=1)
    _compare(Resolvent(ch, poles, residues, modal), EPS * condition[:, None] * size, uncertain, lowest)
    return Resolvent(ch, poles, residues, modal)


def _compare(found: Resolvent, rounding: Array, uncertain: Array, lowest: float) -> None:
    """Clears ``modal`` of the points whose H by modes differs from that by linear solves where the modes may have lost their digits.

    To first order H by modes is off by sum |dr|/|s - p| + sum |r| |dp|/|s - p|^2, with dr, ``rounding`` (m, n), of the residues and dp,
    ``uncertain`` (m, nx), of the poles p. It is predicted where the contour is nearest to each pole.
    """
    modal = np.flatnonzero(found.modal)
    poles, r, part = found.poles[modal], np.abs(found.residues[modal]), found.some(np.asarray(modal, np.int64))
    place = 1j * np.maximum(np.abs(poles.imag), lowest)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        near = 1 / np.abs(place[:, None, :] - poles[:, :, None])
        error = rounding[modal, :, None] * near.sum(axis=1, keepdims=True) + (r * uncertain[modal, None, :]) @ near**2
        H = part.over(place)
        error = (error / np.minimum(np.abs(H), np.abs(1 + H)).clip(min=FLOOR / AGREE)).max(axis=1, initial=0.0)
    doubtful = np.flatnonzero(~(error.max(axis=1, initial=0.0) < DOUBT))
    if not doubtful.size:
        return
    most = np.argsort(-np.nan_to_num(error[doubtful], nan=np.inf), axis=1)[:, :COMPARED]
    s, solving = np.take_along_axis(place[doubtful], most, 1), replace(part.some(doubtful), modal=np.zeros(doubtful.size, bool))
    with np.errstate(divide="ignore", invalid="ignore"):
        H = np.take_along_axis(H[doubtful], most[:, None, :], 2)
        try:
            exact = solving.over(s)
        except np.linalg.LinAlgError:  # a pole on the contour
            exact = np.full_like(H, np.nan)
        agree = np.abs(H - exact) <= AGREE * np.minimum(np.abs(exact), np.abs(1 + exact)) + FLOOR
    found.modal[modal[doubtful[~agree.all(axis=(1, 2))]]] = False


def _conditions(A: Array, V: Complex, inverse: Complex) -> tuple[Array, Array, Array]:
    """Condition numbers (m,) of V with rows, then columns, scaled to one, so that the units of the states have no effect; NaN counts as large.

    And the rounding error (m, nx) of each eigenvalue: eps ||A|| times its condition number, in the same scale; and the scale (m, nx) of the states.
    """
    size, back = np.abs(V), np.abs(inverse)
    rows = np.sqrt((size * size).sum(axis=2))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = size / rows[:, :, None]
        columns = np.sqrt((size * size).sum(axis=1))
        back = back * rows[:, None, :] * columns[:, :, None]
        each = (back * back).sum(axis=2)
        found = np.sqrt(V.shape[-1] * each.sum(axis=1))
        norm = np.sqrt(np.square(A * (rows[:, None, :] / rows[:, :, None])).sum(axis=(1, 2)))
    return np.asarray(np.where(np.isfinite(found), found, np.inf)), EPS * norm[:, None] * np.sqrt(each), rows


def _solved(A: Array, s: Complex, B: Array) -> Complex:
    """(sI - A)^-1 B, (k, nx, n), of one A at s (k,)."""
    nx = len(A)
    out = np.empty((s.size, *B.shape), np.complex128)
    step = max(1, CHUNK // max(1, nx * nx))
    for k in range(0, s.size, step):
        matrix = s[k : k + step, None, None] * np.eye(nx) - A
        out[k : k + step] = np.linalg.solve(matrix, np.broadcast_to(B.astype(complex), (len(matrix), *B.shape)))
    return out
