"""Samples of all unit step responses at all points: one transition for each point, then products of blocks; for dead time see ``delay.steps``.

With the input as states that stay, M = [[A, B], [0, I]] of a sampled loop, or exp([[A, B], [0, 0]] h), and y_k = [C D] M^k [0; I]. The rows
[C D] M^a, 0 <= a < r, and the columns M^(r b) [0; I] grow by doubling; their product has all samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mfc_analysis.analysis.delay.steps import delayed_runner, longest_step, too_long
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.zero_order_hold import zero_order_hold

FEWEST = 1000  #: samples of a response
TOGETHER = 64  #: responses with dead time in one run
VALUES = 1 << 20  #: computed at once
ROUGHLY = 1e-9  #: of a step: how far apart two may be and count as equal


def step_samples(system: OpenSystem, times: Array) -> Array:
    """(m, ny, nu, k) unit step responses of the closed loop at the increasing ``times`` (k,) [s], dead time included.

    A sampled loop holds its outputs from sample to sample. Not finite where an unstable loop overflows. Raises ``BadArgument`` for more steps
    than a loop with dead time affords.
    """
    m, ny, nu = len(system.A), system.ny, system.nu
    out = np.empty((m, ny, nu, times.size))
    if system.delayed:
        for i in range(m):
            for into in input_groups(system):
                one = between(system.at(np.array([i])), into, range(ny))
                run = delayed_runner(one)(float(times[-1]) or longest_step(one), FEWEST)
                if run.t[-1] < times[-1] * (1 - 1e-9):
                    raise too_long(one, float(times[-1]), float(run.t[-1]))
                out[i][:, into] = run.values(times).reshape(ny, into.size, -1)
        return out
    chunk = max(1, VALUES // max(1, ny * nu * times.size))
    for i in range(0, m, chunk):
        at = slice(i, i + chunk)
        with np.errstate(over="ignore", invalid="ignore"):
            _fill(out[at], *close_wires(system.at(at)), times, system.dt)
    return out


def between(system: OpenSystem, into: Sequence[int] | Ints, out: Sequence[int] | Ints) -> OpenSystem:
    """The system with some of its inputs and outputs, and all its wires."""
    columns, rows = np.append(into, system.nu + np.arange(system.nw)).astype(int), np.append(out, system.ny + np.arange(system.nw)).astype(int)
    return replace(
        system, B=system.B[:, :, columns], C=system.C[:, rows], D=system.D[:, rows[:, None], columns],
        input_names=tuple(system.input_names[i] for i in into), output_names=tuple(system.output_names[i] for i in out),
    )  # fmt: skip


def input_groups(system: OpenSystem) -> list[Ints]:
    """Inputs that share a run with dead time, no more than memory takes."""
    parts = -(-system.nu * system.ny // TOGETHER)
    return [np.asarray(part, int) for part in np.array_split(np.arange(system.nu), parts)]


def _fill(out: Array, A: Array, B: Array, C: Array, D: Array, times: Array, dt: float) -> None:
    m, nx, nu = B.shape
    place = np.floor(times / dt * (1 + 1e-12) + ROUGHLY) if dt else times
    rows, now = np.concatenate([C, D], axis=2), np.zeros((m, nx + nu, nu))
    now[:, nx:] = np.eye(nu)

    def over(step: float) -> Array:
        """(m, nx + nu, nx + nu) transition."""
        M = np.zeros((m, nx + nu, nx + nu))
        M[:, nx:, nx:] = np.eye(nu)
        M[:, :nx, :nx], M[:, :nx, nx:] = (A, B) if dt else zero_order_hold(A, B, step)
        return np.linalg.matrix_power(M, round(step)) if dt else M

    if place[0] > 0:
        now = over(place[0]) @ now
    steps = np.diff(place)
    if not steps.size or np.ptp(steps) <= ROUGHLY * steps.max():
        out[:] = _doubled(over(float(steps.mean())) if steps.size else np.eye(nx + nu), rows, now, times.size)
        return
    known: dict[float, Array] = {}
    out[..., 0] = rows @ now
    for k, step in enumerate(steps):
        if dt and step not in known:
            known[step] = over(step)
        now = (known[step] if dt else over(step)) @ now
        out[..., k + 1] = rows @ now


def _doubled(M: Array, rows: Array, columns: Array, count: int) -> Array:
    """(m, ny, nu, count): rows M^k columns."""
    m, ny, n = rows.shape
    rows, columns = rows[:, :, None], columns[..., None]  # (m, ny, a, n), (m, n, nu, b)
    while rows.shape[2] ** 2 < count:
        rows = np.concatenate([rows, (rows.reshape(m, -1, n) @ M).reshape(rows.shape)], axis=2)
        M = M @ M
    a = rows.shape[2]
    b, nu = -(-count // a), columns.shape[2]
    while columns.shape[3] < b:
        columns = np.concatenate([columns, (M @ columns.reshape(m, n, -1)).reshape(columns.shape)], axis=3)
        M = M @ M
    y = columns[..., :b].reshape(m, n, -1).transpose(0, 2, 1) @ rows.reshape(m, -1, n).transpose(0, 2, 1)  # (m, nu b, ny a)
    return y.reshape(m, nu, b, ny, a).transpose(0, 3, 1, 2, 4).reshape(m, ny, nu, -1)[..., :count]
