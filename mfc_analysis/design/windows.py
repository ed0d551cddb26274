"""Where a loop may be lost between two values of a scan: dead times that put a root on the axis, and sample times at which a resonance folds."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned
from mfc_analysis.analysis.frequency.response import wire_response
from mfc_analysis.analysis.spectrum import poles, spectrum
from mfc_analysis.analysis.system import OpenSystem, without_idle
from mfc_analysis.maths.arrays import Array, Complex, on_axis

HALVINGS = 50  #: towards a crossing
LIGHT = 0.5  #: damping ratio below which a mode of the plant is a resonance
DECAYED = 4.0  #: time constants of a resonance in a sample after which it has no window
PER_PERIOD = 12  #: sample times in a period of the resonance,
MOST = 400  #: and in all
RISES = 3.0  #: times the rise to a maximum by which it may rise further between the sample times
TURNS = 0.3  #: [rad]
NEAR_FOLD = 0.6  #: distance of a root from z = -1 within which a fold is looked at
ZOOMS, INNER = (4, 7), np.linspace(0, 1, 7)[1:-1]  #: towards a maximum of the growth, and towards a fold
TRANSIT = 20.0  #: samples of dead time up to which windows are sought


def critical_delays(system: OpenSystem, at: str) -> Array:
    """(k,) increasing dead times [s] > 0 of all wires of ``at`` together, besides the present ones, that put a root on the contour.

    Of a continuous loop. With the wires of ``at`` cut and the others closed by G(s) a root lies at jw where an eigenvalue of G(jw) is
    e^(jwT): its modulus is 1, and its angle gives T. At 1/horizon, the end of the slow roots, it is real. Source: Walton & Marshall, "Direct
    method for TDS stability analysis", IEE Proceedings D 134 (1987) 101-107.
    """
    radius, both = system.radius, np.concatenate([poles(system), np.linalg.eigvals(system.A)], axis=1).astype(np.complex128)
    every = thinned(frequencies_of_interest(both, radius), both)
    found: list[float] = []
    for i, w in enumerate(every):
        w = np.unique(w[w > 0])
        size = _moduli(_gains(system, i, at, on_axis(w)))[0]
        k, order = np.nonzero((size[1:] > 1) != (size[:-1] > 1))
        a, b, up = w[k], w[k + 1], size[k + 1, order] > 1
        rows = np.arange(k.size)
        for _ in range(HALVINGS if k.size else 0):
            middle = (a + b) / 2
            right = (_moduli(_gains(system, i, at, on_axis(middle)))[0][rows, order] > 1) == up
            a, b = np.where(right, a, middle), np.where(right, middle, b)
        if k.size:
            turn = np.angle(_moduli(_gains(system, i, at, on_axis(b)))[1][rows, order])
            found += (np.where(turn > 0, turn, turn + 2 * np.pi) / b).tolist()
        if radius:
            real = np.linalg.eigvals(_gains(system, i, at, np.array([radius + 0j]))[0])
            real = real.real[(np.abs(real.imag) < 1e-9 * np.abs(real)) & (real.real > 1)]
            found += (np.log(real) / radius).tolist()
    return np.unique(np.array(found, float))


def _gains(system: OpenSystem, index: int, at: str, s: Complex) -> Complex:
    """G (k, n, n) from after the cuts of ``at`` to before them, present dead times included, at s (k,)."""
    with np.errstate(over="ignore", invalid="ignore"):  # beside a pole at zero, with a horizon near the largest float
        G = np.exp(-s[:, None] * system.wire_delay)[:, :, None] * wire_response(system, index, s)
    cut = np.arange(system.nw)[system.wires[at]]
    rest = np.setdiff1d(np.arange(system.nw), cut)
    out: Complex = G[:, cut[:, None], cut]
    if rest.size:
        inner = np.linalg.solve(np.eye(rest.size) - G[:, rest[:, None], rest], G[:, rest[:, None], cut])
        out = out + G[:, cut[:, None], rest] @ inner
    return np.asarray(np.where(np.isfinite(out), out, 0.0), np.complex128)


def _moduli(G: Complex) -> tuple[Array, Complex]:
    """Moduli of the eigenvalues of G (k, n, n), the largest first, and these eigenvalues."""
    found = np.linalg.eigvals(G)
    size = np.abs(found)
    order = np.argsort(-size, axis=1, kind="stable")
    return np.take_along_axis(size, order, 1), np.asarray(np.take_along_axis(found, order, 1), np.complex128)


def folding_times(continuous: OpenSystem, low: float, high: float) -> Array:
    """(k,) sample times [s] from ``low`` to beyond ``high``, close enough to see where a lightly damped mode of the plant folds.

    ``continuous``: the loop with all wires cut, without a sample time. The response of such a mode to a held torque turns with the sample time
    once in a period of the mode, until the mode decays within a sample; so the loop may be lost and held again many times.
    """
    plant = np.array(sorted(continuous.plant_states), np.int64)
    modes = np.linalg.eigvals(continuous.A[:, plant[:, None], plant]).ravel()
    modes = modes[(modes.imag > 0) & (np.abs(modes.real) < LIGHT * np.abs(modes))]
    if not modes.size:
        return np.zeros(0)
    w, last = modes.imag, DECAYED / np.maximum(np.abs(modes.real), 1e-300)
    h = max(low, 0.25 * 2 * np.pi / float(w.max()))
    out: list[float] = []
    while h < high and len(out) < MOST:
        rings = w[last > h]
        if not rings.size:
            break
        out.append(h)
        h += 2 * np.pi / float(rings.max()) / PER_PERIOD
    return np.array([*out, h]) if out else np.zeros(0)


class Growth(NamedTuple):
    """Of a sampled loop, over all points."""

    largest: float  #: [1/s] of the roots that are not slow; inf where every root is slow
    turning: float  #: [1/s] of those that turn in a sample; -inf where none does
    folding: float  #: minus the distance of the nearest root from z = -1, where a pair that folds parts into two real roots


def growths(system: OpenSystem) -> Growth:
    """Growth of the roots of a sampled loop."""
    known = spectrum(without_idle(system))
    s: Complex = np.where(known.slow, -np.inf, known.rates).astype(np.complex128)
    turns = np.abs(s.imag) * system.dt > TURNS
    every = np.where(known.slow.all(axis=1), np.inf, s.real.max(axis=1))
    return Growth(float(every.max()), float(np.where(turns, s.real, -np.inf).max()), -float(np.abs(known.poles + 1).min()))


def lost_between(grown: Callable[[float], Growth], values: Array) -> Array:
    """The increasing values at which the loop is lost: some of ``values`` (k,), and those to which a maximum of a growth between them leads.

    A maximum that its neighbours do not let rise far enough is left out.
    """
    g = np.array([grown(float(x)) for x in values]).reshape(-1, 3)
    found = values[~(g[:, 0] < 0)].tolist()
    for column, i in np.ndindex(2, max(values.size - 2, 0)):
        a, top, b = g[i : i + 3, 1 + column]
        if not np.isfinite(top) or top < a or top < b or not g[i + 1, 0] < 0:
            continue
        if top < -NEAR_FOLD if column else top + RISES * max(top - a, top - b) < 0:
            continue
        low, high = float(values[i]), float(values[i + 2])
        for _ in range(ZOOMS[column]):
            inner = low + (high - low) * INNER
            there = np.array([grown(float(x)) for x in inner])
            lost = inner[~(there[:, 0] < 0)]
            if lost.size:
                found += lost.tolist()
                break
            best, step = int(np.argmax(there[:, 1 + column])), (high - low) / (INNER.size + 1)
            low, high = inner[best] - step, inner[best] + step
    return np.unique(np.array(found, float))
