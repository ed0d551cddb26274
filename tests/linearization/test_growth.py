"""Transient growth of a linearisation, against the transition matrix by another way."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.linearization.growth import transient_growth

TIMES = np.linspace(0, 1.5, 31)


def loop(**hardware: float) -> mfc.ClosedLoop:
    arm = mfc.robots.planar_2r()
    path = mfc.trajectories.Sinusoid([0.3, 0.8], 0.5, 3.0)
    return mfc.ClosedLoop(arm.with_payload(1.0), mfc.laws.ComputedTorque(60, 0, 4), path, controller_model=arm, hardware=mfc.Hardware(**hardware))


def test_growth_along_a_path_is_that_of_the_variational_equation() -> None:
    lin = loop().linearize(TIMES)
    n = lin.A.shape[1]

    def rate(t: float, phi: np.ndarray) -> np.ndarray:
        return np.asarray((lin.again(np.array([t])).A[0] @ phi.reshape(n, n)).ravel())

    found = lin.transient_growth()
    exact = solve_ivp(rate, (0, 1.5), np.eye(n).ravel(), t_eval=found.times, rtol=1e-9, atol=1e-11, method="DOP853")
    sizes = np.linalg.norm(exact.y.T.reshape(-1, n, n), 2, axis=(1, 2))
    assert found.singular[0] == 1 and found.singular.max() > 3
    assert_allclose(found.singular, sizes, rtol=1e-5)


def test_growth_of_a_sampled_loop_at_rest_is_that_of_its_powers() -> None:
    resting = mfc.ClosedLoop(
        mfc.robots.planar_2r(), mfc.laws.ComputedTorque(60, 0, 4), mfc.trajectories.Hold([0.3, 0.8]), hardware=mfc.Hardware(sample_time=0.02)
    )
    lin = resting.linearize([0.0, 0.2])
    found = lin.transient_growth()
    powers = [np.linalg.norm(np.linalg.matrix_power(lin.A[0], k), 2) for k in range(11)]
    assert_allclose(found.singular, powers, rtol=1e-9)
    assert not np.isclose(powers[5], np.linalg.norm(expm(0.1 * loop().linearize([0.0]).A[0]), 2), rtol=1e-3)  # another loop has another growth


def test_growth_takes_two_times_and_no_dead_time_without_sampling() -> None:
    with pytest.raises(BadArgument, match="two or more"):
        transient_growth(np.zeros(1), 0.0, lambda t: np.zeros((len(t), 2, 2)))
    with pytest.raises(Unsupported, match="sample_time"):
        loop(delay=0.01).linearize(TIMES).transient_growth()


def test_growth_past_a_torque_limit_is_that_of_steps_cut_where_the_limit_begins_and_ends() -> None:
    lin = loop(torque_limit=9.0).linearize(TIMES)
    n, fine = lin.A.shape[1], np.linspace(0, 1.5, 601)

    def A(t: float) -> np.ndarray:
        return np.asarray(lin.again(np.array([t])).A[0])

    cuts = [0.0]
    at = lin.again(fine).A
    for k in np.flatnonzero(np.abs(np.diff(at, axis=0)).max(axis=(1, 2)) > 5):
        low, high, first = fine[k], fine[k + 1], at[k]
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if np.abs(A(middle) - first).max() < 4 else (low, middle)
        cuts += [low]
    phi = np.eye(n)
    assert len(cuts) > 2  # the limit acts for a part of the path
    for low, high in zip(cuts, [*cuts[1:], 1.5], strict=True):
        inside = (low + 2e-9, high - 2e-9)
        run = solve_ivp(
            lambda t, y, i=inside: (A(float(np.clip(t, *i))) @ y.reshape(n, n)).ravel(),
            (low, high),
            phi.ravel(),
            rtol=1e-10,
            atol=1e-12,
            method="DOP853",
        )
        phi = run.y[:, -1].reshape(n, n)
    assert_allclose(lin.transient_growth().singular[-1], np.linalg.norm(phi, 2), rtol=1e-6)
