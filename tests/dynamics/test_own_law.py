"""Laws of users at the door: what does not fit is named when the loop is made, and a point that ``act`` names is one that can be opened."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import mfc_analysis as mfc
from mfc_analysis.dynamics.own_law import is_own
from mfc_analysis.errors import BadArgument
from mfc_analysis.laws import Action, JointLaw, Slot, define
from mfc_analysis.maths.dual import matvec
from tests.conftest import arm, regular_pose

Act = Callable[..., Any]


def own(act: Act, **attributes: Any) -> mfc.laws.Law:
    return define(type("Own", (JointLaw,), {"act": act, "equation": "own: a test", **attributes}))()  # type: ignore[no-any-return]


def torque(model: Any, now: Any, ref: Any) -> Any:
    return model.gravity(now.q) + 400.0 * (ref.q - now.q) - 40.0 * now.v


def good(self: Any, model: Any, now: Any, ref: Any, tap: Any) -> Action:
    return Action(torque(model, now, ref), {}, ref.q - now.q)


def gives(command: Callable[[Any, Any, Any], Any] = torque, error: Any = None, **rates: Any) -> Act:
    def act(self: Any, model: Any, now: Any, ref: Any, tap: Any) -> Action:
        return Action(command(model, now, ref), rates, ref.q - now.q if error is None else error)

    return act


def loop(law: mfc.laws.Law, **hardware: float) -> mfc.ClosedLoop:
    return mfc.ClosedLoop(arm("ur5"), law, mfc.trajectories.Hold(regular_pose("ur5")), hardware=mfc.Hardware(**hardware))


def slots(*names: str) -> Callable[..., tuple[Slot, ...]]:
    return lambda self, joints: tuple(Slot(name, joints) for name in names)


WRONG = {
    "no action": ((lambda *_: None), {}, "Own.act returns a NoneType"),
    "a bare command": ((lambda self, model, now, ref, tap: model.gravity(now.q)), {}, "Own.act returns a ndarray"),
    "a short command": (gives(lambda model, now, ref: np.zeros(5)), {}, "command of shape"),
    "a number": (gives(lambda model, now, ref: 0.0), {}, "command of shape"),
    "a short error": (gives(error=np.zeros(3)), {}, "error of shape"),
    "not finite": (gives(lambda model, now, ref: np.nan * now.q), {}, "command that is not finite"),
    "no rate": (gives(), {"slots": slots("w")}, "rates of"),
    "a rate too many": (gives(w=np.zeros(6)), {}, "rates of"),
    "a short rate": (gives(w=np.zeros(2)), {"slots": slots("w")}, "rate of 'w' of shape"),
    "a function of numpy": (gives(lambda model, now, ref: np.sin(now.q)), {}, "Own.act on dual arrays: TypeError"),
    "one joint": (gives(lambda model, now, ref: now.q + now.q[..., 0]), {}, "Own.act on "),
    "a bare matrix": (gives(lambda model, now, ref: np.eye(6) @ now.q), {}, "Own.act on arrays of several points"),
    "a state of the arm": (gives(q=np.zeros(6)), {"slots": slots("q")}, "law.slots: got 'q'"),
    "a slot twice": (gives(w=np.zeros(6)), {"slots": slots("w", "w")}, "law.slots: got 'w'"),
    "a bare slot": (gives(), {"slots": lambda self, joints: Slot("w", joints)}, "law.slots"),
    "a point that is not there": (good, {"opens_at": ("torque", "command")}, "law.opens_at: got 'command'"),
    "a bare name": (good, {"opens_at": "torque"}, "law.opens_at: got 'torque'"),
    "a plant": (good, {"plant": "position"}, "law.plant: got 'position'"),
    "a number for words": (good, {"equation": 9.99}, "law.equation: got 9.99"),
    "a sample time": (good, {"sample_time": "fast"}, "law.sample_time: got 'fast'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_law_that_does_not_fit_is_refused_when_the_loop_is_made(name: str) -> None:
    act, attributes, says = WRONG[name]
    law = own(act, **attributes)
    with pytest.raises(BadArgument) as why:
        loop(law)
    assert says in str(why.value)


def test_the_laws_of_the_package_are_not_evaluated_at_the_door() -> None:
    assert is_own(own(good)) and not is_own(mfc.laws.JointPID(1.0, kd=1.0))


def test_an_error_of_a_users_own_keeps_its_class() -> None:
    with pytest.raises(ZeroDivisionError):
        loop(own(lambda *_: 1 / 0))


@pytest.mark.parametrize("hardware", [{}, {"torque_lag": 2e-3, "delay": 1e-3}, {"torque_lag": 2e-3, "sample_time": 1e-3}], ids=str)
def test_a_point_with_a_name_of_its_own_can_be_opened(hardware: dict[str, float]) -> None:
    """All of the command on the wire "inner": its loops are those at the torques. Half of the position error on "half": L is the same ratio."""

    def act(self: Any, model: Any, now: Any, ref: Any, tap: Any) -> Action:
        return Action(tap("inner", torque(model, now, ref)), {}, ref.q - now.q)

    made = loop(own(act, opens_at=("torque", "inner")), **hardware)
    lin = made.linearize()
    ours, known = lin.margins(at="inner"), lin.margins(at="torque")
    assert ours.channels == known.channels == made.robot.joint_names
    for name in ("gain_reduction", "gain_increase", "phase_deg", "sensitivity_peak", "crossover"):
        assert_allclose(getattr(ours, name), getattr(known, name), rtol=1e-9)
    w = np.array([1.0, 30.0])
    assert_allclose(lin.frequency_response(w, at="inner"), lin.frequency_response(w, at="torque"), rtol=1e-9)
    assert_allclose(made.simulate(0.1, initial_error=0.05).q, loop(own(good), **hardware).simulate(0.1, initial_error=0.05).q, atol=1e-6)


class Through:
    """100 times two joints' values, on the torques of these."""

    def __init__(self, *on: int) -> None:
        self.on = on

    def __matmul__(self, x: Any) -> Any:
        return matvec(100.0 * np.eye(6)[:, 2:4] * [k in self.on for k in (2, 3)], x)


def two(*on: int) -> mfc.laws.Law:
    def act(self: Any, model: Any, now: Any, ref: Any, tap: Any) -> Action:
        e = ref.q - now.q
        return Action(torque(model, now, ref) + Through(*on) @ tap("two", e[..., 2:4]), {}, e)

    return own(act, opens_at=("torque", "two"))


def test_a_point_may_have_fewer_channels_than_joints() -> None:
    """On the wire the errors of the elbow and the first wrist, 100 Nm/rad: with it cut at the elbow, L is 100 times the loop without it."""
    lin, w = loop(two(2, 3)).linearize(), np.array([0.5, 5.0, 50.0])
    assert lin.margins(at="two").channels == ("two_1", "two_2")
    rest = loop(two(3)).linearize()
    elbow = "elbow_joint"
    into, out = rest.input_names.index(f"disturbance_{elbow}"), rest.output_names.index(f"q_{elbow}")
    states = 1j * w[:, None, None] * np.eye(rest.A.shape[1]) - rest.A
    known = 100.0 * (rest.C[0, out] @ np.linalg.solve(states, rest.B[:, :, into, None]))[:, 0]
    assert_allclose(lin.frequency_response(w, at="two")[0, 0], known, rtol=1e-8)


@pytest.mark.parametrize("what", [3, Through, Through(2)], ids=["number", "class", "object"])
def test_only_a_class_of_laws_is_defined(what: Any) -> None:
    with pytest.raises(BadArgument, match=r"^cls: got .*; takes a class derived from mfc\.laws\.JointLaw"):
        define(what)


def test_a_law_without_words_for_its_equation_is_called_by_its_class():
    def act(self, model, now, ref, tap):
        return Action(8.0 * (ref.q - now.q) - 2.0 * now.v, {}, ref.q - now.q)

    law = define(type("Spring", (JointLaw,), {"act": act}))()
    loop = mfc.ClosedLoop(mfc.robots.single_joint(), law, mfc.trajectories.Hold([0.3]))
    assert law.numbered() == "Spring" and "Spring" in str(loop.linearize())
