"""Directions by name: "z", "xyrz", or the rows of a selection."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array

AXES = ("x", "y", "z", "rx", "ry", "rz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_TAKES = "directions from x, y, z, rx, ry, rz, each at most once, like 'z', 'xyz' or 'xyrz'"


def parse_axes(axes: Any, takes: str = _TAKES) -> tuple[int, ...]:
    """'xyrz' -> (0, 1, 5), in the order given. Raises BadArgument."""
    if not isinstance(axes, str) or not re.fullmatch(r"(r?[xyz])+", axes):
        raise BadArgument("axes", axes, takes)
    index = tuple(AXES.index(a) for a in re.findall(r"r?[xyz]", axes))
    if len(set(index)) < len(index):
        raise BadArgument("axes", axes, takes)
    return index


def selected_rows(axes: Any) -> tuple[Array, tuple[str, ...]]:
    """(k, 6) orthonormal rows of a selection of directions, read-only, and k names: "vx" ... "wz", or "row1" ... of rows along no axis.

    ``axes``: text as in ``parse_axes``, or the rows. Raises BadArgument.
    """
    takes = f"{_TAKES}, or a (k, 6) matrix of orthonormal rows, 1 <= k <= 6, on (linear, angular)"
    rows = np.eye(6)[list(parse_axes(axes, takes))] if isinstance(axes, str) else np.array(checks.array("axes", axes, (None, 6), takes))
    if not 1 <= len(rows) <= 6 or np.abs(rows @ rows.T - np.eye(len(rows))).max() > 1e-9:
        raise BadArgument("axes", axes, takes)
    rows.setflags(write=False)
    along = [np.flatnonzero(row) for row in rows]
    names = tuple(TWIST[i[0]] if len(i) == 1 and row[i[0]] > 0 else f"row{k + 1}" for k, (i, row) in enumerate(zip(along, rows, strict=True)))
    return rows, names
