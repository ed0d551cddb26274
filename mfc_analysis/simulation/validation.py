"""Linear prediction against nonlinear simulation: is the linearisation correct, and up to which disturbance is it valid?

A base run starts at the operating point. Runs from disturbed starts are compared with the transition matrices of the loop
linearised along the base run. If the linearisation is correct, the remainder shrinks with the square of the disturbance.
The disturbances are those that the linear model predicts worst (``directions``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.errors import MfcError, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.directions import LARGEST, MISFIT, Candidate, candidates, scaled_basis
from mfc_analysis.simulation.orbit import TIGHT, transitions_along
from mfc_analysis.simulation.prediction import delayed, sampled_along, sampled_at_rest
from mfc_analysis.simulation.run import Outcome, most_evaluations
from mfc_analysis.simulation.simulation import Simulation, simulate

STEPS = 200
ROUNDED = 10.0  #: times the solver's relative tolerance: the difference between two runs of a linear loop (measured: up to 2)
WORK = 1.5  #: times the evaluations that one run may take, for all runs of a validation
REGULAR, LEAST = 0.05, 1e-2  #: agreement of two slopes of a remainder below the solver's error, and the part of that error it exceeds
CLOSE = 0.01  #: relative accuracy of the radius
LOOSE: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-10}  #: of the runs that give the radius


@dataclass(frozen=True, eq=False)
class Validation:
    """Accuracy of the linear model's prediction of the nonlinear loop from a disturbed start."""

    time: float  #: [s] length of the runs
    size: float  #: [rad, m] of the disturbance
    taylor_order: float  #: 2.0: the remainder shrinks with the square; inf: no remainder above rounding (the loop is linear)
    nrmse: float  #: rms(nonlinear - linear) / rms(nonlinear) of the joint deviations at ``size``; inf where the run did not reach its end
    radius: float  #: [rad, m] largest size with nrmse below 5 % in the worst direction found; inf: up to 3 or more; NaN: too much work
    direction: Array  #: (nx,) that direction: all runs start at x0 + size direction; the largest entry of the joint positions is 1
    sizes: Array  #: (k,) the sizes that give ``taylor_order``: from ``size`` down, or from a quarter of ``radius`` where that is smaller
    remainders: Array  #: (k,) largest |nonlinear - linear| over the run
    t: Array  #: (N,) [s]
    nonlinear: Array  #: (N, n) joint deviations of the nonlinear run at ``size``; NaN where it did not reach its end
    linear: Array  #: (N, n) prediction of the linear model
    message: str = ""  #: why there are no metrics (NaN), where a run did not reach its end

    def __str__(self) -> str:
        if np.isnan(self.nrmse):
            return f"not validated: {self.message}"
        reach = f"at least {LARGEST:g} rad" if np.isinf(self.radius) else f"{self.radius:.3g} rad"
        missed = f"no misfit at {self.size:g} rad ({self.message})" if self.message else f"misfit {100 * self.nrmse:.3g} % at {self.size:g} rad"
        return f"Taylor order {self.taylor_order:.3f}; {missed}; below 5 % up to {reach} in the worst direction"

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
        return _nothing(e, time, size, base.message, np.nan if base.outcome is Outcome.STOPPED else 0.0)
    predicted, q = _predict(e, base, t), e.parts["q"].where
    if not np.isfinite(predicted).all():
        return _nothing(e, time, size, "the response of the linear model overflows")
    allowed = int(WORK * most_evaluations(e))
    stopped, left = "", max(allowed - base.evaluations, 1)

    def compare(direction: Array, size: float, options: dict[str, Any]) -> tuple[Array, Array] | None:
        nonlocal stopped, left
        try:
            run = simulate(e, t, x0 + size * direction, method="LSODA", max_evaluations=left, **options)
        except MfcError as why:
            stopped = str(why)
            return None
        left = max(left - run.evaluations, 1)
        if run.outcome is Outcome.STOPPED:
            raise _TooMuch(f"the runs take more than {allowed} evaluations of the equations; a shorter time= takes fewer")
        if run.diverged:
            stopped = run.message
            return None
        return run.x[:, q] - base.x[:, q], size * (predicted[:, q] @ direction)

    def nrmse(direction: Array, size: float) -> float:
        pair = compare(direction, size, LOOSE)
        return np.inf if pair is None else misfit(*pair)

    try:
        radius, direction = _worst(nrmse, candidates(e, base, scaled_basis(e, predicted), seed), 1e-6 * size)
        here = compare(direction, size, TIGHT)
        largest = min(size, 0.25 * radius) if radius > 0 else size
        sizes = largest * np.array([1.0, 0.5, 0.25])
        pairs = [here if s == size else compare(direction, s, TIGHT) for s in sizes]
    except _TooMuch as why:
        return _nothing(e, time, size, str(why), np.nan)
    if here is None and radius == 0:
        return _nothing(e, time, size, stopped)
    remainders = np.array([np.nan if p is None else float(np.abs(p[0] - p[1]).max()) for p in pairs])
    growth = np.array([1.0 if p is None else max(1.0, float(np.abs(p[0]).max()) / s) for s, p in zip(sizes, pairs, strict=True)])
    error = 1e-8 * growth * sizes + ROUNDED * TIGHT["rtol"] * float(np.abs(base.x[:, q]).max())  # an unstable loop makes more of it
    order = _order(sizes, remainders, error)
    if here is None:
        linear = size * (predicted[:, q] @ direction)
        return Validation(time, size, order, np.inf, radius, direction, sizes, remainders, t, np.full(linear.shape, np.nan), linear, stopped)
    return Validation(time, size, order, misfit(*here), radius, direction, sizes, remainders, t, *here)


def misfit(nonlinear: Array, linear: Array) -> float:
    """rms(nonlinear - linear) / rms(nonlinear)."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean((nonlinear - linear) ** 2) / max(float(np.mean(nonlinear**2)), 1e-300)))


def _grid(e: Equations, time: float) -> Array:
    T, least = e.sample_time, 2
    if not T:
        return np.linspace(0.0, time, STEPS + 1)
    if not np.isfinite(least * T):
        raise Unsupported("hardware.sample_time", T, f"a sample time of which {least} are a finite time")
    return np.asarray(T * np.arange(max(round(time / T), least) + 1), float)


def _predict(e: Equations, base: Simulation, t: Array) -> Array:
    """(N, nx, nx) the linear deviation along the base run, from every state at the start."""
    every = np.eye(e.nx)
    if e.sample_time:
        at_rest = np.abs(base.x - base.x[0]).max() <= 1e-9 * (1 + np.abs(base.x[0]).max())
        return sampled_at_rest(e, base, t, every) if at_rest else sampled_along(e, base, t, every)
    if e.delayed:
        return delayed(e, base, t, every)
    return accumulated(transitions_along(e, base, t))


def _order(sizes: Array, remainders: Array, floor: Array) -> float:
    """Slope of the remainder; inf where no remainder exceeds ``floor``, the solver's error on a linear loop.

    Below it a remainder still counts if it shrinks by the same power of 2, 1.5 or more, twice: errors of the solver do not.
    """
    if not np.isfinite(remainders).all():
        return float("nan")
    first, second = np.log2(np.maximum(remainders[:2], 1e-300) / np.maximum(remainders[1:], 1e-300))
    regular = min(first, second) > 1.5 and abs(first - second) < REGULAR and bool(np.all(remainders > LEAST * floor))
    if np.all(remainders <= floor) and not regular:
        return float("inf")
    return float(np.log2(remainders[0] / remainders[1] if remainders[2] <= 3 * floor[2] else remainders[1] / remainders[2]))


def _worst(nrmse: Callable[[Array, float], float], tried: list[Candidate], least: float) -> tuple[float, Array]:
    """The smallest radius of the candidates [rad, m] and its direction. Each takes one run at the smallest radius so far, more if it fails there."""
    direction = tried[0].direction
    radius = _radius(partial(nrmse, direction), MISFIT * tried[0].reach, least)
    for candidate in tried[1:]:
        size = min(radius, LARGEST)
        found = nrmse(candidate.direction, size) if size > 0 else 0.0
        if found > MISFIT * (1 + CLOSE):
            direction = candidate.direction
            radius = _radius(partial(nrmse, direction), size * MISFIT / found, least)
    return radius, direction


def _radius(nrmse: Callable[[float], float], guess: float, least: float) -> float:
    """Largest size at which ``nrmse`` is below ``MISFIT``, to ``CLOSE``; inf if it is up to ``LARGEST``, 0 if it is not even at ``least``.

    The misfit grows about in proportion to the size, so the next size tried is where it would be ``MISFIT``.
    """
    low, high, size = 0.0, np.inf, float(np.clip(guess, least, LARGEST))
    while high > (1 + CLOSE) * low:
        found = nrmse(size)
        if found < MISFIT:
            low = size
            if low >= LARGEST:
                return np.inf
        elif size <= least:
            return 0.0
        else:
            high = size
        step = size * float(np.clip(MISFIT / max(found, 1e-300), 0.25, 4.0))
        if high == np.inf:
            size = min(max(step, (1 + CLOSE) * low), LARGEST)
        elif low == 0:
            size = max(min(step, (1 - CLOSE) * high), least)
        else:
            size = step if (1 + CLOSE / 4) * low < step < (1 - CLOSE / 4) * high else float(np.sqrt(low * high))
    return low


def _nothing(e: Equations, time: float, size: float, why: str, radius: float = 0.0) -> Validation:
    nan, n = float("nan"), e.n
    none, empty = np.full((1, n), nan), np.zeros(0)
    return Validation(time, size, nan, nan, radius, np.full(e.nx, nan), empty, empty, np.zeros(1), none, none, why)


class _TooMuch(Exception):
    """The runs take too much work."""
