"""What all sections of the chapter speak of: arms, paths, designs, and the words for a number of each joint."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.report.chapter.arms import LIMITS, NAMES, PAYLOAD, POINTS, Designs, Polynomial, arms, decibels, per_joint, triple_pole


def test_only_the_six_joint_arm_carries_what_its_controller_does_not_know() -> None:
    found = arms()
    assert [(a.robot.n, a.exact) for a in found] == [(1, True), (2, True), (6, False)]
    heavy = found[2]
    assert sum(float(p.mass) for p in heavy.robot.payloads) - sum(float(p.mass) for p in heavy.model.payloads) == PAYLOAD
    for a in found:
        assert a.times.size == POINTS and (a.times[0], a.times[-1]) == (0.0, a.ref.duration)


@pytest.mark.parametrize("equation", NAMES)
def test_each_loop_runs_its_own_equation_with_the_model_that_its_controller_believes(equation: str) -> None:
    for arm in arms():
        view = Designs().view(equation, arm)
        assert view.loop.law.equation == equation and view.name.startswith(equation) and view.requirements is LIMITS
        assert (view.loop.robot, view.loop.equations.model) == (arm.robot, arm.model)


def test_an_equation_that_the_designs_do_not_have_is_no_other_one() -> None:
    with pytest.raises(KeyError):
        Designs().law("9.16", arms()[0])


def test_the_gains_of_each_equation_are_those_of_its_closed_form() -> None:
    arm, w = arms()[0], arms()[0].speed
    gains = {e: {name: float(np.ravel(g.array)[0]) for name, g in Designs().law(e, arm).gains().items() if g} for e in NAMES}
    assert gains["9.3"]["ki"] == gains["9.3"]["kp"] ** 2 / 4  # critical damping
    assert_allclose([gains["9.10"][x] for x in ("kp", "ki", "kd")], triple_pole(w))
    assert_allclose([1, *(triple_pole(w)[i] for i in (2, 0, 1))], np.poly([-w] * 3))
    assert_allclose([gains["9.11"][x] for x in ("kp", "kd")], [w**2, 2 * w])


def test_a_ramp_and_a_parabola_have_the_rates_that_differences_give() -> None:
    ref, t, h = Polynomial(3, 0.2, 0.1), np.array([0.0, 0.7, 2.0]), 1e-4
    here = ref(t)
    assert here.q.shape == (3, ref.n) and not ref(0.0).q.any()
    assert_allclose(here.v, (ref(t + h).q - ref(t - h).q) / (2 * h), atol=1e-10)
    assert_allclose(here.a, (ref(t + h).v - ref(t - h).v) / (2 * h), atol=1e-10)


def test_the_decibels_of_nothing_are_minus_infinity_and_joints_that_agree_are_told_once() -> None:
    assert decibels([10.0, 1.0]).tolist() == [20.0, 0.0] and decibels(0.0) == -np.inf
    assert per_joint([3.2, 3.2001]) == "3.20" and per_joint([5.4, 3.2]) == "3.20 to 5.40"
