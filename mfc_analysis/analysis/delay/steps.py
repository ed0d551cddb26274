"""Step responses of loops with dead time by the method of steps.

Between grid points the signal after each cut is a cubic (value and slope at both ends, from one dead time ago), and a matrix
exponential gives the states exactly. The grid divides the shortest dead time, so that the kinks of the response at its
multiples lie on the grid. The error falls with the fourth power of the grid step, which is at first at most a twentieth of the
fastest time constant (no finer than 1/1024 of the shortest dead time), and twice as long wherever all signals of the last dead times
are the same in steps of twice the length.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from mfc_analysis.analysis.step_run import Piece
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument, NotConverged
from mfc_analysis.maths.arrays import Array

FINEST, SHOWN = 1024, 60  #: steps, and samples, in the shortest dead time
MOST_STEPS = 1_000_000
WIDE, BLOCK = 600, 64  #: numbers that say all of the past, up to which the steps of a block are one matrix, and the steps in one;
LONG = 20  #: steps of a run for each of these numbers, from which on the matrix saves more than it costs
DEEPEST = 16_384  #: steps in the longest dead time, where the shortest allows that
FINER = 8  #: times shorter are the first steps where a dead time is no whole number of them: a kink within a step is smeared over it
SAME, FAINT = 1e-9, 1e-3  #: of the largest value of a signal: what two step lengths may differ by; of its largest one of all inputs
LOOK = 0.25  #: of the time so far: how often longer steps are tried
FAST = 100_000  #: steps after which those shorter than a sample are doubled all the same, since the fastest root hardly decays
#: cubic on 0..1 from y, h y' at its start and at its end
CUBIC = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [-3, -2, 3, -1], [2, 1, -2, 1]])


def delayed_runner(system: OpenSystem) -> Callable[[float, int], Piece]:
    """The run (duration, samples) of unit steps of every input, for a system with one point; it ends where ``MOST_STEPS`` are used up.
    Not finite where an unstable loop overflows.

    Its responses are those of output 0 to all inputs, then of output 1, ...
    """
    late = system.wire_delay > 0
    A, B, C, D = (x[0] for x in close_wires(system, keep=late))
    T = system.wire_delay[late]
    longest = longest_step(system, FINEST)
    nu, ny = system.nu, system.ny
    columns = np.concatenate([nu + np.arange(T.size), np.arange(nu)])
    rows = np.concatenate([ny + np.arange(T.size), np.arange(ny)])

    def run(duration: float, samples: int) -> Piece:
        loop, wanted = (A, B[:, columns], C[rows], D[np.ix_(rows, columns)], T), max(min(duration / samples, longest), T.max() / DEEPEST)
        h = T.min() / 2 ** np.ceil(np.log2(max(T.min() / wanted * (1 - 1e-12), 1)))
        first = _Steps(*loop, h, nu)
        with np.errstate(over="ignore", invalid="ignore"):
            t, y = _marched(first if first.whole or first.deep * FINER > DEEPEST else _Steps(*loop, h / FINER, nu), duration)
            y[1::2] *= np.diff(t)
        return Piece(t, y, CUBIC)

    return run


def grid(system: OpenSystem, duration: float, samples: int) -> tuple[float, int]:
    """Step [s] and number of at least this many equal samples, in which the kinks of a response show. Raises ``BadArgument`` for too many."""
    T, wanted = float(system.wire_delay[system.wire_delay > 0].min()), min(duration / samples, longest_step(system))
    h = T / np.ceil(T / wanted * (1 - 1e-12))
    steps = int(np.ceil(duration / h * (1 - 1e-12)))
    if steps > MOST_STEPS:
        raise too_long(system, duration, MOST_STEPS * h)
    return h, steps


def longest_shown(system: OpenSystem) -> float:
    """[s] that takes ``MOST_STEPS`` of a grid, of a system with one point."""
    T = float(system.wire_delay[system.wire_delay > 0].min())
    return float(MOST_STEPS * T / np.ceil(T / longest_step(system) * (1 - 1e-12)) * (1 - 1e-9))


def too_long(system: OpenSystem, duration: float, reached: float) -> BadArgument:
    """The error of a duration [s] that takes more than ``MOST_STEPS``; they take ``reached`` [s]."""
    T = float(system.wire_delay[system.wire_delay > 0].min())
    return BadArgument("duration", float(duration), f"at most {reached:.4g} s, as far as {MOST_STEPS} steps go with a dead time of {T:.4g} s")


def never_settled(system: OpenSystem, into: int, out: int, rate: float, reached: float) -> NotConverged:
    """The error of a response that has not settled after ``reached`` [s], with ``MOST_STEPS``; ``rate`` [1/s] of its slowest root that decays."""
    shortest = float(system.wire_delay[system.wire_delay > 0].min())
    slowest = f"; the slowest root has a time constant of {1 / rate:.4g} s" if rate > 0 else ""
    return NotConverged(
        f"step {system.input_names[into]} -> {system.output_names[out]}: not settled after {reached:.4g} s, as far as "
        f"{MOST_STEPS} steps go with a dead time of {shortest:.4g} s{slowest}"
    )


def longest_step(system: OpenSystem, finest: int = SHOWN) -> float:
    """[s] by the fastest time constant and the shortest dead time, of which it is at least one of ``finest`` parts, of a system with one point.

    The fastest root is that of the loop without dead time or that of the loop with its delayed wires cut: a law may cancel a pole of the plant.
    """
    late = system.wire_delay > 0
    roots = np.linalg.eigvals([close_wires(system)[0][0], close_wires(system, keep=late)[0][0]])
    return max(0.05 / max(float(np.abs(roots).max(initial=0.0)), 1e-300), float(system.wire_delay[late].min()) / finest)


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
    """Equal steps of a loop with its delayed wires cut, from any start, which may have several columns.

    ``B``, ``D``: columns of the wires, then of ``nu`` inputs; ``C``, ``D``: rows of the signals into the wires, then y.
    What arrives in as many steps as the shortest dead time has is known at their start, so they are taken together.
    """

    def __init__(self, A: Array, B: Array, C: Array, D: Array, T: Array, h: float, nu: int) -> None:
        self.loop, self.T, self.h, self.nu = (A, B, C, D), T, h, nu
        self.nx, self.nd, self.ny = len(A), T.size, len(C) - T.size
        self.table = _one_step(A, B, C, D, h, nu)
        self.back = np.ceil(T / h * (1 - 1e-12)).astype(int)
        late = self.back - T / h
        late = np.where(np.abs(late) < 1e-9, 0.0, late)
        self.first, self.second = (np.stack([m[i] for m in (_shifted(f, h) for f in late)]) for i in (0, 1))
        self.whole = not late.any()
        self.deep = 2 * int(-(-self.back.max() // 2))  #: steps of the past that matter, an even number
        self.size = self.nx + 4 * self.nd * self.deep  #: numbers that say the state and the past
        self.together = max(1, int(self.back.min()) - (not self.whole))
        self.powers = [self.table[: self.nx, : self.nx]]  #: of the matrix of a step, for 1, 2, 4, ... steps
        while 2 ** len(self.powers) <= self.together:
            self.powers.append(self.powers[-1] @ self.powers[-1])

    def start(self) -> Array:
        """(size, nu) at rest."""
        return np.zeros((self.size, self.nu))

    def past(self, now: Array) -> Array:
        """(deep, nd, 4, k) the signals in the steps before, each with its slope, at the start and at the end of a step."""
        return now[self.nx :].reshape(self.deep, self.nd, 4, -1)

    def taken(self, count: int, now: Array, u: Array) -> tuple[Array, Array]:
        """Each y likewise in ``count`` steps, (count, ny, 4, k), and what is ``now`` (size, k) at their end. u (nu, k), constant."""
        nx, nd, k, wired = self.nx, self.nd, now.shape[1], self.nx + 4 * self.nd
        x, past = now[:nx], np.concatenate([self.past(now), np.zeros((count, nd, 4, k))])
        y = np.empty((count, 4 * self.ny, k))
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
            x, every = states[-1], np.concatenate([states[:-1], arriving, np.broadcast_to(u, (some.size, *u.shape))], axis=1)
            out = self.table[nx:] @ every
            past[some + self.deep] = out[:, : 4 * nd].reshape(-1, nd, 4, k)
            y[some] = out[:, 4 * nd :]
        return y.reshape(count, self.ny, 4, k), np.concatenate([x, past[count:].reshape(-1, k)])

    def run(self, count: int, now: Array, left: int) -> tuple[Array, Array]:
        """``taken`` of unit inputs, with ``left`` steps to go. Where few numbers say all of the past, many steps are one matrix."""
        if self.size > min(WIDE, left / LONG):
            return self.taken(count, now, np.eye(self.nu))
        parts = np.empty((-(-count // BLOCK), BLOCK * 4 * self.ny, self.nu))
        rest = count % BLOCK
        for part in parts[: count // BLOCK]:
            out = self._block @ np.concatenate([now, np.eye(self.nu)])
            part[:], now = out[: len(part)], out[len(part) :]
        if rest:
            y, now = self.taken(rest, now, np.eye(self.nu))
            parts[-1, : rest * 4 * self.ny] = y.reshape(-1, self.nu)
        return parts.reshape(-1, self.ny, 4, self.nu)[:count], now

    @cached_property
    def _block(self) -> Array:
        """From [now; u] to [y of ``BLOCK`` steps; now at their end]."""
        unit = np.eye(self.size + self.nu)
        y, now = self.taken(BLOCK, unit[: self.size], unit[self.size :])
        return np.concatenate([y.reshape(-1, len(unit)), now])

    def doubled(self, now: Array) -> tuple[_Steps, Array]:
        """Steps of twice the length, and what is ``now`` in these."""
        other, past = _Steps(*self.loop, self.T, 2 * self.h, self.nu), self.past(now)
        pairs = np.concatenate([past[::2, :, :2], past[1::2, :, 2:]], axis=2)
        return other, np.concatenate([now[: self.nx], np.zeros((4 * self.nd * (other.deep - len(pairs)), self.nu)), pairs.reshape(-1, self.nu)])

    def smooth(self, signals: Array, size: Array) -> bool:
        """Whether signals (2 j, r, 4, k) in the last steps are the same in half as many. ``size`` (r, k): largest values of each so far."""
        v0, s0, v1, s1 = np.moveaxis(signals, 2, 0) * np.array([1, self.h, 1, self.h])[:, None, None, None]
        first, last = (v0[::2], s0[::2]), (v1[1::2], s1[1::2])
        middle, slope = 0.5 * (first[0] + last[0]) + 0.25 * (first[1] - last[1]), 0.75 * (last[0] - first[0]) - 0.25 * (first[1] + last[1])
        off = [v0[1:] - v1[:-1], s0[1:] - s1[:-1], middle - v1[::2], slope - s1[::2]]
        return all(np.all(np.abs(one) <= SAME * np.maximum(size, FAINT * size.max(axis=1, keepdims=True))) for one in off)


def _marched(steps: _Steps, duration: float) -> tuple[Array, Array]:
    """Ends (k + 1,) [s] of the steps to ``duration`` [s], and each y and its slope at their starts and ends, (4, ny * nu, k), from rest."""
    now, at, used, lengths, parts = steps.start(), 0.0, 0, [], []
    most: Array = np.zeros((steps.nd + steps.ny, steps.nu))
    while at < duration * (1 - 1e-12) and used < MOST_STEPS:
        left = min(int(np.ceil((duration - at) / steps.h * (1 - 1e-12))), MOST_STEPS - used)
        count = left if steps.together == 1 else min(left, max(2 * steps.deep, int(LOOK * at / steps.h)))
        y, now = steps.run(count, now, left)
        at, used = at + count * steps.h, used + count
        lengths.append(np.full(count, steps.h))
        parts.append(y)
        if steps.together > 1 and left > count:
            past = steps.past(now)
            most = np.maximum(most, np.concatenate([np.abs(signals[:, :, ::2]).max(axis=(0, 2)) for signals in (past, y)]))
            if steps.smooth(np.concatenate([past, y[-steps.deep :]], axis=1), most) or (used > FAST and steps.together > SHOWN):
                steps, now = steps.doubled(now)
    y = np.concatenate(parts)
    t = np.concatenate([[0.0], np.cumsum(np.concatenate(lengths))])
    return t, np.ascontiguousarray(y.transpose(2, 1, 3, 0)).reshape(4, -1, len(y))


def _shifted(f: float, h: float) -> tuple[Array, Array]:
    """End values of a step that begins a fraction f into one step and ends the same fraction into the next, from the end values of both."""
    if f == 0:
        return np.eye(4), np.zeros((4, 4))
    value = np.array([1 - 3 * f**2 + 2 * f**3, h * (f - 2 * f**2 + f**3), 3 * f**2 - 2 * f**3, h * (f**3 - f**2)])
    slope = np.array([(-6 * f + 6 * f**2) / h, 1 - 4 * f + 3 * f**2, (6 * f - 6 * f**2) / h, 3 * f**2 - 2 * f])
    zero = np.zeros(4)
    return np.stack([value, slope, zero, zero]), np.stack([zero, zero, value, slope])
