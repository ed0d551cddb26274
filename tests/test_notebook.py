"""Results in a notebook."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.notebook import table
from tests.test_pickle import results

LOOP = mfc.ClosedLoop(mfc.robots.planar_2r(), mfc.laws.ComputedTorque(100, 50, 20), mfc.trajectories.Hold([0.3, 0.4]))
LIN = LOOP.linearize(np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (LIN, "damping"),
        (LIN.margins(), "joint2"),
        (mfc.Requirements(phase_deg=30).check(LOOP, [0.0]), "phase margin"),
        (LOOP.simulate(0.2, initial_error=0.1), "torque"),
        (mfc.gains.pid(bandwidth=6.0, damping=1.0), "kp"),
    ],
    ids=["linearization", "margins", "verdict", "simulation", "gains"],
)
def test_a_result_shows_itself_as_well_formed_html(result, said):
    html = result._repr_html_()
    ElementTree.fromstring(f"<div>{html}</div>")
    assert said in html


def test_a_table_escapes_every_text():
    html = table("<a>", ("<b>",), [("<c>", "<d>")], ["<e>"])
    assert not any(f"<{tag}>" in html for tag in "abcde")
    assert all(f"&lt;{tag}&gt;" in html for tag in "abcde")


@pytest.mark.parametrize("delay", [None, 0.01])
def test_a_loop_with_dead_time_shows_its_roots_and_not_the_poles_without_it(delay):
    lin = mfc.ClosedLoop(LOOP.robot, LOOP.law, LOOP.ref, hardware=mfc.Hardware(delay=delay)).linearize()
    page = lin._repr_html_()
    late = delay is not None
    assert ("rightmost roots, dead time included" in page) is ("without dead time" in page) is late
    for s, shown in ((lin.poles()[0, 0], not late), (lin.delay_roots(1)[0, 0], True)):
        assert (f"{complex(s):.5g}" in page) is shown


def test_every_result_has_html_and_none_prints_its_fields() -> None:
    """Those that survive a trip to another process are all the results that there are."""
    for name, result in {**results(), "pole table": LIN.pole_table(), "root table": LIN.root_table(), "loop": LOOP}.items():
        text = repr(result)
        assert len(text) < 2500 and "array(" not in text, name
        if name not in ("pole", "requirements"):
            assert not text.startswith(f"{type(result).__name__}("), name
            ElementTree.fromstring(f"<div>{result._repr_html_()}</div>")


def test_a_table_of_poles_is_a_tuple_that_prints_a_row_for_each() -> None:
    found = LIN.pole_table()
    assert isinstance(found, tuple) and len(str(found).splitlines()) == len(found) + 1 == found._repr_html_().count("<tr>")
    assert "ComputedTorque" in LOOP._repr_html_() and repr(LOOP) == str(LOOP)
