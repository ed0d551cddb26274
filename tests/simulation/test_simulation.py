"""The nonlinear loop: conserved energy, times and disturbances, what a run holds, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_trapezoid

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.errors import BadArgument, NearPi
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import inverse, log6
from mfc_analysis.simulation.run import Outcome
from mfc_analysis.simulation.simulation import METHODS, simulate, simulate_together
from mfc_analysis.trajectories import Hold, Sinusoid, ToolHold
from tests.conftest import LAWS, Case, arm, loop_of, moving, named, plant, regular_pose

NOTHING = L.JointPID(0.0)  # the arm alone
JOINT = robots.single_joint()


@pytest.mark.parametrize("name", ["planar_2r", "ur5", "kinova"])
def test_an_arm_left_to_itself_keeps_its_energy(name: str) -> None:
    robot, q = arm(name).with_friction(viscous=0.0), regular_pose(name)
    sim = ClosedLoop(robot, NOTHING, Hold(q)).simulate(np.linspace(0, 0.6, 601), v=0.3 * np.ones(robot.n), rtol=1e-9, atol=1e-11)
    kinetic = 0.5 * np.einsum("ti,tij,tj->t", sim.v, robot.mass(sim.q), sim.v)
    work = cumulative_trapezoid(np.sum(robot.gravity(sim.q) * sim.v, axis=1), sim.t, initial=0)
    assert_allclose(kinetic + work, kinetic[0], atol=1e-4 * kinetic.max())  # the trapezoids of 1 ms
    assert np.ptp(kinetic) > 0.1


def test_friction_takes_energy_as_it_should() -> None:
    robot = robots.slider(2.0, 0.8)
    sim = ClosedLoop(robot, L.OpenLoopForce(np.zeros(6)), Hold([0.0])).simulate(np.linspace(0, 3, 7), v=[1.5], rtol=1e-9)
    assert_allclose(sim.v[:, 0], 1.5 * np.exp(-0.4 * sim.t), rtol=1e-6)
    dry = robots.slider(2.0).with_friction(viscous=0.0, coulomb=0.5, coulomb_speed=1e-3)
    sim = ClosedLoop(dry, L.OpenLoopForce(np.zeros(6)), Hold([0.0])).simulate(np.linspace(0, 3, 7), v=[1.5], rtol=1e-9)
    assert_allclose(sim.v[:, 0], 1.5 - 0.25 * sim.t, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_all_solvers_find_the_same_motion(method: str) -> None:
    loop = loop_of(named("9.10 standard")[0], "planar_2r")
    sim = loop.simulate(np.linspace(0, 0.5, 6), 0.1, rtol=1e-7, atol=1e-9, method=method)
    best = loop.simulate(np.linspace(0, 0.5, 6), 0.1, rtol=1e-11, atol=1e-13, method="DOP853")
    assert_allclose(sim.q, best.q, atol=1e-6)


@pytest.mark.parametrize("case", [c for c in LAWS if c.name != "9.9 printed"], ids=str)
def test_every_law_runs_on_every_kind_of_arm_and_its_signals_belong_together(case: Case) -> None:
    name = "ur5" if case.tool else "planar_2r"
    loop = loop_of(case, name, contact=case.law(6).plant == "torque")
    sim = loop.simulate(np.linspace(0, 0.05, 5), 0.01)
    assert not sim.diverged and sim.end == 0.05
    n, e = arm(name).n, 6 if case.tool else arm(name).n
    assert sim.q.shape == sim.v.shape == sim.tau.shape == sim.command.shape == (5, n) and sim.error.shape == (5, e)
    assert sim.twist.shape == sim.force.shape == (5, 6) and sim.t.shape == (5,) and sim.x.shape == (5, loop.equations.nx)
    assert_allclose(sim.twist, np.einsum("tij,tj->ti", arm(name).jacobian(sim.q), sim.v), atol=1e-9)
    ref = loop.ref(sim.t)
    want = log6(inverse(arm(name).pose(sim.q)) @ arm(name).pose(ref.q)) if case.tool else ref.q - sim.q
    if case.name != "9.5 printed":
        assert_allclose(sim.error, want, atol=1e-9)
    assert bool(np.any(sim.force)) == bool(loop.equations.surfaces)


# --- where a run starts ------------------------------------------------------------------------------------------------------


def test_a_duration_starts_at_zero_and_an_array_at_its_first_time() -> None:
    loop = ClosedLoop(JOINT, L.JointPID(30.0, kd=5.0), Sinusoid([0.1], 0.4, 2.0))
    sim = loop.simulate(0.5)
    assert sim.t.size == 501 and sim.t[0] == 0.0 and sim.end == 0.5
    late = loop.simulate([1.0, 1.2, 1.5])
    assert_allclose(late.t, [1.0, 1.2, 1.5])
    assert_allclose(late.q[0], loop.ref(1.0).q)
    assert_allclose(late.v[0], loop.ref(1.0).v)
    assert loop.simulate([0.3]).t.tolist() == [0.3]


def test_a_disturbance_is_a_torque_at_the_joints_constant_or_in_time() -> None:
    robot = robots.slider(2.0)
    loop = ClosedLoop(robot, L.OpenLoopForce(np.zeros(6)), Hold([0.0]))
    t = np.linspace(0, 2, 9)
    assert_allclose(loop.simulate(t, disturbance=3.0).v[:, 0], 1.5 * t, atol=1e-8)
    wave = loop.simulate(t, disturbance=lambda t: [2.0 * np.cos(t)], rtol=1e-9)
    assert_allclose(wave.v[:, 0], np.sin(t), atol=1e-7)


def test_two_runs_are_the_same_to_the_last_bit() -> None:
    loop = loop_of(named("9.24 dynamic standard")[0], "ur5", contact=True)
    one, two = (loop.simulate(0.02, 0.01) for _ in range(2))
    assert np.array_equal(one.x, two.x) and np.array_equal(one.tau, two.tau)


def test_the_state_between_the_points_is_the_solvers() -> None:
    loop = ClosedLoop(JOINT, L.VelocityP(3.0), Hold([0.0]))
    sim = loop.simulate([0.0, 1.0], 1.0, rtol=1e-9, atol=1e-12)
    assert_allclose(sim.state([0.25, 0.7])[:, 0], -np.exp(-3.0 * np.array([0.25, 0.7])), atol=1e-7)
    for outside in (-0.1, 1.1):
        with pytest.raises(BadArgument, match="within the run"):
            sim.state(outside)


# --- contact -----------------------------------------------------------------------------------------------------------------


def test_a_two_sided_wall_pulls_back_instead() -> None:
    m, k = 2.0, 5000.0
    loop = ClosedLoop(robots.slider(m), L.OpenLoopForce(np.zeros(6)), Hold([0.0]), environment=Environment(k, pose=np.eye(4), axes="z"))
    sim = loop.simulate(np.linspace(0, 0.4, 41), v=[1.0], rtol=1e-9, atol=1e-12)
    w = np.sqrt(k / m)
    assert_allclose(sim.q[:, 0], np.sin(w * sim.t) / w, atol=1e-6)
    assert sim.events == () and sim.force.min() < -10


def test_a_run_that_ends_says_so() -> None:
    sim = ClosedLoop(JOINT, L.VelocityP(3.0), Hold([0.0])).simulate(1.0)
    assert not sim.diverged and sim.outcome.name == "FINISHED" and "end" in sim.message


def test_an_impossible_start_is_an_error_not_an_outcome() -> None:
    q = regular_pose("ur5")
    loop = ClosedLoop(arm("ur5"), L.TaskVelocity(3.0), ToolHold(arm("ur5").pose(q)), q_start=q)
    with pytest.raises(NearPi):
        loop.simulate(1.0, q=q + (np.pi - 1e-5) * np.eye(6)[5])


@pytest.mark.parametrize(("given", "argument"), [
    ({"times": -1.0}, "times"), ({"times": 0.0}, "times"), ({"times": np.nan}, "times"), ({"times": [0.0, 0.0]}, "times"), ({"times": []}, "times"),
    ({"times": "long"}, "times"), ({"times": [1.0, 0.5]}, "times"), ({"x": [1.0]}, "x"),
    ({"disturbance": [1.0, 2.0, 3.0]}, "disturbance"), ({"disturbance": np.nan}, "disturbance"),
    ({"disturbance": lambda t: [1.0, 2.0, 3.0]}, "disturbance"),
    ({"disturbance": lambda t: np.nan}, "disturbance"), ({"rtol": 0.0}, "rtol"), ({"max_evaluations": 0}, "max_evaluations"),
    ({"max_evaluations": 1e5}, "max_evaluations"), ({"atol": 1e-300}, "atol"), ({"method": "Euler"}, "method"),
])  # fmt: skip
def test_what_a_run_cannot_take_is_refused_by_name(given: dict, argument: str) -> None:
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"))
    with pytest.raises(BadArgument) as info:
        loop.simulate(**{"times": 0.1, **given})
    assert info.value.argument == argument


# --- runs together -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hardware", [None, Hardware(delay=5e-3), Hardware(sample_time=5e-3, delay=7e-3)], ids=["ideal", "delay", "sampled"])
@pytest.mark.parametrize("rtol", [1e-7, 1e-10])
def test_each_of_several_runs_together_is_as_accurate_as_alone(hardware: Hardware | None, rtol: float) -> None:
    """Against runs at a tighter tolerance: the largest error together is at most that of runs alone, up to a factor of 3 of luck."""
    loop = ClosedLoop(
        plant("planar_2r"), L.ComputedTorque(400.0, 200.0, 40.0), moving("planar_2r"), controller_model=arm("planar_2r"), hardware=hardware
    )
    e, t = loop.equations, np.linspace(0, 0.3, 61)
    starts = on_reference(e, np.zeros(1)).x + np.random.default_rng(0).uniform(-1, 1, (6, e.nx)) * np.geomspace(1e-4, 0.3, 6)[:, None]
    exact, alone = (np.stack([simulate(e, t, x, rtol=r, atol=1e-3 * r).x for x in starts]) for r in (1e-13, rtol))
    x, outcome, evaluations = simulate_together(e, t, starts, rtol=rtol, atol=1e-3 * rtol, max_evaluations=1e5)
    assert x is not None and outcome is Outcome.FINISHED and evaluations > 0
    assert np.abs(x - exact).max() <= 3 * np.abs(alone - exact).max() + 1e-12
    assert simulate_together(e, t, starts, rtol=rtol, atol=1e-3 * rtol, max_evaluations=20)[1] is Outcome.STOPPED


def test_where_one_of_the_runs_together_stops_there_are_no_states() -> None:
    loop = ClosedLoop(robots.slider(1.0), L.JointPID(-50.0), Hold([0.0]))
    t = np.linspace(0, 1.5, 11)
    for far, outcome in ((1e-3, Outcome.FINISHED), (0.5, Outcome.DIVERGED), (2e4, Outcome.DIVERGED)):
        x, how, _ = simulate_together(loop.equations, t, np.array([[0.0, 0.0], [far, 0.0]]), rtol=1e-8, atol=1e-10, max_evaluations=1e5)
        assert how is outcome and (x is None) == (how is not Outcome.FINISHED)
