"""Linear prediction against nonlinear simulation: is the linearisation correct, and up to which disturbance is it valid?

A base run starts at the operating point. Runs from disturbed starts are compared with the transition matrices of the loop
linearised along the base run. If the linearisation is correct, the remainder shrinks with the square of the disturbance.
The disturbances are those that the linear model predicts worst (``directions``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mfc_analysis.analysis.floquet import accumulated
from mfc_analysis.dynamics.equations import Equations
from mfc_analysis.dynamics.operating_point import on_reference
from mfc_analysis.errors import MfcError, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown
from mfc_analysis.simulation.along import STEPS, Along
from mfc_analysis.simulation.directions import LARGEST, MISFIT, Candidate, candidates, on_box, pattern_step, scaled_basis
from mfc_analysis.simulation.orbit import TIGHT
from mfc_analysis.simulation.prediction import delayed, sampled_along, sampled_at_rest
from mfc_analysis.simulation.run import Outcome, most_evaluations
from mfc_analysis.simulation.simulation import Motion, motion, simulate_together

if TYPE_CHECKING:
    from mfc_analysis.plots.figure import Axes

ROUNDED = 10.0  #: times the solver's relative tolerance: the difference between two runs of a linear loop (measured: up to 2)
WORK = 1.5  #: times the evaluations that one run may take, for all runs of a validation: about 15 s of work
REGULAR, LEAST = 0.05, 1e-2  #: agreement of two slopes of a remainder below the solver's error, and the part of that error it exceeds
SQUARE = 1.5  #: power of two from which a remainder shrinks as it should
CLOSE = 0.01  #: relative accuracy of the radius
APART = 0.03  #: relative distance of the sizes that are run together
FIRST, LATER = (-2, 1), (-1, 1)  #: sizes below and above the one where a direction is to have its radius, run with it: the first is often too large
SMOOTH = 0.5  #: difference from 1 of the power with which the misfit grows with the size, up to which no limit is reached between two sizes
STEEP = 1e3  #: [1/s] modulus of a root from which on the response that chooses directions may not follow
RANDOM, CLIMBERS = 24, 5  #: directions tried at random there, and those that climb beside the worst known
SMALLER = (1e-2, 1e-1, 1.0)  #: of the radius: sizes at which they are tried
CLIMBED = (0.7, 0.4, 0.2)  #: changes of the entries of a direction in the steps of their search
NEAR = 0.1  #: relative difference of two sizes up to which the misfit is in proportion
LOOSE, LOOSEST = 5e-5, 1e-5  #: relative tolerance of the runs that give the radius, for each rad (m) of their disturbance, and its largest value

Case = tuple[Array, float]  #: direction (nx,) and size of a disturbance
Pair = tuple[Array, Array]  #: (N, n) joint deviations of the nonlinear run and of the linear model


@dataclass(frozen=True, eq=False)
class Validation(Shown):
    """Accuracy of the linear model's prediction of the nonlinear loop from a disturbed start."""

    time: float  #: [s] length of the runs
    size: float  #: [rad, m] of the disturbance
    taylor_order: float  #: 2.0: the remainder shrinks with the square; inf: none above rounding (linear); NaN: the loop grows too much to tell
    nrmse: float  #: rms(nonlinear - linear) / rms(nonlinear) of the joint deviations at ``size``; inf where the run did not reach its end
    radius: float  #: [rad, m] largest size with nrmse below 5 % in the worst direction found; inf: up to 3 or more; NaN: too much work
    direction: Array  #: (nx,) that direction: all runs start at x0 + size direction; the largest entry of the joint positions is 1
    sizes: Array  #: (k,) the sizes that give ``taylor_order``: from ``size`` down, or from a quarter of ``radius`` where that is smaller
    remainders: Array  #: (k,) largest |nonlinear - linear| over the run
    t: Array  #: (N,) [s]
    nonlinear: Array  #: (N, n) joint deviations of the nonlinear run at ``size``; NaN where it did not reach its end
    linear: Array  #: (N, n) prediction of the linear model
    message: str = ""  #: why there are no metrics (NaN), where a run did not reach its end
    joints: tuple[str, ...] = ()  #: (n,) names

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """The joint deviations at ``size``: nonlinear solid, linear dashed. ``ax``: to draw in; None: a new figure of pyplot."""
        from mfc_analysis import plots

        panel = plots.Panel("deviation [rad, m]", self.nonlinear, beside=self.linear)
        title, said = f"Start off by {self.size:g} rad", ("nonlinear", "linear")
        return plots.traces(self.t, (panel,), self.joints, title=title, said=said, axes=plots.shown("time history", ax))[0]

    def __str__(self) -> str:
        if np.isnan(self.nrmse):
            return f"not validated: {self.message}"
        reach = f"at least {LARGEST:g} rad" if np.isinf(self.radius) else f"{self.radius:.3g} rad"
        missed = f"no misfit at {self.size:g} rad ({self.message})" if self.message else f"misfit {100 * self.nrmse:.3g} % at {self.size:g} rad"
        grows = f"a disturbance grows too much in {self.time:g} s for a Taylor order"
        order = grows if np.isnan(self.taylor_order) else f"Taylor order {self.taylor_order:.3f}"
        return f"{order}; {missed}; below 5 % up to {reach} in the worst direction"

    __repr__ = __str__


def validate(e: Equations, time: float, size: float, seed: int, n_jobs: int | None = None) -> Validation:
    """Implements ``ClosedLoop.validate`` for the equations ``e`` of the loop. Other arguments as there.

    Raises BadArgument for a time that is not positive, a size below 1e-8, a seed that is not an integer from 0 to 2^64 - 1, and for ``n_jobs`` 0.
    """
    time = checks.number("time", time, low=0.0, strict=True)
    size = checks.number("size", size, low=1e-8)
    seed, n_jobs = checks.whole("seed", seed, 0, 2**64 - 1), checks.jobs(n_jobs)
    x0 = on_reference(e, np.zeros(1)).x[0]
    t, least = _grid(e, time), 1e-6 * size
    base = motion(e, t, x0, **TIGHT)
    if base.diverged:
        return _nothing(e, time, size, base.message, np.nan if base.outcome is Outcome.STOPPED else 0.0)
    along, q = Along(e, base), e.parts["q"].where
    predicted = _predict(along, t)
    if not np.isfinite(predicted).all():
        return _nothing(e, time, size, "the response of the linear model overflows")
    runs = _Disturbed(e, base, predicted[:, q], int(WORK * most_evaluations(e)), n_jobs)

    try:
        basis = scaled_basis(e, predicted)
        tried = candidates(along, basis, seed)
        radius, direction = _worst(runs, tried, least)
        radius, direction = _worse(runs, along, basis, radius, direction, seed, least)
        sizes = _sizes(size, radius)
        here, *pairs = runs.compare([(direction, s) for s in (size, *sizes)], TIGHT)
        found = np.inf if isinstance(here, str) else misfit(*here)
        if size < (1 - CLOSE) * radius and not found <= MISFIT * (1 + CLOSE):  # it is larger here than at some larger sizes
            radius = _radius(runs, direction, {size: found}, least)
            sizes = _sizes(size, radius)
            pairs = runs.compare([(direction, s) for s in sizes], TIGHT)
    except _TooMuch as why:
        return _nothing(e, time, size, str(why), np.nan)
    if isinstance(here, str) and radius == 0:
        return _nothing(e, time, size, here)
    remainders = np.array([np.nan if isinstance(p, str) else float(np.abs(p[0] - p[1]).max()) for p in pairs])
    growth = np.array([1.0 if isinstance(p, str) else max(1.0, float(np.abs(p[0]).max()) / s) for s, p in zip(sizes, pairs, strict=True)])
    solver = ROUNDED * (TIGHT["rtol"] * float(np.abs(base.x[:, q]).max()) + TIGHT["atol"])
    order = _order(remainders, 1e-8 * growth * sizes + solver, growth * solver)
    if radius == 0 and least * float(np.abs(predicted[:, q] @ direction).max()) > MISFIT:  # even the least disturbance leaves the linear range
        order = float("nan")
    names = e.robot.joint_names
    if isinstance(here, str):
        linear = size * (predicted[:, q] @ direction)
        return Validation(time, size, order, np.inf, radius, direction, sizes, remainders, t, np.full(linear.shape, np.nan), linear, here, names)
    return Validation(time, size, order, misfit(*here), radius, direction, sizes, remainders, t, *here, joints=names)


class _Disturbed:
    """Runs from disturbed starts, together where that is possible, and what the linear model predicts for them."""

    def __init__(self, e: Equations, base: Motion, predicted: Array, allowed: int, n_jobs: int | None) -> None:
        self.e, self.base, self.predicted, self.n_jobs = e, base, predicted, n_jobs  #: predicted: (N, n, nx)
        self.allowed, self.left = allowed, max(allowed - float(base.evaluations), 1.0)  #: evaluations
        self.alone = any(s.one_sided for s in e.surfaces)  #: each run has its own contact

    def misfits(self, cases: list[Case]) -> list[float]:
        """``misfit`` of each case, inf where its run does not reach the end."""
        return [np.inf if isinstance(pair, str) else misfit(*pair) for pair in self.compare(cases, _loose(cases))]

    def together(self, cases: list[Case]) -> list[float]:
        """The same where several runs can be run together and all reach the end; none otherwise."""
        if self.alone or len(cases) < 2:
            return []
        x = self._stacked(self._starts(cases), _loose(cases))
        return [] if x is None else [misfit(*self._pair(one, case)) for one, case in zip(x, cases, strict=True)]

    def compare(self, cases: list[Case], options: dict[str, Any]) -> list[Pair | str]:
        """The joint deviations of each case; where its run does not reach the end: why not."""
        starts, which = np.unique(self._starts(cases), axis=0, return_inverse=True)
        runs = self._runs(starts, options)
        return [x if isinstance(x := runs[i], str) else self._pair(x, case) for i, case in zip(np.ravel(which), cases, strict=True)]

    def _starts(self, cases: list[Case]) -> Array:
        return np.asarray(self.base.x[0] + np.array([size * direction for direction, size in cases]))

    def _pair(self, x: Array, case: Case) -> Pair:
        q, (direction, size) = self.e.parts["q"].where, case
        return x[:, q] - self.base.x[:, q], size * (self.predicted @ direction)

    def _runs(self, starts: Array, options: dict[str, Any]) -> list[Array | str]:
        """States (N, nx) of the runs from the starts (k, nx). Where one of them stops, halves of them run again, in the end each alone."""
        if self.alone or len(starts) == 1:
            return self._each_alone(starts, options)
        x, half = self._stacked(starts, options), len(starts) // 2
        return list(x) if x is not None else self._runs(starts[:half], options) + self._runs(starts[half:], options)

    def _stacked(self, starts: Array, options: dict[str, Any]) -> Array | None:
        x, outcome, spent = simulate_together(self.e, self.base.t, starts, max_evaluations=self.left, **options)
        self._spend(spent, outcome)
        return x

    def _each_alone(self, starts: Array, options: dict[str, Any]) -> list[Array | str]:
        """``_runs`` one by one, or as many at a time as there are processes."""
        import joblib

        out, workers = [], int(joblib.effective_n_jobs(cast(int, self.n_jobs)))  # it takes None, whatever its types say
        for first in range(0, len(starts), workers):
            some, run = starts[first : first + workers], joblib.delayed(partial(_run, self.e, self.base.t, int(self.left), options))
            found = joblib.Parallel(self.n_jobs if len(some) > 1 else 1)(map(run, some))
            for x, evaluations, outcome in cast("list[tuple[Array | str, int, Outcome]]", found):
                self._spend(evaluations, outcome)
                out.append(x)
        return out

    def _spend(self, evaluations: float, outcome: Outcome) -> None:
        if outcome is Outcome.STOPPED or evaluations > self.left:
            raise _TooMuch(f"the runs take more than {self.allowed} evaluations of the equations; a shorter time= takes fewer")
        self.left = max(self.left - evaluations, 1.0)


def _run(e: Equations, t: Array, most: int, options: dict[str, Any], start: Array) -> tuple[Array | str, int, Outcome]:
    """States (N, nx) of one run, or why it does not reach its end; its evaluations and how it ended."""
    try:
        run = motion(e, t, start, max_evaluations=most, **options)
    except MfcError as why:
        return str(why), 0, Outcome.REFUSED
    return run.message if run.diverged else run.x, run.evaluations, run.outcome


def _loose(cases: list[Case]) -> dict[str, Any]:
    """Tolerances that suffice for the misfit of each case."""
    rtol = float(np.clip(LOOSE * min(size for _, size in cases), TIGHT["rtol"], LOOSEST))
    return {"rtol": rtol, "atol": 0.1 * rtol}


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


def _predict(along: Along, t: Array) -> Array:
    """(N, nx, nx) the linear deviation along the base run, from every state at the start."""
    e, base, every = along.e, along.base, np.eye(along.e.nx)
    if e.sample_time:
        return sampled_at_rest(e, base, t, every) if along.still else sampled_along(e, base, t, every)
    if e.delayed:
        return delayed(e, base, t, every)
    return accumulated(along.Phi)


def _order(remainders: Array, floor: Array, grown: Array) -> float:
    """Slope of the remainder; inf where no remainder exceeds ``floor``, the solver's error on a linear loop.

    Below it a remainder still counts if it shrinks by the same power of 2, 1.5 or more, twice: errors of the solver do not. A smaller power is NaN
    where no remainder exceeds ``grown``, the solver's error once it has grown as the disturbance.
    """
    if not np.isfinite(remainders).all():
        return float("nan")
    first, second = np.log2(np.maximum(remainders[:2], 1e-300) / np.maximum(remainders[1:], 1e-300))
    regular = min(first, second) > SQUARE and abs(first - second) < REGULAR and bool(np.all(remainders > LEAST * floor))
    if np.all(remainders <= floor) and not regular:
        return float("inf")
    order = float(np.log2(remainders[0] / remainders[1] if remainders[2] <= 3 * floor[2] else remainders[1] / remainders[2]))
    return float("nan") if order < SQUARE and np.all(remainders <= grown) else order


def _worst(runs: _Disturbed, tried: list[Candidate], least: float) -> tuple[float, Array]:
    """The smallest radius of the candidates [rad, m] and its direction.

    All are run together at the size where the first is to have its radius, and again at that radius where it is another size; one that fails
    there takes its place.
    """
    direction, others = tried[0].direction, [candidate.direction for candidate in tried[1:]]
    size = float(np.clip(MISFIT * tried[0].reach, least, LARGEST))
    sizes = _about(size, FIRST, 0.0, np.inf, least)
    found = runs.together([(direction, s) for s in sizes] + [(other, size) for other in others])
    known = dict(zip(sizes, found, strict=False)) or {size: runs.misfits([(direction, size)])[0]}
    radius, found = _radius(runs, direction, known, least), found[len(sizes) :]
    while others and radius > 0:
        reached = min(radius, LARGEST)
        if not found or abs(reached / size - 1) > NEAR:
            size, found = reached, runs.misfits([(other, reached) for other in others])
        i = int(np.argmax(found))
        if not found[i] * reached / size > MISFIT * (1 + CLOSE):  # about in proportion to the size
            break
        direction = others.pop(i)
        radius = _radius(runs, direction, {size: found.pop(i)}, least)
    return radius, direction


def _worse(runs: _Disturbed, along: Along, basis: Array, radius: float, direction: Array, seed: int, least: float) -> tuple[float, Array]:
    """A smaller radius and its direction, where a pattern search on the runs finds one: from ``direction``, its opposite and some at random.

    For loops that the response may not follow, and whose misfit may be largest at a small size. It takes half of the work that is left, and ends
    with that. Not where runs are not integrated together, or take long.
    """
    e = runs.e
    if runs.alone or e.delayed or e.sample_time or not (along.fastest > STEEP or e.plant.robot.coulomb.any()):
        return radius, direction
    n, k, kept = e.n, basis.shape[1], 0.5 * runs.left
    own = np.asarray(np.linalg.lstsq(basis, direction, rcond=None)[0], float)
    random = np.random.default_rng(seed).uniform(-1.0, 1.0, (RANDOM, k))
    random[::2] = np.sign(random[::2])
    c: Array = np.array([own, -own, *(on_box(x, n) for x in random)])

    def misfits(c: Array, size: float) -> Array:
        found = runs.misfits([(basis @ x, size) for x in c.reshape(-1, k)])
        return np.asarray(np.minimum(np.reshape(found, c.shape[:-1]), 1.0))

    for part, step in (*((part, 0.0) for part in SMALLER), *((1.0, step) for step in CLIMBED)):  # the starts as they are, then their search
        if radius == 0 or runs.left <= kept:
            break
        size = part * min(radius, LARGEST)
        runs.left -= kept
        try:
            c, found = pattern_step(partial(misfits, size=size), c, step, n) if step else (c, misfits(c[:, None], size)[:, 0])
        except _TooMuch:
            break
        finally:
            runs.left += kept
        worst = int(found.argmax())
        if found[worst] > MISFIT * (1 + CLOSE):
            radius, direction = _radius(runs, basis @ c[worst], {size: float(found[worst])}, least), basis @ c[worst]
        if len(c) > CLIMBERS and part == 1.0:
            c = np.concatenate([c[:1], c[1:][np.argsort(-found[1:], kind="stable")[:CLIMBERS]]])
    return radius, direction


def _radius(runs: _Disturbed, direction: Array, known: dict[float, float], least: float) -> float:
    """Largest size with a misfit below ``MISFIT``, to ``CLOSE``; inf if it is up to ``LARGEST``, 0 if it is not even at ``least``.

    Beyond a singularity the misfit may be small again, so some sizes below ``LARGEST`` are tried too.
    The misfit grows about in proportion to the size, so the next size tried is where it would be ``MISFIT``, once that is near with some more
    about it. Between two sizes that are near, a power of the size near the first gives the radius; else it is halved. ``known``: size -> misfit.
    """
    tries = 0
    while True:
        tries += 1
        high = min((s for s, found in known.items() if not found < MISFIT), default=np.inf)
        low = max((s for s in known if s < high), default=0.0)
        if high <= least:
            return 0.0
        if low >= LARGEST:
            between = [s for s in (LARGEST / 2, LARGEST / 4, LARGEST / 8) if s not in known]
            if not between:
                return np.inf
            known.update(zip(between, runs.misfits([(direction, s) for s in between]), strict=True))
            continue
        if high <= (1 + CLOSE) * low:
            return low
        power = np.inf
        if 0 < low < high < np.inf and 0 < known[low] < known[high]:
            power = float(np.log(known[high] / known[low]) / np.log(high / low))
        if high <= (1 + APART) ** 2 * low and abs(power - 1) < SMOOTH:
            return float(low * (MISFIT * (1 - 0.1 * CLOSE) / known[low]) ** (1 / power))
        near = low if low and (high == np.inf or known[low] * known[high] > MISFIT**2) else high  # the nearer one
        change = float(np.clip(MISFIT / max(known[near], 1e-300), 0.25, 4.0))
        size = near * change
        if high == np.inf:
            size = min(max(size, (1 + CLOSE) * low), LARGEST)
        elif low == 0:
            size = max(min(size, (1 - CLOSE) * high), least)
        elif tries % 3 and power < np.inf:
            size = float(low * (MISFIT / known[low]) ** (1 / power))
        else:
            size = float(np.sqrt(low * high))
        sizes = _about(size, LATER, low, high, least) if 0.5 < change < 2 else [size]
        found = runs.together([(direction, s) for s in sizes]) or runs.misfits([(direction, size)])
        known.update(zip(sizes if len(found) > 1 else [size], found, strict=True))


def _about(size: float, among: tuple[int, int], low: float, high: float, least: float) -> list[float]:
    """A size, and some below and above, that are between known ones and within the sizes that are tried."""
    sizes = np.clip(size * (1 + APART) ** np.arange(among[0], among[1] + 1), least, LARGEST)
    return [float(s) for s in np.unique(sizes) if low < s < high]


def _sizes(size: float, radius: float) -> Array:
    """The sizes that give the Taylor order."""
    return (min(size, 0.25 * radius) if radius > 0 else size) * np.array([1.0, 0.5, 0.25])


def _nothing(e: Equations, time: float, size: float, why: str, radius: float = 0.0) -> Validation:
    nan, n = float("nan"), e.n
    none, empty = np.full((1, n), nan), np.zeros(0)
    return Validation(time, size, nan, nan, radius, np.full(e.nx, nan), empty, empty, np.zeros(1), none, none, why, e.robot.joint_names)


class _TooMuch(Exception):
    """The runs take too much work."""
