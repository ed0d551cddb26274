"""A root between two points: its digits, its ends, and what is none."""

from __future__ import annotations

import math

import pytest

from mfc_analysis.maths.roots import root_between


def test_the_root_has_all_its_digits_large_or_small() -> None:
    assert root_between(lambda x: x * x - 2.0, 0.0, 2.0) == pytest.approx(math.sqrt(2.0), rel=4e-15)  # a few units in the last place
    assert root_between(lambda x: x - 1e6 * math.pi, 0.0, 1e7) == pytest.approx(1e6 * math.pi, rel=4e-15)
    assert root_between(lambda x: x - 1e-15, -1.0, 1.0, xtol=1e-18) == pytest.approx(1e-15, abs=1e-18)


def test_a_root_at_an_end_is_found_and_the_ends_may_stand_either_way() -> None:
    assert root_between(lambda x: x - 1.0, 1.0, 3.0) == 1.0
    assert root_between(math.cos, 3.0, 0.0) == pytest.approx(math.pi / 2, rel=1e-14)


def test_a_looser_tolerance_asks_for_fewer_values() -> None:
    def calls(**tolerance: float) -> int:
        seen: list[float] = []

        def f(x: float) -> float:
            seen.append(x)
            return math.exp(x) - 5.0

        assert root_between(f, 0.0, 10.0, **tolerance) == pytest.approx(math.log(5.0), abs=1e-3)
        return len(seen)

    assert calls(xtol=1e-3, rtol=1e-3) < calls()


def test_the_same_sign_at_both_ends_is_refused() -> None:
    with pytest.raises(ValueError):
        root_between(lambda x: x * x + 1.0, -1.0, 1.0)
