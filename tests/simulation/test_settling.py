"""Settling told from a run: both sides of the boundary, drift, and what is not a number."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.simulation.settling import settles

T = np.linspace(0, 2, 400)


@pytest.mark.parametrize("rate", [0.5, 5.0])
def test_an_oscillation_settles_if_it_decays_and_not_if_it_grows(rate: float) -> None:
    assert settles(T, np.exp(-rate * T) * np.sin(40 * T))
    assert not settles(T, np.exp(rate * T) * np.sin(40 * T))


def test_a_slow_drift_below_a_decaying_oscillation_does_not_count() -> None:
    assert settles(T, 3 * T + np.exp(-T) * np.sin(40 * T))


def test_one_growing_component_is_enough() -> None:
    assert not settles(T, np.stack([np.exp(-T) * np.sin(40 * T), 1e-3 * np.exp(T) * np.sin(30 * T)], axis=1))


def test_what_is_not_finite_does_not_settle() -> None:
    y = np.exp(-T)
    y[-1] = np.nan
    assert not settles(T, y)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(BadArgument, match="20 samples"):
        settles(T[:10], T[:10])
