"""The loop linearised along a base run: A(t), and its transition matrices in equal steps. Dead time and sampling are left out.

Along most runs A(t) is smooth: a polynomial through a few Chebyshev points gives it everywhere. Where the polynomial does not settle, or misses
what happens between its points (a limit that is reached for a short time, friction where a joint turns back), A is evaluated at each time that is
asked for.
"""

from __future__ import annotations

from functools import cache, cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from mfc_analysis.analysis.floquet import transitions
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.zero_order_hold import zero_order_hold
from mfc_analysis.simulation.simulation import Motion

STEPS = 200  #: of equal length, over the run
DEGREES = (8, 16, 32, 64)  #: of the polynomial, tried until it settles
SETTLED, LAST = 1e-9, 3  #: of its largest coefficient: the last ones of a polynomial that gives A(t), and their number
GIVEN = 1e-6  #: of its largest value in the run: the error of a rate in the middle of a step, up to which a polynomial through the points gives it
ROUGHLY = 1e-3  #: of its largest coefficient: those that are left out where A(t) need not be accurate
PIECES = 25  #: over which A(t) is held there, if it is not smooth
FAST = 0.3  #: modulus of the largest root times a step, above which an input is held by the matrix exponential


class Along:
    """The loop of the equations ``e``, linearised along the run ``base``. Its methods raise MfcError where the law cannot be evaluated there."""

    def __init__(self, e: Equations, base: Motion) -> None:
        self.e, self.base = e, base
        self.t = np.linspace(base.t[0], base.t[-1], STEPS + 1)  #: [s]

    def A(self, t: Array) -> Array:
        """(m, nx, nx) at times t (m,) [s]."""
        if self._series is None:
            return closed_matrix(self.e, t, self.base.state(t))
        return np.asarray(self._powers(t, len(self._series) - 1) @ self._series).reshape(len(t), self.e.nx, self.e.nx)

    @cached_property
    def still(self) -> bool:
        """True where the run is at rest."""
        start = self.base.x[0]
        near = 1e-9 * (1 + np.abs(start).max())
        return all(np.abs(self.base.state(self.t[::every]) - start).max() <= near for every in (STEPS // 8, 1))  # most move at the first few

    @cached_property
    def Phi(self) -> Array:
        """(STEPS, nx, nx) transition matrices of the steps."""
        Phi = transitions(self.A, self.t[:2] if self.still else self.t, smooth=self._series is not None)
        return np.broadcast_to(Phi, (STEPS, *Phi.shape[1:]))

    def steps(self, count: int) -> tuple[Array, Array]:
        """Phi and Gamma, (count, nx, nx) each, of x' = A(t) x + u in ``count`` steps, a divisor of ``STEPS``, with u held over each."""
        merged, one = STEPS // count, np.eye(self.e.nx)
        h = float(self.t[1] - self.t[0])
        if merged % 2 or self.fastest * h > FAST:
            middle = self.A(0.5 * (self.t[:-merged:merged] + self.t[merged::merged]))
            return zero_order_hold(middle, np.broadcast_to(one, middle.shape), merged * h)
        each = self.Phi.reshape(count, merged, *one.shape)
        with np.errstate(over="ignore", invalid="ignore"):  # Gamma by Simpson's rule, from the end of the step
            Phi, Gamma = each[:, -1], one + 4 * each[:, -1]
            for k in range(2, merged + 1):
                Phi = Phi @ each[:, merged - k]
                Gamma = Gamma + (1 if k == merged else 4 if k % 2 else 2) * Phi
            return Phi, Gamma * (h / 3)

    def roughly(self, t: Array) -> tuple[Array, Array]:
        """Times (k,) [s] at which to take what is as smooth as A(t), and the weights (m, k) with which these give it at times t (m,) [s]."""
        if self.still:
            return self.t[:1], np.ones((len(t), 1))
        if self._series is None:
            at = self.t[: -1 : STEPS // PIECES]
            return at, np.eye(PIECES)[np.searchsorted(at[1:], t, side="right")]
        size = np.abs(self._series).max(axis=1)
        degree = max(1, int(np.flatnonzero(size >= ROUGHLY * size.max())[-1]))
        return self._points(degree), self._powers(t, degree) @ _coefficients(degree)

    @cached_property
    def fastest(self) -> float:
        """[1/s] largest modulus of a root at the start, in the middle and at the end."""
        return float(np.abs(np.linalg.eigvals(self.A(self.t[:: STEPS // 2]))).max())

    @cached_property
    def _series(self) -> Array | None:
        """(degree + 1, nx nx) coefficients of A(t); None where no degree in ``DEGREES`` settles, or the run itself is not as smooth between."""
        if self.still:
            return closed_matrix(self.e, self.t[:1], self.base.x[:1]).reshape(1, -1)
        samples = np.empty((0, self.e.nx**2))
        for degree in DEGREES:
            t, known = self._points(degree), samples
            new = slice(None) if degree == DEGREES[0] else slice(1, None, 2)
            samples = np.empty((degree + 1, self.e.nx**2))
            samples[::2] = known if len(known) else 0.0
            samples[new] = closed_matrix(self.e, t[new], self.base.state(t[new])).reshape(-1, self.e.nx**2)
            found = _coefficients(degree) @ samples
            size = np.abs(found).max(axis=1)
            if size[-LAST:].max() <= SETTLED * size.max() and self._smooth(degree, SETTLED * size.max()):
                return np.asarray(found, float)
        return None

    def _smooth(self, degree: int, noise: float) -> bool:
        """True where a polynomial through the points gives the rates x' in the middle of every step: they take a quarter of the time of A.

        ``noise``: of a rate for each unit of the state.
        """
        t = self._points(degree)
        series = _coefficients(degree) @ self.e.rates(t, self.base.state(t))
        middle, x, exact = self._middles
        off = np.abs(self._powers(middle, degree) @ series - exact).max(axis=0)
        return bool(np.all(off <= GIVEN * np.abs(exact).max(axis=0) + noise * (1 + np.abs(x).max())))

    @cached_property
    def _middles(self) -> tuple[Array, Array, Array]:
        """Times (STEPS,) [s] in the middle of the steps, and states and rates there, (STEPS, nx) each."""
        t = 0.5 * (self.t[:-1] + self.t[1:])
        x = self.base.state(t)
        return t, x, self.e.rates(t, x)

    def _points(self, degree: int) -> Array:
        """(degree + 1,) [s] Chebyshev points of the run, its start and end among them."""
        return np.asarray(self.t[0] + 0.5 * (1 + _unit_points(degree)) * (self.t[-1] - self.t[0]))

    def _powers(self, t: Array, degree: int) -> Array:
        """(m, degree + 1) Chebyshev polynomials at times t (m,) [s]."""
        return np.asarray(chebvander(2 * (t - self.t[0]) / (self.t[-1] - self.t[0]) - 1, degree), float)


@cache
def _unit_points(degree: int) -> Array:
    return -np.cos(np.pi * np.arange(degree + 1) / degree)


@cache
def _coefficients(degree: int) -> Array:
    """(degree + 1, degree + 1) from samples at the points to the coefficients of the polynomial."""
    return np.asarray(np.linalg.inv(chebvander(_unit_points(degree), degree)), float)
