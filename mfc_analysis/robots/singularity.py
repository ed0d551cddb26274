"""Distance of a tool Jacobian from singularity: the condition numbers above which the library warns and raises."""

from __future__ import annotations

import warnings

import numpy as np

from mfc_analysis.errors import MfcWarning, NearSingular
from mfc_analysis.maths.arrays import Array

WARN_CONDITION, REFUSE_CONDITION = 1e4, 1e6


def check_regular(tool: str, J: Array) -> None:
    """Warns (``MfcWarning``) where a tool Jacobian (..., 6, n) has a condition number above 1e4; raises ``NearSingular`` above 1e6 or for n < 6."""
    if not J.size:
        return
    if J.shape[-1] < 6:
        raise NearSingular(tool, 0.0, np.inf)
    found = nearest_singular(tool, np.asarray(np.linalg.svd(J, compute_uv=False), float))
    if found.condition > REFUSE_CONDITION:
        raise found
    if found.condition > WARN_CONDITION:
        metrics = f"smallest singular value {found.sigma_min:.3g}, condition number {found.condition:.3g}"
        warnings.warn(f"the Jacobian of frame {tool!r} is close to singular: {metrics}", MfcWarning, stacklevel=3)


def nearest_singular(tool: str, sigma: Array) -> NearSingular:
    """The configuration with the largest condition number, from singular values (..., k), largest first, as a NearSingular error."""
    low, high = np.ravel(sigma[..., -1]), np.ravel(sigma[..., 0])
    condition = np.divide(high, low, out=np.full_like(high, np.inf), where=low > 0)
    worst = int(np.argmax(condition))
    return NearSingular(tool, float(low[worst]), float(condition[worst]), index=worst)
