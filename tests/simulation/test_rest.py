"""The rest point of a soft loop: where it comes to rest by itself; which of several, unstable ones named, none where there is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.dynamics.operating_point import OperatingPoint
from mfc_analysis.errors import BadArgument, NearPi, NearSingular, NotConverged
from mfc_analysis.loop import ClosedLoop, Equilibrium
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation import rest
from mfc_analysis.simulation.rest import LONGEST, at_rest
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, plant, regular_pose

JOINT = robots.single_joint(inertia=0.5, mass=1.0, com_distance=0.1, damping=0.1)  # m g r = 0.981 Nm
WEIGHT = 9.81 * 0.1


def soft(name: str, seed: int) -> ClosedLoop:
    """JointPID without an integral, kp from a tenth to ten times the largest gravity torque per radian, kd from 0.03 to 3 sqrt(kp M)."""
    rng = np.random.default_rng(seed)
    robot = JOINT if name == "single_joint" else arm(name)
    q = rng.uniform(-2, 2, robot.n)
    weight, inertia = 0.1 + np.abs(robot.gravity(q)).max(), np.diag(robot.mass(q)).max()
    kp = 10 ** rng.uniform(-1, 1) * weight
    return ClosedLoop(robot, L.JointPID(kp, kd=10 ** rng.uniform(-1.5, 0.5) * np.sqrt(kp * inertia)), Hold(q))


def pressing(seed: int) -> ClosedLoop:
    """A UR5 with an unknown payload, pressing on a soft wall under 9.22 or 9.23 without an integral; a soft foot holds the other directions."""
    rng = np.random.default_rng(seed)
    q = np.array([0.0, -1.2, 1.5, -0.8, 1.57, 0.0]) + rng.uniform(-0.3, 0.3, 6)
    X = arm("ur5").pose(q)
    wall = Environment(10 ** rng.uniform(2, 4), 20.0, pose=X, axes="z", preload=10.0)
    foot = Environment([10 ** rng.uniform(2.3, 4)] * 2 + [10 ** rng.uniform(1, 2)] * 3, [20.0, 20.0, 2.0, 2.0, 2.0], pose=X, axes="xyrxryrz")
    kfp, F_d = rng.uniform(0, 2), np.array([0, 0, 10.0, 0, 0, 0])
    law = L.DampedForcePI(F_d, kfp, kdamp=[60.0, 60, 60, 3, 3, 3]) if rng.random() < 0.5 else L.ForcePI(F_d, kfp)
    return ClosedLoop(arm("ur5").with_payload(rng.uniform(0, 3)), law, Hold(q), arm("ur5"), [wall, foot])


def checked(loop: ClosedLoop) -> str:
    """What is wrong with the equilibrium of a loop whose own simulation over 200 s comes to rest; "moving" where it does not; or ""."""
    run = loop.simulate(LONGEST)
    if run.diverged or np.abs(run.v[-1]).max() > 1e-6:
        return "moving"
    found = loop.equilibrium()
    apart = float(np.abs(found.q - run.q[-1]).max())
    left = 2 * np.abs(run.v[-1]).max() / -loop.linearize(about="equilibrium").poles()[0].real.max()  # what the slowest root still has to go
    balance = np.abs(loop.equations.rates(0.0, found.x)).max()
    right = apart < 1e-6 + left and balance < 1e-6 and found.stable
    return "" if right else f"{apart:.3g} rad from where the loop rests; rates {balance:.3g}; stable {found.stable}; {found.notes}"


def balance(q: float, kp: float, q_d: float) -> float:
    return kp * (q_d - q) - WEIGHT * np.cos(q)


@pytest.mark.parametrize(("kp", "q_d"), [(0.7, 1.0), (0.2, 0.0), (0.1, 0.0), (0.3, 1.0), (0.5, 1.0)])
def test_a_soft_joint_rests_at_the_root_of_its_balance_that_it_falls_to(kp: float, q_d: float) -> None:
    """A scan for every root of kp (q_d - q) = m g r cos q, stable where kp > m g r sin q; well damped, it stops at the first below q_d."""
    grid = np.linspace(q_d - WEIGHT / kp - 0.1, q_d, 4001)
    f = balance(grid, kp, q_d)
    roots = [brentq(balance, a, b, args=(kp, q_d)) for a, b, s in zip(grid[:-1], grid[1:], f[:-1] * f[1:], strict=True) if s < 0]
    falling_to = max(q for q in roots if kp > WEIGHT * np.sin(q))
    loop = ClosedLoop(JOINT, L.JointPID(kp, kd=1.0), Hold([q_d]))
    found = loop.equilibrium()
    assert_allclose(found.q, falling_to, atol=1e-10)
    assert found.stable and loop.linearize(about="equilibrium").stable.all()


@pytest.mark.parametrize(("name", "seed"), [*((n, s) for n in ("single_joint", "planar_2r") for s in range(6)), *(("ur5", s) for s in range(3))])
def test_a_soft_loop_rests_where_its_own_simulation_does(name: str, seed: int) -> None:
    assert checked(soft(name, seed)) in ("", "moving")


@pytest.mark.parametrize("seed", range(2))
def test_a_soft_force_loop_rests_where_its_own_simulation_does(seed: int) -> None:
    assert checked(pressing(seed)) in ("", "moving")


def test_a_rest_point_that_newton_finds_but_the_loop_never_comes_to_is_named() -> None:
    loop = ClosedLoop(JOINT, L.JointPID(0.1, kd=1.0), Hold([0.0]))
    assert loop.equilibrium().notes[0] == "the loop comes to rest here when it starts on the reference"
    upright = ClosedLoop(JOINT, L.JointPID(0.1, kd=1.0), Hold([np.pi / 2 - 0.001]))  # 0.1 x 0.001 Nm against a weight that falls away
    found = upright.equilibrium()
    assert found.stable and found.q[0] < 0 and any("another rest point lies near the reference" in n and "unstable" in n for n in found.notes)


def test_an_unstable_rest_point_is_named_as_such() -> None:
    """kp = 50, no damping but 0.1, a lag of 50 ms: Routh: (b)(I) < T I kp, the loop oscillates and grows."""
    loop = ClosedLoop(JOINT, L.JointPID(50.0), Hold([0.5]), hardware=Hardware(torque_lag=0.05))
    found = loop.equilibrium()
    assert_allclose(50.0 * found.error, WEIGHT * np.cos(found.q), atol=1e-9)
    assert not found.stable and found.notes[0].startswith("unstable") and "not come to rest" in found.notes[1]
    assert not loop.linearize(about="equilibrium").stable.any()


def test_a_loop_that_swings_for_ever_rests_at_the_point_it_swings_about() -> None:
    still = robots.single_joint(inertia=0.5, mass=1.0, com_distance=0.1, damping=0.0)
    loop = ClosedLoop(still, L.JointPID(0.7), Hold([1.0]))
    found = loop.equilibrium()
    assert_allclose(found.q, brentq(balance, -2, 1, args=(0.7, 1.0)), atol=1e-9)
    assert found.notes and "moves about this rest point" in found.notes[0]


@pytest.mark.parametrize("law", [L.JointPID(3000.0, kd=300.0), L.JointPID(3000.0, 800.0, 300.0), L.ComputedTorque(90.0, kd=18.0)], ids=str)
def test_a_stiff_loop_needs_no_simulation(law: L.Law, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr(rest, "_released", never)
    q = regular_pose("ur5")
    found = ClosedLoop(plant("ur5"), law, Hold(q), arm("ur5")).equilibrium()
    assert isinstance(found, Equilibrium) and found.stable and not found.notes


def test_where_neither_newton_nor_a_simulation_finds_one_both_say_why() -> None:
    loop = ClosedLoop(robots.slider(), L.ForcePI([0, 0, 5.0, 0, 0, 0], 1.0), Hold([0.0]))
    with pytest.raises(NotConverged, match=r"not found near the reference.*has not come to rest.*diverged"):
        at_rest(loop.equations)


def test_a_law_that_cannot_be_simulated_leaves_newtons_point(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise BadArgument("the start", 1.0, "another")

    monkeypatch.setattr("mfc_analysis.simulation.simulation.simulate", refused)
    found = ClosedLoop(JOINT, L.JointPID(2.0, kd=1.0), Hold([0.0])).equilibrium()
    assert found.stable and "cannot be simulated" in found.notes[0]


@pytest.mark.parametrize("why", [NearPi(3.1415), NearSingular("tool0", 1e-7, 1e7)], ids=lambda why: type(why).__name__)
def test_newton_may_leave_for_where_the_law_cannot_be_evaluated(why: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Upright the joint rests on its reference, and 50 ms of lag drive it away: the search from the end of that run must not hide the point."""
    newton = rest.rest_point

    def lost(e: Equations, start: OperatingPoint, closed: Callable[[Array], Array]) -> OperatingPoint:
        if abs(start.x[0, 0] - np.pi / 2) > 1e-6:
            raise why
        return newton(e, start, closed)

    monkeypatch.setattr(rest, "rest_point", lost)
    found = ClosedLoop(JOINT, L.JointPID(50.0), Hold([np.pi / 2]), hardware=Hardware(torque_lag=0.05)).equilibrium()
    assert_allclose(found.q, np.pi / 2, atol=1e-9)
    assert not found.stable and found.notes[0].startswith("unstable")
    with pytest.raises(NotConverged, match=f"not found near the reference: {str(why)[:20]}.*has not come to rest"):
        ClosedLoop(JOINT, L.JointPID(50.0), Hold([0.5]), hardware=Hardware(torque_lag=0.05)).equilibrium()
