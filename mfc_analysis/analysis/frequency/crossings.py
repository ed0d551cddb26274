"""Crossings of the loops: every frequency at which |L_i| = 1, and every frequency at which L_i is real.

With S_i = d + c (sI - A)^-1 b, on s = jw

    Re S_i = d - c (A^2 + w^2)^-1 A b          |L_i| = 1  is  Re S_i = 1/2
    Im S_i = -w c (A^2 + w^2)^-1 b             L_i real   is  Im S_i = 0

so that -w^2 are eigenvalues of a matrix of the size of A: those of A^2 - A b c / (d - 1/2), and the zeros of (A^2, b, c).
Both come from shift and invert about one w0, with one complex inverse Z = (A - j w0)^-1 of each point: with
G = (A^2 + w0^2)^-1 = Im Z / w0 and A G = Re Z, the numbers 1 / (w0^2 - w^2) are the eigenvalues of

    G + (A G b)(c G) / (d - 1/2 - c A G b)     and     G - (G b)(c G) / (c G b).

A is never squared, c b = 0 is allowed (zeros at infinity become eigenvalues 0), and no eigenvector is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import Channels
from mfc_analysis.analysis.frequency.exclusion import crossover_intervals, narrowed, phase_intervals
from mfc_analysis.analysis.frequency.grid import Grid
from mfc_analysis.analysis.frequency.resolvent import Resolvent
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints


@dataclass(frozen=True, eq=False)
class Crossings:
    """k polished crossings, each with its point and channel."""

    point: Ints  #: (k,)
    channel: Ints  #: (k,)
    w: Array  #: (k,) [rad/s] > 0
    H: Complex  #: (k,) S_i(jw) - 1

    def __getitem__(self, some: Bools) -> Crossings:
        return Crossings(self.point[some], self.channel[some], self.w[some], self.H[some])

    @property
    def L(self) -> Complex:
        """(k,) the loop L_i(jw)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(-self.H / (1 + self.H))


def crossings(grid: Grid) -> tuple[Crossings, Crossings]:
    """All gain crossovers (|L| = 1) and all phase crossings (L real) at w[:, 0] <= w < inf of every point and channel.

    The first frequency of the grid, 1/horizon, is the same for all points. Where modes are known, ``exclusion`` isolates the crossings between
    the frequencies; this is cheaper than the eigenvalue problem, which is used where exclusion stops early.
    """
    found, lowest = grid.found, float(grid.w[0, 0])
    left = np.stack([~found.ch.empty] * 2)  # channels for the eigenvalue problem
    starts: list[list[tuple[Ints, Ints, Array]]] = [[], []]
    modal = np.asarray(np.flatnonzero(found.modal), np.int64)
    if modal.size:
        part = grid.some(modal)
        for which, (known, some, failed) in enumerate(((part.found, *crossover_intervals(part)), phase_intervals(part))):
            left[which, modal] &= failed
            starts[which].append((modal[some.point], some.channel, narrowed(known, some)))
    points = np.asarray(np.flatnonzero(left.any(axis=(0, 2))), np.int64)
    if points.size:
        for start, squared in zip(starts, _squared_frequencies(found.ch.at(points), found.poles[points], left[:, points], lowest), strict=True):
            point, channel, w = _candidates(squared, lowest)
            start.append((points[point], channel, w))
    gain, phase = (_polished(found, *_joined(start), gain=k == 0) for k, start in enumerate(starts))
    return gain[gain.w >= lowest], phase[phase.w >= lowest]


def _joined(starts: list[tuple[Ints, Ints, Array]]) -> tuple[Ints, Ints, Array]:
    point, channel, w = (np.concatenate(each) for each in zip(*starts, strict=True)) if starts else (np.zeros(0, int), np.zeros(0, int), np.zeros(0))
    return point, channel, w


def _squared_frequencies(ch: Channels, poles: Complex, wanted: Bools, lowest: float) -> tuple[Complex, Complex]:
    """w^2 (m, n, nx) of the gain crossovers and of the phase crossings of the channels ``wanted`` (2, m, n), complex and infinite ones included."""
    m, nx = ch.A.shape[:2]
    n = ch.B.shape[2]
    size = np.maximum(np.abs(poles), lowest)
    size = np.where(size > 1e-9 * size.max(axis=1, keepdims=True), size, np.nan)
    shift = 1.2345 * np.exp(np.nanmean(np.log(size), axis=1))
    Z = np.linalg.inv(ch.A - 1j * shift[:, None, None] * np.eye(nx))
    G, AG = np.ascontiguousarray(Z.imag) / shift[:, None, None], np.ascontiguousarray(Z.real)
    Gb, AGb, cG = G @ ch.B, AG @ ch.B, ch.C @ G
    cGb = np.einsum("mnx,mxn->mn", ch.C, Gb)
    gap = ch.H0 + 0.5 - np.einsum("mnx,mxn->mn", ch.C, AGb)
    inverse = np.full((2, m, n, nx), np.nan, np.complex128)
    for which, column, scale in ((0, AGb, gap), (1, -Gb, cGb)):
        p, k = np.nonzero(wanted[which])
        if p.size:
            row = cG[p, k] / _nonzero(scale[p, k])[:, None]
            inverse[which, p, k] = np.linalg.eigvals(G[p] + column[p, :, k][:, :, None] * row[:, None, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = (shift**2)[:, None, None] - 1 / inverse
    return squared[0], squared[1]


def _nonzero(x: Array) -> Array:
    return np.where(np.abs(x) < 1e-200, 1e-200, x)


def _candidates(squared: Complex, lowest: float) -> tuple[Ints, Ints, Array]:
    """Points, channels and w of the real positive eigenvalues, up to the rounding of a double eigenvalue, not far below ``lowest``."""
    with np.errstate(invalid="ignore"):
        real = (squared.real > 0.5 * lowest**2) & (squared.imag >= 0) & (squared.imag <= 1e-5 * squared.real)
    point, channel, which = np.nonzero(real)
    return point, channel, np.sqrt(squared.real[point, channel, which])


def _polished(found: Resolvent, point: Ints, channel: Ints, w: Array, gain: bool) -> Crossings:
    """Newton on Re H = -1/2 (``gain``) or Im H = 0; a candidate that does not converge nearby is no crossing (a zero at infinity)."""
    keep = np.ones(w.size, bool)
    start = w.copy()
    H, slope = found.at(point, channel, w)
    for _ in range(6):
        miss, rate = (H.real + 0.5, slope.real) if gain else (H.imag, slope.imag)
        scale = np.abs(H) + 1e-300
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(miss == 0, 0.0, miss / rate)
        flat = np.abs(miss) <= 1e-13 * scale
        keep &= flat | (np.isfinite(step) & (np.abs(step) < 0.05 * w))
        again = keep & ~flat & (np.abs(step) > 1e-13 * w)
        if not again.any():
            break
        w = np.where(again, w - np.where(again, step, 0.0), w)
        H_new, slope_new = found.at(point[again], channel[again], w[again])
        H[again], slope[again] = H_new, slope_new
    keep &= np.abs(w - start) < 0.05 * start
    miss = H.real + 0.5 if gain else H.imag
    keep &= np.abs(miss) <= 1e-6 * np.abs(H)
    return Crossings(point[keep], channel[keep], w[keep], H[keep])
