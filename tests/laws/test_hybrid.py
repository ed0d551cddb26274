"""Equation 9.24: the page by matrices in every form and projection, its two subspaces, what the misplaced eta costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

from mfc_analysis import laws as L
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws.constraints import peg_in_hole, projection, selection
from mfc_analysis.laws.hybrid import HybridMotionForce
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import ad, adjoint, inverse, log6
from mfc_analysis.trajectories import Hold
from tests.conftest import ARMS, F_D, SIX, arm, each, full, moving, plant, regular_pose, seed, surfaces

Z = np.eye(6)[[2]]
PUSH = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
EASY = np.array([0.1, -0.9, 1.6, -0.7, 1.2, 0.3])


def wall(q: np.ndarray, stiffness: float = 5e3, damping: float = 0.0) -> Environment:
    """Frictionless, along the tool's z at q, pressed with 10 N there."""
    return Environment(stiffness, damping, pose=arm("ur5").pose(q), axes="z", preload=10.0)


@pytest.mark.parametrize("name", SIX)
@pytest.mark.parametrize("project", ["dynamic", "selection"])
@pytest.mark.parametrize("form", HybridMotionForce.forms)
def test_the_law_is_the_page_by_matrices(name: str, project: str, form: str) -> None:
    """tau = J^T (P Lambda^ c + (1 - P) f + eta^), eta^ inside (1 - P) as printed: at a state far from the reference, in contact."""
    A = np.array([[0.0, 0.6, 0.8, 0, 0, 0], [0, 0, 0, 1.0, 0, 0]])
    gains = {"kp": full(6, 80.0), "ki": each(6, 30.0), "kd": full(6, 15.0), "kfp": full(6, 1.5), "kfi": each(6, 2.0), "kdamp": full(6, 30.0)}
    law = HybridMotionForce(F_D, constraints=A, projection=project, form=form, **gains)
    model, q0, t, rng = arm(name), regular_pose(name), 0.6, seed("9.24", name)
    loop = ClosedLoop(plant(name), law, moving(name), model, surfaces(name, q0))
    q, v = q0 + rng.uniform(-0.05, 0.05, 6), rng.uniform(-0.4, 0.4, 6)
    z, z_f = rng.uniform(-0.1, 0.1, 6), rng.uniform(-1, 1, 6)
    flow = loop.equations.flow(t, np.concatenate([q, v, z, z_f]))
    F = np.asarray(flow.F_tip)
    point = moving(name)(t)
    J_d = model.jacobian(point.q)
    V_ref, dV_ref = J_d @ point.v, J_d @ point.a + model.jacobian_rate(point.q, point.v) @ point.v
    E = inverse(model.pose(q)) @ model.pose(point.q)
    J, X_e = model.jacobian(q), log6(E)
    V, AdV = J @ v, adjoint(E) @ V_ref
    if form == "printed":
        h = 1e-5
        poses = [inverse(model.pose(q + s * h * v)) @ model.pose(moving(name)(t + s * h).q) for s in (-1, 1)]
        c = dV_ref + gains["kp"] @ X_e + gains["ki"] * z + gains["kd"] @ ((log6(poses[1]) - log6(poses[0])) / (2 * h))
    else:
        c = adjoint(E) @ dV_ref - ad(V) @ AdV + gains["kp"] @ X_e + gains["ki"] * z + gains["kd"] @ (AdV - V)
    f = F_D + gains["kfp"] @ (F_D - F) + gains["kfi"] * z_f - gains["kdamp"] @ V
    Lambda, eta = model.task_inertia(q), model.task_bias(q, v) + np.linalg.solve(J.T, model.viscous * v)
    P = projection(A, Lambda) if project == "dynamic" else selection(A)
    wrench = P @ Lambda @ c + (np.eye(6) - P) @ f + eta if form == "standard" else P @ Lambda @ c + (np.eye(6) - P) @ (f + eta)
    scale = max(1.0, np.abs(J.T @ P @ Lambda).max())
    assert_allclose(np.asarray(flow.command), J.T @ wrench, atol=(1e-6 if form == "printed" else 1e-10) * scale)
    assert_allclose(np.asarray(flow.rates["z"]), X_e, atol=1e-12)
    assert_allclose(np.asarray(flow.rates["z_f"]), F_D - F, atol=1e-12)
    assert_allclose(np.asarray(flow.error), X_e, atol=1e-12)


@pytest.mark.parametrize("name", [n for n in ARMS if n not in SIX])
def test_on_a_redundant_arm_the_whole_of_h_is_compensated(name: str) -> None:
    robot, rng = arm(name), seed("redundant", name)
    q, v = regular_pose(name), rng.uniform(-0.3, 0.3, 7)
    loop = ClosedLoop(robot, HybridMotionForce(np.zeros(6), 80.0, kd=15.0, constraints=Z), Hold(q))
    J, Lambda = robot.jacobian(q), robot.task_inertia(q)
    V = J @ v
    P = projection(Z, Lambda)
    wrench = P @ Lambda @ (-15.0 * V) - Lambda @ (robot.jacobian_rate(q, v) @ v)
    assert_allclose(np.asarray(loop.equations.flow(0.0, np.r_[q, v]).command), J.T @ wrench + robot.bias(q, v) + robot.viscous * v, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(kp=st.floats(10, 300), kd=st.floats(3, 40), k=st.floats(500, 2e4), kfp=st.floats(0, 4), kfi=st.floats(0.1, 5), kdamp=st.floats(1, 300))
def test_motion_and_force_are_two_loops_that_do_not_disturb_each_other(kp: float, kd: float, k: float, kfp: float, kfi: float, kdamp: float) -> None:
    """Exact model, constraint and wall along the tool's z: five copies of s^2 + kd s + kp, and the one-mass force loop with 1/(A Lambda^-1 A^T).

    Without preload: a force that is there turns with the tool, and so couples the two.
    """
    law = HybridMotionForce(np.zeros(6), kp, kd=kd, kfp=kfp, kfi=[0, 0, kfi, 0, 0, 0], kdamp=[0, 0, kdamp, 0, 0, 0], constraints=Z)
    lin = ClosedLoop(arm("ur5"), law, Hold(EASY), environment=replace(wall(EASY, k), preload=0.0)).linearize([0.0])
    assert np.abs(lin.residual).max() < 1e-9
    A = lin.A[0]
    keep = [*range(12), 14]
    idle = [i for i in range(18) if i not in keep]
    assert not A[np.ix_(keep, idle)].any()
    found = np.poly(A[np.ix_(keep, keep)])
    m = 1 / np.linalg.inv(arm("ur5").task_inertia(EASY))[2, 2]
    want = np.array([1.0, kdamp / m, k * (1 + kfp) / m, k * kfi / m])
    for _ in range(5):
        want = np.polymul(want, [1, kd, kp])
    scale = np.abs(np.linalg.eigvals(A)).max() ** np.arange(14)
    assert np.max(np.abs(found - want) / scale) < 1e-9


def test_an_undamped_wall_with_a_force_integral_is_unstable_whatever_its_stiffness_and_kdamp_repairs_it() -> None:
    for k in (1e2, 1e4, 1e6):
        for kdamp, stable in ((0.0, False), (80.0, True)):
            law = HybridMotionForce(PUSH, 100.0, kd=20.0, kfp=1.0, kfi=1.0, kdamp=kdamp, constraints=Z)
            lin = ClosedLoop(arm("ur5"), law, Hold(EASY), environment=wall(EASY, k)).linearize([0.0])
            assert bool(lin.stable[0]) == stable


def test_the_misplaced_eta_leaves_a_motion_error_and_the_standard_form_none() -> None:
    """At the equilibrium of the printed law under PD: P Lambda Kp X_e = P (eta + F_tip)."""
    law = {"kp": 200.0, "kd": 28.0, "kfp": 1.0, "kdamp": 50.0, "constraints": Z}
    # the force is asked along the constraint at the pose of rest as well: the wall stays along z of where it was built
    for form in ("printed", "printed_eta"):
        loop = ClosedLoop(arm("ur5"), HybridMotionForce(PUSH, form=form, **law), Hold(EASY), environment=wall(EASY))
        rest = loop.equilibrium()
        Lambda, eta = arm("ur5").task_inertia(rest.q), arm("ur5").task_bias(rest.q, np.zeros(6))
        P = projection(Z, Lambda)
        assert_allclose(P @ Lambda @ (200.0 * rest.error), P @ (eta + rest.force), atol=1e-8)
        assert np.abs(rest.error).max() > 1e-2
        assert np.abs(loop.linearize([0.0]).residual).max() > 1.0
    loop = ClosedLoop(arm("ur5"), HybridMotionForce(PUSH, **law), Hold(EASY), environment=wall(EASY))
    rest = loop.equilibrium()
    assert_allclose(rest.error, 0, atol=1e-10)
    assert_allclose(rest.force, PUSH, atol=1e-8)


def test_selection_and_dynamic_projections_differ_where_lambda_couples() -> None:
    loops = [ClosedLoop(arm("ur5"), HybridMotionForce(PUSH, 100.0, kd=20.0, constraints=Z, projection=p), Hold(EASY), environment=wall(EASY))
             for p in ("dynamic", "selection")]  # fmt: skip
    A = [one.linearize([0.0]).A for one in loops]
    assert np.abs(A[0] - A[1]).max() > 1.0


def test_an_error_along_the_constraint_leaks_into_motion_and_not_into_force() -> None:
    """X_e is not projected first: A Lambda^-1 (tau of motion) stays 0, the free directions move."""
    law = HybridMotionForce(np.zeros(6), 100.0, kd=20.0, constraints=Z)
    loop = ClosedLoop(arm("ur5"), law, Hold(EASY))
    J, Lambda = arm("ur5").jacobian(EASY), arm("ur5").task_inertia(EASY)
    q = EASY - 1e-3 * np.linalg.solve(J, np.eye(6)[2])  # 1 mm short along z
    moved = loop.equations.rates(0.0, np.r_[q, np.zeros(6)])[6:]
    V_dot = J @ moved
    leak = np.linalg.solve(Lambda, projection(Z, Lambda) @ Lambda @ (100.0 * 1e-3 * np.eye(6)[2]))
    assert abs(leak[2]) < 1e-12 and np.abs(leak).max() > 1e-3
    assert_allclose(V_dot, leak, atol=5e-3 * np.abs(leak).max())  # 1 mm: the second order is 1e-3 of the first


def test_a_constraint_set_gives_the_same_law_as_its_rows() -> None:
    peg = peg_in_hole()
    one, two = (ClosedLoop(arm("ur5"), HybridMotionForce(np.zeros(6), 100.0, kd=20.0, constraints=c), Hold(EASY)).linearize([0.0]).A
                for c in (peg, np.eye(6)[[0, 1, 3, 4]]))  # fmt: skip
    assert_allclose(one, two, atol=1e-10)


def test_the_dynamic_projection_does_not_care_how_its_rows_are_scaled() -> None:
    laws = [HybridMotionForce(PUSH, 100.0, kd=20.0, constraints=c * Z) for c in (1.0, 7.0)]
    one, two = (ClosedLoop(arm("ur5"), law, Hold(EASY), environment=wall(EASY)).linearize([0.0]).A for law in laws)
    assert_allclose(one, two, atol=1e-8)


@pytest.mark.parametrize(("constraints", "project"), [
    (None, "dynamic"), (np.eye(6)[:, :5], "dynamic"), (np.zeros((1, 6)), "dynamic"), (np.ones((2, 6)), "dynamic"),
    (2 * Z, "selection"), ([[np.nan] * 6], "dynamic"), (np.zeros((0, 6)), "dynamic"), ("z", "dynamic"),
])  # fmt: skip
def test_constraints_that_are_none_are_refused(constraints: object, project: str) -> None:
    with pytest.raises(BadArgument) as info:
        HybridMotionForce(PUSH, 100.0, constraints=constraints, projection=project)
    assert info.value.argument == "constraints"


@pytest.mark.parametrize(("given", "argument"), [
    ({"projection": "static"}, "projection"), ({"form": "misprinted"}, "form"), ({"kp": [1.0, 2.0]}, "kp"), ({"kfp": np.eye(3)}, "kfp"),
    ({"kdamp": np.inf}, "kdamp"), ({"F_d": 3.0}, "F_d"),
])  # fmt: skip
def test_other_wrong_arguments_are_refused_by_name(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        ClosedLoop(arm("ur5"), HybridMotionForce(**{"F_d": PUSH, "kp": 100.0, "constraints": Z, **given}), Hold(EASY))
    assert info.value.argument == argument


def test_fewer_than_six_joints_have_no_lambda() -> None:
    with pytest.raises(BadArgument, match="axes= selects"):
        ClosedLoop(arm("planar_2r"), L.HybridMotionForce(PUSH, 100.0, constraints=Z), Hold([0.1, 0.2]))


@pytest.mark.parametrize("rows", [np.eye(6), np.eye(6) + 0.3 * np.triu(np.ones((6, 6)))])
def test_where_all_six_directions_carry_force_no_motion_gain_acts_and_nothing_is_trimmed_into_rounding(rows: np.ndarray) -> None:
    q = regular_pose("ur5")
    stiff = Environment(5e7, pose=arm("ur5").pose(q), axes="z", preload=3.0)  # not the force asked: a gap that no motion integral closes
    found = []
    for kp in (0.0, 2e4):
        law = HybridMotionForce(PUSH, kp=kp, ki=5e4, kd=300.0, kfp=1.0, kfi=10.0, kdamp=50.0, constraints=rows)
        lin = ClosedLoop(arm("ur5"), law, Hold(q), environment=stiff, hardware=Hardware(torque_lag=2e-3)).linearize()
        assert np.abs(lin.point.x).max() < 1e3  # z is 0
        assert (lin.margins().stable == lin.stability.nonzero_stable).all()
        found.append(np.sort_complex(lin.poles()[0]))
    assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-4)
