"""What every law offers, and that nothing but its attributes and hooks says what it is."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, MfcError, Unsupported
from mfc_analysis.laws.law import JointLaw, Law, ToolLaw, define
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.trajectories import Hold, Quintic
from tests.conftest import LAWS, Case, arm, loop_of, named, regular_pose, surfaces


def own(kind: type[Law]) -> type[Law]:
    """A law of one's own: a subclass of a shipped one, with nothing but another equation."""
    return dataclass(frozen=True, eq=False)(type("Mine", (kind,), {"equation": f"own: {kind.equation} again", "__annotations__": {}}))


def the_same_as_ones_own(given: Law) -> Law:
    kind = own(type(given))
    return kind(**{f.name: getattr(given, f.name) for f in fields(given) if f.init})  # type: ignore[arg-type]


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_a_law_of_ones_own_is_judged_like_the_law_that_it_is(case: Case) -> None:
    loop = loop_of(case, "ur5", contact=case.law(6).plant == "torque")
    mine = replace(loop, law=the_same_as_ones_own(loop.law))
    assert mine.law.equation != loop.law.equation
    times = [0.4]
    one, two = loop.linearize(times), mine.linearize(times)
    assert_array_equal(two.A, one.A)
    assert_array_equal(two.stable, one.stable)
    assert (two.coordinates, two.output_names, two.opened.points) == (one.coordinates, one.output_names, one.opened.points)
    asked = mfc.Requirements(phase_deg=30, settling_time=0.5)
    a, b = asked.check(loop, times), asked.check(mine, times)
    assert [str(line) for line in b.lines] == [str(line) for line in a.lines]
    assert (b.status, b.notes) == (a.status, a.notes)


@pytest.mark.parametrize("case", named("9.21", "9.22", "9.23"), ids=str)
def test_a_force_law_of_ones_own_has_no_motion_reference_either(case: Case) -> None:
    q = regular_pose("ur5")
    mine = the_same_as_ones_own(case.law(6))
    with pytest.raises(BadArgument, match="Mine has no motion reference"):
        ClosedLoop(arm("ur5"), mine, Quintic(q, q + 0.1, 1.0), environment=surfaces("ur5", q))
    assert ClosedLoop(arm("ur5"), mine, Hold(q), environment=surfaces("ur5", q)).quasi_static().force.any()


def test_a_law_that_needs_the_acceleration_says_so_and_not_its_number() -> None:
    q = regular_pose("planar_2r")
    printed = loop_of(named("9.9 printed")[0], "planar_2r")
    mine = replace(printed, law=the_same_as_ones_own(printed.law))
    assert mine.law.needs_acceleration
    assert_array_equal(mine.linearize([0.3]).A, printed.linearize([0.3]).A)
    assert_array_equal(mine.equations.rates(0.3, np.r_[q, 0.1, -0.2]), printed.equations.rates(0.3, np.r_[q, 0.1, -0.2]))
    with pytest.raises(Unsupported, match="algebraic loop"):
        replace(mine, hardware=mfc.Hardware(delay=1e-3))
    with pytest.raises(Unsupported):
        mfc.laws.VelocityP(1.0).acceleration_torque(printed.equations.plant, printed.equations.reference(0.0), q)


def test_a_class_without_act_is_no_law() -> None:
    with pytest.raises(TypeError, match="abstract"):
        type("Nothing", (JointLaw,), {"equation": "none"})()
    assert JointLaw.space == "joint" and ToolLaw.space == "tool"


@define
class Scaled(JointLaw):
    """u = Kp e + Kd (v_d - v), as a torque."""

    kp: mfc.laws.Gain
    kd: mfc.laws.Gain = mfc.laws.Gain(given=2.0)
    equation = "own"

    def act(self, model: Any, now: Any, ref: Any, tap: Any) -> Any:
        """tau = Kp e + Kd e'."""
        e = ref.q - now.q
        return mfc.laws.Action(self.kp @ e + self.kd @ (ref.v - now.v), {}, e)


def test_gain_fields_take_what_a_gain_can_be_made_of_and_a_law_is_a_value() -> None:
    one = Scaled(kp=[100, 200])
    assert_allclose(one.kp.matrix(2), np.diag([100.0, 200.0]))
    assert float(one.kd.matrix(1)[0, 0]) == 2.0
    with pytest.raises(TypeError, match="kp"):
        Scaled()
    with pytest.raises(AttributeError):
        one.kp = 3.0
    with pytest.raises(BadArgument, match="kp"):
        Scaled(kp=np.nan)
    other = replace(one, kp=5.0)
    assert (str(other), str(one)) == ("Scaled(kp = 5, kd = 2) [own]", "Scaled(kp = [100, 200], kd = 2) [own]")
    again = pickle.loads(pickle.dumps(one))
    assert_array_equal(again.kp.array, one.kp.array)
    assert list(one.gains()) == ["kp", "kd"]


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_every_law_pickles(case: Case) -> None:
    given = case.law(6)
    again = pickle.loads(pickle.dumps(given))
    assert str(again) == str(given) and again.gains().keys() == given.gains().keys()


def test_errors_cross_processes_with_their_data() -> None:
    for error in (
        BadArgument("kp", -1, "a positive number"),
        mfc.errors.NearSingular("tool0", 1e-9, 1e8, 0.5),
        mfc.errors.UnknownName("law", "x", ["a"]),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error) and str(again) == str(error) and vars(again) == vars(error)
        assert isinstance(again, MfcError)


def test_a_law_shows_every_choice_that_is_not_the_default() -> None:
    L = mfc.laws
    euclidean, printed = L.TaskComputedTorque(100.0, kd=20.0, inverse="euclidean"), L.TorqueFeedforward(form="printed")
    assert str(euclidean) == "TaskComputedTorque(kp = 100, kd = 20, inverse='euclidean') [eq. 9.16]"
    assert str(euclidean.changed(inverse="dynamic")) == "TaskComputedTorque(kp = 100, kd = 20) [eq. 9.16]"
    assert str(printed) == "TorqueFeedforward(form='printed') [eq. 9.9]"
    assert "projection='selection'" in str(L.HybridMotionForce(np.zeros(6), 100.0, constraints=np.eye(6)[2:3], projection="selection"))
