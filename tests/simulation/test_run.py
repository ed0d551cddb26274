"""A run under way: contact events in closed form, how a run ends, its dense output, its segments."""

from __future__ import annotations

from itertools import pairwise
from time import process_time
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.law import Action
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.dual import value
from mfc_analysis.simulation import run
from mfc_analysis.simulation.run import FAR, FASTEST, DenseOutput, Outcome, Run, bounded, most_evaluations
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, moving, plant, regular_pose

# --- contact -----------------------------------------------------------------------------------------------------------------


def test_a_mass_thrown_at_a_wall_touches_bounces_and_lifts_at_the_times_of_the_closed_form() -> None:
    m, k = 2.0, 5000.0
    wall = Environment(k, pose=np.eye(4), axes="z", one_sided=True)
    loop = ClosedLoop(robots.slider(m), L.OpenLoopForce(np.zeros(6)), Hold([-0.1]), environment=wall)
    sim = loop.simulate(np.linspace(0, 0.4, 401), v=[1.0], rtol=1e-9, atol=1e-12)
    touch, lift = 0.1, 0.1 + np.pi * np.sqrt(m / k)
    assert [(e.kind, e.surface, e.axis) for e in sim.events] == [("touch", 0, "z"), ("lift", 0, "z")]
    assert_allclose([e.time for e in sim.events], [touch, lift], atol=1e-5)
    assert_allclose(sim.v[-1], -1.0, atol=1e-5)
    inside = (sim.t > touch - 1e-9) & (sim.t < lift)
    assert_allclose(sim.force[inside, 2], np.sqrt(k * m) * np.sin(np.sqrt(k / m) * (sim.t[inside] - touch)), atol=1e-2)
    assert sim.force.min() >= 0 and not sim.force[~inside, 2][1:].any()


def test_a_force_loop_that_loses_contact_comes_back() -> None:
    wall = Environment(3000.0, 5.0, pose=np.eye(4), axes="z", one_sided=True)
    law = L.DampedForcePI([0, 0, 10.0, 0, 0, 0], 1.0, [0, 0, 5.0, 0, 0, 0], 40.0)
    loop = ClosedLoop(robots.slider(1.0), law, Hold([-0.02]), environment=wall)
    sim = loop.simulate(1.5)
    assert sim.events[0].kind == "touch"
    kinds = [event.kind for event in sim.events]
    assert all(a != b for a, b in pairwise(kinds))  # touch and lift take turns
    assert_allclose(sim.force[-1, 2], 10.0, atol=0.05)


def test_a_mass_thrown_at_two_surfaces_touches_each_at_its_own_time() -> None:
    upper, lower = np.eye(4), np.eye(4)
    upper[2, 3], lower[2, 3] = 0.05, 0.15
    walls = [Environment(500.0, pose=pose, axes="z", one_sided=True) for pose in (lower, upper)]
    loop = ClosedLoop(robots.slider(1.0), L.OpenLoopForce(np.zeros(6)), Hold([0.0]), environment=walls)
    sim = loop.simulate(0.05, v=[4.0], rtol=1e-9, atol=1e-12)
    first, second = sim.events
    assert (first.kind, first.surface, second.kind, second.surface) == ("touch", 1, "touch", 0)
    w = np.sqrt(500.0)  # from the first on: z = 0.05 + 4 sin(w t) / w
    assert_allclose([first.time, second.time], [0.0125, 0.0125 + np.arcsin(0.1 * w / 4) / w], atol=1e-7)


# --- how a run ends ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hardware", [None, Hardware(delay=0.05), Hardware(sample_time=0.05)], ids=["ideal", "delay", "sampled"])
def test_a_run_that_diverges_stops_keeps_what_it_has_and_says_when(hardware: Hardware | None) -> None:
    loop = ClosedLoop(robots.slider(1.0), L.JointPID(-50.0), Hold([0.0]), hardware=hardware)
    sim = loop.simulate(10.0, 0.1)
    assert sim.diverged and sim.outcome.name == "DIVERGED"
    assert 0.5 < sim.end < 10.0 and f"at t = {sim.end:.4g} s" in sim.message
    assert np.isfinite(sim.x).all() and sim.t.size > 20 and np.abs(sim.v).max() <= 1.001e4
    if hardware is None:  # v = 0.1 sqrt(50) sinh(sqrt(50) t) reaches 1e4
        assert_allclose(sim.end, np.arcsinh(1e4 / (0.1 * np.sqrt(50))) / np.sqrt(50), atol=1e-3)
    assert sim.message in str(sim)


@pytest.mark.parametrize("hardware", [None, Hardware(delay=1e-4), Hardware(sample_time=1e-4)], ids=["ideal", "delay", "sampled"])
def test_a_run_stops_at_its_limit_on_work_keeps_what_it_has_and_says_how_far_it_came(hardware: Hardware | None) -> None:
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"), hardware=hardware)
    times = np.linspace(0, 30.0, 3001)
    sim = loop.simulate(times, 0.1, max_evaluations=600)
    assert sim.diverged and sim.outcome is Outcome.STOPPED and 600 <= sim.evaluations < 700
    for said in (f"at t = {sim.end:.4g} s", "600 evaluations", "30 s", "max_evaluations"):
        assert said in sim.message
    assert 0 < sim.end < 30.0 and np.isfinite(sim.x).all()
    short = loop.simulate([0.0, 0.5 * sim.end, sim.end], 0.1, max_evaluations=2000)
    assert not short.diverged
    assert_allclose(sim.state([0.5 * sim.end, sim.end]), short.x[1:], atol=1e-4)


def test_a_run_with_a_dead_time_of_a_microsecond_ends_although_nobody_sets_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "MOST", 2000)  # 400 000 take about 10 s
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"), hardware=Hardware(delay=1e-6))
    sim = loop.simulate(1.0)
    assert sim.outcome is Outcome.STOPPED and 1e-4 < sim.end < 1e-2


@pytest.mark.parametrize("law", ["joint", "tool", "hybrid"])
@pytest.mark.parametrize("axes", [(), ("z",), ("rxry", "rz")], ids=str)
def test_the_limit_on_work_is_the_same_time_whatever_an_evaluation_costs(law: str, axes: tuple[str, ...]) -> None:
    """Time of the evaluations allowed, in evaluations of a joint law without surfaces: MOST within a factor of three."""
    q = regular_pose("ur5")

    def loop(law: str, axes: tuple[str, ...]) -> ClosedLoop:
        walls = [Environment(1e4, 10.0, axes=a) for a in axes]
        if law == "joint":
            return ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, None, 20.0), Hold(q), environment=walls or None)
        given = L.TaskComputedTorque(100.0, None, 20.0, damping=0.05)
        if law == "hybrid":
            given = L.HybridMotionForce([0, 0, 10.0, 0, 0, 0], 100.0, None, 20.0, kfp=0.5, kdamp=50.0, constraints=np.eye(6)[[2]])
        return ClosedLoop(arm("ur5"), given, Hold(q), environment=walls or None)

    def cost(loop: ClosedLoop) -> float:
        e = loop.equations
        x = np.r_[q, 0.01 * np.ones(e.nx - 6)]
        times = []
        for _ in range(5):
            start = process_time()
            for _ in range(20):
                e.rates(0.0, x)
            times.append(process_time() - start)
        return min(times)

    one, other = loop("joint", ()), loop(law, axes)
    work = most_evaluations(other.equations) * cost(other) / (most_evaluations(one.equations) * cost(one))
    assert 1 / 3 < work < 3


def test_a_disturbance_that_stops_being_a_number_ends_the_run_in_words() -> None:
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"))
    sim = loop.simulate(0.5, disturbance=lambda t: np.nan if t > 0.2 else 0.0)
    assert sim.diverged and sim.outcome.name == "REFUSED" and "disturbance: got nan" in sim.message
    assert_allclose(sim.end, 0.2, atol=1e-6)
    assert np.isfinite(sim.x).all() and sim.t.size > 100


def test_rates_that_no_solver_ends_with_are_refused_at_the_start_and_end_a_run_later() -> None:
    loop = ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r"))
    with pytest.raises(BadArgument, match="rates"):
        loop.simulate(0.5, disturbance=1e300)
    sim = loop.simulate(0.5, disturbance=lambda t: 1e300 if t > 0.2 else 0.0)
    assert sim.diverged and "rates" in sim.message
    assert_allclose(sim.end, 0.2, atol=1e-6)


def started(**options: Any) -> Run:
    loop = ClosedLoop(robots.slider(1.0), L.JointPID(0.0), Hold([0.0]))
    chosen = {"rtol": 1e-9, "atol": 1e-12, "method": "LSODA", **options}
    return Run(loop.equations, None, chosen, DenseOutput(0.0, np.array([1.0, 0.0])), [])


def circle(t: float, x: np.ndarray) -> np.ndarray:
    return np.array([x[1], -x[0]])


@pytest.mark.parametrize("short", [False, True])
def test_segments_one_after_the_other_are_one_path(short: bool) -> None:
    run, x = started(), np.array([1.0, 0.0])
    for start, end in pairwise(np.linspace(0, 2, 5)):
        found = run.integrate(circle, float(start), float(end), x, short=short)
        assert found is not None
        x = found
    t = np.linspace(0, 2, 23)
    assert_allclose(np.stack([run.path.at(float(ti)) for ti in t]), np.stack([np.cos(t), -np.sin(t)], axis=1), atol=1e-7)
    assert_allclose(x, [np.cos(2), -np.sin(2)], atol=1e-7)
    assert run.outcome is Outcome.FINISHED


@pytest.mark.parametrize(("end", "far"), [(0.99, False), (1.01, True)])
def test_a_run_ends_where_a_position_passes_the_limit(end: float, far: bool) -> None:
    run = started()
    found = run.integrate(lambda t, x: np.array([FAR, 0.0]), 0.0, end, np.zeros(2))
    assert (found is None) == far == (run.outcome is Outcome.DIVERGED)
    if far:
        assert run.message.startswith("the motion diverged at t = 1 s") and f"{FAR:g}" in run.message


def test_a_law_that_refuses_for_good_ends_the_run_in_its_own_words_and_one_that_refuses_a_trial_step_does_not() -> None:
    def wall(t: float, x: np.ndarray) -> np.ndarray:
        if t > 0.5:
            raise BadArgument("the wall", t, "times up to 0.5 s")
        return circle(t, x)

    run = started()
    assert run.integrate(wall, 0.0, 1.0, np.array([1.0, 0.0])) is None
    assert run.outcome is Outcome.REFUSED and "the wall" in run.message
    assert_allclose(run.path.starts[-1], 0.5, atol=1e-6)
    again = started()
    assert again.integrate(wall, 0.0, 0.5, np.array([1.0, 0.0])) is not None
    assert again.outcome is Outcome.FINISHED and again.refused is None


@pytest.mark.parametrize(("rate", "taken"), [(0.999 * FASTEST, True), (1.001 * FASTEST, False), (np.inf, False), (np.nan, False)])
def test_rates_are_bounded(rate: float, taken: bool) -> None:
    rates = np.array([1.0, -rate])
    if taken:
        assert bounded(rates) is rates
        return
    with pytest.raises(BadArgument) as why:
        bounded(rates)
    assert why.value.argument == "the motion"


# --- dense output ------------------------------------------------------------------------------------------------------------


def test_dense_output_is_that_of_the_segment_and_of_the_later_one_at_its_seam() -> None:
    path = DenseOutput(0.0, np.array([-1.0]))
    assert path.at(3.0).tolist() == [-1.0]  # nothing integrated yet
    path.add(1.0, lambda t: np.array([10 + t]))
    path.add(2.0, lambda t: np.array([20 + t]))
    assert [path.at(t)[0] for t in (-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5)] == [-1, -1, 10.5, 21, 21.5, 22, 22]
    assert path.at(1.0 - 1e-13)[0] == pytest.approx(21.0)  # a sampling instant up to rounding
    assert path.at(1.0 - 1e-9)[0] == pytest.approx(11.0)
    times = np.array([-1.0, 0.0, 0.5, 1.0 - 1e-9, 1.0 - 1e-13, 1.0, 1.5, 2.0, 2.5])
    assert path.along(times).tolist() == [path.at(float(t)).tolist() for t in times]
    assert DenseOutput(0.0, np.array([-1.0])).along(times).tolist() == [[-1.0]] * 9


@L.define
class _NoSolution(L.JointLaw):
    """Pushes away, with an equation that has no solution beyond 0.5."""

    equation = "none"

    def act(self, model, now, ref, tap):
        if np.any(np.abs(value(now.q)) > 0.5):
            raise np.linalg.LinAlgError("SVD did not converge")
        return Action(20.0 * now.q, {}, ref.q - now.q)


@pytest.mark.parametrize("hardware", [None, Hardware(delay=2e-3), Hardware(sample_time=2e-3)])
def test_a_law_without_a_solution_ends_the_run_and_says_so(hardware: Hardware | None) -> None:
    loop = ClosedLoop(robots.single_joint(mass=0.0), _NoSolution(), Hold([0.0]), hardware=hardware)
    run = loop.simulate(np.linspace(0, 5, 501), q=[0.1])
    assert run.message and run.t[-1] < 4.9 and np.abs(run.q).max() < 0.6
