"""The directions that the linear model predicts worst: the box of the disturbances, and the search in it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.simulation import directions
from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.directions import MAXIMA, candidates, scaled_basis
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.response import FOLLOWED, STEPS, Follower, Response
from mfc_analysis.simulation.second_order import expansion
from mfc_analysis.simulation.validation import misfit
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, moving, plant, regular_pose


def based(loop: ClosedLoop, time: float) -> tuple[Along, np.ndarray]:
    """The loop along the run from the operating point, and the basis of its disturbances."""
    e = loop.equations
    along = Along(e, loop.simulate(np.linspace(0, time, 201), x=on_reference(e, np.zeros(1)).x[0], **TIGHT))
    return along, scaled_basis(e, accumulated(along.Phi))


ROBOT = arm("ur5")
LOOPS = {
    "at rest": lambda: ClosedLoop(ROBOT, L.JointPID(300.0, 100.0, 50.0), Hold(regular_pose("ur5"))),
    "on a moving path": lambda: ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r")),
}


def test_the_basis_moves_a_joint_by_one_and_any_other_state_by_what_a_joint_error_makes_of_it() -> None:
    m, w = 2.0, 5.0
    loop = ClosedLoop(robots.slider(m), L.JointPID(m * w**2, 0.0, 0.0), Hold([0.0]))  # x'' = -w^2 x: v reaches w, the integral 1 / w
    _, basis = based(loop, 2 * np.pi / w)
    assert_allclose(basis, np.diag([1.0, w, 1 / w]), rtol=1e-3)
    elastic = Hardware(joint_stiffness=1e4, joint_damping=5.0, motor_inertia=0.5)
    _, basis = based(ClosedLoop(robots.slider(m), L.JointPID(m * w**2, None, 20.0), Hold([0.0]), hardware=elastic), 0.3)
    assert basis.shape == (4, 2) and basis[2].tolist() == basis[0].tolist() and basis[3].tolist() == basis[1].tolist()  # motor with its link
    growing = ClosedLoop(robots.slider(m), L.JointPID(-m * w**2, None, None), Hold([0.0]))  # x'' = w^2 x: v reaches w x
    _, basis = based(growing, 2.0)
    assert_allclose(basis[1, 1], w, rtol=1e-2)


def test_candidates_lie_in_the_box_the_worst_first_with_both_signs() -> None:
    loop = LOOPS["at rest"]()
    along, basis = based(loop, 0.2)
    found = candidates(along, basis, 0)
    assert found[0].reach <= min(c.reach for c in found)
    pairs = [(a, b) for a in found for b in found if a.reach == b.reach and np.allclose(a.direction, -b.direction)]
    assert len(pairs) == 2 * MAXIMA
    for candidate in found:
        c = np.linalg.solve(basis, candidate.direction)
        assert np.abs(c[:6]).max() == pytest.approx(1.0) and np.abs(c).max() <= 1 + 1e-9


def test_steps_become_shorter_where_most_starts_cannot_be_followed() -> None:
    """The wrist's fast roots lie within the longest steps; the shorter steps agree with runs."""
    loop = LOOPS["at rest"]()
    along, basis = based(loop, 0.2)
    c = np.random.default_rng(3).uniform(-1, 1, (6, basis.shape[1]))
    second = expansion(along, basis)
    assert second is not None
    follower = Follower(along, basis, second)
    assert follower.steps == STEPS[0]
    near, far = (follower.misfits(size * c[:, None])[:, 0] for size in (1e-3, 0.5))
    assert STEPS[0] < follower.steps
    assert np.isfinite(near).mean() >= FOLLOWED and np.isfinite(far).mean() >= FOLLOWED
    n = loop.robot.n
    still = loop.simulate(along.t, x=along.base.x[0], **TIGHT).q
    linear = accumulated(along.Phi)[:, :n]
    for size, misfits in ((1e-3, near), (0.5, far)):
        for i in np.flatnonzero(np.isfinite(misfits)):
            d = size * basis @ c[i]
            moved = loop.simulate(along.t, x=along.base.x[0] + d, **TIGHT).q - still
            assert misfits[i] == pytest.approx(misfit(moved, linear @ d), abs=0.1 * np.nanmax(misfits))


def test_where_the_second_order_gives_the_misfits_nothing_is_climbed_and_nothing_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 9.10 with a wrong model the misfits of the starts are within a tenth of those to second order, and the search finds the same radius."""
    robot = robots.load("kinova")
    loop = ClosedLoop(robot.with_payload(2.0), L.ComputedTorque(100, 100, 20), Hold([0.3, 2.6, 2.0, 1.1, 2.5, 0.9]), controller_model=robot)
    calls, misfits = [], Response.misfits
    monkeypatch.setattr(Response, "misfits", lambda self, starts, beyond: calls.append(len(starts)) or misfits(self, starts, beyond))
    found, number = loop.validate(0.05), len(calls)
    monkeypatch.setattr(directions, "SECOND", 0.0)
    searched = loop.validate(0.05)
    assert number <= len(STEPS) < len(calls) - number
    assert found.radius == pytest.approx(searched.radius, rel=0.01)


def test_a_torque_limit_and_a_surface_that_can_be_left_give_their_own_candidates() -> None:
    wall = Environment(1e3, 5.0, preload=5.0, one_sided=True)
    law, hold = L.DampedForcePI([0, 0, 5.0, 0, 0, 0], 1.0, None, 20.0), Hold([0.0])
    free, limited = (ClosedLoop(robots.slider(), law, hold, environment=wall, hardware=Hardware(torque_limit=limit)) for limit in (None, 20.0))
    own, others = ([c.direction for c in candidates(*based(loop, 0.2), 0) if np.isinf(c.reach)] for loop in (limited, free))
    assert len(own) == len(others) + 1
    assert own[-1][0] < 0 and own[-1][1] < 0  # away from the wall, fastest
