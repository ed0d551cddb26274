"""Searches with several processes: the same results to the last bit; what is not asked for leaves no trace."""

from __future__ import annotations

import os
import warnings

import joblib
import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis import design
from mfc_analysis.design.ahead import Ahead
from mfc_analysis.design.searches import first_loss, scan
from mfc_analysis.errors import BadArgument
from tests.design.test_limits import pressing, velocity_p
from tests.design.test_worst_case import two_lags

ASKED = mfc.Requirements(phase_deg=60.0)
WORST = {"gain": (1.0, 5.0), "lag": (1e-3, 2e-2)}
SEARCHES = {
    "max_delay": lambda n_jobs: design.max_delay(velocity_p(velocity_lag=2e-3), n_jobs=n_jobs),
    "max_stiffness": lambda n_jobs: design.max_stiffness(pressing(torque_lag=5e-3), n_jobs=n_jobs),
    "min_sample_rate": lambda n_jobs: design.min_sample_rate(velocity_p(), n_jobs=n_jobs),
    "max_payload": lambda n_jobs: design.max_payload(
        mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.JointPID(5.0, 2.0, 2.0), mfc.trajectories.Hold([0.3])), n_jobs=n_jobs
    ),
    "max_bandwidth": lambda n_jobs: design.max_bandwidth(lambda w: velocity_p(w, velocity_lag=2e-3), ASKED, [0.0], n_jobs=n_jobs),
    "max_delay with requirements": lambda n_jobs: design.max_delay(velocity_p(velocity_lag=2e-3), requirements=ASKED, n_jobs=n_jobs),
    "min_sample_rate with requirements": lambda n_jobs: design.min_sample_rate(
        velocity_p(velocity_lag=2e-3, sample_time=0.2), requirements=mfc.Requirements(phase_deg=75.0), n_jobs=n_jobs
    ),
    "max_bandwidth of several loops": lambda n_jobs: design.max_bandwidth(
        lambda w: [velocity_p(w, velocity_lag=lag) for lag in (1e-3, 2e-3, 3e-3)], ASKED, [0.0], n_jobs=n_jobs
    ),
    "worst_case": lambda n_jobs: design.worst_case(two_lags, WORST, points=3, n_jobs=n_jobs),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_a_search_is_the_same_to_the_last_bit_with_two_processes(name):
    one, two = (SEARCHES[name](n_jobs) for n_jobs in (1, 2))
    assert float(one) == float(two) and str(one) == str(two) and one.replay == two.replay
    assert one.evaluations == two.evaluations > 1


@pytest.mark.parametrize("n_jobs", [2, 3])
def test_the_values_of_a_scan_and_of_a_bisection_are_asked_for_in_their_order(n_jobs):
    asked: dict[int, list[float]] = {1: [], n_jobs: []}
    found = [first_loss(lambda x: x < 2.0 or x > 5.0, scan(0.1, 100.0), tick=asked[n].append, n_jobs=n) for n in asked]
    assert found[0] == found[1] and asked[1] == asked[n_jobs] and len(asked[1]) == found[0].evaluations


def test_what_may_come_next_is_computed_by_the_other_process_at_the_same_time():
    ahead = Ahead(lambda x: (x, os.getpid()), 2)
    assert [ahead(x, range(x + 1, 4))[0] for x in range(4)] == [0, 1, 2, 3]
    assert os.getpid() not in {ahead(x)[1] for x in range(4)}
    alone = Ahead(lambda x: (x, os.getpid()))
    assert alone(0, (1 // x for x in (0,))) == (0, os.getpid()) and not alone.known


def failing(x: float) -> float:
    warnings.warn(f"near {x}", UserWarning, stacklevel=1)
    if x > 1:
        raise BadArgument("x", x, "less")
    return 10 * x


def refused(some):
    raise BadArgument("some", some, "fewer")


def test_errors_and_warnings_belong_to_the_values_that_are_asked_for():
    ahead = Ahead(failing, 2)
    with pytest.warns(UserWarning) as said:
        assert ahead(1.0, [2.0]) == 10.0
    assert [str(w.message) for w in said] == ["near 1.0"] and set(ahead.known) == {1.0, 2.0}
    with pytest.warns(UserWarning, match=r"near 2\.0"), pytest.raises(BadArgument, match="less"):
        ahead(2.0)


def test_what_may_come_next_is_computed_together_in_one_process():
    asked = []
    ahead = Ahead(lambda x: asked.append(x) or 10 * x, 1, lambda some: asked.append(some) or [10 * x for x in some])
    assert [ahead(x, range(x + 1, 9)) for x in (0, 1, 2, 3)] == [0, 10, 20, 30]
    assert ahead(8) == 80 and asked == [[0, 1, 2], [3, 4, 5], 8]


@pytest.mark.parametrize("together", [lambda some: None, refused])
def test_where_several_cannot_be_computed_together_one_is(together):
    ahead = Ahead(lambda x: 10 * x, 1, together)
    assert ahead(0.5, [2.0]) == 5.0 and not ahead.known


def test_the_number_of_processes_may_come_from_joblib():
    with joblib.parallel_config(n_jobs=3):
        assert Ahead(np.sqrt).workers == 3
    assert Ahead(np.sqrt).workers == 1
    for wrong in (0, 1.5, "two"):
        with pytest.raises(BadArgument, match="n_jobs"):
            Ahead(np.sqrt, wrong)
