r"""The matrix sensitivity around a frequency: value, two derivatives, and a bound of what they leave out over an interval.

.. math:: S(c + \delta) = S_0 + \delta S_1 + \tfrac12 \delta^2 S_2 + \rho, \qquad |\rho_{ij}| \le R_{ij} \text{ for all real } |\delta| \le r

The variable is the frequency w; w dt of a sampled loop; and, above the poles of a loop without dead time, x = 1/w, so that infinity is a number
like the others. Where the modes are well conditioned S is a sum over its poles. Elsewhere, and with dead time,

    S = D + C F^-1 B,    F = F_0 + delta F_1 + delta^2 F_2 / 2 + ...,    B = B_0 + delta B_1,

and the rest of the Neumann series of F^-1 = (I + F_0^-1 (F - F_0))^-1 F_0^-1 is bounded entry by entry, with moduli, so that the units of
the states have no effect. Near a root of the loop the bound is large or infinite, so that no peak is missed wherever the centers are placed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mfc_analysis.analysis.frequency.resolvent import CONDITION
from mfc_analysis.analysis.frequency.sensitivity import Opened
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.maths.arrays import Array, Bools, Complex, Ints

NODES = 8  #: steps of a quadratic over an interval
CHUNK = 150_000  #: complex numbers of one array at a time
FAR = 3.0  #: times the fastest pole: from here on the variable is 1/w
AROUND = np.array([-3.0, -1.0, 1.0, 3.0])  #: marks around a pole, in units of its decay rate
LADDER = 3.0  #: largest ratio of two marks


@dataclass(frozen=True, eq=False)
class Taylor:
    """A matrix function around k centers, (k, n, n) each."""

    value: Complex
    slope: Complex
    bend: Complex
    rest: Array  #: bound of the moduli of what value + delta slope + delta^2/2 bend leave out for real abs(delta) <= r; inf: not known

    def __getitem__(self, some: Bools | Ints) -> Taylor:
        return Taylor(self.value[some], self.slope[some], self.bend[some], self.rest[some])


def over_cells(size: Array, bend: Array, rest: Array, r: Array) -> Array:
    """Bounds (k, NODES) of a norm over equal cells of each interval of radius r (k,).

    ``size`` (k, NODES + 1): that of the quadratic at the nodes. Between them it exceeds the larger by at most h^2/8 times the norm of the second
    derivative, ``bend`` (k,): the norm is convex on the chord. ``rest`` (k,) grows at least with the cube of the distance.
    """
    share = np.abs(np.linspace(-1, 1, NODES + 1))
    share = np.maximum(share[1:], share[:-1]) ** 3
    return np.asarray(np.maximum(size[:, 1:], size[:, :-1]) + ((r / NODES) ** 2 / 2 * bend)[:, None] + share * rest[:, None])


def left_over(over: Bools) -> tuple[Ints, Ints]:
    """First and last+1 of the cells that remain, (k, 2): all cells (k, NODES) that are ``over`` in one part of at most half of them, or in two."""
    some = np.asarray(over.any(axis=1))
    first, last = over.argmax(axis=1), NODES - over[:, ::-1].argmax(axis=1)
    middle = np.where(last - first > NODES // 2, (first + last) // 2, last)
    left, right = np.stack([first, middle], axis=1), np.stack([middle, last], axis=1)
    return np.where(some[:, None], left, 0), np.where(some[:, None], right, 0)


@dataclass(frozen=True, eq=False)
class Piece:
    """S as a function of a real variable over an interval."""

    edges: Array  #: (k,) increasing: the interval, and places at which to divide it
    some: Callable[[Array, Array], Taylor]  #: centers (k,) and radii (k,) -> S
    frequency: Callable[[float], float]  #: [rad/s]
    most: int = field(default=1000)  #: centers at a time

    def around(self, c: Array, r: Array) -> Taylor:
        """S around the centers c (k,) over the radii r (k,), with the memory of a few at a time."""
        parts = [self.some(c[k : k + self.most], r[k : k + self.most]) for k in range(0, max(c.size, 1), self.most)]
        return parts[0] if len(parts) == 1 else Taylor(*(np.concatenate(x) for x in zip(*(vars(p).values() for p in parts), strict=True)))


@dataclass(frozen=True, eq=False)
class _Realised:
    """S = D + s D1 + C (sI - A)^-1 B (or zI). D1 is not zero where the torque is opened together with the encoder, whose rate acts on it."""

    A: Array
    B: Array
    C: Array
    D: Array
    D1: Array
    moving: Bools  #: (n,) channels with a rate


def pieces(channels: Opened, index: int, lowest: float, poles: Complex) -> list[Piece]:
    """S of one point from ``lowest`` [rad/s] to infinity (a sampled loop: to half the sample rate; with dead time: see ``beyond``).

    ``poles``: [1/s] of the loop; they place the edges, and nothing else depends on them.
    """
    system = channels.system
    if system.delayed:
        return [_delayed(channels, index, lowest, poles)]
    S = _realised(channels, index)
    size = np.abs(poles[np.isfinite(poles)])
    top = max(float(size.max(initial=0.0)), lowest, 1e-300)
    if system.dt:
        edges = _edges(poles, lowest, np.pi / system.dt)
        return [_piece(edges * system.dt, S, "angle", lambda x: x / system.dt)]
    high = FAR * top
    edges = _edges(poles, lowest, high)
    far = np.array([0.0, 1 / high])
    return [_piece(edges, S, "w", float), _piece(far, S, "inverse", lambda x: 1 / x if x else np.inf)]


def _edges(poles: Complex, lowest: float, last: float) -> Array:
    """Increasing places from ``lowest`` to ``last``: around each pole, and in steps of a limited ratio."""
    s = poles[np.isfinite(poles)]
    size = np.abs(s)
    first = max(lowest, 0.1 * float(size[size > 1e-9 * last].min(initial=last)))
    near = (np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * AROUND)[s.imag > 0]
    ladder = np.geomspace(first, last, 2 + int(np.log(last / first) / np.log(LADDER))) if last > first else np.array([last])
    every = np.unique(np.concatenate([[lowest, last], near.ravel(), size, ladder]))
    every = every[(every >= lowest) & (every <= last)]
    wide = np.concatenate([[True], np.diff(every) > 1e-3 * every[1:], [True]])[:-1]
    wide[-1] = True
    return np.asarray(every[wide | (every == lowest)])


def _realised(channels: Opened, index: int) -> _Realised:
    system = channels.system
    nu, ny, nw = system.nu, system.ny, system.nw
    D = system.D[index, ny:, nu:]
    through = np.linalg.inv(np.eye(nw) - D) if D.any() else np.eye(nw)
    into, back = system.B[index, :, nu:] @ through, through @ system.C[index, ny:]
    A = system.A[index] + system.B[index, :, nu:] @ back
    rows = channels.wires
    B, C, S = into[:, rows], back[rows], through[np.ix_(rows, rows)]
    moving = channels.rates >= 0
    direct = np.zeros_like(S)
    if moving.any():  # s (sI - A)^-1 b = b + (sI - A)^-1 A b
        rate = into[:, channels.rates[moving]]
        B[:, moving] += A @ rate
        S[:, moving] += C @ rate
        direct[:, moving] = through[np.ix_(rows, channels.rates[moving])]
    return _Realised(A, B, C, np.asarray(S, float), np.asarray(direct, float), moving)


def _piece(edges: Array, S: _Realised, variable: str, frequency: Callable[[float], float]) -> Piece:
    """The piece of one variable, by modes where these are well conditioned."""
    poles, V = np.linalg.eig(S.A)
    n, nx = len(S.D), len(S.A)
    if np.linalg.cond(V) < CONDITION:
        residues = (S.C @ V).T[:, :, None] * np.linalg.solve(V, S.B.astype(complex))[:, None, :]
        terms = {"w": pole_terms, "angle": _sampled_terms, "inverse": _far_terms}[variable]
        dynamic: _Around = _Modes(poles.astype(np.complex128), np.asarray(residues.reshape(nx, n, n), np.complex128), terms)
        most = max(1, CHUNK // max(nx, n * n))
    else:
        form = {"w": _on_axis, "angle": _on_circle, "inverse": _beyond}[variable]
        dynamic, most = (lambda c, r: _neumann(form(S, c), S.C, r)), max(1, CHUNK // nx**2)
    finish = _beyond_finished if variable == "inverse" else _finished
    return Piece(edges, lambda c, r: finish(dynamic(c, r), S, c, r), frequency, most)


def _finished(found: Taylor, S: _Realised, c: Array, r: Array) -> Taylor:
    return Taylor(found.value + S.D + 1j * c[:, None, None] * S.D1, found.slope + 1j * S.D1, found.bend, found.rest)


def _beyond_finished(found: Taylor, S: _Realised, c: Array, r: Array) -> Taylor:
    """From N = C (jI - x A)^-1 B, S = D + j D1 / x + x N, with the channels that have a rate scaled by 1/x: their diagonal balance is free."""
    power = 1 + S.moving[None, :].astype(int) - S.moving[:, None].astype(int)  # 0, 1 or 2: of x before N
    x, h = c[:, None, None], r[:, None, None]
    a = x**power
    a1, a2 = np.where(power == 0, 0.0, power * x ** np.maximum(power - 1, 0)), np.where(power == 2, 2.0, 0.0)
    N, N1, N2 = found.value, found.slope, found.bend
    rest = (x + h) ** power * found.rest + h**3 / 2 * (np.abs(a1 * N2) + np.abs(a2 * N1)) + h**4 / 4 * np.abs(a2 * N2)
    direct = np.where(power == 0, 0.0, S.D)
    value = a * N + np.where(power == 2, x, 1.0) * direct + 1j * S.D1
    slope = a * N1 + a1 * N + np.where(power == 2, direct, 0.0)
    return Taylor(value, slope, a * N2 + 2 * a1 * N1 + a2 * N, rest)


_Around = Callable[[Array, Array], Taylor]
Terms = Callable[[Complex, Array, Array], tuple[Complex, Complex, Complex, Array]]  # of each pole, at c, over r: value, slope, bend, rest


@dataclass(frozen=True, eq=False)
class _Modes:
    """A sum over poles."""

    poles: Complex  #: (nx,)
    residues: Complex  #: (nx, n, n)
    terms: Terms

    def __call__(self, c: Array, r: Array) -> Taylor:
        value, slope, bend, rest = self.terms(self.poles, c[:, None], r[:, None])
        flat = self.residues.reshape(len(self.residues), -1)
        shape = (c.size, *self.residues.shape[1:])
        one, two, three = ((x @ flat).reshape(shape) for x in (value, slope, bend))
        return Taylor(one, two, three, (rest @ np.abs(flat)).reshape(shape))


def pole_terms(p: Complex, c: Array, r: Array) -> tuple[Complex, Complex, Complex, Array]:
    """1 / (jw - p) around w = c: value, slope, bend, and the bound of the rest over r; p, c, r broadcast."""
    g = 1 / (1j * c - p)
    away = np.maximum(np.abs(c - p.imag) - r, 0.0)
    return g, -1j * g * g, -2 * g**3, r**3 * np.abs(g) ** 3 / np.sqrt(away * away + p.real**2)


def _sampled_terms(p: Complex, c: Array, r: Array) -> tuple[Complex, Complex, Complex, Array]:
    """1 / (e^(j angle) - p)."""
    z = np.exp(1j * c)
    g = 1 / (z - p)
    size = np.abs(g)
    away = np.maximum(1 / size - r, np.abs(1 - np.abs(p)))
    return g, -1j * z * g * g, (z - 2 * z * z * g) * g * g, r**3 * size**2 * (1 / 6 + size + size / away)


def _far_terms(p: Complex, c: Array, r: Array) -> tuple[Complex, Complex, Complex, Array]:
    """1 / (j - x p), x = 1 / w, of poles well below."""
    g = 1 / (1j - c * p)
    away = np.maximum(1 / np.abs(g) - r * np.abs(p), 1e-300)
    return g, p * g * g, 2 * p * p * g**3, r**3 * np.abs(p * g) ** 3 / away


@dataclass(frozen=True, eq=False)
class _Form:
    """F and B of k centers: F_0 + delta F_1 + delta^2/2 F_2 + ..., B_0 + delta B_1."""

    F: Complex  #: (k, N, N)
    F1: Complex
    F2: Complex | None
    bounds: tuple[Array | None, Array | None, Array | None]  #: (N, N) of the moduli of dF, d2F and d3F; the first None: the unit matrix; others: zero
    B: Complex  #: (k or 1, N, n)
    B1: Complex | None


def _on_axis(S: _Realised, c: Array) -> _Form:
    eye = np.eye(len(S.A))
    F = np.asarray(1j * c[:, None, None] * eye - S.A, np.complex128)
    return _Form(F, np.asarray(1j * eye[None], np.complex128), None, (None, None, None), S.B[None].astype(complex), None)


def _on_circle(S: _Realised, c: Array) -> _Form:
    eye = np.eye(len(S.A))
    z = np.asarray(np.exp(1j * c)[:, None, None] * eye, np.complex128)
    return _Form(z - S.A, np.asarray(1j * z, np.complex128), -z, (None, eye, eye), S.B[None].astype(complex), None)


def _beyond(S: _Realised, c: Array) -> _Form:
    F = np.asarray(1j * np.eye(len(S.A)) - c[:, None, None] * S.A, np.complex128)
    return _Form(F, -S.A[None].astype(complex), None, (np.abs(S.A), None, None), S.B[None].astype(complex), None)


def _delayed(channels: Opened, index: int, lowest: float, poles: Complex) -> Piece:
    """With dead time: the states, and the wires that are delayed or opened; the others are closed."""
    wires = _kept(channels, index)
    A, B, C, D, T = wires.A, wires.B, wires.C, wires.D, wires.T
    nx, k = len(A), len(T)
    N, n = nx + k, channels.wires.size
    gain = np.concatenate([C, D], axis=1)
    size, late = np.abs(gain), T[:, None]
    first, none = np.concatenate([np.eye(nx, N), late * size]), np.zeros((nx, N))
    second, third = np.concatenate([none, late**2 * size]), np.concatenate([none, late**3 * size])
    still, rated = np.zeros((N, n)), np.zeros((N, n))
    still[nx + wires.rows, np.arange(n)] = 1
    moving = np.flatnonzero(channels.rates >= 0)
    rated[nx + wires.rates, moving] = 1
    out, B1 = still.T, np.asarray(1j * rated[None], np.complex128) if moving.size else None

    def form(c: Array) -> _Form:
        E = np.exp(-1j * c[:, None] * T)[:, :, None] * gain
        F, F1, F2 = (np.zeros((c.size, N, N), np.complex128) for _ in range(3))
        F[:, :nx, :nx], F[:, :nx, nx:] = 1j * c[:, None, None] * np.eye(nx) - A, -B
        F[:, nx:] = np.concatenate([np.zeros((k, nx)), np.eye(k)], axis=1) - E
        F1[:, :nx, :nx], F1[:, nx:] = 1j * np.eye(nx), 1j * late * E
        F2[:, nx:] = late**2 * E
        B0 = np.asarray(still + 1j * c[:, None, None] * rated, np.complex128)
        return _Form(F, F1, F2, (first, second, third), B0, B1)

    places = np.concatenate([poles, np.linalg.eigvals(A), [1 / float(T.max())]]).astype(np.complex128)
    edges = _edges(places, lowest, max(FAR * float(np.abs(places[np.isfinite(places)]).max()), 2 * lowest))
    return Piece(edges, lambda c, r: _neumann(form(c), out, r), float, max(1, CHUNK // N**2))


@dataclass(frozen=True, eq=False)
class _Kept:
    """The wires that are delayed or opened, cut; the others closed. A, B, C, D between them."""

    A: Array
    B: Array
    C: Array
    D: Array
    T: Array  #: (k,) [s]
    rows: Ints  #: (n,) the channels among them
    rates: Ints  #: the rate wires of channels that have one


def _kept(channels: Opened, index: int) -> _Kept:
    system = channels.system
    moving = channels.rates[channels.rates >= 0]
    keep = system.wire_delay > 0
    keep[channels.wires] = keep[moving] = True
    A, B, C, D = (x[0] for x in close_wires(system.at(np.array([index])), keep))
    place = np.cumsum(keep) - 1
    nu, ny = system.nu, system.ny
    return _Kept(A, B[:, nu:], C[ny:], D[ny:, nu:], system.wire_delay[keep], place[channels.wires], place[moving])


def beyond(channels: Opened, index: int, w: float) -> Array:
    """With dead time: bound (n, n) of the moduli of S - S(infinity) at all frequencies above w [rad/s]; inf where none is known.

    Channels with a rate are scaled by 1/w against the others: their diagonal balance is free, and the rate grows with w. With K at least the
    moduli of C (sI - A)^-1 B, it is the sum of (abs(D) + K)^i, less the powers of the D of undelayed wires, which are S(infinity).
    """
    wires, n = _kept(channels, index), channels.wires.size
    moving = channels.rates >= 0
    if not moving.any():
        size = np.abs(wires.D)
        at = np.eye(len(size))[:, wires.rows]
        still = _series(size * (wires.T == 0)[:, None], at)
        return np.asarray((_series(size + _loop(wires, w)[0], at) - still)[wires.rows])
    through = np.abs(wires.D)[:, wires.rates]  # s r acts on these wires
    if (np.abs(wires.D) @ through).any():
        return np.full((n, n), np.inf)
    found, later = (_with_rates(wires, moving, x) for x in (w, 1e9 * w))
    cross = np.outer(moving, ~moving)
    if not (1e9 * later[cross] <= found[cross] * (1 + 1e-6)).all():  # these must fall at least with 1/w
        return np.full((n, n), np.inf)
    found[cross] *= w
    found[cross.T] /= w
    found[:, moving] += np.where(moving[:, None], 0.0, through[wires.rows])
    return np.asarray(found, float)


def _with_rates(wires: _Kept, moving: Bools, w: float) -> Array:
    """As ``beyond``, unscaled and without the direct effect of the rates."""
    size = np.abs(wires.D)
    K, K1 = _loop(wires, w)
    step = (size + K)[:, wires.rows]
    step[:, moving] += K1[:, wires.rates] + K1 @ size[:, wires.rates]
    return np.asarray(_series(size + K, step)[wires.rows])


def _loop(wires: _Kept, w: float) -> tuple[Array, Array]:
    """Bounds (k, k) above w of C (sI - A)^-1 B and of s times it."""
    k = len(wires.T)
    right = np.concatenate([np.abs(wires.B), np.abs(wires.A @ wires.B)], axis=1) / w
    later = _inverse_of_m_matrix(np.abs(wires.A)[None] / w, right[None])[0]
    if not np.isfinite(later).all():
        return np.full((k, k), np.inf), np.full((k, k), np.inf)
    return np.abs(wires.C) @ later[:, :k], np.abs(wires.C) @ later[:, k:] + np.abs(wires.C @ wires.B)


def _series(N: Array, right: Array) -> Array:
    """(I - N)^-1 right of one nonnegative N; inf where its powers do not fade."""
    if not np.isfinite(N).all() or not np.isfinite(right).all():
        return np.full(right.shape, np.inf)
    return np.asarray(_inverse_of_m_matrix(N[None], right[None])[0])


def _neumann(form: _Form, C: Array, r: Array) -> Taylor:
    """C F^-1 B over the radii r (k,)."""
    inverse = np.linalg.inv(form.F)
    U, V = C @ inverse, inverse @ form.B
    U1, V1 = U @ form.F1, form.F1 @ V
    U2, V2 = U1 @ inverse, inverse @ V1
    value, slope, bend = C @ V, -U1 @ V, 2 * (U1 @ V2)
    size, u, v, u2, v2 = (np.abs(x) for x in (inverse, U, V, U2, V2))
    first, second, third = form.bounds
    h = r[:, None, None]
    rest = np.zeros(value.shape)
    if form.F2 is not None and second is not None and third is not None:
        bend = bend - U @ form.F2 @ V
        u2, plain = u2 + h / 2 * (u @ second @ size), u2
        v2 = v2 + h / 2 * (size @ (second @ v))
        rest = (u @ second @ v2 + plain @ second @ v) / 2 + u @ third @ v / 6
    right = v2
    if form.B1 is not None:
        W = inverse @ form.B1
        slope, bend = slope + U @ form.B1, bend - 2 * (U1 @ W)
        w = np.abs(W)
        right = right + w
        if second is not None:
            rest = rest + u @ second @ w / 2
    growth = h * (size if first is None else size @ first)
    sums = _inverse_of_m_matrix(growth, right)
    left = u2 if first is None else u2 @ first
    with np.errstate(invalid="ignore"):
        rest = h**3 * (rest + left @ sums)
    return Taylor(value, slope, bend, np.where(np.isnan(rest), np.inf, rest))


def _inverse_of_m_matrix(N: Array, right: Array) -> Array:
    """(I - N)^-1 right, (k, N, n), of nonnegative N; inf where the powers of N do not fade: no y > 0 has (I - N) y > 0."""
    ones = np.ones((*N.shape[:2], 1))
    try:
        found = np.linalg.solve(np.eye(N.shape[-1]) - N, np.concatenate([right, ones], axis=2))
    except np.linalg.LinAlgError:
        return np.full(right.shape, np.inf)
    fades = np.asarray((found[..., -1] > 0).all(axis=1))
    return np.asarray(np.where(fades[:, None, None], np.maximum(found[..., :-1], 0.0), np.inf))
