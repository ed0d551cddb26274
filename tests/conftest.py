"""The lists that the shared tests run over: every robot, every law in all its forms, and regular poses to put them at."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from zlib import crc32

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.laws.law import Law
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.robots.robot import Robot
from mfc_analysis.trajectories import Hold, Sinusoid

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of the worker processes, which start later: they share the cores already

# the same examples at every run, and no clock: a failure is one that anyone can repeat
settings.register_profile("repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("repeatable")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes minutes goes first, so that two processes end together."""
    items.sort(key=lambda item: "[pyright]" not in item.nodeid)


#: the acceptance list; the last five are of example-robot-data
ROBOTS = ("single_joint", "planar_2r", "ur5", "panda", "xarm7", "z1", "talos_left_arm", "kinova")
ARMS = ROBOTS[2:]  #: six or seven joints: a tool-space law has a Jacobian of full rank
SIX = tuple(name for name in ARMS if name not in ("panda", "xarm7"))  #: a square Jacobian

F_D = np.array([2.0, -3.0, 12.0, 0.4, -0.3, 0.2])  # a wrench with every component, so that no mixed-up axis hides


@cache
def arm(name: str) -> Robot:
    """A robot of the list. Robots are values, so all tests share one."""
    return getattr(robots, name)() if name in ROBOTS[:3] else robots.load(name)


@cache
def plant(name: str) -> Robot:
    """The same robot with a payload and friction of which a controller that believes in ``arm(name)`` knows nothing."""
    return arm(name).with_payload(0.8, com=(0.02, -0.01, 0.05), inertia=0.01).with_friction(viscous=0.3, coulomb=0.2, coulomb_speed=0.7)


def seed(*words: object) -> np.random.Generator:
    """A generator that depends on the words alone."""
    return np.random.default_rng(crc32(repr(words).encode()))


@cache
def regular_pose(name: str, which: int = 0) -> np.ndarray:
    """(n,) a random pose inside the limits where the Jacobian of a whole arm has a condition number below 40."""
    robot, rng = arm(name), seed("pose", name, which)
    low, high = robot.limits.position.T
    low, high = np.maximum(low, -2.5) + 0.4, np.minimum(high, 2.5) - 0.4
    for _ in range(1000):
        q = rng.uniform(low, high)
        if robot.n < 6 or np.linalg.cond(robot.jacobian(q)) < 40:
            q.setflags(write=False)
            return q
    raise AssertionError(f"no regular pose of {name}")


def moving(name: str, which: int = 0) -> Sinusoid:
    """A joint reference that moves about a regular pose, every joint at its own phase, and keeps the Jacobian regular."""
    q = regular_pose(name, which)
    return Sinusoid(center=q, amplitude=0.1, frequency=3.0, phase=np.arange(q.size) * 0.7)


def surfaces(name: str, q: np.ndarray) -> list[Environment]:
    """Two surfaces, neither along the axes of the tool nor of the world."""
    X = arm(name).pose(q)
    tilted = X @ exp6(np.array([0.003, -0.004, 0.002, 0.5, -0.4, 0.6]))
    return [
        Environment([3000.0, 20.0, 15.0], [12.0, 0.3, 0.2], pose=tilted, axes="zrxry", preload=[5.0, 0.3, -0.2]),
        Environment([900.0, 400.0, 20.0], [3.0, 0.0, 0.4], pose=X @ exp6(np.array([0.0, 0.0, 0.001, -0.3, 0.7, 0.2])), axes="xyrz"),
    ]


@dataclass(frozen=True)
class Case:
    """A law of the list, with gains of every shape among them."""

    name: str
    make: Callable[[int], Law]

    def __str__(self) -> str:
        return self.name

    def law(self, n: int) -> Law:
        """The law for an arm of n joints."""
        return self.make(n)

    @property
    def tool(self) -> bool:
        """Whether it needs a Jacobian of full rank."""
        return self.law(6).space == "tool"


def full(size: int, scale: float) -> np.ndarray:
    """A gain matrix that is neither diagonal nor symmetric."""
    return scale * (np.eye(size) + 0.1 * np.random.default_rng(size).uniform(-1, 1, (size, size)))


def spd(size: int, scale: float) -> np.ndarray:
    """A symmetric positive definite matrix that is not diagonal."""
    A = full(size, 1.0)
    return scale * A @ A.T


def each(size: int, scale: float) -> np.ndarray:
    """A gain for each component."""
    return scale * np.linspace(0.8, 1.2, size)


def _outer() -> control.StateSpace:
    return control.ss(control.tf([8.0, 120.0, 40.0], [0.02, 1.0, 0.0]))  # PID with a filtered derivative


_A2 = np.array([[0.0, 0.6, 0.8, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])  # orthonormal rows, not along the axes
_A1 = np.array([[0.3, 0.1, 2.0, 0.2, -0.1, 0.0]])

LAWS: tuple[Case, ...] = (
    Case("9.1", lambda n: L.VelocityFeedforward()),
    Case("9.2", lambda n: L.VelocityP(full(n, 4.0))),
    Case("9.3", lambda n: L.VelocityPI(each(n, 4.0), 3.0)),
    Case("9.3 printed", lambda n: L.VelocityPI(4.0, full(n, 3.0), form="printed")),
    Case("9.4", lambda n: L.VelocityFeedforwardPI(4.0, each(n, 3.0))),
    *(Case(f"9.5 {form}", lambda n, form=form: L.TaskVelocity(full(6, 4.0), each(6, 3.0), form=form)) for form in L.TaskVelocity.forms),
    Case("9.5 damped", lambda n: L.TaskVelocity(4.0, damping=0.05)),
    Case("9.8", lambda n: L.JointPID(each(n, 300.0), 100.0, full(n, 40.0))),
    Case("9.8 PD", lambda n: L.JointPID(300.0, kd=40.0)),
    *(Case(f"9.9 {form}", lambda n, form=form: L.TorqueFeedforward(form)) for form in L.TorqueFeedforward.forms),
    *(Case(f"9.10 {form}", lambda n, form=form: L.ComputedTorque(full(n, 90.0), 40.0, each(n, 18.0), form=form)) for form in L.ComputedTorque.forms),
    *(
        Case(f"9.10 {form} mass", lambda n, form=form: L.ComputedTorque(90.0, 40.0, 18.0, form=form, mass=np.diag(each(n, 1.5))))
        for form in L.ComputedTorque.forms
    ),
    Case("9.11 PID", lambda n: L.InverseDynamics({"kp": 90.0, "ki": full(n, 40.0), "kd": 18.0})),
    Case("9.11 LTI", lambda n: L.InverseDynamics(_outer())),
    *(
        Case(f"9.16 {form}", lambda n, form=form: L.TaskComputedTorque(full(6, 90.0), 40.0, each(6, 18.0), form=form))
        for form in L.TaskComputedTorque.forms
    ),
    Case("9.16 null", lambda n: L.TaskComputedTorque(90.0, None, 18.0, null_damping=3.0)),
    Case("9.16 damped", lambda n: L.TaskComputedTorque(90.0, 40.0, 18.0, null_damping=3.0, damping=0.05, mass=np.diag(each(n, 1.5)))),
    Case("9.16 damped inertia", lambda n: L.TaskComputedTorque(90.0, None, each(6, 18.0), null_damping=3.0, damping=0.05)),
    Case("9.16 null euclidean", lambda n: L.TaskComputedTorque(90.0, 40.0, 18.0, null_damping=3.0, inverse="euclidean")),
    Case("9.21", lambda n: L.OpenLoopForce(F_D)),
    Case("9.22", lambda n: L.ForcePI(F_D, full(6, 1.5), each(6, 2.0))),
    Case("9.23", lambda n: L.DampedForcePI(F_D, 1.5, full(6, 2.0), each(6, 30.0))),
    *(
        Case(
            f"9.24 {projection} {form}",
            lambda n, projection=projection, form=form: L.HybridMotionForce(
                F_D, full(6, 90.0), 40.0, each(6, 18.0), 1.5, each(6, 2.0), full(6, 30.0),
                constraints=_A2 if projection == "selection" else _A1, projection=projection, form=form,
            ),
        )
        for projection in ("dynamic", "selection")
        for form in L.HybridMotionForce.forms
    ),
    Case("impedance", lambda n: L.Impedance(full(6, 400.0), each(6, 60.0), null_damping=3.0)),
    Case("impedance pressing", lambda n: L.Impedance(each(6, 400.0), 60.0, F_d=F_D, inverse_damping=0.05)),
    Case("impedance without Lambda", lambda n: L.Impedance(400.0, full(6, 60.0), feedforward=False)),
    Case("impedance shaped", lambda n: L.Impedance(each(6, 400.0), full(6, 60.0), spd(6, 4.0), F_D, null_damping=3.0)),
    Case("joint impedance", lambda n: L.JointImpedance(full(n, 300.0), each(n, 40.0))),
    Case("joint impedance shaped", lambda n: L.JointImpedance(each(n, 300.0), 40.0, spd(n, 2.0))),
    Case("admittance", lambda n: L.Admittance(F_D, spd(6, 4.0), full(6, 60.0), each(6, 200.0))),
    Case("admittance free", lambda n: L.Admittance(F_D, each(6, 4.0), 60.0, inverse_damping=0.05)),
)  # fmt: skip


def named(*names: str) -> list[Case]:
    """The laws of the list by name."""
    return [next(case for case in LAWS if case.name == name) for name in names]


def fits(case: Case, name: str) -> bool:
    """Whether this robot has the joints that the law needs."""
    return name in ARMS or not case.tool


def loop_of(case: Case, name: str, *, contact: bool = False, which: int = 0, **more: object) -> ClosedLoop:
    """The law on the robot with an unknown payload and friction, moving where the law has a motion reference."""
    law, q = case.law(arm(name).n), regular_pose(name, which)
    ref = Hold(q) if law.equation in ("9.21", "9.22", "9.23") else moving(name, which)
    environment = surfaces(name, q) if contact and (law.plant == "torque" or law.senses_force) else None
    hardware = more.get("hardware")
    if environment and law.plant == "velocity" and (hardware is None or (hardware.servo is None and hardware.velocity_lag is None)):
        environment = [replace(surface, damping=0.0) for surface in environment]  # a damper needs a velocity of the joints
    return ClosedLoop(plant(name), law, ref, controller_model=arm(name), environment=environment, **more)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator of this test alone."""
    return np.random.default_rng(20240601)
