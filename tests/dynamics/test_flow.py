"""Wires that can be cut, and external inputs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.dynamics.flow import Inputs, Wires
from mfc_analysis.maths.dual import value
from tests.conftest import LAWS, Case, named, plant
from tests.dynamics.test_equations import T, state

#: wires that a law doesn't listen to
SILENT = {"9.1": ("position",), "9.9 standard": ("position", "rate"), "9.9 printed": ("position", "rate"), "9.21": ("rate",), "9.22": ("rate",)}


@pytest.mark.parametrize("case", LAWS, ids=str)
def test_each_wire_can_be_cut_and_what_goes_on_is_what_is_put_in(case: Case) -> None:
    """Cut with its own value nothing changes; cut with another one everything behind it does, and what arrives is recorded."""
    loop, x = state(case, "ur5")
    e = loop.equations
    whole = Wires()
    closed = e.flow(T, x, whole)
    for name, size in e.wire_sizes().items():
        signal = value(closed.command) if name == e.actuator else value(whole.recorded[name])
        assert signal.shape == (2, size)
        same = Wires({name: np.array(signal)})
        again = e.flow(T, x, same)
        for slot in e.parts:
            rate = value(closed.rates[slot])
            assert_allclose(value(again.rates[slot]), rate, rtol=1e-9, atol=1e-8 * max(1.0, np.abs(rate).max()))
        assert_allclose(value(same.recorded[name]), signal, atol=1e-9 * max(1.0, np.abs(signal).max()))
        other = e.flow(T, x, Wires({name: signal + 0.1}))
        changed = any(not np.allclose(value(other.rates[slot]), value(closed.rates[slot]), rtol=1e-9) for slot in e.parts)
        assert changed != (name in SILENT.get(case.name, ())), name


def test_every_point_that_a_law_can_be_opened_at_has_a_wire() -> None:
    for case in LAWS:
        loop, _ = state(case, "ur5")
        assert set(loop.law.opens_at) <= set(loop.equations.wire_sizes())
        assert loop.default_at in loop.law.opens_at
        assert loop.default_at == ("velocity" if loop.law.equation in ("9.1", "9.2", "9.3", "9.4", "9.5", "admittance") else "torque")


def test_a_disturbance_and_a_reference_shift_enter_where_they_should() -> None:
    loop, x = state(named("9.8")[0], "planar_2r")
    e, d = loop.equations, np.array([1.0, -2.0])
    pushed, alone = (value(e.flow(T, x, None, Inputs(disturbance=b)).rates["v"]) for b in (d, None))
    q = x[:, :2]
    assert_allclose(pushed - alone, np.linalg.solve(plant("planar_2r").mass(q), np.broadcast_to(d[:, None], (2, 2, 1)))[..., 0], atol=1e-9)
    shifted = e.flow(T, x, None, Inputs(reference=d))
    assert_allclose(value(shifted.error) - value(e.flow(T, x).error), np.broadcast_to(d, (2, 2)), atol=1e-12)


def test_a_wire_records_its_signal_and_passes_on_what_is_put_in() -> None:
    wires = Wires({"torque": np.ones(2)})
    assert wires("torque", np.zeros(2)).tolist() == [1.0, 1.0] and wires("position", np.full(2, 3.0)).tolist() == [3.0, 3.0]
    assert wires.recorded["torque"].tolist() == [0.0, 0.0] and wires.cuts("torque") and not wires.cuts("position")
