"""Many figures: two processes agree with one, and are not started in vain."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
import warnings
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from mfc_analysis import plots
from mfc_analysis.errors import MfcWarning
from mfc_analysis.plots import batch, figure as sheet
from mfc_analysis.plots.batch import MANY, drawn, in_two_processes, second_process
from tests.plots import kinds

KINDS = kinds.every_kind()
ROOT = Path(__file__).resolve().parents[2]
two_cores = pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) < 2, reason="one core")


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


def test_a_few_figures_start_no_process(monkeypatch):
    monkeypatch.setattr(batch, "Popen", None)
    assert len(drawn([KINDS["disk"]] * MANY)) == MANY


# --- the second process ------------------------------------------------------------------------------------------------------


def where(seconds: float = 0.2) -> int:
    time.sleep(seconds)
    return os.getpid()


def square(x: float) -> float:
    warnings.warn(f"squared {x}", MfcWarning, stacklevel=1)
    return x * x


def dies(x: int) -> int:
    if parent_process() != os.getpid():
        os._exit(3)
    return x


def parent_process() -> int:
    return int(os.environ["MFC_TEST_PARENT"])


@two_cores
def test_a_second_process_takes_its_share_and_is_gone_afterwards():
    numbers = set(in_two_processes([where] * 30))
    assert os.getpid() in numbers and len(numbers) == 2
    assert all(gone(number) for number in numbers - {os.getpid()})


def test_results_come_in_order_and_warnings_with_them():
    with pytest.warns(MfcWarning) as said:
        assert list(in_two_processes([partial(square, k) for k in range(20)])) == [k * k for k in range(20)]
    ours = [str(one.message) for one in said if issubclass(one.category, MfcWarning)]  # matplotlib 3.10 uses old names of pyparsing
    assert sorted(ours) == sorted(f"squared {k}" for k in range(20))


@two_cores
def test_tasks_are_done_here_where_the_second_process_is_lost(monkeypatch):
    monkeypatch.setenv("MFC_TEST_PARENT", str(os.getpid()))
    assert list(in_two_processes([where, *(partial(dies, k) for k in range(10))]))[1:] == list(range(10))


@pytest.mark.parametrize("broken", [{"Popen": OSError}, {"sys.executable": ""}], ids=str)
def test_tasks_are_done_here_where_no_process_can_be_started(monkeypatch, broken):
    def refuses(*_, **__):
        raise OSError("no more processes")

    if "Popen" in broken:
        monkeypatch.setattr(batch, "Popen", refuses)
    else:
        monkeypatch.setattr(sys, "executable", "")
    assert set(in_two_processes([partial(where, 0.0)] * 3)) == {os.getpid()}


@two_cores
def test_one_second_process_does_its_share_of_all_that_is_done_within():
    with second_process():
        numbers = [set(in_two_processes(tasks)) - {os.getpid()} for tasks in ([where] * 30, [partial(where, 0.05)] * 10, [partial(where, 0.05)] * 10)]
        assert len(numbers[0]) == 1 and numbers[1:] == numbers[:1] * 2
        with second_process():
            assert set(in_two_processes([partial(where, 0.05)] * 10)) - {os.getpid()} == numbers[0]
        assert not gone(*numbers[0])
    assert gone(*numbers[0])


@two_cores
def test_a_shared_second_process_that_is_lost_or_left_with_a_task_is_done_without(monkeypatch):
    monkeypatch.setenv("MFC_TEST_PARENT", str(os.getpid()))
    for tasks, seen in (([where, *(partial(dies, k) for k in range(10))], 11), ([where] * 20, 1)):
        with second_process():
            found = in_two_processes(tasks)
            for _ in range(seen):
                next(found)
            found.close()
            assert [one() for one in in_two_processes([partial(partial, int, str(k)) for k in range(20)])] == list(range(20))


def test_an_unfinished_run_leaves_no_process():
    found = in_two_processes([where] * 20)
    next(found)
    found.close()
    assert not any("(others)" in thread.name for thread in threading.enumerate())


ASKS = """import os, sys; from mfc_analysis.plots.batch import in_two_processes; from tests.plots.test_batch import where
for number in in_two_processes([where] * 30 + [__import__("functools").partial(where, 20)] * 2):
    print(number, flush=True)
"""


@two_cores
def test_no_module_of_the_current_folder_is_run(tmp_path):
    for name in ("matplotlib", "numpy", "pickle", "mfc_analysis"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    code = ASKS.replace(' + [__import__("functools").partial(where, 20)] * 2', "")
    run = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert run.returncode == 0 and len(set(run.stdout.split())) == 2, run.stderr
    assert not (tmp_path / "ran").exists()


@two_cores
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_the_second_process_ends_soon_after_the_first_was_killed():
    run = subprocess.Popen([sys.executable, "-c", ASKS], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    numbers = {int(run.stdout.readline()) for _ in range(30)}
    second = (numbers - {run.pid}).pop()
    assert not gone(second)
    run.kill()
    run.communicate()
    assert any(gone(second) or time.sleep(0.1) for _ in range(50))


def gone(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return True
    return "Z" in Path(f"/proc/{number}/stat").read_text().split() if Path("/proc/self/stat").exists() else False
