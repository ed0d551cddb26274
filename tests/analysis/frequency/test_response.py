"""Frequency responses: the loop itself, others closed, dead time exact."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import mfc_analysis as mfc
from mfc_analysis.analysis.channels import channels
from mfc_analysis.analysis.frequency.resolvent import resolvent
from mfc_analysis.analysis.frequency.response import frequency_response
from mfc_analysis.errors import BadArgument, UnknownPoint
from tests.analysis.conftest import open_system, random_loops

s = control.tf("s")
W = np.geomspace(1e-2, 1e4, 60)


@pytest.mark.parametrize("L", [25 / (s**3 + 10 * s**2 + 10 * s + 10), (3 * s**2 + 3 * s + 1) / s**3, (s + 2) / (s + 1)])
def test_the_response_is_that_of_the_transfer_function(L):
    assert_allclose(frequency_response(open_system(L), W, "torque")[0, 0], L(1j * W), rtol=1e-9)


def test_dead_time_turns_the_phase_and_nothing_else():
    L = 2 / s
    assert_allclose(frequency_response(open_system(L, delay=0.3), W, "torque")[0, 0], L(1j * W) * np.exp(-0.3j * W), rtol=1e-12)


def test_a_sampled_loop_is_read_on_the_unit_circle():
    L = control.tf([0.4], [1, -0.9], 0.01)
    w = np.linspace(0.1, np.pi / 0.01, 30)
    assert_allclose(frequency_response(open_system(L), w, "torque")[0, 0], 0.4 / (np.exp(1j * w * 0.01) - 0.9), rtol=1e-10)


def test_cutting_one_wire_and_opening_one_from_the_closed_loop_give_the_same(rng):
    system = random_loops(rng, 3, 6, 3)
    H = resolvent(channels(system, "torque")).on(np.tile(W, (3, 1)))
    assert_allclose(frequency_response(system, W, "torque"), -H / (1 + H), rtol=1e-8)


def test_the_delays_of_the_other_wires_are_inside(rng):
    system = replace(random_loops(rng, 1, 4, 2), wire_delay=np.array([0.1, 0.25]))
    A, B, C = system.A[0], system.B[0][:, 1:], system.C[0][1:]
    for w in (0.3, 2.0, 11.0):
        G = C @ np.linalg.solve(1j * w * np.eye(4) - A, B)
        e = np.exp(-1j * w * system.wire_delay)
        expected = -(G[0, 0] + G[0, 1] * e[1] * G[1, 0] / (1 - G[1, 1] * e[1])) * e[0]
        assert_allclose(frequency_response(system, w, "torque")[0, 0, 0], expected, rtol=1e-12)


def test_on_a_pole_the_response_is_infinite_and_beside_it_finite():
    found = frequency_response(open_system(1 / s), [0.0, 1.0], "torque")[0, 0]
    assert np.isinf(found[0]) and found[1] == pytest.approx(-1j)


def test_bad_frequencies_and_points_are_refused():
    for bad in ([-1.0], [np.nan], [[1.0]], ["a"]):
        with pytest.raises(BadArgument, match="frequencies"):
            frequency_response(open_system(1 / s), bad, "torque")
    with pytest.raises(BadArgument, match="pi/dt"):
        frequency_response(open_system(control.tf([0.4], [1, -0.9], 0.01)), [400.0], "torque")
    with pytest.raises(UnknownPoint):
        frequency_response(open_system(1 / s), [1.0], "wrist")


@pytest.mark.parametrize(("hardware", "at"), [({}, "torque"), ({"delay": 3e-3}, "position"), ({"sample_time": 5e-3}, "torque")], ids=str)
def test_one_channel_alone_is_that_channel_of_all(hardware, at):
    law, hold = mfc.laws.ComputedTorque(100.0, 80.0, 20.0), mfc.trajectories.Hold([0.3, 0.8])
    lin = mfc.ClosedLoop(mfc.robots.planar_2r(), law, hold, hardware=mfc.Hardware(**hardware)).linearize([0.0, 1.0])
    w = np.geomspace(0.1, 300.0, 7)
    assert_array_equal(frequency_response(lin.opened_for(at), w, at, 1), lin.frequency_response(w, at)[:, [1]])
