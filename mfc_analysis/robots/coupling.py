"""Inertial coupling of the joints, and the sign of a model that lacks the inertia of its rotors."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import MfcWarning
from mfc_analysis.maths.arrays import Array

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot

STRONG = 5.0  #: [-] relative gain above which a model without armature is suspicious


def relative_gain(robot: Robot, q: ArrayLike) -> Array:
    """Relative gain M_jj (M^-1)_jj of each joint, at least 1: the factor by which its inertia drops if the other joints are free.

    Args:
        robot: with its armature. q: (..., n) poses [rad or m].

    Returns (..., n) [-]: 1 for a joint that is not coupled to the others through the mass matrix. Raises ``BadArgument`` for a q of another
    shape. An independent-joint loop (9.8) is designed on M_jj, but at high frequencies it acts on 1/(M^-1)_jj: its gain is larger by this factor.
    Source: Bristol, IEEE Trans. Automatic Control 11 (1966), "On a new measure of interaction for multivariable process control".
    """
    M = robot.mass(q)
    return np.asarray(np.diagonal(M, axis1=-2, axis2=-1) * np.diagonal(np.linalg.inv(M), axis1=-2, axis2=-1), float)


def lacks_armature(robot: Robot, q: ArrayLike) -> str:
    """A sentence with joint and number if the model of ``robot`` lacks rotor inertia, else "".

    The model lacks it if some joint has no armature and a relative gain exceeds 5 at one of the poses q (..., n). A geared motor adds its rotor
    inertia times the gear ratio squared to M_jj alone, which lowers the relative gain of most real arms to between 1 and 2.
    """
    gain = relative_gain(robot, q).reshape(-1, robot.n).max(axis=0)
    j = int(np.argmax(gain))
    if gain[j] <= STRONG or np.all(robot.armature > 0):
        return ""
    return (
        f"{robot.name}: the URDF lacks rotor inertia; give armature: M_jj (M^-1)_jj of joint {robot.joint_names[j]!r} reaches {gain[j]:.3g} "
        f"(above {STRONG:g}), so loops designed for each joint alone are far from those of the arm"
    )


def warn_without_armature(robot: Robot, q: ArrayLike) -> None:
    """Warns (``MfcWarning``) the caller of the calling function with the sentence of ``lacks_armature``, if there is one."""
    if said := lacks_armature(robot, q):
        warnings.warn(said, MfcWarning, stacklevel=3)
