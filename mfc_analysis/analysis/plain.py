"""Loops of your own, without a robot: margins, disk margins and characteristic roots of a python-control system L in unity negative feedback.

The definitions and methods are those of a robot's loops. The horizon is infinite unless given: every root is judged by its sign.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.delay.roots import delay_roots as roots_of
from mfc_analysis.analysis.disk import DiskMargin, disk_margin as disk_of
from mfc_analysis.analysis.margins import Margins, margins as margins_of
from mfc_analysis.analysis.measured import measured_margins
from mfc_analysis.analysis.spectrum import poles
from mfc_analysis.analysis.system import OpenSystem, checked_horizon
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Complex

STATIC = ("none",)  #: names of the states of a gain
AT = "loop"  #: the only analysis point
TAKES = "a proper python-control LTI system with as many outputs as inputs: StateSpace, TransferFunction or FrequencyResponseData"
MOST_SAMPLES = 200  #: samples of dead time in one channel of a discrete loop


def margins(L: Any, delay: ArrayLike = 0.0, *, horizon: float = np.inf, open_loop_unstable: int = 0) -> Margins:
    """One-loop-at-a-time margins of L in negative feedback, the other channels closed: gain interval, phase, delay, sensitivity peak.

    Args:
        L: StateSpace or TransferFunction, continuous or discrete, n x n, proper; or FrequencyResponseData of one channel, with straight lines from
            sample to sample and nothing beyond them.
        delay: [s] dead time behind L, exact; scalar or (n,). Of a discrete L whole samples.
        horizon: [s] roots with |s| < 1/horizon are slow; inf: every root is judged by its sign.
        open_loop_unstable: poles of measured data in the right half plane, for Nyquist's count.

    Returns:
        ``Margins`` at one time, 0 s. All NaN where the closed loop is unstable.

    Raises BadArgument.
    """
    import control

    unstable = checks.whole("open_loop_unstable", open_loop_unstable, 0, 100)
    if isinstance(L, control.FrequencyResponseData):
        return measured_margins(L, checks.number("delay", delay, low=0.0), unstable)
    if unstable:
        raise Unsupported("open_loop_unstable", unstable, "FrequencyResponseData with it: the poles of any other L are known")
    return margins_of(in_feedback(L, delay, horizon), AT)


def disk_margin(L: Any, delay: ArrayLike = 0.0, frequencies: ArrayLike | None = None, *, horizon: float = np.inf) -> DiskMargin:
    """The disk margin of all channels of L at once, in negative feedback. Arguments as ``margins``; ``frequencies`` [rad/s]: only there."""
    grid = None if frequencies is None else checks.array("frequencies", frequencies, (None,))
    return disk_of(in_feedback(L, delay, horizon), AT, grid)


def delay_roots(L: Any, delay: ArrayLike = 0.0, count: int = 6) -> Complex:
    """(count,) rightmost characteristic roots of the closed loop [1/s], dead time exact, rightmost first; of a discrete L all, in z.

    Other arguments as ``margins``, whose errors it raises.
    """
    system = in_feedback(L, delay, np.inf)
    count = checks.whole("count", count, 1, 1000)
    static, alone = system.state_names[:1] == STATIC, system.A[0, :1, 0]
    found = (poles(system) if system.dt else roots_of(system, count + static))[0]
    if static:
        found = np.delete(found, np.flatnonzero(np.abs(found - alone) <= 1e-9 * np.abs(alone))[:1])
    return np.asarray(found if system.dt else found[:count], np.complex128)


def in_feedback(L: Any, delay: ArrayLike = 0.0, horizon: float = np.inf) -> OpenSystem:
    """L with its output cut at the point "loop", in unity negative feedback. Raises BadArgument."""
    A, B, C, D, dt, names = _matrices(L)
    n = len(D)
    late = checks.per_joint("delay", delay, n, low=0.0)
    names_of_states = tuple(f"x{i}" for i in range(len(A)))
    if not names_of_states:  # a gain: the methods work on states, so it gets one that decays and acts on nothing
        A, B, C, names_of_states = np.full((1, 1), 0.0 if dt else -np.pi / (late.max() or 1.0)), np.zeros((1, n)), np.zeros((n, 1)), STATIC
    if dt and late.any():
        A, B, C, D = _with_samples(A, B, C, D, late / dt)
        late = np.zeros(n)
    if np.linalg.cond(np.eye(n) + D) > 1 / np.finfo(float).eps:
        raise BadArgument("L", "I + D singular, D the gain of L at infinite frequency", "a loop that can be closed: this one has no solution")
    return OpenSystem(
        times=np.zeros(1), A=A[None], B=-B[None], C=C[None], D=-D[None], state_names=names_of_states, input_names=(),
        output_names=(), wires={AT: slice(0, n)}, wire_names=names, wire_delay=late, points=(AT,), dt=dt,
        horizon=checked_horizon(horizon, dt),
    )  # fmt: skip


def _matrices(L: Any) -> tuple[Array, Array, Array, Array, float, tuple[str, ...]]:
    """A, B, C, D, the sample time [s] (0: continuous) and the names of the channels."""
    import control

    if isinstance(L, control.TransferFunction):
        for row in range(L.noutputs):
            for column in range(L.ninputs):
                num, den = (np.trim_zeros(np.atleast_1d(np.asarray(p[row][column], float)), "f") for p in (L.num, L.den))
                if num.size > den.size:
                    raise BadArgument("L", f"an improper transfer function (degree {num.size - 1} over {den.size - 1})", TAKES)
        L = control.ss(L) if L.issiso() else control.tf2ss(L)
    if not isinstance(L, control.StateSpace) or L.noutputs != L.ninputs or not L.noutputs:
        shape = f" with {L.noutputs} outputs and {L.ninputs} inputs" if isinstance(L, control.StateSpace) else ""
        raise BadArgument("L", f"{type(L).__name__}{shape}", TAKES)
    if L.dt is True:
        raise BadArgument("L", "a discrete system without sample time (dt = True)", "dt in seconds")
    A, B, C, D = (checks.array("L", M) for M in (L.A, L.B, L.C, L.D))
    return A, B, C, D, float(L.dt or 0.0), tuple(str(name) for name in L.output_labels)


def _with_samples(A: Array, B: Array, C: Array, D: Array, samples: Array) -> tuple[Array, Array, Array, Array]:
    """Each output (n,) late by whole samples, held in states."""
    whole = np.rint(samples)
    takes = f"whole sample times of L, at most {MOST_SAMPLES}: a fraction acts within the hold, which a discrete L does not contain"
    if np.abs(samples - whole).max() > 1e-9 * max(1.0, whole.max()) or whole.max() > MOST_SAMPLES:
        raise BadArgument("delay", f"{samples.max():.6g} samples", takes)
    for row, count in enumerate(whole.astype(int)):
        for _ in range(count):
            nx = len(A)
            A = np.block([[A, np.zeros((nx, 1))], [C[row : row + 1], np.zeros((1, 1))]])
            B = np.vstack([B, D[row : row + 1]])
            C = np.hstack([C, np.zeros((len(C), 1))])
            D = D.copy()
            C[row], D[row] = 0.0, 0.0
            C[row, nx] = 1.0
    return A, B, C, D
