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


def _marched(table: Array, nx: int, T: Array, h: float, steps: int, nu: int) -> Array:
    """(4, ny * nu, steps): each y and its slope at the start and at the end of each step, from rest."""
    nd = T.size
    back = np.ceil(T / h * (1 - 1e-12)).astype(int)
    late = back - T / h
    late = np.where(np.abs(late) < 1e-9, 0.0, late)
    first, second = (np.stack([m[i] for m in (_shifted(f, h) for f in late)]) for i in (0, 1))
    deep = int(back.max())
    past = np.zeros((steps + deep + 1, nd, 4, nu))
    wired = nx + 4 * nd  # rows of the states and of the wires
    y = np.empty((steps, len(table) - wired, nu))
    now = np.zeros((table.shape[1], nu))
    now[wired:] = np.eye(nu)
    wires, whole = np.arange(nd), not late.any()
    for k in range(steps):
        which = k + deep - back
        arriving = past[which, wires]
        if not whole:
            arriving = first @ arriving + second @ past[np.minimum(which + 1, k + deep - 1), wires]
        now[nx:wired] = arriving.reshape(-1, nu)
        out = table @ now
        now[:nx] = out[:nx]
        past[k + deep] = out[nx:wired].reshape(nd, 4, nu)
        y[k] = out[wired:]
    return np.ascontiguousarray(y.reshape(steps, -1, 4, nu).transpose(2, 1, 3, 0)).reshape(4, -1, steps)


def _shifted(f: float, h: float) -> tuple[Array, Array]:
    """End values of a step that begins a fraction f into one step and ends the same fraction into the next, from the end values of both."""
    if f == 0:
        return np.eye(4), np.zeros((4, 4))
    value = np.array([1 - 3 * f**2 + 2 * f**3, h * (f - 2 * f**2 + f**3), 3 * f**2 - 2 * f**3, h * (f**3 - f**2)])
    slope = np.array([(-6 * f + 6 * f**2) / h, 1 - 4 * f + 3 * f**2, (6 * f - 6 * f**2) / h, 3 * f**2 - 2 * f])
    zero = np.zeros(4)
    return np.stack([value, slope, zero, zero]), np.stack([zero, zero, value, slope])
