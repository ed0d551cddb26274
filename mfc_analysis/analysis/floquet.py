r"""Time-varying loops: period maps, Floquet multipliers, periodic orbits, and transient growth on finite paths.

Frozen-time poles do not prove stability along a moving trajectory. With A(t) the exact linearisation along the motion,
Phi' = A(t) Phi, Phi(0) = I; the eigenvalues of Phi(T, 0) are the multipliers, and they decide the stability of a periodic loop. Phi is
advanced by Magnus steps of fourth order on two Gauss-Legendre nodes,

.. math:: \Omega = \frac{h}{2}(A_1 + A_2) + \frac{\sqrt 3}{12} h^2 [A_2, A_1], \qquad \Phi_{k+1} = e^{\Omega} \Phi_k .

Source: Blanes, Casas, Oteo, Ros, "The Magnus expansion and some of its applications", Physics Reports 470 (2009), section 5.

Where a root is fast for the steps they are halved until the matrices stay the same; the fastest, for which the series does not converge, are those
of the Radau IIA method of fifth order. Source: Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.5. Where A changes within a
step (friction where a joint turns back, a limit) that step is halved, and the half in which it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

PeriodMap = Callable[[Array], tuple[Array, Array]]

_NODES = np.array([0.5 - math.sqrt(3) / 6, 0.5 + math.sqrt(3) / 6])
_6 = math.sqrt(6)
_RADAU_NODES = np.array([(4 - _6) / 10, (4 + _6) / 10, 1.0])
_RADAU = np.array(
    [
        [(88 - 7 * _6) / 360, (296 - 169 * _6) / 1800, (-2 + 3 * _6) / 225],
        [(296 + 169 * _6) / 1800, (88 + 7 * _6) / 360, (-2 - 3 * _6) / 225],
        [(16 - _6) / 36, (16 + _6) / 36, 1 / 9],
    ]
)
CALM, STIFF = 0.3, 3.0  #: modulus of a root times a step: up to the first one step is enough; above the second the Magnus series does not converge
SAME, HALVED = 1e-6, 7  #: change of a step's matrix, of its largest entry, at which its parts are short enough; and how often they are halved
FEW, SHORT = 32, 20  #: as few parts, in which A jumps, are halved more often
STRAIGHT = 1e-5  #: of the largest entry of a step's matrix: what A at its ends may be off a line, times the step


class FloquetVerdict(Enum):
    """Stability verdict of the multipliers; the value is a sentence."""

    STABLE = "stable: every disturbance of the periodic motion decays"
    NEUTRAL = "neutral: some disturbances of the periodic motion persist, none grows"
    DRIFTS = "drifts: a disturbance of the periodic motion grows polynomially, not exponentially"
    UNSTABLE = "unstable: a disturbance of the periodic motion grows every period"
    PERIOD_DOUBLING = "unstable by period doubling: a disturbance changes sign every period and grows"


STEPS = 80  #: fewest steps of a path


@dataclass(frozen=True, eq=False)
class Floquet(Shown):
    """Floquet multipliers of a periodic loop, with the stability verdict."""

    period: float  #: [s]
    multipliers: Complex  #: (nx,) eigenvalues of Phi(T, 0), the largest modulus first
    exponents: Complex  #: (nx,) [1/s, rad/s] log(multipliers) / T, imaginary parts within pi/T
    growth: float  #: factor of the slowest disturbance in one period: the largest modulus of the multipliers that are not neutral
    verdict: FloquetVerdict
    neutral: int  #: multipliers at 1 that neither grow nor decay
    Phi: Array  #: (nx, nx) the period map
    orbit: Array | None = None  #: (nx,) state of the periodic orbit at its start, where it was computed
    iterations: int = 0  #: Newton iterations used
    residual: float = 0.0  #: |x(T) - x(0)| of the orbit

    @property
    def exponent(self) -> float:
        """Largest Floquet exponent [1/s]: log(growth) / T; negative is stable."""
        return math.log(self.growth) / self.period if self.growth > 0 else -math.inf

    @property
    def stable(self) -> bool:
        """Whether every disturbance decays (except neutral ones, as for frozen-time poles)."""
        return self.verdict in (FloquetVerdict.STABLE, FloquetVerdict.NEUTRAL)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The multipliers and the unit circle. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        return plots.multipliers(self.multipliers, title=f"Floquet multipliers, T = {self.period:.4g} s", ax=plots.shown("disc", ax)[0])

    def __str__(self) -> str:
        worst = self.multipliers[np.argmin(np.abs(np.abs(self.multipliers) - self.growth))]
        return (
            f"{self.verdict.value}\ngrowth per period {self.growth:.6g} (T = {self.period:.4g} s), exponent {self.exponent:.4g} 1/s; "
            f"its multiplier {abs(worst):.6g} at {math.degrees(math.atan2(worst.imag, worst.real)):.1f} deg"
        )

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class Orbit:
    """A fixed point of a period map."""

    x: Array  #: (nx,) x(T) = x(0)
    Phi: Array  #: (nx, nx) derivative of x(T) with respect to x(0) on the orbit
    iterations: int
    residual: float  #: |x(T) - x(0)|


@dataclass(frozen=True, eq=False)
class TransientGrowth(Shown):
    """Growth of a disturbance along a path, in the coordinates of the loop. ``float()`` gives the largest."""

    times: Array  #: (N,) [s]
    singular: Array  #: (N,) largest singular value of Phi(t, 0)
    largest: float  #: largest of ``singular``, >= 1
    time: float  #: [s] of the largest
    direction: Array  #: (nx,) unit initial disturbance with this growth

    def __float__(self) -> float:
        return self.largest

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The largest singular value against time. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        series = [("largest singular value", self.singular)]
        return plots.curves(self.times, series, xlabel="t [s]", ylabel="growth of a disturbance [-]", ax=plots.shown("map", ax)[0])

    def __str__(self) -> str:
        return f"a disturbance grows by at most a factor {self.largest:.4g}, at t = {self.time:.4g} s; at the end {self.singular[-1]:.4g}"

    __repr__ = __str__


def gauss_nodes(edges: Array) -> Array:
    """(N, 2) times [s] at which ``transition_magnus`` takes A, for steps between the N + 1 ``edges`` [s]."""
    edges = np.asarray(edges, float)
    return np.asarray(edges[:-1, None] + np.diff(edges)[:, None] * _NODES)


def transition_magnus(A_nodes: Array, h: float | Array) -> Array:
    """(N, n, n) transition matrices of N steps, Phi_k+1 = E_k Phi_k, fourth order in h.

    A_nodes: (N, 2, n, n), A at ``gauss_nodes``; h: step length(s) [s], scalar or (N,). Raises ``BadArgument`` where A h is not finite.
    """
    from scipy.linalg import expm

    h = np.broadcast_to(np.asarray(h, float), A_nodes.shape[:1])[:, None, None]
    A1, A2 = A_nodes[:, 0], A_nodes[:, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        Omega = h / 2 * (A1 + A2) + math.sqrt(3) / 12 * h**2 * (A2 @ A1 - A1 @ A2)
        if not np.isfinite(Omega).all():
            raise BadArgument("A_nodes", "A h that is not finite", "finite matrices and shorter steps")
        return np.asarray(expm(Omega), float)


def transitions(A: Callable[[Array], Array], edges: Array, *, smooth: bool = True) -> Array:
    """(N, n, n) transition matrices of x' = A(t) x, one for each step between the N + 1 ``edges`` [s]; ``A``: times (m,) [s] -> (m, n, n).

    ``smooth``: whether A changes little within a step, so that one is enough where all roots are slow. Raises as ``transition_magnus``, and
    what ``A`` raises.
    """
    starts, h = np.asarray(edges, float)[:-1], np.diff(np.asarray(edges, float))
    nodes = gauss_nodes(edges)
    flat = A(np.ravel(nodes))
    whole = transition_magnus(flat.reshape(*nodes.shape, *flat.shape[1:]), h)
    turn = _turn(flat, float(h.max()))
    if not smooth and turn <= STIFF:
        return _halved(A, starts, h, whole)
    if turn <= CALM:
        return whole
    out, left, before = np.empty_like(whole), np.arange(len(h)), whole
    for halved in range(1, 1 + HALVED):
        out[left] = found = _in_parts(_magnus if turn / 2**halved <= STIFF else _radau, A, starts[left], h[left], 2**halved)
        more = ~(np.abs(found - before).max(axis=(1, 2)) <= SAME * np.abs(found).max(axis=(1, 2)))
        left, before = left[more], found[more]
        if not left.size:
            break
    return out


def _halved(A: Callable[[Array], Array], starts: Array, h: Array, whole: Array, times: int = 1) -> Array:
    """The transition matrices ``whole`` over h (N,) from ``starts`` (N,) [s] by two halves.

    Each is halved again where that changes them, or where A at the ends of a half is not on a line with A at its nodes.
    """
    N, starts, h = len(whole), np.concatenate([starts, starts + 0.5 * h]), 0.5 * np.concatenate([h, h])
    at = A(np.ravel(starts[:, None] + h[:, None] * [0.0, *_NODES, 1.0])).reshape(2 * N, 4, *whole.shape[1:])
    half = transition_magnus(at[:, 1:3], h)
    with np.errstate(over="ignore", invalid="ignore"):
        line = at[:, 1:3] + _NODES[0] / (_NODES[1] - _NODES[0]) * (at[:, 1:3] - at[:, 2:0:-1])
        off = (np.abs(at[:, ::3] - line).max(axis=(1, 2, 3)) * h).reshape(2, N).max(axis=0)
        out = half[N:] @ half[:N]
        size = np.abs(out).max(axis=(1, 2))
        more = np.flatnonzero(~((np.abs(out - whole).max(axis=(1, 2)) <= SAME * size) & (off <= STRAIGHT * size)))
        if more.size and times < (SHORT if more.size <= FEW else HALVED):
            both = np.concatenate([more, more + N])
            finer = _halved(A, starts[both], h[both], half[both], times + 1)
            out[more] = finer[more.size :] @ finer[: more.size]
    return out


def _turn(A: Array, h: float) -> float:
    """Largest modulus of a root of the first, middle and last of A (m, n, n), times a step h [s]; 0 where A does not change."""
    size = float(np.abs(A).max())
    if size * A.shape[-1] * h <= CALM or np.ptp(A, axis=0).max() <= 1e-9 * size:  # the first is quick, and stricter
        return 0.0
    return float(np.abs(np.linalg.eigvals(A[[0, len(A) // 2, -1]])).max()) * h


def _in_parts(
    step: Callable[[Callable[[Array], Array], Array, Array], Array], A: Callable[[Array], Array], starts: Array, h: Array, parts: int
) -> Array:
    """(N, n, n) transition matrices over h (N,) from ``starts`` (N,) [s], each as the product of equal parts."""
    h = h / parts
    Phi = step(A, starts, h)
    with np.errstate(over="ignore", invalid="ignore"):
        for part in range(1, parts):
            Phi = step(A, starts + part * h, h) @ Phi
    return Phi


def _magnus(A: Callable[[Array], Array], starts: Array, h: Array) -> Array:
    nodes = A(np.ravel(starts[:, None] + h[:, None] * _NODES))
    return transition_magnus(nodes.reshape(len(h), 2, *nodes.shape[1:]), h)


def _radau(A: Callable[[Array], Array], starts: Array, h: Array) -> Array:
    At = A(np.ravel(starts[:, None] + h[:, None] * _RADAU_NODES))
    n = At.shape[-1]
    inner = np.einsum("ij,kjab->kiajb", _RADAU, At.reshape(-1, 3, n, n)).reshape(-1, 3 * n, 3 * n)
    one = np.broadcast_to(np.tile(np.eye(n), (3, 1)), (len(h), 3 * n, n))
    return np.asarray(np.linalg.solve(np.eye(3 * n) - h[:, None, None] * inner, one)[:, 2 * n :], float)


def accumulated(steps: Array) -> Array:
    """(N + 1, n, n): Phi(t_k, 0) from the N transition matrices of the steps, the first is I."""
    out = np.empty((steps.shape[0] + 1, *steps.shape[1:]))
    out[0] = np.eye(steps.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        for k, E in enumerate(steps):
            np.matmul(E, out[k], out=out[k + 1])
    return out


def period_map(steps: Array) -> Array:
    """(n, n): product of all steps, the last on the left, multiplied pairwise in batches."""
    while steps.shape[0] > 1:
        paired = steps[1::2] @ steps[: 2 * (steps.shape[0] // 2) : 2]
        steps = np.concatenate([paired, steps[-1:]]) if steps.shape[0] % 2 else paired
    return steps[0] if steps.shape[0] else np.eye(steps.shape[-1])


def floquet(Phi: Array, period: float, tolerance: float = 1e-7, orbit: Orbit | None = None) -> Floquet:
    """Stability of a period map Phi (nx, nx) over ``period`` [s].

    Multipliers at 1 (free positions, integrals that act on nothing) are found by rank, relative to ``tolerance`` (the accuracy of Phi);
    semisimple ones are neutral, those in a Jordan chain drift. Any other multiplier on the unit circle is not stable, as for undamped poles.
    """
    Phi = np.asarray(Phi, float)
    mu = np.linalg.eigvals(Phi).astype(np.complex128)
    mu = mu[np.argsort(-np.abs(mu), kind="stable")]
    neutral, chained = _ones(Phi, tolerance)
    rest = mu[np.argsort(np.abs(mu - 1), kind="stable")[chained:]]
    worst = rest[np.argmax(np.abs(rest))] if rest.size else 0j
    growth = float(abs(worst)) if rest.size else 1.0
    if rest.size and growth >= 1 - tolerance:
        flips = worst.real < 0 and abs(worst.imag) <= 1e-6 * growth
        verdict = FloquetVerdict.PERIOD_DOUBLING if flips else FloquetVerdict.UNSTABLE
    elif chained > neutral:
        verdict, growth = FloquetVerdict.DRIFTS, 1.0
    else:
        verdict = FloquetVerdict.NEUTRAL if neutral else FloquetVerdict.STABLE
    with np.errstate(divide="ignore"):
        exponents: Complex = np.asarray(np.log(mu) / period, np.complex128)
    found: dict[str, Any] = {} if orbit is None else {"orbit": orbit.x, "iterations": orbit.iterations, "residual": orbit.residual}
    return Floquet(float(period), mu, exponents, growth, verdict, neutral, Phi, **found)


def _ones(Phi: Array, tolerance: float) -> tuple[int, int]:
    """Number of semisimple directions at multiplier 1, and number of multipliers at 1 with their Jordan chains."""
    N = Phi - np.eye(Phi.shape[0])
    scale = max(1.0, float(np.linalg.norm(Phi, 2)))
    single = int(np.sum(np.linalg.svd(N, compute_uv=False) <= tolerance * scale))
    if single == 0:
        return 0, 0
    return single, max(single, int(np.sum(np.linalg.svd(N @ N, compute_uv=False) <= tolerance * scale**2)))


def shoot(advance: PeriodMap, x0: Array, tolerance: float = 1e-10, iterations: int = 60) -> Orbit:
    """The periodic orbit near ``x0`` by Newton's method: x <- x + (I - Phi)^-1 (x(T) - x), halved while the residual grows.

    ``advance(x)`` returns x(T) and Phi = dx(T)/dx, (nx,) and (nx, nx). Only the difference x(T) - x counts, so ``advance`` must unwrap
    an angle that turns through 2 pi. Directions in which I - Phi is singular (neutral ones) do not change. Converged when
    |x(T) - x| <= tolerance (1 + |x|). Raises ``NotConverged`` with the residual.
    """
    x = np.array(x0, float)
    end, Phi = advance(x)
    size = float(np.linalg.norm(end - x))
    count, goal = 0, tolerance
    for count in range(iterations + 1):
        goal = tolerance * (1 + float(np.linalg.norm(x)))
        if size <= goal:
            return Orbit(np.asarray(x, float), np.array(Phi), count, size)
        if not (np.isfinite(size) and np.isfinite(Phi).all()) or count == iterations:
            break
        nearer = _nearer(advance, x, np.asarray(np.linalg.lstsq(np.eye(x.size) - Phi, end - x, rcond=1e-11)[0], float), size)
        if nearer is None:
            break
        x, end, Phi, size = nearer
    raise NotConverged(f"no periodic orbit found: |x(T) - x(0)| = {size:.3g} after {count} Newton iterations, tolerance {goal:.3g}; start closer")


def _nearer(advance: PeriodMap, x: Array, step: Array, size: float) -> tuple[Array, Array, Array, float] | None:
    """x moved by the step or a part of it so that its residual is below ``size``: x, x(T), Phi and the residual; None where no part does."""
    for fraction in (1.0, 0.5, 0.25, 0.125, 0.0625, 0.01):
        tried = np.asarray(x + fraction * step, float)
        end, Phi = advance(tried)
        residual = float(np.linalg.norm(end - tried))
        if residual < size:
            return tried, end, Phi, residual
    return None


def transient_growth(Phi: Array, times: Array) -> TransientGrowth:
    """Largest singular value of Phi(t, 0) over the times of a finite path. Phi: (N, n, n), times: (N,) [s]."""
    if Phi.ndim != 3 or Phi.shape[0] != np.size(times) or Phi.shape[0] == 0:
        raise BadArgument("Phi", f"shape {Phi.shape}", f"transition matrices (N, n, n) at N = {np.size(times)} times, at least one")
    if not np.isfinite(Phi).all():
        raise BadArgument("Phi", "entries that are not finite", "a shorter path: the transition matrices overflow on this one")
    singular = np.linalg.norm(Phi, 2, axis=(-2, -1))
    k = int(np.argmax(singular))
    direction = np.linalg.svd(Phi[k])[2][0]
    return TransientGrowth(np.array(times, float), singular, float(singular[k]), float(np.asarray(times)[k]), direction)
