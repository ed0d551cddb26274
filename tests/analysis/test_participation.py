"""Who takes part in a root: participation factors from eigenvectors, null vectors with dead time, copies, units, and the words."""

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.analysis.delay.characteristic import delayed_points
from mfc_analysis.analysis.participation import Root, complex_words, listed, located, rightmost, shares
from mfc_analysis.analysis.stability import roots

Q = np.array([0.0, -0.9, 1.6, -0.7, 1.57, 0.0])
KI = np.array([100.0, 100.0, 3000.0, 100.0, 100.0, 100.0])
KD = np.array([40.0, 40.0, 40.0, 70.0, 40.0, 40.0])
Z = np.eye(6)[2]


def opened(law, robot=None, q=Q, **hardware):
    loop = mfc.ClosedLoop(robot or mfc.robots.ur5(), law, mfc.trajectories.Hold(q), hardware=mfc.Hardware(**hardware))
    return loop.linearize([1.2])


def test_shares_are_the_participation_factors_of_the_eigenvectors():
    lin = opened(mfc.laws.JointPID(kp=[900, 800, 300, 90, 80, 70], ki=3000.0, kd=[60, 50, 30, 5, 4, 3]), torque_lag=3e-3)
    found, right = np.linalg.eig(lin.A[0])
    left = np.linalg.inv(right)
    apart = np.abs(found[:, None] - found) + np.diag(np.full(len(found), np.inf))
    alone = np.flatnonzero(apart.min(axis=1) > 0.1 * np.abs(found))
    assert alone.size >= 3
    for k in alone:
        names, share = shares(lin.opened, 0, complex(found[k]))
        assert names == lin.state_names and share == pytest.approx(right[:, k] * left[k], abs=1e-6)


def test_with_dead_time_they_belong_to_the_null_vectors_of_the_characteristic_matrix():
    lin = opened(mfc.laws.ComputedTorque(kp=400.0, kd=KD), delay=0.03)
    s = complex(lin.delay_roots(1)[0, 0])
    (point,) = delayed_points(lin.opened)
    M, slope = (x[0] for x in point.matrix(np.array([s])))
    U, size, Vh = np.linalg.svd(M)
    assert size[-1] < 1e-9 * size[0]
    row, column = U[:, -1].conj(), Vh[-1].conj()
    factor = (row @ slope) * column / (row @ slope @ column)
    names, share = shares(lin.opened, 0, s)
    assert share == pytest.approx(factor, abs=1e-6) and names[-6:] == lin.equations.robot.joint_names
    assert rightmost(lin.opened).where == "wrist_1_joint"  # the joint with the most damping: the least dead time


def test_without_dead_time_in_a_loop_the_shares_do_not_jump():
    """A dead time of a microsecond changes no share by more than the dead time times the root."""
    law = mfc.laws.ComputedTorque(kp=100.0, ki=KI, kd=20.0)
    plain, late = opened(law), opened(law, delay=1e-6)
    one, two = rightmost(plain.opened), rightmost(late.opened)
    assert one.where == two.where == "elbow_joint" and two.value == pytest.approx(one.value, rel=1e-3)


@pytest.mark.parametrize(
    "hardware", [{}, {"torque_lag": 1e-3}, {"delay": 1e-3}, {"sample_time": 2e-3}, {"sample_time": 2e-3, "delay": 4e-3}], ids=str
)
def test_the_joint_whose_integral_is_too_strong_is_named(hardware):
    root = rightmost(opened(mfc.laws.ComputedTorque(kp=100.0, ki=KI, kd=20.0), **hardware).opened)
    assert root.where == "elbow_joint" and root.names == "joint 3 (elbow_joint)" and root.value.real > 0
    assert str(root).startswith("joint 3 (elbow_joint) at t = 1.2 s: ") and str(root).endswith(" j 1/s")
    assert ("z = " in str(root)) == ("sample_time" in hardware)


def test_the_root_in_words_is_that_of_the_design_polynomial():
    s = max(np.roots([1, 20, 100, 3000]), key=lambda x: (x.real, x.imag))
    root = rightmost(opened(mfc.laws.ComputedTorque(kp=100.0, ki=KI, kd=20.0)).opened)
    assert root.value == pytest.approx(s, rel=1e-8)
    assert str(root) == f"joint 3 (elbow_joint) at t = 1.2 s: root +{s.real:.3g} ± {s.imag:.3g} j 1/s"
    assert root.said("pose 3").startswith("joint 3 (elbow_joint) at pose 3: root") and root.said("").startswith("joint 3 (elbow_joint): root")


def test_equal_roots_belong_to_all_their_joints():
    """Computed torque with one gain: six copies of one polynomial, whose eigenvectors are arbitrary."""
    root = rightmost(opened(mfc.laws.ComputedTorque(kp=100.0, ki=3000.0, kd=20.0)).opened)
    assert root.names == "all 6 joints" and root.where == "shoulder_pan_joint"


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 1e-3}, {"delay": 1e-3}], ids=str)
def test_a_tool_law_names_the_axis(hardware):
    root = rightmost(opened(mfc.laws.TaskComputedTorque(kp=100.0, ki=[1, 1, 3000, 1, 1, 1], kd=20.0), **hardware).opened)
    assert root.names == root.where == "the tool along z"


@pytest.mark.parametrize(
    ("robot", "q", "joint"),
    [
        (mfc.robots.load("panda"), np.array([0.3, 0.3, 0.3, -1.5, 0.3, 1.5, 0.3]), 4),
        (mfc.robots.load("xarm7"), np.array([0.3, 0.3, 0.3, 1.5, 0.3, 1.5, 0.3]), 5),
        (mfc.robots.load("kinova"), np.array([0.3, 3.0, 1.5, 0.3, 0.9, 0.3]), 2),
        (mfc.robots.slider(mass=1.0), np.zeros(1), 1),
        (mfc.robots.rp(), np.array([0.3, 0.5]), 2),
    ],
    ids=["panda", "xarm7", "kinova", "slider", "rp"],
)
def test_it_is_the_same_on_every_arm(robot, q, joint):
    ki = np.where(np.arange(robot.n) == joint - 1, 3000.0, 1.0)
    root = rightmost(opened(mfc.laws.ComputedTorque(kp=100.0, ki=ki, kd=20.0), robot, q).opened)
    assert root.names == f"joint {joint} ({robot.joint_names[joint - 1]})" and root.where == robot.joint_names[joint - 1]


def test_a_root_that_is_not_there_and_roots_of_several_times():
    lin = opened(mfc.laws.ComputedTorque(kp=100.0, ki=KI, kd=20.0))
    assert located(lin.opened, 0, complex(-np.inf)) == Root(complex(-np.inf), 1.2, "", "")
    found, slow = roots(lin.opened)
    assert rightmost(lin.opened, (found, np.ones_like(slow))).value.real == -np.inf


def test_texts():
    assert complex_words(2.34 - 14.01j, "+.3g") == "+2.34 ± 14 j" and complex_words(-0.5 + 0j, ".4g") == "-0.5"
    assert complex_words(1e-7 + 3j, "+.3g") == "0 ± 3 j" and complex_words(1e-5 + 3j, "+.3g") == "+1e-05 ± 3 j"
    assert listed([]) == "" and listed(["a"]) == "a" and listed(["a", "b", "c"]) == "a, b and c"
