"""The chapter's symbols, for the appendix of a report."""

from __future__ import annotations

from mfc_analysis.report.document.document import Math, Symbol

_JOINT = (
    ("q, q_d", "joint positions, actual and desired", "rad (sliding: m)"),
    ("e = q_d - q", "joint error", "rad (sliding: m)"),
    ("z", "integral of the error", "rad s"),
    ("tau", "joint torques", "Nm (sliding: N)"),
    ("M(q), hat(M)", "mass matrix of the plant and of the controller's model", "kg m²"),
    ("h(q, dot(q))", "Coriolis, centrifugal, gravity and viscous terms", "Nm"),
    ("g(q)", "gravity", "Nm"),
    ("K_p, K_i, K_d", "gains on the error, its integral and its rate", ""),
    ("a_q", "commanded joint acceleration", "rad/s²"),
)
_LINEAR = (
    ("L(s)", "open loop at an analysis point, the other loops closed", ""),
    ('"GM"', "gain margin: factors of the loop gain at which the loop becomes unstable", "dB"),
    ('"PM"', "phase margin: the smallest over all crossovers", "°"),
    ("M_s", "sensitivity peak: largest amplification of a disturbance", ""),
    ("omega_n, zeta", "natural frequency and damping ratio of a pole", "rad/s, –"),
    ("alpha", "disk margin: all loops varied at once", ""),
)
_TOOL = (
    ("X, X_d", "tool pose, actual and desired", ""),
    ("X_e", "pose error: logarithm of the desired pose relative to the tool", "m, rad"),
    ("V_b", "body twist (linear, angular)", "m/s, rad/s"),
    ("J_b", "body Jacobian", ""),
    ("Lambda, eta", "inertia and bias in tool space", ""),
)
_FORCE = (
    ('F_"tip", F_d', "wrench on the environment, actual and desired", "N, Nm"),
    ("F_e", "force error", "N, Nm"),
    ('K_"fp", K_"fi"', "force gains", "–, 1/s"),
    ('K_"damp"', "damping of the tool's motion", "Ns/m"),
    ('k_"env"', "stiffness of the environment", "N/m"),
    ("P", "projection onto the motion directions", ""),
)


def symbols(*, tool: bool = False, force: bool = False) -> tuple[Symbol, ...]:
    """Symbols of the joint-space equations; optionally also those of tool space and of force control."""
    rows = _JOINT + _LINEAR + (_TOOL if tool else ()) + (_FORCE if force else ())
    return tuple(Symbol(Math(source), meaning, unit) for source, meaning, unit in rows)
