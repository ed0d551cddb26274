"""Soak: 2000 fuzzed inputs to the public functions: a result without silent NaN, or a ValueError of ours; never C++ text.

Not collected by pytest and not part of CI: ``python tests/soak/fuzz.py [--count 2000] [--seed 0]``. Exit code 1 on any offence.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
import traceback
import warnings
from collections.abc import Callable

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings, strategies as st

import mfc_analysis as mfc
from mfc_analysis.errors import MfcError

CPP = re.compile(r"Eigen|pinocchio::|boost|std::|C\+\+|\.hpp|\.hxx|Expected:|Assertion")
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


def joints(n: int) -> st.SearchStrategy:
    """Mostly a joint vector that fits."""
    return st.one_of(st.lists(st.floats(-3, 3), min_size=n, max_size=n), anything)


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


def main() -> int:
    """Every call in turn, ``--count`` examples in all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    offences: dict[tuple[str, str], str] = {}
    ran = 0
    calls = [c for c in CALLS if asked.only in (None, c[0])]
    for name, inputs, call in calls:
        here = (name, call)

        @seed(asked.seed)
        @settings(
            max_examples=max(asked.count // len(calls), 1) + 1,
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

        start = time.perf_counter()
        once()
        sys.stderr.write(f"{name}: {time.perf_counter() - start:.1f} s\n")
    for (name, kind), text in offences.items():
        sys.stdout.write(f"{name}: {kind}: {text}\n")
    sys.stdout.write(f"{ran} inputs, {len(offences)} kinds of offence\n")
    return int(bool(offences))


if __name__ == "__main__":
    sys.exit(main())
