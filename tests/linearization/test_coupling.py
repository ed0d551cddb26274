"""Leak and coupling of the halves of 9.24: closed forms, both projections, python-control."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.linearization.coupling import coupling, leak

Z = np.array([[0, 0, 1.0, 0, 0, 0]])
Q = np.array([0.3, -1.25, 1.9, -2.2, -1.57, 0.2])


def inertia(seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(6, 6))
    return a @ a.T + np.eye(6)


@pytest.mark.parametrize("seed", range(3))
def test_the_dynamic_leak_is_a_column_of_the_mobility(seed: int) -> None:
    mobility = np.linalg.inv(inertia(seed))
    found = leak(Z, inertia(seed))[:, 0]
    assert found[2] == pytest.approx(0, abs=1e-12)
    assert_allclose(np.delete(found, 2), np.delete(-mobility[:, 2] / mobility[2, 2], 2), atol=1e-12)


def test_nothing_leaks_where_the_task_inertia_is_diagonal() -> None:
    Lambda = np.diag([1.0, 2, 3, 4, 5, 6])
    for projection in ("dynamic", "selection"):
        assert_allclose(leak(Z, Lambda, projection), 0, atol=1e-15)


def test_the_selection_leaks_and_accelerates_across_the_constraint_besides() -> None:
    Lambda = inertia(5)
    P = np.eye(6) - Z.T @ Z
    out = np.linalg.solve(Lambda, P @ Lambda @ Z.T)
    expected = out.copy()
    expected[2] = 0
    assert_allclose(leak(Z, Lambda, "selection"), expected, atol=1e-12)
    assert abs(out[2, 0]) > 1e-3


def test_leaks_come_in_batches() -> None:
    many = np.stack([inertia(i) for i in range(4)])
    assert_allclose(leak(Z, many)[2], leak(Z, many[2]), atol=1e-14)


def test_what_cannot_leak_is_named() -> None:
    with pytest.raises(BadArgument, match="orthonormal"):
        leak(2 * Z, np.eye(6))
    with pytest.raises(BadArgument, match="projection"):
        leak(Z, np.eye(6), "both")  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def lin() -> mfc.Linearization:
    law = mfc.laws.HybridMotionForce(20 * Z[0], 100.0, kd=20.0, kfp=Z[0], kfi=5 * Z[0], kdamp=200 * Z[0], constraints=Z, projection="selection")
    robot = mfc.robots.ur5()
    X = robot.pose(Q)
    return mfc.ClosedLoop(robot, law, mfc.trajectories.ToolHold(X), environment=mfc.Environment(1e4, preload=20.0, pose=X), q_start=Q).linearize()


def test_coupling_is_the_largest_singular_value_of_the_closed_loop(lin: mfc.Linearization) -> None:
    inputs, outputs = ("X_d_vx", "X_d_vy"), ("F_tip_fz", "X_e_wx")
    found = coupling(lin, inputs, outputs, [3.0, 40.0])
    system = lin.system(0)
    rows, columns = [lin.output_names.index(x) for x in outputs], [lin.input_names.index(x) for x in inputs]
    for w, gain in zip((3.0, 40.0), found.gain[0], strict=True):
        assert gain == pytest.approx(np.linalg.norm(system(1j * w)[np.ix_(rows, columns)], 2), rel=1e-6)
    assert found.peak() == (found.gain.max(), (3.0, 40.0)[int(found.gain[0].argmax())])


def test_unknown_signals_and_sampled_loops_are_refused(lin: mfc.Linearization) -> None:
    with pytest.raises(UnknownName, match="outputs"):
        coupling(lin, ("F_d_fz",), ("X_e_up",), [1.0])
    sampled = mfc.ClosedLoop(
        mfc.robots.slider(), mfc.laws.JointPID(100.0, kd=20.0), mfc.trajectories.Hold([0.0]), hardware=mfc.Hardware(sample_time=1e-3)
    )
    with pytest.raises(BadArgument, match="sampled"):
        coupling(sampled.linearize(), ("disturbance_slide",), ("q_slide",), [1.0])
