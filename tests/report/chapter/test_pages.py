"""The page of one loop within a chapter: which blocks it has, and whose numbers."""

from __future__ import annotations

import numpy as np
import pytest

import mfc_analysis as mfc
from mfc_analysis.report.chapter.pages import figure_wanted, loop_page
from mfc_analysis.report.document.document import Figure, KeyFacts, Paragraph, Row, Scrubber, Section
from mfc_analysis.report.loops.sections import validated
from tests.report.loops.views import falling, joint, links, mass, open_loop, velocity, view


def figures(section: Section) -> list[str]:
    """The functions that draw the figures of a page, in its order."""
    rows = [b.figures if isinstance(b, Row) else (b,) for b in section.body if isinstance(b, (Row, Figure))]
    return [f.draw.func.__name__ for row in rows for f in row]


def test_a_page_has_the_blocks_that_were_asked_for_and_no_others() -> None:
    bare = loop_page(mass(), frequency=False, compare=False)
    assert [type(b) for b in bare.body] == [KeyFacts] and "validation" not in bare.numbers
    assert figures(loop_page(mass(), compare=False)) == ["bode", "poles"]
    one = loop_page(links((0.0, 1.0, 2.0)), frequency=False, compare=False, path=True, moving=True)
    assert figures(one) == ["margin_history"] and any(isinstance(b, Scrubber) for b in one.body)
    assert figures(loop_page(open_loop(), compare=False)) == ["poles"]  # nothing is fed back: a sentence and the poles


def test_blocks_before_and_after_stand_around_the_figures_and_own_numbers_beside_the_loops() -> None:
    first, last = Paragraph("first"), Paragraph("last")
    page = loop_page(mass(), "a title", compare=False, before=(first,), after=(last,), more={"own": 3}, shown="why", finding="so")
    assert page.body[1] is first and page.body[-1] is last
    assert (page.title, page.finding, page.shown, page.loop, page.key) == ("A title", "so", "why", "the loop", "the loop")
    assert page.numbers["own"] == 3 and np.poly(page.numbers["poles"]) == pytest.approx([1.0, 6.0, 25.0])
    assert loop_page(mass(), compare=False).title == "the loop" and page.sources[0].endswith("9.8")


def test_a_comparison_that_is_exact_is_told_and_another_is_drawn() -> None:
    swinging = view(mfc.ClosedLoop(joint(), mfc.laws.JointPID(10.0, kd=2.0), mfc.trajectories.Hold([0.3])))  # in a plane with gravity
    linear, bent = loop_page(velocity(), frequency=False), loop_page(swinging, frequency=False)
    assert linear.numbers["validation"]["taylor_order"] == np.inf and figures(linear) == []
    assert not figure_wanted(validated(velocity()))
    assert bent.numbers["validation"]["taylor_order"] == pytest.approx(2.0, abs=0.05) and figures(bent) == ["traces"]
    assert figure_wanted(validated(swinging))


def test_checks_and_finding_follow_the_gains() -> None:
    unstable = loop_page(falling(), frequency=False, compare=False)
    assert unstable.badge == "FAIL" and unstable.checks[0].found > 0
    assert loop_page(mass(), frequency=False, compare=False).badge == "PASS"
    assert loop_page(mass(25.0, 6.0), compare=False).finding != loop_page(mass(36.0, 6.0), compare=False).finding
