"""The array types: which number each of them holds; the memory of large arrays is kept."""

from __future__ import annotations

import platform
import subprocess
import sys
from typing import get_args

import numpy as np
import pytest

from mfc_analysis.maths import arrays, checks


@pytest.mark.parametrize(("name", "made"), [
    ("Array", checks.array("x", [1, 2])), ("Complex", np.linalg.eigvals(np.array([[0.0, 1.0], [-1.0, 0.0]]))), ("Bools", np.isnan(np.ones(2))),
    ("Ints", np.flatnonzero(np.ones(2))),
])  # fmt: skip
def test_each_name_stands_for_what_numpy_makes_of_such_values(name: str, made: np.ndarray) -> None:
    held = get_args(getattr(arrays, name))[-1]  # a dtype of the number; from numpy 2.5 on the number
    (number,) = get_args(held) or (held,)
    assert np.dtype(number) == made.dtype


PAGES = """
import resource
import numpy as np
{first}

def batch():
    parts = [np.ones(500_000) for _ in range(10)]  # 4 MB each, 10240 pages in all

batch()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
batch()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc hands freed memory back so soon")
def test_the_pages_of_freed_arrays_are_used_again() -> None:
    alone, ours = (
        int(subprocess.run([sys.executable, "-c", PAGES.format(first=first)], capture_output=True, text=True, check=True).stdout)
        for first in ("", "import mfc_analysis.maths.arrays")
    )
    assert ours < max(100, 0.1 * alone)  # alone few pages where the system gives huge ones
