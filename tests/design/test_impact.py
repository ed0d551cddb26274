"""Touching a surface at speed: one mass in closed form, the balance of energy through impacts, and what is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis.design import impact
from mfc_analysis.design.impact import Impact, at_the_touch
from mfc_analysis.errors import BadArgument, UnknownName
from tests.conftest import Case, named, regular_pose

M, K = 2.0, 1e4
NOTHING, PRESS = np.zeros(6), np.array([0, 0, 5.0, 0, 0, 0])
HOLD = mfc.trajectories.Hold([0.0])


def slider(law: mfc.laws.Law, damping: float = 0.0, preload: float = 0.0, stiffness: float = K, **hardware: float) -> mfc.ClosedLoop:
    wall = mfc.Environment(stiffness, damping, axes="z", preload=preload, one_sided=True)
    return mfc.ClosedLoop(mfc.robots.slider(M), law, HOLD, environment=wall, hardware=mfc.Hardware(**hardware))


FORCE = slider(mfc.laws.DampedForcePI(PRESS, 0.5, 3.0, 20.0), 20.0, 5.0)


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6])
def test_a_free_mass_feels_v_sqrt_km_and_leaves_once(stiffness: float) -> None:
    speeds = np.array([0.01, 0.1, 1.0])
    found = impact(slider(mfc.laws.OpenLoopForce(NOTHING), stiffness=stiffness), speeds, duration=0.6)
    assert_allclose(found.peak[0], speeds * np.sqrt(stiffness * M), rtol=1e-6)
    assert (found.bounces == 1).all() and np.isnan(found.settling).all() and (found.last == 0).all()


def test_a_damper_meets_the_mass_with_its_full_force_at_the_touch() -> None:
    """m x'' + c x' + k x = 0, x' = v: with a large c the largest force is c v, at once."""
    c, v = 600.0, 0.1
    found = impact(slider(mfc.laws.OpenLoopForce(NOTHING), c), [v], duration=0.1)
    assert_allclose(found.peak, c * v, rtol=1e-5)


@pytest.mark.parametrize("law", [mfc.laws.OpenLoopForce(PRESS), mfc.laws.JointPID(500.0, None, 5.0)], ids=["9.21", "9.8"])
def test_energy_is_balanced_through_the_impacts_of_one_mass(law: mfc.laws.Law) -> None:
    """Kinetic + wall + spring of the law - work of the thrust + what wall and law dissipate: the same before and after, to 1e-5."""
    c, v = 8.0, 0.3
    loop = slider(law, c)
    x0 = at_the_touch(loop, 0, 2, v)
    run = loop.simulate([0.0, 0.6], x=x0, rtol=1e-9, atol=1e-12)
    marks = np.array([event.time for event in run.events])
    assert marks.size >= 3
    t = np.unique(np.concatenate([np.linspace(0, 0.6, 60001), marks, marks - 1e-12, marks + 1e-12]))
    x, speed = run.state(t)[:, :2].T
    force = loop.equations.touch(loop.equations.split(run.state(t)), lose_contact=True).wrench[:, 2]
    depth = np.maximum(x, 0)
    kp, kd, thrust = (500.0, 5.0, 0.0) if isinstance(law, mfc.laws.JointPID) else (0.0, 0.0, 5.0)
    lost = np.trapezoid(kd * speed**2 + (force - K * depth) * speed, t)
    energy = M * speed**2 / 2 + K * depth**2 / 2 + kp * x**2 / 2 - thrust * x
    assert speed[0] == pytest.approx(v, rel=1e-12) and x[0] == pytest.approx(-1e-6 * v, rel=1e-2)
    assert energy[-1] + lost == pytest.approx(energy[0], rel=1e-5)
    found = impact(loop, [v], duration=0.6)
    assert found.bounces[0, 0] == sum(event.kind == "lift" for event in run.events)
    assert_allclose(found.peak[0, 0], force.max(), rtol=1e-5)


def test_energy_is_balanced_through_the_impacts_of_an_arm() -> None:
    robot, q = mfc.robots.ur5(), regular_pose("ur5")
    wall = mfc.Environment(1e5, axes="z", preload=5.0, one_sided=True)
    loop = mfc.ClosedLoop(robot, mfc.laws.DampedForcePI(PRESS, 0.5, 3.0, 200.0), mfc.trajectories.Hold(q), environment=wall)
    run = loop.simulate(np.linspace(0, 0.2, 40001), x=at_the_touch(loop, 0, 2, 0.1), rtol=1e-9, atol=1e-12)
    assert any(event.kind == "lift" for event in run.events)
    power = ((run.tau - np.stack([robot.gravity(one) for one in run.q])) * run.v).sum(axis=1) - (run.force * run.twist).sum(axis=1)
    kinetic = [run.v[i] @ robot.mass(run.q[i]) @ run.v[i] / 2 for i in (0, -1)]
    assert kinetic[1] - kinetic[0] == pytest.approx(np.trapezoid(power, run.t), abs=1e-5 * kinetic[0])


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_the_tool_meets_the_surface_at_the_speed_along_the_normal_and_does_not_turn(name: str) -> None:
    robot, q = mfc.robots.ur5() if name == "ur5" else mfc.robots.load(name), regular_pose(name)
    X = robot.pose(q)
    wall = mfc.Environment(1e4, pose=X, axes="yz", preload=[0.0, 8.0], one_sided=True)
    loop = mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(90.0, 40.0, 18.0), mfc.trajectories.Hold(q), environment=wall)
    x = at_the_touch(loop, 0, 2, 0.2)
    there, n = x[: robot.n], robot.n
    assert (X[:3, :3].T @ (robot.pose(there)[:3, 3] - X[:3, 3]))[2] == pytest.approx(-8.0 / 1e4 - 2e-7, abs=1e-9)
    twist = robot.jacobian(there) @ x[n : 2 * n]
    assert_allclose(twist, np.concatenate([robot.pose(there)[:3, :3].T @ X[:3, 2] * 0.2, np.zeros(3)]), atol=1e-9)


def test_without_a_bounce_it_settles_as_the_linear_loop_does() -> None:
    loop = slider(mfc.laws.DampedForcePI(PRESS, 0.5, 3.0, 20.0), 20.0, 5.0, 1e3)
    found = impact(loop, [0.01], duration=2.0)
    assert found.bounces[0, 0] == 0 and found.last[0, 0] == pytest.approx(5.0, rel=1e-3)
    # x from the touch, the force integral z: m x'' = 1.5 (5 - F) + 5 - 5 + 5 + 3 z - 20 x' - F, F = k x + c x'
    k, c = 1e3, 20.0
    A = np.array([[0, 1, 0, 0], [-1.5 * k / M, -(1.5 * c + 20) / M, 3 / M, 7.5 / M], [-k, -c, 0, 5.0], [0, 0, 0, 0]])
    t = np.linspace(0, 2, 4001)
    x = np.stack([expm(A * one) @ [0, 0.01, 0, 1] for one in t])
    F = k * x[:, 0] + c * x[:, 1]
    assert found.peak[0, 0] == pytest.approx(F.max(), rel=1e-4)
    late = t[np.flatnonzero(np.abs(F - 5.0) > 0.25)[-1] + 1]
    assert found.settling[0, 0] == pytest.approx(late, abs=3e-3)


@pytest.mark.parametrize(("form", "inertia"), [("standard", 1.0), ("printed", 2.0)])
def test_an_arm_meets_steel_with_the_mass_that_it_shows_along_the_normal(form: str, inertia: float) -> None:
    """1/(J M^-1 J^T)_zz; under the printed 9.9, which has the q'' of the arm in its torque, the inertia is M + M^: twice as much."""
    robot, q, k, v = mfc.robots.ur5(), regular_pose("ur5"), 1e6, 0.05
    J = robot.jacobian(q)
    mass = 1 / (J @ np.linalg.inv(robot.mass(q)) @ J.T)[2, 2]
    wall = mfc.Environment(k, axes="z", preload=3.0, one_sided=True)
    loop = mfc.ClosedLoop(robot, mfc.laws.TorqueFeedforward(form), mfc.trajectories.Hold(q), environment=wall)
    found = impact(loop, [v], duration=0.02)
    assert found.peak[0, 0] == pytest.approx(v * np.sqrt(k * mass * inertia), rel=1e-2) and found.bounces[0, 0] == 1


@pytest.mark.parametrize("case", named("9.8", "9.10 standard", "9.16 null", "9.22", "9.24 dynamic standard", "impedance shaped"), ids=str)
def test_every_kind_of_law_meets_a_surface(case: Case) -> None:
    robot, q = mfc.robots.ur5(), regular_pose("ur5")
    wall = mfc.Environment(1e6, axes="z", preload=3.0, one_sided=True)
    found = impact(mfc.ClosedLoop(robot, case.law(6), mfc.trajectories.Hold(q), environment=wall), [0.05], duration=0.02)
    J = robot.jacobian(q)
    free = 0.05 * np.sqrt(1e6 / (J @ np.linalg.inv(robot.mass(q)) @ J.T)[2, 2])
    assert 0.7 * free < found.peak[0, 0] < 1.2 * free and not found.failed  # within the 5 ms of the contact a law changes little


@pytest.fixture(scope="module")
def mapped() -> Impact:
    return impact(FORCE, [0.02, 0.1], [1e3, 1e5], duration=1.0)


def test_a_map_grows_with_speed_and_stiffness_and_keeps_the_force_at_the_reference(mapped: Impact) -> None:
    assert (np.diff(mapped.peak, axis=0) > 0).all() and (np.diff(mapped.peak, axis=1) > 0).all()
    assert_allclose(mapped.last, 5.0, rtol=2e-2)
    assert mapped.bounces[1, 1] > mapped.bounces[0, 1] == 0
    assert mapped.force.shape == (2, 2, mapped.times.size)
    assert (mapped.force.max(axis=2) <= mapped.peak * (1 + 1e-9)).all()


def test_several_processes_give_the_same_numbers() -> None:
    alone, together = (impact(FORCE, [0.1], [1e3, 1e4], duration=0.05, n_jobs=n) for n in (1, 2))
    assert np.array_equal(alone.peak, together.peak) and np.array_equal(alone.force, together.force)


def test_a_map_says_shows_and_draws_itself(mapped: Impact) -> None:
    text = "impact at 2 speeds from 0.02 to 0.1 m/s on 2 stiffnesses from 1000 to 1e+05 N/m: peak force "
    assert str(mapped).startswith(text) and "N at 1e+05 N/m and 0.1 m/s, at most" in str(mapped)
    page = mapped._repr_html_()
    ElementTree.fromstring(f"<div>{page}</div>")
    assert page.count("<tr>") == 5
    assert str(pickle.loads(pickle.dumps(mapped))) == str(mapped)
    assert [line.get_label() for line in mapped.plot().get_lines()] == ["1e+03 N/m", "1e+05 N/m"]
    assert_allclose(mapped.plot("bounces").get_lines()[1].get_ydata(), mapped.bounces[1])
    names = ("peak", "bounces", "settling", "last", "force")
    one_speed = replace(mapped, speeds=mapped.speeds[:1], **{name: getattr(mapped, name)[:, :1] for name in names})
    assert one_speed.plot().get_xlabel() == "stiffness [N/m]"
    alone = replace(one_speed, stiffness=mapped.stiffness[:1], **{name: getattr(one_speed, name)[:1] for name in names})
    assert_allclose(alone.plot().get_lines()[0].get_ydata(), mapped.force[0, 0])
    with pytest.raises(UnknownName, match="quantity"):
        mapped.plot("speed")


@pytest.mark.parametrize("hardware", [{"delay": 2e-3}, {"sample_time": 2e-3}, {"torque_lag": 3e-3}], ids=str)
def test_hardware_is_in_the_run(hardware: dict[str, float]) -> None:
    loop = replace(FORCE, hardware=mfc.Hardware(**hardware))
    found = impact(loop, [0.02], duration=0.1)
    run = loop.simulate(0.1, x=at_the_touch(loop, 0, 2, 0.02), rtol=1e-8, atol=1e-11)
    assert found.peak[0, 0] == pytest.approx(run.force[:, 2].max(), rel=1e-3) and not found.failed


def test_a_run_that_ends_early_says_so_and_has_not_settled() -> None:
    found = impact(FORCE, [0.1], duration=1.0, max_evaluations=300)
    assert "max_evaluations" in found.failed[0, 0] and np.isnan(found.settling[0, 0]) and np.isnan(found.force[0, 0, -1])
    assert "1 runs did not reach their end" in str(found)


def test_its_own_duration_is_some_time_constants_of_the_loop_in_contact() -> None:
    loop = slider(mfc.laws.JointPID(1000.0, None, 100.0), 50.0)
    slowest = -loop.linearize().poles()[0].real.max()
    assert impact(loop, [0.05]).times[-1] == pytest.approx(12.0 / slowest, rel=1e-6)


def test_an_admittance_touches_as_the_mass_that_it_makes_the_arm() -> None:
    """M_d w' = -k x - D w from w = v: the peak of a damped oscillator; behind a fast drive within 1 %, in dead time higher."""
    k, Md, D, speed = 1e4, 2.0, 40.0, 0.2
    law = mfc.laws.Admittance(NOTHING, Md, D, axes="z")
    w, zeta = np.sqrt(k / Md), D / (2 * np.sqrt(k * Md))
    peak = speed * np.sqrt(k * Md) * np.exp(-zeta / np.sqrt(1 - zeta**2) * np.arccos(zeta))
    ideal = impact(slider(law, stiffness=k), [speed], duration=3 * np.pi / w)
    assert ideal.peak[0, 0] == pytest.approx(peak * np.exp(-D / Md * 1e-6), rel=1e-6)  # it has the speed a microsecond before
    driven = impact(slider(law, stiffness=k, servo=mfc.Servo(2e4, 0.8)), [speed], duration=3 * np.pi / w)
    late = impact(slider(law, stiffness=k, servo=mfc.Servo(2e4, 0.8, 3e-3)), [speed], duration=3 * np.pi / w)
    assert driven.peak[0, 0] == pytest.approx(peak, rel=1e-2) and late.peak[0, 0] > 1.05 * peak
    arm, q = mfc.robots.ur5(), np.radians([0.0, -60.0, 80.0, -110.0, -90.0, 0.0])
    law = mfc.laws.Admittance(PRESS, [30.0] * 3 + [2.0] * 3, [2000.0] * 3 + [60.0] * 3, [800.0, 800.0, 0.0, 60.0, 60.0, 60.0])
    hardware = mfc.Hardware(sample_time=8e-3, servo=mfc.Servo(mfc.hertz(8), 0.7, 16e-3))
    wall = mfc.Environment(2e4, axes="z", one_sided=True)
    found = impact(
        mfc.ClosedLoop(arm, law, mfc.trajectories.ToolHold(arm.pose(q)), q_start=q, environment=wall, hardware=hardware), [0.05], duration=0.3
    )
    assert not found.failed and found.peak[0, 0] > 0.05 * np.sqrt(2e4 * 30.0)  # the wall is met with the speed for 16 ms more


def test_what_cannot_be_touched_is_refused() -> None:
    two = replace(FORCE, environment=[FORCE.environment, FORCE.environment])
    for loop in (replace(FORCE, environment=None), replace(FORCE, environment=mfc.Environment(K)), two):
        with pytest.raises(BadArgument, match="exactly one surface"):
            impact(loop, [0.1])
    with pytest.raises(BadArgument, match="stiff along its normal"):
        impact(slider(mfc.laws.OpenLoopForce(NOTHING), stiffness=0.0), [0.1])
    for speeds in ([0.0], [-1.0], [], [np.inf], 1e6):
        with pytest.raises(BadArgument, match="speeds"):
            impact(FORCE, speeds)
    with pytest.raises(BadArgument, match="stiffness"):
        impact(FORCE, [0.1], [-1.0])
    flat = mfc.ClosedLoop(
        mfc.robots.planar_2r(), mfc.laws.JointPID(100.0, None, 10.0), mfc.trajectories.Hold([0.3, 0.8]),
        environment=mfc.Environment(K, axes="z", one_sided=True),
    )  # fmt: skip
    with pytest.raises(BadArgument, match="along the normal"):
        impact(flat, [0.1])
