"""Simulation, and its comparison with the linear model."""

from __future__ import annotations

from typing import Any

import mfc_analysis as mfc
from benchmarks import floors, rivals
from benchmarks.loops import computed_torque, hybrid
from benchmarks.table import Found, Row, paired

ALONE: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


def simulated(reference: str) -> Found:
    """5 s from an initial error, with all signals."""
    loop = computed_torque()
    other = floors.hand_written(loop) if reference == "hand" else rivals.cvodes(loop)
    return paired(lambda: loop.simulate(5.0, initial_error=0.1), other)


def validated(loop: mfc.ClosedLoop) -> Found:
    """The linear prediction against disturbed runs over 1 s, about 20 of them."""
    return paired(lambda: loop.validate(1.0), lambda: loop.simulate(1.0, 0.01, **ALONE))


RUN = "one of its runs alone, rtol 1e-10"
ROWS = (
    Row("simulation of 5 s, with all signals", "hand-written right-hand side and Jacobian, LSODA", lambda: simulated("hand"), 2.0),
    Row("simulation of 5 s, with all signals", "CasADi, CVODES, states only", lambda: simulated("cvodes"), needs=("casadi",)),
    Row("validation over 1 s, 9.10", RUN, lambda: validated(computed_torque()), 3.0),
    Row("validation over 1 s, 9.24 in contact", RUN, lambda: validated(hybrid())),
    Row("validation over 1 s, 9.10 with 2 ms of dead time", RUN, lambda: validated(computed_torque(hardware=mfc.Hardware(delay=2e-3)))),
)
