"""Open loops from transfer functions, as the analysis sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import control
import numpy as np
import pytest

from mfc_analysis.analysis.system import OpenSystem


def open_system(L: control.lti.LTI | Sequence[control.lti.LTI], delay: float = 0.0) -> OpenSystem:
    """The loop whose transfer, cut at the wire "torque", is L in negative feedback. Input "d" adds at the wire, output "y" is what arrives, negated.

    A sequence gives several points; all must have the same order.
    """
    models = [control.ss(one) for one in (L if isinstance(L, (list, tuple)) else [L])]
    A = np.stack([s.A for s in models])
    B = np.stack([np.hstack([s.B, s.B]) for s in models])
    C = np.stack([np.vstack([s.C, -s.C]) for s in models])
    D = np.stack([np.block([[s.D, s.D], [-s.D, -s.D]]) for s in models])
    return OpenSystem(
        times=np.arange(len(models), dtype=float),
        A=A,
        B=B,
        C=C,
        D=D,
        state_names=tuple(f"x{i}" for i in range(A.shape[-1])),
        input_names=("d",),
        output_names=("y",),
        wires={"torque": slice(0, 1)},
        wire_names=("joint",),
        wire_delay=np.array([delay]),
        points=("torque",),
        dt=float(models[0].dt or 0.0),
    )


def from_matrix(A: np.ndarray, integrals: tuple[int, ...] = (), dt: float = 0.0) -> OpenSystem:
    """A loop without wires whose closed A is the one given."""
    A = np.atleast_3d(np.asarray(A, float).T).T if np.ndim(A) == 2 else np.asarray(A, float)
    m, n = len(A), A.shape[-1]
    return OpenSystem(
        times=np.arange(m, dtype=float),
        A=A,
        B=np.zeros((m, n, 0)),
        C=np.zeros((m, 0, n)),
        D=np.zeros((m, 0, 0)),
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=(),
        output_names=(),
        wires={},
        wire_names=(),
        wire_delay=np.zeros(0),
        points=(),
        integrals=integrals,
        dt=dt,
    )


def scaled(system: OpenSystem, factor: float) -> OpenSystem:
    """The same loop with its wire multiplied by ``factor``."""
    C, D = system.C.copy(), system.D.copy()
    C[:, system.ny :] *= factor
    D[:, system.ny :] *= factor
    return replace(system, C=C, D=D)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240601)
