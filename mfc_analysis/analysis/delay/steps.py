"""Step responses of loops with dead time by the method of steps.

Between grid points the signal after each cut is a cubic (value and slope at both ends, from one dead time ago), and a matrix
exponential gives the states exactly. The grid divides the shortest dead time, so that the kinks of the response at its
multiples lie on the grid. The error falls with the fourth power of the grid step, which is at most a twentieth of the
fastest time constant (no finer than 1/60 of the shortest dead time).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfc_analysis.analysis.step_run import Piece
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.maths.arrays import Array

FINEST = 60  #: steps in the shortest dead time
MOST_STEPS = 1_000_000
WIDE, BLOCK = 600, 64  #: numbers that say all of the past, up to which the steps of a block are one matrix, and the steps in one;
LONG = 20  #: steps of a run for each of these numbers, from which on the matrix saves more than it costs
#: cubic on 0..1 from y, h y' at its start and at its end
CUBIC = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-3, -2, 3, -1], [2, 1, -2, 1]])


def delayed_runner(system: OpenSystem) -> Callable[[float, int], Piece]:
    """The run (duration, samples) of unit steps of every input, for a system with one point.

    Its responses are those of output 0 to all inputs, then of output 1, ...
    """
    late = system.wire_delay > 0
    A, B, C, D = (x[0] for x in close_wires(system, keep=late))
    T = system.wire_delay[late]
    longest = longest_step(system)
    nu, ny = system.nu, system.ny
    columns = np.concatenate([nu + np.arange(T.size), np.arange(nu)])
    rows = np.concatenate([ny + np.arange(T.size), np.arange(ny)])

    def run(duration: float, samples: int) -> Piece:
        wanted = min(duration / samples, longest)
        h = T.min() / np.ceil(T.min() / wanted * (1 - 1e-12))
        steps = int(np.ceil(duration / h * (1 - 1e-12)))
        if steps > MOST_STEPS:
            takes = f"at most {MOST_STEPS * h:.4g} s: the dead time of {T.min():.4g} s needs steps of {h:.3g} s"
            raise BadArgument("duration", float(duration), takes)
        table = _one_step(A, B[:, columns], C[rows], D[np.ix_(rows, columns)], h, nu)
        y = _marched(table, len(A), T, h, steps, nu)
        y[1::2] *= h
        return Piece(h * np.arange(steps + 1), y, CUBIC)

    return run


def longest_run(system: OpenSystem) -> float:
    """[s] that takes ``MOST_STEPS`` of the longest steps, of a system with one point."""
    T = float(system.wire_delay[system.wire_delay > 0].min())
    return float(MOST_STEPS * T / np.ceil(T / longest_step(system) * (1 - 1e-12)) * (1 - 1e-9))


def never_settled(system: OpenSystem, into: int, out: int, rate: float) -> NotConverged:
    """The error of a response that has not settled when ``MOST_STEPS`` are used up; ``rate`` [1/s] of its slowest root that decays."""
    shortest = float(system.wire_delay[system.wire_delay > 0].min())
    slowest = f"; the slowest root has a time constant of {1 / rate:.4g} s" if rate > 0 else ""
    return NotConverged(
        f"step {system.input_names[into]} -> {system.output_names[out]}: not settled after {longest_run(system):.4g} s, as far as "
        f"{MOST_STEPS} steps go with a dead time of {shortest:.4g} s{slowest}"
    )


def longest_step(system: OpenSystem) -> float:
    """[s] by the fastest time constant and the shortest dead time of a system with one point."""
    fastest = float(np.abs(np.linalg.eigvals(close_wires(system)[0][0])).max(initial=0.0))
    return max(0.05 / max(fastest, 1e-300), float(system.wire_delay[system.wire_delay > 0].min()) / FINEST)


def _one_step(A: Array, B: Array, C: Array, D: Array, h: float, nu: int) -> Array:
    """Matrix from the start of a step, [x; v0, v0', v1, v1' of each wire; u], to [x at its end; w0, w0', w1, w1' of each output].

    B, D: columns of the delayed wires, then of ``nu`` inputs; C, D: rows of the signals into the wires, then y.
    """
    from scipy.linalg import expm

    nx, k = B.shape
    chain = np.zeros((nx + 4 * k, nx + 4 * k))  # x and the derivatives of the cubic inputs
    chain[:nx, :nx], chain[:nx, nx : nx + k] = A, B
    chain[nx : nx + 3 * k, nx + k :] = np.eye(3 * k)
    move = expm(chain * h)[:nx]
    hermite = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-6 / h**2, -4 / h, 6 / h**2, -2 / h], [12 / h**3, 6 / h**2, -12 / h**3, 6 / h**2]])
    size = nx + 4 * (k - nu) + nu
    ends = np.zeros((4, k, size))  # v0, v0', v1, v1' of every input
    for j in range(k - nu):
        ends[:, j, nx + 4 * j : nx + 4 * j + 4] = np.eye(4)
    ends[0, k - nu :, size - nu :] = ends[2, k - nu :, size - nu :] = np.eye(nu)
    derivatives = np.einsum("de,eks->dks", hermite, ends).reshape(4 * k, size)
    start = np.eye(nx, size)
    end = move[:, :nx] @ start + move[:, nx:] @ derivatives
    rows = [end]
    for x, v, slope in ((start, ends[0], ends[1]), (end, ends[2], ends[3])):
        rows += [C @ x + D @ v, C @ (A @ x + B @ v) + D @ slope]
    shape = (4, len(C), size)
    return np.concatenate([rows[0], np.stack(rows[1:]).reshape(shape).transpose(1, 0, 2).reshape(-1, size)])


class _Steps:
    """Equal steps of a loop from any start; a start and its responses have as many columns as are asked for.

    What arrives in as many steps as the shortest dead time has is known at their start, so they are taken together.
    """

    def __init__(self, table: Array, nx: int, T: Array, h: float) -> None:
        self.table, self.nx, self.nd = table, nx, T.size
        self.back = np.ceil(T / h * (1 - 1e-12)).astype(int)
        late = self.back - T / h
        late = np.where(np.abs(late) < 1e-9, 0.0, late)
        self.first, self.second = (np.stack([m[i] for m in (_shifted(f, h) for f in late)]) for i in (0, 1))
        self.whole, self.deep = not late.any(), int(self.back.max())
        self.together = max(1, int(self.back.min()) - (not self.whole))
        self.powers = [table[:nx, :nx]]  #: of the matrix of a step, for 1, 2, 4, ... steps
        while 2 ** len(self.powers) <= self.together:
            self.powers.append(self.powers[-1] @ self.powers[-1])

    def taken(self, count: int, x: Array, past: Array, u: Array) -> tuple[Array, Array, Array]:
        """Each y and its slope at the start and at the end of ``count`` steps (count, 4 ny, k), and x and ``past`` at their end.

        x (nx, k); past (deep, nd, 4, k): signals in the steps before; u (nu, k), constant.
        """
        nx, nd, k, wired = self.nx, self.nd, x.shape[1], self.nx + 4 * self.nd
        past = np.concatenate([past, np.zeros((count, nd, 4, k))])
        y = np.empty((count, len(self.table) - wired, k))
        for start in range(0, count, self.together):
            some = np.arange(start, min(start + self.together, count))
            which, wires = some[:, None] + self.deep - self.back, np.arange(nd)
            arriving = past[which, wires]
            if not self.whole:
                arriving = self.first @ arriving + self.second @ past[np.minimum(which + 1, start + self.deep - 1), wires]
            arriving = arriving.reshape(some.size, -1, k)
            states = np.concatenate([x[None], self.table[:nx, nx:wired] @ arriving + self.table[:nx, wired:] @ u])
            for j, power in enumerate(self.powers):
                states[2**j :] += power @ states[: -(2**j)]
            x, now = states[-1], np.concatenate([states[:-1], arriving, np.broadcast_to(u, (some.size, *u.shape))], axis=1)
            out = self.table[nx:] @ now
            past[some + self.deep] = out[:, : 4 * nd].reshape(-1, nd, 4, k)
            y[some] = out[:, 4 * nd :]
        return y, x, past[count:]


def _marched(table: Array, nx: int, T: Array, h: float, steps: int, nu: int) -> Array:
    """(4, ny * nu, steps): each y and its slope at the start and at the end of each step, from rest.

    Where few numbers say all of the past, many steps are one matrix.
    """
    march = _Steps(table, nx, T, h)
    shape = march.deep, march.nd, 4
    size = nx + int(np.prod(shape))
    if size > min(WIDE, steps / LONG):
        y = march.taken(steps, np.zeros((nx, nu)), np.zeros((*shape, nu)), np.eye(nu))[0]
    else:
        unit, parts = np.eye(size + nu), np.zeros((-(-steps // BLOCK), BLOCK * (len(table) - nx - 4 * march.nd), nu))
        y, x, past = march.taken(BLOCK, unit[:nx], unit[nx:size].reshape(*shape, -1), unit[size:])
        block = np.concatenate([y.reshape(-1, size + nu), x, past.reshape(-1, size + nu)])
        now = unit[:, size:].copy()
        for part in parts:
            out = block @ now
            part[:], now[:size] = out[: len(part)], out[len(part) :]
        y = parts.reshape(-1, len(table) - nx - 4 * march.nd, nu)[:steps]
    return np.ascontiguousarray(y.reshape(steps, -1, 4, nu).transpose(2, 1, 3, 0)).reshape(4, -1, steps)


def _shifted(f: float, h: float) -> tuple[Array, Array]:
    """End values of a step that begins a fraction f into one step and ends the same fraction into the next, from the end values of both."""
    if f == 0:
        return np.eye(4), np.zeros((4, 4))
    value = np.array([1 - 3 * f**2 + 2 * f**3, h * (f - 2 * f**2 + f**3), 3 * f**2 - 2 * f**3, h * (f**3 - f**2)])
    slope = np.array([(-6 * f + 6 * f**2) / h, 1 - 4 * f + 3 * f**2, (6 * f - 6 * f**2) / h, 3 * f**2 - 2 * f])
    zero = np.zeros(4)
    return np.stack([value, slope, zero, zero]), np.stack([zero, zero, value, slope])
