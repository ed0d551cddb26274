"""A second way to the unstable roots of a loop with dead time, without any of the library's own code for it.

f(s) = det [[sI - A, -B], [-E C, I - E D]], E = diag(e^(-s T)) over all wires of the opened loop, is entire and its zeros are the roots. They are
counted by Mikhailov's criterion, indented at the origin; where that takes too many samples, one unstable root is sought from random starts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import mfc_analysis as mfc

MOST = 150_000  #: samples
STARTS = 400
Complex = NDArray[np.complex128]


class Undecided(Exception):
    """A root on the contour up to rounding, or too many samples and no root found."""


class Characteristic:
    """f of one point of a loop."""

    def __init__(self, lin: mfc.Linearization, index: int = 0) -> None:
        o = lin.opened
        self.A, self.B, self.C, self.D = o.A[index], o.B[index][:, o.nu :], o.C[index][o.ny :], o.D[index][o.ny :, o.nu :]
        self.T, self.radius = np.asarray(o.wire_delay, float), 1 / lin.horizon
        size = np.abs(np.linalg.eigvals(self.A)).max() + np.linalg.norm(self.B, 2) * np.linalg.norm(self.C, 2)
        self.size = float(size + 1 / self.T[self.T > 0].min() + self.radius)

    def __call__(self, s: Complex) -> tuple[Complex, Complex]:
        """The phase of f as a unit number, and f'/f, at s (k,)."""
        n, nw = len(self.A), len(self.C)
        sign, rate = np.empty(s.size, complex), np.empty(s.size, complex)
        for k in range(0, s.size, 500):
            z = s[k : k + 500]
            E = np.exp(-z[:, None] * self.T)[:, :, None]
            M, dM = np.zeros((2, z.size, n + nw, n + nw), complex)
            M[:, :n, :n], M[:, :n, n:] = z[:, None, None] * np.eye(n) - self.A, -self.B
            M[:, n:, :n], M[:, n:, n:] = -E * self.C, np.eye(nw) - E * self.D
            dM[:, :n, :n], dM[:, n:, :n], dM[:, n:, n:] = np.eye(n), self.T[:, None] * E * self.C, self.T[:, None] * E * self.D
            sign[k : k + 500] = np.linalg.slogdet(M)[0]
            rate[k : k + 500] = np.trace(np.linalg.solve(M, dM), axis1=1, axis2=2)
        return sign, rate

    def turn(self, u: NDArray[np.float64], path: Callable[[NDArray[np.float64]], Complex], speed: Callable[[NDArray[np.float64]], Complex]) -> float:
        """[rad] by which the phase of f changes along path(u). Raises ``Undecided``."""
        sign, rate = self(path(u))
        while True:
            step, rates = np.diff(u), np.abs(rate * speed(u))
            angle = np.angle(sign[1:] / sign[:-1])
            bad = np.flatnonzero((step * np.maximum(rates[1:], rates[:-1]) > 0.7) | (np.abs(angle) > 0.7))
            if not bad.size:
                return float(angle.sum())
            if u.size + bad.size > MOST or (step[bad] < 1e-11 * np.abs(u[bad + 1])).any():
                raise Undecided
            new = 0.5 * (u[bad] + u[bad + 1])
            more = self(path(new))
            u = np.insert(u, bad + 1, new)
            sign, rate = np.insert(sign, bad + 1, more[0]), np.insert(rate, bad + 1, more[1])

    def counted(self) -> int:
        """Roots with a positive real part and abs(s) >= radius. Raises ``Undecided``."""
        r = self.radius

        def circle(u: NDArray[np.float64]) -> Complex:
            return np.asarray(r * np.exp(1j * u))

        def axis(v: NDArray[np.float64]) -> Complex:
            return np.asarray(1j * np.exp(v))

        turn = self.turn(np.linspace(0, np.pi / 2, 65), circle, lambda u: 1j * circle(u))
        turn += self.turn(np.linspace(np.log(r), np.log(1e4 * self.size), 600), axis, axis)
        roots = len(self.A) / 2 - turn / np.pi
        if abs(roots - round(roots)) > 0.1 or roots < -0.1:
            raise Undecided
        return round(roots)

    def found(self) -> bool:
        """Whether an unstable root is found from random starts, with a winding of one about it."""
        rng = np.random.default_rng(0)
        w = np.exp(rng.uniform(np.log(self.radius), np.log(1e2 * self.size), STARTS))
        s = w * np.exp(1j * rng.uniform(0, np.pi / 2, STARTS))
        s = np.where(rng.random(STARTS) < 0.5, s, rng.uniform(0, 5, STARTS) / self.T.max() + 1j * w)
        with np.errstate(all="ignore"):
            step = np.full(s.shape, np.inf, complex)
            for _ in range(60):
                good = np.isfinite(s) & (s.real * self.T.max() < 600) & (s.real > -1 / self.T.max())
                s, step = s[good], step[good]
                try:
                    step = 1 / self(s)[1]
                except np.linalg.LinAlgError:
                    return False
                s = s - step
        for root in s[(np.abs(step) < 1e-3 * s.real) & (s.real > 1e-6 * np.abs(s)) & (np.abs(s) > 1.2 * self.radius)][:20]:
            size = 0.1 * root.real
            around = root + size * np.exp(1j * np.linspace(0, 2 * np.pi, 33))
            if round(float(np.angle(np.divide(*(self(around)[0][k] for k in (slice(1, None), slice(None, -1))))).sum()) / (2 * np.pi)) >= 1:
                return True
        return False


def decays(lin: mfc.Linearization, index: int = 0) -> bool:
    """Whether the loop has no unstable root outside the disc of slow ones. Raises ``Undecided``."""
    f = Characteristic(lin, index)
    try:
        return f.counted() == 0
    except Undecided:
        if f.found():
            return False
        raise
