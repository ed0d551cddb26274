"""The array types of the package."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def on_axis(w: Array) -> Complex:
    """s = jw of the frequencies w."""
    return np.asarray(1j * w, np.complex128)
