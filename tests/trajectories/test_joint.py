from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mfc_analysis import errors, robots
from mfc_analysis.trajectories import Hold, Quintic, Sinusoid, Waypoints, from_csv, warn_outside_limits
from mfc_analysis.trajectories.joint import least_common_period

REFS = [
    Hold([0.1, 0.2]),
    Quintic([0, 1], [1, 3], duration=2),
    Sinusoid([0, 1], [0.2, 0.3], [2, 3], phase=[0.1, -0.4]),
    Waypoints([0, 1, 1.5, 3], [[0, 1], [1, 1], [2, 0], [0, 3]]),
]


@pytest.mark.parametrize("ref", REFS, ids=lambda r: type(r).__name__)
def test_velocity_and_acceleration_are_derivatives(ref):
    t, h = np.array([0.3, 0.7, 1.3, 1.8]), 1e-5
    before, now, after = ref(t - h), ref(t), ref(t + h)
    assert_allclose((after.q - before.q) / (2 * h), now.v, atol=1e-8)
    assert_allclose((after.v - before.v) / (2 * h), now.a, atol=1e-7)


@pytest.mark.parametrize("ref", REFS, ids=lambda r: type(r).__name__)
def test_many_times_are_the_single_ones_stacked(ref):
    t = np.linspace(-1, 4, 7)
    many = ref(t)
    assert ref.n == 2 and ref.space == "joint"
    for part in many:
        assert part.shape == (7, 2)
    for k, x in enumerate(t):
        for one, whole in zip(ref(x), many, strict=True):
            assert one.shape == (2,)
            assert_allclose(one, whole[k], atol=1e-14)


@pytest.mark.parametrize("ref", REFS, ids=lambda r: type(r).__name__)
def test_a_time_that_is_not_finite_is_refused(ref):
    for t in (np.nan, [0.0, np.inf], "now", None):
        with pytest.raises(errors.BadArgument, match="t: got"):
            ref(t)


def test_integers_and_floats_are_alike():
    for a, b in ((Hold([1, 2]), Hold([1.0, 2.0])), (Quintic([0, 0], [1, 2], 2), Quintic([0.0, 0.0], [1.0, 2.0], 2.0))):
        for x, y in zip(a(1), b(1.0), strict=True):
            assert_array_equal(x, y)
    assert Hold(1).n == 1 and Hold(1)(0).q.shape == (1,)


def test_a_hold_stands_still():
    ref = Hold([0.1, 0.2])
    assert ref.is_hold and ref.period is None and ref.duration is None
    assert_array_equal(ref(3).q, [0.1, 0.2])
    assert not ref(3).v.any() and not ref(3).a.any()


def test_what_is_returned_or_given_is_no_way_to_change_a_reference():
    q = np.array([0.1, 0.2])
    ref = Hold(q)
    q[0] = 9
    ref(0).q[0] = 7
    assert_array_equal(ref(0).q, [0.1, 0.2])
    with pytest.raises(AttributeError):
        ref.q = [1, 2]


def test_a_quintic_is_at_rest_at_both_ends_and_held_outside():
    ref = Quintic([0, 1], [1, 3], duration=2.0)
    ends = ref([-1, 0, 2, 5])
    assert_array_equal(ends.q, [[0, 1], [0, 1], [1, 3], [1, 3]])
    assert not ends.v.any() and not ends.a.any()
    middle = ref(1.0)
    assert_allclose(middle.q, [0.5, 2])
    assert_allclose(middle.v, np.array([1, 2]) * 15 / 8 / 2)  # the greatest speed: 15/8 of the mean
    assert (ref.duration, ref.period, ref.is_hold) == (2.0, None, False)
    assert Quintic([1], [1]).is_hold and Quintic([0], [1]).duration == 2.0


def test_a_sinusoid_is_what_the_contract_says():
    ref = Sinusoid(center=[1, 2], amplitude=[0.1, 0.2], frequency=3.0, phase=0.4)
    assert_allclose(ref(0.7).q, [1, 2] + np.array([0.1, 0.2]) * np.sin(3 * 0.7 + 0.4))
    assert ref.period == pytest.approx(2 * np.pi / 3) and ref.duration is None


def test_the_period_is_the_least_common_one_of_the_joints_that_move():
    assert Sinusoid([0, 0], 1, [2, 3]).period == pytest.approx(2 * np.pi)
    assert Sinusoid([0, 0], 1, [0.3 * 2 * np.pi, 0.7 * 2 * np.pi]).period == pytest.approx(10.0)
    assert Sinusoid([0, 0], [1, 0], [2, np.sqrt(2)]).period == pytest.approx(np.pi)  # the second joint stands still
    assert Sinusoid([0, 0], 1, [2, 0]).period == pytest.approx(np.pi)
    still = Sinusoid([0, 0], 0, 2)
    assert still.period is None and still.is_hold


def test_frequencies_without_a_common_period_are_an_error():
    ref = Sinusoid([0, 0], 1, [1, np.sqrt(2)])
    ref(0.3)
    with pytest.raises(errors.BadArgument, match="frequency"):
        _ = ref.period


def test_a_common_period_is_a_whole_number_of_each():
    rng = np.random.default_rng(0)
    for _ in range(20):
        w = rng.uniform(0.1, 5) * rng.integers(1, 30, 3) / rng.integers(1, 12)
        T = least_common_period(w)
        turns = T * w / (2 * np.pi)
        assert_allclose(turns, np.round(turns), atol=1e-6)
        assert np.gcd.reduce(np.round(turns).astype(int)) == 1


def test_waypoints_are_met_smoothly_and_the_ends_at_rest():
    times, positions = [0, 1, 1.5, 3], np.array([[0, 1], [1, 1], [2, 0], [0, 3.0]])
    ref = Waypoints(times, positions)
    assert_allclose(ref(times).q, positions, atol=1e-13)
    for t in (0, 3, -1, 4):
        assert_allclose(ref(t).v, 0, atol=1e-13)
        assert_allclose(ref(t).a, 0, atol=1e-13)
    for t in (1.0, 1.5):
        for left, right in zip(ref(t - 1e-9), ref(t + 1e-9), strict=True):
            assert_allclose(left, right, atol=1e-6)
    assert ref.duration == 3.0 and ref.period is None
    assert_allclose(ref(9).q, positions[-1], atol=1e-13)


def test_two_waypoints_are_a_quintic():
    a, b = Waypoints([0, 2], [[0, 1], [1, 3]]), Quintic([0, 1], [1, 3], 2)
    for x, y in zip(a(np.linspace(0, 2, 9)), b(np.linspace(0, 2, 9)), strict=True):
        assert_allclose(x, y, atol=1e-12)


def test_waypoints_of_one_joint_may_be_flat():
    assert Waypoints([0, 1, 2], [0.0, 1.0, 0.5])(1).q == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: Hold([]), "q"),
        (lambda: Hold([1, np.nan]), "q"),
        (lambda: Hold([[1, 2]]), "q"),
        (lambda: Hold("ab"), "q"),
        (lambda: Quintic([0, 1], [1]), "q1"),
        (lambda: Quintic([0], [1], duration=0), "duration"),
        (lambda: Quintic([0], [1], duration=np.inf), "duration"),
        (lambda: Sinusoid([0, 1], [1, 2, 3], 1), "amplitude"),
        (lambda: Sinusoid([0, 1], 1, -1), "frequency"),
        (lambda: Sinusoid([0, 1], 1, 1, phase=np.nan), "phase"),
        (lambda: Waypoints([0, 1, 1], np.zeros((3, 2))), "times"),
        (lambda: Waypoints([0], np.zeros((1, 2))), "times"),
        (lambda: Waypoints([0, 1], np.zeros((3, 2))), "positions"),
        (lambda: Waypoints([0, 1], [[0, 1], [np.inf, 2]]), "positions"),
    ],
)
def test_bad_arguments_are_refused_by_name(make, names):
    with pytest.raises(errors.BadArgument) as info:
        make()
    assert info.value.argument == names


# --- from a file --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "0,0,1\n1,1,1\n3,2,0\n",
        "time,j1,j2\n0,0,1\n1,1,1\n3,2,0\n",
        "# made by hand\n\nt;a;b\n0;0;1\n1;1;1\n3;2;0",
        "0\t0\t1\n1\t1\t1\n3\t2\t0",
        "\ufeff0 0 1\r\n1  1 1\r\n3 2 0\r\n",
        "time 1st 2nd\n0 0 1\n1 1 1\n3 2 0\n",
    ],
)
def test_a_table_with_or_without_a_header_becomes_waypoints(tmp_path, text):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8", newline="")
    ref = from_csv(path)
    assert_allclose(ref([0, 1, 3]).q, [[0, 1], [1, 1], [2, 0]], atol=1e-13)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0,0\n1,x\n", "line 2.*'x'"),
        ("t,j\n0,0\nu,v\n", "line 3.*'u'"),
        ("0,0\n1,nan\n", "line 2.*'nan'"),
        ("0,0\n1,1,1\n", "line 2.*3 columns"),
        ("0\n1\n", "line 1.*1 columns.*at least one joint"),
        ("0,0\n0,1\n", "line 2.*increase"),
        ("0,0\n1,\n", "line 2.*''"),
        ("0,0\n1,1_0\n", "line 2.*'1_0'"),
        ("0,0\n1,\uff12\n", "line 2.*'\uff12'"),
        ("0,0;1,5\n1,0;2,5\n", "line 1.*'0,0'"),
        ("nan,nan\n0,0\n1,1\n", "line 1.*'nan'"),
        ("0,0\n1,1e400\n", "line 2.*'1e400'"),
        ("t,j\n0,0\n", "at least two times"),
        ("", "at least two times"),
    ],
)
def test_a_bad_table_names_its_line(tmp_path, text, says):
    path = tmp_path / "path.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(errors.BadArgument, match=says):
        from_csv(path)


@pytest.mark.parametrize("start", [1.7e9, 1700000000.25, 1.7e12, 345678.9])
def test_readings_of_a_clock_are_refused_and_say_what_to_subtract(tmp_path, start):
    path = tmp_path / "log.csv"
    path.write_text("".join(f"{start + t!r},{t * t!r}\n" for t in range(11)))
    with pytest.raises(errors.BadArgument, match=f"log.csv, column 1: got '10 s of motion.*subtract the first, {start!r}"):
        from_csv(path)
    with pytest.raises(errors.BadArgument, match=r"times: got .*readings of a clock"):
        Waypoints(start + np.arange(11.0), np.zeros(11))
    assert Waypoints(np.arange(11.0), np.zeros(11)).duration == 10.0


def test_a_long_motion_and_a_late_one_are_no_clock():
    for times in ([9e3, 9001.0], [2e4, 3e4], [-1.7e9, 0.0], [0.0, 1e11]):
        assert Waypoints(times, [0.0, 1.0])(times[1]).q == pytest.approx(1.0)


def test_a_table_that_is_not_there_is_refused(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\x00\xfe")
    for path in (tmp_path / "none.csv", tmp_path, tmp_path / "binary", None):
        with pytest.raises(errors.BadArgument, match="path"):
            from_csv(path)


# --- limits -------------------------------------------------------------------------------------------------------------------


def test_leaving_the_joint_limits_warns_of_joint_and_time():
    panda = robots.load("panda")
    q0 = np.array([0, -0.4, 0, -2.2, 0, 2, 0.7])
    inside, outside = Quintic(q0, q0 + 0.1, 2.0), Quintic(q0, [0, 2.6, 0, -2.2, 0, 2, 0.7], 2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert warn_outside_limits(panda, inside, np.linspace(0, 2, 21)) == ()
    speed = pytest.warns(errors.MfcWarning, match=r"moves joint 'panda_joint2' at 2.812 at t = 1 s, above its limit 2.175")
    with speed, pytest.warns(errors.MfcWarning, match="limits of joint 'panda_joint2' at t = 2 s: 2.6 is outside"):
        found = warn_outside_limits(panda, outside, np.linspace(0, 2, 21))
    assert len(found) == 2


def test_a_continuous_joint_has_no_limits_to_leave():
    kinova = robots.load("kinova")
    q0 = np.array([0, 2.9, 1.3, 4.2, 1.4, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert warn_outside_limits(kinova, Quintic(q0, [100, 2.9, 1.3, 4.2, 1.4, 0], 1000), [0.0, 1000.0]) == ()
