r"""Gains of an arm in contact: the damping of a Cartesian stiffness, and an admittance for a wall and the servo of the arm.

Sources: Albu-Schaeffer, Ott, Frese, Hirzinger, ICRA 2003, "Cartesian impedance control of redundant robots";
Lynch & Park, Modern Robotics, section 11.7.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.loop_step import loop_step
from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.plain import AT, in_feedback
from mfc_analysis.analysis.step_metrics import pair_metrics
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument
from mfc_analysis.gains.formulas import asked_for, one_of
from mfc_analysis.gains.result import Achieved, DampingMatrix, Gains
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Complex
from mfc_analysis.maths.roots import root_between

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot

SEARCHED = 121  #: natural frequencies of the search for a bandwidth or crossover
SAME = 1e-6  #: relative distance of two roots below which they are a double root


class Damped(NamedTuple):
    """A stiffness with its damping."""

    K: Array  #: (6, 6) [N/m, Nm/rad]
    D: Array  #: (6, 6) [N s/m, Nm s/rad]
    modes: Array  #: (6,) [rad/s] undamped, ascending
    ratio: Array  #: (6,) damping ratio of each mode


def cartesian_damping(robot: Robot, q: ArrayLike, stiffness: ArrayLike, ratio: ArrayLike = 1.0) -> DampingMatrix:
    r"""Damping matrix for a Cartesian stiffness, by double diagonalisation with the task inertia Lambda(q).

    .. math:: \Lambda = Q Q^T, \quad K = Q \,\mathrm{diag}(w^2)\, Q^T, \quad D = 2 Q \,\mathrm{diag}(\zeta w)\, Q^T

    so that Lambda x'' + D x' + K x = 0 decouples into six modes, each with damping ratio ``ratio``.

    Args:
        robot: gives the mass matrix. q: (n,) pose.
        stiffness: scalar, (6,) or (6, 6) symmetric positive definite [N/m, Nm/rad], tool frame (linear, angular).
        ratio: >= 0, scalar or (6,) in the order of increasing modal frequency.

    Returns ``DampingMatrix``: kp the (6, 6) stiffness, kd the (6, 6) damping [N s/m, Nm s/rad]. Raises ``BadArgument``; ``NearSingular``
    where the robot has no task inertia. Source: Albu-Schaeffer, Ott, Frese, Hirzinger, ICRA 2003, "Cartesian impedance control of
    redundant robots".
    """
    found = _damped(robot, q, stiffness, ratio)
    unit = {"kp": "N/m, N m/rad", "kd": "N s/m, N m s/rad"}
    return DampingMatrix({"kp": found.K, "kd": found.D}, unit, *_words(found), None)


def impedance(robot: Robot, q: ArrayLike, stiffness: ArrayLike, ratio: ArrayLike = 1.0) -> Gains:
    r"""Stiffness and damping of an impedance with the inertia of the arm: those of ``cartesian_damping``, for ``laws.Impedance``.

    .. math:: \Lambda(q) = Q Q^T, \quad K = Q \,\mathrm{diag}(w^2)\, Q^T, \quad D = 2 Q \,\mathrm{diag}(\zeta w)\, Q^T

    Args:
        robot: gives the mass matrix. q: (n,) pose.
        stiffness: scalar, (6,) or (6, 6) symmetric positive definite [N/m, Nm/rad], tool frame (linear, angular).
        ratio: damping ratio >= 0 of the six modes, scalar or (6,) in the order of increasing modal frequency.

    Returns gains that unpack into ``Impedance(**gains)``: stiffness and damping, (6, 6). A note says what the damping ratios are out of contact, by
    the eigenvalues of Lambda s^2 + D s + K. Raises ``BadArgument``; ``NearSingular`` where the robot has no task inertia.
    """
    found = _damped(robot, q, stiffness, ratio)
    Lambda = np.asarray(robot.task_inertia(checks.array("q", q, (robot.n,))))
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(Lambda, found.K), -np.linalg.solve(Lambda, found.D)]])
    roots = np.linalg.eigvals(A)
    settling = 1 / float(np.min(np.abs(roots.real)))
    note = f"poles of the six modes from {np.abs(roots).min():.4g} to {np.abs(roots).max():.4g} rad/s; the slowest time constant is {settling:.4g} s"
    units = {"stiffness": "N/m, N m/rad", "damping": "N s/m, N m s/rad"}
    return Gains({"stiffness": found.K, "damping": found.D}, units, *_words(found), None, (note,))


def admittance(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    stiffness: float,
    damping: float = 1.0,
    lag: float = 0.0,
    servo: float | None = None,
    servo_damping: float = 0.5**0.5,
    delay: float = 0.0,
) -> Gains:
    r"""Inertia and damping of an admittance that presses on a wall through the servo of the arm, one direction, for ``laws.Admittance``.

    The pair of poles (damping, w) is placed exactly, lag, servo and dead time included. With its roots s1, s2 and the actuator H(s) the loop

    .. math:: s (M_d s + D) + k_e H(s) = 0, \quad H(s) = \frac{e^{-s T_d}}{T s + 1} \frac{w_s^2}{s^2 + 2 \zeta_s w_s s + w_s^2}

    has both for M_d = k_e (H(s1) - s1 h) / w^2, D = -k_e h - M_d (s1 + s2) with h = (H(s1) - H(s2)) / (s1 - s2), or H'(s1) of a double root.
    Without lag, servo and dead time: M_d = k_e / w^2, D = 2 damping sqrt(k_e M_d).

    Args:
        bandwidth, natural_frequency, crossover: exactly one of these three [rad/s], as ``Achieved`` defines them: the bandwidth of T = F_tip / F_d,
            w, the crossover of L at the force sensor.
        stiffness: k_e of the wall, in series with that of the tool [N/m] > 0. damping: ratio of the pair, 0.001 to 1000.
        lag: of the velocity [s] >= 0. servo: bandwidth of the servo [rad/s] at -3 dB, None: none; servo_damping: of the servo. As ``Servo``.
        delay: all dead time in the loop, of command, servo and sensor [s] >= 0; half a sample time stands for the sampling.

    Returns inertia [kg] and damping [N s/m], which unpack into ``Admittance(F_d, **gains)``. Notes say on what walls they are stable. Raises
    ``BadArgument``: as ``pid``, and with the reason where no positive gains meet the specification.
    """
    name, value = one_of("reference", bandwidth, natural_frequency, crossover, None)
    chain = _Chain(
        checks.number("stiffness", stiffness, low=1e-9, high=1e12),
        checks.number("lag", lag, low=0.0, high=1e6),
        None if servo is None else checks.number("servo", servo, low=1e-9, high=1e9),
        checks.number("servo_damping", servo_damping, low=1e-3, high=1e3),
        checks.number("delay", delay, low=0.0, high=1e6),
        checks.number("damping", damping, low=1e-3, high=1e3),
    )
    w = value if name == "natural_frequency" else chain.attaining(name, value)
    M, D = chain.placed(w)
    if not (M > 0 and D > 0):
        raise BadArgument(name, value, f"less: a pair at {w:.4g} rad/s behind this actuator needs an inertia of {M:.4g} kg and {D:.4g} N s/m")
    system = chain.loop(M, D)
    found = margins(system, AT)
    if not found.stable[0]:
        raise BadArgument(name, value, "less: with the pair of poles placed there another one is unstable")
    step, late = loop_step(system, AT)
    settling = float(pair_metrics(step, np.array([0]), np.array([0]))["settling"][0, 0] + late[0])
    k, up = chain.k, float(found.gain_increase[0, 0])
    achieved = Achieved(chain.bandwidth(M, D), float(found.crossover[0, 0]), settling, settling, w, chain.zeta, float(found.phase_deg[0, 0]))
    stiffest = "any stiffer one" if math.isinf(up) else f"one of {k * up:.4g} N/m, {up:.3g} times this"
    return Gains(
        {"inertia": M, "damping": D},
        {"inertia": "kg", "damping": "N s/m"},
        "roots s1, s2 of the pair (damping, w) placed on s (M_d s + D) + k_e H(s), H lag, servo and dead time; "
        f"w = {w:.6g} rad/s, damping = {chain.zeta:g}; without H: M_d = k_e/w^2, D = 2 damping sqrt(k_e M_d)",
        asked_for(name, value),
        f"L = k_e H/(s (M_d s + D)) at the force sensor: wall k_e = {k:g} N/m, {chain.words}",
        achieved,
        (f"stable on softer walls, and up to {stiffest}", f"in free space the tool moves at {1 / D:.4g} m/s for each N of F_d"),
    )


# --- the damping of a stiffness ------------------------------------------------------------------------------------------


def _damped(robot: Robot, q: ArrayLike, stiffness: ArrayLike, ratio: ArrayLike) -> Damped:
    from scipy.linalg import eigh

    from mfc_analysis.robots.robot import Robot

    takes = "a positive number, (6,) positive numbers or a symmetric positive definite (6, 6) matrix"
    K = checks.array("stiffness", stiffness, takes=takes)
    K = K * np.eye(6) if K.ndim == 0 else np.diag(K) if K.shape == (6,) else np.array(K)
    if K.shape != (6, 6) or np.abs(K - K.T).max() > 1e-9 * np.abs(K).max() or np.linalg.eigvalsh(K)[0] <= 0:
        raise BadArgument("stiffness", stiffness, takes)
    zeta = checks.per_joint("ratio", ratio, 6, low=0.0)
    arm = checks.instance("robot", robot, Robot, "a Robot, such as mfc.robots.ur5()")
    Lambda = np.asarray(arm.task_inertia(checks.array("q", q, (arm.n,))))
    w2, V = eigh(K, Lambda)  # V^T Lambda V = I, V^T K V = diag(w2): Q = V^-T = Lambda V
    Q = Lambda @ V
    D = 2.0 * (Q * (zeta * np.sqrt(w2))) @ Q.T
    return Damped(K, (D + D.T) / 2, np.sqrt(w2), zeta)


def _words(found: Damped) -> tuple[str, str, str]:
    """Formula, definition and loop."""
    return (
        "Lambda = Q Q^T, K = Q diag(w^2) Q^T, D = 2 Q diag(ratio w) Q^T",
        f"damping ratio {np.array2string(np.unique(found.ratio), precision=4)} of each mode of Lambda(q) x'' + D x' + K x = 0",
        f"Lambda(q) x'' + D x' + K x = 0, modes at {np.array2string(found.modes, precision=4, separator=', ')} rad/s",
    )


# --- an admittance on a wall ---------------------------------------------------------------------------------------------


class _Chain(NamedTuple):
    """A wall and the actuator H in front of it."""

    k: float  #: [N/m]
    lag: float  #: [s]
    servo: float | None  #: [rad/s]
    servo_damping: float
    delay: float  #: [s]
    zeta: float  #: of the pair of poles

    @property
    def words(self) -> str:
        servo = "no servo" if self.servo is None else f"servo of {self.servo:.4g} rad/s (damping {self.servo_damping:.3g})"
        return f"{servo}, lag {self.lag:g} s, dead time {self.delay:g} s"

    @property
    def den(self) -> Array:
        """Denominator of H without dead time; its constant term is 1."""
        out = np.array([self.lag, 1.0])
        if self.servo is not None:
            a = 1 - 2 * self.servo_damping**2
            x = a + math.hypot(a, 1.0) if a > 0 else 1 / (math.hypot(a, 1.0) - a)
            w = self.servo / math.sqrt(x)
            out = np.polymul(out, [1 / w**2, 2 * self.servo_damping / w, 1.0])
        return np.asarray(np.trim_zeros(out, "f"), float)

    def H(self, s: complex) -> complex:
        return cmath.exp(-s * self.delay) / complex(np.polyval(self.den, s))

    def H_slope(self, s: complex) -> complex:
        """H'."""
        den = self.den
        return self.H(s) * (-self.delay - complex(np.polyval(np.polyder(den), s) / np.polyval(den, s)))

    def placed(self, w: float) -> tuple[float, float]:
        """M_d and D for which the pair (zeta, w) is a root."""
        spread = w * cmath.sqrt(self.zeta**2 - 1)
        s1, s2 = -w * self.zeta + spread, -w * self.zeta - spread
        h = self.H_slope(-w * self.zeta) if abs(spread) < SAME * w else (self.H(s1) - self.H(s2)) / (s1 - s2)
        M = self.k * (self.H(s1) - s1 * h) / w**2
        return M.real, (-self.k * h - M * (s1 + s2)).real

    def loop(self, M: float, D: float) -> OpenSystem:
        """L = k H / (s (M s + D)) in negative feedback."""
        import control

        return in_feedback(control.tf([self.k], np.polymul(self.den, [M, D, 0.0])), self.delay)

    def L(self, w: Array, M: float, D: float) -> Complex:
        s = 1j * w
        return np.asarray(self.k * np.exp(-s * self.delay) / (np.polyval(self.den, s) * s * (M * s + D)))

    def holds(self, M: float, D: float) -> bool:
        """True where the gains are positive and the loop is stable: 1 + L turns by 90 degrees from 0 to infinite frequency (Nyquist)."""
        if not (M > 0 and D > 0):
            return False
        turned = np.unwrap(np.angle(1 + self.L(_grid(math.sqrt(self.k / M), D / M), M, D)))
        return bool(abs(turned[-1] - turned[0] - np.pi / 2) < 0.5)

    def bandwidth(self, M: float, D: float) -> float:
        """[rad/s] lowest frequency where |T| falls to -3 dB."""
        return _falls(lambda w: np.abs(self.L(w, M, D) / (1 + self.L(w, M, D))) - 0.5**0.5, math.sqrt(self.k / M), D / M)

    def crossover(self, M: float, D: float) -> float:
        """[rad/s] where |L| = 1: it falls all the way."""
        return _falls(lambda w: np.abs(self.L(w, M, D)) - 1, math.sqrt(self.k / M), D / M)

    def attaining(self, name: str, value: float) -> float:
        """The natural frequency w at which the bandwidth or crossover is ``value``, the lowest of them. Raises BadArgument."""

        def excess(log_w: float) -> float:
            M, D = self.placed(math.exp(log_w))
            return math.log((self.bandwidth if name == "bandwidth" else self.crossover)(M, D) / value) if self.holds(M, D) else math.nan

        reach = math.log(max(1e3, 4e2 * self.zeta**2))
        before, most = math.nan, 0.0
        for x in math.log(value) + np.linspace(-reach, reach, SEARCHED):
            now = excess(float(x))
            if before < 0 <= now:
                return math.exp(root_between(excess, float(x) - 2 * reach / (SEARCHED - 1), float(x), xtol=1e-14, rtol=1e-14))
            if math.isnan(now) and not math.isnan(before):
                break  # beyond, the pair is faster than the actuator, and another one is in front of it
            before, most = now, max(most, value * math.exp(now)) if math.isfinite(now) else most
        raise BadArgument(name, value, f"at most {most:.4g} rad/s behind this actuator ({self.words}) with a damping of {self.zeta:g}")


def _grid(*scales: float) -> Array:
    """Frequencies [rad/s] about the scales."""
    return np.geomspace(1e-4 * min(scales), 1e4 * max(scales), 4000)


def _falls(f: Callable[[Array], Array], *scales: float) -> float:
    """The lowest frequency [rad/s] where f falls through 0; the scales say where to look."""
    w = _grid(*scales)
    below = np.flatnonzero(f(w) < 0)
    if not below.size or below[0] == 0:
        return math.inf if not below.size else float(w[0])
    i = int(below[0])
    return root_between(lambda x: float(f(np.array([x]))[0]), float(w[i - 1]), float(w[i]), xtol=1e-14 * w[i], rtol=1e-14)
