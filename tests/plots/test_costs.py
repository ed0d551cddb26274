"""Bars of costs: their lengths, what is written where nothing can be drawn, and the two bars of all together."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis import plots
from tests.plots.drawn import words


def test_each_cost_has_its_bar_and_the_sum_stands_beside_the_joint_cost():
    ax = plots.costs(("lag", "delay"), (2.0, 3.0), (1.5, np.nan), 4.0, xlabel="cost [deg]")
    assert [bar.get_width() for bar in ax.patches] == pytest.approx([2.0, 3.0, 1.5, 0.0, 5.0, 4.0])
    assert words(ax) == ["2", "3", "1.5", "not defined", "5", "4"]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["lag", "delay", "sum of those alone", "all together"]


def test_an_infinite_cost_is_written():
    assert words(plots.costs(("lag",), (np.inf,), (-np.inf,), np.inf, xlabel="cost [dB]")) == [
        "no limit left",
        "no limit",
        "no limit left",
        "no limit left",
    ]
