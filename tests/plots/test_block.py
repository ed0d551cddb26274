"""The loop as boxes: one for each of the chain, its points named, the one in use filled."""

from __future__ import annotations

import pytest
from matplotlib.patches import Rectangle

from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import block, figure as sheet
from tests.plots.drawn import words

CHAIN = (("law", "command"), ("inverse\ndynamics", ""), ("UR5", "torque"))


def boxes(ax) -> list[Rectangle]:
    return sorted((x for x in ax.patches if isinstance(x, Rectangle)), key=lambda box: box.get_x())


def points(ax) -> dict[str, bool]:
    """Analysis points and whether they are filled."""
    circles = [x for x in ax.get_lines() if x.get_marker() == "o" and x.get_markersize() < 10]
    names = [name for name in words(ax) if name in ("command", "torque", "position")]
    return {name: circle.get_markerfacecolor() == sheet.BAD for name, circle in zip(names, circles, strict=True)}


@pytest.mark.parametrize("count", [1, 6])
def test_there_is_a_box_for_each_of_the_chain_and_they_do_not_overlap(count):
    found = boxes(block((("a", ""),) * count))
    assert len(found) == count
    edges = [edge for box in found for edge in (box.get_x(), box.get_x() + box.get_width())]
    assert edges == sorted(edges) and edges[0] > 0 and edges[-1] < sheet.SHEETS["block"].size[0]


@pytest.mark.parametrize("count", [0, 7])
def test_no_box_or_too_many_are_refused(count):
    with pytest.raises(BadArgument) as why:
        block((("a", ""),) * count)
    assert (why.value.argument, why.value.got) == ("chain", count)


def test_the_words_of_the_loop_are_all_there():
    said = words(block(CHAIN, reference="q_d", output="q", back="position", inputs=((2, "F_tip"),)))
    assert {"law", "inverse\ndynamics", "UR5", "q_d", "q", "position", "F_tip", "command", "torque", "−"} == set(said)


@pytest.mark.parametrize("at", ["command", "torque", "position", ""])
def test_only_the_point_in_use_is_filled(at):
    assert points(block(CHAIN, back="position", at=at)) == {name: name == at for name in ("command", "torque", "position")}


def test_a_text_too_long_for_its_box_is_cut_with_an_ellipsis():
    long = "a name that no box of six has room for"
    cut = next(word for word in words(block(((long, ""),) * 6)) if word.endswith("…"))
    assert long.startswith(cut[:-1]) and len(cut) < len(long)
    assert long in words(block(((long, ""),)))
