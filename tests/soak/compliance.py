"""Soak: impedance and admittance on six arms, in contact and out of it, behind lag, servo, dead time and sampling.

Jacobians against differences to 1e-7 with a remainder of order 2.00 +- 0.05, and Taylor order 2.00 +- 0.05 of the linear prediction of runs.
Not collected by pytest and not part of CI: ``python tests/soak/compliance.py [name ...]``. Exit code 1 if anything is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Iterator

import numpy as np

import mfc_analysis as mfc
from mfc_analysis import laws as L
from mfc_analysis.dynamics.hardware import Hardware, Servo
from tests.conftest import F_D, Case, arm, loop_of, regular_pose, seed
from tests.dynamics.test_jacobians import misfit

ARMS = ("ur5", "panda", "xarm7", "z1", "kinova", "talos_left_arm")
TORQUE = {
    "ideal": Hardware(),
    "lag": Hardware(torque_lag=1e-3),
    "delay": Hardware(torque_lag=5e-4, delay=5e-4),
    "sampled": Hardware(sample_time=1e-3, delay=5e-4),
}
VELOCITY = {
    "ideal": Hardware(),
    "lag": Hardware(velocity_lag=5e-3),
    "servo": Hardware(servo=Servo(60.0, 0.7)),
    "delay": Hardware(servo=Servo(60.0, 0.7, 4e-3), delay=2e-3),
    "sampled": Hardware(servo=Servo(60.0, 0.7, 8e-3), sample_time=8e-3),
}
FORCE = {"force_filter": 4e-3, "force_limit": 1e5}  # no dead band: its edges have no Taylor series


def laws() -> dict[str, Case]:
    """Gentle gains, so that every arm is stable behind its hardware."""
    K, D, M = np.repeat([120.0, 4.0], 3), np.repeat([40.0, 0.3], 3), np.repeat([5.0, 0.4], 3)
    free = np.where(np.arange(6) == 2, 0.0, K)
    return {
        "impedance": Case("impedance", lambda n: L.Impedance(K, D, F_d=0.2 * F_D, null_damping=3.0)),
        "shaped": Case("shaped", lambda n: L.Impedance(K, D, M, F_d=0.2 * F_D, null_damping=3.0)),
        "joint": Case("joint", lambda n: L.JointImpedance(20.0, 6.0)),
        "joint shaped": Case("joint shaped", lambda n: L.JointImpedance(20.0, 6.0, 1.5)),
        "admittance": Case("admittance", lambda n: L.Admittance(0.2 * F_D, M, np.repeat([320.0, 20.0], 3), free)),
    }


def loops(name: str) -> Iterator[tuple[str, mfc.ClosedLoop]]:
    """Every law behind every chain, moving out of contact and at rest in it."""
    for label, case in laws().items():
        law = case.law(arm(name).n)
        chains = VELOCITY if law.plant == "velocity" else TORQUE
        for chain, hardware in chains.items():
            more = {field: value for field, value in vars(hardware).items() if value is not None}
            given = Hardware(**(more | FORCE)) if law.senses_force else hardware
            for contact in (False, True):
                yield f"{label}, {chain}, {'contact' if contact else 'free'}", loop_of(case, name, contact=contact, hardware=given)


def judged(name: str, label: str, loop: mfc.ClosedLoop) -> tuple[bool, str]:
    """Whether the Jacobian is exact and the prediction of second order, and what there is to say."""
    found = misfit(loop, seed(name, label))
    good = found.error < 1e-7 and abs(found.order - 2.0) <= 0.05
    ref = loop.ref if loop.environment is None else mfc.trajectories.Hold(regular_pose(name))
    late = list(loop.equations.delays.values()) if loop.equations.delayed else []
    exact = mfc.ClosedLoop(arm(name), loop.law, ref, environment=loop.environment, hardware=loop.hardware)
    span = 12 * min(late) if late else 0.02
    run = exact.validate(time=span, size=1e-2 if late else 2e-3)
    while run.message and span > 2e-3:  # more work than a validation takes
        span /= 2
        run = exact.validate(time=span, size=1e-2)
    for brief in (2e-3, 1.2e-3):  # an unstable loop that leaves at once
        if run.message:
            run = exact.validate(time=brief, size=1e-3)
    order = run.taylor_order
    good &= bool(np.isinf(order) or abs(order - 2.0) <= 0.05)
    return good, f"Jacobian {found.error:.1e}, order {found.order:.3f}; prediction {order:.3f} {run.message}"


def main() -> int:
    """All arms, or those named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    warnings.simplefilter("ignore")
    bad = 0
    for name in parser.parse_args().names or ARMS:
        start = time.perf_counter()
        for label, loop in loops(name):
            good, text = judged(name, label, loop)
            bad += not good
            sys.stdout.write(f"{'ok ' if good else 'BAD'} {name:15s} {label:32s} {text}\n")
            sys.stdout.flush()
        sys.stdout.write(f"    {name} took {time.perf_counter() - start:.0f} s\n")
    return min(bad, 1)


if __name__ == "__main__":
    sys.exit(main())
