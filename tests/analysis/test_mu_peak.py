"""The peak of mu over frequency: certain, also where no pole says that there is one."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from mfc_analysis.analysis import mu_peak as room
from mfc_analysis.analysis.frequency.sensitivity import Opened, opened, sensitivity
from mfc_analysis.analysis.mu import largest_bound, raised
from mfc_analysis.analysis.mu_peak import Peak, mu_peaks
from tests.analysis.conftest import open_system
from tests.analysis.frequency.test_taylor import LOOPS
from tests.analysis.test_disk import SATELLITE, coupled, feedback

s = control.tf("s")
NO_HINT = np.array([-1.0 + 0j])


def mu_peak(channels: Opened, index: int, poles: np.ndarray) -> Peak:
    return mu_peaks(channels, [(index, poles)])[0]


@pytest.mark.parametrize("zeta", [1e-6, 1e-3, 0.1])
def test_a_narrow_peak_that_no_pole_announces_is_found(zeta: float) -> None:
    # S - 1/2 = (s^2 + 2 zeta s - 1) / (2 (s^2 + 2 zeta s + 1)) of L = 1 / (s^2 + 2 zeta s): 1/2 * sqrt((1 + 1/zeta^2)) near s = j
    found = mu_peak(opened(open_system(1 / (s * (s + 2 * zeta))), "torque"), 0, NO_HINT)
    w = np.concatenate([np.linspace(1 - 10 * zeta, 1 + 10 * zeta, 400_001), np.geomspace(0.01, 100, 1001)])
    truth = np.abs((-(w**2) + 2j * zeta * w - 1) / (-(w**2) + 2j * zeta * w + 1)).max() / 2
    assert found.certain
    assert found.value == pytest.approx(truth, rel=2e-6 if zeta > 1e-5 else 1e-4)  # 1 - w^2 has ten digits left at 1e-6
    assert found.value >= truth * (1 - 1e-6) or zeta < 1e-5
    assert found.lower == pytest.approx(found.value)


def test_an_all_pass_is_flat_and_its_peak_is_one_half() -> None:
    # L = 5/s: S - 1/2 = (s - 5) / (2 (s + 5))
    found = mu_peak(opened(open_system(5 / s), "torque"), 0, NO_HINT)
    assert found.certain
    assert found.value == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("seed", "n"), [(1, 2), (2, 4), (4, 5), (6, 6)])
def test_no_frequency_of_a_fine_grid_has_more(seed: int, n: int) -> None:
    system = coupled(seed, n, 0.5)
    channels = opened(system, "torque")
    found = mu_peak(channels, 0, NO_HINT)
    w = np.unique(np.concatenate([np.geomspace(0.01, 1e3, 300), found.frequency * np.linspace(0.9, 1.1, 101)]))
    fine = largest_bound(sensitivity(channels, 0, w[w >= 0.01]) - np.eye(n) / 2)[0]
    assert found.certain
    assert fine * (1 - 1e-6) <= found.value <= fine * (1 + 1e-3)
    at = largest_bound(sensitivity(channels, 0, np.array([found.frequency])) - np.eye(n) / 2)
    assert found.value == pytest.approx(at[0], rel=1e-7) and found.lower <= found.value


def test_with_dead_time_the_peak_is_that_of_the_loop_as_it_is() -> None:
    # an elastic mode at 40 rad/s that only the dead time makes narrow
    A, B, C = [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1600, -0.8]], [[0], [1], [0], [1]], [[4, 3, 0, 0.7]]
    system = feedback(A, B, C, 1.0, delay=0.018)
    channels = opened(system, "torque")
    w = np.linspace(0.01, 400, 1_000_001)
    L = np.exp(-0.018j * w) * ((4 + 3j * w) / (1j * w) ** 2 + 0.7j * w / ((1j * w) ** 2 + 0.8j * w + 1600))
    truth = np.abs((1 - L) / (1 + L)).max() / 2
    found = mu_peak(channels, 0, NO_HINT)
    assert found.certain
    assert found.value == pytest.approx(truth, rel=2e-6)


def test_out_of_centers_is_not_certain(monkeypatch) -> None:
    monkeypatch.setattr(room, "MOST", 20)
    assert not mu_peak(opened(coupled(2, 4), "torque"), 0, NO_HINT).certain
    assert mu_peak(opened(SATELLITE, "torque"), 0, NO_HINT).value > 5


def test_a_sampled_loop_ends_at_half_the_sample_rate() -> None:
    system = replace(feedback([[1.0]], [[0.1]], [[1.0]], 2.0), dt=0.1)
    found = mu_peak(opened(system, "torque"), 0, NO_HINT)
    assert found.certain
    assert (found.value, found.frequency) == (pytest.approx(1.1 / 1.8), pytest.approx(np.pi / 0.1))


@pytest.mark.parametrize("name", ["torque and encoder", "dead time", "dead time, encoder", "dead time, torque and encoder"])
def test_torque_and_encoder_together_are_certain_with_dead_time_and_without(name: str) -> None:
    system, at = LOOPS[name]
    channels = opened(system, at)
    found = mu_peak(channels, 0, NO_HINT)
    w = np.unique(np.concatenate([np.geomspace(0.01, 1e4, 1500), found.frequency * np.linspace(0.98, 1.02, 101)]))
    fine = largest_bound(sensitivity(channels, 0, w[w >= 0.01]) - np.eye(channels.wires.size) / 2)[0]
    assert found.certain
    assert fine * (1 - 1e-6) <= found.value <= fine * (1 + 1e-5)


def test_points_searched_together_have_the_peaks_of_each_alone(monkeypatch) -> None:
    each = [coupled(seed, 3, 0.5) for seed in range(5)]
    together = replace(each[0], times=np.arange(5.0), **{k: np.concatenate([getattr(one, k) for one in each]) for k in "ABCD"})
    monkeypatch.setattr(room, "TOGETHER", 3)
    found = mu_peaks(opened(together, "torque"), [(i, NO_HINT) for i in range(5)])
    for one, peak in zip(each, found, strict=True):
        alone = mu_peak(opened(one, "torque"), 0, NO_HINT)
        assert (peak.value, peak.frequency, peak.certain) == (pytest.approx(alone.value, rel=1e-12), pytest.approx(alone.frequency, rel=1e-9), True)


def test_mu_is_computed_of_the_matrices_of_many_points_at_a_time(monkeypatch) -> None:
    one, sets = coupled(4, 3, 0.5), []
    many = replace(one, times=np.arange(8.0), **{k: np.repeat(getattr(one, k), 8, axis=0) for k in "ABCD"})
    monkeypatch.setattr(room, "raised", lambda every, above: (sets.append(len(every)), raised(every, above))[1])
    mu_peaks(opened(many, "torque"), [(i, NO_HINT) for i in range(8)])
    assert set(sets) == {8}
