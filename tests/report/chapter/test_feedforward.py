"""9.9 of the chapter: its numbers, read back from the JSON, confirmed another way."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.report.chapter import arms as chapter
from tests.report.chapter.test_joint_torque import JOINT, MGR, B, I, numbers


def test_9_9_has_the_poles_of_the_bare_joint_and_its_error_grows_as_simulated():
    found = numbers("joint_torque", f"9-9-torque-feedforward-{JOINT}")
    top = float(chapter.arms()[0].ref(2.0).q[0])
    assert_allclose(found["rightmost"], np.roots([I, B, -MGR * np.sin(top)]).real.max(), rtol=1e-6)
    assert found["error_off_path"] > 0.05 > 1e-3 > found["error_on_path"]
