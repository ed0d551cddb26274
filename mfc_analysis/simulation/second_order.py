"""The response of a loop to a disturbance, to second order along a base run, and its largest misfits.

To second order a disturbance c moves the state by P(t) c + X(t)[c, c], so the misfit of the linear model grows with the size of c by
rms(X[c, c]) / rms(P c) of the joints. Its largest values over a box of disturbances cost no simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.maths.arrays import Array, Bools, Ints
from mfc_analysis.simulation.along import STEPS as FINEST, Along

STEPS = (50, 100)  #: of the response: the fewest in which its fastest root turns by less than ``FAST``, else the most
FAST = 0.3  #: modulus of a root times a step
SAMPLES = 25  #: steps at which the joints are compared
SHIFT = 1e-4  #: of each scaled state, for differences of the Jacobian
NOTHING = 1e-9  #: misfit for each unit of size that is rounding
FAR = 1e60  #: [rad, m] response beyond which there is no second order
NO_ROW = 1e-3  #: of the largest singular value of the second order: rows below it are left out
CLIMBS, FLAT = 60, 1e-3  #: steps uphill to a local maximum, and the move along the slope at which it is reached
REVERSED = 3  #: times that an entry of a local maximum is reversed, to climb on from there


@dataclass(frozen=True, eq=False)
class Expansion:
    """What disturbances c (k,) of a run make of its states, to second order, at times t (m,)."""

    t: Array  #: (m,) [s]
    first: Array  #: (m, nx, k)
    second: Array  #: (m, nx, k (k + 1) / 2) for each pair of entries of c, one of the two orders

    def beyond(self, t: Array, c: Array) -> Array:
        """(i, j, nx) the part of second order of disturbances c (j, k) at times t (i,) of the run, by straight lines between its own times."""
        i, j = np.triu_indices(c.shape[1])
        own = np.swapaxes(self.second @ (np.where(i == j, 1.0, 2.0) * c[:, i] * c[:, j]).T, 1, 2)
        at = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        part = ((t - self.t[at]) / (self.t[at + 1] - self.t[at]))[:, None, None]
        return np.asarray((1 - part) * own[at] + part * own[at + 1])

    def of_joints(self, q: slice) -> SecondOrder:
        """That of the joints, the states ``q``, at ``SAMPLES`` of the times."""
        every, k = (len(self.t) - 1) // SAMPLES, self.first.shape[2]
        return SecondOrder(self.first[::every, q].reshape(-1, k), _full(self.second[::every, q].reshape(-1, self.second.shape[2]), k))


def expansion(along: Along, basis: Array) -> Expansion | None:
    """That of disturbances of the ``basis`` (nx, k); None where it overflows.

    x'' of the rates by differences of the exact Jacobian. Dead time and sampling are left out: the response only chooses directions. Raises
    MfcError where the law cannot be evaluated beside the run.
    """
    steps = next((n for n in STEPS if along.fastest * (along.t[-1] - along.t[0]) <= FAST * n), STEPS[-1])
    t = along.t[:: FINEST // steps]
    Phi, Gamma = along.steps(steps)
    with np.errstate(all="ignore"):
        first = accumulated(Phi) @ basis
        rows, sources = _sources(along, t, basis, first)
        forced = Gamma[:, :, rows] @ (0.5 * (sources[:-1] + sources[1:]))
        second = np.zeros((steps + 1, *forced.shape[1:]))
        for step in range(steps):
            second[step + 1] = Phi[step] @ second[step] + forced[step]
    q = along.e.parts["q"].where
    if not max(np.abs(first[:, q]).max(), np.abs(second[:, q]).max()) < FAR:
        return None
    return Expansion(t, first, second)


def _sources(along: Along, t: Array, basis: Array, P: Array) -> tuple[Ints, Array]:
    """Half the second derivative of the rates along each pair of the columns of P (m, nx, k), once for the two orders, at times t (m,): the rows
    (r,) of the rates that have one, and (m, r, k (k + 1) / 2)."""
    e, nx = along.e, along.e.nx
    nodes, weights = along.roughly(t)
    scale = SHIFT * np.abs(basis).max(axis=1)
    moved = np.flatnonzero(scale)
    shifts = np.concatenate([np.zeros((1, nx)), np.diag(scale)[moved]])
    around = along.base.state(nodes)[:, None] + shifts
    lose = any(s.one_sided for s in e.surfaces)
    A = closed_matrix(e, np.repeat(nodes, len(shifts)), around.reshape(-1, nx), lose_contact=lose).reshape(nodes.size, len(shifts), nx, nx)
    H = (A[:, 1:] - A[:, :1]) / scale[moved, None, None]  # H[:, l, i, j] = d A_ij / d x_l
    rows = np.flatnonzero(H.any(axis=(0, 1, 3)))
    H = (weights @ H[:, :, rows].reshape(nodes.size, -1)).reshape(len(t), -1, nx)
    k, r = P.shape[-1], rows.size
    S = np.swapaxes(P[:, moved], 1, 2) @ (H @ P).reshape(len(t), moved.size, r * k)
    S = np.moveaxis(S.reshape(len(t), k, r, k), 1, 2)
    i, j = np.triu_indices(k)
    return rows, 0.25 * (S[..., i, j] + S[..., j, i])


def _full(upper: Array, k: int) -> Array:
    """Symmetric matrices (..., k, k) from their entries (..., k (k + 1) / 2) on and above the diagonal, row by row."""
    i, j = np.triu_indices(k)
    out = np.empty((*upper.shape[:-1], k, k))
    out[..., i, j] = out[..., j, i] = upper
    return out


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """Response of the joints to a disturbance c (k,) at all samples: ``first @ c`` (r,), and ``c @ second @ c`` beyond it."""

    first: Array  #: (r, k)
    second: Array  #: (r, k, k) symmetric

    def turned(self) -> SecondOrder:
        """Both in other rows, fewer, that have the same norms."""
        i, j = np.triu_indices(self.first.shape[1])
        weight = np.where(i == j, 1.0, np.sqrt(2.0))
        _, size, rows = np.linalg.svd(self.second[:, i, j] * weight, full_matrices=False)
        keep = size > NO_ROW * size[0]
        second = _full(size[keep, None] * rows[keep] / weight, self.first.shape[1])
        return SecondOrder(np.asarray(np.linalg.qr(self.first, mode="r"), float), second)

    def ratios(self, c: Array) -> Array:
        """log of the misfit for each unit of size, of disturbances (m, k): (m,)."""
        return self._slopes(c)[0]

    def _slopes(self, c: Array) -> tuple[Array, Array]:
        """``ratios`` (m,) and their gradients (m, k)."""
        linear, row = self.first @ c.T, self.second @ c.T
        square = (row * c.T).sum(axis=1)
        bottom = (linear**2).sum(axis=0)
        top = _ratio((square**2).sum(axis=0), bottom) * bottom
        slope = (row * square[:, None]).sum(axis=0) * (2 / top) - self.first.T @ linear / bottom
        return np.asarray(0.5 * np.log(top / bottom)), slope.T

    def maxima(self, starts: Array, joints: int) -> tuple[Array, Array]:
        """Local maxima in the box, (m,) and where (m, k), one near each of the ``starts`` (m, k).

        The largest joint of each start, at 1 or -1, stays there. No other entry can be reversed with gain.
        """
        lead = np.abs(starts[:, :joints]).argmax(axis=1)
        reached, c = self._uphill(starts, lead)
        going: Ints = np.arange(len(c))
        for _ in range(REVERSED):
            reversed_ = c[going, None] * (1 - 2 * np.eye(c.shape[1]))
            reversed_[np.arange(going.size), lead[going]] = c[going]
            gains = self.ratios(reversed_.reshape(-1, c.shape[1])).reshape(going.size, -1)
            more = gains.max(axis=1) > reached[going] + 1e-6
            going, best = going[more], reversed_[more, gains[more].argmax(axis=1)]
            if not going.size:
                break
            reached[going], c[going] = self._uphill(best, lead[going])
        return reached, c

    def _uphill(self, starts: Array, lead: Ints) -> tuple[Array, Array]:
        """Uphill in the box from all starts at once."""
        at = _Climb(starts.copy(), np.arange(starts.shape[1]) == lead[:, None], *self._slopes(starts))
        for _ in range(CLIMBS):
            far = at.far()
            if not far.size:
                break
            tried = at.tried(far)
            at.move(far, tried, *self._slopes(tried))
        return at.reached, at.c


class _Climb:
    """Ascent from m points in the box, with the step lengths of Barzilai and Borwein (IMA J. Numer. Anal. 8, 1988)."""

    def __init__(self, c: Array, held: Bools, reached: Array, slope: Array) -> None:
        self.c, self.held = c, held  #: (m, k) where, and the entries that stay
        self.reached: Array = reached  #: (m,)
        self.slope: Array = np.where(held, 0.0, slope)  #: (m, k)
        self.step: Array = 0.5 / np.maximum(np.abs(self.slope).max(axis=1), 1e-12)  #: (m,)

    def far(self) -> Ints:
        """The points that are not yet at a maximum."""
        return np.flatnonzero(np.abs(np.clip(self.c + self.slope, -1.0, 1.0) - self.c).max(axis=1) > FLAT)

    def tried(self, some: Ints) -> Array:
        """The next places of some points."""
        return np.clip(self.c[some] + self.step[some, None] * self.slope[some], -1.0, 1.0)

    def move(self, some: Ints, tried: Array, ratio: Array, slope: Array) -> None:
        """There where that is uphill, else the step becomes shorter."""
        slope = np.where(self.held[some], 0.0, slope)
        up = ratio >= self.reached[some]
        moved = tried - self.c[some]
        curved = (moved * (self.slope[some] - slope)).sum(axis=1)
        length = np.where(curved > 0, (moved**2).sum(axis=1) / np.where(curved > 0, curved, 1.0), 10 * self.step[some])
        self.step[some] = np.where(up, np.clip(length, 1e-3, 1e3), 0.3 * self.step[some])
        some = some[up]
        self.c[some], self.slope[some], self.reached[some] = tried[up], slope[up], ratio[up]


def _ratio(square: Array, linear: Array) -> Array:
    """square / linear, at least the square of ``NOTHING``; ``linear`` is 1 or more, since a joint starts at 1."""
    return np.maximum(square / linear, NOTHING**2)
