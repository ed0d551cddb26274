from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis import errors
from mfc_analysis.maths.se3 import exp3, exp6, inverse, log3, log6
from mfc_analysis.trajectories import ToolCircle, ToolHold, ToolLine, ToolSinusoid

X0 = exp6(np.array([0.1, 0.2, 0.3, 0.5, -0.4, 1.0]))
X1 = X0 @ exp6(np.array([0.3, -0.2, 0.1, 0.8, 1.2, -0.7]))
REFS = [
    ToolHold(X0),
    ToolLine(X0, X1, 2),
    ToolSinusoid(X0, [0.1, 0.2, 0.3], 3, axis=[1, 2, 3], angle=0.7, phase=0.2),
    ToolCircle(X0, 0.1, 2, normal=(1, 1, 0)),
]
NAMES = [type(r).__name__ for r in REFS]


@pytest.mark.parametrize("ref", REFS, ids=NAMES)
def test_the_twist_is_the_references_own_and_its_rate_the_derivative(ref):
    h = 1e-5
    for t in (0.2, 0.7, 1.6):
        before, now, after = ref(t - h), ref(t), ref(t + h)
        assert_allclose(log6(inverse(before.X) @ after.X) / (2 * h), now.V, atol=1e-8)
        assert_allclose((after.V - before.V) / (2 * h), now.dV, atol=1e-8)
        assert_allclose(log6(inverse(now.X) @ after.X) / h, now.V + 0.5 * h * now.dV, atol=1e-8)  # one-sided


@pytest.mark.parametrize("ref", REFS, ids=NAMES)
def test_poses_are_rigid_and_many_times_are_the_single_ones_stacked(ref):
    t = np.linspace(-1, 4, 7)
    many = ref(t)
    assert [x.shape for x in many] == [(7, 4, 4), (7, 6), (7, 6)] and ref.space == "tool"
    R = many.X[:, :3, :3]
    assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    assert_array_equal(many.X[:, 3], np.tile([0, 0, 0, 1.0], (7, 1)))
    for k, x in enumerate(t):
        for one, whole in zip(ref(x), many, strict=True):
            assert_allclose(one, whole[k], atol=1e-15)
    with pytest.raises(errors.BadArgument, match="t: got"):
        ref(np.nan)


@pytest.mark.parametrize("ref", REFS[2:], ids=NAMES[2:])
def test_a_period_brings_everything_back(ref):
    for a, b in zip(ref(0.3), ref(0.3 + ref.period), strict=True):
        assert_allclose(a, b, atol=1e-12)


def test_a_hold_stands_still_at_its_pose():
    ref = ToolHold(X0)
    assert ref.is_hold and ref.period is None and ref.duration is None
    assert_array_equal(ref(5).X, X0)
    assert not ref(5).V.any()
    ref(5).X[0, 0] = 9
    assert_array_equal(ref(5).X, X0)


def test_a_pinocchio_se3_is_a_pose():
    given = pin.SE3(X0[:3, :3], X0[:3, 3])
    assert_array_equal(ToolHold(given)(0).X, X0)
    assert_allclose(ToolLine(given, pin.SE3(X1[:3, :3], X1[:3, 3]), 1)(1).X, X1, atol=1e-14)


def test_a_line_is_straight_about_a_fixed_axis_and_at_rest_at_both_ends():
    ref = ToolLine(X0, X1, duration=2.0)
    ends = ref([0, 2, 7])
    assert_allclose(ends.X, np.stack([X0, X1, X1]), atol=1e-14)
    assert not ends.V.any() and not ends.dV.any()
    t = np.linspace(0.1, 1.9, 7)
    p = ref(t).X[:, :3, 3] - X0[:3, 3]
    along = X1[:3, 3] - X0[:3, 3]
    assert_allclose(np.cross(p, along), 0, atol=1e-15)
    w = ref(t).V[:, 3:]
    assert_allclose(np.cross(w, log3(X0[:3, :3].T @ X1[:3, :3])), 0, atol=1e-13)
    half = ref(1.0).X
    assert_allclose(half[:3, :3], X0[:3, :3] @ exp3(0.5 * log3(X0[:3, :3].T @ X1[:3, :3])), atol=1e-14)
    assert (ref.duration, ref.period, ref.is_hold) == (2.0, None, False)
    assert ToolLine(X0, X0, 1).is_hold and not ToolLine(X0, X0, 1)(0.5).V.any()


def test_a_sinusoid_is_what_the_contract_says():
    amplitude, w, axis, angle, phase = np.array([0.1, 0.2, 0.3]), 3.0, np.array([0, 3.0, 4.0]), 0.7, 0.2
    X = ToolSinusoid(X0, amplitude, w, axis=axis, angle=angle, phase=phase)(0.9).X
    s = np.sin(w * 0.9 + phase)
    assert_allclose(X[:3, 3], X0[:3, 3] + amplitude * s)
    assert_allclose(X[:3, :3], X0[:3, :3] @ exp3(axis / 5 * angle * s), atol=1e-14)
    assert ToolSinusoid(X0, amplitude, w).period == pytest.approx(2 * np.pi / 3)
    still = ToolSinusoid(X0, 0, 1)
    assert still.is_hold and still.period is None


def test_a_circle_starts_at_its_pose_and_keeps_orientation_and_radius():
    for normal in ((0, 0, 1), (1, 0, 0), (1, 1, 0), (0, 0, -2)):
        ref = ToolCircle(X0, 0.1, 2, normal=normal)
        assert_allclose(ref(0).X, X0, atol=1e-15)
        t = np.linspace(0, ref.period, 8, endpoint=False)
        X = ref(t).X
        assert_allclose(X[:, :3, :3], np.broadcast_to(X0[:3, :3], (8, 3, 3)))
        p = X[:, :3, 3]
        assert_allclose(np.linalg.norm(p - p.mean(axis=0), axis=1), 0.1)
        assert_allclose((p - p[0]) @ np.array(normal, float), 0, atol=1e-15)
        assert_allclose(np.linalg.norm(ref(t).V, axis=1), 0.2)
        assert np.cross(p[0] - p.mean(axis=0), p[1] - p.mean(axis=0)) @ np.array(normal, float) > 0


BAD_X = X0.copy()
BAD_X[0, 0] += 0.1
FLIPPED = X0 @ np.diag([1, 1, -1, 1.0])


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: ToolHold(BAD_X), "X"),
        (lambda: ToolHold(FLIPPED), "X"),
        (lambda: ToolHold(np.eye(3)), "X"),
        (lambda: ToolHold(np.full((4, 4), np.nan)), "X"),
        (lambda: ToolHold("here"), "X"),
        (lambda: ToolLine(X0, BAD_X, 1), "X1"),
        (lambda: ToolLine(X0, X1, 0), "duration"),
        (lambda: ToolLine(X0, X0 @ np.diag([-1, -1, 1, 1.0]), 1), "X1"),
        (lambda: ToolSinusoid(X0, [1, 2], 1), "amplitude"),
        (lambda: ToolSinusoid(X0, 1, 0), "frequency"),
        (lambda: ToolSinusoid(X0, 1, 1, axis=(0, 0, 0)), "axis"),
        (lambda: ToolSinusoid(X0, 1, 1, angle=np.inf), "angle"),
        (lambda: ToolCircle(X0, 0, 1), "radius"),
        (lambda: ToolCircle(X0, 1, -1), "frequency"),
        (lambda: ToolCircle(X0, 1, 1, normal=(0, 0, 0)), "normal"),
    ],
)
def test_bad_arguments_are_refused_by_name(make, names):
    with pytest.raises(errors.BadArgument) as info:
        make()
    assert info.value.argument == names


@pytest.mark.parametrize("ref", REFS, ids=NAMES)
def test_one_time_gives_what_many_give(ref):
    times = np.array([0.0, 0.3, 1.7, 2.5])
    for k, t in enumerate(times):
        for one, many in zip(ref(float(t)), ref(times), strict=True):
            assert_allclose(one, many[k], atol=1e-14)
