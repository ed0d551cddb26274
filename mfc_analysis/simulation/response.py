"""The nonlinear response of a loop to many disturbed starts at once, along a base run.

With A of the loop linearised along the base run x_b, a deviation d obeys d' = A d + r, r = f(x_b + d) - f(x_b) - A d. From the response to second
order, r is taken at all times of all starts in one call of the equations, and the linear part is solved for it exactly, with the mean of r over
each step; this is repeated until the response stays the same (Picard's iteration: what is wrong shrinks with the size of the deviation each time).
Where it does not settle, as in a stiff loop far off, the same is done step by step (Cox and Matthews, J. Comput. Phys. 176, 2002). A start costs a
small part of a simulation. Dead time and sampling are left out: the response only chooses directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.errors import MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.second_order import NOTHING, Expansion

STEPS = (20, 50, 100, 200)  #: of a response: even numbers that are tried until the steps are short enough
FOLLOWED = 0.5  #: of the starts: those that the steps are to follow
ROUGH = 0.1  #: of the misfit: its error by steps that are too long
SMALL = 0.3  #: of the largest misfit: below it a misfit need not be more accurate
FAR = 1e6  #: [SI] deviation beyond which a response is not followed
AGREED, SHRINKS = 0.25, 0.5  #: change in the last repetition, of what is beyond the linear response; and that in a repetition, of the one before


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
    first: Array  #: (N + 1, nx, nx) the linear response to a deviation at the start

    def misfits(self, starts: Array, beyond: Array) -> Array:
        """(m,) rms(nonlinear - linear) / rms(nonlinear) of the joint deviations from the starts x_b + d, d (m, nx).

        ``beyond`` (N + 1, m, nx): a guess of what the nonlinear responses add to the linear ones. NaN where the steps are too long; inf where a
        response cannot be followed to its end, as that of a run.
        """
        q = self.equations.parts["q"].where
        with np.errstate(all="ignore"):
            linear = np.swapaxes(self.first @ starts.T, 1, 2)
            found, r = self._repeated(linear, beyond)
            left = np.flatnonzero(np.isnan(found[-1, :, 0]))
            if left.size:
                found[:, left], r[:, left] = self._stepped(linear[:, left])
            moved = _rms((linear + found)[..., q])
            size, error = _rms(found[..., q]) / moved, _rms(self._error(found, r)[..., q]) / moved
            return np.where(error <= ROUGH * _scale(size), size, np.where(np.isfinite(error), np.nan, np.inf))

    def _repeated(self, linear: Array, guess: Array) -> tuple[Array, Array]:
        """What is beyond the ``linear`` responses, and r there, (N + 1, m, nx) each, from a ``guess``; NaN where the repetition does not settle."""
        q = self.equations.parts["q"].where
        out, rest = np.full(linear.shape, np.nan), np.full(linear.shape, np.nan)
        going, before = np.arange(linear.shape[1]), np.full(linear.shape[1], np.inf)
        while going.size:
            r = self._rest(slice(None), linear[:, going] + guess)
            found = _solved(self.Phi, self.Gamma, r)
            size, change, moved = (_rms(y[..., q]) for y in (found, found - guess, linear[:, going] + found))
            done = change <= AGREED * moved * _scale(size / moved)
            out[:, going[done]], rest[:, going[done]] = found[:, done], r[:, done]
            more = ~done & (change < SHRINKS * before) & (np.abs(linear[:, going] + found).max(axis=(0, 2)) < FAR)
            going, guess, before = going[more], found[:, more], change[more]
        return out, rest

    def _stepped(self, linear: Array) -> tuple[Array, Array]:
        """The same step by step, with r at the end of a step from a prediction; NaN where a response is not followed to its end."""
        out, rest = np.full(linear.shape, np.nan), np.full(linear.shape, np.nan)
        going = np.flatnonzero(np.isfinite(linear).all(axis=(0, 2)))
        found = np.zeros((going.size, linear.shape[2]))
        r = self._rest(slice(0, 1), linear[:1, going])[0]
        out[0, going], rest[0, going] = found, r
        for k, (Phi, Gamma) in enumerate(zip(self.Phi, self.Gamma, strict=True), start=1):
            found = found @ Phi.T + r @ Gamma.T
            near = np.abs(linear[k, going] + found).max(axis=1, initial=0.0) < FAR
            going, found, r = going[near], found[near], r[near]
            later = self._rest(slice(k, k + 1), (linear[k, going] + found)[None])[0]
            found, r = found + 0.5 * (later - r) @ Gamma.T, later
            out[k, going], rest[k, going] = found, r
        return out, rest

    def _error(self, beyond: Array, r: Array) -> Array:
        """(N / 2 + 1, m, nx) the error in ``beyond``, the response to r, by what steps of twice the length make of it."""
        Phi, Gamma = self.Phi[1::2] @ self.Phi[::2], self.Gamma[1::2] + self.Phi[1::2] @ self.Gamma[::2]
        return np.asarray((_solved(Phi, Gamma, r[::2]) - beyond[::2]) / 3)  # of second order in the step

    def _rest(self, at: slice, d: Array) -> Array:
        """r (j, m, nx) of deviations d, likewise, at the steps ``at``; NaN where the equations cannot be evaluated."""
        x = self.x[at, None] + d
        f = _rates(self.equations, np.repeat(self.t[at], d.shape[1]), x.reshape(-1, d.shape[2])).reshape(d.shape)
        return np.asarray(f - self.rates[at, None] - d @ np.swapaxes(self.A[at], 1, 2))


def _solved(Phi: Array, Gamma: Array, r: Array) -> Array:
    """d' = A d + r (N + 1, m, nx) from d = 0, r its mean over each step: (N + 1, m, nx)."""
    forced = 0.5 * (r[:-1] + r[1:]) @ np.swapaxes(Gamma, 1, 2)
    out = np.zeros(r.shape)
    for k in range(len(Phi)):
        out[k + 1] = out[k] @ Phi[k].T + forced[k]
    return out


def _scale(misfits: Array) -> Array:
    """What an error is compared with: the misfit, or a part of the largest where that is more, since only the largest matter."""
    return np.maximum(misfits, max(SMALL * float(np.nanmax(misfits, initial=0.0)), NOTHING))


def _rms(y: Array) -> Array:
    """(m,) of (N, m, n)."""
    return np.asarray(np.sqrt((y**2).mean(axis=(0, 2))))


def response(along: Along, steps: int) -> Response | None:
    """The base run in equal steps; None where the linear response overflows. Raises MfcError where the law cannot be evaluated along it."""
    e, t = along.e, np.linspace(along.t[0], along.t[-1], steps + 1)
    x, (Phi, Gamma) = along.base.state(t), along.steps(steps)
    if not (np.isfinite(Phi).all() and np.isfinite(Gamma).all()):
        return None
    return Response(e, t, x, e.rates(t, x, lose_contact=True), along.A(t), Phi, Gamma, accumulated(Phi))


class Follower:
    """Responses to disturbed starts, in the fewest of the numbers of ``STEPS`` that can follow most of them."""

    def __init__(self, along: Along, basis: Array, second: Expansion) -> None:
        """For disturbances of the ``basis`` (nx, k). ``second``: their response to second order, the first guess. Raises as ``response``."""
        self._along, self._basis, self._second, self._finer = along, basis, second, list(STEPS[1:])
        self.response = response(along, STEPS[0])  #: None where the linear response overflows

    @property
    def steps(self) -> int:
        """Their number now."""
        return 0 if self.response is None else len(self.response.Phi)

    def misfits(self, c: Array) -> Array:
        """(m, j) as ``Response.misfits`` of disturbances (m, j, k); in shorter steps from now on where most of them are not followed."""
        while self.response is not None:
            each = c.reshape(-1, c.shape[-1])
            found = self.response.misfits(each @ self._basis.T, self._second.beyond(self.response.t, each)).reshape(c.shape[:-1])
            if not self._finer or np.isnan(found).mean() <= 1 - FOLLOWED:
                return found
            self.response = response(self._along, self._finer.pop(0))
        return np.full(c.shape[:-1], np.nan)


def _rates(e: Equations, t: Array, x: Array) -> Array:
    """The rates (m, nx) at the states x (m, nx) and times t (m,); NaN where the law cannot be evaluated."""
    try:
        return e.rates(t, x, lose_contact=True)
    except MfcError:
        if len(x) <= 1:
            return np.full(x.shape, np.nan)
    half = len(x) // 2
    return np.concatenate([_rates(e, t[:half], x[:half]), _rates(e, t[half:], x[half:])])
