"""Derivatives of the body Jacobian by brackets of its columns: d J_i / d q_j is [J_i, J_j] for j after i on the chain.

Inside, the points are the last axis, in memory too: the other axes are a few long, and numpy takes most of its time between them.
"""

from __future__ import annotations

import numpy as np

from mfc_analysis.maths.arrays import Array, Ints
from mfc_analysis.robots.calls import Calls


def _rows(*halves: int) -> tuple[Ints, Ints]:
    """Rows of halves of a twist (0: linear, 1: angular), from the second and from the third on: their products make cross products."""
    second, third = (np.array([3 * half + (i + turn) % 3 for half in halves for i in range(3)], np.int64) for turn in (1, 2))
    return second, third


BRACKET = _rows(1, 0, 1), _rows(0, 1, 1)  #: of two twists: w x v', v x w' and w x w'
TURNED = _rows(1, 0, 1), _rows(0, 0, 1)  #: of a twist and a wrench: w x f, v x f and w x m


def bracketed(calls: Calls, J: Array, x: Array) -> Array:
    """d(J x)/dq with x held: column j is [sum over i < j of J_i x_i, J_j], (..., 6, n)."""
    lead = np.broadcast_shapes(J.shape[:-2], x.shape[:-1])
    J, x = (_points_last(one, lead) for one in calls.along(J, x[..., None, :]))
    return calls.unordered(_points_first(bracket_columns(_before(J * x), J), lead))


def transposed_derivative(calls: Calls, J: Array, f: Array) -> Array:
    """d(J^T f)/dq with f held: entry (i, j) is [J_i, J_j] . f for j after i, (..., n, n)."""
    (J,) = calls.along(J)
    lead = np.broadcast_shapes(J.shape[:-2], f.shape[:-1])
    both = _crosses(_points_last(J, lead), _points_last(f[..., None], lead), *TURNED)
    G = np.concatenate([both[:3], both[3:6] + both[6:]])
    out = np.triu(np.swapaxes(J, -1, -2) @ _points_first(G, lead), 1)
    return out if calls.order is None else out[..., calls.back[:, None], calls.back]


def jacobian_dot_derivatives(calls: Calls, J: Array, K: Array, v: Array) -> tuple[Array, Array]:
    """d(J' v)/dq and d(J' v)/dv, (..., 6, n) each."""
    lead = np.broadcast_shapes(J.shape[:-2], v.shape[:-1])
    J, K, v = (_points_last(one, lead) for one in calls.along(J, K, v[..., None, :]))
    Jv, Kv = J * v, K * v
    after = _before(Jv[:, ::-1])[:, ::-1]  # twist of the joints after joint k; before it, their acceleration
    dq = bracket_columns(_before(Kv), J) + bracket_columns(K, Jv + after)
    dv = K + bracket_columns(J, after)
    return calls.unordered(_points_first(dq, lead)), calls.unordered(_points_first(dv, lead))


def bracket_columns(V: Array, W: Array) -> Array:
    """[V_j, W_j] for the columns of (6, n, m) twists."""
    both = _crosses(V, W, *BRACKET)
    return np.concatenate([both[:3] + both[3:6], both[6:]])


def _crosses(V: Array, W: Array, v: tuple[Ints, Ints], w: tuple[Ints, Ints]) -> Array:
    """(9, n, m) three cross products of halves of the columns of V (6, n, m) and of W; n may be 1 in one of them."""
    return np.asarray(V[v[0]] * W[w[1]] - V[v[1]] * W[w[0]])


def _before(parts: Array) -> Array:
    """(6, n, m) sums of the columns before each; numpy's cumulative sum takes several times as long."""
    out = np.zeros(parts.shape)
    for k in range(1, parts.shape[1]):
        np.add(out[:, k - 1], parts[:, k - 1], out=out[:, k])
    return out


def _points_last(M: Array, lead: tuple[int, ...]) -> Array:
    """(r, n, m) of matrices (..., r, n) at the points ``lead``."""
    if not lead:
        return M[..., None]
    if M.shape[:-2] != lead:
        M = np.broadcast_to(M, (*lead, *M.shape[-2:]))
    return np.ascontiguousarray(np.moveaxis(M.reshape(-1, *M.shape[-2:]), 0, -1))


def _points_first(M: Array, lead: tuple[int, ...]) -> Array:
    """(..., r, n) of (r, n, m)."""
    return np.ascontiguousarray(np.moveaxis(M, -1, 0)).reshape(*lead, *M.shape[:2])
