"""The time of a point over the number of points, of joints, and over the hardware in the loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import mfc_analysis as mfc
from benchmarks import floors
from benchmarks.loops import chain, computed_torque
from benchmarks.table import Found, Row, alone, paired
from mfc_analysis.dynamics.jacobians import closed_system

HARDWARE = {
    "ideal": None,
    "torque lag": mfc.Hardware(torque_lag=2e-3),
    "velocity filter": mfc.Hardware(velocity_filter=1e-3),
    "elastic joints": mfc.Hardware(joint_stiffness=2e4, joint_damping=20.0, motor_inertia=0.5),
    "1 kHz sampling": mfc.Hardware(sample_time=1e-3),
    "4 ms of dead time": mfc.Hardware(delay=4e-3),
}


def over_points(what: str, points: int) -> Found:
    """Operating points, A, B and one result, for each point."""
    loop, times = computed_torque(), np.linspace(0.0, 4.0, points)
    call = {"A, B": lambda lin: lin.B, "poles": lambda lin: lin.poles(), "margins": lambda lin: lin.margins()}[what]
    return alone(lambda: call(loop.linearize(times)), points, repeats=1 if points > 10_000 else 3)


def over_joints(n: int) -> Found:
    """A, B of an arm of n joints at given operating points, against its bare loop."""
    loop, times = chain(n), np.linspace(0.0, 4.0, 200)
    x = loop.linearize(times).point.x
    return paired(lambda: closed_system(loop.equations, times, x), floors.joint_loop(loop, times, inputs=True), len(times))


def margins_over_joints(n: int) -> Found:
    """Margins of the n loops of such an arm, for each point."""
    lin = chain(n).linearize(np.linspace(0.0, 4.0, 20))
    _ = lin.opened
    return alone(lin.margins, 20, repeats=3)


def over_hardware(hardware: mfc.Hardware | None) -> Found:
    """Operating points, verdicts and margins with hardware in the loop, against those of the ideal loop."""
    loop, ideal, times = computed_torque(hardware=hardware), computed_torque(), np.linspace(0.0, 4.0, 50)
    return paired(lambda: loop.linearize(times).margins(), lambda: ideal.linearize(times).margins(), len(times))


def _rows() -> Iterator[Row]:
    for what, largest, long in (("A, B", 6, 6), ("poles", 6, 5), ("margins", 5, 4)):
        for k in range(2, largest + 1):
            yield Row(f"operating points and {what}, 1e{k} points", "", lambda w=what, m=10**k: over_points(w, m), slow=k >= long)
    for n in (1, 2, 3, 6, 7, 12, 20, 30):
        yield Row(f"A, B of 9.10, chain of {n} joints", "its bare loop", lambda n=n: over_joints(n))
    for n in (1, 2, 3, 6, 7, 12, 20, 30):
        yield Row(f"margins of {n} loops, chain of {n} joints", "", lambda n=n: margins_over_joints(n), slow=n > 12)
    for name, hardware in HARDWARE.items():
        if hardware is not None:
            yield Row(f"margins of 9.10 with {name}", "the ideal loop", lambda h=hardware: over_hardware(h))


ROWS = tuple(_rows())
