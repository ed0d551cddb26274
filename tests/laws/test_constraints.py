"""Constraint sets of 9.17-9.18 and the projector of 9.24."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.laws.constraints import ConstraintSet, checked_rows, peg_in_hole, projection, selection, surface_sliding
from mfc_analysis.maths.se3 import adjoint, exp6


def spd(seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(6, 6))
    return a @ a.T + 0.5 * np.eye(6)


def test_the_peg_in_the_hole_is_the_table_of_the_chapter() -> None:
    peg = peg_in_hole(insertion_speed=0.02)
    assert set(peg.natural) == {"vx", "vy", "wx", "wy", "fz", "mz"}
    assert set(peg.artificial) == {"fx", "fy", "vz", "mx", "my", "wz"}
    assert peg.artificial["vz"] == 0.02
    assert (peg.rank_free, peg.rank_constraint, peg.reciprocity) == (2, 4, 0.0)
    assert_allclose(peg.rows, np.eye(6)[[0, 1, 3, 4]], atol=1e-15)
    assert_allclose(peg.V_d, [0, 0, 0.02, 0, 0, 0])
    assert_allclose(peg.F_d, 0)


def test_a_sliding_face_keeps_two_translations_and_the_spin() -> None:
    face = surface_sliding(force=20.0)
    assert (face.rank_free, face.rank_constraint) == (3, 3)
    assert_allclose(face.rows, np.eye(6)[[2, 3, 4]], atol=1e-15)
    assert_allclose(face.F_d, [0, 0, 20, 0, 0, 0])


def test_a_moved_compliance_frame_keeps_reciprocity_and_moves_the_rows() -> None:
    X = exp6(np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6]))
    peg = peg_in_hole(frame=X)
    A = peg.rows
    assert_allclose(A @ A.T, np.eye(4), atol=1e-14)
    free_in_tool = adjoint(X) @ peg.twists
    assert_allclose(A @ free_in_tool, 0, atol=1e-15)
    # power does not depend on the frame: V . F of any pair is the same number in tool coordinates
    asked = ConstraintSet(natural=peg.natural, artificial={"vz": 0.3, "wz": -0.2, "fx": 4.0, "my": 2.0}, frame=X)
    assert abs(asked.V_d @ asked.F_d) < 1e-15
    # by hand: a wrench at the compliance frame's origin, f = R f_c, m = R m_c + p x f
    f = X[:3, :3] @ [4.0, 0, 0]
    assert_allclose(asked.F_d, np.r_[f, X[:3, :3] @ [0, 2.0, 0] + np.cross(X[:3, 3], f)], atol=1e-14)


def test_names_alone_are_enough_and_missing_references_are_zero() -> None:
    named = ConstraintSet(natural=("vz", "fx", "fy", "mx", "my", "mz"), artificial={"fz": 5})
    assert named.artificial == {"vx": 0.0, "vy": 0.0, "wx": 0.0, "wy": 0.0, "wz": 0.0, "fz": 5.0}
    assert (named.rank_free, named.rank_constraint) == (5, 1)


def test_general_twists_give_their_reciprocal_wrenches() -> None:
    twists = np.array([[0, 0, 1, 0, 0, 0.01], [1, 0, 0, 0, 0.3, 0]]).T  # a screw of 10 mm per radian, and a second motion
    screw = ConstraintSet(natural=twists)
    assert (screw.rank_free, screw.rank_constraint) == (2, 4)
    assert screw.reciprocity < 1e-15
    assert_allclose(screw.rows @ twists, 0, atol=1e-15)
    again = ConstraintSet(natural=twists, artificial=screw.wrenches)
    assert_allclose(selection(again), selection(screw), atol=1e-14)


@pytest.mark.parametrize(
    ("natural", "artificial", "error", "says"),
    [
        ({"vx": 0, "fx": 0, "vy": 0, "vz": 0, "wx": 0, "wy": 0, "wz": 0}, None, BadArgument, "both vx and fx"),
        ({"vx": 0, "vy": 0, "vz": 0, "wx": 0, "wy": 0}, None, BadArgument, "neither wz nor mz"),
        ({"vx": 0.1, "vy": 0, "vz": 0, "wx": 0, "wy": 0, "wz": 0}, None, BadArgument, "vx = 0.1"),
        ({"vx": 0, "vy": 0, "vz": 0, "wx": 0, "wy": 0, "vq": 0}, None, UnknownName, "vq"),
        (("vx", "vy", "vz", "wx", "wy", "wz"), {"vx": 1.0}, BadArgument, "vx"),
        (("vx", "vy", "vz", "wx", "wy", "wz"), {"fx": np.nan}, BadArgument, "fx"),
        (np.eye(6)[:, :2], np.eye(6)[:, :4], BadArgument, "reciprocal"),
        (np.eye(6)[:, :2], np.eye(6)[:, 2:5], BadArgument, "add up to 6"),
        (np.ones((6, 2)), None, BadArgument, "independent"),
        (3.0, None, BadArgument, "free twists"),
    ],
)
def test_a_table_that_is_not_reciprocal_or_not_complete_is_refused(natural, artificial, error, says) -> None:
    with pytest.raises(error, match=says):
        ConstraintSet(natural, artificial)


def test_a_frame_that_is_no_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="frame"):
        peg_in_hole(frame=2 * np.eye(4))


def test_the_projector_kills_constraint_wrenches_and_accelerates_nothing_across() -> None:
    A = peg_in_hole(frame=exp6(np.array([0.1, 0.2, 0.0, 0.3, -0.4, 0.2]))).rows
    Lambda = np.stack([spd(0), spd(1)])
    P = projection(A, Lambda)
    assert P.shape == (2, 6, 6)
    assert_allclose(P @ P, P, atol=1e-12)
    assert_allclose(P @ A.T, 0, atol=1e-12)
    assert_allclose(A @ np.linalg.solve(Lambda, P), 0, atol=1e-12)
    assert_allclose(np.trace(P, axis1=1, axis2=2), 2)
    assert_allclose(projection(A, Lambda[1]), P[1], atol=1e-13)
    # scaling and mixing the rows does not change it
    mix = np.random.default_rng(3).normal(size=(4, 4))
    assert_allclose(projection(mix @ A, Lambda), P, atol=1e-10)


def test_projection_and_selection_agree_for_an_isotropic_inertia() -> None:
    peg = peg_in_hole()
    assert_allclose(projection(peg, 3.0 * np.eye(6)), selection(peg), atol=1e-15)


def test_no_rows_leave_everything_free_and_six_rows_nothing() -> None:
    assert_allclose(projection(np.zeros((0, 6)), spd(2)), np.eye(6))
    assert_allclose(projection(np.eye(6), spd(2)), 0, atol=1e-12)


def test_bad_rows_and_inertias_are_refused() -> None:
    with pytest.raises(BadArgument, match="independent"):
        projection([[0, 0, 1, 0, 0, 0], [0, 0, 2, 0, 0, 0]], np.eye(6))
    with pytest.raises(BadArgument, match="positive definite"):
        projection([[0, 0, 1, 0, 0, 0]], np.diag([1, 1, 1, 1, 1, -1.0]))
    with pytest.raises(BadArgument, match="shape"):
        projection([[0, 0, 1, 0, 0, 0]], np.eye(5))
    with pytest.raises(BadArgument, match="orthonormal"):
        selection([[0, 0, 2, 0, 0, 0]])
    with pytest.raises(BadArgument, match="constraints"):
        checked_rows([[0, 0, np.nan, 0, 0, 0]])


def test_it_prints_its_table() -> None:
    text = str(peg_in_hole(insertion_speed=0.5))
    assert "vx = 0" in text
    assert "vz = 0.5" in text
    assert "2 free directions" in text
    assert "rank_free=2" in repr(ConstraintSet(np.eye(6)[:, :2]))
