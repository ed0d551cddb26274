"""One-sided contact: nothing before the touch, Kelvin-Voigt after it, each axis by itself, energy kept, events where the penetration is 0."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment, contact
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.robots.primitives import Primitives
from mfc_analysis.simulation.simulation import Simulation
from mfc_analysis.simulation.touching import LEAST, Touching
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, regular_pose

M, K, GAP, V0 = 1.0, 1e4, 0.01, 1.0
CRITICAL = 2 * np.sqrt(K * M)
HARDWARE = {"ideal": None, "sampled": Hardware(sample_time=1e-3), "dead time": Hardware(delay=5e-3)}
EXACT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


def lifted(height: float) -> np.ndarray:
    X = np.array(robots.slider(M).pose([0.0]))
    X[2, 3] += height
    return X


def thrown(walls: Environment | list[Environment], end: float, hardware: Hardware | None = None, speed: float = V0) -> Simulation:
    loop = ClosedLoop(robots.slider(M), L.OpenLoopForce(np.zeros(6)), Hold([0.0]), environment=walls, hardware=hardware)
    return loop.simulate(np.linspace(0, end, 1001), v=[speed], **EXACT)


def kelvin_voigt(c: float, end: float, times: np.ndarray) -> tuple[list[float], np.ndarray]:
    """Touch and lift, and (position, speed) at the times: M z'' = -max(0, K p + c v) while p = z - GAP > 0, with events of p."""
    t, y, touched, events, rows = 0.0, np.array([0.0, V0]), False, [], np.empty((times.size, 2))
    while t < end:

        def rates(t: float, y: np.ndarray, touched: bool = touched) -> list[float]:
            return [y[1], -max(0.0, K * (y[0] - GAP) + c * y[1]) / M if touched else 0.0]

        def penetration(t: float, y: np.ndarray) -> float:
            return y[0] - GAP

        penetration.terminal, penetration.direction = True, -1 if touched else 1  # type: ignore[attr-defined]
        found = solve_ivp(rates, (t, end), y, method="DOP853", rtol=1e-12, atol=1e-14, max_step=2e-4, events=penetration, dense_output=True)
        here = (times >= t) & (times <= found.t[-1])
        rows[here] = found.sol(times[here]).T
        t, y = float(found.t[-1]), found.y[:, -1]
        if found.status == 1:
            touched = not touched
            events.append(t)
    return events, rows


@pytest.mark.parametrize("hardware", HARDWARE)
@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.5, 1.0])
def test_a_mass_thrown_at_a_wall_meets_kelvin_and_voigt_from_no_damping_to_critical(ratio: float, hardware: str) -> None:
    c, end = ratio * CRITICAL, 0.1
    sim = thrown(Environment(K, c, pose=lifted(GAP), one_sided=True), end, HARDWARE[hardware])
    events, rows = kelvin_voigt(c, end, sim.t)
    assert [e.kind for e in sim.events] == ["touch", "lift"]
    assert_allclose([e.time for e in sim.events], events, atol=1e-8)
    assert_allclose(sim.q[:, 0], rows[:, 0], atol=1e-6 * GAP)
    assert_allclose(sim.v[:, 0], rows[:, 1], atol=1e-6 * V0)
    assert sim.events[0].time == pytest.approx(GAP / V0)
    assert not sim.force[(sim.t < events[0] - 1e-9) | (sim.t > events[1] + 1e-9)].any()  # nothing in free flight
    within = (sim.t > events[0] + 1e-9) & (sim.t < events[1])
    assert_allclose(sim.force[within, 2], np.maximum(0.0, K * (rows[within, 0] - GAP) + c * rows[within, 1]), atol=1e-5 * (K * GAP))


def test_a_preload_moves_the_touch_to_where_its_force_is_gone() -> None:
    """Elastic force k d + f0 = 0 at d = -f0 / k, before the pose."""
    sim = thrown(Environment(K, 50.0, pose=lifted(GAP), preload=40.0, one_sided=True), 0.02)
    assert_allclose(sim.events[0].time, (GAP - 40.0 / K) / V0, atol=1e-9)
    assert not sim.force[sim.t < sim.events[0].time - 1e-9].any()
    at = np.argmax(sim.t > sim.events[0].time + 1e-9)
    assert_allclose(sim.force[at, 2], 50.0 * V0, rtol=0.02)


def test_each_of_two_walls_pushes_from_its_own_touch() -> None:
    near, far = (Environment(K, 60.0, pose=lifted(z), one_sided=True) for z in (0.01, 0.012))
    sim = thrown([far, near], 0.06)
    assert [(e.kind, e.surface) for e in sim.events] == [("touch", 1), ("touch", 0), ("lift", 0), ("lift", 1)]
    z, v = sim.q[:, 0], sim.v[:, 0]
    right = sum(np.where(z > at + 1e-12, np.maximum(0.0, K * (z - at) + 60.0 * v), 0.0) for at in (0.01, 0.012))
    inside = np.min(np.abs(sim.t[:, None] - [e.time for e in sim.events]), axis=1) > 1e-9
    assert_allclose(sim.force[inside, 2], right[inside], atol=1e-9)


def energy(loop: ClosedLoop, sim: Simulation) -> np.ndarray:
    """Kinetic energy, and that of the springs of the touched axes, without gravity (the law carries it)."""
    P, robot = Primitives(loop.robot), loop.robot
    out = 0.5 * np.einsum("ki,kij,kj->k", sim.v, robot.mass(sim.q), sim.v)
    for surface, elastic in zip(loop.equations.surfaces, contact(loop.equations.surfaces, P, sim.q, sim.v).elastic, strict=True):
        for j in surface.index:
            out += 0.5 * np.maximum(elastic[:, j], 0.0) ** 2 / surface.K[j, j]
    return out


@pytest.mark.parametrize("damped", [False, True])
def test_an_arm_thrown_into_a_corner_with_a_stop_keeps_the_energy_that_the_dampers_leave(damped: bool) -> None:
    """Two faces and a rotational stop, in a tilted frame: E is constant in flight, and falls by the power of the contact less the springs'."""
    q = regular_pose("ur5")
    X = arm("ur5").pose(q) @ exp6(np.array([0.0, 0.0, 0.0, 0.2, -0.1, 0.3])) @ exp6(np.array([0.01, 0.0, 0.015, 0.0, 0.0, 0.0]))
    turn = arm("ur5").pose(q) @ exp6(np.array([0, 0, 0, 0, 0, 0.06]))
    c = 1.0 if damped else 0.0
    corner = Environment([5e3, 4e3], [40 * c, 80 * c], pose=X, axes="xz", one_sided=True)
    stop = Environment(200.0, 2.0 * c, pose=turn, axes="rz", one_sided=True)
    loop = ClosedLoop(arm("ur5"), L.OpenLoopForce(np.zeros(6)), Hold(q), environment=[corner, stop])
    v = np.linalg.lstsq(arm("ur5").jacobian(q), np.array([0.3, 0.0, 0.3, 0.0, 0.0, 0.8]), rcond=None)[0]
    first = loop.simulate(0.25, q=q, v=v, **EXACT)
    assert {(e.surface, e.axis) for e in first.events} == {(0, "x"), (0, "z"), (1, "rz")}
    edges = [0.0, *(e.time for e in first.events), 0.25]
    lost = 0.0
    for begin, stop_ in pairwise(edges):
        if stop_ - begin < 1e-6:
            continue
        t = np.linspace(begin + 1e-10, stop_ - 1e-10, 1001)
        x = first.state(t)
        flow = loop.equations.flow(t, x, lose_contact=True)
        power = np.einsum("ki,ki->k", np.asarray(flow.F_tip), np.einsum("kij,kj->ki", arm("ur5").jacobian(x[:, :6]), x[:, 6:12]))
        lost += float(np.trapezoid(power, t))
    E = energy(loop, first)
    springs = E[-1] - 0.5 * first.v[-1] @ arm("ur5").mass(first.q[-1]) @ first.v[-1]
    assert_allclose(E[-1] - springs + lost, E[0], rtol=1e-6)
    before = first.t < first.events[0].time
    assert_allclose(E[before], E[0], rtol=1e-8)
    if damped:
        assert np.diff(E).max() < 1e-9 * E[0] and E[-1] < 0.9 * E[0]
    else:
        assert_allclose(E, E[0], rtol=1e-6)


def test_at_rest_on_the_very_surface_rounding_logs_no_events() -> None:
    q = regular_pose("ur5")
    wall = Environment(1e4, 50.0, one_sided=True)
    sim = ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, kd=20.0), Hold(q), environment=wall).simulate(1.0)
    assert not sim.events and not sim.force.any()


def test_an_axis_with_a_damper_alone_is_never_touched_and_a_constant_force_always() -> None:
    damper = thrown(Environment(0.0, 100.0, pose=lifted(GAP), one_sided=True), 0.05)
    assert not damper.events and not damper.force.any()
    constant = thrown(Environment(0.0, 0.0, pose=lifted(GAP), preload=3.0, one_sided=True), 0.05)
    assert not constant.events
    assert_allclose(constant.force[:, 2], 3.0)


@pytest.mark.parametrize("method", ["LSODA", "RK45"])
def test_a_run_ends_in_words_where_the_rotation_of_a_stop_is_no_longer_defined(method: str) -> None:
    stop = Environment(1e-3, 0.0, axes="rxryrz", one_sided=True)
    loop = ClosedLoop(robots.single_joint(inertia=1.0, mass=0.0, damping=0.0), L.JointPID(0.0), Hold([0.0]), environment=stop)
    sim = loop.simulate(0.5, q=[3.0], v=[0.5], method=method)  # within 1e-3 rad of pi for two of the longest steps
    assert sim.outcome.name == "REFUSED" and "pi" in sim.message
    assert_allclose(sim.end, (np.pi - 3.0) / 0.5, rtol=1e-2)


def test_the_axes_start_as_the_state_is_and_switch_with_the_events() -> None:
    walls = [Environment(K, pose=lifted(z), one_sided=z >= 0) for z in (-0.01, 0.0, 0.02)]
    e = ClosedLoop(robots.slider(M), L.OpenLoopForce(np.zeros(6)), Hold([0.0]), environment=walls).equations
    touching = Touching(e, np.array([0.01, 1.0]))
    assert [bool(axes[2]) for axes in touching.axes] == [False, True, False]  # the first is two-sided: not watched
    change = touching.change()
    assert change(0.0, np.array([0.01, 1.0])) == pytest.approx(100.0)  # 1e4 N/m x 10 mm, to the lift from the second
    assert change(0.01, np.array([0.02 + 2 * LEAST / K, 1.0])) < 0 < change(0.0, np.array([0.03, 0.0]))  # at a step it keeps to its first value
    (event,) = touching.switch(0.01, np.array([0.02 + LEAST / K, 1.0]))
    assert (event.time, event.kind, event.surface, event.axis) == (0.01, "touch", 2, "z") and touching.axes[2][2]
