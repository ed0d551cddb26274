"""How near a tool Jacobian is to singular: from which condition number on one is warned, and from which it is refused."""

from __future__ import annotations

import numpy as np

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.arrays import Array

WARN_CONDITION, REFUSE_CONDITION = 1e4, 1e6


def nearest_singular(tool: str, sigma: Array) -> NearSingular:
    """The point whose Jacobian has the largest condition number, of singular values (..., k), largest first: as the error that it may be."""
    low, high = np.ravel(sigma[..., -1]), np.ravel(sigma[..., 0])
    condition = np.divide(high, low, out=np.full_like(high, np.inf), where=low > 0)
    worst = int(np.argmax(condition))
    return NearSingular(tool, float(low[worst]), float(condition[worst]), index=worst)
