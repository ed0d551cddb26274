"""Rows of values, one for each point, of which each point needs another number."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.maths.arrays import Array, Complex, Ints

ALIKE = 0.4  #: two poles are alike whose decay rates differ by about this fraction, and whose frequencies by about this fraction of them


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


def apart(poles: Complex) -> Complex:
    """(m, q) one of the ``poles`` (m, p) [1/s] of each kind: of those that are alike another adds nothing to a grid.

    The first is repeated where a row has fewer; NaN counts as none. Of a pair that is alike the upper one stays, so that a real pole is never below
    the axis by rounding, alone.
    """
    rate, height = np.maximum(np.abs(poles.real), 1e-9 * np.abs(poles)), poles.imag
    with np.errstate(divide="ignore", invalid="ignore"):
        kind = np.round(np.log(rate) / ALIKE) + 1j * np.round(height / rate / ALIKE)
    poles = np.where(kind.imag == 0, poles.real + 1j * np.abs(height), poles)
    order = np.argsort(np.where(np.isnan(kind), np.inf, kind), axis=1)
    sorted_ = np.take_along_axis(kind, order, 1)
    new = ~np.isnan(sorted_)
    new[:, 1:] &= sorted_[:, 1:] != sorted_[:, :-1]
    last = np.argsort(~new, axis=1, kind="stable")[:, : max(int(new.sum(axis=1).max(initial=0)), 1)]
    chosen = np.take_along_axis(np.take_along_axis(poles, order, 1), last, 1)
    return np.asarray(np.where(np.take_along_axis(new, last, 1), chosen, chosen[:, :1]), np.complex128)
