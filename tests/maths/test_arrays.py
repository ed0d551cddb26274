"""The array types: which number each of them holds."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from mfc_analysis.maths import arrays, checks


@pytest.mark.parametrize(("name", "made"), [
    ("Array", checks.array("x", [1, 2])), ("Complex", np.linalg.eigvals(np.array([[0.0, 1.0], [-1.0, 0.0]]))), ("Bools", np.isnan(np.ones(2))),
    ("Ints", np.flatnonzero(np.ones(2))),
])  # fmt: skip
def test_each_name_stands_for_what_numpy_makes_of_such_values(name: str, made: np.ndarray) -> None:
    (held,) = get_args(get_args(getattr(arrays, name))[-1])
    assert np.dtype(held) == made.dtype
