"""Every example runs, prints an answer with a unit, and warns of nothing."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
UNIT = re.compile(r"\d\s?(?:N|Nm|N/m|kg|Hz|deg|ms|mm|mrad|rad|rad/s|1/s|dB|s|m)\b")

#: what each of them has to have found, told by its words
FOUND = {
    "which_gains.py": "bandwidth 50.27 rad/s (8 Hz)",
    "why_it_bounces_on_steel.py": "lag 2 ms: stable up to 26000 N/m\nclosed form: 26000 N/m",
    "what_a_payload_costs.py": "largest stable payload",
    "how_slow_may_the_bus_be.py": "smallest stable sample rate",
    "what_the_misprint_costs.py": "9.10 h at (q_d, v_d)            printed",
    "press_and_slide.py": "stable at 9 of 9 times",
}


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.name)
def test_an_example_runs_and_prints_its_answer_with_units(script: Path, tmp_path: Path) -> None:
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "PYTHONUTF8": "1", "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", str(script)],
        cwd=tmp_path, env={**os.environ, **one_thread}, capture_output=True, text=True, encoding="utf-8", timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert UNIT.search(done.stdout), done.stdout
    assert FOUND[script.name] in done.stdout
    assert not list(tmp_path.iterdir())  # nothing is written


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_a_page_that_states_its_question(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith('"""') and "?" in text.splitlines()[0]
    assert len(text.splitlines()) <= 60


def test_every_example_is_in_the_guide() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert {path.name for path in EXAMPLES} == set(FOUND) == set(re.findall(r"\]\(\.\./examples/(\w+\.py)\)", page))
    assert {path.name for path in NOTEBOOKS} == set(re.findall(r"\]\(\.\./examples/(\w+\.ipynb)\)", page))


@pytest.mark.parametrize("book", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_kept_without_outputs(book: Path) -> None:
    """The guide runs it, and its pictures are looked for there."""
    assert not any(cell.get("outputs") for cell in json.loads(book.read_text(encoding="utf-8"))["cells"])
