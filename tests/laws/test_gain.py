"""Gains of every shape on plain and dual arrays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.gain import Gain
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.dual import Dual
from mfc_analysis.trajectories import Hold
from tests.conftest import LAWS, arm


@pytest.mark.parametrize("given", [3, 3.0, np.float32(3), [1.0, 2.0, 3.0], np.arange(9.0).reshape(3, 3)], ids=str)
def test_a_gain_acts_as_its_matrix_on_plain_and_dual_arrays(given: object) -> None:
    gain = Gain("kp", given)
    K = gain.matrix(3)
    x, dx = np.array([[1.0, -2.0, 0.5], [0.1, 0.2, 0.3]]), np.random.default_rng(0).normal(size=(2, 3, 4))
    assert_allclose(gain @ x, x @ K.T)
    found = gain @ Dual(x, dx)
    assert_allclose(found.value, x @ K.T)
    assert_allclose(found.tangent, K @ dx)
    assert_allclose(gain.diagonal(3), np.diag(K))
    assert bool(gain)


def test_no_gain_contributes_nothing_and_zero_is_a_gain() -> None:
    none = Gain("ki", None)
    assert not none and (none @ np.ones(3)) == 0.0 and not none.matrix(2).any()
    assert Gain("ki", 0.0)
    assert (Gain("ki", 2.0) @ None) == 0.0


@pytest.mark.parametrize("given", [np.nan, [1.0, np.inf], np.ones((2, 3)), np.ones((2, 2, 2)), "stiff", "3", [[1.0, 2.0]], 1j, {"kp": 1}], ids=str)
def test_what_is_no_gain_is_refused_by_name(given: object) -> None:
    with pytest.raises(BadArgument) as info:
        L.VelocityP(given)
    assert info.value.argument == "kp" and "kp" in str(info.value)


@pytest.mark.parametrize(("law", "argument", "shape"), [
    (L.JointPID([1.0, 2.0, 3.0]), "kp", "(2,)"), (L.JointPID(1.0, np.eye(3)), "ki", "(2, 2)"), (L.ComputedTorque(1.0, kd=[1.0]), "kd", "(2,)"),
    (L.InverseDynamics({"kp": 1.0, "ki": [1.0, 2.0, 3.0]}), "ki", "(2,)"), (L.ComputedTorque(1.0, mass=np.eye(3)), "mass", "(2, 2)"),
    (L.TaskVelocity([1.0, 2.0]), "kp", "(6,)"),
])  # fmt: skip
def test_a_gain_for_another_arm_is_refused_with_the_shape_it_takes(law: L.Law, argument: str, shape: str) -> None:
    with pytest.raises(BadArgument) as info:
        ClosedLoop(arm("planar_2r"), law, Hold([0.1, 0.2]))
    assert info.value.argument == argument and shape in info.value.takes and "shape" in str(info.value.got)


@pytest.mark.parametrize("mass", [np.zeros((2, 2)), [[1.0, 0.5], [0.4, 1.0]], -np.eye(2), [1.0, 2.0], [[1.0, np.nan], [np.nan, 1.0]]], ids=str)
def test_a_mass_that_is_not_symmetric_positive_definite_is_refused(mass: object) -> None:
    for law in (L.ComputedTorque, L.TaskComputedTorque):
        with pytest.raises(BadArgument) as info:
            law(1.0, mass=mass)
        assert info.value.argument == "mass"


def test_a_gain_is_a_copy_that_nobody_changes() -> None:
    k = np.array([1.0, 2.0])
    law = L.JointPID(k)
    k[0] = 99.0
    assert law.kp.array[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        law.kp.array[0] = 5.0


def test_one_and_one_point_zero_are_the_same_gain() -> None:
    a, b = (ClosedLoop(arm("planar_2r"), L.JointPID(k, k, k), Hold([0.1, 0.2])).linearize([0.0]).A for k in (1, 1.0))
    assert np.array_equal(a, b)


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_a_law_says_what_it_is_and_what_its_gains_are(case: object) -> None:
    law = case.law(6)
    assert f"[{law.numbered()}]" in str(law) and type(law).__name__ in str(law)
    assert type(law).__doc__ and type(law).typst and law.sources
    for name, gain in law.gains().items():
        assert not gain or name in type(law).units, f"{name} has no unit"
