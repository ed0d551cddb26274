"""The exact step of x' = A x + B u under a held input, by one matrix exponential of the block matrix [[A, B], [0, 0]].

Source: Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23 (1978), 395-404.
"""

from __future__ import annotations

import numpy as np

from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array


def zero_order_hold(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Phi = exp(A h) and Gamma = int_0^h exp(A s) ds B, so that x(h) = Phi x(0) + Gamma u.

    A: (..., n, n), B: (..., n, k), h [s]. Returns (..., n, n), (..., n, k); not finite where an unstable system overflows.
    Raises ``BadArgument`` where A h or B h is not finite.
    """
    from scipy.linalg import expm

    n, k = B.shape[-2:]
    block = np.zeros((*A.shape[:-2], n + k, n + k))
    with np.errstate(over="ignore", invalid="ignore"):
        block[..., :n, :n], block[..., :n, n:] = A * h, B * h
        if not np.isfinite(block).all():
            raise BadArgument("h", h, "a step over which A h and B h are finite")
        E = np.asarray(expm(block), float)
    return E[..., :n, :n], E[..., :n, n:]
