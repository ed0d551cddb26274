"""All loops at a glance: a bar for each margin in units of its limit, the values as text, the mark of each loop."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_hex

from mfc_analysis.plots.overview import COLOURS, LONGEST, overview, shortened
from tests.plots.overlaps import texts_on_texts

LOOPS = ("9.2 velocity P, single joint", "9.10 computed torque with a lag and a very long name, UR5 + 2 kg", "open")
RATIO = np.array([[2.0, 0.5], [np.inf, 1.5], [np.nan, 9.0]])
WORDS = (("90.0", "1.00"), ("∞", "1.33"), ("–", "0.222"))


def made():
    return overview(LOOPS, ("phase margin [°]", "sensitivity peak"), RATIO, WORDS, ("PASS", "WATCH", "DEMO"))


def test_a_bar_is_the_value_over_its_limit_and_ends_at_the_edge() -> None:
    _, phase, peak = made().axes
    assert [bar.get_width() for bar in phase.patches] == [2.0, LONGEST, 0.0]
    assert [bar.get_width() for bar in peak.patches] == [0.5, 1.5, LONGEST]
    colours = [to_hex(bar.get_facecolor()) for bar in peak.patches]
    assert colours == [COLOURS["FAIL"], COLOURS["PASS"], COLOURS["DEMO"]]
    assert [line.get_xdata()[0] for line in phase.get_lines()] == [1.0]


def test_values_marks_and_names_are_words(monkeypatch: pytest.MonkeyPatch) -> None:
    figure = made()
    said = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert {"90.0", "∞", "–", "PASS", "WATCH", "DEMO", LOOPS[0], shortened(LOOPS[1])} <= set(said)
    assert shortened(LOOPS[1]).endswith("…") and shortened("open") == "open"
    assert not texts_on_texts(figure, monkeypatch)


def test_a_name_that_fits_its_column_is_not_cut() -> None:
    name = "9.11 inverse dynamics + PD, single joint"
    assert shortened(name) == name
    assert shortened("i" * 60) == "i" * 60 and len(shortened("W" * 60)) < 30
