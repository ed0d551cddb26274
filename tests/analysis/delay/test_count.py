"""The count of unstable roots with dead time against roots found in other ways: Lambert's function, Newton, the residue theorem."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.special import lambertw

from mfc_analysis.analysis.delay import count
from mfc_analysis.analysis.delay.characteristic import Delayed, delayed_points, stacked
from mfc_analysis.analysis.delay.count import disc_counts, roots_within, unstable_counts, unstable_roots
from mfc_analysis.analysis.stability import stability
from mfc_analysis.errors import NotConverged
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")
RADIUS = 0.01


def delayed(L, T: float) -> Delayed:
    return delayed_points(open_system(L, delay=T))[0]


def integrator(k: float, T: float, radius: float = RADIUS) -> tuple[int, float]:
    """Unstable roots of s + k e^(-sT) that are not slow, by Lambert's function, and the smallest distance of one from the contour."""
    branches = int(k * T / 2) + 4
    roots = lambertw(-k * T, np.arange(-branches, branches + 1)) / T
    gap = np.minimum(np.abs(roots.real) / np.abs(roots), np.abs(np.abs(roots) / radius - 1) if radius else 1)
    return int(((roots.real > 0) & (np.abs(roots) >= radius)).sum()), float(gap.min())


@settings(max_examples=60)
@given(k=st.floats(-2, 3).map(lambda x: 10**x), kT=st.floats(-3, 3).map(lambda x: 10**x))
def test_an_integrator_has_the_unstable_roots_of_lambert(k, kT):
    expected, gap = integrator(k, kT / k)
    assume(gap > 1e-6)
    assert unstable_roots(delayed(k / s, kT / k), RADIUS)[0] == expected


@pytest.mark.parametrize("kT", np.geomspace(1e-3, 1e9, 13))
def test_an_integrator_is_stable_up_to_a_quarter_period_over_twelve_decades(kT):
    for k in (0.5, 30.0):
        system = replace(open_system(k / s, delay=kT / k), horizon=np.inf)
        assert bool(stability(system).nonzero_stable[0]) == (kT < np.pi / 2)


@pytest.mark.parametrize("off", [1e-3, 1e-6, 1e-8])
@pytest.mark.parametrize("k", [0.1, 1.0, 1e4])
def test_the_boundary_is_sharp(k, off):
    for side in (1, -1):
        assert unstable_roots(delayed(k / s, np.pi / 2 / k * (1 + side * off)), 0.0)[0] == (2 if side > 0 else 0)


def quasi_roots(a: float, b: float, c: float, T: float, radius: float) -> tuple[int, float]:
    """Unstable roots of s^2 + a s + b + c e^(-sT) with abs(s) >= radius, by Newton from a fine grid, and their smallest relative distance
    from the contour. Those with a real part >= 0 have abs(s) <= the largest root of s^2 = abs(a) s + abs(b) + abs(c)."""
    reach = 1.05 * (abs(a) + np.sqrt(a * a + 4 * (abs(b) + abs(c)))) / 2
    x, y = np.meshgrid(np.linspace(-0.15, 1, 36) * reach, np.linspace(0, 1, int(30 + 3 * reach * T)) * reach)
    z = (x + 1j * y).ravel()
    with np.errstate(all="ignore"):
        for _ in range(60):
            late = c * np.exp(-z * T)
            z = z - (z * z + a * z + b + late) / (2 * z + a - T * late)
            z = z[np.isfinite(z) & (np.abs(z) < 3 * reach) & (z.real > -reach)]
        late = c * np.exp(-z * T)
        z = z[np.abs(z * z + a * z + b + late) < 1e-9 * (np.abs(z) ** 2 + abs(a * z) + abs(b) + np.abs(late))]
    z = np.where(np.abs(z.imag) < 1e-7 * np.abs(z), z.real, z)
    z = np.concatenate([z, z.conj()])
    z = z[np.unique(np.round(z / reach, 6), return_index=True)[1]]
    gap = np.minimum(np.abs(z.real) / np.abs(z), np.abs(np.abs(z) / radius - 1)).min(initial=1.0)
    apart = np.abs(z[:, None] - z) + np.eye(z.size) * reach
    return int(((z.real > 0) & (np.abs(z) >= radius)).sum()), float(min(gap, apart.min(initial=reach) / reach))


@settings(max_examples=60)
@given(a=st.floats(-1, 3), b=st.floats(-4, 9), c=st.floats(-9, 9), T=st.floats(0.01, 4))
def test_a_second_order_loop_has_the_unstable_roots_that_newton_finds(a, b, c, T):
    assume(abs(c) > 1e-3)
    expected, gap = quasi_roots(a, b, c, T, RADIUS)
    assume(gap > 1e-4)
    point = delayed(c / (s**2 + a * s + b), T)
    assert unstable_roots(point, RADIUS)[0] == expected


@pytest.mark.parametrize("T", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("w", [1.0, 2.0, 3.0, 7.3])
def test_an_undamped_pole_that_a_small_delayed_gain_moves_is_seen(w, T):
    # s^2 + w^2 + eps s e^(-sT): the root near jw moves by -eps/2 e^(-jwT)
    for eps in (1e-2, 1e-4, 1e-6, 1e-8):
        expected = 0 if np.cos(w * T) > 0 else 2
        assert (unstable_roots(delayed(eps * s / (s**2 + w**2), T), RADIUS)[0] > 0) is (expected > 0)


@pytest.mark.parametrize("zeta", [1e-2, 1e-6, 1e-7])
def test_a_narrow_resonance_with_a_long_dead_time(zeta):
    # w T = 1e4: with the gain 2 zeta eta the loop is at most eta / zeta-fold, and unstable from eta = 1 on where the phase is right
    w = 1e4
    quarter = np.round(w / (2 * np.pi)) * 2 * np.pi
    for eta, phase, stable in ((0.9, 0.0, True), (0.9, np.pi, True), (1.1, 0.0, True), (1.1, np.pi, False)):
        T = (quarter + phase) / w
        if eta > 1 and zeta * w * T > 0.1:
            continue  # broader than a turn of e^(-sT): some phase is always right
        point = delayed(2 * zeta * eta * w * s / (s**2 + 2 * zeta * w * s + w**2), T)
        assert (unstable_roots(point, RADIUS)[0] == 0) is stable


@pytest.mark.parametrize("apart", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("side", [1, -1])
def test_two_roots_close_together_near_the_axis_are_two(apart, side):
    # two separate loops k/s whose pairs lie beside j pi/(2T), on the same or on both sides of the axis
    T = 0.3
    for gains, expected in (((1 + apart, 1 + 2 * apart), 4), ((1 + apart, 1 - apart), 2), ((1 - apart, 1 - 2 * apart), 0)):
        k = np.pi / 2 / T * np.array(gains)[::side]
        point = Delayed(np.zeros((2, 2)), np.eye(2), -np.diag(k), np.zeros((2, 2)), np.array([T, T]), np.ones(2))
        assert unstable_roots(point, RADIUS)[0] == expected
        assert unstable_roots(replace(point, T=np.array([T, T * (1 + 1e-9)])), RADIUS)[0] == expected


def test_the_walk_along_the_axis_starts_at_the_radius_and_resolves_the_roots_near_it():
    walk = unstable_roots(delayed(1 / s, np.pi / 2 * (1 - 1e-6)), RADIUS)[1]
    assert walk.s[0] == 1j * RADIUS and (np.diff(walk.s.imag) > 0).all() and not walk.on_it.size
    assert np.diff(walk.s.imag)[np.abs(walk.s.imag[:-1] - 1) < 1e-4].min() < 1e-5


def test_a_root_on_the_axis_is_reported_as_unstable():
    number, walk = unstable_roots(delayed(1 / s, np.pi / 2), RADIUS)
    assert number >= 1
    assert not walk.on_it.size or abs(walk.on_it[0] - 1j) < 1e-8


@settings(max_examples=40)
@given(kT=st.floats(0.05, 20), radius=st.floats(0.1, 20), x=st.floats(-2, 1), y=st.floats(0.2, 15))
def test_a_disc_holds_the_roots_of_lambert_in_it(kT, radius, x, y):
    roots = lambertw(-kT, np.arange(-20, 21))
    point = delayed(kT / s, 1.0)
    for center in (0.0, complex(x, y)):
        distance = np.abs(roots - center) / radius
        if np.abs(distance - 1).min() > 1e-2:
            assert roots_within(point, radius, center) == (distance < 1).sum()


def test_a_contour_that_takes_too_many_samples_says_so():
    with pytest.raises(NotConverged, match="samples"):
        unstable_roots(delayed(1e5 / (s + 1), 100.0), RADIUS)


@settings(max_examples=60)
@given(d=st.floats(0.5, 0.995), sign=st.sampled_from((1, -1)), k=st.floats(-20, 20), T=st.floats(0.05, 3))
def test_a_direct_gain_below_one_leaves_the_count_of_nyquists_plot(d, sign, k, T):
    L = sign * d + k / (s + 1)
    end = 3 * abs(k) / (1 - d) + 10
    w = np.union1d(np.linspace(0, min(end, 100), 30_001), np.linspace(0, end, 60_001))
    g = 1 + (sign * d + k / (1j * w + 1)) * np.exp(-1j * w * T)
    assume(np.abs(g).min() > 1e-3)
    turn = np.unwrap(np.angle(g))
    encircled = -(turn[-1] - turn[0] - np.angle(g[-1])) / np.pi  # far away g - 1 is below one: the arc at infinity keeps to the right half plane
    assert unstable_roots(delayed(L, T), 0.0)[0] == round(encircled)


def test_a_limit_of_samples_holds_for_the_disc_at_the_origin_too(monkeypatch):
    limits = []
    within = count.disc_counts
    monkeypatch.setattr(count, "disc_counts", lambda *about: limits.append(about[3]) or within(*about))
    assert unstable_roots(delayed(1 / s, 1.0), 0.0, 2000)[0] == 0
    assert limits == [2000]


def test_points_are_counted_together_as_they_are_alone(rng):
    points = delayed_points(replace(random_loops(rng, 40, 4, 2), wire_delay=np.array([0.31, 0.12])))
    for radius in (RADIUS, 0.0):
        together = unstable_counts(stacked(points), radius)
        assert [one.number for one in together] == [unstable_roots(point, radius).number for point in points]
        assert {one.number > 0 for one in together} == {False, True}
    discs = disc_counts(stacked(points), np.full(40, 3.0))
    assert discs == [roots_within(point, 3.0) for point in points] and max(discs) > 1


def test_a_point_that_takes_too_many_samples_does_not_stop_the_others():
    """With k/(s + 1) at two points: 1e5 at a dead time of 100 s takes too many; 0.5 has no unstable root, 1.2 has some (k > 1, a long dead time)."""
    points = [delayed(k / (s + 1), 100.0) for k in (0.5, 1e5, 1.2)]
    few, long, some = unstable_counts(stacked(points), RADIUS, 3000)
    assert few.number == 0 and some.number == unstable_roots(points[2], RADIUS).number > 0
    assert isinstance(long, NotConverged)
