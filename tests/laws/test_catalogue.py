"""Laws by the number of their equation."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis import laws as L
from mfc_analysis.errors import BadArgument, UnknownName
from mfc_analysis.laws import LAWS, by_equation
from mfc_analysis.laws.law import Law
from tests.conftest import LAWS as CASES


@pytest.mark.parametrize(("number", "law"), [
    ("9.1", L.VelocityFeedforward), ("9.2", L.VelocityP), ("9.3", L.VelocityPI), ("9.4", L.VelocityFeedforwardPI), ("9.5", L.TaskVelocity),
    ("9.8", L.JointPID), ("9.9", L.TorqueFeedforward), ("9.10", L.ComputedTorque), ("9.11", L.InverseDynamics), ("9.12", L.ComputedTorque),
    ("9.13", L.InverseDynamics), ("9.16", L.TaskComputedTorque), ("9.21", L.OpenLoopForce), ("9.22", L.ForcePI), ("9.23", L.DampedForcePI),
    ("9.24", L.HybridMotionForce),
])  # fmt: skip
def test_each_control_equation_has_its_law(number: str, law: type[Law]) -> None:
    assert by_equation(number) is law
    assert by_equation(f"eq. {number}") is law and by_equation(f"({number})") is law


@pytest.mark.parametrize("number", ["9.6", "9.14", "8.1", "", "ten"])
def test_an_equation_without_a_law_is_refused_with_the_list(number: str) -> None:
    with pytest.raises(UnknownName) as info:
        by_equation(number)
    assert set(LAWS) == set(info.value.known) and isinstance(info.value, ValueError)


@pytest.mark.parametrize("number", [9.10, 9.1, 9, None])
def test_a_number_that_is_not_text_is_refused_since_9_10_would_be_9_1(number: object) -> None:
    with pytest.raises(BadArgument, match=r"9\.10"):
        by_equation(number)


def test_the_shared_tests_run_over_every_law_in_every_form_and_projection() -> None:
    """A new law is tested by being listed: nothing in the catalogue may be missing from the list."""
    listed = {(type(law), getattr(law, "form", "standard"), getattr(law, "projection", "")) for law in (case.law(6) for case in CASES)}
    projections = {L.HybridMotionForce: ("dynamic", "selection")}
    wanted = {(law, form, project) for law in LAWS.values() for form in law.forms for project in projections.get(law, ("",))}
    assert wanted <= listed


@pytest.mark.parametrize("law", sorted(set(LAWS.values()), key=lambda law: law.__name__))
def test_a_form_that_is_not_on_the_list_is_refused(law: type[Law]) -> None:
    from dataclasses import fields

    names = [f.name for f in fields(law)]
    if "form" not in names:
        with pytest.raises(TypeError):
            law(form="printed")
        return
    needed = {"kp": 1.0, "ki": 1.0, "F_d": np.zeros(6), "constraints": np.eye(6)[[2]]}
    given = {name: needed[name] for name in names if name in needed}
    with pytest.raises(BadArgument, match="standard") as info:
        law(**given, form="as printed")
    assert info.value.argument == "form"


def test_unknown_keywords_raise() -> None:
    with pytest.raises(TypeError):
        L.ComputedTorque(kp=1.0, gain=2.0)
