"""What is slow in a loop, in words: its roots and time constants, what slides, and what would hold it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.laws.law import TWIST
from mfc_analysis.maths.arrays import Array, Complex

if TYPE_CHECKING:
    from mfc_analysis.requirements.evidence import Evidence

ZERO = 1e-3  #: of 1/horizon: a slow root below this is zero, to rounding and to any model
SHARE = 0.3  #: of the largest component: axes and joints that take part in a motion
STRONG = 0.1  #: of the largest motion: further directions that are named
AXES = dict(zip(TWIST, ("along x", "along y", "along z", "about x", "about y", "about z"), strict=True))


class SlowWords(NamedTuple):
    """Texts without a full stop."""

    roots: str  #: how many slow roots there are, and the time constant of the fastest
    moves: str  #: what keeps moving within the horizon; "" where nothing does
    means: str  #: what that means and what would stop it; "" where nothing moves
    fastest: str = ""  #: the time constant of the fastest slow root; "" where there is none


def slow_words(evidence: Evidence) -> SlowWords:
    """The slow part of a loop at the first time at which it drifts (else at the first with a slow root)."""
    verdict = evidence.stability
    some = verdict.drifts if verdict.drifts.any() else verdict.slow > 0
    if not some.any():
        return SlowWords("no slow root", "", "")
    i = int(np.argmax(some))
    count, rate = int(verdict.slow[i]), 1 / verdict.horizon
    size = _fastest(verdict.slow_roots[i], rate)
    head = f"{count} slow root{'s' if count > 1 else ''} (|s| < {rate:.3g} 1/s), left out of the metrics: "
    roots = head + (f"the fastest {size}" if size else "zero to rounding, free positions and ramps")
    fastest = f"the fastest slow root is one {size}" if size else "its speed stays: the slow roots are zero to rounding"
    return SlowWords(roots, *(_motion(evidence, i) if verdict.drifts.any() else ("", "")), fastest)


def _fastest(roots: Complex, rate: float) -> str:
    """The fastest slow root, in words; "" where all are zero to rounding."""
    sizes = np.abs(roots)
    if not sizes.size or sizes.max() < ZERO * rate:
        return ""
    fastest = complex(roots[np.argmax(sizes)])
    if abs(fastest.real) < ZERO * rate:
        return f"at {abs(fastest):.2g} rad/s, undamped"
    return f"with a time constant of {1 / abs(fastest.real):.3g} s, {'growing' if fastest.real > 0 else 'decaying'}"


def _motion(evidence: Evidence, i: int) -> tuple[str, str]:
    """What moves, and its meaning, at time number i: the dominant directions of joint motion, and of the tool for laws that feel or hold it."""
    e = evidence.equations
    within = f"within {evidence.horizon:g} s"
    where = e.parts["q"].where
    moved = evidence.stability.motion[i][where]
    if not moved.any():
        return (
            "an integral or a velocity ramps",
            f"an integral or a velocity ramps {within}: a constant error stays; remove the integral or give it an effect",
        )
    U, size, _ = np.linalg.svd(moved)
    joints = U[:, : int(np.count_nonzero(size > STRONG * size[0]))] * size[size > STRONG * size[0]]
    names = _named(np.abs(joints).max(axis=1), e.robot.joint_names)
    if e.law.space == "joint" and not e.surfaces:
        return f"{names} keep{_s(names)} moving", f"nothing holds {names} {within}: add position feedback there"
    J = e.robot.jacobian(np.ascontiguousarray(evidence.linearization.point.x[i, where]))
    tool = np.abs(J @ joints).max(axis=1)
    part = 0 if tool[:3].max() >= SHARE * tool[3:].max() * REACH else 1
    if tool.max() < 1e-3 * np.abs(joints).max():
        return (
            f"the posture moves ({names}), the tool does not",
            f"nothing holds the posture ({names}) {within}: add null-space damping or a posture task",
        )
    axes = _named(tool[3 * part : 3 * part + 3], [AXES[c] for c in TWIST[3 * part : 3 * part + 3]])
    verb = "turns" if part else "slides"
    cure = "add a foot (another surface) or motion control in that direction (9.24)" if e.surfaces else "add position feedback there"
    return f"the tool {verb} {axes} (tool axes)", f"nothing holds the tool {axes} {within}: it {verb}; {cure}"


REACH = 0.3  #: [m] that weighs a rotation against a translation


def _named(size: Array, names: list[str] | tuple[str, ...]) -> str:
    kept = [name for name, x in zip(names, size, strict=True) if x > SHARE * size.max()]
    return kept[0] if len(kept) == 1 else ", ".join(kept[:-1]) + " and " + kept[-1]


def _s(names: str) -> str:
    return "" if " and " in names else "s"
