"""One loop at a time: the sensitivity of each channel of an analysis point, all other loops closed.

With every wire closed and a signal r added after wire i, the signal after the cut is S_i r, S_i = 1/(1 + L_i), with L in
negative feedback:

    S_i(s) = d_i + c_i (sI - A)^-1 b_i,      L_i = 1/S_i - 1.

All channels share the closed A. At "position" the encoder is cut, and with q_i its rate: the rate carries s r, and
s (sI - A)^-1 b = b + (sI - A)^-1 A b keeps S_i in the same form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import UnknownName, UnknownPoint
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Ints


@dataclass(frozen=True, eq=False)
class Channels:
    """Sensitivities of n channels at m points, dead time left out: S_i = d_i + c_i (sI - A)^-1 b_i."""

    names: tuple[str, ...]  #: (n,)
    A: Array  #: (m, nx, nx) closed loop
    B: Array  #: (m, nx, n) columns b_i
    C: Array  #: (m, n, nx) rows c_i
    H0: Array  #: (m, n) d_i - 1: S_i - 1 at infinite frequency
    dt: float  #: [s] 0: continuous
    #: where a rate is cut too: b_i (m, nx, n) and d_i - 1 (m, n) of the position alone, and the columns r_i (m, nx, n) of its rate, so that
    #: S_i = d_i + c_i (sI - A)^-1 (b_i + s r_i) without the cancellation of b_i + A r_i at low frequency
    apart: tuple[Array, Array, Array] | None = None

    @property
    def empty(self) -> Bools:
        """(m, n) where L_i is identically zero: the wire has no input or no effect."""
        return np.asarray((self.H0 == 0) & ~(self.B.any(axis=1) & self.C.any(axis=2)))

    def at(self, index: Ints | Bools) -> Channels:
        """The same channels at some of the points."""
        apart = None if self.apart is None else (self.apart[0][index], self.apart[1][index], self.apart[2][index])
        return replace(self, A=self.A[index], B=self.B[index], C=self.C[index], H0=self.H0[index], apart=apart)


def point_wires(system: OpenSystem, at: str) -> slice:
    """The wires of the analysis point ``at``. Raises ``UnknownPoint``, which lists the known points."""
    if at not in system.points or at not in system.wires:
        raise UnknownPoint(str(at), system.law, system.points)
    return system.wires[at]


def channel_number(channel: int | str, names: tuple[str, ...]) -> int:
    """The number of a channel given by its number or name. Raises ``BadArgument`` and ``UnknownName``."""
    if isinstance(channel, str):
        if channel not in names:
            raise UnknownName("channel", channel, names)
        return names.index(channel)
    return checks.whole("channel", channel, 0, len(names) - 1, f"an integer from 0 to {len(names) - 1} or one of {', '.join(names)}")


def has_rate(system: OpenSystem, at: str) -> bool:
    """Whether opening ``at`` also cuts the "rate" wires."""
    return at == "position" and "rate" in system.wires


def channels(system: OpenSystem, at: str) -> Channels:
    """The channels of the analysis point ``at`` with all wires closed, dead time left out.

    Raises ``UnknownPoint`` where the loop cannot be opened there.
    """
    wires = point_wires(system, at)
    nu, ny = system.nu, system.ny
    D22 = system.D[:, ny:, nu:]
    through = np.linalg.inv(np.eye(system.nw) - D22) if D22.any() else np.broadcast_to(np.eye(system.nw), D22.shape)
    into, out = system.B[:, :, nu:] @ through, through @ system.C[:, ny:, :]
    A = system.A + into @ system.C[:, ny:, :]
    B, C = into[:, :, wires], out[:, wires, :]
    H0: Array = np.asarray(np.diagonal(through[:, wires, wires], axis1=1, axis2=2) - 1.0, float)
    apart = None
    if has_rate(system, at):
        rate = system.wires["rate"]
        assert not np.diagonal(through[:, wires, rate], axis1=1, axis2=2).any(), "the rate reaches its own position without a state"
        assert not system.dt, "a sampled rate is not s times the sampled position"
        B_rate = into[:, :, rate]
        apart = B, H0, B_rate
        H0 = np.asarray(H0 + np.einsum("mnx,mxn->mn", C, B_rate), float)
        B = B + A @ B_rate
    return Channels(system.wire_names[wires], A, B, C, H0, system.dt, apart)


def continuous(ch: Channels) -> Channels:
    """Sampled channels in the w plane, z = (1 + w)/(1 - w): the unit circle maps to the imaginary axis, w = j tan(omega dt / 2).

    w -> infinity corresponds to z = -1.
    """
    if not ch.dt:
        return ch
    eye = np.eye(ch.A.shape[-1])
    stacked = np.linalg.solve(ch.A + eye, np.concatenate([ch.A - eye, ch.B], axis=2))
    A, B = stacked[:, :, : len(eye)], stacked[:, :, len(eye) :]
    return replace(ch, A=A, B=B - A @ B, H0=ch.H0 - np.einsum("mnx,mxn->mn", ch.C, B), dt=0.0)
