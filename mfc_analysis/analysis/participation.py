r"""Who takes part in a root: the joints or tool axes that move in its modes, and the root in words.

The share of a state in the roots inside a small circle about s is its diagonal entry of

    1/(2 pi j) oint M(s)^-1 M'(s) ds,

M the characteristic matrix, dead time included. Without dead time this is the spectral projector; for a single root its diagonal holds the
participation factors. All shares add up to the number of roots inside. The share of a joint is the sum over its states and its torque in
transit: it depends neither on units nor, of equal roots, on the choice of eigenvectors.

Sources: Perez-Arriaga, Verghese & Schweppe, "Selective modal analysis", IEEE Trans. Power Apparatus and Systems 101 (1982), 3117-3125;
Beyn, "An integral method for solving nonlinear eigenvalue problems", Linear Algebra Appl. 436 (2012), 3839-3863.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.delay.characteristic import delayed_points
from mfc_analysis.analysis.stability import roots
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Bools, Complex

AXES = {
    **dict(zip(("vx", "vy", "vz", "wx", "wy", "wz"), ("along x", "along y", "along z", "about x", "about y", "about z"), strict=True)),
    **dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), ("along x", "along y", "along z", "about x", "about y", "about z"), strict=True)),
}  #: component of a twist or wrench -> tool axis
SHARE = 0.3  #: of the largest: joints and axes that take part
SAME = 1e-6  #: of the largest: shares that are equal up to rounding; the first one counts as the largest
POINTS = 16  #: on the circle
CLOSE = 1e-2  #: radius of the circle, of abs(s)
REAL = 1e-9  #: of abs(s): an imaginary part below this is rounding
ON_THE_AXIS = 1e-6  #: of abs(s): a real part below this is shown as 0, as at a limit found by bisection


@dataclass(frozen=True)
class Root:
    """A root of a loop at one time, with what takes part in it."""

    value: complex  #: [1/s]; of a sampled loop ln(z) / dt
    time: float  #: [s]
    where: str  #: the joint or axis (or else the state) that takes part the most; "" where there is none
    names: str  #: all that take part, in words: "joint 3 (elbow_joint)"
    dt: float = 0.0  #: [s] 0: continuous

    def __str__(self) -> str:
        return self.said(f"t = {round(self.time, 4):.6g} s")

    def said(self, place: str) -> str:
        """Joint or axis, place and root as text; ``place`` is a time or pose, or empty."""
        z = f"z = {complex_words(complex(np.exp(self.value * self.dt)), '.4g')}, " if self.dt else ""
        head = " at ".join(part for part in (self.names, place) if part)
        return f"{head + ': ' if head else ''}{z}root {complex_words(self.value, '+.3g')} 1/s"


def complex_words(s: complex, form: str) -> str:
    """A root and its conjugate as text: ``+2.3 ± 14 j``."""
    real = "0" if abs(s.real) <= ON_THE_AXIS * abs(s) else f"{s.real:{form}}"
    return real if abs(s.imag) <= REAL * abs(s) else f"{real} ± {abs(s.imag):{form.replace('+', '')}} j"


def located(system: OpenSystem, index: int, s: complex) -> Root:
    """The root near ``s`` [1/s] of the loop at point ``index``, with the joints or tool axes that take part in it."""
    time = float(system.times[index])
    if not np.isfinite(s):
        return Root(s, time, "", "", system.dt)
    joints = _joints(system)
    groups: dict[str, complex] = {}
    for name, share in zip(*shares(system, index, s), strict=True):
        owner = max((j for j in joints if name.endswith(j)), key=len, default="") or name
        groups[owner] = groups.get(owner, 0.0) + share
    kinds: tuple[dict[str, complex], ...] = ({}, {}, {})  # joints, tool axes, other states: the kind that moves most is named
    for owner, share in groups.items():
        axis = AXES.get(owner.rpartition("_")[2], "")
        kind, name = (0, owner) if owner in joints else (1, axis) if axis else (2, owner)
        kinds[kind][name] = kinds[kind].get(name, 0.0) + share
    best = max(kinds, key=lambda kind: sum(map(abs, kind.values())))
    sizes = {name: abs(share) for name, share in best.items()}
    most = max(sizes.values(), default=0.0)
    kept = [name for name, size in sizes.items() if size > SHARE * most]
    where = next((name for name, size in sizes.items() if size >= (1 - SAME) * most), "")
    if best is kinds[0]:
        numbered = [f"{joints.index(name) + 1} ({name})" for name in sorted(kept, key=joints.index)]
        said = f"all {len(joints)} joints" if len(kept) == len(joints) > 2 else f"joint{'s' * (len(kept) > 1)} {listed(numbered)}"
        return Root(s, time, where, said, system.dt)
    tool = "the tool " if best is kinds[1] else ""
    return Root(s, time, tool + where, tool + listed(kept), system.dt)


def rightmost(system: OpenSystem, known: tuple[Complex, Bools] | None = None) -> Root:
    """The rightmost root that is not slow over all points, dead time included; -inf where there is none. ``known``: ``roots(system)``."""
    found, slow = roots(system) if known is None else known
    real = np.where(slow, -np.inf, found.real)
    i, k = np.unravel_index(int(np.argmax(real)), real.shape)
    return located(system, int(i), complex(found[i, k]) if np.isfinite(real[i, k]) else complex(-np.inf))


def shares(system: OpenSystem, index: int, s: complex) -> tuple[tuple[str, ...], Complex]:
    """Names of the states and of the delayed wires, and the share of each (their number,) in the roots near ``s`` [1/s]."""
    (point,) = delayed_points(system.at(slice(index, index + 1)))
    late = tuple(name for name, T in zip(system.wire_names, system.wire_delay, strict=True) if T > 0)
    size = max(abs(s), 1e-8 * float(np.abs(point.A).max(initial=0.0)), 1e-12)
    away = CLOSE * size * np.exp(2j * np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    M, slope = point.matrix(np.asarray(s + away, np.complex128))
    around = np.diagonal(np.linalg.solve(M, slope), axis1=1, axis2=2)
    return system.state_names + late, np.asarray((around * away[:, None]).mean(axis=0), np.complex128)


def listed(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1] if names else ""


def _joints(system: OpenSystem) -> tuple[str, ...]:
    """Names of the joints: those of the wires to the actuators."""
    return next((system.wire_names[system.wires[at]] for at in ("torque", "velocity") if at in system.wires), ())
