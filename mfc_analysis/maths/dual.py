"""Dual arrays: a value ``(..., k)`` with its tangent ``(..., k, N)``, for many points along the leading axes.

A law written with these functions gives the right-hand side of a simulation for plain arrays, and the exact Jacobian at every
point for dual arrays. The tangent axis is last, so a chain rule is one batched ``@``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import EllipsisType
from typing import TypeAlias

import numpy as np

from mfc_analysis.maths.arrays import Array


class Dual:
    """A value and its derivatives along N directions; arithmetic follows the product rule."""

    __array_ufunc__ = None  # numpy passes mixed operations to this class
    __slots__ = ("tangent", "value")

    def __init__(self, value: Array, tangent: Array) -> None:
        self.value = value  #: (..., k)
        self.tangent = tangent  #: (..., k, N)

    def __add__(self, other: Vector) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.tangent + other.tangent)
        return Dual(self.value + other, self.tangent)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.tangent)

    def __sub__(self, other: Vector) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.tangent - other.tangent)
        return Dual(self.value - other, self.tangent)

    def __rsub__(self, other: Array | float) -> Dual:
        return Dual(other - self.value, 0.0 - self.tangent)  # without -0

    def __mul__(self, other: Vector) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.tangent * other.value[..., None] + self.value[..., None] * other.tangent)
        factor = np.asarray(other)
        return Dual(self.value * factor, self.tangent * (factor[..., None] if factor.ndim else factor))

    __rmul__ = __mul__

    def __getitem__(self, part: slice | tuple[EllipsisType, slice]) -> Dual:
        """A slice of the last (component) axis: [a:b], or [..., a:b], which plain arrays take as well."""
        part = part[1] if isinstance(part, tuple) else part
        return Dual(self.value[..., part], self.tangent[..., part, :])


class Seed(Dual):
    """Independent variables: component i is the direction ``start`` + i of ``width``. ``chain`` multiplies nothing by their tangent."""

    __slots__ = ("start",)

    def __init__(self, value: Array, start: int, width: int, tangent: Array | None = None) -> None:
        if tangent is None:
            tangent = np.zeros((*value.shape, width))
            k = np.arange(value.shape[-1])
            tangent[..., k, start + k] = 1.0
        self.value, self.tangent, self.start = value, tangent, start

    def __getitem__(self, part: slice | tuple[EllipsisType, slice]) -> Dual:
        """Contiguous components are independent variables too."""
        part = part[1] if isinstance(part, tuple) else part
        first, _, stride = part.indices(self.value.shape[-1])
        if stride != 1:
            return super().__getitem__(part)
        return Seed(self.value[..., part], self.start + first, self.tangent.shape[-1], self.tangent[..., part, :])


Vector: TypeAlias = Array | float | Dual


def value(x: Vector) -> Array:
    """The value of a plain or dual array."""
    return x.value if isinstance(x, Dual) else np.asarray(x)


def chain(out: Array, *partials: tuple[Callable[[], Array], Vector]) -> Array | Dual:
    """The chain rule: ``out`` unchanged if every argument is plain, otherwise with tangent sum of partial @ tangent.

    Each partial is a function without arguments, so that it is not computed where its argument is plain.
    """
    tangent: Array | None = None
    seeds: list[tuple[Callable[[], Array], Seed]] = []
    for partial, argument in partials:
        if isinstance(argument, Seed):
            seeds.append((partial, argument))
        elif isinstance(argument, Dual):
            part = product(partial(), argument.tangent)
            tangent = part if tangent is None else tangent + part
    for partial, seed in seeds:
        if tangent is None:
            tangent = np.zeros((*out.shape, seed.tangent.shape[-1]))
        tangent[..., seed.start : seed.start + seed.value.shape[-1]] += partial()
    return out if tangent is None else Dual(out, tangent)


def matvec(matrix: Array, x: Vector) -> Array | Dual:
    """A constant matrix (..., j, k) times a vector (..., k)."""
    if isinstance(x, Dual):
        return Dual(times(matrix, x.value), product(matrix, x.tangent))
    return times(matrix, np.asarray(x))


def product(matrix: Array, other: Array) -> Array:
    """matrix @ other: of two small matrices numpy's ``dot`` takes half the time."""
    return matrix.dot(other) if matrix.ndim == other.ndim == 2 else matrix @ other


def times(matrix: Array, x: Array) -> Array:
    """Plain batched matrix (..., j, k) times vector (..., k)."""
    return matrix.dot(x) if matrix.ndim == 2 and x.ndim == 1 else (matrix @ x[..., None])[..., 0]


def spread(x: Array, lead: tuple[int, ...]) -> Array:
    """A vector (..., k) at every point of the leading axes: (*lead, k)."""
    shape = (*lead, x.shape[-1])
    return x if x.shape == shape else np.broadcast_to(x, shape)


def elementwise(x: Vector, f: Callable[[Array], Array], df: Callable[[Array], Array]) -> Array | Dual:
    """A function of each component, with its derivative."""
    if isinstance(x, Dual):
        return Dual(f(x.value), df(x.value)[..., None] * x.tangent)
    return f(np.asarray(x))


def total(x: Vector) -> Array | Dual:
    """The sum over the components, (..., 1)."""
    out = value(x).sum(axis=-1, keepdims=True)
    return Dual(out, x.tangent.sum(axis=-2, keepdims=True)) if isinstance(x, Dual) else out


def concatenate(parts: Sequence[Vector]) -> Array | Dual:
    """Joins along the component axis; plain parts among dual ones get a zero tangent."""
    duals = [p for p in parts if isinstance(p, Dual)]
    if not duals:
        return np.concatenate([np.asarray(p) for p in parts], axis=-1)
    lead, width = duals[0].value.shape[:-1], duals[0].tangent.shape[-1]
    values = [spread(value(p), lead) for p in parts]
    tangents = [p.tangent if isinstance(p, Dual) else np.zeros((*lead, v.shape[-1], width)) for p, v in zip(parts, values, strict=True)]
    return Dual(np.concatenate(values, axis=-1), np.concatenate(tangents, axis=-2))
