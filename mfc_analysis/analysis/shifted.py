r"""A loop with a sampled controller whose one channel has more dead time: exact, the fraction of a sample acting inside the hold.

With a dead time of d + f samples (0 < f <= 1) in channel i of the closed loop, every other wire as it is, the loop has a root at z where

    U(z) = z^-(d + 1) Y(z; f),        U = 1 + H_i,     Y = factor(z) (l(z) gamma(f) + delta(f)) + l(z) b + Delta.

H_i = S_i - 1 = U - 1 is written by the closed loop: U is its present sensitivity S_i, and Y z^-(d + 1) what the injected signal gives late.

- A driving wire (torque, velocity), or a command that acts through them: the new value acts for (1 - f) h, the old one before.
  l = c_i (zI - A)^-1, gamma(f) = int_0^((1 - f) h) exp(A_p s) ds B_p, factor = z - 1, and b, Delta are those of the old value alone.
- A sensor (force, encoder), reported late: it is that at (1 - f) h into the sample before. l = (zI - A)^-1 b_i, gamma(f) its row, factor = 1.

gamma(f) is analytic between the breaks at which another wire's held value switches: Taylor polynomials about the middle of pieces of f.

Source: Astrom & Wittenmark, Computer-Controlled Systems, chapter 3 (sampling of systems with time delay).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.sampled import Layout, advanced, layout_of
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.maths.arrays import Array, Complex, Ints
from mfc_analysis.maths.zero_order_hold import zero_order_hold

TERMS = 16  #: of each Taylor polynomial
SENSORS = ("force", "position")  #: analysis points at which the plant is measured
EXACT = 1e-12  #: its remainder, of a mode of the plant
DEEPEST = 12  #: halvings of a piece


@dataclass(frozen=True, eq=False)
class Shifted:
    """Y(z; f) and U(z) of n channels at m points, in coordinates in which l(z) is cheap. ``P`` pieces of f, ``K`` terms each."""

    matrix: Array | None  #: (m, nx, nx): l = (zI - matrix)^-1 row; None: coordinates are the modes
    poles: Complex  #: (m, nx)
    row: Complex  #: (m, n, nx)
    base: Complex  #: (m, n, nx) U = 1 + at_infinity + l base
    at_infinity: Array  #: (m, n)
    old: Complex  #: (m, n, nx) b
    old_direct: Array  #: (m, n) Delta
    gamma: Complex  #: (m, n, P, K, nx) in powers of (f - middle) / half
    delta: Array  #: (m, n, P, K)
    edges: Array  #: (P + 1,) of f, 0 to 1
    holds: bool  #: factor = z - 1, else 1
    present: Array  #: (n,) dead time of the channels now, in samples

    def left(self, point: Ints, channel: Ints, z: Complex) -> tuple[Complex, Complex]:
        """l(z) and its slope (k, nx) of k cases."""
        if self.matrix is None:
            gap = 1 / (z[:, None] - self.poles[point])
            modal = self.row[point, channel] * gap
            return np.asarray(modal, np.complex128), np.asarray(-modal * gap, np.complex128)
        system = z[:, None, None] * np.eye(self.poles.shape[1]) - self.matrix[point]
        out = np.linalg.solve(system, self.row[point, channel][..., None].astype(np.complex128))
        return np.asarray(out[..., 0], np.complex128), np.asarray(-np.linalg.solve(system, out)[..., 0], np.complex128)

    def at(self, point: Ints, channel: Ints, z: Complex, f: Array) -> tuple[Complex, Complex, Complex]:
        """log(Y/U) and its derivatives by z and by f, each (k,), of k cases."""
        piece, half, x = self._local(f)
        powers = x[:, None] ** np.arange(TERMS)
        slopes = np.arange(1, TERMS) * powers[:, :-1] / half[:, None]
        gamma, delta = self.gamma[point, channel, piece], self.delta[point, channel, piece]
        left, slope = self.left(point, channel, z)
        terms, turned = (np.einsum("kx,ktx->kt", one, gamma) for one in (left, slope))
        terms = terms + delta
        factor, rate = (z - 1, 1.0) if self.holds else (1.0, 0.0)
        q, old, base = (terms * powers).sum(axis=1), self.old[point, channel], self.base[point, channel]
        Y = factor * q + (left * old).sum(axis=1) + self.old_direct[point, channel]
        Yz = factor * (turned * powers).sum(axis=1) + rate * q + (slope * old).sum(axis=1)
        Yf = factor * (terms[:, 1:] * slopes).sum(axis=1)
        U, Uz = 1 + self.at_infinity[point, channel] + (left * base).sum(axis=1), (slope * base).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(Y / U), Yz / Y - Uz / U, Yf / Y

    def sensitivity(self, point: Ints, channel: Ints, z: Complex) -> Complex:
        """U (k,) of k cases."""
        return np.asarray(1 + self.at_infinity[point, channel] + (self.left(point, channel, z)[0] * self.base[point, channel]).sum(axis=1))

    def nodes(self, f: Array) -> tuple[Complex, Array]:
        """gamma (m, n, J, nx) and delta (m, n, J) at the fractions f (J,)."""
        piece, _, x = self._local(f)
        powers = x[:, None] ** np.arange(TERMS)
        return np.einsum("mnjtx,jt->mnjx", self.gamma[:, :, piece], powers), np.einsum("mnjt,jt->mnj", self.delta[:, :, piece], powers)

    def node(self, point: int, channel: int, f: float) -> tuple[Complex, Array]:
        """gamma (1, nx) and delta (1,) of one channel at one fraction."""
        piece, _, x = self._local(np.array([f]))
        powers = x ** np.arange(TERMS)
        return np.asarray(powers @ self.gamma[point, channel, piece], np.complex128), np.asarray(self.delta[point, channel, piece] @ powers, float)

    def ratio(self, left: Complex, z: Complex, gamma: Complex, delta: Array, point: Ints, channel: Ints) -> Complex:
        """Y/U of k cases, with l (k, nx) and gamma (k, nx), delta (k,) known."""
        factor = z - 1 if self.holds else 1.0
        Y = factor * ((left * gamma).sum(axis=1) + delta) + (left * self.old[point, channel]).sum(axis=1) + self.old_direct[point, channel]
        U = 1 + self.at_infinity[point, channel] + (left * self.base[point, channel]).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(Y / U)

    def over(self, z: Complex, gamma: Complex, delta: Array) -> Complex:
        """Y/U (m, n, J, k) at z (m, k) of each point, with gamma (m, n, J, nx) and delta (m, n, J)."""
        m, n, J, nx = gamma.shape
        vectors = np.concatenate([gamma, self.base[:, :, None], self.old[:, :, None]], axis=2)
        if self.matrix is None:
            gap = 1 / (z[:, None, :] - self.poles[:, :, None])
            found = ((self.row[:, :, None] * vectors).reshape(m, -1, nx) @ gap).reshape(m, n, J + 2, -1)
        else:
            found = np.empty((m, n, J + 2, z.shape[1]), np.complex128)
            for i in range(m):
                system = z[i][:, None, None] * np.eye(nx) - self.matrix[i]
                left = np.linalg.solve(system, np.broadcast_to(self.row[i].T, (len(system), nx, n)))
                found[i] = vectors[i] @ np.moveaxis(left, 0, 2).transpose(1, 0, 2)
        factor = z[:, None, None] - 1 if self.holds else 1.0
        Y = factor * (found[:, :, :J] + delta[..., None]) + (found[:, :, J + 1] + self.old_direct[..., None])[:, :, None]
        U = 1 + self.at_infinity[..., None] + found[:, :, J]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(Y / U[:, :, None])

    def _local(self, f: Array) -> tuple[Ints, Array, Array]:
        piece = np.clip(np.searchsorted(self.edges, f) - 1, 0, self.edges.size - 2)
        half = (self.edges[piece + 1] - self.edges[piece]) / 2
        return piece, half, (f - self.edges[piece]) / half - 1


def shifted(system: OpenSystem, at: str, modes: tuple[Complex, Complex] | None) -> Shifted:
    """The channels of ``at`` of a sampled loop (``held`` is its continuous one). ``modes``: poles (m, nx) and vectors; None: linear solves."""
    held = system.held
    assert held is not None and system.dt
    layout, _ = layout_of(held, system.dt)
    ch = channels(system, at)
    wires = np.arange(system.nw)[system.wires[at]]
    through = np.asarray(np.linalg.inv(np.eye(system.nw) - system.D[:, system.ny :, system.nu :]), float)
    sensor = at in SENSORS
    parts = _late_sensor if sensor else _late_torque
    found = parts(system, held, layout, wires, through)
    row, base = (ch.B.swapaxes(1, 2), ch.C) if sensor else (ch.C, ch.B.swapaxes(1, 2))
    old, old_direct, gamma, delta, edges, present = found
    vectors = row, base, old, gamma
    if modes is None:
        matrix = ch.A if sensor else ch.A.swapaxes(1, 2)
        poles = np.zeros(ch.A.shape[:2], np.complex128)
        r, b, o, g = (x.astype(np.complex128) for x in vectors)
        return Shifted(matrix, poles, r, b, ch.H0, o, old_direct, g, delta, edges, not sensor, present)
    poles, V = modes
    turn, inverse = np.asarray(V.swapaxes(1, 2), np.complex128), np.asarray(np.linalg.inv(V), np.complex128)
    to_row, to_vector = (inverse, turn) if sensor else (turn, inverse)

    def turned(M: Complex, vectors: Array) -> Complex:
        flat = vectors.reshape(len(M), -1, M.shape[1])
        return np.asarray(flat @ M.swapaxes(1, 2), np.complex128).reshape(vectors.shape)

    r, b, o, g = (turned(M, x) for M, x in zip((to_row, to_vector, to_vector, to_vector), vectors, strict=True))
    return Shifted(None, poles, r, b, ch.H0, o, old_direct, g, delta, edges, not sensor, present)


_Found = tuple[Array, Array, Array, Array, Array, Array]  # old, old_direct, gamma, delta, edges, present


def _late_torque(system: OpenSystem, held: OpenSystem, layout: Layout, wires: Ints, through: Array) -> _Found:
    """A driving wire each, or a command, which acts through all of them."""
    h, nu, p, registers = system.dt, system.nu, *_places(system, layout)
    D = held.D[:, held.ny :, held.nu :]
    drive = layout.drive
    onto = np.broadcast_to((drive[:, None] == wires) * 1.0, (len(D), drive.size, wires.size))
    command = not np.isin(wires, drive).all()
    if command:
        onto = D[:, drive[:, None], wires]
    old, signals = np.zeros((len(D), system.nx, drive.size)), np.zeros((len(D), system.nw, drive.size))
    for j, wire in enumerate(drive):
        own = registers[layout.first[wire] - held.nx + np.arange(_depth(layout, wire))] if layout.first[wire] >= 0 else np.zeros(0, int)
        for samples in range(int(layout.whole[wire]), _depth(layout, wire) + 1):
            old[:, :, j] += system.B[:, :, nu + wire] if samples == 0 else system.A[:, :, own[samples - 1]]
            signals[:, :, j] += system.D[:, system.ny :, nu + wire] if samples == 0 else system.C[:, system.ny :, own[samples - 1]]
        old[:, own, j] = 0.0
    old, signals = old @ onto, signals @ onto
    if command and not (layout.whole + layout.part)[drive].any():  # with what else it acts on
        old, signals = system.B[:, :, nu + wires], system.D[:, system.ny :, nu + wires]
    late = [(int(w), (1 - float(layout.part[w]))) for w in np.flatnonzero(layout.part) if w not in drive]
    A = held.A[:, layout.plant[:, None], layout.plant]
    B = held.B[:, layout.plant[:, None], held.nu + drive] @ onto
    edges, half, middle = _pieces(A, h, [f for _, f in late])
    gamma = np.zeros((len(D), wires.size, middle.size, TERMS, system.nx))
    for k, (f, size) in enumerate(zip(middle, half, strict=True)):
        for t, vector in enumerate(_taylor(A, B, (1 - f) * h, size * h)):
            gamma[:, :, k, t, p] = vector.swapaxes(1, 2)
        for w, switch in late:
            if f < switch:
                row = held.C[:, held.ny + w, layout.plant][:, None]
                place = registers[layout.first[w] - held.nx]
                for t, vector in enumerate(_taylor(A, B, (switch - f) * h, size * h)):
                    gamma[:, :, k, t, place] = (row @ vector)[:, 0]
                gamma[:, :, k, 0, place] += (D[:, w, drive][:, None] @ onto)[:, 0]
    into = through @ signals
    old = (old + system.B[:, :, nu:] @ into).swapaxes(1, 2)
    channel = np.arange(wires.size)
    now = (layout.whole + layout.part)[np.full(wires.size, drive[0]) if command else wires]
    return old, into[:, wires, channel], gamma, np.zeros(gamma.shape[:-1]), edges, now


def _late_sensor(system: OpenSystem, held: OpenSystem, layout: Layout, wires: Ints, through: Array) -> _Found:
    """Each component of the force sensor, or each encoder."""
    h, nu, p, registers = system.dt, system.nu, *_places(system, layout)
    drive, nx = layout.drive, system.nx
    A = held.A[:, layout.plant[:, None], layout.plant]
    B = held.B[:, layout.plant[:, None], held.nu + drive]
    row = held.C[:, held.ny + wires[:, None], layout.plant]
    direct = held.D[:, held.ny + wires[:, None], held.nu + drive]
    edges, half, middle = _pieces(A, h, [1 - float(x) for x in layout.part[drive]])
    gamma, delta = np.zeros((len(A), wires.size, middle.size, TERMS, nx)), np.zeros((len(A), wires.size, middle.size, TERMS))

    def closed(rows: Array) -> tuple[Array, Array]:
        """Rows over Z, the external inputs left out, with the wires closed: over the states, and direct."""
        out = np.zeros((*rows.shape[:2], nx))
        out[:, :, p] = rows[:, :, layout.plant]
        out[:, :, registers] = rows[:, :, held.nx : held.nx + layout.registers]
        into = rows[:, :, layout.wires] @ through
        signals = system.D[:, system.ny :, nu + wires]
        return out + into @ system.C[:, system.ny :], np.einsum("mnw,mwn->mn", into, signals)

    for k, (f, size) in enumerate(zip(middle, half, strict=True)):
        time = (1 - f) * h
        state = advanced(held, layout, h, time)
        active = [layout.past(int(w), int(layout.whole[w]) + int(time <= layout.part[w] * h)) for w in drive]
        first = row @ state
        first[:, :, active] += direct
        gamma[:, :, k, 0], delta[:, :, k, 0] = closed(first)
        rate = A @ state
        rate[:, :, active] += B
        left = row
        for t in range(1, TERMS):
            left = left * (-size * h / t)
            gamma[:, :, k, t], delta[:, :, k, t] = closed(left @ rate)
            left = left @ A
    return np.zeros((*row.shape[:2], nx)), np.zeros(row.shape[:2]), gamma, delta, edges, (layout.whole + layout.part)[wires]


def _places(system: OpenSystem, layout: Layout) -> tuple[Ints, Ints]:
    """The states of the plant and the registers of a sampled loop, of which idle integrals may have been dropped."""
    every = np.array(sorted(system.plant_states), np.int64)
    return every[: layout.plant.size], every[layout.plant.size :]


def _depth(layout: Layout, wire: int) -> int:
    return int(layout.whole[wire] + (layout.part[wire] > 0))


def _taylor(A: Array, B: Array, time: float, half: float) -> list[Array]:
    """int_0^t exp(A s) ds B at t = time - half x, in powers of x: TERMS arrays (m, np, n)."""
    Phi, Gamma = zero_order_hold(A, B, time)
    out, term = [Gamma], Phi @ B
    for k in range(1, TERMS):
        term = term * (-half / k)
        out.append(term)
        term = A @ term
    return out


def _pieces(A: Array, h: float, breaks: list[float]) -> tuple[Array, Array, Array]:
    """Edges (P + 1,) of pieces of f, their half lengths and middles (P,): in each the Taylor polynomials are exact up to rounding.

    Only young fast modes need short pieces: what decays is gone some time after a switch.
    """
    ends = np.unique([0.0, 1.0, *(f for f in breaks if 0 < f < 1)])
    power = A * h
    for _ in range(3):
        power = power @ power
    fast = np.abs(power).sum(axis=1).max(initial=0.0) ** 0.125 > 1
    modes = np.unique(np.linalg.eigvals(A * h).ravel()) if fast else np.zeros(0)
    edges = [0.0]
    for low, high in itertools.pairwise(ends):
        todo = [(float(low), float(high), 0)]
        while todo:
            a, b, depth = todo.pop()
            half, age = (b - a) / 2, high - (a + b) / 2
            with np.errstate(divide="ignore"):
                left = np.minimum(modes.real, 0) * age + TERMS * np.log(np.abs(modes) * half) - np.log(np.arange(1, TERMS + 1)).sum()
            if depth < DEEPEST and left.size and left.max() > np.log(EXACT):
                todo += [((a + b) / 2, b, depth + 1), (a, (a + b) / 2, depth + 1)]
            else:
                edges.append(b)
    found = np.array(edges)
    return found, np.diff(found) / 2, (found[1:] + found[:-1]) / 2
