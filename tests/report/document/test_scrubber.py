"""The scrubber's drawings and data."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.report.document.document import Scrubber, Trace
from mfc_analysis.report.document.scrubber import _ticks, moving


def made(m=401, worst=73, bad=()):
    t = np.linspace(0, 8, m)
    poles = np.stack([-3 - np.sin(t) + 0j, -20 + 5j * np.ones(m), -20 - 5j * np.ones(m)], axis=1)
    values = 40 + 10 * np.cos(t)
    values[list(bad)] = np.nan
    return t, poles, values, moving(Scrubber(t, poles, (Trace("PM", "°", values, 30.0),), worst, "caption", "alt 1"))


def test_the_worst_time_is_kept_when_times_are_thinned():
    t, _, values, found = made(worst=173)
    assert len(found.data["say"]) <= 122
    assert f"t = {t[173]:.4g} s" in found.data["say"][found.data["worst"]]
    assert f"PM {values[173]:.1f}°" in found.data["say"][found.data["worst"]]


def test_poles_that_swap_their_order_are_followed():
    t, poles, *_ = made()
    swapped = poles.copy()
    swapped[::2] = swapped[::2, ::-1]
    one, two = (moving(Scrubber(t, p, (), 0, "c", "a")).data for p in (poles, swapped))
    assert np.ptp(np.asarray(two["py"])[:, 1]) == 0 == np.ptp(np.asarray(one["py"])[:, 1])


def test_an_unstable_time_leaves_a_gap_and_says_so():
    *_, found = made(m=101, worst=50, bad=(50,))
    assert found.data["cy"][0][50] is None
    assert "not defined" in found.data["say"][50]


def test_a_larger_margin_stands_higher():
    *_, values, found = made(m=101)
    assert found.data["cy"][0][int(np.argmax(values))] < found.data["cy"][0][int(np.argmin(values))]


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [(0.0, 2.0, [0, 0.5, 1, 1.5, 2]), (0.0, np.pi, [0, 1, 2, 3]), (0.3, 0.47, [0.3, 0.35, 0.4, 0.45]), (1.0, 1.0, [1])],
)
def test_the_times_have_round_labels(low, high, wanted):
    assert_allclose(_ticks(low, high), wanted)


def test_the_heading_stands_alone_and_the_axis_names_its_scale():
    drawn = moving(Scrubber(np.array([0.0, np.pi]), np.full((2, 1), -1.0 + 0j), (), 1, "c", "a", heading="Roots with dead time")).poles
    assert ">Roots with dead time<" in drawn and ">Re s [1/s], symmetric log scales<" in drawn
