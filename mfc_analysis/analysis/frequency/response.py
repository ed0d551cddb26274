"""Exact frequency responses of the loops: a linear solve at every frequency, with dead time as e^(-jwT).

With all wires cut, w_out = G(s) w_in, G = C2 (sI - A)^-1 B2 + D22 of the open system. With all but one closed,

    -L_i = e_i (G_ii + G_io E_o (I - G_oo E_o)^-1 G_oi),        E = diag(e^(-s T)),

which is accurate where |L_i| is large and needs no eigenvectors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.channels import has_rate, point_wires
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Complex
from mfc_analysis.maths.checks import vector

CHUNK = 2_000_000  #: complex numbers solved for at a time


def frequency_response(system: OpenSystem, frequencies: ArrayLike, at: str, channel: int | None = None) -> Complex:
    """L_i(jw), (m, n, nf) complex, of each channel of the point ``at``, the others closed, dead time included.

    ``frequencies``: (nf,) [rad/s], not negative; up to pi/dt of a sampled loop, where L_i(e^(jw dt)) is returned. Infinite on a pole of L_i.
    ``channel``: index of the only one wanted, (m, 1, nf).
    Raises ``UnknownPoint`` and ``BadArgument``.
    """
    wires = point_wires(system, at)
    w = vector("frequencies", frequencies)
    highest = np.pi / system.dt * (1 + 1e-12) if system.dt else np.inf
    if np.any(w < 0) or np.any(w > highest):
        raise BadArgument("frequencies", frequencies, "frequencies >= 0 [rad/s]" + (f" up to pi/dt = {np.pi / system.dt:.6g}" if system.dt else ""))
    s: Complex = np.asarray(np.exp(1j * w * system.dt) if system.dt else 1j * w, np.complex128)
    delays = np.exp(-1j * w[:, None] * (0.0 if system.dt else system.wire_delay))
    numbers = np.arange(system.nw)
    cuts = np.stack([numbers[wires], numbers[system.wires["rate"]]] if has_rate(system, at) else [numbers[wires]], axis=1)
    cuts = cuts if channel is None else cuts[[channel]]
    out = np.empty((len(system.A), len(cuts), w.size), np.complex128)
    for i in range(len(system.A)):
        G = wire_response(system, i, s)
        for k, cut in enumerate(cuts.tolist()):
            out[i, k] = _loop(G, delays, cut, s, bool(system.dt))
    return out


def wire_response(system: OpenSystem, index: int, s: Complex) -> Complex:
    """G (nf, nw, nw) from after each cut to before each cut, all wires cut, at s (nf,); infinite on a pole."""
    A, B, C, D = system.A[index], system.B[index][:, system.nu :], system.C[index][system.ny :], system.D[index][system.ny :, system.nu :]
    nx = system.nx
    G = np.empty((s.size, *D.shape), np.complex128)
    step = max(1, CHUNK // max(1, nx * nx))
    for k in range(0, s.size, step):
        matrix = s[k : k + step, None, None] * np.eye(nx) - A
        G[k : k + step] = C @ _solved(matrix, np.broadcast_to(B.astype(complex), (len(matrix), *B.shape))) + D
    return G


def _solved(matrix: Complex, right: Complex) -> Complex:
    """matrix^-1 right, (k, n, n) and (k, n, j); NaN where a matrix is singular: at a pole on the axis there is no response."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), np.complex128)
    except np.linalg.LinAlgError:
        if len(matrix) == 1:
            return np.full(right.shape, np.nan, np.complex128)
        return np.concatenate([_solved(matrix[[i]], right[[i]]) for i in range(len(matrix))])


def _loop(G: Complex, delays: Complex, cut: list[int], s: Complex, sampled: bool) -> Complex:
    """L (nf,) with the wires ``cut`` open (a position with its rate: two) and the others closed."""
    others = [j for j in range(G.shape[1]) if j not in cut]
    G = G * delays[:, None, :]
    open_wires = G[:, cut][:, :, cut]
    if others:
        bad = np.asarray(~np.isfinite(G).all(axis=(1, 2)))
        G = np.where(bad[:, None, None], 0.0, G)
        back = _solved(np.eye(len(others)) - G[:, others][:, :, others], G[:, others][:, :, cut])
        open_wires = G[:, cut][:, :, cut] + G[:, cut][:, :, others] @ back
        open_wires[bad] = np.nan
    if len(cut) == 1:
        L = -open_wires[:, 0, 0]
    elif sampled:
        L = np.linalg.det(np.eye(2) - open_wires) - 1
    else:
        L = -(open_wires[:, 0, 0] + s * open_wires[:, 0, 1])
    return np.asarray(np.where(np.isnan(L), complex(np.inf), L))
