"""Sampled controllers as they are coded: sums, differences of the encoder, difference equations; against z-transforms and a loop written out."""

from __future__ import annotations

import pickle
from itertools import product

import control
import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.dynamics.coded import PRESENT
from mfc_analysis.errors import BadArgument, UnknownPoint, Unsupported
from tests.conftest import arm, regular_pose

T, INERTIA, DAMPING = 5e-3, 0.7, 0.4
KP, KI, KD, TF = 60.0, 90.0, 9.0, 8e-3
RULES = [(i, d, f) for i, d, f in product(PRESENT, (None, *PRESENT), (None, TF)) if f or d in (None, "backward")]


def joint(damping: float = DAMPING) -> mfc.Robot:
    return mfc.robots.single_joint(inertia=INERTIA, mass=0.0, damping=damping)


def loop(integral: str, derivative: str | None, filter_: float | None, delay: float | None = None) -> mfc.ClosedLoop:
    hardware = mfc.Hardware(sample_time=T, integral_rule=integral, derivative_rule=derivative, velocity_filter=filter_, delay=delay)
    return mfc.ClosedLoop(joint(), mfc.laws.JointPID(KP, KI, KD), mfc.trajectories.Hold([0.3]), hardware=hardware)


def held_plant() -> control.StateSpace:
    """(q, v) of the joint from its torque, held over a sample."""
    A = np.array([[0.0, 1.0], [0.0, -DAMPING / INERTIA]])
    return control.c2d(control.ss(A, [[0.0], [1 / INERTIA]], np.eye(2), np.zeros((2, 1))), T)


@pytest.mark.parametrize(("integral", "derivative", "filter_"), RULES)
def test_poles_are_those_of_the_z_transforms(integral: str, derivative: str | None, filter_: float | None) -> None:
    plant, one = held_plant(), np.array([1.0, -1.0])  # z - 1
    den = np.poly(plant.A)
    of_q, of_v = (np.poly(plant.A - plant.B @ plant.C[i : i + 1]) - den for i in range(2))  # numerators, by the determinant lemma
    b, tf = PRESENT[integral], filter_ or 0.0
    if derivative is not None:
        d = PRESENT[derivative]
        num_d, den_d, seen = one, np.array([tf + d * T, -(tf - (1 - d) * T)]), of_q
    elif filter_ is None:
        num_d, den_d, seen = np.ones(1), np.ones(1), of_v
    else:  # the filter's zero-order-hold equivalent, one sample old
        num_d, den_d, seen = np.array([1 - np.exp(-T / tf)]), np.array([1.0, -np.exp(-T / tf)]), of_v
    pi = np.polyadd(KP * one, KI * T * np.array([b, 1 - b]))
    expected = np.convolve(np.convolve(den, one), den_d)
    expected = np.polyadd(expected, np.convolve(np.convolve(of_q, pi), den_d))
    expected = np.polyadd(expected, np.convolve(np.convolve(seen, KD * num_d), one))
    found = loop(integral, derivative, filter_).linearize([0.0]).poles()[0]
    found = found[np.argsort(-np.abs(found))][: len(expected) - 1]  # of a filtered difference the last encoder value is a state at 0
    np.testing.assert_allclose(np.poly(found), expected / expected[0], atol=1e-9)


@pytest.mark.parametrize(("rule", "filter_"), [("backward", None), ("tustin", TF), ("forward", TF)])
def test_a_run_is_the_loop_written_out(rule: str, filter_: float | None) -> None:
    plant, tf, b = held_plant(), filter_ or 0.0, PRESENT[rule]
    x, total, before, d, last = np.array([0.1, 0.5]), 0.0, 0.1 - T * 0.5, 0.5, 0.0
    path = [x]
    for _ in range(200):
        e = 0.3 - x[0]
        total += T * {"backward": e, "tustin": (e + last) / 2, "forward": last}[rule]
        d = ((tf - (1 - b) * T) * d + x[0] - before) / (tf + b * T)
        before, last = x[0], e
        x = plant.A @ x + plant.B[:, 0] * (KP * e + KI * total - KD * d)
        path.append(x)
    sim = loop(rule, rule, filter_).simulate(T * np.arange(201), q=[0.1], v=[0.5], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(np.column_stack([sim.q[:, 0], sim.v[:, 0]]), path, atol=1e-8)


def test_the_encoder_of_differences_can_be_opened_and_its_margins_are_boundaries() -> None:
    lin = loop("tustin", "backward", TF, delay=3e-3).linearize([0.0])
    margins, L = lin.margins("position"), lin.loop(0, at="position")
    for end, inside in ((margins.gain_increase[0, 0], 0.999), (margins.gain_reduction[0, 0], 1.001)):
        for k, decays in ((inside * end, True), ((2 - inside) * end, False)):
            z = np.linalg.eigvals(L.A - k * L.B @ L.C / (1 + k * L.D[0, 0]))
            assert bool(np.abs(z).max() < 1) == decays
    with pytest.raises(UnknownPoint, match="torque"):
        loop("tustin", None, None).linearize([0.0]).margins("position")


def test_a_difference_equation_as_outer_loop_is_the_same_pid() -> None:
    """A forward sum and a filtered backward difference as one transfer function of e: the poles of the PID by rules, on a joint without friction."""
    kp, ki, kd = 80.0, 120.0, 15.0
    one = np.array([1.0, -1.0])
    outer = kp + control.tf([ki * T], one, T) + control.tf(kd * one, [TF + T, -TF], T)

    def closed(law: mfc.laws.Law, **rules: object) -> mfc.ClosedLoop:
        hardware = mfc.Hardware(sample_time=T, delay=3e-3, **rules)
        return mfc.ClosedLoop(joint(0.0), law, mfc.trajectories.Hold([0.3]), hardware=hardware)

    ours = closed(mfc.laws.InverseDynamics(outer))
    theirs = closed(mfc.laws.JointPID(INERTIA * kp, INERTIA * ki, INERTIA * kd), derivative_rule="backward", velocity_filter=TF)
    found, expected = (np.sort_complex(x.linearize([0.0]).poles()[0]) for x in (ours, theirs))
    np.testing.assert_allclose(found, expected[np.abs(expected) > 1e-9], rtol=1e-8)
    again = pickle.loads(pickle.dumps(ours.law)).changed()
    np.testing.assert_array_equal(np.sort_complex(closed(again).linearize([0.0]).poles()[0]), found)
    t = T * np.arange(101)
    runs = [x.simulate(t, disturbance=[0.5], rtol=1e-10, atol=1e-12).q for x in (ours, theirs)]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-8)
    with pytest.raises(Unsupported, match=r"0\.005"):
        mfc.ClosedLoop(joint(), mfc.laws.InverseDynamics(outer), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(sample_time=1e-3))
    with pytest.raises(BadArgument, match="without its dt"):
        mfc.laws.InverseDynamics(control.tf([1.0], [1.0, 0.5], True))


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_the_linear_model_of_coded_controllers_has_a_remainder_of_second_order(name: str) -> None:
    robot, q = arm(name), regular_pose(name)
    hardware = mfc.Hardware(sample_time=4e-3, delay=2e-3, integral_rule="tustin", derivative_rule="backward", velocity_filter=5e-3)
    law, model = mfc.laws.ComputedTorque(100.0, 50.0, 20.0), robot.with_inertia_scaled(0.9)
    closed = mfc.ClosedLoop(robot, law, mfc.trajectories.Hold(q), controller_model=model, hardware=hardware)
    assert closed.linearize([0.0]).stable[0]
    assert closed.validate(time=0.3).taylor_order == pytest.approx(2.0, abs=0.05)


def test_rules_without_a_sample_time_or_a_filter_are_refused() -> None:
    for given in ({"integral_rule": "tustin"}, {"derivative_rule": "backward"}):
        with pytest.raises(BadArgument, match="sample_time"):
            mfc.Hardware(**given)
    for rule in ("forward", "tustin"):
        with pytest.raises(BadArgument, match="velocity_filter"):
            mfc.Hardware(sample_time=T, derivative_rule=rule)
    with pytest.raises(BadArgument, match="backward"):
        mfc.Hardware(sample_time=T, integral_rule="euler")
    every = mfc.Hardware(sample_time=T, derivative_rule="backward", delay=1e-3).every(None)
    assert (every.sample_time, every.derivative_rule, every.delay) == (None, None, 1e-3)
    with pytest.raises(Unsupported, match="derivative_rule"):
        hardware = mfc.Hardware(sample_time=T, derivative_rule="backward")
        mfc.ClosedLoop(joint(), mfc.laws.VelocityPI(3.0, 1.0), mfc.trajectories.Hold([0.0]), hardware=hardware)
