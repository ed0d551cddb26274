"""Distance of a tool Jacobian from singularity: the condition numbers above which the library warns and raises."""

from __future__ import annotations

import numpy as np

from mfc_analysis.errors import NearSingular
from mfc_analysis.maths.arrays import Array

WARN_CONDITION, REFUSE_CONDITION = 1e4, 1e6


def nearest_singular(tool: str, sigma: Array) -> NearSingular:
    """The configuration with the largest condition number, from singular values (..., k), largest first, as a NearSingular error."""
    low, high = np.ravel(sigma[..., -1]), np.ravel(sigma[..., 0])
    condition = np.divide(high, low, out=np.full_like(high, np.inf), where=low > 0)
    worst = int(np.argmax(condition))
    return NearSingular(tool, float(low[worst]), float(condition[worst]), index=worst)
