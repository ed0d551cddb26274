"""Design searches: exact stability at some dozens of loops, each at the points of its reference."""

from __future__ import annotations

import time

import mfc_analysis as mfc
from benchmarks.loops import computed_torque, hybrid
from benchmarks.table import Found, Row, alone, paired


def at_rest(loop: mfc.ClosedLoop, search: str) -> Found:
    """A search at one point."""
    return alone(lambda: getattr(mfc.design, search)(loop, times=[0.0]), repeats=3)


def two_processes() -> Found:
    """A search along the path: wall time with two processes, which are running already, and with one."""
    loop = computed_torque()
    program = lambda n: mfc.design.max_delay(loop, n_jobs=n)  # noqa: E731
    return paired(lambda: program(2), lambda: program(1), clock=time.perf_counter)


ROWS = (
    Row("max_delay, 9.10, one point", "", lambda: at_rest(computed_torque(), "max_delay")),
    Row("max_payload, 9.10, one point", "", lambda: at_rest(computed_torque(), "max_payload")),
    Row("min_sample_rate, 9.10, one point", "", lambda: at_rest(computed_torque(), "min_sample_rate")),
    Row("max_stiffness, 9.24, one point", "", lambda: at_rest(hybrid(), "max_stiffness")),
    Row("max_delay, 9.10, 21 points, two processes (wall time)", "one process", two_processes, slow=True),
)
