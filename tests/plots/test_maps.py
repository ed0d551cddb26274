"""Stability maps: the boundary where the growth is zero, regions named, simulated points marked."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from mfc_analysis import plots
from mfc_analysis.errors import BadArgument
from mfc_analysis.plots import figure as sheet
from tests.plots import kinds
from tests.plots.drawn import legend, marks, words

X, Y = np.linspace(0, 2, 41), np.linspace(0, 3, 31)


def drawn(growth: np.ndarray, **more: object):
    return plots.stability_map(X, Y, growth, xlabel="x", ylabel="y", log="", **more)


def slope() -> np.ndarray:
    """Stable on the left of x = 1."""
    return X[None, :] - 1 + 0 * Y[:, None]


def test_a_stability_map_draws_its_boundary_where_the_growth_is_zero():
    x, y = np.linspace(0, 2, 41), np.linspace(0, 2, 41)
    ax = plots.stability_map(x, y, x[None, :] - 1 + 0 * y[:, None], xlabel="x", ylabel="y", log="")
    line = next(c for c in ax.collections if c.get_linewidth()[0] == 1.2).get_paths()[0].vertices
    np.testing.assert_allclose(line[:, 0], 1.0, atol=1e-12)


def test_a_map_is_small_and_names_its_regions():
    text = sheet.svg(partial(plots.stability_map, *kinds._map(), xlabel="k [N/m]", ylabel="g [-]"))
    assert len(text) < 70_000
    assert ">stable<" in text.replace("\n", "") and ">unstable<" in text.replace("\n", "")


@pytest.mark.parametrize(("growth", "said"), [(slope() - 5, ["stable"]), (slope() + 5, ["unstable"]), (slope() * np.nan, ["unstable"])])
def test_a_map_of_one_region_has_one_word_and_no_boundary(growth, said):
    ax = drawn(growth)
    assert words(ax) == said
    assert not [c for c in ax.collections if c.get_linewidth()[0] == 1.2]


def test_the_words_stand_in_their_regions():
    places = {text.get_text(): text.xy for text in drawn(slope()).texts}
    assert places["stable"][0] < 0.5 < places["unstable"][0]


def test_what_is_not_known_counts_as_unstable():
    growth = slope() - 5
    growth[:, 20:] = np.nan
    assert words(drawn(growth)) == ["stable", "unstable"]


def test_simulated_points_are_marked_by_what_they_did():
    ax = drawn(slope(), points=((0.5, 1.0, True), (1.5, 2.0, False), (0.2, 0.1, True)))
    assert marks(ax, "o")[0].tolist() == [[0.5, 1.0], [0.2, 0.1]] and marks(ax, "X")[0].tolist() == [[1.5, 2.0]]
    assert legend(ax) == ["run settles", "run diverges"] and legend(drawn(slope())) == []


@pytest.mark.parametrize("log", ["", "x", "y", "xy"])
def test_only_the_axes_asked_for_are_logarithmic(log):
    ax = plots.stability_map(X + 1, Y + 1, slope(), xlabel="x", ylabel="y", log=log)
    assert (ax.get_xscale() == "log", ax.get_yscale() == "log") == ("x" in log, "y" in log)
    assert ax.get_xlim() == (1.0, 3.0) and ax.get_ylim() == (1.0, 4.0)


def test_growth_of_another_shape_is_refused():
    with pytest.raises(BadArgument) as why:
        drawn(slope().T)
    assert why.value.argument == "growth" and why.value.takes == "shape (31, 41)"
