"""The matrix sensitivity S = (I + L)^-1 of several channels at once, over frequency, dead time exact.

Every wire is closed and a signal r is added after each wire of the analysis point; the signal after the sum is S r, and T = I - S.
At "position" the rate also carries jw r. Takes one analysis point, or several together (loop input and output at once).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.channels import has_rate, point_wires
from mfc_analysis.analysis.frequency.resolvent import CONDITION
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array, Complex, Ints


@dataclass(frozen=True, eq=False)
class Opened:
    """The wires of a system that carry the k channels of one or several analysis points."""

    system: OpenSystem
    points: tuple[str, ...]
    names: tuple[str, ...]  #: (k,) "joint" or, with several points, "point joint"
    wires: Ints  #: (k,) among the nw
    rates: Ints  #: (k,) the rate wire of a position wire, else -1


def opened(system: OpenSystem, at: str | Sequence[str]) -> Opened:
    """The channels of ``at``: a point, or several together. Raises ``UnknownPoint`` and, for no point or a repeated one, ``BadArgument``."""
    points = (at,) if isinstance(at, str) else tuple(at)
    if not points or len(set(points)) < len(points):
        raise BadArgument("at", at, "an analysis point, or several different ones")
    wires: list[int] = []
    rates: list[int] = []
    names: list[str] = []
    for point in points:
        found = range(*point_wires(system, point).indices(system.nw))
        wires += found
        rates += range(*system.wires["rate"].indices(system.nw)) if has_rate(system, point) else [-1] * len(found)
        names += [system.wire_names[i] if len(points) == 1 else f"{point} {system.wire_names[i]}" for i in found]
    return Opened(system, points, tuple(names), np.array(wires), np.array(rates))


CHUNK = 4_000_000  #: complex numbers solved for at a time


def sensitivity(channels: Opened, index: int, frequencies: Array) -> Complex:
    """S (nf, k, k) at one operating point, at frequencies (nf,) [rad/s]; below pi / dt for a sampled loop."""
    system = channels.system
    nu, ny, nw = system.nu, system.ny, system.nw
    A, B, C, D = system.A[index], system.B[index, :, nu:], system.C[index, ny:], system.D[index, ny:, nu:]
    s: Complex = np.asarray(np.exp(1j * frequencies * system.dt) if system.dt else 1j * frequencies, np.complex128)
    moving = np.flatnonzero(channels.rates >= 0)
    into, out = np.concatenate([channels.wires, channels.rates[moving]]), channels.wires
    if not system.dt and system.wire_delay.any():
        step = max(1, CHUNK // (len(A) + nw) ** 2)
        some = [frequencies[k : k + step] for k in range(0, frequencies.size, step)]
        H = np.concatenate([_delayed(A, B, C, D, system.wire_delay, w, into, out) for w in some])
    else:
        through = np.linalg.inv(np.eye(nw) - D) if D.any() else np.eye(nw)
        H = _response(A + B @ through @ C, B @ through[:, into], through[out] @ C, s) + through[np.ix_(out, into)]
    chosen = H[:, :, : out.size]
    if moving.size:
        chosen[:, :, moving] += s[:, None, None] * H[:, :, out.size :]
    return chosen


def sensitivity_at_infinity(channels: Opened, index: int) -> Complex:
    """S (k, k) at infinite frequency, where delayed wires pass no signal; at the Nyquist frequency for a sampled loop."""
    system = channels.system
    if system.dt:
        return np.asarray(sensitivity(channels, index, np.array([np.pi / system.dt]))[0])
    D = system.D[index, system.ny :, system.nu :] * (system.wire_delay == 0)[:, None]
    through = np.linalg.inv(np.eye(system.nw) - D)
    S = through[channels.wires[:, None], channels.wires]
    moving = np.flatnonzero(channels.rates >= 0)
    if moving.size:
        C, B = through @ system.C[index, system.ny :], system.B[index, :, system.nu :] @ through
        S[:, moving] += C[channels.wires] @ B[:, channels.rates[moving]]
    return S.astype(complex)


def _response(A: Array, B: Array, C: Array, s: Complex) -> Complex:
    """C (sI - A)^-1 B for each s, by modes where these are well conditioned, else by linear solves."""
    poles, V = np.linalg.eig(A)
    if np.linalg.cond(V) < CONDITION:
        residues = (C @ V).T[:, :, None] * np.linalg.solve(V, B.astype(complex))[:, None, :]
        H = (1 / (s[:, None] - poles)) @ residues.reshape(len(A), -1)
        return np.asarray(H.reshape(s.size, *residues.shape[1:]))
    H, step = np.empty((s.size, len(C), B.shape[1]), np.complex128), max(1, CHUNK // len(A) ** 2)
    for k in range(0, s.size, step):
        matrix = s[k : k + step, None, None] * np.eye(len(A)) - A
        H[k : k + step] = C @ np.linalg.solve(matrix, np.broadcast_to(B.astype(complex), (len(matrix), *B.shape)))
    return H


def _delayed(A: Array, B: Array, C: Array, D: Array, delay: Array, w: Array, into: Ints, out: Ints) -> Complex:
    """Response (nf, out, into) with every wire closed through its dead time: input and output after the cut."""
    E = np.exp(-1j * w[:, None] * delay)[:, :, None]
    through = np.linalg.inv(np.eye(len(delay)) - E * D)
    force = B @ through
    back = through @ (E * C)
    closed = 1j * w[:, None, None] * np.eye(len(A)) - A - force @ (E * C)
    return np.asarray(back[:, out] @ np.linalg.solve(closed, force[:, :, into]) + through[:, out[:, None], into])
