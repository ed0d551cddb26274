"""One operating point as models of python-control, which take no dead time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.analysis.channels import channel_number, channels, has_rate, point_wires
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.analysis.system import OpenSystem, close_wires, signals
from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from control import FrequencyResponseData, StateSpace


def closed_model(system: OpenSystem) -> StateSpace:
    """The closed loop of a system with one point as a ``control.StateSpace`` with named signals, without the dead time of its wires."""
    import control

    A, B, C, D = (M[0] for M in close_wires(system))
    return control.StateSpace(
        A, B, C, D, system.dt, name=_named("closed_loop", system),
        states=signals(system.state_names), inputs=signals(system.input_names), outputs=signals(system.output_names),
    )  # fmt: skip


def loop_model(system: OpenSystem, at: str, channel: int | str | None) -> StateSpace:
    """L(s) opened at ``at`` in one channel (default: the first), the others closed, as a ``control.StateSpace``. Raises UnknownName."""
    import control

    wires = point_wires(system, at)
    names = system.wire_names[wires]
    j = 0 if channel is None else channel_number(channel, names)
    cut = np.arange(system.nw) == wires.start + j
    rate = system.wires["rate"].start + j if has_rate(system, at) else None
    if rate is not None:
        cut[rate] = True
    A, B, C, D = (M[0] for M in close_wires(system, cut))
    kept = np.flatnonzero(cut)
    k = int(np.searchsorted(kept, wires.start + j))
    b, c, d = B[:, system.nu + k], C[system.ny + k], D[system.ny + k, system.nu + k]
    if rate is not None:  # it carries s r, and s (sI - A)^-1 b = b + (sI - A)^-1 A b
        into = B[:, system.nu + int(np.searchsorted(kept, rate))]
        b, d = b + A @ into, d + c @ into
    return control.StateSpace(
        A, b[:, None], -c[None, :], [[-d]], system.dt,
        inputs=signals([f"{at}_{names[j]}_in"]), outputs=signals([f"{at}_{names[j]}_out"]), name=_named(f"L_{at}_{names[j]}", system),
    )  # fmt: skip


def measured_model(system: OpenSystem, frequencies: Array, at: str, channel: int | str | None) -> FrequencyResponseData:
    """L(jw) of the same loop at w (k,) [rad/s] as ``control.FrequencyResponseData``, dead time included. Raises UnknownName."""
    import control

    names = tuple(channels(system, at).names)
    j = 0 if channel is None else channel_number(channel, names)
    L = frequency_response(system, frequencies, at, j)[0, 0]
    name = f"L_{at}_{names[j]}".replace(".", "_")
    into, out = (signals([f"{at}_{names[j]}_{end}"]) for end in ("in", "out"))
    return control.frd(L, frequencies, inputs=into, outputs=out, name=name, smooth=False)


def _named(name: str, system: OpenSystem) -> str:
    """With what the model leaves out; python-control allows no full stop."""
    return f"{name}{'_without_dead_time' if system.delayed else ''}".replace(".", "_")
