"""The sections of 9.1 to 9.4: what gains that are not the chapter's do to its closed forms, and findings that quote the numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.report.chapter import velocity
from mfc_analysis.report.chapter.arms import Designs, arms
from mfc_analysis.report.document.document import written
from tests.report.read import told

JOINT, UR5 = arms()[0], arms()[2]


def designs(**given: dict[str, float]) -> Designs:
    """The chapter's designs with other gains of 9.2, 9.3 or 9.4."""
    return Designs({**Designs().velocity, **{f"9.{name[-1]}": gains for name, gains in given.items()}})


@pytest.mark.parametrize("k", [2.0, 10.0])
def test_on_a_ramp_the_lag_of_9_2_is_the_speed_over_the_gain_on_every_arm(k: float) -> None:
    for arm in (JOINT, UR5):
        lag = velocity.steady(designs(eq2={"kp": k}), "9.2", arm, velocity.SLOPE, 0.0)
        assert lag == pytest.approx(velocity.SLOPE / k * (1 - np.exp(-k * velocity.SETTLED)), rel=1e-6)


def test_on_a_parabola_9_3_keeps_the_acceleration_over_its_integral_gain_and_9_4_nothing() -> None:
    gains = {"kp": 6.0, "ki": 12.0}
    assert velocity.steady(designs(eq3=gains), "9.3", JOINT, 0.0, velocity.BEND) == pytest.approx(velocity.BEND / 12.0, rel=1e-6)
    assert abs(velocity.steady(designs(eq3=gains), "9.3", JOINT, velocity.SLOPE, 0.0)) < 1e-8
    assert abs(velocity.steady(designs(eq4=gains), "9.4", JOINT, velocity.SLOPE, velocity.BEND)) < 1e-8


def test_the_error_along_the_path_shrinks_as_the_gain_grows() -> None:
    slow, fast = (velocity.tracking(designs(eq2={"kp": k}).view("9.2", JOINT)) for k in (40.0, 80.0))
    top = float(np.abs(JOINT.ref(JOINT.times).v).max())
    assert fast == pytest.approx(top / 80.0, rel=0.01) and slow / fast == pytest.approx(2.0, rel=0.01)  # v/k, but for terms in 1/k^2


def test_findings_quote_the_gains_and_the_numbers_of_their_pages() -> None:
    found = told("velocity")
    arm = "ur5-2-kg"
    lag, both = found[f"9-2-velocity-p-{arm}"]["numbers"], found[f"9-3-velocity-pi-{arm}"]["numbers"]
    assert all(x in found["eq-9-2"]["finding"] for x in (written(lag["ramp_error"]), written(lag["gains"]["kp"], exact=True)))
    assert all(written(both[x]) in found["eq-9-3"]["finding"] for x in ("ramp_error", "parabola_theory"))
    for name in ("single-joint", "planar-2r", arm):
        page = found[f"9-1-velocity-feedforward-{name}"]
        assert all(written(page["numbers"][x]) in page["finding"] for x in ("error_change", "disturbance_error"))
    errors = [found[f"{e}-single-joint"]["numbers"]["tracking_error"] for e in ("9-2-velocity-p", "9-4-feedforward-pi")]
    phase = found["9-4-feedforward-pi-single-joint"]["numbers"]["phase_deg"][0]
    assert all(written(x) in found["eq-9-4"]["finding"] for x in (*errors, phase, errors[0] / errors[1]))
