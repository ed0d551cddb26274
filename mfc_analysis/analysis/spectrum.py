"""Poles of the closed loop.

Roots at zero (z = 1 in a sampled loop) are found by rank (``zero_roots``); the others are judged by the sign of their real part.
The poles leave dead time out; the stability verdict includes it exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.analysis.zero_roots import ZeroRoots, nonzero_roots, zero_roots
from mfc_analysis.maths.arrays import Array, Bools, Complex

UNDAMPED = 1e-10  #: a root whose real part is below this fraction of its modulus counts as undamped: not stable


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Poles at m points, and which of them are at zero. Slowest first; dead time left out."""

    poles: Complex  #: (m, nx) [rad/s], or in the z plane
    zero: Bools  #: (m, nx) True for the roots at zero (z = 1), found by rank; their value is exact
    roots: ZeroRoots
    dt: float  #: [s] 0: continuous

    @property
    def rates(self) -> Complex:
        """(m, nx) [rad/s] the poles in the s plane: ln(z) / dt of a sampled loop."""
        return rates(self.poles, self.dt)


@dataclass(frozen=True)
class Pole:
    """One row of the table of poles."""

    value: complex  #: [rad/s], or z
    frequency: float  #: [rad/s] natural frequency
    damping: float  #: damping ratio; -1..1; NaN at zero
    time_constant: float  #: [s] inf where it does not decay, negative where it grows
    kind: str  #: "zero", "stable", "undamped" or "unstable"


def rates(poles: Complex, dt: float) -> Complex:
    """Poles in the s plane [rad/s]: unchanged if ``dt`` is 0, else ln(z) / dt (a pole at z = 0 gives -inf)."""
    if not dt:
        return poles
    z = np.asarray(poles, np.complex128)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.abs(z)) / dt + 1j * (np.angle(z) / dt))


def spectrum(system: OpenSystem, eigenvalues: Complex | None = None) -> Spectrum:
    """Poles of the closed loop, dead time left out, with the roots at zero found by rank. ``eigenvalues``: (m, nx), if already known."""
    A = close_wires(system)[0]
    one = 1.0 if system.dt else 0.0
    found = np.array(np.linalg.eigvals(A) if eigenvalues is None else eigenvalues, np.complex128).reshape(A.shape[:2])
    shifted = (A - one * np.eye(system.nx)) / (system.dt or 1.0)
    m = len(A)
    roots = ZeroRoots(np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros(m, bool), np.zeros(m, np.int64))
    size = np.abs(found - one)
    doubtful = np.flatnonzero(size.min(axis=1, initial=np.inf) <= 1e-3 * size.max(axis=1, initial=0.0))
    if doubtful.size:
        # a sampled loop has the neutral and drifting roots of its continuous loop, whose matrices show them without rounding
        behind = None if system.continuous is None else close_wires(system.continuous)[0]
        some = zero_roots((shifted if behind is None else behind)[doubtful], system.integrals)
        for name in ("dropped", "neutral", "drifts", "count"):
            getattr(roots, name)[doubtful] = getattr(some, name)
    at_zero = np.arange(system.nx) < roots.count[:, None]
    for i in np.flatnonzero(roots.count):
        found[i] = one
        found[i, roots.count[i] :] += nonzero_roots(shifted[i], int(roots.count[i])) * (system.dt or 1.0)
    s = rates(found, 1.0 if system.dt else 0.0)
    order = np.lexsort((-s.imag, np.abs(s.imag), np.abs(s.real), ~at_zero), axis=1)
    return Spectrum(np.take_along_axis(found, order, 1), np.take_along_axis(at_zero, order, 1), roots, system.dt)


def poles(system: OpenSystem) -> Complex:
    """Eigenvalues (m, nx) of the closed loop [rad/s] (sampled loops: z), roots at zero first, then slowest first. Dead time is left out."""
    return spectrum(system).poles


def inside(poles: Complex, dt: float, fastest: Array | None = None) -> Bools:
    """Which of the poles (m, k) are stable. Undamped pairs (up to rounding) are not.

    Rounding is relative to the fastest root of the matrix; ``fastest`` gives it where ``poles`` holds only some of the roots.
    """
    s = rates(poles, 1.0 if dt else 0.0)
    floor = 1e-13 if dt else 1e-14 * (np.abs(s).max(axis=-1, keepdims=True, initial=0.0) if fastest is None else fastest[..., None])
    with np.errstate(invalid="ignore"):
        return np.asarray((s.real < -UNDAMPED * np.abs(s) - floor) | np.isneginf(s.real))


def pole_table(system: OpenSystem, index: int) -> tuple[Pole, ...]:
    """Natural frequency, damping and time constant of each pole at point ``index``, slowest first."""
    found = spectrum(system.at(np.array([index])))
    s = found.rates[0]
    decays = inside(found.poles, found.dt)[0]
    return tuple(_row(complex(p), complex(r), bool(z), bool(d)) for p, r, z, d in zip(found.poles[0], s, found.zero[0], decays, strict=True))


def _row(pole: complex, rate: complex, at_zero: bool, decays: bool) -> Pole:
    if at_zero:
        return Pole(pole, 0.0, np.nan, np.inf, "zero")
    if np.isneginf(rate.real):
        return Pole(pole, np.inf, 1.0, 0.0, "stable")
    size = abs(rate)
    undamped = not decays and rate.real <= UNDAMPED * size
    kind = "stable" if decays else "undamped" if undamped else "unstable"
    return Pole(pole, size, 0.0 if undamped else -rate.real / size, np.inf if undamped else -1 / rate.real, kind)
