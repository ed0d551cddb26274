"""Settling and overshoot of the steps of a loop along a path: of the reference, or of the loop opened at an analysis point (``loop_step``).

A step of the reference goes from every reference channel to its coordinate. Joint laws: q_d -> q of each joint. Tool laws: a body twist r
of X_d -> the tool motion r - X_e of each axis (9.24: the axes of motion). Force laws: F_d -> F_tip of each axis that a surface resists.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mfc_analysis.analysis.loop_step import SettlingStep, loop_step
from mfc_analysis.analysis.step_metrics import pair_metrics
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.laws.law import WRENCH
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.linearization.linearization import Linearization


RESISTED = 0.05  #: fraction of the stiffest axis above which an axis counts as resisted


@dataclass(frozen=True, eq=False)
class StepMetrics(Shown):
    """Metrics of linear unit steps, m times and k channels. NaN: the coordinate does not reach a steady value."""

    times: Array  #: (m,) [s]
    channels: tuple[str, ...]  #: (k,)
    settling: Array  #: (m, k) [s] to 2 %; inf where a slow root integrates the step
    overshoot: Array  #: (m, k) fraction of the final value

    def __str__(self) -> str:
        rows = [f"steps of {len(self.channels)} channels at {len(self.times)} times"]
        for k, name in enumerate(self.channels):
            settling, over = (float(np.max(x[:, k], initial=-np.inf, where=~np.isnan(x[:, k]))) for x in (self.settling, self.overshoot))
            rows.append(f"  {name}: longest settling {settling:.4g} s, largest overshoot {100 * over:.4g} %")
        return "\n".join(rows)

    __repr__ = __str__


def step_metrics(lin: Linearization, step: SettlingStep = "reference", at: str | None = None) -> StepMetrics:
    """Settling [s] and overshoot of all channels at all times of a linearised loop, from its exact step responses.

    ``step``: "reference", or "loop": of T_i = L_i/(1 + L_i) at the analysis point ``at``, one loop at a time, dead time included; at
    "force" of the axes that a surface resists.
    Raises ``UnknownPoint`` and ``Unsupported`` as ``loop_step``.
    """
    if step == "loop":
        assert at is not None
        system, late = loop_step(lin.opened_for(at), at)
        resisted = {WRENCH[i] for i in _resisted(lin)} if at == "force" else set(system.output_names)
        numbers = [(i, i) for i, name in enumerate(system.output_names) if name in resisted]
        channels, late = tuple(system.output_names[i] for i, _ in numbers), late[[i for i, _ in numbers]]
    else:
        system, pairs = followed(lin)
        numbers = [(system.input_names.index(source), system.output_names.index(target)) for source, target, _ in pairs]
        channels, late = tuple(name for *_, name in pairs), np.zeros(len(pairs))
    into, out = np.array(numbers, int).reshape(-1, 2).T
    found = pair_metrics(system, into, out)
    settling = np.where(found["steady_state"] == 0.0, np.nan, found["settling"] + late)
    return StepMetrics(lin.times, channels, settling, found["overshoot"])


def followed(lin: Linearization) -> tuple[OpenSystem, list[tuple[str, str, str]]]:
    """The system with one coordinate per reference channel, and (input, output, name) of each."""
    system, law = lin.opened, lin.equations.law
    if not law.follows_motion:
        return system, _forces(lin, tuple(range(6)))
    if law.space == "joint":
        return system, [(f"q_d_{j}", f"q_{j}", j) for j in lin.equations.robot.joint_names]
    directions = law.error_channels(lin.equations.robot.joint_names)
    system = _with_followed_pose(system, directions)
    rows = law.force_directions
    if rows is None:
        return system, [(f"X_d_{c}", f"X_{c}", f"X_{c}") for c in directions]
    S = np.eye(6) if law.selection is None else law.selection.rows
    pairs = [(f"X_d_{c}", f"X_{c}", f"X_{c}") for c, held in zip(directions, _held(rows, S), strict=True) if held < 0.5]
    return system, pairs + _forces(lin, tuple(np.flatnonzero(_held(rows, np.eye(6)) >= 0.5).tolist()))


def _held(rows: Array, directions: Array) -> Array:
    """(k,) fraction of each direction (k, 6) that lies in the span of the constraint rows, 0 to 1."""
    basis = np.linalg.svd(rows, full_matrices=False)[2]
    return np.asarray(((directions @ basis.T) ** 2).sum(axis=1))


def _forces(lin: Linearization, axes: tuple[int, ...]) -> list[tuple[str, str, str]]:
    """F_d -> F_tip of the tool axes that a surface resists."""
    resisted = _resisted(lin) if "F_d_fx" in lin.input_names else ()
    return [(f"F_d_{WRENCH[i]}", f"F_tip_{WRENCH[i]}", f"F_{WRENCH[i]}") for i in axes if i in resisted]


def _resisted(lin: Linearization) -> tuple[int, ...]:
    """The tool axes that a surface resists, by its stiffness and damping in tool axes; forces and moments separately."""
    equations = lin.equations
    if not equations.surfaces:
        return ()
    q = np.ascontiguousarray(lin.point.x[:, equations.parts["q"].where])
    X = equations.robot.pose(q)
    size = np.zeros(6)
    for surface in equations.surfaces:
        assert surface.pose is not None
        for R in surface.pose[:3, :3].T @ X[:, :3, :3]:
            turn = np.kron(np.eye(2), R)
            size = np.maximum(size, np.diag(turn.T @ (surface.K + surface.B) @ turn))
    largest = np.repeat([size[:3].max(), size[3:].max()], 3)
    return tuple(i for i in range(6) if size[i] > RESISTED * largest[i] and largest[i] > 0)


def _with_followed_pose(system: OpenSystem, directions: tuple[str, ...]) -> OpenSystem:
    """X_e rows replaced by r - X_e: the motion of the tool with its reference."""
    rows = [system.output_names.index(f"X_e_{c}") for c in directions]
    C, D = system.C.copy(), system.D.copy()
    C[:, rows] *= -1.0
    D[:, rows] *= -1.0
    for row, c in zip(rows, directions, strict=True):
        D[:, row, system.input_names.index(f"X_d_{c}")] += 1.0
    names = list(system.output_names)
    for row, c in zip(rows, directions, strict=True):
        names[row] = f"X_{c}"
    return replace(system, C=C, D=D, output_names=tuple(names))
