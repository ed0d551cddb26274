"""What each imperfection costs: closed forms, the ideal loop and the loop given at the two ends, sums and interactions."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.design.attribution import imperfections, with_imperfections
from mfc_analysis.errors import BadArgument
from tests.design.test_limits import velocity_p
from tests.test_arms import pose

PHASE = mfc.Requirements(phase_deg=45.0)


def test_lag_and_dead_time_take_the_phase_that_the_formulas_say():
    """Velocity P: L = k / (s (T s + 1)) e^(-s d); the phase margin 90 deg - atan(w T) - w d at the crossover w (T w^2 + ... = k)."""
    k, lag, delay = 5.0, 0.05, 0.03
    found = design.attribute(velocity_p(k, velocity_lag=lag, delay=delay), PHASE)
    w = math.sqrt((math.sqrt(1 + 4 * (k * lag) ** 2) - 1) / 2) / lag
    assert found.factors == ("lag", "dead time") and found.ideal[0] == pytest.approx(90.0)
    assert found.first[:, 0] == pytest.approx([math.degrees(math.atan(w * lag)), math.degrees(k * delay)], rel=1e-9)
    assert found.last[:, 0] == pytest.approx([found.joint[0] - math.degrees(k * delay), math.degrees(w * delay)], rel=1e-9)
    assert found.joint[0] == pytest.approx(math.degrees(math.atan(w * lag) + w * delay), rel=1e-9)
    assert found.sum[0] == pytest.approx(float(found.first.sum()))
    assert "sum, each alone" in str(found) and "all together" in str(found)


def arm(name: str = "xarm7") -> mfc.ClosedLoop:
    robot = mfc.robots.load(name).with_armature(0.3)
    law = mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=mfc.hertz(3.0)))
    plant = robot.with_payload(1.0, (0.0, 0.0, 0.05)).with_friction(robot.viscous + 0.5).with_inertia_scaled(1.1)
    hardware = mfc.Hardware(
        torque_lag=2e-3, delay=2e-3, sample_time=2e-3, velocity_filter=1e-3, joint_stiffness=2e4, joint_damping=100.0, motor_inertia=0.1
    )
    return mfc.ClosedLoop(plant, law, mfc.trajectories.Hold(pose(robot, np.random.default_rng(2))), robot, hardware=hardware)


def test_ideal_plus_all_is_the_loop_given_and_ideal_is_the_design():
    loop = arm()
    found = design.attribute(loop, mfc.Requirements(phase_deg=30, sensitivity_peak=3, damping_ratio=0.2))
    assert found.factors == ("lag", "dead time", "sampling", "filter", "flexibility", "payload", "friction", "model error")
    verdict = mfc.Requirements(phase_deg=30, sensitivity_peak=3, damping_ratio=0.2).check(loop, [0.0])
    assert found.given.tolist() == [verdict.line(name).found for name in found.metrics]
    assert np.allclose(found.joint, [found.ideal[0] - found.given[0], found.given[1] - found.ideal[1], found.ideal[2] - found.given[2]])
    assert found.place == tuple(verdict.line(name).where for name in found.metrics)
    ideal = with_imperfections(loop, ())
    assert with_imperfections(loop, found.factors) is loop and imperfections(ideal) == ()
    kp, ki, kd = (float(np.asarray(ideal.law.gains()[name].array)) for name in ("kp", "ki", "kd"))
    poles = np.sort_complex(ideal.linearize().poles()[0])
    assert np.allclose(np.poly(poles[::7]), np.poly(np.roots([1, kd, kp, ki])), rtol=1e-3)  # seven copies of the design's triple pole
    again = pickle.loads(pickle.dumps(found))
    assert str(again) == str(found)


def test_a_payload_that_the_controller_knows_is_taken_from_both():
    loop = arm()
    known = mfc.ClosedLoop(loop.robot, loop.law, loop.ref, loop.robot)
    assert imperfections(known) == ("payload", "friction")
    bare = with_imperfections(known, ["friction"])
    assert bare.robot is bare.equations.model and not bare.robot.payloads
    half = with_imperfections(loop, ["payload"])
    assert half.robot.payloads[0].mass == pytest.approx(1.1) and not half.equations.model.payloads
    q = np.full(7, 0.3)
    model = half.equations.model
    assert np.allclose(model.with_payload(1.1, (0.0, 0.0, 0.05)).mass(q), half.robot.mass(q), rtol=1e-12)  # the model error is off


def test_a_perfect_loop_has_nothing_to_attribute_and_one_imperfection_is_all_of_it():
    none = design.attribute(velocity_p())
    assert none.factors == () and none.joint.tolist() == [0.0] * 4 and none.first.shape == (0, 4) and none.sum.tolist() == [0.0] * 4
    one = design.attribute(velocity_p(delay=0.01), PHASE)
    assert one.first.tolist() == one.last.tolist() == [one.joint.tolist()]


def test_what_is_not_stable_is_not_defined():
    found = design.attribute(velocity_p(delay=1.0), PHASE)
    assert math.isnan(found.joint[0]) and "undefined" in str(found) and found.ideal[0] == pytest.approx(90.0)


def test_bad_arguments_are_named():
    with pytest.raises(BadArgument, match="loop"):
        design.attribute(3)
    with pytest.raises(BadArgument, match="requirements"):
        design.attribute(velocity_p(), {"phase_deg": 3})
    with pytest.raises(BadArgument, match="times"):
        design.attribute(velocity_p(), PHASE, [1.0, 0.0])
