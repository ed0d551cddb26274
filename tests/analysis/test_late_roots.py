"""Special exits: through z = -1, out of the disc of the slow roots, and by the jump of a signal that acts within the sample."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mfc_analysis.analysis.margins import margins
from mfc_analysis.analysis.sampled import sampled
from mfc_analysis.analysis.system import OpenSystem, close_wires
from tests.analysis.test_sampled import loop
from tests.soak.sampled_delay import compared, drawn, random_plant, wrong_delays


@pytest.mark.parametrize("seed", [93, 147, 152])
def test_a_root_that_leaves_through_minus_one_is_found(seed: int) -> None:
    found: Counter[str] = Counter()
    assert wrong_delays(random_plant(seed), 1.0, 100.0, found, 60) == []
    assert found["through z = -1"] > 0


@pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")
def test_a_slow_root_that_leaves_its_disc_is_a_loss() -> None:
    """A force loop whose pair at 0.01 rad/s leaves abs(s) < 1/horizon to the right as the dead time of a torque grows."""
    said, made = drawn(7)
    found: Counter[str] = Counter()
    assert compared(made, found, 6, channels=1) == [], said
    assert found["of these slow"] > 0


@pytest.mark.parametrize("at", ["torque", "force"])
@pytest.mark.parametrize("direct", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("gain", [0.3, 1.0])
@pytest.mark.parametrize("now", [0.0, 0.03, 0.1])
def test_a_velocity_felt_by_the_sensor_at_once_is_felt_a_sample_later(at: str, direct: float, gain: float, now: float) -> None:
    """q' = w, force = q + c w (a damped wall): beyond a whole number of samples the rate is that of one sample before."""
    h = 0.1
    wire = ("torque", "force").index(at)

    def made(late: float) -> OpenSystem:
        delays = [0.0, 0.0]
        delays[wire] = late
        plant = loop([[0.0]], [1.0], [1.0], gain, delays=tuple(delays))
        D = plant.D.copy()
        D[0, 0, 1] = D[0, 2, 1] = direct
        return sampled(replace(plant, D=D), h)

    def decays(late: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(close_wires(made(late))[0][0])).max() < 1)

    found = margins(made(now), at)
    assert found.stable[0] and decays(now)
    T = float(found.delay[0, 0])
    later = np.unique(
        np.concatenate([np.linspace(0, T, 200)[1:] if T else [], [k * h - now + s for k in range(30) for s in (-1e-7, 1e-7) if k * h + s > now]])
    )
    assert all(decays(now + x) for x in later if x < T * (1 - 1e-6))
    assert not decays(now + T * (1 + 1e-6) + 1e-8 * h)
