"""Where a loop is linearised: operating points asked for by name, coordinates by the Jacobian."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.dynamics.operating_point import CHUNK
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.linearization.start import chosen_coordinates, operating_points

Q0 = [0.3, -1.2, 1.5, -0.8, -1.4, 0.2]


def tool_loop(target: float) -> mfc.ClosedLoop:
    """A UR5 under 9.16 whose wrist joint 2 goes from -1.4 rad to ``target`` in a second; at 0 the arm is singular."""
    path = mfc.trajectories.Quintic(Q0, [0.3, -1.2, 1.5, -0.8, target, 0.2], 1.0)
    return mfc.ClosedLoop(mfc.robots.ur5(), mfc.laws.TaskComputedTorque(100, 20), path)


def test_points_on_the_reference_at_rest_and_along_a_run() -> None:
    loop = mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.ComputedTorque(kp=100, kd=20), mfc.trajectories.Quintic([0, 0], [0.5, -0.5], 1.0))
    times = np.array([0.0, 0.4, 3.0])
    ref = loop.ref(times)
    e, run = loop.equations, loop.simulate(np.linspace(0, 4, 41), q=[0, 0.2], v=[0.1, 0])
    assert_allclose(operating_points(e, times, "reference", None).x, np.hstack([ref.q, ref.v]), atol=1e-14)
    rest = mfc.ClosedLoop(loop.robot, loop.law, mfc.trajectories.Hold([0.5, -0.5])).equations
    assert_allclose(operating_points(rest, times, "equilibrium", None).x, np.tile([0.5, -0.5, 0, 0], (3, 1)), atol=1e-9)
    along = operating_points(e, times, "simulation", run).x
    assert_allclose(along[0], [0, 0.2, 0.1, 0], atol=1e-12)
    assert_allclose(along[2], [0.5, -0.5, 0, 0], atol=1e-5)
    with pytest.raises(BadArgument, match="along"):
        operating_points(e, times, "simulation", None)
    with pytest.raises(BadArgument, match="about"):
        operating_points(e, times, "somewhere", None)  # type: ignore[arg-type]


def test_states_of_ones_own() -> None:
    """9.10 with a wrong model, off its reference: A by a ladder of central differences of the loop's own rates, the residual by hand."""
    robot = mfc.robots.planar_2r()
    law = mfc.laws.ComputedTorque(kp=100, ki=40, kd=20)
    loop = mfc.ClosedLoop(robot.with_payload(1.0), law, mfc.trajectories.Hold([0.5, -0.5]), controller_model=robot)
    rng = np.random.default_rng(3)
    times, x = np.array([0.0, 1.0, 2.5]), np.array([0.5, -0.5, 0, 0, 0, 0]) + 0.3 * rng.normal(size=(3, 6))
    lin = loop.linearize(times, about=x)
    rates = loop.equations.rates
    for k in range(3):
        found = []
        for h in (1e-3, 5e-4):
            steps = h * np.eye(6)
            found.append((rates(np.full(6, times[k]), x[k] + steps) - rates(np.full(6, times[k]), x[k] - steps)).T / (2 * h))
        assert_allclose(lin.A[k], (4 * found[1] - found[0]) / 3, rtol=1e-8, atol=1e-8)
    assert_allclose(lin.residual, rates(times, x)[:, 2:4], atol=1e-12)
    assert_allclose(lin.again(times[1:]).A, lin.A[1:], rtol=0, atol=0)
    run = loop.simulate(np.linspace(0, 1, 11), initial_error=0.1)
    assert_allclose(loop.linearize(run.t, about=run.x).A, loop.linearize(run.t, about="simulation", simulation=run).A, rtol=1e-10)
    with pytest.raises(BadArgument, match=r"about.*shape \(3, 6\)"):
        loop.linearize(times, about=x[:2])
    with pytest.raises(BadArgument, match="about"):
        loop.linearize(times, about=np.full((3, 6), np.nan))
    with pytest.raises(Unsupported, match="nothing is known between"):
        lin.again(np.array([0.5]))
    with pytest.raises(Unsupported, match="nothing is known between"):
        lin.transient_growth()


def test_a_tool_law_has_its_error_as_coordinates_where_the_jacobian_is_regular() -> None:
    regular, near = tool_loop(-1.0), tool_loop(-1.5e-4)
    times = np.linspace(0, 1, 5)
    assert chosen_coordinates(regular.equations, None, operating_points(regular.equations, times, "reference", None)) == "error"
    with pytest.warns(mfc.errors.MfcWarning, match="nearly singular at t = 1 s"):
        assert chosen_coordinates(near.equations, None, operating_points(near.equations, times, "reference", None)) == "state"
    redundant = mfc.ClosedLoop(mfc.robots.load("panda"), mfc.laws.TaskComputedTorque(100, 20), mfc.trajectories.Hold([0, -0.5, 0, -2, 0, 1.6, 0.8]))
    with pytest.raises(Unsupported, match="square Jacobian"):
        chosen_coordinates(redundant.equations, "error", operating_points(redundant.equations, times, "reference", None))


def test_a_tool_law_over_many_points_names_the_time_nearest_to_singular() -> None:
    times = np.linspace(0, 1, 2 * CHUNK)
    loop = tool_loop(0.0)
    with pytest.raises(mfc.errors.NearSingular, match=r"t = 1 s"):
        loop.linearize(times)
