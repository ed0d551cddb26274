"""What is slow in a loop, in words: its roots and time constants, what slides, and what would hold it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mfc_analysis.analysis.participation import AXES, listed
from mfc_analysis.laws.law import TWIST
from mfc_analysis.maths.arrays import Array, Complex

if TYPE_CHECKING:
    from mfc_analysis.requirements.evidence import Evidence

ZERO = 1e-3  #: of 1/horizon: a slow root below this is zero, to rounding and to any model
SHARE = 0.3  #: of the largest component: axes and joints that take part in a motion
STRONG = 0.1  #: of the largest motion: further directions that are named
LEFT = 0.1  #: of a displacement: what of it is left after the horizon where a direction is free


class SlowWords(NamedTuple):
    """Texts without a full stop."""

    roots: str  #: how many slow roots there are, and the time constant of the fastest
    moves: str  #: what keeps moving within the horizon; "" where nothing does
    means: str  #: what slides or is free, and what would hold it; "" where nothing is
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
    fastest = f"the fastest slow root is one {size}" if size else ""
    if not verdict.drifts.any():
        return SlowWords(roots, "", _free(evidence, i), fastest)
    return SlowWords(roots, *_motion(evidence, i), fastest or "its speed stays: the slow roots are zero to rounding")


def _fastest(roots: Complex, rate: float) -> str:
    """The fastest slow root, in words; "" where all are zero to rounding."""
    sizes = np.abs(roots)
    if not sizes.size or sizes.max() < ZERO * rate:
        return ""
    fastest = complex(roots[np.argmax(sizes)])
    if abs(fastest.real) < ZERO * rate:
        return f"at {abs(fastest):.2g} rad/s, undamped"
    return f"with a time constant of {1 / abs(fastest.real):.3g} s, {'growing' if fastest.real > 0 else 'decaying'}"


class _Way(NamedTuple):
    """Where the slow part goes."""

    kind: str  #: "joint", "posture", "slides", "turns", or "" where no position takes part
    names: str  #: joints or tool axes
    many: bool


def _way(evidence: Evidence, i: int, moved: Array) -> _Way:
    """The dominant directions of motion at time number i, and of the tool for laws that feel or hold it. ``moved``: (n, k) positions by starts."""
    e, lin = evidence.equations, evidence.linearization
    if not moved.any():
        return _Way("", "", False)
    U, size, _ = np.linalg.svd(moved)
    along = U[:, : int(np.count_nonzero(size > STRONG * size[0]))] * size[size > STRONG * size[0]]
    if lin.coordinates == "error" and e.law.space == "tool":  # the positions are X_e
        selection = e.law.selection
        tool = np.abs(along if selection is None else selection.rows.T @ along).max(axis=1)
    else:
        named = _named(np.abs(along).max(axis=1), e.robot.joint_names)
        if e.law.space == "joint" and not e.surfaces:
            return _Way("joint", f"all {e.n} joints" if len(named) == e.n > 2 else listed(named), len(named) > 1)
        J = e.robot.jacobian(np.ascontiguousarray(lin.point.x[i, e.parts["q"].where]))
        tool = np.abs(J @ along).max(axis=1)
        if tool.max() < 1e-3 * np.abs(along).max():
            return _Way("posture", listed(named), len(named) > 1)
    part = 0 if tool[:3].max() >= SHARE * tool[3:].max() * REACH else 1
    axes = _named(tool[3 * part : 3 * part + 3], [AXES[c] for c in TWIST[3 * part : 3 * part + 3]])
    return _Way("turns" if part else "slides", listed(axes), len(axes) > 1)


def _motion(evidence: Evidence, i: int) -> tuple[str, str]:
    """What moves, and its meaning, at time number i."""
    within = f"within {evidence.horizon:g} s"
    kind, names, many = _way(evidence, i, evidence.stability.motion[i][evidence.equations.parts["q"].where])
    if not kind:
        return (
            "an integral or a velocity ramps",
            f"an integral or a velocity ramps {within}: a constant error stays; remove the integral or give it an effect",
        )
    if kind == "joint":
        return f"{names} keep{'' if many else 's'} moving", f"nothing holds {names} {within}: add position feedback there"
    if kind == "posture":
        return (
            f"the posture moves ({names}), the tool does not",
            f"nothing holds the posture ({names}) {within}: add null-space damping or a posture task",
        )
    return f"the tool {kind} {names} (tool axes)", f"nothing holds the tool {names} {within}: it {kind}; {_cure(evidence)}"


def _free(evidence: Evidence, i: int) -> str:
    """What is free without drifting at time number i: the directions of which a displacement is left after the horizon; "" where there are none.

    They are those without dead time, which changes them by its fraction of the horizon.
    """
    part, where = evidence.spectrum.parts(i), evidence.equations.parts["q"].where
    left = None if part is None else part.slow.at(evidence.horizon)[where, where]
    if left is None or np.abs(left).max() <= LEFT:
        return ""
    kind, names, many = _way(evidence, i, left)
    within = f"within {evidence.horizon:g} s"
    if kind == "joint":
        stay = "they stay nearly where they are put" if many else "it stays nearly where it is put"
        return f"nothing brings {names} back {within}: {stay}; add position feedback there"
    if kind == "posture":
        return f"nothing brings the posture ({names}) back {within}: it stays nearly where it is put; add a posture task"
    return f"nothing brings the tool back {names} (tool axes) {within}: it stays nearly where it is put; {_cure(evidence)}"


def _cure(evidence: Evidence) -> str:
    surfaces = evidence.equations.surfaces
    return "add a foot (another surface) or motion control in that direction (9.24)" if surfaces else "add position feedback there"


REACH = 0.3  #: [m] that weighs a rotation against a translation


def _named(size: Array, names: Sequence[str]) -> list[str]:
    return [name for name, x in zip(names, size, strict=True) if x > SHARE * size.max()]
