"""Results hold data: every one of them survives a trip to another process."""

from __future__ import annotations

import importlib
import inspect
import pickle
from collections.abc import Iterator
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.linearization.coupling import coupling
from mfc_analysis.linearization.tracking_steps import step_metrics
from tests.conftest import regular_pose

ROOT = Path(mfc.__file__).parent
ROOMS = ("analysis", "gains", "linearization", "simulation", "requirements", "design")
#: what lives only while something is computed
WITHIN = {
    "Bracket",
    "Layout",
    "Response",
    "Mode",
    "Piece",
    "Point",
    "Terms",
    "Candidate",
    "Channels",
    "Crossings",
    "Delayed",
    "Sensitivities",
    "Stacked",
    "DelayedVerdict",
    "Expansion",
    "Motion",
    "ForceDesign",
    "Grid",
    "Intervals",
    "Judge",
    "Kind",
    "LoopMetrics",
    "MarginMetrics",
    "Opened",
    "Orbit",
    "Parts",
    "Peak",
    "Replay",
    "PortSystem",
    "Raised",
    "Resolvent",
    "Shifted",
    "Rest",
    "Run",
    "SecondOrder",
    "SingularValues",
    "SlowPart",
    "SlowWords",
    "Split",
    "Taylor",
    "Walk",
}

ARM, F = mfc.robots.ur5(), np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
Q = regular_pose("ur5")
PID = mfc.gains.pid(bandwidth=mfc.hertz(3))
MOVING = mfc.ClosedLoop(
    ARM.with_payload(1.0), mfc.laws.ComputedTorque(**PID), mfc.trajectories.Sinusoid(center=Q, amplitude=0.2, frequency=3.0), controller_model=ARM
)
LATE = mfc.ClosedLoop(ARM, mfc.laws.ComputedTorque(**PID), mfc.trajectories.Hold(Q), hardware=mfc.Hardware(delay=2e-3))
SAMPLED = mfc.ClosedLoop(ARM, mfc.laws.ComputedTorque(**PID), mfc.trajectories.Hold(Q), hardware=mfc.Hardware(delay=1.5e-3, sample_time=2e-3))
WALL = mfc.Environment(stiffness=[1e4] * 3 + [1e2] * 3, damping=10.0, axes="xyzrxryrz", preload=[0, 0, 5.0, 0, 0, 0])
ONE = mfc.robots.single_joint()  # for what searches: a joint alone is judged fast
PRESSING = mfc.ClosedLoop(ARM, mfc.laws.DampedForcePI(F, 0.5, 20.0, [400.0] * 6), mfc.trajectories.Hold(Q), environment=WALL)
ASKED = mfc.Requirements(phase_deg=30, settling_time=1.0, tracking_error=0.1, disk_margin=0.1)


def bounced() -> mfc.Simulation:
    arm = mfc.robots.slider(mass=1.0)
    wall = mfc.Environment(stiffness=1e4, damping=5.0, axes="z", one_sided=True)
    loop = mfc.ClosedLoop(arm, mfc.laws.OpenLoopForce(F), mfc.trajectories.Hold([0.0]), environment=wall)
    return loop.simulate(0.2, q=[-0.01], v=[0.1])


TOUCHED = mfc.ClosedLoop(
    mfc.robots.slider(), mfc.laws.OpenLoopForce(F), mfc.trajectories.Hold([0.0]), environment=mfc.Environment(1e4, 5.0, one_sided=True)
)
NOISE = np.random.default_rng(5).normal(size=2000)


def results() -> dict[str, Any]:
    lin = MOVING.linearize([0.0, 0.1])
    run = MOVING.simulate(0.1, initial_error=0.01)
    return {
        "linearization": lin,
        "linearization along a run": MOVING.linearize([0.05], about="simulation", simulation=run),
        "margins": lin.margins(),
        "worst": lin.margins().worst(),
        "disk margin": lin.disk_margin(),
        "stability": lin.stability,
        "pole": lin.pole_table(0)[0],
        "step": lin.step(0),
        "all steps": lin.steps([0.0, 0.1], inputs=[0], outputs=[0, 7]),
        "late step": LATE.linearize().step(0),
        "port": lin.port([1.0, 10.0]),
        "passivity": lin.passivity(),
        "transient growth": lin.transient_growth(),
        "floquet": MOVING.floquet(),
        "decentralised": lin.decentralised(),
        "steps": step_metrics(LATE.linearize()),
        "coupling": coupling(lin, ["q_d_shoulder_pan_joint"], ["q_elbow_joint"], [1.0, 10.0]),
        "measured response": mfc.frf.estimate(0.01 * np.arange(len(NOISE)), NOISE, np.cumsum(NOISE)),
        "second opinion": LATE.linearize().second_opinion(),
        "run": run,
        "late run": LATE.simulate(0.02, initial_error=0.01),
        "sampled run": SAMPLED.simulate(0.02, initial_error=0.01),
        "run with contact": bounced(),
        "validation": MOVING.validate(0.05),
        "equilibrium": LATE.equilibrium(),
        "quasi-static": PRESSING.quasi_static(),
        "gains": PID,
        "damping matrix": mfc.gains.cartesian_damping(ARM, Q, [500.0] * 6, 0.7),
        "joint gains": mfc.gains.joint_pid(ARM, Q, natural_frequency=8.0),
        "limit": mfc.design.max_delay(_made(20.0)),
        "bandwidth": mfc.design.max_bandwidth(_made, mfc.Requirements(phase_deg=30), [0.0], upper=1000.0),
        "worst case": mfc.design.worst_case(_heavier, {"mass": [0.0, 1.0]}, [0.0], "phase_deg"),
        "attribution": mfc.design.attribute(_made(20.0), mfc.Requirements(phase_deg=30)),
        "tuned gains": mfc.design.tune(_made, {"bandwidth": (1.0, 100.0)}, mfc.Requirements(phase_deg=30)),
        "impact": mfc.design.impact(TOUCHED, [0.1], duration=0.05),
        "stiffness sweep": mfc.design.over_stiffness(PRESSING, [1e3, 1e4]),
        "stability map": mfc.design.stiffness_map(lambda gain: _pressing(gain), [1e3, 1e4], [10.0, 20.0]),
        "delay map": mfc.design.delay_map(lambda hz: _made(hz), [1e-3, 5e-3], [10.0, 20.0]),
        "verdict": ASKED.check(MOVING, [0.0, 0.1]),
        "requirements": ASKED,
    }


def _made(bandwidth: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(
        ONE, mfc.laws.ComputedTorque(**mfc.gains.pid(bandwidth=bandwidth)), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(delay=2e-3)
    )


def _heavier(mass: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(ONE.with_payload(mass), mfc.laws.ComputedTorque(**PID), mfc.trajectories.Hold([0.3]), controller_model=ONE)


def _pressing(kfi: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(ARM, mfc.laws.DampedForcePI(F, 0.5, kfi, [400.0] * 6), mfc.trajectories.Hold(Q), environment=WALL)


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return results()


def parts(thing: Any, seen: set[int]) -> Iterator[Any]:
    """The thing and everything of this package in it."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    yield thing
    inner: list[Any] = []
    if isinstance(thing, dict):
        inner = list(thing.values())
    elif isinstance(thing, (list, tuple)):
        inner = list(thing)
    elif type(thing).__module__.startswith("mfc_analysis"):
        inner = list(getattr(thing, "__dict__", {}).values())
    for one in inner:
        yield from parts(one, seen)


def test_every_result_pickles_and_says_the_same_afterwards(made: dict[str, Any]) -> None:
    for name, thing in made.items():
        again = pickle.loads(pickle.dumps(thing))
        assert type(again) is type(thing) and str(again) == str(thing), name


def test_what_a_result_answers_later_it_answers_after_the_trip_too(made: dict[str, Any]) -> None:
    again = pickle.loads(pickle.dumps(made))
    assert str(again["linearization"].margins(at="command")) == str(made["linearization"].margins(at="command"))
    assert str(again["linearization along a run"].again(np.array([0.02]))) == str(made["linearization along a run"].again(np.array([0.02])))
    assert np.array_equal(again["all steps"].y, made["all steps"].y)
    for name in ("run", "late run", "sampled run", "run with contact"):
        t = np.linspace(0.0, made[name].end, 7)
        assert np.array_equal(again[name].state(t), made[name].state(t)), name
    assert np.array_equal(again["quasi-static"].departure([10.0]), made["quasi-static"].departure([10.0]))


def test_the_list_has_every_class_of_results(made: dict[str, Any]) -> None:
    there = {type(thing).__name__ for thing in parts(made, set())}
    for file in (file for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))):
        module = importlib.import_module(".".join(("mfc_analysis", *file.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"))
        for name, cls in inspect.getmembers(module, inspect.isclass):
            if cls.__module__ == module.__name__ and is_dataclass(cls) and not issubclass(cls, Enum) and not name.startswith("_"):
                assert name in there | WITHIN, f"{module.__name__}.{name} is neither in the list nor in WITHIN"


def test_a_loop_is_sent_without_what_it_has_computed() -> None:
    """Else each chunk of many times carries those times again."""
    robot = mfc.robots.ur5()
    path = mfc.trajectories.Sinusoid(center=regular_pose("ur5"), amplitude=0.3, frequency=2.0)
    law = mfc.laws.TaskComputedTorque(**mfc.gains.pid(bandwidth=5.0))
    loop = mfc.ClosedLoop(robot.with_payload(1.0), law, path, controller_model=robot)
    fresh = len(pickle.dumps(loop))
    A = loop.linearize(np.linspace(0.0, 3.0, 400)).A
    sent = pickle.dumps(loop)
    assert len(sent) < 1.2 * fresh
    again = pickle.loads(sent)
    np.testing.assert_array_equal(again.linearize(np.linspace(0.0, 3.0, 400)).A, A)
    q = regular_pose("ur5")
    assert again.equations.plant.at(q).J is again.equations.controller.at(q).J  # one kinematics for both, as before
