"""A gain: a scalar, a vector (diagonal) or a matrix, which acts by ``@`` on plain and dual arrays. None is a zero gain."""

from __future__ import annotations

from typing import Self, overload

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.maths.dual import Dual, Vector, matvec


class Gain:
    """A gain ``given`` as a number, a vector or a matrix, with a name for messages.

    ``Gain("ki", None) @ x`` is 0, and ``bool(Gain("ki", None))`` is False.

    In the body of a law it declares a field: ``kp: Gain`` is required, ``ki: Gain = Gain()`` is optional. The field takes a number, a vector,
    a matrix, another gain or None, and holds a gain.

    Raises:
        BadArgument: not finite, or neither a scalar, a vector nor a square matrix.
    """

    __array_ufunc__ = None

    def __init__(self, name: str = "", given: ArrayLike | Gain | None = None, *, required: bool = False) -> None:
        self.name = name
        self.required = required  #: True: the field has no default
        raw = given.array if isinstance(given, Gain) else given
        self.array: Array | None = None if raw is None else checks.array(name, raw)
        if self.array is not None and (self.array.ndim > 2 or (self.array.ndim == 2 and self.array.shape[0] != self.array.shape[1])):
            raise BadArgument(name, f"shape {self.array.shape}", "a scalar, a vector or a square matrix")

        self._factor = None if self.array is None or self.array.ndim == 2 else self.array
        self._inverses: dict[int, Array] = {}

    # --- as a field of a law -------------------------------------------------------------------------------------

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, law: None, owner: type) -> Self: ...
    @overload
    def __get__(self, law: object, owner: type) -> Gain: ...
    def __get__(self, law: object | None, owner: type) -> Gain:
        if law is not None:
            found: Gain = law.__dict__[self.name]
            return found
        if self.required:  # dataclasses read the default from the class
            raise AttributeError(f"{self.name} has no default")
        return self

    def __set__(self, law: object, given: ArrayLike | Gain | None) -> None:
        vars(law)[self.name] = Gain(self.name, given)

    # --- as a value ----------------------------------------------------------------------------------------------

    def __bool__(self) -> bool:
        return self.array is not None

    def __matmul__(self, x: Vector | None) -> Array | Dual | float:
        if x is not None and self._factor is not None:
            return x * self._factor
        return 0.0 if x is None or self.array is None else matvec(self.array, x)

    def check(self, size: int, what: str) -> None:
        """Raises BadArgument unless this gain acts on vectors of ``size`` (``what``: 'joints', 'twist')."""
        if self.array is not None and self.array.ndim and self.array.shape[0] != size:
            takes = f"a scalar, shape ({size},) or ({size}, {size}): one entry for each of the {size} {what}"
            raise BadArgument(self.name, f"shape {self.array.shape}", takes)

    def matrix(self, size: int) -> Array:
        """As a (size, size) matrix; zeros for None."""
        if self.array is None:
            return np.zeros((size, size))
        return self.array if self.array.ndim == 2 else np.diag(np.broadcast_to(self.array, (size,)))

    def inverse(self, size: int) -> Array:
        """(size, size) pseudo-inverse of ``matrix``: 0 for directions on which it does not act."""
        if size not in self._inverses:
            self._inverses[size] = np.asarray(np.linalg.pinv(self.matrix(size)), float)
        return self._inverses[size]

    def diagonal(self, size: int) -> Array:
        """Its diagonal, (size,): the gains of independent joints."""
        return np.diag(self.matrix(size)).copy()

    def __repr__(self) -> str:
        if self.array is None:
            return "None"
        return _text(self.array)


def _text(a: Array) -> str:
    return f"{float(a):g}" if a.ndim == 0 else f"[{', '.join(map(_text, a))}]"
