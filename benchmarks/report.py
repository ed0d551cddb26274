"""Reports: of one loop, with everything imported; of the chapter, as a command, on two cores."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

import numpy as np

import mfc_analysis as mfc
from benchmarks.loops import computed_torque
from benchmarks.table import Found, Row, alone, elapsed


def one_loop() -> Found:
    """HTML, PDF and JSON of the loop under 9.10 at 21 points."""
    loop, times = computed_torque(), np.linspace(0.0, 4.0, 21)
    with TemporaryDirectory() as folder:
        return alone(lambda: mfc.report.write(loop, folder, times, requirements=mfc.Requirements(phase_deg=45)))


def chapter() -> Found:
    """``mfc-analysis report``."""
    with TemporaryDirectory() as folder:
        return elapsed(sys.executable, "-m", "mfc_analysis", "report", "--out", folder, repeats=1)


ROWS = (
    Row("report of one loop, warm", "", one_loop, 1.0),
    Row("report of the chapter, two cores (wall time)", "", chapter, 10.0),
)
