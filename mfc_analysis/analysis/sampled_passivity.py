r"""Passivity of a port in continuous time whose controller is sampled: exact, between the samples too.

A force at theta + 2 pi m/h moves the port at theta + 2 pi n/h for all n: the operator D + a b^H, D the plant's admittance at each of these
frequencies, a and b of the rank of the joints. With H = D + D^H > 0, and W = [a b]^H H^-1 [a b] summed over the harmonics, it is passive at
theta if and only if the smallest eigenvalue of [[0, I], [I, 0]] W is at least -1. For one mass with friction on a sampled controller H(z)
this is Colgate & Schenkel's condition b > h/2 Re{(1 - e^{-jwh}) H(e^{jwh})} / (1 - cos wh).

A plant without friction is never passive then, nor is one whose rate is sampled without a filter before the sampler: the sum has no limit. With
the rate from differences of the encoder (``Hardware.derivative_rule``) a wall K, B needs b > K h/2 + abs(B).

Sources: Fardad & Bamieh, IEEE Trans. Automatic Control 54 (2009) 611-614; Colgate & Schenkel, J. Robotic Systems 14 (1997) 37-47.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mfc_analysis.analysis.port import PortSystem, controller, under_hold
from mfc_analysis.maths.arrays import Array, Complex, on_axis

HARMONICS = (8, 16, 32)  #: of the partial sums, from which the limit follows: the rest falls with 1/M and 1/M^3, M = N + 1/2
GROWS = 0.8  #: ratio of their differences above which the sum has no limit; with one it is 0.5
ANGLES = 24  #: theta of the first look: as many on a logarithmic scale, twice as many even ones
VALLEYS = 4  #: minima over theta that are refined
ROUNDING = 1e-7  #: of the smallest value that counts as zero
THIN = 1e-13  #: relative: friction below this is none


def least(port: PortSystem) -> float:
    """Smallest 1 + eigenvalue over theta at the one point of a sampled port: negative where it is not passive; -inf: by no finite amount."""
    h = port.opened.dt
    theta = np.union1d(np.geomspace(1e-3, np.pi, ANGLES), np.linspace(0, np.pi, 2 * ANGLES + 1)[1:]) / h
    values = _at(port, theta)
    best = float(values.min())
    valley = np.flatnonzero((values <= np.append(values[1:], np.inf)) & (values <= np.append(np.inf, values[:-1])))
    valley = valley[np.argsort(values[valley])][:VALLEYS]
    low, high, rows = theta[np.maximum(valley - 1, 0)], theta[np.minimum(valley + 1, theta.size - 1)], np.arange(valley.size)
    for _ in range(7 if np.isfinite(best) else 0):
        inner = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 7)
        values = _at(port, inner.ravel()).reshape(inner.shape)
        k = np.argmin(values, axis=1)
        best = min(best, float(values.min()))
        low, high = inner[rows, np.maximum(k - 1, 0)], inner[rows, np.minimum(k + 1, 6)]
    return 0.0 if abs(best) < ROUNDING else best


def _at(port: PortSystem, theta: Array) -> Array:
    """1 + the smallest eigenvalue at each theta (k,) [rad/s]."""
    h, last = port.opened.dt, HARMONICS[-1]
    n = np.arange(-last, last + 1)
    shape = (theta.size, n.size)
    parts = under_hold(port, on_axis((theta[:, None] + 2 * np.pi * n / h).ravel()))
    direct, held, measured = (x[0].reshape(*shape, *x.shape[2:]) for x in parts)
    if not direct.any():  # the force acts through the sampled sensor only: it is not seen between the samples
        return np.full(theta.size, -np.inf)
    through = controller(port, np.exp(1j * theta * h))[0][:, None]
    H = direct + np.swapaxes(direct, -1, -2).conj()
    values, V = np.linalg.eigh(H)
    values = np.maximum(values, THIN * np.abs(direct).max(axis=(-2, -1))[..., None])
    both = np.concatenate([held, np.swapaxes(through @ measured, -1, -2).conj()], axis=-1)
    U = np.swapaxes(V, -1, -2).conj() @ both / np.sqrt(values)[..., None]
    each = np.swapaxes(U, -1, -2).conj() @ U
    return np.array([_eigenvalue(np.stack([one[np.abs(n) <= N].sum(axis=0) for N in HARMONICS])) for one in each])


def _eigenvalue(sums: Complex) -> float:
    W = _limit(sums)
    if W is None:
        return float("-inf")
    values, V = np.linalg.eigh((W + W.conj().T) / 2)
    root = V * np.sqrt(np.maximum(values, 0))
    return 1 + float(np.linalg.eigvalsh(root.conj().T @ np.roll(root, len(W) // 2, axis=0))[0])


def _limit(sums: Complex) -> Complex | None:
    """The sum over all harmonics; None where it has no limit. In the scale of its own diagonal, in which all directions count."""
    last, size = sums[-1], np.sqrt(np.maximum(np.real(np.diagonal(sums[-1])), 1e-300))
    first, second = (np.abs((b - a) / np.outer(size, size)).max() for a, b in pairwise(sums))
    if second > 1e-6 and second > GROWS * first:
        return None
    M: Array = np.array(HARMONICS) + 0.5
    weights = np.linalg.solve(np.stack([np.ones(3), 1 / M, 1 / M**3]), [1.0, 0.0, 0.0])
    return np.asarray(np.tensordot(weights, sums, 1)) if last.size else last
