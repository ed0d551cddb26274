"""Poles of the closed loop: the slow ones, abs(s) < 1/horizon, and the others, which are judged by the sign of their real part.

The poles leave dead time out; the stability verdict includes it exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mfc_analysis.analysis.slow import Parts, parts
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import NotConverged
from mfc_analysis.maths.arrays import Array, Bools, Complex

NEVER = 1e-10  #: [1/s] rate of a slow root below which it is rounding
UNDAMPED = 1e-10  #: a root whose real part is below this fraction of its modulus counts as undamped: not stable


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Poles at m points, slowest first; dead time left out."""

    poles: Complex  #: (m, nx) [rad/s], or in the z plane
    slow: Bools  #: (m, nx) True for the slow poles
    A: Array | None  #: (m, nx, nx) of the closed loop; None may stand for it where no pole is slow
    radius: float  #: [1/s] of the disc of the slow poles
    dt: float  #: [s] 0: continuous

    @property
    def rates(self) -> Complex:
        """(m, nx) [rad/s] the poles in the s plane: ln(z) / dt of a sampled loop."""
        return rates(self.poles, self.dt)

    @cached_property
    def decays(self) -> Bools:
        """(m,) whether every pole that is not slow decays."""
        return np.asarray((inside(self.poles, self.dt) | self.slow).all(axis=1))

    def parts(self, index: int) -> Parts | None:
        """The slow part and the rest at one point; None where no pole is slow.

        Where rounding mixes them: None if another pole does not decay, since that settles the verdict; else raises ``NotConverged``.
        """
        count = int(self.slow[index].sum())
        if not count or self.A is None:
            return None
        try:
            return parts(self.A[index], self.radius, self.dt, count)
        except NotConverged:
            if self.decays[index]:
                raise
            return None


POLE_HEADS = ("pole [1/s, or z]", "wn [rad/s]", "damping", "time constant [s]", "kind")


@dataclass(frozen=True)
class Pole:
    """One row of the table of poles."""

    value: complex  #: [1/s], or z
    frequency: float  #: [rad/s] natural frequency
    damping: float  #: damping ratio; -1..1; NaN of a slow pole
    time_constant: float  #: [s] inf where it does not decay (or not in 300 years), negative where it grows
    kind: str  #: "slow", "stable", "undamped" or "unstable"


class PoleTable(tuple[Pole, ...]):
    """Rows of poles or roots, as a tuple; printed as a table."""

    __slots__ = ()

    def _rows(self) -> list[tuple[str, str, str, str, str]]:
        return [(f"{p.value:.5g}", f"{p.frequency:.4g}", f"{p.damping:.3g}", f"{p.time_constant:.4g}", p.kind) for p in self]

    def __str__(self) -> str:
        return "\n".join("".join(f"{cell:>22}" for cell in row) for row in (POLE_HEADS, *self._rows()))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        return table(f"{len(self)} poles", POLE_HEADS, self._rows())


def rates(poles: Complex, dt: float) -> Complex:
    """Poles in the s plane [rad/s]: unchanged if ``dt`` is 0, else ln(z) / dt (a pole at z = 0 gives -inf)."""
    if not dt:
        return poles
    z = np.asarray(poles, np.complex128)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.abs(z)) / dt + 1j * (np.angle(z) / dt))


def spectrum(system: OpenSystem, eigenvalues: Complex | None = None) -> Spectrum:
    """Poles of the closed loop, dead time left out. ``eigenvalues``: (m, nx), if already known."""
    dt, radius, A = system.dt, system.radius, None
    if eigenvalues is None:
        A = close_wires(system)[0]
        eigenvalues = np.asarray(np.linalg.eigvals(A), np.complex128)
    found = eigenvalues.reshape(system.A.shape[:2])
    slow = np.abs(rates(found, dt)) < radius
    if A is None and slow.any():
        A = close_wires(system)[0]
    s = rates(found, 1.0 if dt else 0.0)
    order = np.lexsort((-s.imag, np.abs(s.imag), np.abs(s.real), ~slow), axis=1)
    return Spectrum(np.take_along_axis(found, order, 1), np.take_along_axis(slow, order, 1), A, radius, dt)


def poles(system: OpenSystem) -> Complex:
    """Eigenvalues (m, nx) of the closed loop [rad/s] (sampled loops: z), slow ones first, then slowest first. Dead time is left out."""
    return spectrum(system).poles


def inside(poles: Complex, dt: float, fastest: Array | None = None) -> Bools:
    """Which of the poles (m, k) are stable. Undamped pairs (up to rounding) are not.

    Rounding is relative to the fastest root of the matrix; ``fastest`` gives it where ``poles`` holds only some of the roots.
    """
    s = rates(poles, 1.0 if dt else 0.0)
    floor = 1e-13 if dt else 1e-14 * (np.abs(s).max(axis=-1, keepdims=True, initial=0.0) if fastest is None else fastest[..., None])
    with np.errstate(invalid="ignore"):
        return np.asarray((s.real < -UNDAMPED * np.abs(s) - floor) | np.isneginf(s.real))


def pole_table(system: OpenSystem, index: int) -> PoleTable:
    """Natural frequency, damping and time constant of each pole at point ``index``, slowest first."""
    found = spectrum(system.at(np.array([index])))
    s = found.rates[0]
    decays = inside(found.poles, found.dt)[0]
    return PoleTable(
        _row(complex(p), complex(r), bool(slow), bool(d)) for p, r, slow, d in zip(found.poles[0], s, found.slow[0], decays, strict=True)
    )


def root_rows(roots: Complex, horizon: float) -> PoleTable:
    """Roots [1/s] of a loop with dead time (k,) as rows of such a table, in their order; those that do not exist (-inf) are left out."""
    s = roots[np.isfinite(roots)]
    slow, decays = np.abs(s) < 1 / horizon, inside(s, 0.0)
    return PoleTable(_row(complex(root), complex(root), bool(late), bool(d)) for root, late, d in zip(s, slow, decays, strict=True))


def _row(pole: complex, rate: complex, slow: bool, decays: bool) -> Pole:
    if np.isneginf(rate.real):
        return Pole(pole, np.inf, 1.0, 0.0, "stable")
    size = abs(rate)
    undamped = not decays and rate.real <= UNDAMPED * size
    if slow:
        return Pole(pole, size, np.nan, np.inf if abs(rate.real) < NEVER else -1 / rate.real, "slow")
    kind = "stable" if decays else "undamped" if undamped else "unstable"
    return Pole(pole, size, 0.0 if undamped else -rate.real / size, np.inf if undamped else -1 / rate.real, kind)
