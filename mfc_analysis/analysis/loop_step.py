"""The two unit steps whose settling time and overshoot are asked for, and the second of them.

- "reference": the reference of one channel steps, its derivatives stay zero (v_d = 0): the response of the coordinate that follows it;
- "loop": the step response of T_i = L_i/(1 + L_i), loop i opened at an analysis point, the others closed.

The poles are the same. A law that multiplies the derivative of the error gets v = q', not the derivative of the step of q_d: with kp, ki, kd on
a double integrator the first is (kp s + ki)/p(s), the second (kd s^2 + kp s + ki)/p(s), p(s) = s^3 + kd s^2 + kp s + ki.

With a signal r added after wire i, the signal before the cut is -T_i r (``channels``): T_i has the inputs and outputs of the wires, so
dead time, sampling and all other loops are in it as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from mfc_analysis.analysis.channels import has_rate, point_wires
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import Unsupported
from mfc_analysis.maths.arrays import Array

SettlingStep = Literal["reference", "loop"]
STEPS: Mapping[str, str] = {"reference": "reference step", "loop": "loop step"}  #: in words


def loop_step(system: OpenSystem, at: str) -> tuple[OpenSystem, Array]:
    """The system with T_i from input i to output i of the n channels of ``at``, and the dead time (n,) [s] by which T_i responds later.

    Channels without a loop, T_i = 0 at all points, are left out. Raises ``UnknownPoint``; ``Unsupported`` where the encoder is opened and its
    rate goes into dead time unfiltered: the rate of a step is an impulse.
    """
    wires = np.arange(system.nw)[point_wires(system, at)]
    n, nu, ny = wires.size, system.nu, system.ny
    late = system.wire_delay > 0
    rate = np.arange(system.nw)[system.wires["rate"]] if has_rate(system, at) else wires[:0]
    added = np.concatenate([wires, rate])
    opened = replace(
        system,
        B=np.concatenate([system.B[:, :, nu + added], system.B[:, :, nu:]], axis=2),
        C=np.concatenate([-system.C[:, ny + wires], system.C[:, ny:]], axis=1),
        D=np.concatenate([
            np.concatenate([-system.D[:, (ny + wires)[:, None], nu + added], -system.D[:, ny + wires, nu:]], axis=2),
            np.concatenate([system.D[:, ny:, nu + added], system.D[:, ny:, nu:]], axis=2),
        ], axis=1),
        input_names=tuple(system.wire_names[i] for i in added),
        output_names=tuple(system.wire_names[i] for i in wires),
    )  # fmt: skip
    A, B, C, D = close_wires(opened, keep=late)
    if rate.size:  # s (sI - A)^-1 b = b + (sI - A)^-1 A b
        passed = D[:, :, n : 2 * n].copy()
        passed[:, np.arange(n)[:, None], np.arange(n)] *= np.eye(n)  # the other channels are not asked for
        if passed.any():
            takes = f"'reference', another analysis point than {at!r}, or a velocity filter: the rate of a step of the encoder goes into dead time"
            raise Unsupported("step", "loop", takes)
        moved = B[:, :, n : 2 * n]
        B = np.concatenate([B[:, :, :n] + A @ moved, B[:, :, 2 * n :]], axis=2)
        D = np.concatenate([D[:, :, :n] + C @ moved, D[:, :, 2 * n :]], axis=2)
    looped = [i for i in range(n) if (B[:, :, i].any() or D[:, :, i].any()) and (C[:, i].any() or D[:, i].any())]
    own = np.array([*looped, *range(n, B.shape[2])], int)  # and the wires with dead time
    names = tuple(system.wire_names[wires[i]] for i in looped)
    closed = replace(
        opened, A=A, B=B[:, :, own], C=C[:, own], D=D[:, own[:, None], own], input_names=names, output_names=names, wires={}, points=(),
        wire_names=tuple(name for name, kept in zip(system.wire_names, late, strict=True) if kept), wire_delay=system.wire_delay[late],
    )  # fmt: skip
    return closed, system.wire_delay[wires[looped]]
