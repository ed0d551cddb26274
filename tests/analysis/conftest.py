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


def random_loops(rng: np.random.Generator, m: int, nx: int, n: int) -> OpenSystem:
    """m random loops of n wires with one input and one output beside: plants of both kinds, about half of them stable when closed."""
    A = rng.normal(size=(m, nx, nx)) - 1.2 * np.sqrt(nx) * np.eye(nx) * rng.uniform(0.3, 1.2, size=(m, 1, 1))
    A *= rng.uniform(0.3, 3, size=(m, nx, 1))
    B, C = rng.normal(size=(m, nx, 1 + n)), rng.normal(size=(m, 1 + n, nx)) * 1.5
    return OpenSystem(
        times=np.arange(m, dtype=float),
        A=A,
        B=B,
        C=C,
        D=np.zeros((m, 1 + n, 1 + n)),
        state_names=tuple(f"x{i}" for i in range(nx)),
        input_names=("d",),
        output_names=("y",),
        wires={"torque": slice(0, n)},
        wire_names=tuple(f"j{i}" for i in range(n)),
        wire_delay=np.zeros(n),
        points=("torque",),
    )


def scaled(system: OpenSystem, factor: float, wire: int = 0) -> OpenSystem:
    """The same loop with one wire multiplied by ``factor``."""
    C, D = system.C.copy(), system.D.copy()
    C[:, system.ny + wire] *= factor
    D[:, system.ny + wire] *= factor
    return replace(system, C=C, D=D)


def companion(*coefficients: float) -> np.ndarray:
    """s^n + c[0] s^(n-1) + ... + c[n-1]; states are derivatives of rising order."""
    n = len(coefficients)
    A = np.eye(n, k=1)
    A[-1] = -np.asarray(coefficients, float)[::-1]
    return A


def mixed(A: np.ndarray, rng: np.random.Generator, spread: float = 1.0) -> np.ndarray:
    """The same roots in other coordinates."""
    T = np.linalg.qr(rng.normal(size=A.shape))[0] * 10.0 ** rng.uniform(-spread, spread, len(A))
    return T @ A @ np.linalg.inv(T)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240601)
