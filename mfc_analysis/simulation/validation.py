"""Linear prediction against nonlinear simulation: is the linearisation correct, and up to which disturbance is it valid?

A base run starts at the operating point. Runs from disturbed starts are compared with the transition matrices of the loop
linearised along the base run. If the linearisation is correct, the remainder shrinks with the square of the disturbance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.errors import MfcError
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.orbit import TIGHT, transitions_along
from mfc_analysis.simulation.prediction import delayed, sampled_along, sampled_at_rest
from mfc_analysis.simulation.simulation import Simulation, simulate

STEPS = 200
MISFIT = 0.05  #: nrmse up to which the linear model is said to hold
ROUNDED = 10.0  #: times the solver's relative tolerance: the difference between two runs of a linear loop (measured: up to 2)
LARGEST = 3.0  #: [rad, m] largest disturbance tried


@dataclass(frozen=True, eq=False)
class Validation:
    """Accuracy of the linear model's prediction of the nonlinear loop from a disturbed start."""

    time: float  #: [s] length of the runs
    size: float  #: [rad, m] of the disturbance of each joint
    taylor_order: float  #: 2.0: the remainder shrinks with the square; inf: no remainder above rounding (the loop is linear)
    nrmse: float  #: rms(nonlinear - linear) / rms(nonlinear) of the joint deviations, at ``size``
    radius: float  #: [rad, m] largest size at which nrmse stays below 5 %; inf if it does up to 3
    sizes: Array  #: (k,) the sizes that give ``taylor_order``
    remainders: Array  #: (k,) largest |nonlinear - linear| over the run
    t: Array  #: (N,) [s]
    nonlinear: Array  #: (N, n) joint deviations of the nonlinear run at ``size``
    linear: Array  #: (N, n) prediction of the linear model
    message: str = ""  #: why there are no metrics (NaN), where a run did not reach its end

    def __str__(self) -> str:
        if self.message:
            return f"not validated: {self.message}"
        reach = f"at least {LARGEST:g} rad" if np.isinf(self.radius) else f"{self.radius:.3g} rad"
        return f"Taylor order {self.taylor_order:.3f}; misfit {100 * self.nrmse:.3g} % at {self.size:g} rad; below 5 % up to {reach}"

    __repr__ = __str__


def validate(e: Equations, time: float, size: float, seed: int) -> Validation:
    """Implements ``ClosedLoop.validate``.

    Raises BadArgument for a time that is not positive, a size below 1e-8, a seed that is not an integer from 0 to 2^64 - 1.
    """
    time = checks.number("time", time, low=0.0, strict=True)
    size = checks.number("size", size, low=1e-8)
    seed = checks.whole("seed", seed, 0, 2**64 - 1)
    x0 = on_reference(e, np.zeros(1)).x[0]
    t = _grid(e, time)
    base = simulate(e, t, x0, method="LSODA", **TIGHT)
    if base.diverged:
        return _nothing(time, size, e.n, base.message)
    direction = np.zeros(e.nx)
    q = e.parts["q"].where
    direction[q] = np.random.default_rng(seed).uniform(-1.0, 1.0, e.n)
    direction[q] /= np.abs(direction[q]).max()
    if "theta" in e.parts:  # motor and link move together
        direction[e.parts["theta"].where] = direction[q]
    predicted = _predict(e, base, t, direction)
    stopped: list[str] = []

    def compare(size: float, tight: bool = True) -> tuple[Array, Array] | None:
        try:
            run = simulate(e, t, x0 + size * direction, method="LSODA", **(TIGHT if tight else {"rtol": 1e-7, "atol": 1e-10}))
        except MfcError as why:
            stopped.append(str(why))
            return None
        if run.diverged:
            stopped.append(run.message)
            return None
        return run.x[:, q] - base.x[:, q], size * predicted[:, q]

    sizes = size * np.array([1.0, 0.5, 0.25])
    pairs = [compare(s) for s in sizes]
    remainders = np.array([np.nan if p is None else float(np.abs(p[0] - p[1]).max()) for p in pairs])
    order = _order(sizes, remainders, 1e-8 * sizes + ROUNDED * TIGHT["rtol"] * float(np.abs(base.x[:, q]).max()))
    here = pairs[0]
    if here is None:
        return _nothing(time, size, e.n, stopped[0] if stopped else "the disturbed run stopped")
    return Validation(time, size, order, misfit(*here), _radius(lambda s: compare(s, tight=False), size), sizes, remainders, t, *here)


def misfit(nonlinear: Array, linear: Array) -> float:
    """rms(nonlinear - linear) / rms(nonlinear)."""
    return float(np.sqrt(np.mean((nonlinear - linear) ** 2) / max(float(np.mean(nonlinear**2)), 1e-300)))


def _grid(e: Equations, time: float) -> Array:
    T = e.sample_time
    if not T:
        return np.linspace(0.0, time, STEPS + 1)
    return np.asarray(float(T) * np.arange(max(round(time / float(T)), 2) + 1), float)


def _predict(e: Equations, base: Simulation, t: Array, direction: Array) -> Array:
    """(N, nx) the linear deviation from a unit disturbance, along the base run."""
    if e.sample_time:
        at_rest = np.abs(base.x - base.x[0]).max() <= 1e-9 * (1 + np.abs(base.x[0]).max())
        return sampled_at_rest(e, base, t, direction) if at_rest else sampled_along(e, base, t, direction)
    if e.delayed:
        return delayed(e, base, t, direction)
    return accumulated(transitions_along(e, base, t)) @ direction


def _order(sizes: Array, remainders: Array, floor: Array) -> float:
    """Slope of the remainder; inf where no remainder exceeds ``floor``, the solver's error on a linear loop."""
    if not np.isfinite(remainders).all():
        return float("nan")
    if np.all(remainders <= floor):
        return float("inf")
    return float(np.log2(remainders[0] / remainders[1] if remainders[2] <= 3 * floor[2] else remainders[1] / remainders[2]))


def _radius(compare: Callable[[float], tuple[Array, Array] | None], size: float) -> float:
    def holds(s: float) -> bool:
        pair = compare(s)
        return pair is not None and misfit(*pair) < MISFIT

    low = size
    while not holds(low):
        low /= 4
        if low < 1e-6 * size:
            return 0.0
    high = low
    while high < LARGEST:
        high = min(2 * high, LARGEST)
        if not holds(high):
            break
        low = high
    if low >= LARGEST:
        return float("inf")
    for _ in range(6):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _nothing(time: float, size: float, n: int, why: str) -> Validation:
    nan = float("nan")
    return Validation(time, size, nan, nan, 0.0, np.zeros(0), np.zeros(0), np.zeros(1), np.full((1, n), nan), np.full((1, n), nan), why)
