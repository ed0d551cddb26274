"""From a tool path to a joint trajectory: equation 9.14, for any arm, redundant arms included.

At each time the pose is solved by Newton's method on log6(X^-1 X_d), from the joints at the previous time. The velocity has least norm,
v = J^# V_d, and the acceleration is its derivative along the path, so that J v = V_d and J a + J' v = V_d'. On a redundant arm the
joints follow q' = J^# V_d from ``q_start``, which determines the self-motion. Of selected directions (``axes``) the same holds with S J.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument, MfcWarning, NearSingular, NotConverged
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.se3 import pose_matrix
from mfc_analysis.robots.singularity import REFUSE_CONDITION, WARN_CONDITION
from mfc_analysis.robots.tool_task import Selection
from mfc_analysis.trajectories.joint import JointPoint, JointReference, warn_outside_limits
from mfc_analysis.trajectories.piecewise import Piecewise
from mfc_analysis.trajectories.tip import SelectedTip, Tip
from mfc_analysis.trajectories.tool import ToolPoint, ToolReference

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


TOLERANCE = 1e-13  #: pose error [m and rad] at which Newton stops
ROUNDING = 1e-10  #: pose error below which a step without improvement means rounding error
MOST_FOLLOWED = 8  #: joint motions kept of one tool path
ITERATIONS = 100  #: Newton iterations at one time
STEP = 0.08  #: largest joint step [rad or m] between two nodes of a followed path
JUMP = 1.0  #: joint step [rad or m] above which the solution belongs to another branch
FINE, COARSE = 60, 24  #: nodes per period or duration of a path: for interpolation, and for the start of Newton


@dataclass(frozen=True, eq=False)
class JointPath(JointReference):
    """A joint trajectory by quintic Hermite interpolation between nodes with positions, velocities and accelerations.

    Held at rest outside its times; a closed path repeats with its period. Raises BadArgument for arrays that do not fit together.
    """

    times: Array  #: (m,) [s]
    q: Array  #: (m, n) [rad or m]
    v: Array  #: (m, n) [rad/s or m/s]
    a: Array  #: (m, n) [rad/s^2 or m/s^2]
    cycle: float | None = None  #: [s] period, where the path is closed
    _path: Piecewise = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = checks.times(self.times)
        motion = {name: checks.array(name, getattr(self, name), (times.size, None)) for name in ("q", "v", "a")}
        for name, values in motion.items():
            if times.size < 2 or values.shape != motion["q"].shape or values.shape[1] == 0:
                raise BadArgument(name, f"shape {values.shape}", "a row for each time, at least two, and in q, v and a the same joints")
        cycle = None if self.cycle is None else checks.number("cycle", self.cycle, low=0.0, strict=True)
        path = Piecewise.hermite(times, *motion.values())
        for name, content in {"times": times, **motion, "cycle": cycle, "_path": path}.items():
            object.__setattr__(self, name, content)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def period(self) -> float | None:
        """Period [s]; None where the path is not closed."""
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


def from_tool_path(robot: Robot, tool_ref: ToolReference, q_start: ArrayLike, times: ArrayLike, axes: Any = None) -> JointPath:
    """The joint trajectory (q, v, a) that moves the tool along ``tool_ref`` (equation 9.14), exact at ``times`` and at nodes added between them.

    Args:
        robot: any arm; with fewer than six joints the path must be feasible, or ``axes`` say which part of it is followed.
        tool_ref: a tool reference.
        q_start: (n,) [rad or m] near the solution at ``times[0]``. times: (m,) [s], m >= 2, increasing.
        axes: directions of the tool that follow the path, "xyz", "xyzrz", or (k, 6) orthonormal rows, as those of a tool law; None: all six.

    Raises ``NotConverged`` (out of reach, or a jump), ``NearSingular`` (condition number of J above 1e6), both with the time, ``BadArgument``.
    Warns (``MfcWarning``) of a condition number above 1e4 and of joint limits.
    """
    t = checks.times(times)
    if t.size < 2:
        raise BadArgument("times", times, "at least two times [s]")
    start = _start(robot, q_start)
    follower = _Follower(_tip(robot, None if axes is None else Selection(axes)), _tool(tool_ref))
    kept, nodes = follower.walk(start, t, FINE)
    follower.report()
    path = JointPath(kept, nodes.q, nodes.v, nodes.a, _closed(tool_ref, t, nodes))
    warn_outside_limits(robot, path, path.times)
    return path


def follow(
    robot: Robot, tool_ref: ToolReference, q_start: ArrayLike, times: ArrayLike, damping: float = 0.0, selection: Selection | None = None
) -> JointPoint:
    """Joint motion (q, v, a), (m, n) each, read-only, that moves the tool along ``tool_ref``, exact at these ``times``.

    That of the same path, arm (whatever its loads), start and times is computed once.

    Args:
        robot: any arm. tool_ref: a tool reference.
        q_start: (n,) [rad or m] near the solution at t = 0, or at ``times[0]`` if that is earlier; followed from there.
        times: (m,) [s], increasing.
        damping: [-] of the inverse of J, v = J^T (J J^T + damping^2)^-1 V; above 0 no error is raised near a singularity.
        selection: the directions that are followed; None: all six.

    Raises and warns as ``from_tool_path``, except for joint limits.
    """
    t, start = checks.times(times), _start(robot, q_start)
    follower = _Follower(_tip(robot, selection), _tool(tool_ref), checks.number("damping", damping, low=0.0))
    known = _FOLLOWED.setdefault(tool_ref, {}) if _is_fixed(tool_ref) else {}
    rows = b"" if selection is None else selection.rows.tobytes()
    key = b"|".join([_kinematics(robot), start.tobytes(), t.tobytes(), repr(damping).encode(), rows])
    if key not in known:
        if len(known) >= MOST_FOLLOWED:
            del known[next(iter(known))]
        found = follower.along(start, t)
        for array in found:
            array.flags.writeable = False
        known[key] = found, follower.worst
    found, follower.worst = known[key]
    follower.report()
    return found


_FOLLOWED: WeakKeyDictionary[ToolReference, dict[bytes, tuple[JointPoint, tuple[float, float, float]]]] = WeakKeyDictionary()


def _is_fixed(ref: ToolReference) -> bool:
    """Whether its motion cannot change: one of this library's frozen classes."""
    return type(ref).__module__ == ToolReference.__module__


def _kinematics(robot: Robot) -> bytes:
    """All that inverse kinematics depends on; payloads, armature and friction do not."""
    model = robot.model
    frame = model.frames[robot.frame_id]
    parts = [model.jointPlacements[i].homogeneous.tobytes() + model.joints[i].shortname().encode() for i in range(1, model.njoints)]
    axes = repr([str(model.joints[i]) for i in range(1, model.njoints)]).encode()
    tree = repr((list(model.parents), int(frame.parentJoint), robot.order.tolist(), robot.tool)).encode()
    return b"".join([*parts, axes, tree, frame.placement.homogeneous.tobytes()])


def solve_pose(robot: Robot, X: Any, q_start: ArrayLike) -> Array:
    """(n,) joint position of ``robot`` near ``q_start`` [rad or m] with the tool at the pose X (4x4 or a Pinocchio SE3). Raises ``NotConverged``."""
    start = _start(robot, q_start)
    q, error, found = _newton(Tip(robot), pose_matrix("X", X), start, False)
    if not found:
        raise NotConverged(_out_of_reach(robot, error, "near q_start"))
    return q


def displaced(robot: Robot, X: Array, error: Array, q_start: Array, selection: Selection) -> Array:
    """(n,) joint position near ``q_start`` with this error (k,) of the selected directions from the pose X (4, 4). Raises ``NotConverged``."""
    q, _, found = _newton(_tip(robot, selection), X, q_start, False, error)
    if not found:
        raise NotConverged(f"no joint position of {robot.name!r} found with the tool {np.abs(error).max():.3g} m or rad from its reference")
    return q


@dataclass(eq=False)
class _Follower:
    """Follows one tool path with one robot, and records the worst condition number."""

    tip: Tip
    ref: ToolReference
    damping: float = 0.0
    worst: tuple[float, float, float] = (0.0, 0.0, 0.0)  # condition number, smallest singular value, time

    def along(self, q_start: Array, t: Array) -> JointPoint:
        """Exact at times t (m,), followed from ``q_start`` at 0 or at t[0] if that is earlier."""
        first = np.array([min(0.0, float(t[0]))])
        if self.ref.is_hold:
            q = np.repeat(self.project(q_start[None], first), t.size, axis=0)
            return JointPoint(q, np.zeros_like(q), np.zeros_like(q))
        end = float(t[-1])
        known, nodes = self.walk(q_start, np.append(first, end) if end > first[0] else first, COARSE)
        guess = nodes.q if known.size == 1 else Piecewise.hermite(known, *nodes).at(t)[0]
        return self.node(self.project(guess, t), t)

    def walk(self, q_start: Array, times: Array, slices: int) -> tuple[Array, JointPoint]:
        """Nodes at ``times`` and between them, each from the previous one."""
        if self.ref.duration is not None:  # it is at rest before 0 and after its end
            ends = np.array([0.0, self.ref.duration])
            times = np.unique(np.append(times, ends[(ends > times[0]) & (ends < times[-1])]))
        t = times[:1]
        nodes = [self.node(self.project(q_start[None], t), t)]
        kept = [t]
        for t0, t1 in pairwise(times):
            inner = np.linspace(t0, t1, self._substeps(nodes[-1], t0, t1, slices) + 1)
            for now in inner[1:, None]:
                last = nodes[-1]
                q = self.project(self._advance(last, kept[-1], now), now)
                jump = float(np.abs(q - last.q).max())
                if jump > JUMP:
                    raise NotConverged(f"the joints jump by {jump:.3g} rad at t = {now[0]:.4g} s: the tool path passes a singularity")
                nodes.append(self.node(q, now))
                kept.append(now)
        return np.concatenate(kept), JointPoint(*(np.concatenate(x) for x in zip(*nodes, strict=True)))

    def project(self, q: Array, t: Array) -> Array:
        """The joint positions (m, n) with the tool on the path, from nearby guesses."""
        X = self.ref(t).X
        for _ in range(4):
            error = self.tip.error(q, X)
            far = np.abs(error).max(axis=-1)
            if (far < TOLERANCE).all():
                return q
            if (far > 0.1).any():
                break
            step = self._inverse(self.tip.jacobian(q, X), t, quiet=True) @ error[..., None]
            q = q + step[..., 0]
            if (far < 1e-8).all():  # Newton's next error is its square
                return q
        out = np.array(q)
        for k in range(t.size):
            out[k], left, found = _newton(self.tip, X[k], q[k], self.damping > 0)
            if not found:
                raise NotConverged(_out_of_reach(self.tip.robot, left, f"at t = {t[k]:.4g} s"))
        return out

    def node(self, q: Array, t: Array) -> JointPoint:
        """Velocity and acceleration at joint positions (m, n) on the path."""
        point = self.ref(t)
        tip = self.tip
        J = tip.jacobian(q, point.X)
        pinv = self._inverse(J, t)
        v = pinv @ tip.velocity(q, point)[..., None]
        wanted, J_rate = tip.acceleration(q, v[..., 0], point)
        a = pinv @ wanted[..., None]
        if tip.robot.n > tip.size and self.damping == 0:  # the null-space part of (J^# V)'
            null = np.swapaxes(J_rate, -1, -2) @ (np.swapaxes(pinv, -1, -2) @ v)
            a = a + null - pinv @ (J @ null)
        if tip.robot.n < tip.size and self.damping == 0:
            self._check_followed((J @ v)[..., 0] - point.V, (J @ a + J_rate @ v)[..., 0] - point.dV, point, t)
        return JointPoint(q, v[..., 0], a[..., 0])

    def report(self) -> None:
        """Warns where the Jacobian is close to singular."""
        condition, smallest, t = self.worst
        if condition > WARN_CONDITION:
            text = f"the Jacobian of frame {self.tip.robot.tool!r} is close to singular at t = {t:.4g} s"
            warnings.warn(f"{text}: smallest singular value {smallest:.3g}, condition number {condition:.3g}", MfcWarning, stacklevel=3)

    def _substeps(self, node: JointPoint, t0: float, t1: float, slices: int) -> int:
        """Number of nodes of an interval, for joint steps below ``STEP`` and for the time scale of the path."""
        if self.ref.is_hold or (self.ref.duration is not None and (t1 <= 0 or t0 >= self.ref.duration)):
            return 1
        pinv = self._inverse(self.tip.jacobian(node.q, self.ref(np.array([t0])).X), np.array([t0]), quiet=True)[0]
        fastest = float(np.abs(pinv @ self.tip.velocity(node.q, self.ref(np.linspace(t0, t1, 9))).T).max())
        whole = self.ref.period or self.ref.duration
        pieces = 1.0 if whole is None else slices * (t1 - t0) / whole
        speed = 1.5 * fastest * (t1 - t0) / STEP
        if not np.isfinite(speed) or max(speed, pieces) > 1e5:
            raise NotConverged(
                f"the tool path from t = {t0:.4g} to {t1:.4g} s is too long or too fast to follow: joint speeds of {fastest:.3g} rad/s"
            )
        return max(1, int(np.ceil(speed)), int(np.ceil(pieces - 1e-9)))

    def _advance(self, node: JointPoint, t0: Array, t1: Array) -> Array:
        """The next joint position: by Taylor, or along q' = J^# V (Runge-Kutta) on a redundant arm with self-motion."""
        h = t1 - t0
        if self.tip.robot.n <= self.tip.size or self.damping > 0:
            return node.q + h * node.v + 0.5 * h * h * node.a
        k2 = self._rate(node.q + 0.5 * h * node.v, t0 + 0.5 * h)
        k3 = self._rate(node.q + 0.5 * h * k2, t0 + 0.5 * h)
        return node.q + h / 6 * (node.v + 2 * k2 + 2 * k3 + self._rate(node.q + h * k3, t1))

    def _rate(self, q: Array, t: Array) -> Array:
        point = self.ref(t)
        V = self.tip.transported(q, point)[..., None]  # twist of the path in the present tool frame
        rate: Array = self._inverse(self.tip.jacobian(q, point.X), t) @ V
        return rate[..., 0]

    def _inverse(self, J: Array, t: Array, quiet: bool = False) -> Array:
        """(m, n, 6) pseudo-inverses. Raises NearSingular (unless damped or ``quiet``) and records the worst condition number."""
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        if self.damping > 0:
            gain = s / (s * s + self.damping**2)
        elif quiet:
            gain = s / (s * s + (1e-9 * s[..., :1]) ** 2)
        else:
            condition = s[..., 0] / np.maximum(s[..., -1], 1e-300)
            k = int(np.argmax(condition))
            self.worst = max(self.worst, (float(condition[k]), float(s[k, -1]), float(t[k])))
            if condition[k] > REFUSE_CONDITION:
                raise NearSingular(self.tip.robot.tool, float(s[k, -1]), float(condition[k]), float(t[k]))
            gain = 1.0 / s
        out: Array = (np.swapaxes(Vt, -1, -2) * gain[..., None, :]) @ np.swapaxes(U, -1, -2)
        return out

    def _check_followed(self, missed_V: Array, missed_dV: Array, point: ToolPoint, t: Array) -> None:
        scale = 1.0 + np.abs(point.V).max() + np.abs(point.dV).max()
        missed = np.maximum(np.abs(missed_V).max(axis=-1), np.abs(missed_dV).max(axis=-1))
        if missed.max() > 1e-6 * scale:
            when = float(t[int(np.argmax(missed))])
            text = f"{self.tip.robot.n} joints cannot follow the tool path at t = {when:.4g} s: no joint motion gives a part of its twist"
            raise NotConverged(text + _fewer(self.tip.robot))


def _newton(tip: Tip, target: Array, q: Array, least: bool, wanted: Array | float = 0.0) -> tuple[Array, Array, bool]:
    """Joint position (n,) at the target, the remaining pose error, and whether it converged (``least``: or the error is minimal).

    ``wanted``: the error to arrive at.

    Damped least squares, which become Newton steps near the solution.
    """
    q, mu = np.array(q), 0.0
    error = tip.error(q, target) - wanted
    for _ in range(ITERATIONS):
        size = float(np.linalg.norm(error))
        if size < TOLERANCE:
            return q, error, True
        J = tip.jacobian(q, target)
        if least and np.abs(J.T @ error).max() < 1e-9:
            return q, error, True
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        step = Vt.T @ (s / (s * s + mu + (1e-9 * s[0]) ** 2) * (U.T @ error))
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-300))
        after = tip.error(q + step, target) - wanted
        if np.linalg.norm(after) < size:
            q, error, mu = q + step, after, (0.0 if mu < 1e-9 else 0.1 * mu)
        elif size < ROUNDING:
            return q, error, True
        else:
            mu = max(4.0 * mu, 1e-6)
    return q, error, False


def _out_of_reach(robot: Robot, error: Array, where: str) -> str:
    size = f"{np.linalg.norm(error[:3]):.3g} m and {np.linalg.norm(error[3:]):.3g} rad" if error.size == 6 else f"{np.linalg.norm(error):.3g}"
    return (
        f"no joint position of {robot.name!r} found for the tool pose {where}: error {size} after {ITERATIONS} steps. "
        f"The pose is out of reach, or q_start is too far from it{_fewer(robot) if error.size == 6 else ''}"
    )


def _fewer(robot: Robot) -> str:
    return '; axes= ("xyz", ...) leaves directions out' if robot.n < 6 else ""


def _closed(ref: ToolReference, t: Array, nodes: JointPoint) -> float | None:
    """The period of the path, where these times span a whole number of periods and the joints return to their start."""
    if ref.period is None:
        return None
    span = float(t[-1] - t[0])
    turns = round(span / ref.period)
    if turns < 1 or abs(span - turns * ref.period) > 1e-9 * span:
        return None
    back = all(np.abs(x[0] - x[-1]).max() < 1e-7 * (1 + np.abs(x).max()) for x in nodes)
    return ref.period if back else None


def _tip(robot: Robot, selection: Selection | None) -> Tip:
    return Tip(robot) if selection is None else SelectedTip(robot, selection)


def _start(robot: Robot, q_start: ArrayLike) -> Array:
    from mfc_analysis.robots.robot import Robot

    checks.instance("robot", robot, Robot, "a Robot, such as mfc.robots.ur5()")
    out = checks.vector("q_start", q_start)
    if out.size != robot.n:
        raise BadArgument("q_start", f"shape {out.shape}", f"shape ({robot.n},)")
    return out


def _tool(ref: ToolReference) -> ToolReference:
    if getattr(ref, "space", None) != "tool":
        raise BadArgument("tool_ref", ref, "a tool-space reference (ToolHold, ToolLine, ToolSinusoid, ToolCircle)")
    return ref
