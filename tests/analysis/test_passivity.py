"""Passivity: closed forms on one mass, exact crossings, the damping that is missing, and both sides of the verdict on random loops."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.analysis.passivity import Passive, Passivity, passivity
from mfc_analysis.analysis.stability import stability
from mfc_analysis.errors import BadArgument
from mfc_analysis.linearization.port import port_system
from tests.conftest import regular_pose
from tests.plots.drawn import lines, uprights
from tests.soak.passivity import judged, random_loop

M, KP, KD = 2.0, 300.0, 20.0
HOLD = mfc.trajectories.Hold([0.0])


def slider(law: mfc.laws.Law, friction: float = 0.0, **hardware: float) -> mfc.Linearization:
    model = mfc.robots.slider(M)
    loop = mfc.ClosedLoop(mfc.robots.slider(M, friction), law, HOLD, controller_model=model, hardware=mfc.Hardware(**hardware))
    return loop.linearize()


@pytest.mark.parametrize("law", [mfc.laws.JointPID(KP, None, KD), mfc.laws.ComputedTorque(KP / M, None, KD / M)], ids=["9.8", "9.10"])
@pytest.mark.parametrize("at", ["tool", "joints"])
def test_a_mass_a_spring_and_a_damper_are_passive_and_show_the_damper(law: mfc.laws.Law, at: str) -> None:
    found = slider(law).passivity(at)
    assert found.passive.tolist() == [True] and found.outcome == (Passive.PASSIVE,)
    assert_allclose(found.shown[0], KD, rtol=1e-5)  # Z = m s + kd + kp/s
    assert found.damping[0] == 0 and not found.crossings[0].size and np.isnan(found.damping_frequency[0])


@pytest.mark.parametrize("part", [0.99, 1.01])
def test_with_a_lag_the_sign_is_that_of_kd_minus_kp_T(part: float) -> None:
    """Z = m s + b + (kd s + kp)/(s (1 + T s)): its real part is b + (kd - kp T)/(1 + T^2 w^2)."""
    T, b = 0.1, 4.0
    kd = KP * T - b / part  # needs a damper of b/part at w -> 0; the friction is b
    found = slider(mfc.laws.JointPID(KP, None, kd), b, torque_lag=T).passivity()
    w, shown = found.frequencies[0], found.shown[0]
    assert_allclose(shown, b + (kd - KP * T) / (1 + (T * w) ** 2), rtol=1e-6, atol=1e-7)
    assert found.passive[0] == (part > 1)
    if part < 1:
        assert_allclose(found.crossings[0], [np.sqrt((KP * T - kd) / b - 1) / T], rtol=1e-8)
        assert_allclose(found.damping[0], KP * T - kd - b, rtol=1e-4)
        assert found.damping_frequency[0] == pytest.approx(0.01, rel=0.2)  # from 1/horizon on


def test_an_integral_is_not_passive_below_a_known_frequency() -> None:
    """Re Z = kd - ki/w^2: the crossing is sqrt(ki/kd), and at 1/horizon the damper is ki horizon^2 - kd."""
    found = slider(mfc.laws.JointPID(KP, 100.0, KD)).passivity()
    assert found.outcome == (Passive.NOT_PASSIVE,)
    assert_allclose(found.crossings[0], [np.sqrt(100.0 / KD)], rtol=1e-10)
    assert_allclose(found.damping[0], 100.0 * 100.0**2 - KD, rtol=1e-9)
    w = found.frequency[0]
    Y = 1 / (M * 1j * w + KD + KP / (1j * w) - 100.0 / w**2)
    assert_allclose(found.smallest[0], 2 * Y.real, rtol=1e-9)
    assert_allclose(np.abs(found.direction[0]), [0, 0, 1, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(("friction", "passive"), [(19.9, False), (20.3, True)])
def test_with_dead_time_the_friction_has_to_outweigh_kd(friction: float, passive: bool) -> None:
    """Re Z = b + kd cos wT - kp sin(wT)/w: below zero near every odd turn unless b > kd; the dip of the first one is deeper by 2e-3."""
    T = 3e-3
    found = slider(mfc.laws.JointPID(KP, None, KD), friction, delay=T).passivity()
    w = np.linspace(1e-2, 1e4, 2_000_001)
    least = (friction + KD * np.cos(w * T) - KP * np.sin(w * T) / w).min()
    assert found.passive[0] == passive == (least > 0)
    if not passive:
        assert_allclose(found.damping[0], -least, rtol=1e-4)
        dips = friction + KD * np.cos(w * T) - KP * np.sin(w * T) / w
        mine = w[np.flatnonzero((dips[1:] < 0) != (dips[:-1] < 0))]
        assert_allclose(found.crossings[0][: mine.size], mine, rtol=1e-5)


def pressing(robot: mfc.Robot, q: np.ndarray, axes: str) -> Passivity:
    law = mfc.laws.DampedForcePI([0, 0, 5.0, 0, 0, 0], [2.0, 0, 0, 0, 0, 0], None, 50.0)
    wall = mfc.Environment(500.0, 10.0, axes=axes)
    return mfc.ClosedLoop(robot, law, mfc.trajectories.Hold(q), environment=wall).linearize(about="equilibrium").passivity()


def test_what_falls_without_end_is_seen_beyond_the_scan() -> None:
    """With a force sensor the mass at the tool is not symmetric, J M^-1 J^T (1 + kfp) being none, so that Re Z falls with w: no damper is enough."""
    found = pressing(mfc.robots.ur5(), np.array([0.1, -1.0, 1.0, 0.3, 0.4, 0.5]), "xyzrxryrz")
    assert found.outcome == (Passive.NOT_PASSIVE,) and found.damping[0] == np.inf and found.damping_frequency[0] == np.inf
    assert "no damper makes it passive" in str(found)


def test_a_force_that_only_the_sensor_feels_leaves_no_damper() -> None:
    """Two joints, three directions: a force that moves nothing but is measured moves the arm elsewhere; Y has no inverse."""
    found = pressing(mfc.robots.planar_2r(), np.array([0.4, 0.9]), "xyz")
    assert found.outcome == (Passive.NOT_PASSIVE,) and found.damping[0] == np.inf and found.smallest[0] < 0


def test_a_loop_that_is_not_stable_is_not_passive_and_has_no_numbers() -> None:
    for law in (mfc.laws.JointPID(KP), mfc.laws.JointPID(KP, None, -1.0)):
        found = slider(law).passivity()
        assert found.outcome == (Passive.UNSTABLE,) and not found.passive.any()
        assert np.isnan([found.damping[0], found.smallest[0], found.highest[0]]).all() and not found.frequencies[0].size


def test_a_support_that_does_not_move_is_passive() -> None:
    found = mfc.ClosedLoop(mfc.robots.slider(M), mfc.laws.VelocityP(4.0), HOLD).linearize().passivity()
    assert found.passive.all() and found.smallest[0] == 0 and not found.frequencies[0].size
    assert found.plot().has_data() is False


@pytest.mark.parametrize(("law", "hardware"), [((KP, 100.0, KD), {}), ((KP, None, KD), {"delay": 3e-3}), ((KP, None, 20.0), {"torque_lag": 0.1})])
def test_the_damping_is_the_smallest_that_makes_it_passive(law: tuple[float, float | None, float], hardware: dict[str, float]) -> None:
    lin = slider(mfc.laws.JointPID(*law), 8.0, **hardware)
    b = float(lin.passivity().damping[0])
    port = port_system(lin.equations, lin.opened, lin.point.x, "tool")
    for part in (0.999, 1.001):
        damped = port.damped(part * b)
        known = replace(stability(damped.opened), stable=np.array([True]))
        assert passivity(damped, "tool", known).passive[0] == (part > 1)


@pytest.mark.parametrize(("inertia", "lag", "passive"), [(None, None, True), (None, 2e-3, True), (0.1, None, True), (0.1, 2e-3, False)])
def test_impedance_control_is_passive_unless_it_hides_inertia_behind_a_lag(inertia: float | None, lag: float | None, passive: bool) -> None:
    law = mfc.laws.Impedance([500.0] * 3 + [20.0] * 3, [50.0] * 3 + [2.0] * 3, inertia)
    hold, hardware = mfc.trajectories.Hold(regular_pose("ur5")), mfc.Hardware(torque_lag=lag)
    found = mfc.ClosedLoop(mfc.robots.ur5(), law, hold, hardware=hardware).linearize().passivity()
    assert found.passive[0] == passive and found.outcome[0] is (Passive.PASSIVE if passive else Passive.NOT_PASSIVE)


@pytest.mark.parametrize("i", range(24))
def test_passive_loops_are_stable_on_springs_and_the_others_are_not_on_some_environment(i: int) -> None:
    rng = np.random.default_rng([7, i])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert judged(random_loop(rng), rng)[1] == ""


def test_a_result_says_and_draws_what_it_found() -> None:
    loop = mfc.ClosedLoop(mfc.robots.slider(M), mfc.laws.JointPID(KP, 100.0, KD), HOLD)
    found = loop.linearize([0.0, 1.0]).passivity()
    text = "passivity at the tool, passive at 0 of 2 times; worst at t = 0 s: not passive: some passive environment makes it unstable; "
    assert str(found).startswith(
        text
    ) and "along 1.00 fz; passes zero at 2.236 rad/s; 1e+06 Ns/m (Nm s/rad) more at the port make it so, needed at 0.01 rad/s" in str(found)
    ElementTree.fromstring(f"<div>{found._repr_html_()}</div>")
    assert "2.2361" in found._repr_html_()
    assert str(pickle.loads(pickle.dumps(found))) == str(found)
    ax = found.plot(-1)
    assert uprights(ax) == pytest.approx([np.sqrt(5.0)])
    assert_allclose(lines(ax)[0], np.column_stack([found.frequencies[1], found.shown[1]]))
    with pytest.raises(BadArgument, match="index"):
        found.plot(2)
    with pytest.raises(BadArgument, match="at"):
        loop.linearize().passivity("elbow")
