"""The characteristic function of a loop with dead time.

Only the delayed wires stay cut. With the others closed,

    x' = A x + B w_in,   w_out = C x + D w_in,   w_in,j(t) = w_out,j(t - T_j),

and with E = diag(e^(-s T)), G(s) = C (sI - A)^-1 B + D the roots of the loop are the zeros of

    f(s) = det(sI - A) det(I - E G(s)),

which is entire: f has no poles. A sampled loop has x[k + 1] and z = e^(s dt) in the place of x' and s; its dead times are whole samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import matrix_balance

from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.maths.arrays import Array, Bools, Complex, on_axis

NEAR = 1e-5  #: relative distance from a pole of G within which f is computed without G
CHUNK = 2_000_000  #: complex numbers solved for at a time
PHASES = 48  #: relative phases tried of two dead times
BESIDE = 1e-11  #: relative distance from a pole of G below which f is taken beside it: nearer, its rate has no digits
SURE = 1e-9  #: relative distance from a limit at which a bound of a spectral radius settles on which side of it the radius is
NO_LOOP = 1e-12  #: a loop gain below this fraction of the largest entry of G is no loop


@dataclass(frozen=True, eq=False)
class Delayed:
    """One point of a loop with its nd delayed wires cut and the others closed; states balanced."""

    A: Array  #: (nx, nx)
    B: Array  #: (nx, nd)
    C: Array  #: (nd, nx)
    D: Array  #: (nd, nd)
    T: Array  #: (nd,) [s] > 0
    scale: Array  #: (nx,) physical state = scale x
    dt: float = 0.0  #: [s] 0: continuous

    @cached_property
    def open_poles(self) -> Complex:
        """(nx,) poles of G: eigenvalues of A."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @cached_property
    def closed_poles(self) -> Complex:
        """(nx,) poles of the loop without dead time."""
        nd = len(self.T)
        return np.linalg.eigvals(self.A + self.B @ np.linalg.solve(np.eye(nd) - self.D, self.C)).astype(np.complex128)

    @cached_property
    def places(self) -> Complex:
        """[rad/s] the poles with and without dead time in the s plane, and 1/T: where f has features."""
        s = rates(np.concatenate([self.open_poles, self.closed_poles]), self.dt)
        return np.asarray(np.concatenate([s[np.isfinite(s) & (s != 0)], 1 / self.T]), np.complex128)

    @cached_property
    def one_delay(self) -> bool:
        """True where all dead times are equal: E is then a number."""
        return bool(np.ptp(self.T) <= 1e-12 * self.T.max())

    @cached_property
    def strongest_direct(self) -> float:
        """Largest spectral radius of E D over all phases of E: 1 or more gives an infinite chain of roots in the right half plane."""
        if not self.D.any() or self.dt:
            return 0.0
        if self.one_delay:
            return float(np.abs(np.linalg.eigvals(self.D)).max())
        late = self.T.min() * (1 + 1e-12) < self.T
        turns = np.exp(1j * np.linspace(0, 2 * np.pi, PHASES, endpoint=False))[:, None, None] * late[:, None] + ~late[:, None]
        return float(np.abs(np.linalg.eigvals(turns * self.D)).max())

    @cached_property
    def in_a_loop(self) -> bool:
        """False where no dead time lies in a loop: the roots are then those of A."""
        size = np.abs(self.places)
        w = np.geomspace(1e-2 * size.min(), min(1e2 * size.max(), np.pi / self.dt if self.dt else np.inf), 40)
        G = np.abs(self.gain(on_axis(w)))
        if np.einsum("kii->ki", G).max() >= NO_LOOP * max(1.0, float(G.max())):  # no spectral radius is below an entry of the diagonal
            return True
        if not np.linalg.matrix_power(G.any(axis=0).astype(float), len(self.T)).any():  # a chain that no wire closes
            return False
        return bool(perron(G).max(initial=0.0) >= NO_LOOP * max(1.0, float(G.max(initial=0.0))))

    def z(self, s: Complex) -> tuple[Complex, Complex]:
        """The variable of A at s (k,), and its derivative: s and 1, or z and dz/ds of a sampled loop."""
        if not self.dt:
            return s, np.ones(s.shape, np.complex128)
        z = np.asarray(np.exp(s * self.dt), np.complex128)
        return z, np.asarray(self.dt * z)

    def _beside_poles(self, s: Complex) -> tuple[Complex, Complex]:
        """``z``, moved to the unstable side where it lies on a pole of G."""
        z, slope = self.z(np.asarray(s, np.complex128))
        near = np.abs(z[:, None] - self.open_poles).min(axis=1, initial=np.inf) <= BESIDE * np.abs(z)
        aside = np.maximum(BESIDE * np.abs(z), 1e-300) * (np.exp(1j * np.angle(z)) if self.dt else 1.0)
        return np.where(near, z + aside, z), slope

    def response(self, s: Complex) -> tuple[Complex, Complex]:
        """G (k, nd, nd) and dG/ds at s (k,)."""
        z, slope = self._beside_poles(s)
        G, dG = np.empty((2, z.size, len(self.T), len(self.T)), np.complex128)
        for some, matrix, X in self._solutions(z):
            G[some] = self.C @ X + self.D
            dG[some] = -self.C @ _solved(matrix, X) * slope[some, None, None]
        return G, dG

    def gain(self, s: Complex) -> Complex:
        """G (k, nd, nd) at s (k,)."""
        z, _ = self._beside_poles(s)
        return np.concatenate([self.C @ X + self.D for _, _, X in self._solutions(z)])

    def _solutions(self, z: Complex) -> Iterator[tuple[slice, Complex, Complex]]:
        """Parts of z, zI - A and (zI - A)^-1 B there."""
        nx = len(self.A)
        step = max(1, CHUNK // max(1, nx * nx))
        for k in range(0, z.size, step):
            matrix = z[k : k + step, None, None] * np.eye(nx) - self.A
            yield slice(k, k + step), matrix, _solved(matrix, np.broadcast_to(self.B.astype(complex), (len(matrix), *self.B.shape)))

    def value(self, s: Complex, poles: Complex) -> tuple[Array, Complex, Complex]:
        """Of g = f / prod(s - poles) at s (k,): its phase [rad] modulo a turn and (dg/ds) / g, each (k,); and E G (k, nd, nd)."""
        s = np.asarray(s, np.complex128)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            G, dG = self.response(s)
            E = np.exp(-s[:, None] * self.T)[:, :, None]
            loop = E * G
            K = np.eye(len(self.T)) - loop
            dK = self.T[:, None] * loop - E * dG
            z, slope = self._beside_poles(s)
            up, down = z[:, None] - self.open_poles, z[:, None] - poles
            phase = np.angle(np.linalg.slogdet(K)[0]) + np.angle(up).sum(axis=1) - np.angle(down).sum(axis=1)
            rate = np.trace(_solved(K, dK), axis1=1, axis2=2) + slope * ((1 / up).sum(axis=1) - (1 / down).sum(axis=1))
        rate = np.asarray(rate)
        near = np.flatnonzero((np.abs(up) < NEAR * np.abs(z)[:, None]).any(axis=1))  # beside a pole of G: from the matrix, which has none
        if near.size:
            M, dM = self.matrix(s[near])
            phase[near] = np.angle(np.linalg.slogdet(M)[0]) - np.angle(down[near]).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                rate[near] = np.trace(_solved(M, dM), axis1=1, axis2=2) - slope[near] * (1 / down[near]).sum(axis=1)
        return phase, rate, loop

    def matrix(self, s: Complex) -> tuple[Complex, Complex]:
        """The characteristic matrix M (k, nx + nd, nx + nd) at s (k,), with det M = f, and its derivative."""
        nx, nd = len(self.A), len(self.T)
        z, dz = self.z(s)
        E = np.exp(-s[:, None] * self.T)[:, :, None]
        M = np.zeros((s.size, nx + nd, nx + nd), np.complex128)
        slope = np.zeros_like(M)
        M[:, :nx, :nx], M[:, :nx, nx:] = z[:, None, None] * np.eye(nx) - self.A, -self.B
        M[:, nx:, :nx], M[:, nx:, nx:] = -E * self.C, np.eye(nd) - E * self.D
        late = self.T[:, None] * E
        slope[:, :nx, :nx] = dz[:, None, None] * np.eye(nx)
        slope[:, nx:, :nx], slope[:, nx:, nx:] = late * self.C, late * self.D
        return M, slope

    def contraction(self, loop: Complex) -> Array:
        """(k,) bounds of the spectral radius of E G over all phases of E, from E G (k, nd, nd)."""
        if self.one_delay:
            return np.asarray(np.abs(np.linalg.eigvals(loop)).max(axis=1))
        return perron(np.abs(loop))

    def contracts(self, loop: Complex, limit: float) -> Bools:
        """(k,) where ``contraction`` is below ``limit``. Where all dead times are equal, mostly without eigenvalues."""
        return _radius_below(loop, limit) if self.one_delay else np.asarray(perron(np.abs(loop)) < limit)


def _radius_below(M: Complex, limit: float) -> Bools:
    """(k,) where the spectral radius of M (k, n, n) is below ``limit``: by norm and trace of its powers 2, 4, ..., 32, else by eigenvalues."""
    below, unsure = np.zeros(len(M), bool), np.ones(len(M), bool)
    with np.errstate(all="ignore"):
        size = np.linalg.norm(M, axis=(1, 2))
        power, log = M / size[:, None, None], np.log(size)  # M^(2^j) = e^log power
        for j in range(6):
            upper, lower = np.exp(log / 2**j), np.exp((log + np.log(np.abs(np.einsum("kii->k", power)) / M.shape[1])) / 2**j)
            below |= unsure & ((upper < limit * (1 - SURE)) | (size == 0))
            unsure &= ~below & ~(lower > limit * (1 + SURE))
            power = power @ power
            size = np.linalg.norm(power, axis=(1, 2))
            power, log = power / size[:, None, None], 2 * log + np.log(size)
            log[size < 1e-6] = np.nan  # few digits left: no bound settles these
            size[:] = 1
    left = np.flatnonzero(unsure)
    if left.size:
        below[left] = np.abs(np.linalg.eigvals(M[left])).max(axis=1) < limit
    return below


def delayed_points(system: OpenSystem) -> list[Delayed]:
    """Each point of the loop with the delayed wires cut."""
    late = system.wire_delay > 0
    A, B, C, D = close_wires(system, keep=late)
    points = []
    for i in range(len(A)):
        a, b, c = A[i], B[i][:, system.nu :], C[i][system.ny :]
        balanced, (scale, _) = matrix_balance(a, permute=False, separate=True)
        points.append(Delayed(balanced, b / scale[:, None], c * scale, D[i][system.ny :, system.nu :], system.wire_delay[late], scale, system.dt))
    return points


def perron(G: Array) -> Array:
    """Upper bounds (k,) of the spectral radii of nonnegative G (k, n, n), close after a few powers: Collatz-Wielandt quotients."""
    x = np.ones((*G.shape[:2], 1))
    bound = np.full(len(G), np.inf)
    for _ in range(12):
        y = G @ x
        bound = np.minimum(bound, (y / x).max(axis=(1, 2)))
        x = y + 1e-6 * y.max(axis=1, keepdims=True) + 1e-300
        x = x / x.max(axis=1, keepdims=True)
    return np.where(G.any(axis=(1, 2)), bound, 0.0)


def _solved(matrix: Complex, right: Complex) -> Complex:
    try:
        return np.asarray(np.linalg.solve(matrix, right), np.complex128)
    except np.linalg.LinAlgError:  # a few of them are singular to rounding
        return np.stack([_least_squares(a, b) for a, b in zip(matrix, right, strict=True)])


def _least_squares(matrix: Complex, right: Complex) -> Complex:
    if not np.isfinite(matrix).all():
        return np.full(right.shape, np.nan, np.complex128)
    tiny = 1e-14 * (np.abs(matrix).max() + 1e-300)
    try:
        return np.asarray(np.linalg.solve(matrix + tiny * np.eye(len(matrix)), right), np.complex128)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix) @ right, np.complex128)
