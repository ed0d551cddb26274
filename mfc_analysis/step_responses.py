"""Settling and overshoot of every reference channel to its own coordinate, along a path.

Joint laws: q_d -> q of each joint. Tool laws: a body twist that moves X_d -> how far the tool has followed, r - X_e, of each
axis (of 9.24: the axes of motion). Force laws: F_d -> F_tip of each axis that a surface resists.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.analysis.steps import step
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.laws.law import TWIST, WRENCH

if TYPE_CHECKING:
    from mfc_analysis.linearization import Linearization

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StepFigures:
    """Figures of linear unit steps, m times and k channels. NaN: the channel does not lead to a steady value of its own."""

    times: Array  #: (m,) [s]
    channels: tuple[str, ...]  #: (k,)
    settling: Array  #: (m, k) [s] to 2 %; inf where a root at zero integrates the step
    overshoot: Array  #: (m, k) fraction of the final value


def step_figures(lin: Linearization) -> StepFigures:
    """Settling and overshoot of all channels at all times of a linearised loop, from its exact step responses."""
    system, pairs = followed(lin)
    m, k = len(lin.times), len(pairs)
    settling, overshoot = np.full((m, k), np.nan), np.full((m, k), np.nan)
    for j, (source, target, _) in enumerate(pairs):
        for i in range(m):
            found = step(system, i, source, target)
            settling[i, j], overshoot[i, j] = found.settling, found.overshoot
            if found.steady_state == 0.0:
                settling[i, j] = np.nan
    return StepFigures(lin.times, tuple(name for *_, name in pairs), settling, overshoot)


def followed(lin: Linearization) -> tuple[OpenSystem, list[tuple[str, str, str]]]:
    """The system with a coordinate for each reference channel, and (input, output, name) of each."""
    system, law = lin.opened, lin.equations.law
    if law.equation in ("9.21", "9.22", "9.23"):
        return system, _forces(system)
    if law.space == "joint":
        return system, [(f"q_d_{j}", f"q_{j}", j) for j in lin.equations.robot.joint_names]
    system = _with_followed_pose(system)
    rows = getattr(law, "rows", None)
    moving = tuple(range(6)) if rows is None else tuple(i for i in range(6) if _held(np.asarray(rows))[i] < 0.5)
    pairs = [(f"X_d_{TWIST[i]}", f"X_{TWIST[i]}", f"X_{TWIST[i]}") for i in moving]
    return system, pairs if rows is None else pairs + _forces(system)


def _held(rows: Array) -> Array:
    """(6,) how much of each axis lies in the span of the constraint rows, 0 to 1."""
    basis = np.linalg.svd(rows, full_matrices=False)[2]
    return np.asarray((basis**2).sum(axis=0))


def _forces(system: OpenSystem) -> list[tuple[str, str, str]]:
    """F_d -> F_tip of the axes that a surface resists: where the tool's motion makes a force."""
    if "F_tip_fx" not in system.output_names:
        return []
    first = system.output_names.index("F_tip_fx")
    C = np.abs(close_wires(system)[2][:, first : first + 6]).max(axis=(0, 2))
    return [(f"F_d_{c}", f"F_tip_{c}", f"F_{c}") for c, size in zip(WRENCH, C, strict=True) if size > 1e-9 * C.max(initial=0.0)]


def _with_followed_pose(system: OpenSystem) -> OpenSystem:
    """X_e rows replaced by r - X_e: how far the tool has moved with its reference."""
    rows = [system.output_names.index(f"X_e_{c}") for c in TWIST]
    C, D = system.C.copy(), system.D.copy()
    C[:, rows] *= -1.0
    D[:, rows] *= -1.0
    for row, c in zip(rows, TWIST, strict=True):
        D[:, row, system.input_names.index(f"X_d_{c}")] += 1.0
    names = list(system.output_names)
    for row, c in zip(rows, TWIST, strict=True):
        names[row] = f"X_{c}"
    return replace(system, C=C, D=D, output_names=tuple(names))
