"""From a tool path to a joint trajectory: equation 9.14, for any arm, redundant ones too.

At each time the pose is solved by Newton's method on log6(X^-1 X_d), from the joints of the time before. The velocity is the least-norm
one, v = J^# V_d, and the acceleration is its derivative along the path, so that J v = V_d and J a + J' v = V_d'. On a redundant
arm the joints follow q' = J^# V_d from ``q_start``, which fixes their self-motion.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfc_analysis.errors import BadArgument, MfcWarning, NearSingular, NotConverged
from mfc_analysis.maths import checks
from mfc_analysis.maths.se3 import adjoint, inverse, log6, pose_matrix
from mfc_analysis.trajectories.joint import JointPoint, JointReference, warn_outside_limits
from mfc_analysis.trajectories.piecewise import Piecewise
from mfc_analysis.trajectories.tool import ToolPoint, ToolReference

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot

Array = NDArray[np.float64]

TOLERANCE = 1e-13  #: of the pose error [m and rad] at which Newton stops
ROUNDING = 1e-10  #: pose error below which a step that doesn't help means that rounding is reached
ITERATIONS = 100  #: of Newton at one time
STEP = 0.05  #: largest joint step [rad or m] between two nodes of a followed path
WARN_CONDITION, REFUSE_CONDITION = 1e4, 1e6


@dataclass(frozen=True, eq=False)
class JointPath(JointReference):
    """A joint trajectory known at nodes, quintic between them with their positions, velocities and accelerations (Hermite).

    Held at rest outside its times; where it closes on itself after a period, it repeats.
    """

    times: Array  #: (m,) [s]
    q: Array  #: (m, n) [rad or m]
    v: Array  #: (m, n)
    a: Array  #: (m, n)
    cycle: float | None = None  #: [s] period, where the path is closed
    _path: Piecewise = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_path", Piecewise.hermite(self.times, self.q, self.v, self.a))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def period(self) -> float | None:
        """[s], None where the path is not closed."""
        return self.cycle

    @property
    def duration(self) -> float | None:
        """The last time [s]; None for a closed path."""
        return float(self.times[-1]) if self.cycle is None else None

    @property
    def is_hold(self) -> bool:
        """Whether no joint moves."""
        return not (self.v.any() or np.ptp(self.q, axis=0).any())

    def _at(self, t: Array) -> JointPoint:
        if self.cycle is not None:
            inside = (t >= self.times[0]) & (t <= self.times[-1])
            t = np.where(inside, t, self.times[0] + np.mod(t - self.times[0], self.cycle))
        return JointPoint(*self._path.at(t))


class _Node(NamedTuple):
    q: Array
    v: Array
    a: Array


def from_tool_path(robot: Robot, tool_ref: ToolReference, q_start: ArrayLike, times: ArrayLike) -> JointPath:
    """The joint trajectory (q, v, a) that carries the tool along ``tool_ref`` (equation 9.14); exact at ``times`` and at nodes added between them.

    Args:
        robot: any arm; with fewer than six joints the path must be one that it can follow.
        q_start: (n,) [rad or m] near the solution at ``times[0]``. times: (m,) [s], m >= 2, increasing.

    Raises ``NotConverged`` (out of reach, or a jump), ``NearSingular`` (condition number of J above 1e6), both with the time, ``BadArgument``.
    Warns (``MfcWarning``) of a condition number above 1e4 and of joint limits.
    """
    if getattr(tool_ref, "space", None) != "tool":
        raise BadArgument("tool_ref", tool_ref, "a tool-space reference (ToolHold, ToolLine, ToolSinusoid, ToolCircle)")
    t = checks.times(times)
    if t.size < 2:
        raise BadArgument("times", times, "at least two times [s]")
    follower = _Follower(robot, tool_ref)
    q = follower.project(checks.array("q_start", q_start, (robot.n,)), float(t[0]))
    node = follower.node(q, float(t[0]))
    kept, nodes = [float(t[0])], [node]
    for t0, t1 in pairwise(t):
        for now in np.linspace(t0, t1, follower.substeps(node, float(t0), float(t1)) + 1)[1:]:
            q = follower.project(follower.advance(node.q, kept[-1], float(now)), float(now), near=node.q)
            node = follower.node(q, float(now))
            kept.append(float(now))
            nodes.append(node)
    follower.report()
    q_all, v_all, a_all = (np.array(x) for x in zip(*nodes, strict=True))
    path = JointPath(np.array(kept), q_all, v_all, a_all, _closed(tool_ref, t, nodes))
    warn_outside_limits(robot, path, path.times)
    return path


def follow(robot: Robot, tool_ref: ToolReference, q_start: ArrayLike, times: Array, damping: float = 0.0) -> tuple[Array, Array, Array]:
    """Joint positions, velocities, accelerations (m, n) of the solution followed from ``q_start`` at t = 0 (or at the first time, if that is before).

    ``damping`` [-] is that of the Jacobian's inverse where the path comes close to a singularity; 0 refuses there.
    Raises ``NotConverged`` and ``NearSingular``, with the time.
    """
    follower = _Follower(robot, tool_ref, damping=damping)
    now = min(0.0, float(times[0]))
    node = follower.node(follower.project(checks.array("q_start", q_start, (robot.n,)), now), now)
    nodes = []
    for t in times:
        if t > now and not tool_ref.is_hold:
            for later in np.linspace(now, t, follower.substeps(node, now, float(t)) + 1)[1:]:
                node = follower.node(follower.project(follower.advance(node.q, now, float(later)), float(later), near=node.q), float(later))
                now = float(later)
        nodes.append(node)
    follower.report()
    q, v, a = (np.array(x) for x in zip(*nodes, strict=True))
    return q, v, a


def solve_pose(robot: Robot, X: Any, q_start: ArrayLike) -> Array:
    """(n,) joints near ``q_start`` that put the tool at the pose X (4x4 or a Pinocchio SE3); ``NotConverged`` where there are none."""
    target = pose_matrix("X", X)
    q = checks.array("q_start", q_start, (robot.n,))
    found, error = _newton(robot, target, q)
    if found is None:
        raise NotConverged(_out_of_reach(robot, error, "near q_start"))
    return found


@dataclass(eq=False)
class _Follower:
    """Follows one tool path with one robot, and remembers the worst conditioned place."""

    robot: Robot
    ref: ToolReference
    worst: tuple[float, float, float] = (0.0, 0.0, 0.0)  # condition number, smallest singular value, time
    damping: float = 0.0

    def project(self, q: Array, t: float, near: Array | None = None) -> Array:
        """The joints at which the tool is where the path is, from a guess close by."""
        found, error = _newton(self.robot, self.ref(t).X, q)
        if found is None:
            raise NotConverged(_out_of_reach(self.robot, error, f"at t = {t:.4g} s"))
        if near is not None and np.abs(found - near).max() > 20 * STEP:
            raise NotConverged(
                f"the joint solution jumps by {np.abs(found - near).max():.3g} rad at t = {t:.4g} s: the tool path passes through a singularity"
            )
        return found

    def node(self, q: Array, t: float) -> _Node:
        """Velocity and acceleration that go with joints on the path."""
        point = self.ref(t)
        J = self.robot.jacobian(q)
        pinv = self._pseudo_inverse(J, t)
        v = pinv @ point.V
        J_rate = self.robot.jacobian_rate(q, v)
        a = pinv @ (point.dV - J_rate @ v)
        if self.robot.n > 6:  # the part of (J^# V)' that J doesn't see
            null = J_rate.T @ (pinv.T @ v)
            a = a + null - pinv @ (J @ null)
        self._check_followed(J @ v - point.V, J @ a + J_rate @ v - point.dV, point, t)
        return _Node(q, v, a)

    def advance(self, q: Array, t0: float, t1: float) -> Array:
        """One Runge-Kutta step of q' = J^# V."""
        h = t1 - t0
        k1 = self._rate(q, t0)
        k2 = self._rate(q + 0.5 * h * k1, t0 + 0.5 * h)
        k3 = self._rate(q + 0.5 * h * k2, t0 + 0.5 * h)
        return q + h / 6 * (k1 + 2 * k2 + 2 * k3 + self._rate(q + h * k3, t1))

    def substeps(self, node: _Node, t0: float, t1: float) -> int:
        """How many nodes an interval needs for joint steps below ``STEP``, and for the path's own time scale."""
        pinv = self._pseudo_inverse(self.robot.jacobian(node.q), t0)
        fastest = max(float(np.abs(pinv @ self.ref(t).V).max()) for t in np.linspace(t0, t1, 5))
        whole = self.ref.period or self.ref.duration
        slices = 0.0 if whole is None else 60 * (t1 - t0) / whole
        if not np.isfinite(fastest) or fastest * (t1 - t0) / STEP > 1e5:
            raise NotConverged(f"the tool path needs joint speeds of {fastest:.3g} rad/s between t = {t0:.4g} and {t1:.4g} s")
        return max(1, int(np.ceil(1.5 * fastest * (t1 - t0) / STEP)), int(np.ceil(slices - 1e-9)))

    def report(self) -> None:
        """Warn where the Jacobian came close to singular."""
        condition, smallest, t = self.worst
        if condition > WARN_CONDITION:
            text = f"the Jacobian of frame {self.robot.tool!r} is close to singular at t = {t:.4g} s"
            warnings.warn(f"{text}: smallest singular value {smallest:.3g}, condition number {condition:.3g}", MfcWarning, stacklevel=3)

    def _rate(self, q: Array, t: float) -> Array:
        point = self.ref(t)
        V = adjoint(inverse(self.robot.pose(q)) @ point.X) @ point.V  # the path's twist as the tool sees it from where it is
        return self._pseudo_inverse(self.robot.jacobian(q), t) @ V

    def _pseudo_inverse(self, J: Array, t: float) -> Array:
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        condition = float(s[0] / max(s[-1], 1e-300))
        if condition > REFUSE_CONDITION and not self.damping:
            raise NearSingular(self.robot.tool, float(s[-1]), condition, t)
        self.worst = max(self.worst, (condition, float(s[-1]), t))
        out: Array = (Vt.T * (s / (s * s + self.damping**2))) @ U.T
        return out

    def _check_followed(self, dV: Array, ddV: Array, point: ToolPoint, t: float) -> None:
        if self.robot.n < 6:
            scale = 1.0 + np.abs(point.V).max() + np.abs(point.dV).max()
            if max(np.abs(dV).max(), np.abs(ddV).max()) > 1e-6 * scale:
                raise NotConverged(f"{self.robot.n} joints cannot follow the tool path at t = {t:.4g} s: its twist has a part that no joint gives")


def _newton(robot: Robot, target: Array, q: Array) -> tuple[Array | None, Array]:
    """Joints at the target (None: not found) and the pose error left, by damped least squares that become Newton's steps near the solution."""
    q, mu = np.array(q), 0.0
    error = log6(inverse(robot.pose(q)) @ target)
    for _ in range(ITERATIONS):
        size = float(np.linalg.norm(error))
        if size < TOLERANCE:
            return q, error
        U, s, Vt = np.linalg.svd(robot.jacobian(q), full_matrices=False)
        step = Vt.T @ (s / (s * s + mu + (1e-7 * s[0]) ** 2) * (U.T @ error))
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-300))
        after = log6(inverse(robot.pose(q + step)) @ target)
        if np.linalg.norm(after) < size:
            q, error, mu = q + step, after, (0.0 if mu < 1e-9 else 0.1 * mu)
        elif size < ROUNDING:
            return q, error
        else:
            mu = max(4.0 * mu, 1e-6)
    return None, error


def _out_of_reach(robot: Robot, error: Array, where: str) -> str:
    far, turned = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    return (
        f"no joints of {robot.name!r} found for the tool pose {where}: {far:.3g} m and {turned:.3g} rad are left after {ITERATIONS} steps. "
        "The pose is out of reach, or q_start is too far from it"
    )


def _closed(ref: ToolReference, t: Array, nodes: list[_Node]) -> float | None:
    """The path's period, where these times span a whole number of it and the joints come back to where they began."""
    if ref.period is None:
        return None
    span = float(t[-1] - t[0])
    turns = round(span / ref.period)
    if turns < 1 or abs(span - turns * ref.period) > 1e-9 * span:
        return None
    back = all(np.abs(x - y).max() < 1e-7 * (1 + np.abs(x).max()) for x, y in zip(nodes[0], nodes[-1], strict=True))
    return span if back else None
