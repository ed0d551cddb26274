r"""Matrix exponentials of many matrices at once: scaling and squaring with diagonal Pade approximants.

The degree is chosen for the whole batch by its largest norm, the scaling for each matrix by its own.

Source: Higham, "The scaling and squaring method for the matrix exponential revisited", SIAM J. Matrix Anal. Appl. 26 (2005),
1179-1193: coefficients and the norms theta_m below which degree m is exact to double precision.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.errors import BadArgument

Array = NDArray[np.float64]

_THETA = {3: 1.495585217958292e-2, 5: 2.539398330063230e-1, 7: 9.504178996162932e-1, 9: 2.097847961257068, 13: 5.371920351148152}


def expm(A: Array) -> Array:
    """exp(A) for each matrix of (..., n, n), real or complex. Raises ``BadArgument`` for other shapes and for entries that are not finite."""
    A = np.asarray(A)
    if A.ndim < 2 or A.shape[-1] != A.shape[-2]:
        raise BadArgument("A", f"shape {A.shape}", "square matrices of shape (..., n, n)")
    if not np.isfinite(A).all():
        raise BadArgument("A", A, "finite matrices")
    if A.size == 0:
        return A.copy()
    batch = A.reshape(-1, *A.shape[-2:])
    norm = np.abs(batch).sum(axis=-2).max(axis=-1)
    degree = next((m for m, theta in _THETA.items() if norm.max() <= theta), 13)
    squarings = np.zeros(norm.size, int)
    if norm.max() > _THETA[13]:
        squarings = np.maximum(0, np.ceil(np.log2(np.maximum(norm, 1e-300) / _THETA[13]))).astype(int)
        batch = batch * 0.5 ** squarings[:, None, None]
    X = _pade(batch, degree)
    for k in range(int(squarings.max())):
        more = squarings > k
        if more.all():
            X = X @ X
        else:
            X[more] = X[more] @ X[more]
    return np.asarray(X.reshape(A.shape))


def expm_integral(A: Array, B: Array, h: float | Array) -> tuple[Array, Array]:
    """exp(A h) and its integral applied to B, int_0^h exp(A s) ds B: the exact step under a held input.

    A: (..., n, n), B: (..., n, k), h: scalar or (...) [s]. Returns (..., n, n), (..., n, k).
    """
    n, k = B.shape[-2:]
    big = np.zeros((*A.shape[:-2], n + k, n + k))
    step = np.asarray(h, float)[..., None, None]
    big[..., :n, :n], big[..., :n, n:] = A * step, B * step
    E = expm(big)
    return E[..., :n, :n], E[..., :n, n:]


def _pade(A: Array, degree: int) -> Array:
    """The diagonal Pade approximant of this degree for (k, n, n)."""
    b = [math.factorial(2 * degree - j) / (math.factorial(degree - j) * math.factorial(j)) for j in range(degree + 1)]
    b = [x / b[-1] for x in b]
    eye = np.eye(A.shape[-1])
    A2 = A @ A
    if degree == 13:
        A4 = A2 @ A2
        A6 = A4 @ A2
        odd = A6 @ (b[13] * A6 + b[11] * A4 + b[9] * A2) + b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * eye
        even = A6 @ (b[12] * A6 + b[10] * A4 + b[8] * A2) + b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * eye
    else:
        odd, even, power = b[1] * eye + b[3] * A2, b[0] * eye + b[2] * A2, A2
        for j in range(4, degree, 2):
            power = power @ A2
            odd, even = odd + b[j + 1] * power, even + b[j] * power
    U = A @ odd
    return np.asarray(np.linalg.solve(even - U, even + U), A.dtype)
