"""Derivatives of the body Jacobian by brackets of its columns: d J_i / d q_j is [J_i, J_j] for j after i on the chain."""

from __future__ import annotations

import numpy as np

from mfc_analysis.maths.arrays import Array
from mfc_analysis.robots.calls import Calls


def bracketed(calls: Calls, J: Array, x: Array) -> Array:
    """d(J x)/dq with x held: column j is [sum over i < j of J_i x_i, J_j], (..., 6, n)."""
    J, x = calls.along(J, x)
    parts = J * x[..., None, :]
    return calls.unordered(bracket_columns(np.cumsum(parts, axis=-1) - parts, J))


def transposed_derivative(calls: Calls, J: Array, f: Array) -> Array:
    """d(J^T f)/dq with f held: entry (i, j) is [J_i, J_j] . f for j after i, (..., n, n)."""
    (J,) = calls.along(J)
    G = np.empty(np.broadcast_shapes(J.shape, (*f.shape, J.shape[-1])))
    fv, fm = f[..., :3, None], f[..., 3:, None]
    v, w = J[..., :3, :], J[..., 3:, :]
    G[..., :3, :] = cross_columns(w, fv)
    G[..., 3:, :] = cross_columns(v, fv) + cross_columns(w, fm)
    out = np.triu(np.swapaxes(J, -1, -2) @ G, 1)
    return out if calls.order is None else out[..., calls.back[:, None], calls.back]


def jacobian_dot_derivatives(calls: Calls, J: Array, K: Array, v: Array) -> tuple[Array, Array]:
    """d(J' v)/dq and d(J' v)/dv, (..., 6, n) each."""
    J, K, v = calls.along(J, K, v)
    Jv, Kv = J * v[..., None, :], K * v[..., None, :]
    before = np.cumsum(Kv, axis=-1) - Kv  # acceleration of the joints before joint k
    after = np.sum(Jv, axis=-1, keepdims=True) - np.cumsum(Jv, axis=-1)  # twist of the joints after joint k
    dq = bracket_columns(before, J) + bracket_columns(K, Jv + after)
    dv = K + bracket_columns(J, after)
    return calls.unordered(dq), calls.unordered(dv)


def cross_columns(a: Array, b: Array) -> Array:
    """Cross products of the columns of (..., 3, n) arrays."""
    ax, ay, az = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    bx, by, bz = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    x = ay * bz - az * by
    out = np.empty((*x.shape[:-1], 3, x.shape[-1]))
    out[..., 0, :], out[..., 1, :], out[..., 2, :] = x, az * bx - ax * bz, ax * by - ay * bx
    return out


def bracket_columns(V: Array, W: Array) -> Array:
    """[V_j, W_j] for the columns of (..., 6, n) twists."""
    v, w, x, y = V[..., :3, :], V[..., 3:, :], W[..., :3, :], W[..., 3:, :]
    return np.concatenate([cross_columns(w, x) + cross_columns(v, y), cross_columns(w, y)], axis=-2)
