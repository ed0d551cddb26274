"""A(t) along a run by a polynomial, and the transition matrices of its steps, against those at each time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.analysis.floquet import transitions
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.jacobians import closed_matrix
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.zero_order_hold import zero_order_hold
from mfc_analysis.simulation import along as module
from mfc_analysis.simulation.along import STEPS, Along
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.simulation import motion
from mfc_analysis.trajectories import Hold, Sinusoid
from tests.conftest import arm, moving, plant, regular_pose


def along(loop: ClosedLoop, time: float) -> Along:
    e = loop.equations
    return Along(e, motion(e, np.linspace(0, time, 201), on_reference(e, np.zeros(1)).x[0], **TIGHT))


def on_a_path() -> ClosedLoop:
    return ClosedLoop(plant("ur10").with_payload(2.0), L.ComputedTorque(100.0, 80.0, 20.0), moving("ur10"), controller_model=plant("ur10"))


LOOPS = {
    "on a moving path": on_a_path,
    "at rest": lambda: ClosedLoop(arm("ur5"), L.JointPID(300.0, 100.0, 50.0), Hold(regular_pose("ur5"))),
}


@pytest.mark.parametrize("name", LOOPS)
def test_the_polynomial_gives_the_matrices_and_transitions_of_every_time(name: str) -> None:
    found, t = along(LOOPS[name](), 0.4), np.linspace(0.0, 0.4, 33)
    exact = closed_matrix(found.e, t, found.base.state(t))
    assert_allclose(found.A(t), exact, atol=1e-8 * np.abs(exact).max())
    assert_allclose(found.Phi, transitions(lambda t: closed_matrix(found.e, t, found.base.state(t)), found.t), atol=1e-9)


def test_a_run_that_ends_where_it_began_is_not_at_rest() -> None:
    """As that of a period is, of which two times are kept: a slider that swings, x = cos t."""
    e = ClosedLoop(robots.slider(1.0), L.JointPID(1.0, None, None), Hold([0.0])).equations
    swinging, standing = (Along(e, motion(e, [0.0, 2 * np.pi], np.array([x, 0.0]), **TIGHT)) for x in (1.0, 0.0))
    assert_allclose(swinging.base.x[-1], swinging.base.x[0], atol=1e-9)
    assert standing.still and not swinging.still


def test_it_evaluates_few_points_on_a_smooth_run_and_one_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    points: list[int] = []

    def counted(e: object, t: np.ndarray, *more: object) -> np.ndarray:
        points.append(len(t))
        return closed_matrix(e, t, *more)

    monkeypatch.setattr(module, "closed_matrix", counted)
    assert along(LOOPS["on a moving path"](), 0.4).Phi.shape == (STEPS, 18, 18) and sum(points) < 70 + STEPS
    points.clear()
    assert along(LOOPS["at rest"](), 0.4).Phi.shape == (STEPS, 18, 18) and sum(points) == 1


def test_where_a_limit_is_left_each_time_is_evaluated() -> None:
    """A slider 1 m off: its force is at the limit at first."""
    loop = ClosedLoop(robots.slider(1.0), L.JointPID(100.0, None, 20.0), Hold([0.0]), hardware=Hardware(torque_limit=20.0))
    found = Along(loop.equations, motion(loop.equations, np.linspace(0, 1.0, 201), np.array([1.0, 0.0]), **TIGHT))
    t = np.linspace(0.0, 1.0, 101)
    exact = closed_matrix(loop.equations, t, found.base.state(t))
    assert set(exact[:, 1, 0]) == {0.0, -100.0}
    assert_allclose(found.A(t), exact, rtol=1e-12)
    times, weights = found.roughly(found.t)
    assert_allclose(weights @ times, times[np.searchsorted(times, found.t, side="right") - 1])


def test_a_limit_that_is_reached_between_the_points_of_the_polynomial_is_not_missed() -> None:
    """A slider that swings: its force, 18 N at most, is at the limit for 0.035 s, twice."""
    law, limit = L.ComputedTorque(100.0, None, 20.0), Hardware(torque_limit=17.9)
    found = along(ClosedLoop(robots.slider(1.0), law, Sinusoid([0.0], [0.5], [6.0]), hardware=limit), 1.0)
    t = np.linspace(0.0, 1.0, 101)
    assert_allclose(found.A(t), closed_matrix(found.e, t, found.base.state(t)), rtol=1e-12)
    assert {0.0, -100.0} == set(found.A(t)[:, 1, 0])


@pytest.mark.parametrize("count", [20, 50, 100, STEPS])
def test_merged_steps_are_those_of_a_held_input(count: int) -> None:
    """Against a fine solution: 2000 steps with A held in each."""
    found = along(LOOPS["on a moving path"](), 0.4)
    Phi, Gamma = found.steps(count)
    fine = np.linspace(0.0, 0.4, 2001)
    E, G = zero_order_hold(found.A(0.5 * (fine[:-1] + fine[1:])), np.broadcast_to(np.eye(18), (2000, 18, 18)), fine[1])
    for k in (0, count // 2, count - 1):
        P, Q = np.eye(18), np.zeros((18, 18))
        for i in range(k * 2000 // count, (k + 1) * 2000 // count):
            P, Q = E[i] @ P, E[i] @ Q + G[i]
        assert_allclose(Phi[k], P, atol=2e-6 * np.abs(P).max())
        assert_allclose(Gamma[k], Q, atol=1e-4 * np.abs(Q).max())


def test_a_fast_root_within_a_step_is_held_by_the_exponential(monkeypatch: pytest.MonkeyPatch) -> None:
    """x'' = -1e4 x' - 1e2 x: Simpson's rule over 5 ms would give Gamma of a third of the step, 1e-4 s is right."""
    found = along(ClosedLoop(robots.slider(1.0), L.JointPID(1e2, None, 1e4), Hold([0.0])), 1.0)
    _, Gamma = found.steps(50)
    assert Gamma[0, 1, 1] == pytest.approx(1e-4, rel=1e-2)
    monkeypatch.setattr(module, "FAST", np.inf)
    assert found.steps(50)[1][0, 1, 1] > 1e-3


def test_what_is_as_smooth_as_the_matrices_is_taken_at_few_times() -> None:
    found = along(LOOPS["on a moving path"](), 0.4)
    times, weights = found.roughly(found.t)
    assert len(times) < 12
    shape: list[Callable[[np.ndarray], np.ndarray]] = [np.ones_like, lambda t: np.sin(3 * t)]
    for f in shape:
        assert_allclose(weights @ f(times), f(found.t), atol=1e-3)
