"""The disturbances that the linear model predicts worst, from the second-order and then the nonlinear response of the loop.

The largest misfits to second order (``second_order``) cost no simulation. At the size of the radius higher orders may count too: where the
misfit of the nonlinear ``response`` is not that of the second order, a pattern search climbs it from these maxima, many directions at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import value
from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.response import STEPS, Follower
from mfc_analysis.simulation.second_order import NOTHING, SHIFT, SecondOrder, expansion

STARTS = 16  #: random starts of the search, beside the singular directions and the joints
MAXIMA = 2  #: local maxima of the second order that are tried with both signs
MISFIT = 0.05  #: nrmse up to which the linear model is said to hold
LARGEST = 3.0  #: [rad, m] largest disturbance tried
CLIMBED, CLIMBERS = 6, 6  #: maxima of the second order from which the search on the nonlinear response starts, and directions that climb
PATTERN = (0.7, 0.7, 0.4, 0.4, 0.2, 0.1)  #: changes of the entries in its steps
TOGETHER = (1, 2, 4, 8)  #: numbers of entries changed together, beside all that gain
WORST = 1.0  #: misfit from which on directions count as equally bad
SECOND = 0.1  #: of the largest misfit: where no misfit differs by more from that to second order, its maxima are the worst directions
SAME = 0.98  #: cosine of two directions that count as one
NEARLY = 0.9  #: of the largest misfit: below it a direction that the second order describes is not tried
FIRST = 0.5  #: [rad, m] largest size at which a search begins

Ranked = tuple[float, Array]  #: size at which the misfit would be 1, and direction (k,)


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


def candidates(along: Along, basis: Array, seed: int) -> list[Candidate]:
    """Directions in the box of the ``basis`` (some joint at 1, no entry beyond 1), the worst of the nonlinear response first.

    Then, where that is not the response to second order, the worst to second order with both signs; and the directions that reach a torque limit
    or leave a surface first.
    """
    n, k = along.e.n, basis.shape[1]
    rng = np.random.default_rng(seed)
    starts = np.array([on_box(c, n) for c in (*np.eye(k)[:n], np.ones(k), *rng.uniform(-1.0, 1.0, (STARTS, k)))])
    try:
        both = expansion(along, basis)
    except MfcError:  # the law cannot be evaluated beside the run
        both = None
    if both is None:
        out = _signed([(np.inf, c) for c in starts[:MAXIMA]])
    else:
        second = both.of_joints(along.e.parts["q"].where).turned()
        singular = np.linalg.svd(second.second.reshape(-1, k), full_matrices=False)[2]
        reached, where = second.maxima(np.array([*(on_box(c, n) for c in singular[:n]), *starts]), n)
        maxima = _signed([(float(np.exp(-largest)), c) for largest, c in _distinct(reached, where)])
        out = _worst_of(Follower(along, basis, both), second, maxima, starts, n)
    out += [(np.inf, c) for c in _first_limits(along, basis)]
    return [Candidate(basis @ c, reach) for reach, c in out]


def _signed(ranked: list[Ranked]) -> list[Ranked]:
    return [(reach, sign * c) for reach, c in ranked for sign in (1.0, -1.0)]


def _worst_of(follower: Follower, second: SecondOrder, maxima: list[Ranked], others: Array, n: int) -> list[Ranked]:
    """The directions with the largest misfits of the nonlinear response.

    Where the second order gives the misfits of its ``maxima``, the largest of these. Else what a search on the nonlinear response finds from the
    best of these and of ``others`` (m, k), and the largest to second order.
    """
    size = min(MISFIT * maxima[0][0], FIRST)
    c = np.array([c for _, c in maxima[: 2 * CLIMBED]])
    found = _misfits(follower, c[:, None], size)[:, 0]
    if np.abs(found - size * np.exp(second.ratios(c))).max() <= SECOND * found.max():
        return [(size / misfit, at) for misfit, at in _distinct(found, c, signed=True) if misfit >= NEARLY * found.max()]
    c, found = np.concatenate([c, others]), np.concatenate([found, _misfits(follower, others[:, None], size)[:, 0]])
    some = np.argsort(-found, kind="stable")[: max(4, CLIMBERS * STEPS[1] // max(follower.steps, STEPS[1]))]  # the more steps, the fewer
    climbed = _climbed(follower, c[some], found[some], size, n)
    return climbed + [one for one in maxima[: 2 * MAXIMA] if not any(np.array_equal(one[1], c) for _, c in climbed)]


def _misfits(follower: Follower, c: Array, size: float) -> Array:
    """(m, j) of directions (m, j, k); -1 where it is not known."""
    found = follower.misfits(size * c)
    return np.where(np.isnan(found), -1.0, np.minimum(found, WORST))


def _climbed(follower: Follower, c: Array, worst: Array, size: float, n: int) -> list[Ranked]:
    """Pattern search in the box for larger misfits, from directions c (m, k) with the misfits ``worst`` (m,) at ``size``.

    The misfit is that at the radius of the worst direction so far.
    """
    low, high = 0.0, np.inf  #: [rad, m] sizes below and above the one where the worst is MISFIT
    moved_none = 0.0  #: the last step that moved no direction
    for step in PATTERN:
        if worst.max() < NOTHING:
            return []
        if step == moved_none:
            continue
        low, high = (low if low < size else 0.0, size) if worst.max() > MISFIT else (size, high if high > size else np.inf)
        wanted = min(size * float(np.clip(MISFIT / worst.max(), 0.3, 3.0)), LARGEST)
        size = wanted if low <= wanted < high else float(np.sqrt(low * high))  # where a limit is reached the misfit is not in proportion
        later, worst = pattern_step(partial(_misfits, follower, size=size), c, step, n)
        moved_none = step if np.array_equal(later, c) else 0.0
        c = later
    return [(size / found, at) for found, at in _distinct(worst, c, signed=True) if found > 0]


def pattern_step(misfits: Callable[[Array], Array], c: Array, step: float, joints: int) -> tuple[Array, Array]:
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


def _first_limits(along: Along, basis: Array) -> list[Array]:
    """The direction that reaches a limit of the actuators first, and those that take the force off each one-sided surface first."""
    e, base = along.e, along.base
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
    return [on_box(np.sign(row), e.n) for row in rows if np.any(row[: e.n])]


def on_box(c: Array, joints: int) -> Array:
    """The direction (k,) with the largest joint at 1 or -1 and no entry beyond."""
    size = np.abs(c[:joints]).max()
    return np.clip(c / size, -1.0, 1.0) if size > 1e-6 * np.abs(c).max() else on_box(c + np.abs(c).max() * (np.arange(c.size) == 0), joints)


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
