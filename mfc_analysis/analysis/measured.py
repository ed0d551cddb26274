"""Margins of a loop that is known by its frequency response only: straight lines between the samples, and nothing beyond them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mfc_analysis.analysis.frequency.crossings import Crossings
from mfc_analysis.analysis.margin_metrics import assembled
from mfc_analysis.analysis.margins import Margins
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array, Complex

APART = 0.3  #: of a half turn: how far the count of encirclements may be from a whole number
STEEPEST = 3  #: integrators at most


def measured_margins(data: Any, delay: float = 0.0, open_loop_unstable: int = 0) -> Margins:
    """Margins of one channel of ``control.FrequencyResponseData`` L in negative feedback, with ``delay`` [s] behind it.

    The verdict is Nyquist's count on the samples, with ``open_loop_unstable`` poles of L in the right half plane. L is taken to be 0 above
    the last frequency; below the first it is constant, or has the integrators that its slope shows. Raises BadArgument.
    """
    w, L = samples(data)
    L = np.asarray(L * np.exp(-1j * w * delay), np.complex128)
    stable = unstable_roots(w, L, open_loop_unstable) == 0
    origin = float(L[0].real) if not _integrators(w, L) else None  # L is real there
    return sampled_margins(w, L, stable, "loop", str(data.output_labels[0]), origin)


def sampled_margins(w: Array, L: Complex, stable: bool, at: str, channel: str, origin: float | None = None) -> Margins:
    """Margins of the straight lines through the samples L (k,) at w (k,) [rad/s], and of nothing beyond them, at the time 0.

    ``stable``: the verdict on the closed loop; without it all are NaN. ``origin``: L at zero frequency, if it is known and real.
    """
    gain, phase = _crossings(w, L, lambda L: np.abs(L) ** 2 - 1), _crossings(w, L, lambda L: L.imag)
    still = np.zeros(0) if origin is None else np.array([origin])
    zero = np.zeros(still.size, np.int64)
    with np.errstate(divide="ignore"):
        arc = Crossings(zero, zero, np.zeros(still.size), np.asarray(1 / (1 + still) - 1, np.complex128))
    found = assembled(gain, phase, arc, np.zeros((1, 1)), lambda w: w)
    distance, nearest = _nearest(w, 1 + L)
    found |= {"sensitivity_peak": np.array([[max(1.0, 1 / distance)]]), "peak_frequency": np.array([[nearest]])}
    if not stable:
        found = {name: np.full((1, 1), np.nan) for name in found}
    return Margins(np.zeros(1), at, (channel,), np.array([stable]), np.zeros(1, bool), **found)


def unstable_roots(w: Array, L: Complex, open_loop_unstable: int = 0) -> int:
    """Nyquist's count: roots of 1 + L in the right half plane, from the turns of 1 + L over the samples w (k,) [rad/s] of L (k,).

    Raises BadArgument where the samples are too coarse, or end too early, for a whole number.
    """
    step = np.angle((1 + L[1:]) / (1 + L[:-1]))
    integrators = _integrators(w, L)
    first = (L[0] * 1j**integrators).real  # L beside the origin, on the real axis
    base = np.pi if first < -1 or (integrators and first < 0) else 0.0
    start = float(np.angle(1 + L[0]))
    start += 2 * np.pi * np.rint((base - integrators * np.pi / 2 - start) / (2 * np.pi))
    turned = start + float(step.sum()) - float(np.angle(1 + L[-1])) - base
    count = float(open_loop_unstable - turned / np.pi)
    if np.abs(step).max() > 0.9 * np.pi or abs(L[-1]) > 1 or abs(count - round(count)) > APART:
        takes = "samples so close that 1 + L turns by less than half a turn between them, from well below to well above the crossovers"
        raise BadArgument("L", f"{w.size} samples, {count:.2f} unstable roots by Nyquist's count", takes)
    if round(count) < 0:
        raise BadArgument("open_loop_unstable", open_loop_unstable, f"at least {open_loop_unstable - round(count)}: 1 + L turns that often")
    return round(count)


def _integrators(w: Array, L: Complex) -> int:
    """Poles of L at the origin, by the slope at the first frequencies."""
    slope = -np.log(abs(L[1] / L[0])) / np.log(w[1] / w[0])
    return int(np.clip(np.rint(slope), 0, STEEPEST)) if abs(L[0]) > 1 else 0


def samples(data: Any, argument: str = "L") -> tuple[Array, Complex]:
    """Frequencies (k,) [rad/s], increasing, and L (k,) of ``control.FrequencyResponseData`` of one channel. Raises BadArgument."""
    L = np.asarray(data.frdata)
    w = np.asarray(data.omega, float)
    if L.shape[:2] != (1, 1) or w.size < 3:
        raise BadArgument(argument, f"{L.shape[0]} x {L.shape[1]} responses at {w.size} frequencies", "one channel at three frequencies or more")
    order = np.argsort(w)
    w, L = w[order], np.asarray(L[0, 0, order], np.complex128)
    if not np.isfinite(L).all() or w[0] <= 0 or (np.diff(w) <= 0).any():
        raise BadArgument(argument, "frequency response data", "finite values at different frequencies > 0")
    return w, L


def _crossings(w: Array, L: Complex, f: Callable[[Complex], Array]) -> Crossings:
    """Where f of L changes sign along the straight line between two samples."""
    at = f(L) >= 0
    k = np.flatnonzero(at[:-1] != at[1:])
    low, high = np.zeros(k.size), np.ones(k.size)
    for _ in range(60):
        middle = 0.5 * (low + high)
        right = (f(np.asarray(L[k] + middle * (L[k + 1] - L[k]), np.complex128)) >= 0) == at[k + 1]
        low, high = np.where(right, low, middle), np.where(right, middle, high)
    found, zero = np.asarray(L[k] + high * (L[k + 1] - L[k]), np.complex128), np.zeros(k.size, np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Crossings(zero, zero, w[k] + high * (w[k + 1] - w[k]), np.asarray(1 / (1 + found) - 1, np.complex128))


def _nearest(w: Array, z: Complex) -> tuple[float, float]:
    """The least distance of the lines through z (k,) from the origin, and the frequency there."""
    step = np.diff(z)
    along = np.clip(-(z[:-1] * step.conj()).real / np.maximum(np.abs(step) ** 2, 1e-300), 0, 1)
    size = np.abs(z[:-1] + along * step)
    k = int(size.argmin())
    return float(size[k]), float(w[k] + along[k] * (w[k + 1] - w[k]))
