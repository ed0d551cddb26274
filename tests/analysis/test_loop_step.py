"""The step response of T = L/(1 + L): closed forms, the loop of python-control, and laws whose two steps are the same."""

import math

import control
import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.analysis.loop_step import STEPS, loop_step
from mfc_analysis.analysis.steps import step
from mfc_analysis.errors import UnknownPoint, Unsupported
from mfc_analysis.linearization.tracking_steps import step_metrics

KP, KI, KD = 90.0, 60.0, 14.0
PID = mfc.laws.ComputedTorque(kp=KP, ki=KI, kd=KD)


def opened(law, robot=None, **hardware):
    robot = robot or mfc.robots.slider(mass=2.0)
    ref = mfc.trajectories.Hold([0.0, 0.3, 0.0, -1.2, 0.0, 1.5, 0.3][: robot.n])
    return mfc.ClosedLoop(robot, law, ref, hardware=mfc.Hardware(**hardware) if hardware else None).linearize()


def of_polynomials(num, den, tolerance=0.02):
    """Settling [s] and overshoot of T = num/(num + den), T(0) = 1, as a sum over simple poles on a fine grid, the last crossing by bisection."""
    closed = np.polyadd(num, den)
    poles = np.roots(closed)
    parts = np.polyval(num, poles) / (poles * np.polyval(np.polyder(closed), poles))

    def error(t):
        return (parts * np.exp(np.multiply.outer(t, poles))).sum(axis=-1).real

    grid = np.linspace(0.0, 16.0 / np.min(-poles.real), 400_001)
    y = error(grid)
    k = int(np.flatnonzero(np.abs(y) > tolerance)[-1])
    low, high = grid[k], grid[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if abs(error(middle)) > tolerance else (low, middle)
    return low, max(y.max(), 0.0)


@pytest.mark.parametrize("lag", [0.0, 4e-3])
@pytest.mark.parametrize("at", ["torque", "command", "position"])
def test_pid_on_a_mass_has_the_step_of_its_polynomials(at, lag):
    lin = opened(PID, **({"torque_lag": lag} if lag else {}))
    system, late = loop_step(lin.opened_for(at), at)
    found = step(system, 0, 0, 0)
    settling, overshoot = of_polynomials([KD, KP, KI], [lag, 1.0, 0.0, 0.0, 0.0] if lag else [1.0, 0.0, 0.0, 0.0])
    assert late.tolist() == [0.0] and found.steady_state == pytest.approx(1.0, abs=1e-12)
    assert found.settling == pytest.approx(settling, rel=1e-9)
    assert found.overshoot == pytest.approx(overshoot, rel=1e-7)  # the maximum of a grid


@pytest.mark.parametrize(("name", "joint"), [("single_joint", 0), ("ur5", 1), ("panda", 2)])
@pytest.mark.parametrize("sampled", [{}, {"sample_time": 2e-3}])
def test_every_channel_steps_as_the_loop_of_python_control_closed_again(name, joint, sampled):
    robot = mfc.robots.load(name)
    lin = opened(mfc.laws.JointPID(400.0, 300.0, 80.0), robot.with_armature(0.5), torque_lag=3e-3, **sampled)
    system, _ = loop_step(lin.opened_for("torque"), "torque")
    found = step(system, 0, joint, joint, 0.5)
    T = control.feedback(lin.loop(0, "torque", joint))
    y = control.forced_response(T, found.t, np.ones_like(found.t)).outputs
    np.testing.assert_allclose(found.y, y, atol=1e-9)


EQUAL = [
    ("velocity", mfc.laws.VelocityP(5.0), {}),
    ("velocity", mfc.laws.VelocityPI(5.0, 4.0), {"velocity_lag": 0.02}),
    ("velocity", mfc.laws.VelocityP(5.0), {"delay": 0.03}),
    ("velocity", mfc.laws.VelocityPI(5.0, 4.0), {"delay": 0.03, "velocity_lag": 0.01}),
    ("velocity", mfc.laws.VelocityP(5.0), {"delay": 0.03, "sample_time": 0.01}),
    ("torque", mfc.laws.JointPID(8.0, 2.0), {"torque_lag": 2e-2, "delay": 4e-2}),
    ("torque", mfc.laws.JointPID(8.0, 2.0), {"delay": 5e-3, "sample_time": 2e-3}),
]


@pytest.mark.parametrize(("at", "law", "hardware"), EQUAL)
def test_the_two_steps_are_one_where_the_law_sees_the_error_alone(at, law, hardware):
    """The reference enters where the loop step does, and dead time delays both: one response, computed from other inputs and outputs."""
    lin = opened(law, mfc.robots.slider(mass=1.0, friction=6.0), **hardware)
    reference, loop = step_metrics(lin), step_metrics(lin, "loop", at)
    np.testing.assert_allclose(loop.settling, reference.settling, rtol=1e-6 if lin.delay else 1e-9)  # the method of steps: fourth order
    np.testing.assert_allclose(loop.overshoot, reference.overshoot, rtol=1e-6, atol=1e-9)
    assert np.isfinite(loop.settling).all() and (loop.settling > 0).all()


def test_a_pure_gain_through_dead_time_has_the_closed_form_of_the_method_of_steps():
    """y' = k (1 - y(t - T)) after T; with k T = 0.2 the polynomials of the first sections reach the band before they repeat it."""
    k, T = 5.0, 0.04
    found = step_metrics(opened(mfc.laws.VelocityP(k), delay=T), "loop", "velocity")

    def y(t):
        # sum over the sections: 1 - e, e = sum_j (-k)^j (t - j T)^j / j! for t > j T
        return 1 - sum((-k) ** j * (t - j * T) ** j / math.factorial(j) for j in range(int(t / T) + 1))

    low, high = 0.2, 3.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 1 - y(middle) > 0.02 else (low, middle)
    assert found.settling[0, 0] == pytest.approx(low, rel=1e-6)
    assert found.overshoot[0, 0] == 0.0


def test_an_encoder_step_through_dead_time_needs_a_filter_and_says_so():
    with pytest.raises(Unsupported, match="velocity filter"):
        loop_step(opened(PID, delay=2e-3).opened_for("position"), "position")
    lin = opened(PID, delay=2e-3, velocity_filter=5e-3)
    assert step_metrics(lin, "loop", "position").settling[0, 0] == pytest.approx(step_metrics(lin, "loop", "torque").settling[0, 0], rel=1e-5)
    with pytest.raises(UnknownPoint):
        loop_step(opened(PID, sample_time=1e-3).opened, "position")


def test_channels_without_a_loop_are_left_out():
    robot = mfc.robots.ur5()
    q = np.array([0, -0.9, 1.6, -0.7, 1.57, 0.0])
    law = mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], kfp=1.0, kfi=2.0, kdamp=50.0)
    loop = mfc.ClosedLoop(robot, law, mfc.trajectories.Hold(q), environment=mfc.Environment(1e4, damping=10.0, preload=10.0))
    assert loop_step(loop.linearize().opened, "force")[0].input_names == ("fx", "fy", "fz")  # fx and fy: the damping of the surface
    idle = mfc.laws.JointPID([8.0, 0.0], kd=[2.0, 0.0])
    held = mfc.ClosedLoop(mfc.robots.planar_2r(), idle, mfc.trajectories.Hold([0.3, 0.2]))
    assert loop_step(held.linearize().opened, "torque")[0].output_names == mfc.robots.planar_2r().joint_names[:1]
    assert set(STEPS) == {"reference", "loop"}
