"""Gains of an arm in contact: each mode its damping ratio, and an admittance that achieves what was asked behind the actuator, by runs as well."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigvals

from mfc_analysis import gains, hertz, laws as L
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware, Servo
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.robots import slider, ur5
from mfc_analysis.trajectories import Hold

PUSH = [0.0, 0.0, 10.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("stiffness", [800.0, [2000, 1500, 1000, 50, 40, 30], "full"])
def test_cartesian_damping_gives_every_mode_its_ratio(stiffness) -> None:
    robot, q = ur5(), np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2])
    if stiffness == "full":
        a = np.random.default_rng(0).normal(size=(6, 6))
        stiffness = a @ a.T * 100 + 300 * np.eye(6)
    zeta = 0.35
    D = gains.cartesian_damping(robot, q, stiffness, zeta)
    Lambda, K = robot.task_inertia(q), D.kp
    companion = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(Lambda, K), -np.linalg.solve(Lambda, D.kd)]])
    poles = eigvals(companion)
    assert_allclose(-poles.real / np.abs(poles), zeta, rtol=1e-9)
    assert_allclose(D.kd, D.kd.T)
    assert np.linalg.eigvalsh(D.kd)[0] > 0


@pytest.mark.parametrize("ratio", [0.4, [0.5, 0.6, 0.7, 0.8, 0.9, 1.0]])
def test_the_gains_of_an_impedance_give_the_arm_the_modes_that_they_promise(ratio: object) -> None:
    q = np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2])
    robot = ur5().with_friction(viscous=0.0)
    g = gains.impedance(robot, q, [2000, 1500, 1000, 50, 40, 30], ratio)
    poles = ClosedLoop(robot, L.Impedance(**g), Hold(q)).linearize().poles()[0]
    pairs = poles[poles.imag > 0] if np.ndim(ratio) == 0 else poles[poles.imag >= 0]
    found = np.sort(-pairs.real / np.abs(pairs))
    assert_allclose(found[: 5 if np.ndim(ratio) else 6], np.sort(np.broadcast_to(ratio, 6))[: 5 if np.ndim(ratio) else 6], rtol=1e-6)
    assert "stiffness" in str(g) and "slowest time constant" in str(g)
    same = gains.cartesian_damping(robot, q, [2000, 1500, 1000, 50, 40, 30], ratio)
    assert_allclose(g["damping"], same.kd)


def on_wall(g: gains.Gains, k: float, lag: float, servo: Servo | None, delay: float) -> ClosedLoop:
    """The gains on the law, through hardware with the same actuator."""
    hardware = Hardware(velocity_lag=lag, servo=servo, delay=delay)
    return ClosedLoop(slider(1.0), L.Admittance(PUSH, axes="z", **g), Hold([0.0]), environment=Environment(k, preload=10.0), hardware=hardware)


@pytest.mark.parametrize(("f", "k", "z", "lag", "zs", "late"), [
    (1.0, 3e3, 1.0, 0.0, 0.7, 0.016), (0.5, 5e4, 0.6, 5e-3, 1.5, 0.0), (2.0, 800.0, 0.8, 0.01, 0.7, 4e-3), (0.3, 1e4, 2.0, 0.0, 1.0, 0.02),
])  # fmt: skip
def test_an_admittance_has_the_bandwidth_asked_for_on_the_loop_of_the_law(f: float, k: float, z: float, lag: float, zs: float, late: float) -> None:
    """T = F_tip/F_d of the linearised loop, dead time exact, falls to 1/sqrt 2 there, and the pair of poles is a root."""
    w = hertz(f)
    g = gains.admittance(bandwidth=w, stiffness=k, damping=z, lag=lag, servo=hertz(8), servo_damping=zs, delay=late)
    loop = on_wall(g, k, lag, Servo(hertz(8), zs), late)
    lin = loop.linearize()
    opened = lin.frequency_response([w], "force")[0, 2, 0]
    assert_allclose(abs(opened / (1 + opened)), 0.5**0.5, rtol=1e-8)
    assert_allclose(g.achieved.bandwidth, w, rtol=1e-9)
    wn, found = g.achieved.natural_frequency, lin.margins(at="force")
    assert_allclose(g.achieved.phase_deg, found.phase_deg[0, 2], rtol=1e-6)
    pair = np.roots([1, 2 * z * wn, wn * wn])
    servo = Servo(hertz(8), zs).natural_frequency
    for s in pair:
        H = np.exp(-s * late) * servo**2 / (s**2 + 2 * zs * servo * s + servo**2) / (lag * s + 1)
        assert abs(g["inertia"] * s * s + g["damping"] * s + k * H) < 1e-6 * k * abs(H)
    assert lin.stable[0]
    assert found.gain_reduction[0, 2] < 1e-6  # stable on every softer wall


@pytest.mark.parametrize(("k", "z", "w"), [(500.0, 0.3, 20.0), (5e4, 3.0, 1.0), (4e3, 0.7, 8.0)])
def test_without_an_actuator_it_is_the_mass_and_damper_of_the_formula(k: float, z: float, w: float) -> None:
    g = gains.admittance(natural_frequency=w, stiffness=k, damping=z)
    assert_allclose([g["inertia"], g["damping"]], [k / w**2, 2 * z * k / w], rtol=1e-9)
    once = gains.admittance(crossover=w, stiffness=k, damping=z)
    assert_allclose(abs(k / (1j * w * (once["inertia"] * 1j * w + once["damping"]))), 1.0, rtol=1e-9)
    double = gains.admittance(natural_frequency=w, stiffness=k, damping=1.0, servo=20 * w, delay=0.01 / w)
    near = gains.admittance(natural_frequency=w, stiffness=k, damping=1.0 + 1e-7, servo=20 * w, delay=0.01 / w)
    assert_allclose([near["inertia"], near["damping"]], [double["inertia"], double["damping"]], rtol=1e-5)


def test_the_stiffest_wall_of_the_note_is_the_bound_of_the_loop_by_poles_and_by_runs() -> None:
    g = gains.admittance(bandwidth=hertz(1), stiffness=3e3, servo=hertz(8), servo_damping=0.7, delay=0.016)
    stiffest = float(str(g).partition("one of ")[2].partition(" N/m")[0])
    for factor, stable in ((0.98, True), (1.02, False)):
        loop = on_wall(g, factor * stiffest, 0.0, Servo(hertz(8), 0.7, 0.016), 0.0)
        assert bool(loop.linearize().stable[0]) == stable
    for factor, grows in ((0.7, False), (1.4, True)):
        run = on_wall(g, factor * stiffest, 0.0, Servo(hertz(8), 0.7, 0.016), 0.0).simulate(np.linspace(0, 3, 601), 1e-5)
        F = np.abs(run.force[:, 2] - 10.0)
        assert run.diverged or (F[450:].max() > F[100:250].max()) == grows


def test_the_settling_time_is_that_of_a_step_of_f_d() -> None:
    g = gains.admittance(bandwidth=hertz(1), stiffness=3e3, servo=hertz(8), servo_damping=0.7, delay=0.016)
    run = on_wall(g, 3e3, 0.0, Servo(hertz(8), 0.7, 0.016), 0.0).simulate(np.linspace(0, 3, 6001), q=[-10.0 / 3e3], rtol=1e-9, atol=1e-12)
    away = np.flatnonzero(np.abs(run.force[:, 2] / 10.0 - 1) > 0.02)  # from no force to 10 N
    assert_allclose(g.achieved.settling_time, run.t[away[-1] + 1], atol=2e-3)


@pytest.mark.parametrize(("given", "said"), [
    ({}, "exactly one"), ({"bandwidth": 3.0, "crossover": 3.0}, "exactly one"), ({"stiffness": 0.0, "bandwidth": 3.0}, "stiffness"),
    ({"bandwidth": 3.0, "servo": -1.0}, "servo"), ({"bandwidth": 3.0, "delay": -1.0}, "delay"), ({"bandwidth": 500.0, "servo": 50.0}, "at most"),
    ({"natural_frequency": 500.0, "servo": 50.0}, "less"),
])  # fmt: skip
def test_what_cannot_be_is_refused_with_a_reason(given: dict, said: str) -> None:
    with pytest.raises(BadArgument, match=said):
        gains.admittance(**{"stiffness": 1e3, **given})
