"""Loops over stiffness: the affine shortcut against direct linearisations, and the one-mass closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.design.stiffness import at_stiffness, over_stiffness, stable_up_to, stiffness_map
from mfc_analysis.errors import BadArgument

F_D = np.array([0, 0, 10.0, 0, 0, 0])
Z = np.array([0, 0, 1.0, 0, 0, 0])
Q = np.array([0.3, -1.25, 1.9, -2.2, -1.57, 0.2])


def slider(kfp: float = 1.0, kfi: float = 5.0, kdamp: float = 20.0, **hardware: float) -> mfc.ClosedLoop:
    law = mfc.laws.DampedForcePI(F_D, kfp * Z, kfi * Z, kdamp * Z)
    surface = mfc.Environment(stiffness=1e4, preload=10.0)
    return mfc.ClosedLoop(mfc.robots.slider(), law, mfc.trajectories.Hold([0.0]), environment=surface, hardware=mfc.Hardware(**hardware))


def arm(**hardware: float) -> mfc.ClosedLoop:
    law = mfc.laws.DampedForcePI(F_D, Z, 5 * Z, [100, 100, 100, 2, 2, 2])
    surfaces = [mfc.Environment(1e4, 5.0, preload=10.0), mfc.Environment([2000, 2000, 50, 50, 20.0], axes="xyrxryrz")]
    return mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(Q), environment=surfaces, hardware=mfc.Hardware(**hardware))


@pytest.mark.parametrize("k", [150.0, 3e3, 7e5])
def test_the_line_through_two_stiffnesses_is_the_loop_at_any_other(k: float) -> None:
    loop = arm(torque_lag=2e-3, force_filter=1e-3)
    direct = at_stiffness(loop, k).linearize().opened
    swept = over_stiffness(loop, [k]).opened
    for name in "ABCD":
        assert_allclose(getattr(swept, name), getattr(direct, name), rtol=1e-9, atol=1e-9 * np.abs(getattr(direct, name)).max())


def test_poles_of_the_one_mass_loop_are_the_roots_of_its_polynomial_at_every_stiffness() -> None:
    k, m, T, kfp, kfi, kdamp = np.geomspace(1e2, 1e6, 9), 1.0, 2e-3, 1.0, 5.0, 20.0
    swept = over_stiffness(slider(torque_lag=T), k)
    for stiffness, poles in zip(k, swept.poles, strict=True):
        wanted = [m * T, m, kdamp + stiffness * T, stiffness * (1 + kfp), stiffness * kfi]
        assert_allclose(np.poly(poles[np.abs(poles) > 0]).real * m * T, wanted, rtol=1e-8)


def test_the_boundary_of_the_map_is_the_closed_form() -> None:
    T, kfi, kdamp, kfp = 2e-3, 5.0, 20.0, np.array([0.5, 1.0, 2.0, 5.0])
    found = stiffness_map(lambda g: slider(g, kfi, kdamp, torque_lag=T), np.geomspace(1e2, 1e6, 400), kfp).boundary()
    assert_allclose(found, (kdamp * (1 + kfp) - kfi) / (T * kfp * (1 + kfp)), rtol=1e-3)  # interpolated on a grid of 2.3 %


def test_without_lag_stiffness_decides_nothing() -> None:
    stiffness = np.geomspace(1e2, 1e6, 9)
    assert over_stiffness(slider(kfi=39.9), stiffness).stable.all()  # (b + kdamp)(1 + kfp) = 40 > m kfi
    assert not over_stiffness(slider(kfi=40.1), stiffness).stable.any()
    assert np.isinf(stiffness_map(lambda g: slider(g), stiffness, [0.5, 2.0]).boundary()).all()


def test_dead_time_counts_in_growth_and_verdict_on_both_sides() -> None:
    loop = slider(torque_lag=2e-3, delay=1e-3)
    stiffness = np.geomspace(1e3, 1e5, 40)
    swept = over_stiffness(loop, stiffness)
    assert (swept.stable == (swept.growth < 0)).all()
    last = int(np.flatnonzero(swept.stable)[-1])
    assert at_stiffness(loop, stiffness[last]).linearize().stable[0]
    assert not at_stiffness(loop, stiffness[last + 1]).linearize().stable[0]


def test_margins_over_stiffness_are_those_of_each_loop() -> None:
    swept = over_stiffness(slider(torque_lag=2e-3), [1e3, 5e3]).margins("force")
    for i, k in enumerate((1e3, 5e3)):
        alone = at_stiffness(slider(torque_lag=2e-3), k).linearize().margins("force")
        assert_allclose(swept.phase_deg[i, 2], alone.phase_deg[0, 2], rtol=1e-9)


def test_a_surface_pressed_in_at_the_operating_point_keeps_its_force() -> None:
    loop = slider(torque_lag=2e-3)
    pose = np.eye(4)
    pose[2, 3] = -1e-3  # 1 mm inside: 10 N and the preload
    pressed = mfc.ClosedLoop(loop.robot, loop.law, loop.ref, environment=mfc.Environment(1e4, pose=pose, preload=2.0), hardware=loop.hardware)
    moved = at_stiffness(pressed, 5e4)
    assert moved.simulate([0.0]).force[0, 2] == pytest.approx(12.0)


def test_what_cannot_be_varied_is_named() -> None:
    bare = mfc.ClosedLoop(mfc.robots.slider(), slider().law, mfc.trajectories.Hold([0.0]), environment=mfc.Environment(1e4))
    with pytest.raises(BadArgument, match="preload"):
        over_stiffness(bare, [1e3])
    with pytest.raises(BadArgument, match="stiffness"):
        over_stiffness(slider(), [-1.0])


@pytest.mark.parametrize("hardware", [{}, {"delay": 1e-3, "force_filter": 2e-3}], ids=["lag", "lag, delay, filter"])
def test_the_largest_stable_stiffness_is_that_of_the_bisection(hardware: dict[str, float]) -> None:
    loop = slider(torque_lag=2e-3, **hardware)
    found = stable_up_to(loop)
    assert found == pytest.approx(float(mfc.design.max_stiffness(loop)), rel=1e-5)
    assert at_stiffness(loop, 0.999 * found).linearize().stable[0]
    assert not at_stiffness(loop, 1.001 * found).linearize().stable[0]
    if not hardware:
        assert found == pytest.approx((20.0 * 2 - 5.0) / (2e-3 * 2), rel=1e-6)


def test_a_loop_without_a_limit_says_so_and_one_that_is_never_stable_too() -> None:
    assert stable_up_to(slider()) == np.inf
    assert np.isnan(stable_up_to(slider(kfi=50.0)))


def test_a_force_channel_that_no_gain_uses_has_no_loop() -> None:
    law = mfc.laws.DampedForcePI(F_D, Z, 5 * Z, [100, 100, 100, 2, 2, 2])
    surfaces = [mfc.Environment(3e3, preload=10.0), mfc.Environment(200.0, axes="rxry")]  # free to slide: slow roots besides the idle integrals
    loop = mfc.ClosedLoop(mfc.robots.ur5(), law, mfc.trajectories.Hold(Q), environment=surfaces, hardware=mfc.Hardware(torque_lag=2e-3))
    found = loop.linearize().margins("force")
    assert_allclose(found.sensitivity_peak[0, [0, 1, 3, 4]], 1.0, rtol=1e-12)
    assert 1.0 < found.sensitivity_peak[0, 2] < 2.0


def test_a_slow_growth_counts_within_a_longer_horizon_only() -> None:
    """A negative integral gain leaves one root near -kfi / (1 + kfp) = 0.01 1/s: slow within 50 s, unstable within 1000 s."""
    creeping, k = slider(kfi=-0.02, torque_lag=2e-3), np.array([1e3, 5e3])
    short, long = over_stiffness(creeping, k, horizon=50.0), over_stiffness(creeping, k, horizon=1e3)
    roots = [np.roots([2e-3, 1.0, 20.0 + 2e-3 * x, 2 * x, -0.02 * x]) for x in k]
    assert short.stable.all() and not long.stable.any()
    assert_allclose(long.growth, [r.real.max() for r in roots], rtol=1e-6)
    assert_allclose(short.growth, [r.real[np.abs(r) > 0.02].max() for r in roots], rtol=1e-6)
    assert_allclose(short.margins().phase_deg[:, 2] > 0, True)
    assert np.isnan(long.margins().phase_deg[:, 2]).all()


def test_the_boundary_of_a_map_and_the_largest_stiffness_follow_the_horizon() -> None:
    T, kfi, kdamp, kfp = 2e-3, -0.02, 20.0, 1.0
    limit = (kdamp * (1 + kfp) - kfi) / (T * kfp * (1 + kfp))
    creeping, k = slider(kfp, kfi, kdamp, torque_lag=T), np.geomspace(1e2, 1e6, 400)
    assert stable_up_to(creeping, horizon=50.0) == pytest.approx(limit, rel=1e-6)
    assert np.isnan(stable_up_to(creeping, horizon=1e3)) and mfc.design.max_stiffness(creeping, horizon=1e3) == 0.0
    assert stiffness_map(lambda g: creeping, k, [1.0], horizon=50.0).boundary()[0] == pytest.approx(limit, rel=1e-3)
    assert np.isnan(stiffness_map(lambda g: creeping, k, [1.0], horizon=1e3).boundary()[0])


def test_a_loop_of_slow_roots_only_is_not_stable_on_the_map_either() -> None:
    found = stiffness_map(lambda g: slider(g), np.geomspace(1e2, 1e6, 41), [1.0], horizon=1 / 300)  # all four roots below 300 1/s on soft walls
    assert (found.stable[0] == over_stiffness(slider(), found.stiffness, horizon=1 / 300).stable).all()
    assert np.isnan(found.growth[0, 0]) and found.stable[0, -1] and np.isnan(found.boundary()[0])
