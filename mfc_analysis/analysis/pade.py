"""Dead time by Pade approximation, for tools that take no dead time. Margins, verdicts and roots of this library have it exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mfc_analysis.analysis.channels import has_rate
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import Unsupported
from mfc_analysis.maths import checks

HIGHEST = 15  #: order; the coefficients of higher ones lose their digits


def with_pade(system: OpenSystem, order: int, at: str | None = None) -> OpenSystem:
    """The system whose late wires pass the Pade approximation of e^(-s T) of this order (1 to 15), with its states at the end.

    The diagonal one, without direct term where the loop is to be opened ``at`` a point whose rate is derived.
    Raises BadArgument, and Unsupported for a sampled system, which has its dead time exactly.
    Source: Golub & Van Loan, Matrix Computations, 4th ed., 9.3.1; ``control.pade``.
    """
    import control

    order = checks.whole("pade", order, 1, HIGHEST)
    if system.dt:
        raise Unsupported("pade", order, "a loop without sample_time: a sampled one includes its dead time exactly")
    proper = at is not None and has_rate(system, at)
    late = np.flatnonzero(system.wire_delay)
    if not late.size:
        return system
    m, nx, added = len(system.A), system.nx, order * late.size
    A = np.zeros((m, nx + added, nx + added))
    B = np.zeros((m, nx + added, system.B.shape[2]))
    C = np.zeros((m, system.C.shape[1], nx + added))
    D = system.D.copy()
    A[:, :nx, :nx], B[:, :nx], C[:, :, :nx] = system.A, system.B, system.C
    for k, wire in enumerate(late):
        one: Any = control.ss(control.tf(*control.pade(float(system.wire_delay[wire]), order, order - 1 if proper else None)))
        row, own = system.ny + wire, slice(nx + k * order, nx + (k + 1) * order)
        A[:, own, own] = one.A
        A[:, own, :nx], B[:, own] = one.B * system.C[:, row, None], one.B * system.D[:, row, None]
        C[:, row, :nx], D[:, row] = one.D * system.C[:, row], one.D * system.D[:, row]
        C[:, row, own] = one.C
    names = tuple(f"pade{i}_{system.wire_names[wire]}" for wire in late for i in range(order))
    return replace(system, A=A, B=B, C=C, D=D, state_names=system.state_names + names, wire_delay=np.zeros(system.nw))
