r"""Gains from a specification of the loop: bandwidth, natural frequency, crossover or settling time.

Every helper takes exactly one of

- ``bandwidth`` [rad/s]: the frequency where T = L/(1 + L) falls to -3 dB (1/sqrt 2),
- ``natural_frequency`` [rad/s]: of the pair of poles (of all three for a PID, of the one for a P),
- ``crossover`` [rad/s]: where abs(L) = 1,
- ``settling_time`` [s]: the last time at which a step response is 2 % away from 1. ``step`` says which: "reference" (the default), a
  step of q_d with v_d = 0 (``force_pi``: of F_d), as ``lin.step`` and ``Requirements`` take it; "loop", the step response of T,

and returns ``Gains``, which unpack into a law: ``ComputedTorque(**pid(bandwidth=hertz(4)))``. The achieved metrics are computed
from the polynomials of the final loop; ``joint_pid`` adds those of the coupled arm. L is the loop of the design, in negative feedback:

================  =====================================  ==========================================================
``p``, ``pi``     1/(inertia s) (9.2-9.5)                s + kp;  s^2 + kp s + ki
``pd``, ``pid``   1/(inertia s^2) (9.8-9.16)             s^2 + kd s + kp;  (s^2 + 2 damping w s + w^2)(s + w)
``force_pi``      one mass on a spring (9.22-9.23)       the polynomials of ``force_pi``
================  =====================================  ==========================================================

Sources: chapter, eqs. 9.2-9.4, 9.8-9.13, 9.22-9.23; Siciliano et al., Robotics: Modelling, Planning and Control, section 8.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.loop_step import STEPS, SettlingStep
from mfc_analysis.errors import BadArgument
from mfc_analysis.gains.force_loop import force_design
from mfc_analysis.gains.joints import coupled_loop, motion
from mfc_analysis.gains.result import Achieved, Gains, Value
from mfc_analysis.gains.scalar_loop import BOTH, SETTLING, LoopMetrics, loop_metrics
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.coupling import warn_without_armature

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


__all__ = ["Achieved", "Gains", "force_pi", "joint_pid", "p", "pd", "pi", "pid"]

_ASKED = ("bandwidth", "natural_frequency", "crossover", "settling_time")
_DEFINITIONS = {
    "bandwidth": "the frequency where T = L/(1 + L) falls to -3 dB (1/sqrt 2), rad/s",
    "natural_frequency": "the natural frequency of the dominant poles, rad/s",
    "crossover": "the frequency where |L| = 1, rad/s",
    "settling_time": "the last time at which the response to a step of the reference (v_d = 0) is 2 % away from 1, s",
    "loop_settling_time": "the last time at which the step response of T = L/(1 + L) is 2 % away from 1, s",
}


def p(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    inertia: ArrayLike = 1.0,
) -> Gains:
    """Proportional gain on the integrator 1/(inertia s), laws 9.2 and 9.5: kp = w inertia, one pole at -w.

    Args:
        bandwidth, natural_frequency, crossover, settling_time: exactly one of these four, [rad/s] and [s], as ``Achieved`` defines them.
            The first three are w here.
        step: of the settling time; here both kinds, "reference" and "loop", have the same.
        inertia: scalar or array > 0.

    Raises ``BadArgument``: none or two of them given, a number that is not positive, or a ``step`` without a settling time.
    """
    return _design("p", one_of(step, bandwidth, natural_frequency, crossover, settling_time), 1.0, inertia)


def pi(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    damping: float = 1.0,
    inertia: ArrayLike = 1.0,
) -> Gains:
    """PI gains on the integrator 1/(inertia s), laws 9.3-9.5: kp = 2 damping w inertia, ki = w^2 inertia.

    Args:
        bandwidth, natural_frequency, crossover, settling_time: exactly one of these four, [rad/s] and [s], as ``Achieved`` defines them.
        step: of the settling time; here both kinds, "reference" and "loop", have the same.
        damping: damping ratio of the pair of poles, 0.001 to 1000. inertia: scalar or array > 0.

    Raises ``BadArgument`` as ``p``.
    """
    return _design("pi", one_of(step, bandwidth, natural_frequency, crossover, settling_time), damping, inertia)


def pd(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    damping: float = 1.0,
    inertia: ArrayLike = 1.0,
) -> Gains:
    """PD gains on the double integrator 1/(inertia s^2), laws 9.8-9.16: kp = w^2 inertia, kd = 2 damping w inertia.

    Args:
        bandwidth, natural_frequency, crossover, settling_time: exactly one of these four, [rad/s] and [s], as ``Achieved`` defines them.
        step: of the settling time: "reference", a step of q_d with v_d = 0, or "loop", the step response of T.
        damping: damping ratio of the pair of poles, 0.001 to 1000. inertia: scalar or array > 0 [kg m^2 or kg]; 1 for computed torque.

    Raises ``BadArgument`` as ``p``.
    """
    return _design("pd", one_of(step, bandwidth, natural_frequency, crossover, settling_time), damping, inertia)


def pid(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    damping: float = 1.0,
    inertia: ArrayLike = 1.0,
) -> Gains:
    """PID gains on the double integrator 1/(inertia s^2), laws 9.8-9.16, the third pole at the natural frequency w.

    kd = (1 + 2 damping) w inertia, kp = (1 + 2 damping) w^2 inertia, ki = w^3 inertia; with damping 1 a triple pole at -w.

    Args:
        bandwidth, natural_frequency, crossover, settling_time: exactly one of these four, [rad/s] and [s], as ``Achieved`` defines them.
        step: of the settling time: "reference", a step of q_d with v_d = 0, or "loop", the step response of T.
        damping: damping ratio of the pair of poles, 0.001 to 1000. inertia: scalar or array > 0 [kg m^2 or kg]; 1 for computed torque.

    Raises ``BadArgument`` as ``p``.
    """
    return _design("pid", one_of(step, bandwidth, natural_frequency, crossover, settling_time), damping, inertia)


def joint_pid(
    robot: Robot,
    q: Any,
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    damping: float = 1.0,
    torque_lag: float = 0.0,
    delay: float = 0.0,
) -> Gains:
    """PID gains of independent joints, law 9.8: those of ``pid`` times the effective inertia M_jj(q) of each joint, armature included.

    The loop of the design leaves out gravity, friction and coupling: ``achieved`` are the metrics of each joint alone. ``coupled`` is the
    arm with the loops of all joints closed, linearised exactly with these gains: stable or not, the margins of each joint, and the dead
    time in all joints at once at which it becomes unstable.

    Args:
        robot: its mass matrix gives the effective inertia.
        q: (n,) a pose, (m, n) several poses, or a joint reference ``ref(t)`` with ``period`` or ``duration``. The largest inertia of each joint
            counts; along a reference the coupled loop is judged at 41 times.
        bandwidth, natural_frequency, crossover, settling_time: exactly one, as for ``pid``. step: whose settling time, of each joint alone.
        damping: damping ratio of the pair of poles, 0.001 to 1000.
        torque_lag, delay: [s] as in ``Hardware``: first-order lag and dead time of each torque, in the coupled loop only; 0: none.

    Returns gains of shape (n,) [Nm/rad, Nm/(rad s), Nm s/rad; N and m for prismatic joints]. Raises ``BadArgument`` as ``pid``, and for a q of
    another shape or a reference without an end. Warns (``MfcWarning``) where the model seems to lack rotor inertia, as ``robots.lacks_armature``.
    """
    where = motion(robot, q)
    inertia = where.largest
    asked = one_of(step, bandwidth, natural_frequency, crossover, settling_time)
    made = _design("pid", asked, damping, inertia)
    notes = [f"inertia {where.where}: {np.array2string(inertia, precision=5, separator=', ')} kg m^2 (kg for prismatic joints), armature included"]
    if np.any(where.smallest < inertia * (1 - 1e-9)):
        loops = zip(*(np.asarray(made[name]) for name in ("kd", "kp", "ki")), where.smallest, strict=True)
        light = [loop_metrics([kd, kp, ki], [lightest, 0, 0, 0], settle=()) for kd, kp, ki, lightest in loops]
        notes.append(f"where a joint is lightest its bandwidth is up to {max(f.bandwidth for f in light):.4g} rad/s")
    warn_without_armature(robot, where.q)
    coupled = coupled_loop(robot, made, where, torque_lag, delay)
    return replace(made, loop=f"{made.loop}, I = M_jj(q) {where.where}", notes=tuple(notes), coupled=coupled)


def force_pi(
    *,
    bandwidth: float | None = None,
    natural_frequency: float | None = None,
    crossover: float | None = None,
    settling_time: float | None = None,
    step: SettlingStep = "reference",
    stiffness: float,
    mass: float,
    lag: float = 0.0,
    friction: float = 0.0,
    damping: float = 1.0,
) -> Gains:
    r"""Force gains of 9.22-9.23 for one mass that pushes on a spring through a first-order torque lag: kfp, kfi and kdamp.

    .. math:: m T s^4 + (m + b T) s^3 + (b + k_{damp} + k_e T) s^2 + k_e (1 + k_{fp}) s + k_e k_{fi}

    The poles are placed exactly: a pair (damping, w), a pole at -p, and with a lag a fourth pole that follows from the lag. Slow
    loops take kfp = 0 and p < w (integral force control, suited to a stiff surface); where that is too slow, p = w and kfp > 0.
    ``natural_frequency`` always means p = w. L is the loop at the force sensor, in contact with the environment.

    Args:
        bandwidth, natural_frequency, crossover, settling_time: exactly one of these four, [rad/s] and [s], as ``Achieved`` defines them.
        step: whose settling time, of F_d -> F_tip ("reference") or of T ("loop"); both with the lag.
        stiffness: of the environment [N/m] > 0. mass: effective, along the contact [kg] > 0. lag: of the torque [s] >= 0.
        friction: viscous, of the arm [N s/m] >= 0. damping: ratio of the pair, 0.001 to 1000.

    Returns gains that unpack into ``DampedForcePI(F_d, **gains)``. Raises ``BadArgument``: as ``pid``, and with the reason where no gains
    >= 0 meet the specification. Source: chapter, eqs. 9.22-9.23.
    """
    name, value = one_of(step, bandwidth, natural_frequency, crossover, settling_time)
    k = checks.number("stiffness", stiffness, low=1e-9, high=1e12)
    m = checks.number("mass", mass, low=1e-9, high=1e9)
    T, b = checks.number("lag", lag, low=0.0, high=1e6), checks.number("friction", friction, low=0.0, high=1e12)
    zeta = checks.number("damping", damping, low=1e-3, high=1e3)
    found = force_design(name, value, k, m, T, b, zeta)
    f = found.metrics
    notes = [f"from F_d to F_tip (the feedforward included) the bandwidth is {found.tracking_bandwidth:.4g} rad/s"]
    low, high = found.stiffness_range
    above = "any stiffness above it" if high == math.inf else f"{high:.4g} N/m, {high / k:.3g} times this stiffness"
    between = f"from a stiffness of {low:.4g} N/m to {above}" if low > 0 or high < math.inf else "on any stiffness"
    notes.append(f"with these gains stable {between}")
    notes.append("in free space the velocity ramps (kfi > 0): keep contact, or limit the time")
    return Gains(
        {"kfp": found.kfp, "kfi": found.kfi, "kdamp": found.kdamp},
        {"kfp": "-", "kfi": "1/s", "kdamp": "N s/m"},
        "poles of m T s^4 + (m + b T) s^3 + (b + kdamp + k_e T) s^2 + k_e (1 + kfp) s + k_e kfi placed at a pair (damping, w) and -p; "
        f"w = {found.natural_frequency:.6g} rad/s, p = {found.pole:.6g} rad/s, damping = {zeta:g}",
        asked_for(name, value),
        f"L at the force sensor: mass {m:g} kg on k_e = {k:g} N/m, torque lag {T:g} s, friction {b:g} N s/m",
        Achieved(f.bandwidth, f.crossover, f.settling_time, f.loop_settling_time, found.natural_frequency, found.damping, f.phase_deg),
        tuple(notes),
    )


_FORMULAS: Mapping[str, tuple[str, str, Callable[[float], dict[str, tuple[float, int]]]]] = {
    # kind: formula, loop, damping -> {gain: (factor, power of w)}
    "p": ("kp = w I", "L = kp/(I s)", lambda z: {"kp": (1.0, 1)}),
    "pi": ("kp = 2 damping w I, ki = w^2 I", "L = (kp s + ki)/(I s^2)", lambda z: {"kp": (2 * z, 1), "ki": (1.0, 2)}),
    "pd": ("kp = w^2 I, kd = 2 damping w I", "L = (kd s + kp)/(I s^2)", lambda z: {"kp": (1.0, 2), "kd": (2 * z, 1)}),
    "pid": (
        "kp = (1 + 2 damping) w^2 I, ki = w^3 I, kd = (1 + 2 damping) w I",
        "L = (kd s^2 + kp s + ki)/(I s^3)",
        lambda z: {"kp": (1 + 2 * z, 2), "ki": (1.0, 3), "kd": (1 + 2 * z, 1)},
    ),
}
_UNITS = {"p": {"kp": "1/s"}, "pi": {"kp": "1/s", "ki": "1/s^2"}}
_UNIT_INERTIA = {"kp": "1/s^2", "ki": "1/s^3", "kd": "1/s"}
_PER_INERTIA = {"kp": "N m/rad or N/m", "ki": "N m/(rad s) or N/(m s)", "kd": "N m s/rad or N s/m"}


def one_of(step: SettlingStep, *given: float | None) -> tuple[str, float]:
    """The metric asked for, a field of ``LoopMetrics`` or "natural_frequency", and its value."""
    checks.choice("step", step, tuple(STEPS))
    asked = {name: value for name, value in zip(_ASKED, given, strict=True) if value is not None}
    if len(asked) != 1:
        raise BadArgument(" or ".join(_ASKED), ", ".join(asked) or "none of them", "exactly one of the four")
    name, value = next(iter(asked.items()))
    value = checks.number(name, value, low=1e-9, high=1e9)
    if name != "settling_time" and step != "reference":
        raise BadArgument("step", step, f"a settling_time with it: {name} does not depend on a step")
    return SETTLING[step] if name == "settling_time" else name, value


def asked_for(name: str, value: float) -> str:
    """What was asked of the loop, with its definition: "bandwidth = 31.4: the frequency where ..."."""
    return f"{name.removeprefix('loop_')} = {value:.6g}: {_DEFINITIONS[name]}"


def _metrics(gains: Mapping[str, float], inertia: float) -> LoopMetrics:
    """Of the loop; a step of q_d reaches the law without its derivative, which kd multiplies."""
    order = [name for name in ("kd", "kp", "ki") if name in gains]
    follows = [gains[name] for name in order if name != "kd"]
    return loop_metrics([gains[name] for name in order], [inertia, *[0.0] * len(order)], reference=follows)


@lru_cache(maxsize=256)
def _unit_metrics(kind: str, damping: float) -> LoopMetrics:
    """Metrics of the loop with natural frequency and inertia 1; all other loops differ by a time scale only."""
    return _metrics({name: factor for name, (factor, _) in _FORMULAS[kind][2](damping).items()}, 1.0)


def _design(kind: str, asked: tuple[str, float], damping: float, inertia: ArrayLike) -> Gains:
    zeta = checks.number("damping", damping, low=1e-3, high=1e3)
    I = checks.array("inertia", inertia)
    if np.any(I < 1e-12) or np.any(I > 1e12) or I.size == 0:
        raise BadArgument("inertia", inertia, "positive numbers, 1e-12 to 1e12")
    name, value = asked
    unit = _unit_metrics(kind, zeta)
    metric = 1.0 if name == "natural_frequency" else float(getattr(unit, name))
    w = metric / value if name in BOTH else value / metric
    formula, loop, factors = _FORMULAS[kind]
    gains: dict[str, Value] = {}
    for gain, (factor, power) in factors(zeta).items():
        scaled = factor * w**power * I
        gains[gain] = float(scaled) if I.ndim == 0 else scaled
    plain = I.ndim == 0 and float(I) == 1.0
    units = _UNITS.get(kind) or (_UNIT_INERTIA if plain else _PER_INERTIA)
    how = f"; w = {w:.6g} rad/s" + ("" if kind == "p" else f", damping = {zeta:g}") + (", I = 1" if plain else "")
    return Gains(gains, {g: units[g] for g in gains}, formula + how, asked_for(name, value), loop, _achieved(kind, gains, I))


def _achieved(kind: str, gains: Mapping[str, Value], I: Array) -> Achieved:
    """Metrics of the loops with these gains, one for each inertia."""
    found = []
    for index in np.ndindex(I.shape):
        one = {name: float(np.asarray(value)[index]) for name, value in gains.items()}
        inertia = float(I[index])
        f = _metrics(one, inertia)
        per = {name: value / inertia for name, value in one.items()}
        w, zeta = _pair(kind, per)
        found.append((f.bandwidth, f.crossover, f.settling_time, f.loop_settling_time, w, zeta, f.phase_deg))
    columns = np.array(found).reshape(*I.shape, 7)
    return Achieved(*(float(c) if I.ndim == 0 else c for c in np.moveaxis(columns, -1, 0)))


def _pair(kind: str, per: Mapping[str, float]) -> tuple[float, float]:
    """Natural frequency and damping of the dominant poles, from gains per inertia."""
    if kind == "p":
        return per["kp"], 1.0
    if kind == "pid":
        w = math.cbrt(per["ki"])
        return w, (per["kd"] / w - 1) / 2
    square, linear = (per["ki"], per["kp"]) if kind == "pi" else (per["kp"], per["kd"])
    return math.sqrt(square), linear / (2 * math.sqrt(square))
