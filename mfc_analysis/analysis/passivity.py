r"""Passivity of a port: whether the loop gives energy to what touches it.

A stable loop is passive if and only if Y(jw) + Y(jw)^H >= 0 at all w, Y the admittance of its port. Then it is stable on every passive
environment: springs of any stiffness, masses, dampers. Where Y has an inverse Z the same is said by the damping that the port shows,

.. math:: \delta(\omega) = \lambda_{min}\left(\tfrac12 (Z + Z^H)\right) \ge 0

in [Ns/m, Nm s/rad], which has a limit at high frequency. A damper b at the tool, between it and the ground (in parallel with the environment:
both feel the same velocity), adds b to Z; so the smallest b that makes the port passive is the supremum of -delta.

Certified: without dead time the zeros of det(Y(s) + Y(-s)^T) are the eigenvalues of a Hamiltonian pencil, and delta is looked at between all of
them. With dead time its phases are set free: from some frequency on delta is positive whatever they are, and below it is looked at 16 times a
turn. Sampled: ``sampled_passivity``. In each case the minima are refined.

Sources: Colgate & Hogan, "Robust control of dynamically interacting systems", Int. J. Control 48 (1988) 65-88; Boyd, Balakrishnan & Kabamba,
Math. Control Signals Systems 2 (1989) 207-219.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.analysis.port import PortSystem, admittance
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.sampled_passivity import least
from mfc_analysis.analysis.spectrum import poles
from mfc_analysis.analysis.stability import Stability, stability
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Complex

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

PER_DECADE = 30  #: frequencies of the scan
PER_TURN = 16  #: of the phase of the dead times
TURNS = 40  #: that are looked at where delta is negative at some phase at any frequency
MOST = 40_000  #: frequencies of a scan with dead time
FEW = 8  #: minima that are refined: the deepest, and the positive ones that come nearest to zero
ROUNDING = 1e-11  #: of the impedance: delta above minus this counts as zero; a wall would make of it a growth of 1e-11 w
STILL = 1e-9  #: relative: directions in which the port does not move
FAR = 1e3  #: times the top of the scan: there delta has come to its limit
MOST_DAMPING = 1e9  #: [Ns/m] searched for a sampled loop
BEYOND = 1e3  #: times the fastest pole, above which a zero of the pencil counts as infinite


class Passive(Enum):
    """The verdict of one point; the value is a sentence."""

    PASSIVE = "passive: stable on every passive environment"
    NOT_PASSIVE = "not passive: some passive environment makes it unstable"
    HARMONICS = "not passive: through the harmonics of the sampler, though passive at each frequency alone"
    UNSTABLE = "not passive: the loop itself is not stable"
    NOT_CERTIFIED = "not certified: passive where it was looked at, which does not cover all frequencies"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class Passivity:
    """Passivity of the port at m times; p channels. Numbers are NaN where the loop itself is not stable.

    ``smallest`` is in SI units of an admittance: (m/s)/N, and (rad/s)/(Nm) of the rotations.
    """

    times: Array  #: (m,) [s]
    at: str  #: "tool" or "joints"
    channels: tuple[str, ...]  #: (p,)
    outcome: tuple[Passive, ...]  #: (m,)
    smallest: Array  #: (m,) smallest eigenvalue of Y + Y^H over frequency
    frequency: Array  #: (m,) [rad/s] where it is
    direction: Complex  #: (m, p) of the force there, a unit vector
    crossings: tuple[Array, ...]  #: (m,) arrays [rad/s] where that eigenvalue passes zero; with dead time those below ``highest``
    damping: Array  #: (m,) [Ns/m, Nm s/rad] smallest extra damping at the port, between it and the ground, that makes it passive; inf: none does
    damping_frequency: Array  #: (m,) [rad/s] where it is needed; inf: at ever higher frequencies; NaN: none is
    highest: Array  #: (m,) [rad/s] up to where it was looked at, from 1/horizon on
    frequencies: tuple[Array, ...]  #: (m,) arrays (k,) [rad/s] of the scan
    shown: tuple[Array, ...]  #: (m,) arrays (k,) [Ns/m, Nm s/rad] the damping that the port shows there

    @property
    def passive(self) -> Bools:
        """(m,) True where the port is certified to be passive."""
        return np.array([one is Passive.PASSIVE for one in self.outcome], bool)

    def worst(self) -> int:
        """The time at which most damping is missing; one at which the loop is not stable comes first."""
        return int(np.argmax([np.inf if one is Passive.UNSTABLE else b for one, b in zip(self.outcome, self.damping, strict=True)]))

    def finding(self, index: int) -> str:
        """The verdict at one time, by its ``index``, in a sentence with its numbers."""
        said = str(self.outcome[index])
        if self.outcome[index] is Passive.NOT_PASSIVE:
            said += f"; least Y + Y^H {self.smallest[index]:.3g} at {self.frequency[index]:.4g} rad/s along {self._along(index)}"
            some = self.crossings[index]
            said += f"; passes zero at {', '.join(f'{w:.4g}' for w in some[:3])}{', ...' if some.size > 3 else ''} rad/s" if some.size else ""
        b, w = self.damping[index], self.damping_frequency[index]
        if b > 0:
            where = "" if np.isnan(w) else " at ever higher frequencies" if np.isinf(w) else f" at {w:.4g} rad/s"
            said += f"; {'no damper makes it passive' if np.isinf(b) else f'{b:.4g} Ns/m (Nm s/rad) more at the port make it so, needed{where}'}"
        return said

    def _along(self, index: int) -> str:
        d = self.direction[index]
        some = [k for k in np.argsort(-np.abs(d)) if abs(d[k]) > 0.1][:3]
        return ", ".join(f"{abs(d[k]):.2f} {self.channels[k]}" for k in some)

    def __str__(self) -> str:
        m, i = len(self.times), self.worst()
        many = f"t = {self.times[0]:g} s" if m == 1 else f"passive at {int(self.passive.sum())} of {m} times; worst at t = {self.times[i]:g} s"
        return f"passivity at the {self.at}, {many}: {self.finding(i)}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from mfc_analysis.notebook import table

        i = self.worst()
        crossings = ", ".join(f"{w:.5g}" for w in self.crossings[i][:8]) or "none"
        rows = [
            ("passive", f"{self.outcome[i]}"), ("least eigenvalue of Y + Y^H", f"{self.smallest[i]:.4g} at {self.frequency[i]:.5g} rad/s"),
            ("direction", self._along(i) if np.isfinite(self.smallest[i]) else "-"), ("crossings [rad/s]", crossings),
            ("extra damping at the port [Ns/m, Nm s/rad]", f"{self.damping[i]:.5g}"), ("looked at up to [rad/s]", f"{self.highest[i]:.4g}"),
        ]  # fmt: skip
        return table(f"Passivity at the {self.at}, t = {self.times[i]:g} s", ("quantity", "value"), rows)

    def plot(self, index: int | None = None, *, ax: Axes | None = None) -> Axes:
        """The damping of the port over frequency at one time, by its ``index`` (None: the worst): below zero it gives energy.

        ``ax``: to draw in; None: a new figure of pyplot.
        """
        from mfc_analysis import plots

        m = len(self.times)
        i = self.worst() if index is None else checks.whole("index", index, -m, m - 1) % m
        said = str(self.outcome[i]).split(":")[0]
        title = f"Damping at the {self.at}, t = {self.times[i]:g} s"
        return plots.passivity(self.frequencies[i], self.shown[i], crossings=self.crossings[i], said=said, title=title, ax=plots.shown("map", ax)[0])


def passivity(port: PortSystem, at: str, verdict: Stability) -> Passivity:
    """Passivity at each point; ``verdict`` is the stability of the same loop, which is asked for first."""
    found = [_at_one(port.at(i), bool(verdict.stable[i])) for i in range(len(port.B))]
    column = [np.array(values) for values in zip(*((f.smallest, f.frequency, f.damping, f.damping_frequency, f.highest) for f in found), strict=True)]
    return Passivity(
        port.opened.times, at, port.names, tuple(f.outcome for f in found), column[0], column[1], np.array([f.direction for f in found]),
        tuple(f.crossings for f in found), column[2], column[3], column[4], tuple(f.w for f in found), tuple(f.shown for f in found),
    )  # fmt: skip


class _Found(NamedTuple):
    outcome: Passive
    smallest: float
    frequency: float
    direction: Complex
    crossings: Array
    damping: float
    damping_frequency: float
    highest: float
    w: Array
    shown: Array


class _Shown(NamedTuple):
    """At k frequencies: delta, its rounding, and the smallest eigenvalue of Y + Y^H."""

    delta: Array
    rounding: Array
    smallest: Array


def _at_one(port: PortSystem, stable: bool) -> _Found:
    p, none, nan = len(port.names), np.zeros(0), float("nan")
    if not stable:
        return _Found(Passive.UNSTABLE, nan, nan, np.full(p, nan + 0j), none, nan, nan, nan, none, none)
    lowest = max(port.opened.radius, 1e-6)
    basis = _moving(port, lowest)
    if not basis.size:  # nothing moves it: the loop is a rigid support
        return _Found(Passive.PASSIVE, 0.0, nan, np.zeros(p, complex), none, 0.0, nan, np.inf, none, none)
    port = port.onto(basis)

    def look(w: Array, phases: Array | None = None) -> _Shown:
        return _look(admittance(port, w, phases)[0])

    scan = _scan(port, look, lowest)
    w, (delta, rounding, smallest) = _refined(look, scan.w, look(scan.w))
    lost = delta < -rounding
    crossings = _crossings(look, w, lost)
    k = int(np.argmin(smallest))
    direction = np.asarray(basis @ np.linalg.eigh(_hermitian(admittance(port, w[k : k + 1])[0, 0]))[1][:, 0], np.complex128)
    worst = int(np.argmin(delta))
    damping, place = max(0.0, -float(delta[worst])), float(w[worst])
    if -scan.limit > damping * (1 + 1e-9):
        damping, place = -scan.limit, float("inf")
    outcome = Passive.NOT_PASSIVE if lost.any() or scan.limit < 0 else Passive.PASSIVE if scan.whole else Passive.NOT_CERTIFIED
    if outcome is not Passive.NOT_PASSIVE:
        damping, place = 0.0, nan
    if port.opened.dt and outcome is Passive.PASSIVE and least(port) < 0:
        outcome = Passive.HARMONICS
    if outcome in (Passive.NOT_PASSIVE, Passive.HARMONICS):
        damping, place = _enough(port, damping, place)
    return _Found(outcome, float(smallest[k]), float(w[k]), direction, crossings, damping, place, float(w[-1]), w, delta)


def _hermitian(Y: Complex) -> Complex:
    """Y + Y^H."""
    return np.asarray(Y + np.swapaxes(Y, -1, -2).conj(), np.complex128)


def _least(Y: Complex) -> Array:
    """(k,) smallest eigenvalues of Y + Y^H."""
    return np.asarray(np.linalg.eigvalsh(_hermitian(Y))[:, 0], float)


def _look(Y: Complex) -> _Shown:
    smallest = _least(Y)
    with np.errstate(all="ignore"):
        try:
            Z = np.asarray(np.linalg.inv(Y), np.complex128)
        except np.linalg.LinAlgError:  # of one that has no inverse the sign says it all
            return _Shown(np.where(smallest < 0, -np.inf, np.inf), np.zeros(len(Y)), smallest)
        bad = ~np.isfinite(Z).all(axis=(1, 2))
        Z[bad] = np.eye(Z.shape[-1])
        delta, size = _least(Z) / 2, np.linalg.norm(Z, 2, axis=(1, 2))
    return _Shown(np.where(bad, np.where(smallest < 0, -np.inf, np.inf), delta), ROUNDING * size, smallest)


def _moving(port: PortSystem, lowest: float) -> Array:
    """(p, r) orthonormal: the directions in which a force does something, or that move."""
    Y = admittance(port, np.geomspace(lowest, 1e4 * max(1.0, lowest), 7))[0]
    size = np.abs(Y).max(axis=(1, 2), keepdims=True)
    if not size.any():
        return np.zeros((len(port.names), 0))
    Y = Y / np.where(size == 0, 1, size)
    rows: Complex = np.concatenate([Y, np.swapaxes(Y, 1, 2).conj()]).reshape(-1, len(port.names))
    _, strength, V = np.linalg.svd(np.concatenate([rows.real, rows.imag]), full_matrices=False)
    return np.asarray(V[strength > STILL * strength[0]].T)


class _Scan(NamedTuple):
    w: Array  #: (k,) increasing
    whole: bool  #: they cover all frequencies
    limit: float  #: smallest delta at ever higher frequencies: -inf where it falls without end, 0 where it is not below zero


def _scan(port: PortSystem, look: Callable[..., _Shown], lowest: float) -> _Scan:
    """The frequencies to look at."""
    one = port.opened
    rates = np.abs(np.log(poles(one)[0].astype(complex)) / one.dt if one.dt else poles(one)[0])
    rates = rates[np.isfinite(rates) & (rates > 0)]
    fastest = max(float(rates.max(initial=0.0)), 10 * lowest)
    marks = rates[rates > lowest]
    if one.dt:
        turn = 2 * np.pi / one.dt
        w = _log(lowest, turn / 2, marks)
        return _Scan(np.union1d(w, np.linspace(turn / 2, 8 * turn, 24 * 8)), True, 0.0)
    if one.delayed:
        return _late_scan(port, look, lowest, fastest, marks)
    zeros = _zeros(port)
    known = zeros is not None
    zeros = np.zeros(0) if zeros is None else zeros[(zeros > lowest) & (zeros < BEYOND * fastest)]
    top = 10 * max(fastest, float(zeros.max(initial=0.0)))
    nodes = np.unique(np.concatenate([[lowest], zeros, [top]]))
    between = np.sqrt(nodes[:-1] * nodes[1:])
    return _Scan(np.union1d(_log(lowest, top, marks), np.concatenate([nodes, between])), known, _limit(look, top, np.zeros((1, 0))))


def _limit(look: Callable[..., _Shown], top: float, phases: Array) -> float:
    """``_Scan.limit``, at any of the phases (k, nd)."""
    far = FAR * top
    here, there = (look(np.full(len(phases), w), phases) for w in (top, far))
    k = int(np.argmin(there.delta))
    if not there.delta[k] < -there.rounding[k]:
        return 0.0
    return float("-inf") if there.delta[k] < 0.03 * FAR * min(0.0, float(here.delta.min())) else float(there.delta[k])


def _log(low: float, high: float, marks: Array) -> Array:
    count = max(2, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    around = np.concatenate([marks * part for part in (0.9, 0.97, 1.0, 1.03, 1.1)]) if marks.size else marks
    return np.union1d(np.geomspace(low, high, count), around[(around > low) & (around < high)])


def _late_scan(port: PortSystem, look: Callable[..., _Shown], lowest: float, fastest: float, marks: Array) -> _Scan:
    late = port.late[4]
    whole = float(np.unique(late).sum())
    each = np.unique(late)
    turn = 2 * np.pi / whole
    top = 100 * max(fastest, turn)
    w = np.geomspace(lowest, top, int(12 * np.log10(top / lowest)) + 2)
    angles = np.linspace(0, 2 * np.pi, 48 if each.size == 1 else 16, endpoint=False)
    grid = np.stack(np.meshgrid(*[angles] * each.size, indexing="ij"), axis=-1).reshape(-1, each.size)
    phases = grid[:, np.searchsorted(each, late)]
    free = look(np.repeat(w, len(phases)), np.tile(phases, (w.size, 1)))
    worst, rounding = free.delta.reshape(w.size, -1).min(axis=1), free.rounding.reshape(w.size, -1).max(axis=1)
    lost = np.flatnonzero(worst < 0)
    if not lost.size:
        return _Scan(_log(lowest, top, marks), True, 0.0)
    sure = bool(worst[-1] > rounding[-1])
    end = 1.3 * w[min(int(lost[-1]) + 1, w.size - 1)] if sure else max(TURNS * turn, 2 * float(w[lost[0]]))
    count = int(min(PER_TURN * end / turn, MOST)) + 2
    dense = np.union1d(_log(lowest, end, marks), np.linspace(turn / PER_TURN, max(end, turn), count))
    return _Scan(dense, sure and count <= MOST, 0.0 if sure else _limit(look, top, phases))


def _zeros(port: PortSystem) -> Array | None:
    """[rad/s] sizes and imaginary parts of the finite zeros of det(Y(s) + Y(-s)^T), of a loop without dead time; None: not found."""
    from scipy.linalg import eig, matrix_balance

    A, B, C, D = (x[0] for x in port.late[:4])
    nx = len(B)
    A, (scale, _) = matrix_balance(A, permute=False, separate=True)
    B, C = B / scale[:, None], C * scale
    b, c = np.linalg.norm(B, axis=0).max(initial=0.0), np.linalg.norm(C, axis=1).max(initial=0.0)
    B, C, D = B / b, C / c, D / (b * c)
    none = np.zeros((nx, nx))
    M = np.block([[A, none, B], [none, -A.T, -C.T], [C, B.T, D + D.T]])
    N = np.zeros_like(M)
    N[: 2 * nx, : 2 * nx] = np.eye(2 * nx)
    with np.errstate(all="ignore"):
        try:
            found: Complex = np.asarray(eig(M, N, right=False), np.complex128)
        except (np.linalg.LinAlgError, ValueError):
            return None
    found = found[np.isfinite(found)]
    return np.concatenate([np.abs(found), np.abs(found.imag)])


def _refined(look: Callable[..., _Shown], w: Array, found: _Shown) -> tuple[Array, _Shown]:
    """The scan with the minima of delta, and the smallest one of the eigenvalue, between its frequencies."""
    finite = np.nan_to_num(found.delta, nan=np.inf)
    valley = np.flatnonzero((finite <= np.append(finite[1:], np.inf)) & (finite <= np.append(np.inf, finite[:-1])))
    with np.errstate(over="ignore"):
        near = (finite / np.maximum(found.rounding, 1e-300))[valley]
    nearest, deepest = np.argsort(np.where(near < 0, np.inf, near))[:FEW], np.argsort(finite[valley])[:FEW]
    valley = valley[np.union1d(nearest, deepest)]
    parts = [(w, found)]
    for of, centre in (("delta", valley), ("smallest", np.array([int(np.argmin(found.smallest))]))):
        if not centre.size:
            continue
        low, high = w[np.maximum(centre - 1, 0)], w[np.minimum(centre + 1, w.size - 1)]
        rows = np.arange(centre.size)
        for _ in range(12):
            inner = low[:, None] * (high / low)[:, None] ** np.linspace(0, 1, 9)
            at = np.argmin(getattr(look(inner.ravel()), of).reshape(inner.shape), axis=1)
            low, high = inner[rows, np.maximum(at - 1, 0)], inner[rows, np.minimum(at + 1, 8)]
        best = np.sqrt(low * high)
        parts.append((best, look(best)))
    every, first = np.unique(np.concatenate([x for x, _ in parts]), return_index=True)
    return every, _Shown(*(np.concatenate(values)[first] for values in zip(*(f for _, f in parts), strict=True)))


def _crossings(look: Callable[..., _Shown], w: Array, lost: Bools) -> Array:
    """Where delta passes zero, between the points on its two sides, to 1e-12 of their distance."""
    k = np.flatnonzero(lost[1:] != lost[:-1])
    if not k.size:
        return np.zeros(0)
    low, high, first = w[k], w[k + 1], lost[k]
    rows = np.arange(k.size)
    for _ in range(20):
        ends = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 5)
        seen = (look(ends[:, 1:4].ravel()).delta < 0).reshape(-1, 3)
        at = np.argmax(np.column_stack([seen, ~first]) != first[:, None], axis=1)
        low, high = ends[rows, at], ends[rows, at + 1]
    return np.asarray((low + high) / 2)


def _enough(port: PortSystem, damping: float, place: float) -> tuple[float, float]:
    """The damping that makes the port passive, and where it is needed; inf where the loop with it is not stable, or it never suffices."""
    h = port.opened.dt

    def with_damper(b: float) -> PortSystem:
        damped = port.damped(b)
        return PortSystem(sampled(damped.opened, h), *(getattr(damped, x) for x in ("names", "B", "D", "C", "E"))) if h else damped

    if h:
        harmonic = _smallest(lambda b: least(with_damper(b)), damping)
        damping, place = (harmonic, float("nan")) if harmonic > damping * (1 + 1e-6) else (damping, place)
    if np.isfinite(damping):
        verdict = stability(with_damper(damping * (1 + 1e-6)).opened)
        if not verdict.nonzero_stable[0] and verdict.held[0]:  # a damper may make every root slow
            return float("inf"), place
    return damping, place


def _smallest(margin: Callable[[float], float], start: float) -> float:
    """The smallest b >= start with a margin that is not negative; inf: none up to 1e9."""
    from scipy.optimize import root_scalar

    low, high = start, max(2 * start, 1e-2)
    if margin(low) >= 0:
        return low
    while (found := margin(high)) < 0:
        if high > MOST_DAMPING or found == -np.inf:
            return float("inf")
        low, high = high, 10 * high
    return float(root_scalar(lambda b: max(margin(b), -1e6), bracket=(low, high), xtol=1e-9 * high, rtol=1e-8).root)
