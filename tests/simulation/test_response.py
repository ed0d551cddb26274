"""The response of many disturbed starts at once against one simulation each, and what it says where it cannot follow."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.simulation.along import Along
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.response import Response, response
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, moving, plant, regular_pose


def based(loop: ClosedLoop, time: float) -> Along:
    return Along(loop.equations, loop.simulate(np.linspace(0, time, 51), x=on_reference(loop.equations, np.zeros(1)).x[0], **TIGHT))


LOOPS = {
    "at rest": lambda: ClosedLoop(arm("ur5"), L.ComputedTorque(100.0, 100.0, 20.0, form="printed"), Hold(regular_pose("ur5"))),
    "on a moving path": lambda: ClosedLoop(plant("planar_2r"), L.JointPID(300.0, 40.0, 50.0), moving("planar_2r")),
}


@pytest.mark.parametrize("name", LOOPS)
def test_the_misfits_are_those_of_a_simulation_each(name: str) -> None:
    """The linear part is that of a tiny disturbance, scaled up."""
    loop, time = LOOPS[name](), 0.2
    along, nx, n = based(loop, time), loop.equations.nx, loop.equations.n
    found = response(along, 100)
    assert found is not None
    x0 = along.base.x[0]
    starts = 0.3 * np.random.default_rng(1).uniform(-1, 1, (3, nx)) * (np.arange(nx) < n)

    def run(d: np.ndarray) -> np.ndarray:
        return loop.simulate(found.t, x=x0 + d, **TIGHT).q - loop.simulate(found.t, x=x0, **TIGHT).q

    wanted = []
    for d in starts:
        nonlinear, linear = run(d), (run(1e-4 * d) - run(-1e-4 * d)) / 2e-4
        wanted.append(np.sqrt(((nonlinear - linear) ** 2).sum() / (nonlinear**2).sum()))
    assert_allclose(misfits(found, starts), wanted, rtol=0.03)
    linear = np.swapaxes(found.first @ starts.T, 1, 2)
    stepped, _ = found._stepped(linear)  # where the repetition does not settle
    assert_allclose(np.linalg.norm(stepped[..., :n], axis=(0, 2)) / np.linalg.norm((linear + stepped)[..., :n], axis=(0, 2)), wanted, rtol=0.03)


def misfits(found: Response, starts: np.ndarray) -> np.ndarray:
    """Without a guess."""
    return found.misfits(starts, np.zeros((len(found.t), *starts.shape)))


def test_steps_that_are_too_long_are_said_to_be() -> None:
    """Joint PID on a light wrist: roots of thousands of 1/s, ten steps in half a second."""
    loop = ClosedLoop(arm("ur5"), L.JointPID(3000.0, 100.0, 900.0), Hold(regular_pose("ur5")))
    found = response(based(loop, 0.5), 10)
    assert found is not None
    starts = np.zeros((1, loop.equations.nx))
    starts[0, :6] = [0.5, -0.5, 0.5, 1.0, -1.0, 1.0]
    assert np.isnan(misfits(found, starts)).all()


def test_a_start_at_which_the_law_cannot_be_evaluated_leaves_the_others_alone() -> None:
    loop = ClosedLoop(arm("ur5"), L.TaskComputedTorque(100.0, 100.0, 20.0), Hold(regular_pose("ur5")))
    along = based(loop, 0.05)
    found = response(along, 20)
    assert found is not None
    starts = np.zeros((3, loop.equations.nx))
    starts[0, :3], starts[2, 1:4] = 0.1, 0.1  # one joint alone turns the tool about one screw, on which the law is linear
    starts[1, :6] = -along.base.x[0, :6]  # all joints at zero: the ur5 lies stretched out
    both = misfits(found, starts)
    assert np.isinf(both[1]) and (both[[0, 2]] > 1e-4).all()
    assert_allclose(both[[0, 2]], misfits(found, starts[[0, 2]]), rtol=1e-9)
