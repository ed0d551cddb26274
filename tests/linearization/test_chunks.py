"""Results at many times: chunk by chunk, the numbers of the points alone, whatever the number of processes."""

from __future__ import annotations

from dataclasses import fields, replace

import joblib
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import mfc_analysis as mfc
from mfc_analysis.dynamics.operating_point import CHUNK, chunks
from mfc_analysis.errors import BadArgument
from mfc_analysis.linearization.chunks import joined
from mfc_analysis.linearization.linearization import Linearization
from mfc_analysis.maths import checks

Q0 = [0.3, -1.2, 1.5, -0.8, -1.4, 0.2]
TIMES = np.linspace(0, 4, 2 * CHUNK + 3)


def pressing(**hardware: float) -> Linearization:
    arm = mfc.robots.planar_2r()
    path = mfc.trajectories.Sinusoid(Q0[:2], 0.2, 1.3)
    law, late = mfc.laws.ComputedTorque(100, 80, 20), mfc.Hardware(**hardware)
    return mfc.ClosedLoop(arm.with_payload(2.0), law, path, controller_model=arm, hardware=late).linearize(TIMES)


def same(found: object, expected: object, some: slice) -> None:
    for field in fields(expected):  # type: ignore[arg-type]
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            assert_array_equal(a[some], b, err_msg=field.name)


def alone(lin: Linearization, some: slice) -> Linearization:
    point = lin.point
    return replace(lin, point=type(point)(point.times[some], point.x[some], None))


def test_poles_and_verdicts_are_those_of_each_chunk_alone():
    lin, last = pressing(), slice(2 * CHUNK, None)
    few = alone(lin, last)
    assert_array_equal(lin.poles()[last], few.poles())
    assert len(lin.poles()) == len(lin.stability.stable) == len(lin.stability.slow_roots) == len(lin.stability.motion) == len(TIMES)
    same(lin.stability, few.stability, last)
    assert lin.stability.horizon == few.stability.horizon


def test_margins_are_the_same_to_the_last_bit_for_any_number_of_processes():
    lin, first = pressing(torque_lag=0.004), slice(0, CHUNK)
    one, two = lin.margins(), lin.margins(n_jobs=2)
    same(two, one, slice(None))
    same(one, alone(lin, first).margins(), first)
    assert one.worst() == two.worst() and one.channels == two.channels and len(one.times) == len(TIMES)
    assert lin.__dict__.keys().isdisjoint({"opened", "_closed"})  # nothing of all points is kept
    with joblib.parallel_config("threading", n_jobs=2):
        same(lin.margins(), one, slice(None))


def test_the_disk_margin_of_many_points_has_the_bound_of_its_worst():
    lin = pressing()
    found = lin.disk_margin(frequencies=[3.0, 10.0])
    worst = int(np.nanargmin(found.alpha)) // CHUNK
    same(found, alone(lin, slice(CHUNK, 2 * CHUNK)).disk_margin(frequencies=[3.0, 10.0]), slice(CHUNK, 2 * CHUNK))
    assert found.bound is alone(lin, slice(worst * CHUNK, (worst + 1) * CHUNK)).disk_margin(frequencies=[3.0, 10.0]).bound


def test_operating_points_come_in_chunks_in_their_order():
    point = pressing().point
    parts = list(chunks(point))
    assert [len(part.times) for part in parts] == [CHUNK, CHUNK, 3]
    assert_array_equal(np.concatenate([part.x for part in parts]), point.x)
    assert_array_equal(joined(parts).times, TIMES)
    assert joined(parts, times=np.zeros(1)).times.size == 1


@pytest.mark.parametrize("wrong", [0, 1.5, "two", True])
def test_a_number_of_processes_is_a_whole_number_but_zero(wrong):
    with pytest.raises(BadArgument, match="n_jobs"):
        checks.jobs(wrong)
    with pytest.raises(BadArgument, match="n_jobs"):
        pressing().poles(n_jobs=wrong)
