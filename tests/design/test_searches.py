"""The search itself: first loss on a scan, then bisection; nothing assumed monotone."""

import math

import pytest

from mfc_analysis.design.ahead import Ahead
from mfc_analysis.design.searches import Limit, Outcome, bisected, first_loss, scan
from mfc_analysis.errors import BadArgument


def test_the_first_loss_is_taken_where_stability_comes_back():
    found = first_loss(lambda x: x < 2.0 or x > 5.0, scan(0.1, 100.0))
    assert found.holds == pytest.approx(2.0, rel=1e-6) and found.outcome is Outcome.FOUND


def test_values_that_fail_at_the_beginning_are_passed_over_and_told():
    found = first_loss(lambda x: 1.0 < x < 7.0, scan(0.1, 100.0))
    assert found.holds == pytest.approx(7.0, rel=1e-6) and found.before is not None and found.before <= 1.0


def test_bisection_ends_where_the_two_sides_touch_from_zero_too():
    for limit in (1e-9, 0.3, 4e7):
        low, high, _ = bisected(Ahead(lambda x, limit=limit: x < limit), 0.0, 1e9)
        assert low < limit <= high and high - low <= 1.01e-7 * high


def test_it_never_holds_and_it_always_holds():
    never, always = first_loss(lambda x: False, scan(1.0, 10.0)), first_loss(lambda x: True, scan(1.0, 10.0))
    assert never.outcome is Outcome.NOWHERE and math.isnan(never.holds)
    assert always.outcome is Outcome.UNLIMITED and always.holds == 10.0


def test_without_skipping_a_first_value_that_fails_ends_the_search():
    found = first_loss(lambda x: x > 1.0, [0.0, 1.0, 10.0], skip=False)
    assert found.outcome is Outcome.NOWHERE and found.evaluations == 1


def test_a_scan_has_its_ends_and_its_steps():
    values = scan(1e-2, 1e2, 8)
    assert values[0] == 1e-2 and values[-1] == pytest.approx(1e2) and len(values) == 33
    with pytest.raises(BadArgument, match="upper"):
        scan(1.0, 0.5)


def test_a_limit_is_a_float_in_every_respect():
    found = Limit(2.5, "largest", "s", binds="something")
    assert found * 2 == 5.0 and f"{found:.2f}" == "2.50" and max(found, 3.0) == 3.0 and "2.5 s" in str(found)
