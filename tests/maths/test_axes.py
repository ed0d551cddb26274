"""Directions by name and by rows."""

from __future__ import annotations

import numpy as np
import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.axes import parse_axes, selected_rows


def test_a_name_gives_the_directions_in_its_order() -> None:
    assert parse_axes("xyz") == (0, 1, 2) and parse_axes("rzx") == (5, 0)
    rows, names = selected_rows("xyzrz")
    assert np.array_equal(rows, np.eye(6)[[0, 1, 2, 5]]) and names == ("vx", "vy", "vz", "wz")


def test_rows_are_kept_and_those_along_no_axis_are_numbered() -> None:
    given = [[0.6, 0.8, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 0, -1]]
    rows, names = selected_rows(given)
    assert np.array_equal(rows, given) and names == ("row1", "vz", "row3") and not rows.flags.writeable


@pytest.mark.parametrize("given", [
    "", "xx", "xa", "rz rx", 3, np.zeros((0, 6)), np.zeros((1, 6)), [[1, 1, 0, 0, 0, 0]], np.eye(5), np.vstack([np.eye(6), np.eye(6)[:1]]),
    [[1, 0, 0, 0, 0, 0], [0.6, 0.8, 0, 0, 0, 0]], [[np.nan, 0, 0, 0, 0, 0]],
], ids=str)  # fmt: skip
def test_anything_else_is_refused_by_what_it_takes(given: object) -> None:
    with pytest.raises(BadArgument, match="orthonormal rows") as why:
        selected_rows(given)
    assert why.value.argument == "axes"
