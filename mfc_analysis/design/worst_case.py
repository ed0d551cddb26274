"""Worst case: the worst value of a metric over ranges of parameters, by a grid and a local search, with code to replay it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import inf, isnan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.analysis.loop_step import SettlingStep
from mfc_analysis.analysis.system import HORIZON
from mfc_analysis.design.ahead import Ahead
from mfc_analysis.errors import BadArgument, MfcError, UnknownName
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown
from mfc_analysis.requirements.evidence import METRICS, Evidence
from mfc_analysis.requirements.replay import replay
from mfc_analysis.requirements.requirements import KINDS, Requirements

Case = dict[str, float]
Values = tuple[float, ...]  #: of the parameters, in their order

MOST_POINTS = 1000  #: grid values of one range
SHRINKS = 12  #: halvings of the step in the local search
WIDE = 100.0  #: ratio of the ends of a range from which it is spaced logarithmically


@dataclass(frozen=True, eq=False)
class WorstCase(Shown):
    """The worst case found, convertible to float. ``value`` is NaN where the loop is not stable."""

    metric: str  #: metric that is minimised (maximised, for metrics with an upper limit)
    value: float  #: of the metric, in its own unit
    case: Case  #: the parameters; ``build(**case)`` is the loop
    loop: ClosedLoop
    where: str  #: joint or channel
    when: float | None  #: [s]
    stable: bool
    rightmost: float  #: [1/s] real part of the rightmost root in this case
    unstable: str  #: that root in words, with joint or tool axis and time; "" where the loop is stable
    evaluations: int  #: loops analysed
    failed: tuple[tuple[Case, str], ...] = field(default=())  #: cases that could not be built or analysed, with the reason
    replay: str = ""  #: code that rebuilds the loop
    step: SettlingStep = "reference"  #: of a settling time or an overshoot

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        case = ", ".join(f"{name} = {x:.6g}" for name, x in self.case.items())
        place = ", ".join(p for p in (self.where, "" if self.when is None else f"t = {self.when:.4g} s") if p)
        label, unit = (KINDS[self.metric].said(self.step), f" {KINDS[self.metric].unit}".rstrip()) if self.metric in KINDS else (self.metric, "")
        head = f"{label} {self.value:.6g}{unit}" if self.stable else "not stable"
        lost = f"; {len(self.failed)} cases could not be analysed" if self.failed else ""
        return f"worst case of {self.evaluations}: {head} at {case} ({self.unstable or place}){lost}"

    __repr__ = __str__


@dataclass(frozen=True)
class _Score:
    """Order of cases: not stable before stable, then by the metric; smaller is worse."""

    key: tuple[int, float]
    value: float
    where: str
    when: float | None
    rightmost: float
    unstable: str = ""


def worst_case(
    build: Callable[..., ClosedLoop],
    ranges: Mapping[str, Sequence[float]],
    times: ArrayLike = (0.0,),
    metric: str | Callable[[ClosedLoop], float] = "phase_deg",
    *,
    at: str | None = None,
    points: int = 5,
    horizon: float = HORIZON,
    step: SettlingStep = "reference",
    n_jobs: int | None = None,
) -> WorstCase:
    """The worst case over parameter ranges and path.

    Args:
        build: keyword parameters -> ``ClosedLoop``.
        ranges: name -> (low, high), searched on a grid of ``points`` and then in between; or three or more values, tried as given.
        times: (m,) [s] of the path. at: analysis point. horizon: [s] of the verdict.
        step: of a settling time or an overshoot, as in ``Requirements``.
        metric: a field of ``Requirements``, or a function loop -> number where smaller is worse. NaN counts as worst.
        points: of the grid of each range. n_jobs: processes, as in ``sweep``; the result is the same.

    A range with ends a factor of 100 or more apart is spaced logarithmically. A case that cannot be built is recorded in ``failed``.
    Raises BadArgument, UnknownName; where no case can be analysed the last error is raised.
    """
    if isinstance(metric, str) and metric not in METRICS:
        raise UnknownName("metric", metric, METRICS)
    if not isinstance(metric, str) and not callable(metric):
        raise BadArgument("metric", metric, f"one of {', '.join(METRICS)}, or a function of the loop")
    if not callable(build):
        raise BadArgument("build", build, "a function of the parameters that returns a ClosedLoop")
    if not isinstance(ranges, Mapping) or not ranges:
        raise BadArgument("ranges", ranges, "at least one name with its range, such as {'payload': (0, 5)}")
    points = checks.whole("points", points, 2, MOST_POINTS)
    t = checks.times(times)
    axes = {name: _axis(name, given, points) for name, given in ranges.items()}
    limit = {metric: KINDS[metric].low} if isinstance(metric, str) else {}
    asked = Requirements.from_mapping({**limit, "horizon": horizon, "step": step})
    search = _Search(tuple(axes), Ahead(_Scoring(build, tuple(axes), t, metric, at, asked), n_jobs))
    grid = list(product(*(a.values for a in axes.values())))
    scored = [(search.score(values, map(grid.__getitem__, range(i + 1, len(grid)))), values) for i, values in enumerate(grid)]
    judged = [(s, values) for s, values in scored if s is not None]
    if not judged:
        assert search.last is not None
        raise search.last
    best, found = _local(search, tuple(axes.values()), *min(judged, key=lambda pair: pair[0].key))
    case = dict(zip(axes, found, strict=True))
    loop = build(**case)
    name = metric if isinstance(metric, str) else getattr(metric, "__name__", "metric")
    call = f"print({asked.code}.check(loop, times, at={at!r}))" if name in KINDS else ""
    return WorstCase(
        name, best.value, case, loop, best.where, best.when, best.key[0] > 0, best.rightmost, best.unstable, search.count, tuple(search.failed),
        str(replay(loop, t, call)), asked.step,
    )  # fmt: skip


@dataclass(eq=False)
class _Search:
    """The search so far."""

    names: tuple[str, ...]
    ahead: Ahead[Values, _Score]
    count: int = 0
    failed: list[tuple[Case, str]] = field(default_factory=list)
    last: MfcError | None = None

    def score(self, values: Values, then: Iterable[Values] = ()) -> _Score | None:
        """None where the case cannot be analysed; the error is recorded."""
        self.count += 1
        try:
            return self.ahead(values, then)
        except MfcError as why:
            self.last = why
            self.failed.append((dict(zip(self.names, values, strict=True)), str(why)))
            return None


@dataclass(frozen=True, eq=False)
class _Scoring:
    build: Callable[..., ClosedLoop]
    names: tuple[str, ...]
    times: Array
    metric: str | Callable[[ClosedLoop], float]
    at: str | None
    asked: Requirements

    def __call__(self, values: Values) -> _Score:
        loop = self.build(**dict(zip(self.names, values, strict=True)))
        evidence = Evidence(loop.equations, self.times, self.at, self.asked.horizon, self.asked.step)
        root = evidence.slowest_root()
        if not evidence.judged.all():
            return _Score((0, -root.value), float("nan"), root.where, root.when, root.value, evidence.unstable)
        if isinstance(self.metric, str):
            found = evidence.found(self.metric)
            value, where, when = found.value, found.where, found.when
            worse = value if KINDS[self.metric].least else -value
        else:
            value, where, when = float(self.metric(loop)), "", None
            worse = value
        return _Score((1, -inf if isnan(worse) else worse), value, where, when, root.value)


@dataclass(frozen=True)
class _Axis:
    values: tuple[float, ...]
    low: float
    high: float
    log: bool
    between: bool  #: True: values between the grid values may be tried

    def moved(self, x: float, part: float) -> float:
        """x moved by a fraction of the range, within the range."""
        if self.log:
            return float(np.clip(x * (self.high / self.low) ** part, self.low, self.high))
        return float(np.clip(x + part * (self.high - self.low), self.low, self.high))


def _axis(name: str, given: Any, points: int) -> _Axis:
    takes = "(low, high) with low < high, or three or more values"
    values = checks.array(f"ranges[{name!r}]", given, (None,), takes)
    if values.size < 2 or (values.size == 2 and not values[0] < values[1]):
        raise BadArgument(f"ranges[{name!r}]", given, takes)
    if values.size > 2:
        return _Axis(tuple(values.tolist()), float(values.min()), float(values.max()), False, False)
    low, high = float(values[0]), float(values[1])
    log = low > 0 and high / low >= WIDE
    grid = np.geomspace(low, high, points) if log else np.linspace(low, high, points)
    grid[0], grid[-1] = low, high
    return _Axis(tuple(grid.tolist()), low, high, log, True)


def _local(search: _Search, axes: Sequence[_Axis], best: _Score, case: Values) -> tuple[_Score, Values]:
    """Pattern search: one parameter at a time; the step is halved where no move improves the result."""
    part = 0.5 / max(len(a.values) - 1 for a in axes)
    moves = [(i, sign) for i, axis in enumerate(axes) if axis.between for sign in (1.0, -1.0)]

    def moved(i: int, by: float) -> Values:
        return (*case[:i], axes[i].moved(case[i], by), *case[i + 1 :])

    for _ in range(SHRINKS):
        improved = True
        while improved:
            improved = False
            for k in range(len(moves)):
                tried, *then = (moved(i, sign * part) for i, sign in moves[k:])
                score = search.score(tried, [one for one in then if one != case]) if tried != case else None
                if score is not None and score.key < best.key:
                    best, case, improved = score, tried, True
        part /= 2
    return best, case
