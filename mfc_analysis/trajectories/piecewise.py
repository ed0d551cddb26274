"""Piecewise quintic polynomials for splines and sampled paths, fast for a single time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.maths.arrays import Array

_DEGREES = np.arange(6.0)


@dataclass(frozen=True, eq=False)
class Piecewise:
    """Position, velocity and acceleration of n channels by quintics between m times; held at rest outside them."""

    breaks: Array  #: (m,) [s]
    coefficients: Array  #: (m - 1, 6, 3 n) of powers of the time since the last break: positions, velocities, accelerations
    n: int

    @staticmethod
    def of(breaks: Array, powers: Array) -> Piecewise:
        """From coefficients (m - 1, 6, n) of the powers 0..5 of the time since each break."""
        v, a = np.zeros_like(powers), np.zeros_like(powers)
        k = _DEGREES[1:, None]
        v[:, :5] = k * powers[:, 1:]
        a[:, :5] = k * v[:, 1:]
        return Piecewise(breaks, np.concatenate([powers, v, a], axis=-1), powers.shape[-1])

    @staticmethod
    def spline(breaks: Array, positions: Array) -> Piecewise:
        """The quintic spline through positions (m, n) with zero velocity and acceleration at both ends."""
        from scipy.interpolate import make_interp_spline

        zero = np.zeros(positions.shape[1])
        ends = [(1, zero), (2, zero)]
        curve = make_interp_spline(breaks, positions, k=5, bc_type=(ends, ends))  # its knots are the breaks
        v, a = curve(breaks, nu=1), curve(breaks, nu=2)
        v[[0, -1]] = a[[0, -1]] = 0.0
        return Piecewise.hermite(breaks, positions, v, a)

    @staticmethod
    def hermite(breaks: Array, q: Array, v: Array, a: Array) -> Piecewise:
        """The quintics with these positions, velocities and accelerations (m, n) at the breaks."""
        T = np.diff(breaks)[:, None]
        d, v0, v1, a0, a1 = q[1:] - q[:-1], v[:-1] * T, v[1:] * T, a[:-1] * T**2, a[1:] * T**2
        c3 = 10 * d - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
        c4 = -15 * d + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
        c5 = 6 * d - 3 * (v0 + v1) - 0.5 * (a0 - a1)
        return Piecewise.of(breaks, np.stack([q[:-1], v[:-1], 0.5 * a[:-1], c3 / T**3, c4 / T**4, c5 / T**5], axis=1))

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration (..., n) at times (...)."""
        first, last = self.breaks[0], self.breaks[-1]
        inside = np.minimum(np.maximum(t, first), last)
        i = np.minimum(np.searchsorted(self.breaks, inside, side="right") - 1, len(self.breaks) - 2)
        powers = (inside - self.breaks[i])[..., None] ** _DEGREES
        out = (powers[..., None, :] @ self.coefficients[i])[..., 0, :]
        n = self.n
        q, v, a = out[..., :n], out[..., n : 2 * n], out[..., 2 * n :]
        if (inside != t).any():
            moving = (inside == t)[..., None]
            v, a = np.where(moving, v, 0.0), np.where(moving, a, 0.0)
        return q, v, a
