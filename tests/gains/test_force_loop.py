"""The one-mass force loop: placed poles and Routh's boundary."""

import numpy as np
import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.gains.force_loop import characteristic, force_design, stiffness_range


def test_the_stiffness_range_is_a_boundary_of_the_quartic() -> None:
    kfp, kfi, kdamp, m, lag = 2.0, 5.0, 120.0, 3.0, 2e-3
    low, high = stiffness_range(kfp, kfi, kdamp, m, lag)
    assert low == 0
    assert high == pytest.approx((kdamp * (1 + kfp) - m * kfi) / (lag * kfp * (1 + kfp)))  # the chapter page's closed form, b = 0
    for b in (0.0, 4.0):
        high = stiffness_range(kfp, kfi, kdamp, m, lag, b)[1]
        assert np.all(np.roots(characteristic(kfp, kfi, kdamp, 0.999 * high, m, lag, b)).real < 0)
        assert np.any(np.roots(characteristic(kfp, kfi, kdamp, 1.001 * high, m, lag, b)).real > 0)
    assert stiffness_range(kfp, kfi, kdamp, m) == (0, np.inf)  # an ideal loop does not care
    assert np.isnan(stiffness_range(0.0, 50.0, 1.0, m)[0])  # and an undamped one is never stable


def test_a_boundary_from_below_is_told_too() -> None:
    kfp, kfi, kdamp, m, lag, b = 0.0, 0.02, 0.0, 1.0, 0.5, 0.01  # kfp = 0, friction and lag: the lag's fight turns into help
    low, high = stiffness_range(kfp, kfi, kdamp, m, lag, b)
    assert high == np.inf
    assert low > 0
    assert np.all(np.roots(characteristic(kfp, kfi, kdamp, 1.001 * low, m, lag, b)).real < 0)
    assert np.any(np.roots(characteristic(kfp, kfi, kdamp, 0.999 * low, m, lag, b)).real > 0)


@pytest.mark.parametrize("lag", [0.0, 2e-3])
def test_the_poles_are_where_the_design_says(lag: float) -> None:
    found = force_design("crossover", 30.0, 5e3, 4.0, lag, 1.0, 0.6)
    poles = np.roots(np.trim_zeros(characteristic(found.kfp, found.kfi, found.kdamp, 5e3, 4.0, lag, 1.0), "f"))
    w, z = found.natural_frequency, found.damping
    for pole in (w * (-z + 1j * np.sqrt(1 - z**2)), -found.pole):
        assert np.abs(poles - pole).min() < 1e-8 * abs(pole)
    assert found.metrics.crossover == pytest.approx(30.0, rel=1e-9)


def test_a_jump_over_what_was_asked_is_refused_with_the_nearest() -> None:
    # lightly damped: the bandwidth jumps where the resonance comes through -3 dB
    with pytest.raises(BadArgument, match="nearest loop attains"):
        force_design("bandwidth", 0.0074128, 0.128193, 1102.18, 0.0, 0.0, 0.00138547)
