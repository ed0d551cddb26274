"""The response of many disturbed starts at once against one simulation each, and what it says where it cannot follow."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.response import response
from mfc_analysis.simulation.simulation import Simulation
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, moving, plant, regular_pose


def based(loop: ClosedLoop, time: float) -> Simulation:
    return loop.simulate(np.linspace(0, time, 51), x=on_reference(loop.equations, np.zeros(1)).x[0], **TIGHT)


LOOPS = {
    "at rest": lambda: ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, 100.0, 20.0, form="printed"), Hold(regular_pose("ur5"))),
    "on a moving path": lambda: ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r")),
}


@pytest.mark.parametrize("name", LOOPS)
def test_the_misfits_are_those_of_a_simulation_each(name: str) -> None:
    """The linear part is that of a tiny disturbance, scaled up."""
    loop, time = LOOPS[name](), 0.2
    base, nx, n = based(loop, time), loop.equations.nx, loop.equations.n
    found = response(loop.equations, base, 100)
    assert found is not None
    starts = 0.3 * np.random.default_rng(1).uniform(-1, 1, (3, nx)) * (np.arange(nx) < n)

    def run(d: np.ndarray) -> np.ndarray:
        return loop.simulate(found.t, x=base.x[0] + d, **TIGHT).q - loop.simulate(found.t, x=base.x[0], **TIGHT).q

    wanted = []
    for d in starts:
        nonlinear, linear = run(d), (run(1e-4 * d) - run(-1e-4 * d)) / 2e-4
        wanted.append(np.sqrt(((nonlinear - linear) ** 2).sum() / (nonlinear**2).sum()))
    assert_allclose(found.misfits(starts), wanted, rtol=0.02)


def test_steps_that_are_too_long_are_said_to_be() -> None:
    """Joint PID on a light wrist: roots of thousands of 1/s, five steps in half a second."""
    loop = ClosedLoop(arm("ur5"), L.JointPID(3000.0, 100.0, 900.0), Hold(regular_pose("ur5")))
    found = response(loop.equations, based(loop, 0.5), 5)
    assert found is not None
    starts = np.zeros((1, loop.equations.nx))
    starts[0, :6] = [0.5, -0.5, 0.5, 1.0, -1.0, 1.0]
    assert np.isnan(found.misfits(starts)).all()


def test_a_start_at_which_the_law_cannot_be_evaluated_leaves_the_others_alone() -> None:
    loop = ClosedLoop(arm("ur5"), L.TaskComputedTorque(100.0, 100.0, 20.0), Hold(regular_pose("ur5")))
    base = based(loop, 0.05)
    found = response(loop.equations, base, 25)
    assert found is not None
    starts = np.zeros((3, loop.equations.nx))
    starts[0, :3], starts[2, 1:4] = 0.1, 0.1  # one joint alone turns the tool about one screw, on which the law is linear
    starts[1, :6] = -base.x[0, :6]  # all joints at zero: the ur5 lies stretched out
    both = found.misfits(starts)
    assert np.isnan(both[1]) and (both[[0, 2]] > 1e-4).all()
    assert_allclose(both[[0, 2]], found.misfits(starts[[0, 2]]), rtol=1e-9)
