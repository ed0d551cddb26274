"""Soak: 2000 fuzzed inputs to the public functions: a result without silent NaN, or an error of ours; never C++ text; within 20 s and 2 GiB.

Not collected by pytest and not part of CI: ``python tests/soak/fuzz.py [--count 2000] [--seed 0]``. Exit code 1 on any offence.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings, strategies as st

import mfc_analysis as mfc
from mfc_analysis import exercises
from mfc_analysis.errors import MfcError

CPP = re.compile(r"Eigen|pinocchio::|boost|std::|C\+\+|\.hpp|\.hxx|Expected:|Assertion")
LONGEST, LARGEST = 20.0, 2 << 30  #: [s] of processor time of one input; [bytes] of the process of one kind of input
SLOW = ("walls", "validate", "tool law with dead time", "check")  #: an eighth as many of these
ARM = mfc.robots.ur5()
TWO = mfc.robots.planar_2r()
Q = np.array([0.1, -1.2, 1.4, -0.8, 1.3, 0.2])

scalars = st.one_of(
    st.floats(-1e3, 1e3),
    st.floats(allow_nan=True, allow_infinity=True),
    st.integers(-3, 10),
    st.sampled_from([0, 1, -1, 1e-300, 1e300, True, None, "2", "x", b"1", 1j]),
)
arrays = st.one_of(
    st.lists(st.floats(-10, 10), max_size=8),
    st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=7),
    st.lists(st.lists(st.floats(-5, 5), min_size=2, max_size=2), min_size=1, max_size=3),
    st.sampled_from([[], [[]], np.zeros(6), np.eye(6), np.eye(2), np.zeros((2, 3)), {}, "abc", object(), [1, [2, 3]], np.array(["a"])]),
)
anything = st.one_of(scalars, arrays)
gain = st.one_of(st.floats(0, 500), st.just(None), anything)
size = st.floats(-6, 8).map(lambda x: 10.0**x)
huge = st.sampled_from([0.0, 1.0, 100.0, 1e6, 1e12, 1e30, -1.0, -1e30])
seconds = st.floats(-6, 1).map(lambda x: 10.0**x)
walls = st.lists(st.sampled_from(["z", "rz", "rxry", "xyrz", "xyzrxryrz"]), min_size=1, max_size=2)


def joints(n: int) -> st.SearchStrategy:
    """Mostly a joint vector that fits."""
    return st.one_of(st.lists(st.floats(-3, 3), min_size=n, max_size=n), anything)


def ct(hardware: mfc.Hardware) -> mfc.ClosedLoop:
    """Six joints under computed torque."""
    return mfc.ClosedLoop(ARM, mfc.laws.ComputedTorque(100.0, 10.0, 20.0), mfc.trajectories.Hold(Q), hardware=hardware)


def pressing(axes: list[str], stiffness: float) -> mfc.ClosedLoop:
    """Two joints that press on surfaces."""
    surfaces = [mfc.Environment(stiffness, 10.0, axes=a) for a in axes]
    return mfc.ClosedLoop(
        TWO, mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 0.5, 5.0, kdamp=50.0), mfc.trajectories.Hold([0.3, 0.6]), environment=surfaces
    )


CALLS: list[tuple[str, st.SearchStrategy, Callable[..., object]]] = [
    ("single_joint", st.tuples(scalars, scalars, scalars, scalars), mfc.robots.single_joint),
    ("slider", st.tuples(scalars, scalars), mfc.robots.slider),
    ("load", st.tuples(st.one_of(st.text(max_size=8), anything)), mfc.robots.load),
    (
        "from_urdf",
        st.tuples(st.one_of(st.text(max_size=30), st.sampled_from(["<robot/>", "<robot name='a'><link name='b'/></robot>", "<x>"]), anything)),
        mfc.Robot.from_urdf,
    ),
    ("payload", st.tuples(scalars, anything, anything), ARM.with_payload),
    ("friction", st.tuples(anything, anything), ARM.with_friction),
    ("armature", st.tuples(anything), ARM.with_armature),
    ("scaled", st.tuples(scalars), ARM.with_inertia_scaled),
    ("mass", st.tuples(joints(6)), ARM.mass),
    ("bias", st.tuples(joints(6), joints(6)), ARM.bias),
    ("pose", st.tuples(joints(6)), ARM.pose),
    ("task_bias", st.tuples(joints(6), joints(6)), ARM.task_bias),
    ("torques", st.tuples(joints(6), anything, st.sampled_from(["tool", "world", "x", None])), ARM.joint_torques),
    ("hold", st.tuples(joints(2)), lambda q: mfc.trajectories.Hold(q)(0.3)),
    ("quintic", st.tuples(joints(2), joints(2), scalars), lambda a, b, T: mfc.trajectories.Quintic(a, b, T)([0.0, 0.5])),
    (
        "sinusoid",
        st.tuples(joints(2), anything, anything, anything),
        lambda c, a, f, p: (mfc.trajectories.Sinusoid(c, a, f, p)(0.3), mfc.trajectories.Sinusoid(c, a, f, p).period),
    ),
    ("waypoints", st.tuples(anything, anything), lambda t, q: mfc.trajectories.Waypoints(t, q)(0.1)),
    ("toolline", st.tuples(anything, scalars), lambda X, T: mfc.trajectories.ToolLine(np.eye(4), X, T)(0.2)),
    ("toolsin", st.tuples(anything, anything, anything, scalars), lambda a, f, x, g: mfc.trajectories.ToolSinusoid(np.eye(4), a, f, x, g)(0.2)),
    ("circle", st.tuples(scalars, scalars, anything), lambda r, f, n: mfc.trajectories.ToolCircle(np.eye(4), r, f, n)(0.2)),
    (
        "environment",
        st.tuples(anything, anything, st.one_of(st.none(), anything), st.one_of(st.sampled_from(["z", "xyz", "rz", "zz", ""]), anything), anything),
        mfc.Environment,
    ),
    (
        "hardware",
        st.tuples(anything, anything, scalars, scalars, scalars, scalars),
        lambda a, b, c, d, e, f: mfc.Hardware(torque_lag=a, velocity_filter=b, delay=c, sample_time=d, force_delay=e, torque_limit=f),
    ),
    (
        "pid loop",
        st.tuples(gain, gain, gain, joints(2)),
        lambda p, i, d, q: mfc.ClosedLoop(TWO, mfc.laws.JointPID(p, i, d), mfc.trajectories.Hold(q)).linearize([0.0]).margins(),
    ),
    (
        "ct loop",
        st.tuples(gain, gain, gain, scalars),
        lambda p, i, d, T: (
            mfc.ClosedLoop(TWO, mfc.laws.ComputedTorque(p, i, d), mfc.trajectories.Hold([0.1, 0.2]), hardware=mfc.Hardware(delay=T))
            .linearize([0.0])
            .stable
        ),
    ),
    (
        "velocity",
        st.tuples(gain, gain),
        lambda p, i: mfc.ClosedLoop(TWO, mfc.laws.VelocityPI(p, i), mfc.trajectories.Hold([0.1, 0.2])).linearize([0.0]).margins(),
    ),
    (
        "linearize",
        st.tuples(anything, st.sampled_from(["reference", "equilibrium", "simulation", "x"])),
        lambda t, about: mfc.ClosedLoop(TWO, mfc.laws.JointPID(9e3, 100, 2e3), mfc.trajectories.Hold([0.1, 0.2])).linearize(t, about).A,
    ),
    (
        "simulate",
        st.tuples(st.one_of(st.floats(0.01, 0.1), anything), anything),
        lambda t, e: (
            None
            if np.size(t) and np.asarray(t).dtype.kind in "fi" and np.abs(np.asarray(t)).max() > 2
            else mfc.ClosedLoop(TWO, mfc.laws.JointPID(9e3, 100, 2e3), mfc.trajectories.Hold([0.1, 0.2])).simulate(t, initial_error=e)
        ),
    ),
    (
        "force law",
        st.tuples(anything, gain, gain, gain),
        lambda F, p, i, d: (
            mfc.ClosedLoop(mfc.robots.slider(1.0), mfc.laws.DampedForcePI(F, p, i, d), mfc.trajectories.Hold([0.0]), environment=mfc.Environment(1e3))
            .linearize([0.0])
            .stable
        ),
    ),
    ("hybrid", st.tuples(anything, anything), lambda F, A: mfc.laws.HybridMotionForce(F, 100, None, 20, constraints=A)),
    (
        "walls",
        st.tuples(walls, size, size, st.booleans()),
        lambda axes, K, B, one: (
            mfc.ClosedLoop(
                ARM,
                mfc.laws.DampedForcePI([0, 0, 10, 0, 0, 0], 0.5, 5.0, kdamp=50.0),
                mfc.trajectories.Hold(Q),
                environment=[mfc.Environment(K, B, axes=a, one_sided=one) for a in axes],
            )
            .simulate(10.0, 0.01)
            .q
        ),
    ),
    ("validate", st.tuples(walls, size), lambda axes, K: str(pressing(axes, K).validate(0.5))),
    (
        "tool law with dead time",
        st.tuples(seconds, seconds),
        lambda delay, lag: (
            mfc.ClosedLoop(
                ARM,
                mfc.laws.TaskComputedTorque(100.0, 10.0, 20.0),
                mfc.trajectories.ToolHold(ARM.pose(Q)),
                q_start=Q,
                hardware=mfc.Hardware(delay=delay, torque_lag=lag),
            )
            .simulate(1.0, 0.01)
            .q
        ),
    ),
    (
        "sampled",
        st.tuples(seconds, seconds, st.integers(1, 40)),
        lambda T, delay, m: ct(mfc.Hardware(sample_time=T, delay=delay)).linearize(np.linspace(0, 1, m)).margins(),
    ),
    (
        "disk",
        st.tuples(seconds, seconds, st.integers(2, 7000)),
        lambda T, delay, n: ct(mfc.Hardware(sample_time=T, delay=delay)).linearize([0.0]).disk_margin("torque", np.geomspace(1e-3, 3, n) / T),
    ),
    (
        "delayed disk",
        st.tuples(seconds, seconds, st.integers(2, 7000)),
        lambda lag, delay, n: str(ct(mfc.Hardware(torque_lag=lag, delay=delay)).linearize([0.0]).disk_margin("torque", np.geomspace(1e-2, 1e4, n))),
    ),
    ("exercise 9.1", st.tuples(huge, huge, huge, st.sampled_from([0.0, 90.0])), lambda p, i, d, v: str(exercises.pid(60.0, p, i, d, v))),
    (
        "exercise 9.2",
        st.tuples(huge, huge, huge, st.sampled_from([0.0, 90.0])),
        lambda p, i, d, v: str(exercises.pid_with_inverse_dynamics(60.0, p, i, d, v)),
    ),
    (
        "check",
        st.tuples(huge, huge, seconds),
        lambda viscous, kp, T: str(
            mfc.Requirements(phase_deg=30.0, tracking_error=0.1).check(
                mfc.ClosedLoop(
                    TWO.with_friction(viscous=viscous),
                    mfc.laws.ComputedTorque(kp, 10.0, 20.0),
                    mfc.trajectories.Quintic([0.1, 0.2], [0.5, 0.6], 1.0),
                    hardware=mfc.Hardware(sample_time=T),
                ),
                [0.0, 0.5],
            )
        ),
    ),
    ("gains", st.tuples(scalars, scalars, scalars), lambda b, z, i: mfc.gains.pid(bandwidth=b, damping=z, inertia=i)),
    ("pd", st.tuples(scalars, scalars), lambda c, z: mfc.gains.pd(crossover=c, damping=z)),
    ("force_pi", st.tuples(scalars, scalars, scalars, scalars), lambda b, k, m, T: mfc.gains.force_pi(bandwidth=b, stiffness=k, mass=m, lag=T)),
    ("cartesian", st.tuples(joints(6), anything, scalars), lambda q, K, r: mfc.gains.cartesian_damping(ARM, q, K, r)),
    ("requirements", st.tuples(scalars, scalars, scalars), lambda a, b, c: mfc.Requirements(gain_increase_db=a, phase_deg=b, delay=c)),
    ("by_equation", st.tuples(st.one_of(st.text(max_size=5), anything)), mfc.laws.by_equation),
    ("constraints", st.tuples(anything, anything), lambda n, a: mfc.ConstraintSet(natural=n, artificial=a)),
    ("projection", st.tuples(anything, anything), mfc.constraints.projection),
]


def has_nan(x: object) -> bool:
    """Whether a plain numeric result hides a NaN (margins of unstable loops are NaN by contract)."""
    if isinstance(x, tuple) and not hasattr(x, "_fields"):
        return any(has_nan(part) for part in x)
    if isinstance(x, np.ndarray) and x.dtype.kind in "fc":
        return bool(np.isnan(x).any())
    if hasattr(x, "_fields"):
        return any(has_nan(part) for part in x)  # type: ignore[attr-defined]
    if hasattr(x, "stable") and hasattr(x, "phase_deg"):
        return bool(np.isnan(x.phase_deg[x.stable]).any())
    return False


def _alone(name: str, count: int, seed: int) -> bool:
    """Whether one kind of input, in a process of its own, exceeds the memory or gives another offence."""
    child = subprocess.Popen([sys.executable, __file__, "--only", name, "--count", str(count), "--seed", str(seed)])
    _, status, used = os.wait4(child.pid, 0)
    peak = used.ru_maxrss * 1024
    sys.stdout.write(f"{name}: peak {peak / 2**30:.2f} GiB\n" if peak <= LARGEST else f"{name}: memory: {peak / 2**30:.2f} GiB\n")
    sys.stdout.flush()
    return status != 0 or peak > LARGEST


def main() -> int:
    """Every call in turn, each in a process of its own, ``--count`` examples in all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only")
    asked = parser.parse_args()
    if asked.only is None:
        each = max(asked.count // len(CALLS), 1) + 1
        found = [_alone(name, max(each // 8, 2) if name in SLOW else each, asked.seed) for name, _, _ in CALLS]
        return int(any(found))
    warnings.simplefilter("ignore")
    offences: dict[tuple[str, str], str] = {}
    ran = 0
    calls = [c for c in CALLS if asked.only in (None, c[0])]
    for name, inputs, call in calls:
        here = (name, call)

        @seed(asked.seed)
        @settings(
            max_examples=asked.count,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(inputs)
        def once(values: tuple[object, ...]) -> None:
            nonlocal ran
            name, call = here  # noqa: B023 - called at once, below
            ran += 1
            start = time.process_time()
            try:
                out = call(*values)
            except ValueError as why:
                if not isinstance(why, MfcError) or CPP.search(str(why)):
                    offences.setdefault((name, type(why).__name__), f"{values!r}: {why}\n{traceback.format_exc(limit=-2)}")
            except Exception as why:
                offences.setdefault((name, type(why).__name__), f"{values!r}: {why!r}\n{traceback.format_exc(limit=-3)}")
            else:
                if has_nan(out):
                    offences.setdefault((name, "NaN"), f"{values!r}")
            if (spent := time.process_time() - start) > LONGEST:
                offences.setdefault((name, "time"), f"{values!r}: {spent:.1f} s")

        start = time.perf_counter()
        once()
        sys.stderr.write(f"{name}: {time.perf_counter() - start:.1f} s\n")
    for (name, kind), text in offences.items():
        sys.stdout.write(f"{name}: {kind}: {text}\n")
    sys.stdout.write(f"{ran} inputs, {len(offences)} kinds of offence\n")
    return int(bool(offences))


if __name__ == "__main__":
    sys.exit(main())
