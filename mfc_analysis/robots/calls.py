"""Pinocchio's functions at many points, with values in the user's joint order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache, cached_property
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.maths.dual import Vector, spread
from mfc_analysis.robots.build import configuration, places

if TYPE_CHECKING:
    from mfc_analysis.robots.robot import Robot


#: functions that take many points, a column each
MANY: dict[Callable[..., Array], Callable[..., Array]] = {pin.rnea: pin.rneaInParallel, pin.aba: pin.abaInParallel} if pin.WITH_OPENMP else {}


class Calls:
    """Calls of Pinocchio for one robot. Not thread-safe: every call overwrites its Pinocchio Data."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.n = robot, robot.n
        self.model, self.data = robot.model, robot.model.createData()
        self.back = np.asarray(robot.order)  #: x_user = x_pinocchio[back]
        self.order = None if np.array_equal(self.back, np.arange(self.n)) else np.argsort(self.back)
        self.plain = self.order is None and robot.model.nq == robot.model.nv  #: True where Pinocchio takes the user's vectors as they are
        self.zero = np.zeros(self.n)
        self._places = places(robot.model)

    @cached_property
    def _pool(self) -> pin.ModelPool:
        return pin.ModelPool(self.model, 1)

    def configurations(self, q: Array) -> Array:
        """Pinocchio's configurations (m, nq) of joint positions (..., n)."""
        return np.ascontiguousarray(q if self.plain else self._configuration(q)).reshape(-1, self.model.nq)

    def _configuration(self, q: Array) -> Array:
        return configuration(self._places, q if self.order is None else q[..., self.order])

    def each(self, call: Callable[..., Array], q: Array, *more: Array, size: int | None = None) -> Array:
        """A function of (model, data, q, ...) with Pinocchio, at every point: its values (n,), or ``size`` of them that belong to no joint."""
        model, data = self.model, self.data
        if q.ndim == 1 and self.order is None and all(x.ndim == 1 for x in more):
            return np.array(call(model, data, q if self.plain else self._configuration(q), *more))
        lead, columns = self._columns(q, more)
        if many := MANY.get(call):
            out = many(1, self._pool, *(np.asarray(x).T for x in columns)).T.reshape(-1, self.n)  # of one point or one joint it is a vector
        else:
            out = np.empty((math.prod(lead), size or self.n))
            for i, at in enumerate(zip(*columns, strict=False)):
                out[i] = call(model, data, *at)
        return (out if self.order is None or size else out[:, self.back]).reshape(*lead, out.shape[-1])

    def _columns(self, q: Array, more: tuple[Array | None, ...]) -> tuple[tuple[int, ...], list[Iterable[Array]]]:
        """The leading axes of all arguments together, and each of them point by point (None: zeros)."""
        if self.plain and q.ndim == 2 and all(x is not None and x.shape == q.shape for x in more):  # what the rest would come to
            return q.shape[:1], [q, *(x for x in more if x is not None)]
        lead = _lead(q, more)
        columns: list[Iterable[Array]] = [self.configurations(spread(q, lead))]
        for x in more:
            if x is None:
                columns.append(repeat(self.zero))
                continue
            x = spread(x, lead).reshape(-1, self.n)
            columns.append(np.ascontiguousarray(x if self.order is None else x[:, self.order]))
        return lead, columns

    def collect(
        self, call: Callable[..., object], model: pin.Model, data: pin.Data, views: tuple[Array, ...], q: Array, *more: Array | None
    ) -> list[Array]:
        """Calls at every point (None: zeros) and copies Pinocchio's arrays, which each call overwrites, into batches."""
        if q.ndim == 1 and self.plain and all(x is None or x.ndim == 1 for x in more):
            call(model, data, q, *[self.zero if x is None else x for x in more])
            return [view.copy() for view in views]
        lead, columns = self._columns(q, more)
        outs = [np.empty((math.prod(lead), *view.shape)) for view in views]
        pairs = list(zip(outs, views, strict=True))
        for i, at in enumerate(zip(*columns, strict=False)):
            call(model, data, *at)
            for out, view in pairs:
                out[i] = view
        if self.order is not None:
            outs = [out[:, self.back] if out.ndim == 2 else out[:, self.back[:, None], self.back] for out in outs]
        return [out.reshape(*lead, *out.shape[1:]) for out in outs]

    def along(self, J: Array, *more: Array) -> list[Array]:
        """Into chain order, in which the derivative of the Jacobian is made of sums over earlier joints."""
        return [x if self.order is None else x[..., self.order] for x in (J, *more)]

    def unordered(self, columns: Array) -> Array:
        """Columns in chain order, in the user's."""
        return columns if self.order is None else columns[..., self.back]


def _lead(q: Array, more: tuple[Array | None, ...]) -> tuple[int, ...]:
    """The leading axes of vectors (..., n) together."""
    lead = q.shape[:-1]
    if all(x is None or x.ndim == 1 or x.shape[:-1] == lead for x in more):
        return lead
    return np.broadcast_shapes(lead, *(x.shape[:-1] for x in more if x is not None))


def one_point(q: Vector, v: Vector, a: Vector) -> bool:
    """True for plain vectors (n,): those of one point, which Pinocchio takes as they are where the robot is ``plain``."""
    plain = np.ndarray
    return type(q) is plain and type(v) is plain and type(a) is plain and q.ndim == v.ndim == a.ndim == 1


@cache
def _below(n: int) -> tuple[Ints, Ints]:
    """Places of the entries below the diagonal and of those that mirror them, in a matrix (n, n) row by row."""
    i, j = np.tril_indices(n, -1)
    return i * n + j, j * n + i


def symmetric(upper: Array) -> Array:
    """The full symmetric matrices (..., n, n) from the upper triangle that Pinocchio fills."""
    n = upper.shape[-1]
    below, above = _below(n)
    full = np.ascontiguousarray(upper)
    rows = full.reshape(*full.shape[:-2], n * n)  # a view
    rows[..., below] = rows[..., above]
    return full
