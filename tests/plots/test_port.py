"""What the environment feels: magnitude and phase, and the damping over frequency with what lies below zero."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.plots import admittance, passivity
from tests.plots.drawn import legend, levels, lines, uprights, words

W = np.geomspace(0.1, 1e3, 50)
Y = 1j * W / (300 - 2 * W**2 + 20j * W)


def test_an_admittance_is_drawn_by_increasing_frequency_with_the_angles_within_which_it_is_passive() -> None:
    upper, lower = admittance(W[::-1], [("fz", Y[::-1]), ("mz", 0 * Y)], title="At the tool")
    assert_allclose(upper.get_lines()[0].get_xydata(), np.column_stack([W, np.abs(Y)]))
    assert_allclose(lower.get_lines()[0].get_ydata(), np.degrees(np.angle(Y)))
    assert legend(upper) == ["fz", "mz"] and sorted(levels(lower)) == [-90, 90]
    assert upper.get_yscale() == "log" and upper.get_title(loc="left") == "At the tool"


def test_one_frequency_is_drawn_too() -> None:
    upper, _ = admittance([3.0], [("fz", [1j])])
    assert upper.get_xscale() == "log"


def test_the_damping_has_its_crossings_and_its_finding() -> None:
    ax = passivity(W, 5 - W, crossings=[5.0], said="not passive")
    assert_allclose(lines(ax)[0], np.column_stack([W, 5 - W]))
    assert uprights(ax) == [5.0] and levels(ax) == [0.0] and words(ax) == ["not passive"]
    assert words(passivity([], [], said="unstable")) == ["unstable"]
    assert passivity([1.0, 2.0], [np.inf, -np.inf]).has_data()
