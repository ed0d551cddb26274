"""The nonlinear response of a loop to many disturbed starts at once, by an exponential integrator along a base run.

With A of the loop linearised along the base run x_b, a deviation d obeys d' = A d + r, r = f(x_b + d) - f(x_b) - A d. Over each step A is held
and solved exactly; r is linear between its ends, the second of them predicted (Cox and Matthews, J. Comput. Phys. 176, 2002). One call of the
equations evaluates all starts, so a start costs a small part of a simulation. Dead time and sampling are left out: the response only
chooses directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array, Bools
from mfc_analysis.maths.zero_order_hold import zero_order_hold
from mfc_analysis.simulation.simulation import Simulation

STEPS = (25, 50, 100, 200)  #: of a response: numbers tried until the steps are short enough
FOLLOWED = 0.75  #: of the starts: those that the steps are to follow
ROUGH = 0.02  #: of the misfit: difference between prediction and correction in steps that are too long
FAR = 1e6  #: [SI] deviation beyond which a response is not followed


@dataclass(frozen=True, eq=False)
class Response:
    """A base run in equal steps, ready for disturbed starts."""

    equations: Equations
    t: Array  #: (N + 1,) [s]
    x: Array  #: (N + 1, nx) the base run
    rates: Array  #: (N + 1, nx) its rates
    A: Array  #: (N + 1, nx, nx)
    Phi: Array  #: (N, nx, nx)
    Gamma: Array  #: (N, nx, nx)

    def misfits(self, starts: Array) -> Array:
        """(m,) rms(nonlinear - linear) / rms(nonlinear) of the joint deviations from the starts x_b + d, d (m, nx).

        NaN where the steps are too long, or the law cannot be evaluated.
        """
        found, rough = self._followed(starts)
        return np.where(rough <= ROUGH, found, np.nan)

    def enough(self, starts: Array, part: float) -> float:
        """Number of steps that can follow this part of the starts: the correction of a step shrinks with the square of its length."""
        rough = np.sort(self._followed(starts)[1])[max(int(part * len(starts)), 1) - 1]
        return len(self.Phi) * float(np.sqrt(rough / ROUGH)) if np.isfinite(rough) else len(self.Phi) + 1.0

    def _followed(self, starts: Array) -> tuple[Array, Array]:
        """The misfits (m,), and what is corrected in the steps, of these misfits; inf where the run was not followed to its end."""
        q = self.equations.parts["q"].where
        linear, d = starts.copy(), starts.copy()
        going = np.asarray(np.isfinite(starts).all(axis=1), bool)
        beyond, corrected, moved = np.zeros(len(starts)), np.zeros(len(starts)), (starts[:, q] ** 2).sum(axis=1)
        r = self._rest(0, d, going)
        for k in range(len(self.Phi)):
            linear = linear @ self.Phi[k].T
            free = d @ self.Phi[k].T
            d = free + r @ self.Gamma[k].T
            later = self._rest(k + 1, d, going)
            change = 0.5 * (later - r) @ self.Gamma[k].T
            d, r = d + change, later
            going &= np.abs(d).max(axis=1) < FAR
            d[~going] = 0.0
            beyond += ((d - linear)[:, q] ** 2).sum(axis=1)
            moved += (d[:, q] ** 2).sum(axis=1)
            corrected += (change[:, q] ** 2).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            rough = np.where(going, np.sqrt(np.where(corrected > 0, corrected / beyond, 0.0)), np.inf)
        return np.sqrt(beyond / np.maximum(moved, 1e-300)), rough

    def _rest(self, k: int, d: Array, going: Bools) -> Array:
        """r (m, nx) at step ``k``; clears ``going`` where the equations cannot be evaluated."""
        out = np.zeros(d.shape)
        some = np.flatnonzero(going)
        with np.errstate(all="ignore"):
            f = _rates(self.equations, float(self.t[k]), self.x[k] + d[some])
            out[some] = f - self.rates[k] - d[some] @ self.A[k].T
        going[some] = np.isfinite(out[some]).all(axis=1)
        out[~going] = 0.0
        return out


def response(e: Equations, base: Simulation, steps: int) -> Response | None:
    """The base run in equal steps; None where the linear response overflows. Raises MfcError where the law cannot be evaluated along it."""
    t = np.linspace(base.t[0], base.t[-1], steps + 1)
    x = base.state(t)
    A = closed_matrix(e, t, x)
    middle = 0.5 * (A[:-1] + A[1:])
    Phi, Gamma = zero_order_hold(middle, np.broadcast_to(np.eye(e.nx), middle.shape), float(t[1] - t[0]))
    if not (np.isfinite(Phi).all() and np.isfinite(Gamma).all()):
        return None
    return Response(e, t, x, e.rates(t, x, lose_contact=True), A, Phi, Gamma)


class Follower:
    """Responses to disturbed starts, in the fewest of the numbers of ``STEPS`` that can follow most of them."""

    def __init__(self, e: Equations, base: Simulation, first: Array) -> None:
        """For the deviations ``first`` (m, nx) at the start, which choose the number of steps. Raises as ``response``."""
        self._equations, self._base, self._finer = e, base, list(STEPS[1:])
        self.along = response(e, base, STEPS[0])  #: None where the linear response overflows
        if self.along is not None:
            self._refine(self.along.enough(first, FOLLOWED))

    @property
    def steps(self) -> int:
        """Their number now."""
        return 0 if self.along is None else len(self.along.Phi)

    def misfits(self, starts: Array) -> Array:
        """(m, j) as ``Response.misfits`` of starts (m, j, nx); in shorter steps from now on where most of them are not followed."""
        while self.along is not None:
            found = self.along.misfits(starts.reshape(-1, starts.shape[-1])).reshape(starts.shape[:-1])
            if not self._finer or np.isfinite(found).mean() >= FOLLOWED:
                return found
            self._refine()
        return np.full(starts.shape[:-1], np.nan)

    def _refine(self, least: float = np.inf) -> None:
        """Shorter steps, ``least`` of them if there may be so many; the next number if it is not given."""
        number = self.steps
        while self._finer and number < least:
            number = self._finer.pop(0)
            if least == np.inf:
                break
        if number != self.steps:
            self.along = response(self._equations, self._base, number)


def _rates(e: Equations, t: float, x: Array) -> Array:
    """The rates (m, nx) at the states x (m, nx); NaN where the law cannot be evaluated."""
    try:
        return e.rates(t, x, lose_contact=True)
    except MfcError:
        if len(x) <= 1:
            return np.full(x.shape, np.nan)
    half = len(x) // 2
    return np.concatenate([_rates(e, t, x[:half]), _rates(e, t, x[half:])])
