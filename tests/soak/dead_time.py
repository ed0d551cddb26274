"""Soak: the verdict of random loops with dead time against an independent count of their unstable roots.

Every law, elastic joints, walls, dead times of 1e-6..1 s, gains over ten decades. Not collected by pytest and not part of CI:
``python tests/soak/dead_time.py [count] [first]``. Exit code 1 on a disagreement or an exception.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable

import numpy as np

import mfc_analysis as mfc
from mfc_analysis.errors import MfcError
from tests.soak.contour import Undecided, decays

L, Z = mfc.laws, np.eye(6)[2]
ARMS = ("ur3", "ur5", "ur10", "panda", "xarm7", "kinova")
FORCE = ("9.21", "9.22", "9.23", "9.24")


def drawn(seed: int) -> tuple[str, mfc.ClosedLoop]:
    """A random loop with dead time, and what it is."""
    rng = np.random.default_rng([20, seed])

    def g(low: float, high: float) -> float:
        return float(10 ** rng.uniform(low, high))

    def k(low: float = -4, high: float = 6) -> float:  # gains over ten decades; half of them in the range that people use
        return g(low, high) if rng.random() < 0.5 else g(0, 3)

    laws: dict[str, Callable[[], object]] = {
        "9.2": lambda: L.VelocityP(k()), "9.3": lambda: L.VelocityPI(k(), k()), "9.4": lambda: L.VelocityFeedforwardPI(k(), k()),
        "9.5": lambda: L.TaskVelocity(k(), k()), "9.8": lambda: L.JointPID(k(), k(), k()),
        "9.10": lambda: L.ComputedTorque(k(), k(), k()), "9.16": lambda: L.TaskComputedTorque(k(), k(), k(), null_damping=g(0, 2)),
        "9.21": lambda: L.OpenLoopForce(10 * Z), "9.22": lambda: L.ForcePI(10 * Z, k() * Z, k() * Z),
        "9.23": lambda: L.DampedForcePI(10 * Z, k() * Z, k() * Z, kdamp=k(-2, 4)),
        "9.24": lambda: L.HybridMotionForce(10 * Z, kp=k(), kd=k(), ki=k(), kfp=k(), kfi=k(), kdamp=g(-1, 3), constraints=[Z]),
    }  # fmt: skip
    name = list(laws)[seed % len(laws)]
    small = name not in ("9.5", "9.16", "9.24") and rng.random() < 0.4
    if small:
        robot = mfc.robots.slider() if name in FORCE else mfc.robots.single_joint()
        q = np.array([0.1])
    else:
        robot = mfc.robots.load(str(rng.choice(ARMS)))
        q = rng.uniform(-1.2, 1.2, robot.n)
    hardware: dict[str, float] = {"delay": g(-6, 0)} if rng.random() < 0.8 or name not in FORCE[1:] else {}
    if name in FORCE[1:] and (not hardware or rng.random() < 0.5):
        hardware["force_delay"] = g(-6, 0)
    velocity = name in ("9.2", "9.3", "9.4", "9.5")
    if rng.random() < 0.4:
        hardware["velocity_lag" if velocity else "torque_lag"] = g(-4, -1)
    if not velocity and rng.random() < 0.3:
        hardware |= {"joint_stiffness": g(2, 6), "motor_inertia": g(-3, 0), "joint_damping": g(-2, 2)}
    wall = mfc.Environment(stiffness=g(2, 8), damping=g(-1, 4), axes="z", preload=10.0) if name in FORCE else None
    reference = mfc.trajectories.ToolHold(robot.pose(q)) if name in ("9.5", "9.16") else mfc.trajectories.Hold(q)
    start = {"q_start": q} if name in ("9.5", "9.16") else {}
    loop = mfc.ClosedLoop(robot, laws[name](), reference, environment=wall, hardware=mfc.Hardware(**hardware), **start)  # type: ignore[arg-type]
    return f"{name} on {robot.name}, {hardware}", loop


def judged(seed: int) -> tuple[str, str]:
    """What came of one loop: "agree", "undecided" by the second count, or what is wrong; and a text."""
    said, loop = drawn(seed)
    try:
        lin = loop.linearize()
        start = time.perf_counter()
        ours = bool(lin.stability.nonzero_stable[0])
        took = time.perf_counter() - start
    except MfcError as why:
        return "refused", f"{said}: {why}"
    except Exception as why:
        return "EXCEPTION", f"{said}: {type(why).__name__}: {why}"
    if took > 20:
        return "SLOW", f"{said}: {took:.1f} s"
    try:
        second = decays(lin)
    except Undecided:
        return "undecided", f"{said}: ours {ours}"
    return ("agree" if second == ours else "DISAGREE"), f"{said}: decays: ours {ours}, counted {second}"


def main() -> int:
    """``count`` loops from seed ``first`` on."""
    warnings.simplefilter("ignore")
    given = sys.argv[1:]
    number, first = int(given[0]) if given else 500, int(given[1]) if given[1:] else 0
    found: Counter[str] = Counter()
    for seed in range(first, first + number):
        kind, text = judged(seed)
        found[kind] += 1
        found["of these stable"] += kind == "agree" and text.endswith("True")
        if kind != "agree":
            sys.stdout.write(f"{kind} {seed}: {text}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{dict(found)}\n")
    return int(any(k.isupper() for k in found))


if __name__ == "__main__":
    sys.exit(main())
