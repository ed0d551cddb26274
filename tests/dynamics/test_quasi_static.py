"""Equation 9.20 beside 9.19."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import Unsupported

Q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.3])
UR5 = mfc.robots.ur5()
F_D = np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
HOLD = mfc.trajectories.Hold(Q)
SLIDE = mfc.trajectories.Hold([0.0])


def test_held_rigidly_an_unknown_payload_is_the_force_error_of_9_21():
    found = mfc.ClosedLoop(UR5.with_payload(1.5), mfc.laws.OpenLoopForce(F_D), HOLD, controller_model=UR5).quasi_static()
    weight = UR5.pose(Q)[:3, :3].T @ [0.0, 0.0, -1.5 * 9.81]  # in the tool frame, what the payload presses besides F_d
    assert_allclose(found.force[:3], F_D[:3] + weight, atol=1e-9)
    assert_allclose(found.error[:3], -weight, atol=1e-9)


@pytest.mark.parametrize("kfp", [0.0, 1.0, 9.0])
def test_proportional_feedback_divides_the_error_by_one_plus_its_gain(kfp):
    open_loop = mfc.ClosedLoop(UR5.with_payload(1.5), mfc.laws.OpenLoopForce(F_D), HOLD, controller_model=UR5).quasi_static()
    found = mfc.ClosedLoop(UR5.with_payload(1.5), mfc.laws.ForcePI(F_D, kfp), HOLD, controller_model=UR5).quasi_static()
    assert_allclose(found.error, open_loop.error / (1 + kfp), atol=1e-9)


def test_the_integral_leaves_no_error():
    found = mfc.ClosedLoop(UR5.with_payload(1.5), mfc.laws.ForcePI(F_D, 1.0, 2.0), HOLD, controller_model=UR5).quasi_static()
    assert_allclose(found.error, 0.0, atol=1e-12)


def test_on_a_surface_it_is_the_rest_point_of_the_whole_loop():
    wall = mfc.Environment(2e3, preload=0.0)
    loop = mfc.ClosedLoop(mfc.robots.slider(2.0), mfc.laws.ForcePI(F_D, 0.5), SLIDE, environment=wall)
    assert_allclose(loop.quasi_static().force, loop.equilibrium().force, atol=1e-9)
    assert_allclose(loop.quasi_static().force, F_D, atol=1e-9)


def test_the_departure_is_the_inertia_the_quasi_static_model_leaves_out():
    m, k, kfp, kdamp = 2.0, 2e3, 0.5, 20.0
    loop = mfc.ClosedLoop(mfc.robots.slider(m), mfc.laws.DampedForcePI(F_D, kfp, None, kdamp), SLIDE, environment=mfc.Environment(k, preload=20.0))
    w = np.array([0.1, 1.0, 30.0, 300.0])
    s = 1j * w
    whole = k * (1 + kfp) / (m * s**2 + kdamp * s + k * (1 + kfp))
    slow = k * (1 + kfp) / (kdamp * s + k * (1 + kfp))
    found = loop.quasi_static().departure(w)
    assert_allclose(found, np.abs(whole - slow), rtol=1e-9)
    assert found[0] < 1e-5 and found[-1] > 0.05


def test_velocity_laws_and_loops_without_a_surface_are_refused_in_words():
    with pytest.raises(Unsupported, match="torque inputs"):
        mfc.ClosedLoop(UR5, mfc.laws.VelocityP(1.0), HOLD).quasi_static()
    with pytest.raises(Unsupported, match="environment"):
        mfc.ClosedLoop(UR5, mfc.laws.ForcePI(F_D, 1.0), HOLD).quasi_static().departure([1.0])
