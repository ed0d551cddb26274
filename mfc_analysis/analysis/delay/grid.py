"""Rows of increasing values, one for each point, that need different numbers of values between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.maths.arrays import Array, Ints


def between(w: Array, step: Array) -> Array:
    """(m, q) values that divide the steps of the increasing rows w (m, k) into equal ones of at most ``step`` (m,); some are repeated."""
    parts = np.maximum(np.ceil(np.diff(w, axis=1) / step[:, None] * (1 - 1e-9)), 1).astype(np.int64)
    row, k = np.nonzero(parts > 1)
    count = parts[row, k] - 1
    which = np.repeat(np.arange(row.size), count)
    part = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count) + 1
    a, b = w[row, k][which], w[row, k + 1][which]
    more, column = room(row[which], w[:, -1:])
    more[row[which], column] = a + (b - a) * part / parts[row, k][which]
    return np.asarray(more)


def room(row: Ints, filler: NDArray[Any]) -> tuple[NDArray[Any], Ints]:
    """Room for values of the rows ``row`` (q,), in increasing order: ``filler`` (m, ..., 1) repeated, and the column of each value."""
    count = np.bincount(row, minlength=len(filler))
    column = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(filler, int(count.max(initial=0)), axis=-1), np.asarray(column, np.int64)
