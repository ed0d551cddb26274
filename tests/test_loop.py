"""``ClosedLoop``, the user's door: what it takes, what it refuses and how it says so."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis import laws as L, robots
from mfc_analysis.dynamics.environment import Environment
from mfc_analysis.dynamics.hardware import Hardware
from mfc_analysis.errors import BadArgument, MfcWarning, Unsupported
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, Quintic, Sinusoid, ToolHold, ToolLine
from tests.conftest import LAWS, Case, arm, loop_of, moving, plant, regular_pose

PID = L.JointPID(30.0, 5.0, 4.0)
UR5 = regular_pose("ur5")


def test_the_names_of_a_user_are_the_same_things() -> None:
    assert mfc.ClosedLoop is ClosedLoop and mfc.Hardware is Hardware and mfc.Environment is Environment and mfc.laws is L
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(2.205, kd=2.0), mfc.trajectories.Hold([0.0]))
    assert_allclose(loop.linearize().poles(), -2.1, atol=1e-6)


def test_a_controller_model_that_is_left_out_is_the_plant_payload_included() -> None:
    loop = ClosedLoop(plant("ur5"), L.ComputedTorque(90.0, kd=18.0), Hold(UR5))
    assert loop.equations.model is loop.robot and loop.controller_model is None
    assert_allclose(loop.linearize([0.0]).residual, 0, atol=1e-9)
    told = ClosedLoop(plant("ur5"), L.ComputedTorque(90.0, kd=18.0), Hold(UR5), controller_model=plant("ur5"))
    assert_allclose(told.linearize([0.0]).A, loop.linearize([0.0]).A)
    wrong = ClosedLoop(plant("ur5"), L.ComputedTorque(90.0, kd=18.0), Hold(UR5), controller_model=arm("ur5"))
    assert np.abs(wrong.linearize([0.0]).residual).max() > 0.1


class Broken:
    space = "joint"


@pytest.mark.parametrize(("given", "argument"), [
    ({"robot": "ur5"}, "robot"), ({"robot": None}, "robot"),
    ({"law": "PID"}, "law"), ({"law": L.JointPID}, "law"), ({"law": L.JointPID([1.0, 2.0, 3.0])}, "kp"),
    ({"ref": [0.0]}, "ref"), ({"ref": None}, "ref"), ({"ref": Hold([0.0, 0.0])}, "ref"), ({"ref": ToolHold(np.eye(4))}, "ref"),
    ({"controller_model": robots.slider()}, "controller_model"), ({"controller_model": robots.planar_2r()}, "controller_model"),
    ({"controller_model": "same"}, "controller_model"),
    ({"hardware": 1e-3}, "hardware"), ({"environment": "wall"}, "environment"),
    ({"q_start": [0.0, 1.0]}, "q_start"), ({"q_start": [np.nan]}, "q_start"), ({"q_start": "home"}, "q_start"),
])  # fmt: skip
def test_what_does_not_go_together_is_refused_by_name_with_what_is_taken(given: dict, argument: str) -> None:
    with pytest.raises(BadArgument) as info:
        ClosedLoop(**{"robot": robots.single_joint(), "law": PID, "ref": Hold([0.0]), **given})
    assert info.value.argument == argument and info.value.takes and str(info.value).startswith(f"{argument}: got ")
    assert isinstance(info.value, ValueError)


def test_a_tool_reference_needs_a_tool_law_and_a_place_to_start() -> None:
    X = arm("ur5").pose(UR5)
    with pytest.raises(BadArgument, match="from_tool_path") as info:
        ClosedLoop(arm("ur5"), PID, ToolHold(X), q_start=UR5)
    assert info.value.argument == "ref"
    with pytest.raises(BadArgument) as info:
        ClosedLoop(arm("ur5"), L.TaskVelocity(3.0), ToolHold(X))
    assert info.value.argument == "q_start"


@pytest.mark.parametrize("law", [L.OpenLoopForce(np.zeros(6)), L.ForcePI(np.zeros(6), 1.0), L.DampedForcePI(np.zeros(6), 1.0)], ids=str)
def test_the_reference_of_a_force_law_is_a_hold(law: L.Law) -> None:
    for ref in (Sinusoid([0.0], 0.1, 1.0), Quintic([0.0], [1.0])):
        with pytest.raises(BadArgument, match="Hold") as info:
            ClosedLoop(robots.single_joint(), law, ref)
        assert info.value.argument == "ref"
    ClosedLoop(robots.single_joint(), law, Hold([0.0]))


def test_a_velocity_law_feels_no_surface() -> None:
    with pytest.raises(Unsupported) as info:
        ClosedLoop(robots.single_joint(), L.VelocityP(1.0), Hold([0.0]), environment=Environment(1e3))
    assert info.value.argument == "environment"


@pytest.mark.filterwarnings("ignore::mfc_analysis.errors.MfcWarning")  # of the joints that match= does not name
def test_a_reference_outside_the_limits_is_a_warning() -> None:
    limits = arm("ur5").limits
    far = np.minimum(limits.upper, 10.0) + 0.5
    with pytest.warns(MfcWarning, match=arm("ur5").joint_names[0]):
        loop = ClosedLoop(arm("ur5"), L.ComputedTorque(90.0, kd=18.0), Hold(far))
    assert np.isfinite(loop.linearize([0.0]).A).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ClosedLoop(arm("ur5"), L.ComputedTorque(90.0, kd=18.0), moving("ur5"))


def test_a_tool_path_that_takes_a_joint_beyond_its_limit_is_a_warning() -> None:
    low, high = arm("z1").limits.position.T
    q = regular_pose("z1").copy()
    q[5] = high[5] - 0.05
    X0 = arm("z1").pose(q)
    beyond = q.copy()
    beyond[5] = high[5] + 0.2
    loop = ClosedLoop(arm("z1"), L.TaskVelocity(3.0), ToolLine(X0, arm("z1").pose(beyond), 1.0), q_start=q)
    with pytest.warns(MfcWarning, match=arm("z1").joint_names[5]):
        loop.linearize([0.0, 1.0])
    assert low.size == 6


@pytest.mark.parametrize(("given", "argument"), [
    ({"times": [0.0, 0.0]}, "times"), ({"times": [1.0, 0.0]}, "times"), ({"times": []}, "times"), ({"times": np.nan}, "times"),
    ({"times": [[0.0, 1.0]]}, "times"), ({"times": "all"}, "times"), ({"times": None}, "times"),
    ({"about": "path"}, "about"), ({"about": None}, "about"), ({"coordinates": "joint"}, "coordinates"), ({"about": "simulation"}, "simulation"),
])  # fmt: skip
def test_what_cannot_be_linearised_is_refused_by_name(given: dict, argument: str) -> None:
    loop = ClosedLoop(robots.single_joint(), PID, Hold([0.0]))
    with pytest.raises(BadArgument) as info:
        loop.linearize(**{"times": [0.0], **given})
    assert info.value.argument == argument


def test_coordinates_default_to_the_error_where_the_jacobian_is_square_and_well_conditioned() -> None:
    def chosen(name: str, law: L.Law, q: np.ndarray) -> str:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MfcWarning)
            return ClosedLoop(arm(name), law, Hold(q)).linearize([0.0]).coordinates

    task = L.TaskComputedTorque(90.0, kd=18.0)
    assert chosen("ur5", task, UR5) == "error" and chosen("panda", task, regular_pose("panda")) == "state"
    assert chosen("ur5", L.TaskComputedTorque(90.0, kd=18.0, damping=0.1), np.array([0.1, -0.9, 1.6, -0.7, 1e-5, 0.3])) == "state"
    assert chosen("ur5", L.ComputedTorque(90.0, kd=18.0), UR5) == "state"
    assert chosen("ur5", L.TaskVelocity(3.0), UR5) == "error"


def test_the_reference_that_is_followed_is_the_one_asked_for() -> None:
    ref = moving("ur5")
    loop = ClosedLoop(arm("ur5"), L.ComputedTorque(90.0, kd=18.0), ref)
    t = np.array([0.0, 0.4, 1.1])
    assert_allclose(loop.nominal(t).q, ref(t).q)
    line = ToolLine(arm("ur5").pose(UR5), arm("ur5").pose(UR5 + 0.1), 1.0)
    tool = ClosedLoop(arm("ur5"), L.TaskVelocity(3.0), line, q_start=UR5)
    found = tool.nominal(t)
    assert_allclose(arm("ur5").pose(found.q), line(t).X, atol=1e-9)
    assert_allclose(np.einsum("tij,tj->ti", arm("ur5").jacobian(found.q), found.v), line(t).V, atol=1e-8)
    alone = tool.nominal([1.1])  # a time by itself is followed from the start as well
    assert_allclose(alone.q[0], found.q[2], atol=1e-6)


def test_a_loop_is_a_value() -> None:
    loop = ClosedLoop(robots.single_joint(), PID, Hold([0.0]))
    with pytest.raises(AttributeError):
        loop.law = L.JointPID(1.0)
    q = np.array([0.3])
    held = ClosedLoop(robots.single_joint(), PID, Hold(q), q_start=q)
    q[0] = 9.0
    assert_allclose(held.nominal([0.0]).q, 0.3)
    assert_allclose(held.q_start, 0.3)


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_a_loop_says_what_it_is(case: Case) -> None:
    loop = loop_of(case, "ur5", contact=case.law(6).plant == "torque")
    assert f"[{loop.law.numbered()}]" in str(loop) and "ur5" in str(loop)
    assert ("surface" in str(loop)) == bool(loop.equations.surfaces)


def test_a_quasi_static_wall_bears_what_the_law_presses() -> None:
    """9.20 without an environment: the tool is held rigidly, and with an exact model F_tip is F_d."""
    F_d = np.array([1.0, -2.0, 8.0, 0.1, 0.2, -0.3])
    found = ClosedLoop(arm("ur5"), L.OpenLoopForce(F_d), Hold(UR5)).quasi_static()
    assert_allclose(found.force, F_d, atol=1e-9)
    heavy = ClosedLoop(plant("ur5"), L.OpenLoopForce(F_d), Hold(UR5), controller_model=arm("ur5")).quasi_static()
    missing = np.linalg.solve(arm("ur5").jacobian(UR5).T, arm("ur5").gravity(UR5) - plant("ur5").gravity(UR5))
    assert_allclose(heavy.error, -missing, atol=1e-8)
    assert_allclose(heavy.force, F_d + missing, atol=1e-8)
