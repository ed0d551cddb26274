"""The same gains on the diagonal of M: what an independent-joint design believes, beside what really happens."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold
from tests.conftest import arm, loop_of, moving, named, plant, regular_pose

T = np.array([0.1, 0.6])
GAINS = (np.array([400.0, 350.0, 200.0, 40.0, 30.0, 10.0]), np.array([90.0, 80.0, 50.0, 9.0, 5.0, 2.0]), np.array([60.0, 50.0, 30.0, 6.0, 5.0, 1.5]))


def stiffness(name: str, q: np.ndarray) -> np.ndarray:
    """(dg/dq)_jj by differences."""
    h = 1e-6 * np.eye(q.size)
    return np.array([(plant(name).gravity(q + d) - plant(name).gravity(q - d))[j] / 2e-6 for j, d in enumerate(h)])


def test_each_joint_has_the_polynomial_of_its_own_inertia_and_gravity() -> None:
    """M_jj s^3 + (b + kd) s^2 + (kp + (dg/dq)_jj) s + ki at every time, joint by joint."""
    kp, ki, kd = GAINS
    lin = ClosedLoop(plant("ur5"), L.JointPID(kp, ki, kd), moving("ur5"), arm("ur5")).linearize(T)
    found = lin.decentralised()
    assert found.joints == arm("ur5").joint_names and found.poles().shape == (2, 6, 3) and found.stable.shape == (2, 6)
    for i, q in enumerate(moving("ur5")(T).q):
        M, g = np.diag(plant("ur5").mass(q)), stiffness("ur5", q)
        b = 0.3 + 0.2 / 0.7 / np.cosh(moving("ur5")(T[i]).v / 0.7) ** 2  # the slope of the smoothed Coulomb friction
        for j in range(6):
            want = np.array([M[j], b[j] + kd[j], kp[j] + g[j], ki[j]])
            assert_allclose(np.poly(found.A[i, j]) * M[j], want, rtol=1e-6)
            assert_allclose(np.sort_complex(found.poles()[i, j]), np.sort_complex(np.roots(want)), rtol=1e-5)


def test_where_the_mass_matrix_is_diagonal_and_gravity_off_it_is_the_loop_itself() -> None:
    robot = robots.rp(gravity=0.0)
    loop = ClosedLoop(robot, L.JointPID([30.0, 200.0], [5.0, 9.0], [8.0, 30.0]), Hold([0.4, 0.7]))
    lin = loop.linearize([0.0])
    alone = lin.decentralised().poles().ravel()
    whole = lin.poles()[0]
    assert_allclose(np.sort_complex(alone), np.sort_complex(whole), rtol=1e-8)


def test_on_one_joint_it_is_the_loop_itself() -> None:
    loop = ClosedLoop(robots.single_joint(), L.JointPID(20.0, 5.0, 3.0), Hold([0.4]))
    lin = loop.linearize([0.0])
    assert_allclose(np.sort_complex(lin.decentralised().poles()[0, 0]), np.sort_complex(lin.poles()[0]), rtol=1e-9)
    assert lin.decentralised().stable.all() == lin.stable.all()


@pytest.mark.parametrize("hardware", [
    {"torque_lag": 0.01}, {"velocity_filter": 0.02}, {"joint_stiffness": 900.0, "joint_damping": 3.0, "motor_inertia": 0.2},
    {"joint_stiffness": 900.0, "motor_inertia": 0.2, "feedback": "link", "torque_lag": 0.01},
])  # fmt: skip
def test_hardware_stands_before_each_joint(hardware: dict) -> None:
    for robot, ref in ((robots.single_joint(), Hold([0.4])), (robots.rp(gravity=0.0), Hold([0.4, 0.7]))):
        lin = ClosedLoop(robot, L.JointPID(40.0, 5.0, 6.0), ref, hardware=Hardware(**hardware)).linearize([0.0])
        found = lin.decentralised().poles().ravel()
        assert_allclose(np.sort_complex(found), np.sort_complex(lin.poles()[0]), rtol=1e-6)


@pytest.mark.parametrize("name", ["9.2", "9.3", "9.4"])
def test_a_velocity_loop_is_decentralised_by_the_diagonal_of_its_gains(name: str) -> None:
    lin = loop_of(named(name)[0], "ur5").linearize([0.0])
    alone = lin.decentralised()
    kp = lin.equations.law.kp.diagonal(6)
    ki = np.zeros(6) if name == "9.2" else lin.equations.law.ki.diagonal(6)
    for j in range(6):
        assert_allclose(np.sort_complex(alone.poles()[0, j]), np.sort_complex(np.roots([1, kp[j], ki[j]] if ki[j] else [1, kp[j]])), rtol=1e-8)


def test_coupling_can_destabilise_what_looks_stable_joint_by_joint() -> None:
    """Computed torque frozen to a constant diagonal mass: the joints alone are stable, the arm is not."""
    q, M0 = np.array([0.0, 0.3]), np.array([250.0, 140.0])
    law = L.ComputedTorque(60.0, 210.0, 12.0, mass=np.diag(M0))
    lin = ClosedLoop(robots.planar_2r(gravity=0.0), law, Hold(q)).linearize([0.0])
    M = robots.planar_2r(gravity=0.0).mass(q)
    truth = np.linalg.eigvals(np.linalg.solve(M, np.diag(M0)))  # the loop is s^3 + l (12 s^2 + 60 s + 210) for each of these
    alone = M0 / np.diag(M)
    bound = 210.0 / (12.0 * 60.0)  # stable iff l > ki / (kd kp)
    assert lin.decentralised().stable.all() == bool(np.all(alone > bound))
    assert bool(lin.stable[0]) == bool(np.all(truth.real > bound))
    assert not np.allclose(np.sort(lin.decentralised().poles().ravel().real), np.sort(lin.poles()[0].real), rtol=0.05)


def test_an_integral_that_acts_on_nothing_makes_no_joint_unstable() -> None:
    kp, _, kd = GAINS
    lin = ClosedLoop(arm("ur5"), L.JointPID(kp, [50.0, 0, 0, 0, 0, 0], kd), Hold(regular_pose("ur5"))).linearize([0.0])
    assert lin.decentralised().stable.all() and lin.decentralised().poles().shape == (1, 6, 3)
    limp = ClosedLoop(arm("ur5"), L.JointPID([400.0, -400.0, 200.0, 40.0, 30.0, 10.0], [50.0, 0, 0, 0, 0, 0], kd), Hold(regular_pose("ur5")))
    assert limp.linearize([0.0]).decentralised().stable.tolist() == [[True, False, True, True, True, True]]


def test_margins_of_each_joint_alone_are_those_of_its_own_loop() -> None:
    lin = ClosedLoop(robots.rp(gravity=0.0), L.JointPID([30.0, 200.0], [5.0, 9.0], [8.0, 30.0]), Hold([0.4, 0.7])).linearize([0.0])
    alone, whole = lin.decentralised().margins(), lin.margins()
    for metric in ("gain_reduction", "gain_increase", "phase_deg", "delay", "sensitivity_peak", "crossover"):
        assert_allclose(getattr(alone, metric), getattr(whole, metric), rtol=1e-7)  # M is diagonal: nothing couples
    one = ClosedLoop(robots.single_joint(), L.JointPID(2.0, 50.0, 1.0), Hold([0.4])).linearize([0.0]).decentralised().margins()
    assert not one.stable[0] and np.isnan(one.phase_deg).all()


def test_a_single_outer_loop_is_taken_joint_by_joint_and_an_n_by_n_one_is_refused() -> None:
    tf = control.tf([8.0, 120.0, 40.0], [0.02, 1.0, 0.0])
    one = ClosedLoop(robots.single_joint(), L.InverseDynamics(tf), Hold([0.4])).linearize([0.0])
    assert_allclose(np.sort_complex(one.decentralised().poles()[0, 0]), np.sort_complex(one.poles()[0]), rtol=1e-6)
    square = L.InverseDynamics(control.append(control.ss(tf), control.ss(tf)))
    with pytest.raises(Unsupported, match="each joint"):
        ClosedLoop(robots.planar_2r(), square, Hold([0.1, 0.2])).linearize([0.0]).decentralised()


@pytest.mark.parametrize("name", ["9.5 standard", "9.16 standard", "9.21", "9.23", "9.24 dynamic standard", "9.9 printed"])
def test_a_law_that_is_not_joint_by_joint_is_refused(name: str) -> None:
    with pytest.raises(Unsupported) as info:
        loop_of(named(name)[0], "ur5").linearize([0.0]).decentralised()
    assert info.value.argument == "decentralised"


def test_a_sampled_loop_is_refused() -> None:
    loop = ClosedLoop(robots.single_joint(), L.JointPID(20.0, 5.0, 3.0), Hold([0.4]), hardware=Hardware(sample_time=1e-3))
    with pytest.raises(Unsupported):
        loop.linearize([0.0]).decentralised()


def test_dead_time_is_left_out_and_named():
    for delay, said in ((None, False), (0.01, True)):
        loop = ClosedLoop(robots.planar_2r(), L.JointPID(50.0, kd=10.0), Hold([0.2, 0.4]), hardware=Hardware(delay=delay))
        assert ("without the dead time" in str(loop.linearize().decentralised())) is said
