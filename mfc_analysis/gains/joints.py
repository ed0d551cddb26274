"""Independent joints (law 9.8) on the arm: the inertia of each joint along a motion, and the loop with all joints closed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mfc_analysis.analysis.margins import Margins, margins
from mfc_analysis.analysis.participation import rightmost
from mfc_analysis.analysis.system import OpenSystem, close_wires
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.maths.dual import Dual
from mfc_analysis.maths.roots import root_between
from mfc_analysis.robots.primitives import Primitives

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot

SAMPLES, STRIDE = 401, 10  #: times along a trajectory for the inertia; every tenth of them for the margins


class Motion(NamedTuple):
    """Where joint gains are designed: m poses, or m times along a trajectory."""

    times: Array  #: (m,) [s]; of poses their indices
    q: Array  #: (m, n) [rad or m]
    v: Array  #: (m, n)
    a: Array  #: (m, n)
    moving: bool  #: along a trajectory
    largest: Array  #: (n,) M_jj [kg m^2 or kg]
    smallest: Array  #: (n,)
    where: str  #: of the largest, in words

    def place(self, index: int) -> str:
        """The place of one of the m in words; empty if there is only one."""
        if len(self.times) == 1:
            return ""
        return f"t = {self.times[index]:.4g} s" if self.moving else f"pose {index}"


@dataclass(frozen=True, eq=False)
class CoupledLoop:
    """The loop of law 9.8 on the arm, all n joints closed, at m poses or times: M(q) in full, gravity and friction included.

    Margins are those of one joint at a time. Dead time acts in all joints at once, and joints that are coupled through the mass matrix
    tolerate less of it together than each of them alone: see ``common_delay``.
    """

    system: OpenSystem  #: the loop cut at the torques; ``times`` [s], or the indices of the poses
    places: tuple[str, ...]  #: (m,) time or pose in words; empty strings for one pose
    hardware: str  #: lag and dead time in words

    @cached_property
    def margins(self) -> Margins:
        """Margins (m, n) of each joint at its torque, the others closed, dead time included."""
        return margins(self.system, "torque")

    @property
    def stable(self) -> bool:
        """True where the arm is stable at all poses or times."""
        return bool(self.margins.stable.all())

    @cached_property
    def common_delay(self) -> Array:
        """(m,) [s] smallest further dead time in all torques at once that makes the arm unstable; NaN where it is unstable as it is."""
        stable = self.margins.stable
        limits = [_common_delay(self.system.at(slice(i, i + 1))) if stable[i] else np.nan for i in range(stable.size)]
        return np.asarray(np.array(limits) - self.system.wire_delay[0], float)

    def __str__(self) -> str:
        found = self.margins
        if not self.stable:
            lost, root = np.flatnonzero(~found.stable), rightmost(self.system)
            where = int(np.argmin(np.abs(self.system.times - root.time)))
            first = f", first at {self.places[lost[0]]}" if self.places[lost[0]] else ""
            count = f" at {lost.size} of {found.stable.size} places{first}" if found.stable.size > 1 else ""
            return f"UNSTABLE with the loops of all joints closed{count} ({self.hardware})\n          {root.said(self.places[where])}"

        def said(values: Array, unit: str, worst: Callable[[Array], Any] = np.argmin) -> str:
            i, *joint = np.unravel_index(int(worst(values)), values.shape)
            names = [found.channels[j] for j in joint] + [self.places[i]] * bool(self.places[i])
            at = f" ({', '.join(names)})" if names else ""
            return f"{values[(i, *joint)]:.3g}{unit}{at}" if np.isfinite(values[(i, *joint)]) else "unlimited"

        return (
            f"stable with the loops of all joints closed ({self.hardware})\n"
            f"          further dead time in all joints at once: up to {said(1e3 * self.common_delay, ' ms')}\n"
            f"          one joint at a time: phase {said(found.phase_deg, ' deg')}, delay {said(1e3 * found.delay, ' ms')}, "
            f"gain up {said(found.gain_increase_db, ' dB')},\n"
            f"          gain down {said(found.gain_reduction_db, ' dB')}, Ms {said(found.sensitivity_peak, '', np.argmax)}"
        )

    __repr__ = __str__


def motion(robot: Robot, q: Any) -> Motion:
    """The poses q (n,) or (m, n), or a joint reference, as a ``Motion``. Raises BadArgument."""
    from mfc_analysis.robots.robot import Robot

    checks.instance("robot", robot, Robot, "a Robot, such as mfc.robots.ur5()")

    def diagonal(poses: Array) -> Array:
        return np.array(np.diagonal(robot.mass(poses), axis1=-2, axis2=-1))

    if callable(q):
        if getattr(q, "space", "joint") != "joint":
            raise BadArgument("q", q, "a joint reference; follow a tool reference with trajectories.from_tool_path first")
        end = getattr(q, "period", None) or getattr(q, "duration", None)
        end = 0.0 if end is None and getattr(q, "is_hold", False) else end
        if end is None:
            raise BadArgument("q", q, "a pose, or a joint reference with a period or a duration")
        asked: Callable[[Any], Any] = q
        grid = np.linspace(0.0, float(end), SAMPLES) if end else np.zeros(1)
        at, v, a = (np.array(x) for x in asked(grid)[:3])
        along = diagonal(at)
        largest = _refined(lambda t: diagonal(np.asarray(asked(t)[0])), grid, along)
        return Motion(grid, at, v, a, True, largest, along.min(axis=0), "at its largest along the trajectory")
    takes = f"a pose of shape ({robot.n},), poses of shape (m, {robot.n}), or a joint reference"
    poses = checks.array("q", q, takes=takes)
    if poses.ndim not in (1, 2) or poses.shape[-1] != robot.n or poses.size == 0:
        raise BadArgument("q", f"shape {poses.shape}", takes)
    where = "at this pose" if poses.ndim == 1 else "at its largest over the poses"
    poses = np.atleast_2d(poses)
    along, still = diagonal(poses), np.zeros_like(poses)
    return Motion(np.arange(len(poses), dtype=float), poses, still, still, False, along.max(axis=0), along.min(axis=0), where)


def coupled_loop(robot: Robot, gains: Mapping[str, Array], where: Motion, torque_lag: float = 0.0, delay: float = 0.0) -> CoupledLoop:
    r"""The loop of 9.8 on the arm along a motion, linearised exactly, cut at the joint torques.

    .. math:: M \delta\ddot q + D \delta\dot q + G \delta q = \tau, \quad \tau = -K_p \delta q - K_d \delta\dot q + K_i z, \quad z' = -\delta q

    G and D are the derivatives of the inverse dynamics and the friction at (q, v, a). torque_lag and delay [s] act on the torque. Raises BadArgument.
    """
    lag, delay = checks.number("torque_lag", torque_lag, low=0.0), checks.number("delay", delay, low=0.0)
    some = slice(None, None, STRIDE) if where.moving else slice(None)
    q, v, a = where.q[some], where.v[some], where.a[some]
    m, n = q.shape
    nx = (4 if lag else 3) * n
    at_q, at_v, at_z = (slice(i * n, (i + 1) * n) for i in range(3))
    arm, eye = Primitives(robot), np.eye(n)
    seeds = np.eye(2 * n)
    along_v = Dual(v, np.broadcast_to(seeds[n:], (m, n, 2 * n)))
    tau = arm.rnea(Dual(q, np.broadcast_to(seeds[:n], (m, n, 2 * n))), along_v, a) + arm.friction(along_v)
    assert isinstance(tau, Dual)
    inverse = np.linalg.inv(robot.mass(q))
    A, B, C = np.zeros((m, nx, nx)), np.zeros((m, nx, n)), np.zeros((m, n, nx))
    A[:, at_q, at_v], A[:, at_z, at_q] = eye, -eye
    A[:, at_v, : 2 * n] = -inverse @ tau.tangent
    if lag:
        A[:, at_v, 3 * n :], A[:, 3 * n :, 3 * n :], B[:, 3 * n :] = inverse, -eye / lag, eye / lag
    else:
        B[:, at_v] = inverse
    for columns, gain in ((at_q, -gains["kp"]), (at_v, -gains["kd"]), (at_z, gains["ki"])):
        C[:, :, columns] = np.diag(gain)
    joints = robot.joint_names
    system = OpenSystem(
        times=where.times[some], A=A, B=B, C=C, D=np.zeros((m, n, n)),
        state_names=tuple(f"{part}_{j}" for part in ("q", "v", "z", "tau")[: nx // n] for j in joints), input_names=(), output_names=(),
        wires={"torque": slice(0, n)}, wire_names=joints, wire_delay=np.full(n, delay), points=("torque",),
        integrals=tuple(range(2 * n, 3 * n)), plant_states=(*range(2 * n), *range(3 * n, nx)), law="JointPID",
    )  # fmt: skip
    parts = [f"{word} {1e3 * value:.4g} ms" for word, value in (("lag", lag), ("dead time", delay)) if value]
    every = np.arange(len(where.times))[some]
    return CoupledLoop(system, tuple(where.place(int(i)) for i in every), ", ".join(parts) or "no lag, no dead time")


def _common_delay(system: OpenSystem) -> float:
    """Smallest dead time [s] in all wires of one point, given dead time included, at which a root is on the imaginary axis.

    A root j w of det(1 - G(s) e^(-s T)) needs an eigenvalue of G(j w) of modulus 1, and w T is its angle.
    """
    A, B, C = system.A[0], system.B[0], system.C[0]
    poles = np.abs(np.linalg.eigvals(close_wires(system)[0][0]))
    w = np.geomspace(1e-3 * poles.min(), 1e2 * poles.max(), 600)

    def eigenvalues(w: Array) -> Complex:
        G = C @ np.linalg.solve(1j * w[:, None, None] * np.eye(len(A)) - A, B[None].astype(complex))
        found = np.linalg.eigvals(G)
        return np.asarray(np.take_along_axis(found, np.argsort(np.abs(found), axis=1), axis=1))

    def excess(k: int, w: float) -> float:
        return float(np.log(np.abs(eigenvalues(np.array([w]))[0, k])))

    log = np.log(np.abs(eigenvalues(w)))
    least = np.inf
    for i, k in zip(*np.nonzero(np.diff(np.sign(log), axis=0)), strict=True):
        at = root_between(partial(excess, k), float(w[i]), float(w[i + 1]))
        turn = float(np.angle(eigenvalues(np.array([at]))[0, k])) % (2 * np.pi)
        whole = max(np.ceil((system.wire_delay[0] * at - turn) / (2 * np.pi)), 0.0)  # the loop is stable with its own dead time
        least = min(least, (turn + 2 * np.pi * float(whole)) / at)
    return least


def _refined(inertia: Callable[[float], Array], grid: Array, along: Array) -> Array:
    """The maxima along the trajectory, searched between the neighbours of the largest samples."""
    from scipy.optimize import minimize_scalar

    worst = along.max(axis=0)
    for j, k in enumerate(along.argmax(axis=0)):
        left, right = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
        if right > left and along[:, j].max() > along[:, j].min():
            near: Any = minimize_scalar(partial(_minus, inertia, j), bounds=(left, right), method="bounded", options={"xatol": 1e-9 * (right - left)})
            worst[j] = max(worst[j], -near.fun)
    return np.asarray(worst)


def _minus(inertia: Callable[[float], Array], j: int, t: float) -> float:
    return -float(inertia(t)[j])
