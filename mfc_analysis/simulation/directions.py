"""The disturbances that the linear model predicts worst, from the second-order and then the nonlinear response of the loop.

To second order a disturbance c of size 1 moves the joints by ``first @ c + c @ second @ c``, so the misfit of the linear model grows with
the size by rms(c @ second @ c) / rms(first @ c). Its largest values over a box of disturbances cost no simulation. At the size of the radius
higher orders may count too: where the misfit of the nonlinear ``response`` is not that of the second order, a pattern search climbs it from these
maxima, many directions at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array, Bools, Ints
from mfc_analysis.maths.dual import value
from mfc_analysis.maths.zero_order_hold import zero_order_hold
from mfc_analysis.simulation.response import STEPS as STEPS_ALONG, Follower
from mfc_analysis.simulation.simulation import Simulation

STEPS, SAMPLES = 100, 25  #: steps of the second-order response, and at how many of them it is compared
SHIFT = 1e-4  #: of each scaled state, for differences of the Jacobian
STARTS = 16  #: random starts of the search, beside the singular directions and the joints
MAXIMA = 2  #: local maxima of the second order that are tried with both signs
MISFIT = 0.05  #: nrmse up to which the linear model is said to hold
LARGEST = 3.0  #: [rad, m] largest disturbance tried
CLIMBED, CLIMBERS = 6, 6  #: maxima of the second order from which the search on the nonlinear response starts, and directions that climb
PATTERN = (0.7, 0.7, 0.4, 0.4, 0.2, 0.1)  #: changes of the entries in its steps
TOGETHER = (1, 2, 4, 8)  #: numbers of entries changed together, beside all that gain
PROBED = 4  #: starts by which the number of steps is chosen
WORST = 1.0  #: misfit from which on directions count as equally bad
NOTHING = 1e-9  #: misfit for each unit of size that is rounding
FAR = 1e60  #: [rad, m] response beyond which there is no second order
SECOND = 0.1  #: of the largest misfit: where no misfit differs by more from that to second order, its maxima are the worst directions
SAME = 0.98  #: cosine of two directions that count as one
NO_ROW = 1e-3  #: of the largest singular value of the second order: rows below it are left out
CLIMBS, FLAT = 60, 1e-4  #: steps uphill to a local maximum, and the move along the slope at which it is reached
REVERSED = 3  #: times that an entry of a local maximum is reversed, to climb on from there


@dataclass(frozen=True, eq=False)
class Candidate:
    """A direction in which the linear model may fail first."""

    direction: Array  #: (nx,)
    reach: float  #: [rad, m] size at which the second order gives a misfit of 1; inf where it gives none


def scaled_basis(e: Equations, predicted: Array) -> Array:
    """(nx, k) the disturbances of size 1, one a column, those of the joints first.

    A joint is disturbed by 1 rad (m), its motor with it; any other state by the largest value that it reaches in the linear model while a
    joint disturbance of 1 rad (m) dies out (while the joints grow to 1, where it does not). ``predicted``: (N, nx, nx) from the start to
    N times. Columns of states that stay at 0 are left out.
    """
    q = e.parts["q"].where
    reached = np.abs(predicted[:, :, q]).max(axis=(0, 2))
    scale = reached / max(float(reached[q].max()), 1.0)
    scale[q] = 1.0
    columns = np.diag(scale)
    for link, motor in (("q", "theta"), ("v", "omega")):
        if motor in e.parts:
            columns[e.parts[motor].where] = columns[e.parts[link].where]
    return np.asarray(columns[:, columns.any(axis=0)], float)


def candidates(e: Equations, base: Simulation, basis: Array, seed: int) -> list[Candidate]:
    """Directions in the box of the ``basis`` (some joint at 1, no entry beyond 1), the worst of the nonlinear response first.

    Then the worst to second order with both signs, and the directions that reach a torque limit or leave a surface first.
    """
    n, k = e.n, basis.shape[1]
    rng = np.random.default_rng(seed)
    starts = [*np.eye(k)[:n], np.ones(k), *rng.uniform(-1.0, 1.0, (STARTS, k))]
    try:
        found = second_order(e, base, basis)
    except MfcError:  # the law cannot be evaluated beside the run, or the response overflows
        found = None
    if found is None:
        ranked = [(np.inf, _on_box(c, n)) for c in starts]
    else:
        found = found.turned()
        singular = np.linalg.svd(found.second.reshape(-1, k), full_matrices=False)[2]
        reached, where = found.maxima(np.array([_on_box(c, n) for c in [*singular[:n], *starts]]), n)
        ranked = [(float(np.exp(-largest)), c) for largest, c in _distinct(reached, where)]
    out = [(reach, sign * c) for reach, c in ranked[:MAXIMA] for sign in (1.0, -1.0)]
    if found is not None:
        signed = [sign * c for _, c in ranked[:CLIMBED] for sign in (1.0, -1.0)]
        worst = _climbed(e, base, basis, found, np.array([*signed, *(_on_box(c, n) for c in starts)]), MISFIT * ranked[0][0])
        out = worst + [one for one in out if not any(np.array_equal(one[1], c) for _, c in worst)]
    out += [(np.inf, c) for c in _first_limits(e, base, basis)]
    return [Candidate(basis @ c, reach) for reach, c in out]


def _climbed(e: Equations, base: Simulation, basis: Array, second: SecondOrder, starts: Array, size: float) -> list[tuple[float, Array]]:
    """Directions (k,) with the largest misfits of the nonlinear response, the best of the ``starts`` (m, k) or better, and the sizes at which it
    would be 1.

    Where the second order gives the misfits of the starts, its maxima are among them and nothing is climbed. Else pattern search in the box. The
    misfit is that at the radius of the worst direction so far, from ``size`` on.
    """
    n, size = e.n, min(size, 1.0)
    follower = Follower(e, base, size * starts[:PROBED] @ basis.T)

    def misfits(c: Array) -> Array:
        """(m, j) of directions (m, j, k); -1 where a response is not followed."""
        found = follower.misfits(size * c @ basis.T)
        return np.where(np.isnan(found), -1.0, np.minimum(found, WORST))

    worst = misfits(starts[:, None])[:, 0]
    off = np.where(worst >= 0, np.abs(worst - size * np.exp(second.ratios(starts))), np.inf).max()
    some = np.argsort(-worst, kind="stable")[: max(2, CLIMBERS * STEPS_ALONG[0] // max(follower.steps, 1))]  # the more steps, the fewer directions
    c, worst = starts[some], worst[some]
    low, high = 0.0, np.inf  #: [rad, m] sizes below and above the one where the worst is MISFIT
    moved_none = 0.0  #: the last step that moved no direction
    for step in PATTERN if off > SECOND * worst.max() else ():
        if worst.max() < NOTHING:
            return []
        if step == moved_none:
            continue
        low, high = (low if low < size else 0.0, size) if worst.max() > MISFIT else (size, high if high > size else np.inf)
        wanted = min(size * float(np.clip(MISFIT / worst.max(), 0.3, 3.0)), LARGEST)
        size = wanted if low <= wanted < high else float(np.sqrt(low * high))  # where a limit is reached the misfit is not in proportion
        later, worst = _searched(misfits, c, step, n)
        moved_none = step if np.array_equal(later, c) else 0.0
        c = later
    return [(size / found, at) for found, at in _distinct(worst, c, signed=True) if found > 0]


def _searched(misfits: Callable[[Array], Array], c: Array, step: float, joints: int) -> tuple[Array, Array]:
    """One step of the pattern search from directions c (m, k): the best of each with entries changed by ``step``, and their misfits (m,)."""
    k = c.shape[1]
    turn = np.where(c > 0, -1.0, 1.0)  # each entry towards 0
    reached = misfits(np.concatenate([c[:, None], _inside(c[:, None] + step * turn[:, None] * np.eye(k), joints)], axis=1))
    gain = reached[:, 1:] - reached[:, :1]
    back = (gain < 0) & (np.abs(c) < 1)  # where that loses, the other way should gain
    gain, turn = np.where(back, -gain, gain), np.where(back, -turn, turn)
    rank = np.argsort(np.argsort(-gain, axis=1), axis=1)
    some = np.stack([(rank < count) & (gain > 0) for count in (*TOGETHER, k)], axis=1)
    tried = np.concatenate([c[:, None], _inside(c[:, None] + step * some * turn[:, None], joints)], axis=1)
    reached = misfits(tried)
    best = reached.argmax(axis=1)
    return tried[np.arange(len(c)), best], reached[np.arange(len(c)), best]


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
        second = np.empty((int(keep.sum()), *self.second.shape[1:]))
        second[:, i, j] = second[:, j, i] = size[keep, None] * rows[keep] / weight
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


def second_order(e: Equations, base: Simulation, basis: Array) -> SecondOrder | None:
    """The response along a base run to disturbances of the ``basis`` (nx, k); None where it overflows.

    x'' of the rates by differences of the exact Jacobian, A held over each of ``STEPS`` steps. Dead time and sampling are left out: the
    response only chooses directions. Raises MfcError where the law cannot be evaluated beside the run.
    """
    t = np.linspace(base.t[0], base.t[-1], STEPS + 1)
    nx, k, q, every = e.nx, basis.shape[1], e.parts["q"].where, STEPS // SAMPLES
    still = np.abs(base.x - base.x[0]).max() <= 1e-9 * (1 + np.abs(base.x[0]).max())
    nodes = t[:1] if still else t[:-1:every]
    scale = SHIFT * np.abs(basis).max(axis=1)
    moved = np.flatnonzero(scale)
    shifts = np.concatenate([np.zeros((1, nx)), np.diag(scale)[moved]])
    around = base.state(nodes)[:, None] + shifts
    lose = any(s.one_sided for s in e.surfaces)
    A = closed_matrix(e, np.repeat(nodes, len(shifts)), around.reshape(-1, nx), lose_contact=lose).reshape(nodes.size, len(shifts), nx, nx)
    H = np.zeros((nodes.size, nx, nx, nx))  # H[:, l, i, j] = d A_ij / d x_l
    H[:, moved] = (A[:, 1:] - A[:, :1]) / scale[moved, None, None]
    Phi, Gamma = zero_order_hold(A[:, 0], np.broadcast_to(np.eye(nx), (nodes.size, nx, nx)), float(t[1]))
    P, X, source = basis, np.zeros((nx, k * k)), _source(H[0], basis)
    first, second = [P[q]], [np.zeros((e.n, k, k))]
    with np.errstate(all="ignore"):
        for step in range(STEPS):
            node = 0 if still else step // every
            P = Phi[node] @ P
            before, source = source, _source(H[node], P)
            X = Phi[node] @ X + Gamma[node] @ (0.5 * (before + source))
            if (step + 1) % every == 0:
                first.append(P[q])
                second.append(X[q].reshape(-1, k, k))
    linear, square = np.concatenate(first), np.concatenate(second)
    if not max(np.abs(linear).max(), np.abs(square).max()) < FAR:
        return None
    return SecondOrder(linear, 0.5 * (square + np.swapaxes(square, 1, 2)))


def _source(H: Array, P: Array) -> Array:
    """(nx, k k) half the second derivative of the rates along each pair of columns of P."""
    return np.asarray(0.5 * np.moveaxis(np.tensordot(P.T, H, axes=1) @ P, 1, 0).reshape(len(P), -1))


def _first_limits(e: Equations, base: Simulation, basis: Array) -> list[Array]:
    """The direction that reaches a limit of the actuators first, and those that take the force off each one-sided surface first."""
    limit, one_sided = e.actuators.limit, [i for i, s in enumerate(e.surfaces) if s.one_sided]
    if limit is None and not one_sided:
        return []
    k = basis.shape[1]
    moved = e.flow(np.full(2 * k, base.t[0]), base.x[0] + SHIFT * np.concatenate([basis.T, -basis.T]))
    rows = []
    if limit is not None:
        command = value(moved.command)
        slopes, mean = command[:k] - command[k:], command.mean(axis=0)
        nearest = int(np.argmax(np.abs(slopes).sum(axis=0) / np.maximum(limit - np.abs(mean), 1e-300)))
        rows.append(slopes[:, nearest] * (-1.0 if mean[nearest] < 0 else 1.0))
    for i in one_sided:
        force = value(moved.contact.forces[i])
        rows += [-row for row in (force[:k] - force[k:]).T[list(e.surfaces[i].index)]]
    return [_on_box(np.sign(row), e.n) for row in rows if np.any(row[: e.n])]


def _on_box(c: Array, joints: int) -> Array:
    """The direction (k,) with the largest joint at 1 or -1 and no entry beyond."""
    size = np.abs(c[:joints]).max()
    return np.clip(c / size, -1.0, 1.0) if size > 1e-6 * np.abs(c).max() else _on_box(c + np.abs(c).max() * (np.arange(c.size) == 0), joints)


def _inside(c: Array, joints: int) -> Array:
    """Directions (..., k) scaled so that the largest joint is at 1 or -1, no entry beyond."""
    return np.asarray(np.clip(c / np.maximum(np.abs(c[..., :joints]).max(axis=-1, keepdims=True), 1e-300), -1.0, 1.0))


def _distinct(reached: Array, c: Array, *, signed: bool = False) -> list[tuple[float, Array]]:
    """The largest first, without those that have the direction of a larger one (either sign unless ``signed``)."""
    unit = c / np.linalg.norm(c, axis=1, keepdims=True)
    cosine = unit @ unit.T
    same, kept = (cosine if signed else np.abs(cosine)) >= SAME, np.empty(0, int)
    for i in np.argsort(-reached, kind="stable"):
        if not same[i, kept].any():
            kept = np.append(kept, i)
    return [(float(reached[i]), c[i]) for i in kept]


def _ratio(square: Array, linear: Array) -> Array:
    """square / linear, at least the square of ``NOTHING``; ``linear`` is 1 or more, since a joint starts at 1."""
    return np.maximum(square / linear, NOTHING**2)
