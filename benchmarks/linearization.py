"""A and B of the closed loop, with operating points given and found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import control
import numpy as np

import mfc_analysis as mfc
from benchmarks import floors, rivals
from benchmarks.loops import TIMES, computed_torque, hybrid, task
from benchmarks.table import Found, Row, paired
from mfc_analysis.dynamics.jacobians import closed_matrix, closed_system

BARE = "bare loop of Pinocchio's derivative calls, and batched products"
FEW = TIMES[::20]
ROBOTS = ("example-robot-data",)


def joint_law(loop: mfc.ClosedLoop, *, inputs: bool) -> Found:
    """A (and B) of 9.10 at given operating points."""
    floor, x = floors.joint_loop(loop, TIMES, inputs=inputs), loop.linearize(TIMES).point.x
    found, (A, B) = closed_system(loop.equations, TIMES, x), floor()
    assert np.abs(found.A - A).max() <= 1e-9 * np.abs(A).max()
    assert not inputs or np.abs(found.B - B).max() <= 1e-9 * np.abs(B).max()
    call = closed_system if inputs else closed_matrix
    return paired(lambda: call(loop.equations, TIMES, x), floor, len(TIMES))


def tool_law(loop: mfc.ClosedLoop, mass_calls: int) -> Found:
    """A and B of a tool law at given operating points."""
    x = loop.linearize(TIMES).point.x
    return paired(lambda: closed_system(loop.equations, TIMES, x), floors.tool_calls(loop, TIMES, mass_calls), len(TIMES))


def points_too() -> Found:
    """With the operating points found first."""
    loop = computed_torque()
    return paired(lambda: loop.linearize(TIMES).B, floors.joint_loop(loop, TIMES, inputs=True), len(TIMES))


def poles_too(*, points: bool) -> Found:
    """A and its eigenvalues."""
    loop = computed_torque()
    floor, lin = floors.joint_loop(loop, TIMES, inputs=False), loop.linearize(TIMES)
    ours = (lambda: loop.linearize(TIMES).poles()) if points else (lambda: replace(lin).poles())
    return paired(ours, lambda: np.linalg.eigvals(floor()[0]), len(TIMES))


def python_control() -> Found:
    """``control.linearize`` of a nonlinear system with the same right-hand side, at a few of the points."""
    loop = computed_torque()
    e, x = loop.equations, loop.linearize(FEW).point.x
    system = control.nlsys(lambda t, x, u, params: e.rates(t, x), None, inputs=1, outputs=18, states=18)
    other = lambda: [system.linearize(x[i], [0.0], t=FEW[i]).A for i in range(len(FEW))]  # noqa: E731
    return paired(lambda: loop.linearize(TIMES).A, other, len(TIMES), len(FEW))


def against(rival: Callable[[mfc.ClosedLoop, np.ndarray], Callable[[], np.ndarray]], times: np.ndarray) -> Found:
    """A at given operating points by another library, which must agree."""
    loop = computed_torque()
    other, x = rival(loop, times), loop.linearize(TIMES).point.x
    A = closed_matrix(loop.equations, times, loop.linearize(times).point.x)
    assert np.abs(other() - A).max() <= 1e-7 * np.abs(A).max()
    return paired(lambda: closed_matrix(loop.equations, TIMES, x), other, len(TIMES), len(times))


ROWS = (
    Row("A of 9.10, UR5, 18 states", BARE, lambda: joint_law(computed_torque(), inputs=False), 1.5, aim=1.2),
    Row("A, B of 9.10, UR5, 18 states", BARE, lambda: joint_law(computed_torque(), inputs=True), 1.5, aim=1.2),
    Row("A, B of 9.10, Panda, 21 states", BARE, lambda: joint_law(computed_torque("panda"), inputs=True), 1.5, aim=1.2, needs=ROBOTS),
    Row("A, B of 9.10, xArm7, 21 states", BARE, lambda: joint_law(computed_torque("xarm7"), inputs=True), 1.5, aim=1.2, needs=ROBOTS),
    Row("operating points, A, B of 9.10", f"{BARE}, operating points given", points_too),
    Row("A, B of 9.16", "its bare Pinocchio calls", lambda: tool_law(task(), 0), 2.0),
    Row("A, B of 9.24, dynamic projection, contact", "its bare Pinocchio calls", lambda: tool_law(hybrid(), 2), 3.0),
    Row("A and poles of 9.10", "the bare loop + numpy eigvals", lambda: poles_too(points=False), 1.15),
    Row("operating points, A and poles of 9.10", "the bare loop + numpy eigvals", lambda: poles_too(points=True)),
    Row("operating points and A of 9.10", "control.linearize", python_control, 1 / 20),
    Row("A of 9.10", "CasADi, interpreted", lambda: against(rivals.casadi_matrix, TIMES), needs=("casadi",)),
    Row("A of 9.10", "CasADi, compiled C", lambda: against(rivals.casadi_compiled, TIMES), needs=("casadi",), slow=True),
    Row("A of 9.10", "Drake, AutoDiff of the inverse dynamics", lambda: against(rivals.drake_matrix, FEW), 1 / 20, needs=("drake",)),
)
