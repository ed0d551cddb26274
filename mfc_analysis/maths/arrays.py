"""The array types of the package, and how their memory is kept.

glibc hands freed memory back to the system above twice the largest block freed so far, at most 64 MB. Every array of a batch then
pays for its pages anew: half the time of A, B, C, D at 1000 points. So the largest block that counts is freed once, untouched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


LARGEST_KEPT = 32_000_000  #: [bytes] just below the largest block that glibc considers

np.empty(LARGEST_KEPT, np.uint8)  # freed at once


def on_axis(w: Array) -> Complex:
    """s = jw of the frequencies w."""
    return np.asarray(1j * w, np.complex128)
