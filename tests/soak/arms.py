"""Soak: every arm of the catalogue under 9.8, 9.10, 9.16 and 9.23: analysed with Taylor order 2.0 +- 0.1, or refused with a reason.

Not collected by pytest and not part of CI: ``python tests/soak/arms.py [name ...]``. Exit code 1 if anything is neither.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings

import numpy as np

import mfc_analysis as mfc


def pose_away_from_singularities(robot: mfc.Robot, rng: np.random.Generator) -> np.ndarray:
    """The best conditioned of some random poses inside the limits."""
    low, high = np.maximum(robot.limits.lower, -2.0), np.minimum(robot.limits.upper, 2.0)
    middle, half = 0.5 * (low + high), 0.45 * np.maximum(high - low, 0.0)
    poses = middle + half * rng.uniform(-1, 1, (60, robot.n))
    sigma = np.linalg.svd(robot.jacobian(poses), compute_uv=False)
    return poses[int(np.argmax(sigma[:, -1] / sigma[:, 0]))]


def loops(robot: mfc.Robot, q: np.ndarray) -> dict[str, mfc.ClosedLoop]:
    """One loop for each of the four laws, the controller not knowing a tenth of the inertia."""
    inertia = np.diag(robot.mass(q))
    model = robot.with_inertia_scaled(0.9)
    hold = mfc.trajectories.Hold(q)
    out = {
        "9.8": lambda: mfc.ClosedLoop(robot, mfc.laws.JointPID(60 * inertia, 60 * inertia, 15 * inertia), hold),
        "9.10": lambda: mfc.ClosedLoop(robot, mfc.laws.ComputedTorque(60, 60, 15), hold, controller_model=model),
        "9.16": lambda: mfc.ClosedLoop(
            robot,
            mfc.laws.TaskComputedTorque(60, 60, 15, null_damping=5.0),
            mfc.trajectories.ToolHold(robot.pose(q)),
            q_start=q,
            controller_model=model,
        ),
        "9.23": lambda: mfc.ClosedLoop(
            robot, mfc.laws.DampedForcePI([0, 0, 5, 0, 0, 0], 0.3, None, 20.0), hold, environment=mfc.Environment(2e3, 20.0, axes="z", preload=5.0)
        ),
    }
    return out


def judged(make) -> tuple[bool, str]:
    """Whether a loop is analysed with Taylor order 2, and what there is to say."""
    try:
        loop = make()
        lin = loop.linearize([0.0])
        margins = lin.margins()
        found = loop.validate(time=0.2, size=2e-3)
    except ValueError as why:
        return True, f"refused: {why}"
    order = found.taylor_order
    good = abs(order - 2.0) <= 0.1 or np.isinf(order)
    state = "stable" if lin.stable[0] else "drifts" if lin.drifts[0] else "not stable"
    text = f"order {order:.3f}, {state}, neutral {lin.neutral[0]}, phase {np.nanmin(margins.phase_deg) if lin.stable[0] else np.nan:.1f} deg"
    return bool(good), text if not found.message else f"{text}; {found.message}"


def main() -> int:
    """All arms, or those named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    names = parser.parse_args().names or list(mfc.robots.names())
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(3)
    bad = 0
    for name in names:
        start = time.perf_counter()
        robot = getattr(mfc.robots, name)() if hasattr(mfc.robots, name) else mfc.robots.load(name)
        q = pose_away_from_singularities(robot, rng)
        for law, make in loops(robot, q).items():
            good, text = judged(make)
            bad += not good
            sys.stdout.write(f"{'ok ' if good else 'BAD'} {name:28s} {law:5s} {text}\n")
            sys.stdout.flush()
        sys.stdout.write(f"    {name}: {time.perf_counter() - start:.1f} s\n")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
