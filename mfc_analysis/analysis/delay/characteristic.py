"""The characteristic function of a loop with dead time.

Only the delayed wires stay cut. With the others closed,

    x' = A x + B w_in,   w_out = C x + D w_in,   w_in,j(t) = w_out,j(t - T_j),

and with E = diag(e^(-s T)), G(s) = C (sI - A)^-1 B + D the roots of the loop are the zeros of

    f(s) = det(sI - A) det(I - E G(s)),

which is entire: f has no poles. A sampled loop has x[k + 1] and z = e^(s dt) in the place of x' and s; its dead times are whole samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import get_lapack_funcs

from mfc_analysis.analysis.delay.stacked import Stacked, perron
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints, on_axis

PHASES = 48  #: relative phases tried of two dead times
FREQUENCIES = (5, 40)  #: at which a loop is sought, the second number where the first finds none
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
    def alone(self) -> Stacked:
        """This point, ready for evaluation."""
        return stacked([self])

    @property
    def open_poles(self) -> Complex:
        """(nx,) poles of G: eigenvalues of A."""
        return np.asarray(self.alone.open_poles[0], np.complex128)

    @property
    def closed_poles(self) -> Complex:
        """(nx,) poles of the loop without dead time."""
        return np.asarray(self.alone.closed_poles[0], np.complex128)

    @cached_property
    def places(self) -> Complex:
        """[rad/s] the poles with and without dead time in the s plane, and 1/T: where f has features."""
        found = self.alone.places[0]
        return np.asarray(found[np.isfinite(found)], np.complex128)

    @cached_property
    def strongest_direct(self) -> float:
        """Largest spectral radius of E D over all phases of E: 1 or more gives an infinite chain of roots in the right half plane."""
        if not self.D.any() or self.dt:
            return 0.0
        if self.alone.one_delay:
            return float(np.abs(np.linalg.eigvals(self.D)).max())
        late = self.T.min() * (1 + 1e-12) < self.T
        turns = np.exp(1j * np.linspace(0, 2 * np.pi, PHASES, endpoint=False))[:, None, None] * late[:, None] + ~late[:, None]
        return float(np.abs(np.linalg.eigvals(turns * self.D)).max())

    def z(self, s: Complex) -> tuple[Complex, Complex]:
        """The variable of A at s (k,), and its derivative: s and 1, or z and dz/ds of a sampled loop."""
        return self.alone.z(s)

    def gain(self, s: Complex) -> Complex:
        """G (k, nd, nd) at s (k,)."""
        return self.alone.gain(_first(s), s)

    def value(self, s: Complex, poles: Complex) -> tuple[Array, Complex]:
        """Of g = f / prod(s - poles) at s (k,): its phase [rad] modulo a turn and (dg/ds) / g, each (k,)."""
        return self.alone.value(_first(s), s, poles[None])

    def matrix(self, s: Complex) -> tuple[Complex, Complex]:
        """The characteristic matrix M (k, nx + nd, nx + nd) at s (k,), with det M = f, and its derivative."""
        return self.alone.matrix(_first(s), s)


def _first(s: Complex) -> Ints:
    return np.zeros(s.size, np.int64)


def stacked(points: Sequence[Delayed]) -> Stacked:
    """Points of one loop, evaluated together."""
    A, B, C, D, T = (np.stack([getattr(point, name) for point in points]) for name in ("A", "B", "C", "D", "T"))
    return Stacked(A, B, C, D, T, points[0].dt)


def in_a_loop(points: Stacked) -> Bools:
    """(m,) False where no dead time lies in a loop: the roots are then those of A."""
    size = np.abs(points.places)
    last = 1e2 * np.nanmax(size, axis=1)
    first, last = 1e-2 * np.nanmin(size, axis=1), np.minimum(last, np.pi / points.dt) if points.dt else last

    def seen(left: Ints, count: int) -> tuple[Array, Array, Bools]:
        """|G| of these points at this many frequencies, the size from which it closes a loop, and where its diagonal has it."""
        w = first[left, None] * (last / first)[left, None] ** np.linspace(0, 1, count)
        G = np.abs(points.gain(np.repeat(left, count), on_axis(w.ravel()))).reshape(left.size, count, *points.D.shape[1:])
        least = NO_LOOP * np.maximum(1.0, G.max(axis=(1, 2, 3), initial=0.0))
        return G, least, np.einsum("mkii->mki", G).max(axis=(1, 2), initial=0.0) >= least  # no spectral radius is below an entry of the diagonal

    few, many = FREQUENCIES
    found = seen(np.arange(len(first)), few)[2]
    left = np.flatnonzero(~found)
    G, least, found[left] = seen(left, many)
    for i, one in zip(left, range(left.size), strict=True):
        closed = np.linalg.matrix_power(G[one].any(axis=0).astype(float), points.T.shape[1]).any()  # else a chain that no wire closes
        found[i] |= bool(closed and perron(G[one]).max(initial=0.0) >= least[one])
    return found


def delayed_points(system: OpenSystem) -> list[Delayed]:
    """Each point of the loop with the delayed wires cut."""
    T = np.broadcast_to(system.wire_delay, (len(system.A), system.nw))
    late = np.asarray(T.any(axis=0))
    A, B, C, D = close_wires(system, keep=late)
    (balance,) = get_lapack_funcs(("gebal",), (A,))
    points = []
    for i in range(len(A)):
        a, b, c = A[i], B[i][:, system.nu :], C[i][system.ny :]
        balanced, _, _, scale, _ = balance(a, scale=1, permute=0)
        points.append(Delayed(balanced, b / scale[:, None], c * scale, D[i][system.ny :, system.nu :], T[i, late], scale, system.dt))
    return points
