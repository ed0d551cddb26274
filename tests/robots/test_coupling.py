"""The relative gain of the joints, and models that lack the inertia of their rotors."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import gains, robots
from mfc_analysis.errors import BadArgument, MfcWarning
from mfc_analysis.robots.coupling import STRONG, lacks_armature, relative_gain, warn_without_armature
from tests.conftest import ROBOTS, arm, regular_pose, seed

LIGHT = {"panda": [-2.2, 0.6, 0.9, -1.2, -0.7, 2.5, 2.5], "xarm7": [0.0] * 7}


@pytest.mark.parametrize("name", ROBOTS)
def test_the_relative_gain_is_the_ratio_of_the_inertia_with_the_others_held_and_free(name: str) -> None:
    robot, q = arm(name), regular_pose(name)
    found, M = relative_gain(robot, q), robot.mass(q)
    assert found.shape == (robot.n,) and np.all(found >= 1 - 1e-12)
    for j in range(robot.n):
        rest = [i for i in range(robot.n) if i != j]
        free = M[j, j] - M[j, rest] @ np.linalg.solve(M[np.ix_(rest, rest)], M[rest, j])  # the others accelerate as they like
        assert_allclose(found[j], M[j, j] / free, rtol=1e-8)
    many = np.array([[q, q + 0.1], [q - 0.1, q]])
    assert_allclose(relative_gain(robot, many)[1, 1], found)


def test_seven_joint_models_of_their_makers_lack_rotor_inertia_and_the_ur5_at_work_does_not() -> None:
    for name, q in LIGHT.items():
        robot = arm(name)
        worst = relative_gain(robot, q)
        said = lacks_armature(robot, q)
        assert worst.max() > 10 and f"{worst.max():.3g}" in said and repr(robot.joint_names[int(worst.argmax())]) in said
        assert "the URDF lacks rotor inertia; give armature" in said
        assert lacks_armature(robot, [np.array(q), np.array(q) + 0.01]) != ""
        assert lacks_armature(robot.with_armature(0.3), q) == "" and relative_gain(robot.with_armature(0.3), q).max() < 3
    rng = seed("poses")
    assert max(relative_gain(arm("panda"), rng.uniform(*arm("panda").limits.position.T, (400, 7))).max(axis=0)) > 25
    assert lacks_armature(robots.ur5(), [0.1, -1.2, 1.4, -0.8, 1.3, 0.2]) == ""
    assert relative_gain(robots.ur5(), [0.1, -1.2, 1.4, -0.8, 1.3, 0.2]).max() < STRONG


def test_the_sentence_stands_on_either_side_of_its_threshold() -> None:
    """A double pendulum: the more it is bent, the less its links are coupled."""
    from scipy.optimize import brentq

    robot = robots.load("double_pendulum")
    edge = float(brentq(lambda bend: relative_gain(robot, [0.2, bend]).max() - STRONG, 0.0, 1.5))
    assert lacks_armature(robot, [0.2, edge + 1e-6]) == "" != lacks_armature(robot, [0.2, edge - 1e-6])
    assert lacks_armature(robot.with_armature([1e-9, 0.0]), [0.2, 0.0]) != ""  # one joint without
    assert lacks_armature(robot.with_armature(1e-9), [0.2, 0.0]) == ""  # coupled, but the rotors are given


def test_it_is_a_warning_and_of_joint_pid_as_well() -> None:
    robot, q = arm("xarm7"), LIGHT["xarm7"]
    with pytest.warns(MfcWarning, match="lacks rotor inertia"):
        warn_without_armature(robot, q)
    with pytest.warns(MfcWarning, match="lacks rotor inertia") as caught:
        gains.joint_pid(robot, q, bandwidth=10.0)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gains.joint_pid(robot.with_armature(0.3), q, bandwidth=10.0)
        warn_without_armature(robots.ur5(), [0.1, -1.2, 1.4, -0.8, 1.3, 0.2])
    with pytest.raises(BadArgument, match="q"):
        relative_gain(robot, [0.0] * 6)
