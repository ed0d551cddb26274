"""Many figures: two processes agree with one, and are not started in vain."""

from __future__ import annotations

import subprocess
import sys
import threading

import matplotlib
import numpy as np
import pytest

from mfc_analysis import plots
from mfc_analysis.plots import figure as sheet
from mfc_analysis.plots.batch import MANY, drawn
from tests.plots import kinds

KINDS = kinds.every_kind()


def test_two_processes_draw_what_one_draws_and_in_order():
    recipes = [*KINDS.values(), lambda: plots.poles(np.array([-1.0]))]
    assert len(recipes) > MANY
    assert drawn(recipes) == sheet.svgs(recipes)


def test_axes_drawn_already_come_out_the_same():
    def axes():
        with matplotlib.rc_context(sheet.settings()):
            return [KINDS["bode"](), KINDS["disk"]()] * (MANY // 2 + 1)

    assert drawn(axes()) == sheet.svgs(axes())


def test_a_users_settings_do_not_reach_the_other_processes():
    recipes = [KINDS["bode"]] * (MANY + 1)
    before = drawn(recipes)
    with matplotlib.rc_context({"font.size": 30, "svg.fonttype": "path"}):
        assert drawn(recipes) == before


@pytest.mark.parametrize("count", [0, 3, MANY + 4])
def test_progress_counts_every_figure_once(count):
    counts = []
    assert len(drawn([KINDS["disk"]] * count, progress=counts.append)) == count
    assert sum(counts) == count


def test_a_recipe_that_cannot_be_sent_is_drawn_here():
    lock, counts = threading.Lock(), []

    def bound_to_this_process():
        with lock:
            return KINDS["poles"]()

    recipes = [KINDS["disk"]] * MANY + [bound_to_this_process, KINDS["bode"]]
    assert drawn(recipes, progress=counts.append) == sheet.svgs(recipes)
    assert sum(counts) == len(recipes)


def test_what_goes_wrong_in_a_recipe_is_raised_here():
    def wrong():
        raise ValueError("no such figure")

    for count in (1, MANY):
        with pytest.raises(ValueError, match="no such figure"):
            drawn([KINDS["disk"]] * count + [wrong])


def test_a_few_figures_start_no_process():
    code = f"""import sys; from tests.plots import kinds; from mfc_analysis.plots.batch import drawn
drawn([kinds.every_kind()['disk']] * {MANY}); print('joblib' in sys.modules)"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
