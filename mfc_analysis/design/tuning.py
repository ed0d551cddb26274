"""Gains that meet all requirements over a path and ranges of parameters: the fastest ones, or those nearest to a wanted bandwidth.

One gain (``bandwidth``, or each in turn) is pushed to its largest value that meets the requirements, for each value of the others, which a
grid and then a bounded derivative-free search vary. The requirements are judged at the places (case and time) that bind; the result is
checked at all of them, between the cases and on finer times, and what misses a requirement there joins the places of the next round.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mfc_analysis.design.edges import FLOOR, GROUPS, Judge
from mfc_analysis.design.searches import Tick, shown
from mfc_analysis.errors import BadArgument, MfcError
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import Requirements

RESERVE = 1e-3  #: distance kept to each limit, relative to it: what may lie between the places that are checked
TIGHT = 0.02  #: relative distance below which a requirement binds
STEPS = 10  #: of the scan of the first gain
GRID = {0: 1, 1: 7, 2: 5}  #: values of each of the other gains in the first scan, by their number; 3 for more
CLOSE = 1e-3  #: relative accuracy of the gains
MOST_TRIES = 60  #: values of the other gains that the search tries
MOST_ROUNDS = 6  #: with more places
FINER = 10  #: times between two given ones, near the worst
ONE_HERTZ = 2 * np.pi  #: [rad/s]

Gains = dict[str, float]
Case = dict[str, float]


@dataclass(frozen=True, eq=False)
class Tuned(Shown):
    """The gains found. ``make_loop(**gains, **case)`` is the loop of a case again."""

    gains: Gains
    met: bool  #: all requirements, over the path and the ranges; False: no gains within the bounds do, and these miss least
    loop: ClosedLoop  #: with these gains, in the case that is the tightest
    case: Case  #: that case
    speed: float  #: [rad/s] ``bandwidth`` where that is tuned, else the smallest crossover of the loop
    binding: tuple[Line, ...]  #: the requirements that bind (or are missed), the tightest first, of that case
    breaks: tuple[Line, ...]  #: the requirements missed with a bandwidth one hertz higher; empty: none
    more: Gains  #: the gains of that bandwidth
    evaluations: int  #: loops judged

    def __str__(self) -> str:
        case = f" at {', '.join(f'{name} = {x:.4g}' for name, x in self.case.items())}" if self.case else ""
        lines = [f"{', '.join(f'{name} = {x:.6g}' for name, x in self.gains.items())} ({self.evaluations} loops checked)"]
        verdict = "meets all requirements" if self.met else "no gains within the bounds meet the requirements"
        lines.append(f"  {verdict}; {self.speed:.4g} rad/s = {self.speed / ONE_HERTZ:.4g} Hz")
        word = "binds" if self.met else "missed"
        lines += [f"  {word}: {_told(line)}{case}" for line in self.binding] or [f"  nothing binds{case}: the bounds of the gains end the search"]
        if self.met:
            lines += [f"  one more hertz misses: {_told(line)}" for line in self.breaks] or ["  one more hertz misses nothing"]
        return "\n".join(lines)

    __repr__ = __str__

    @property
    def replay(self) -> str:
        """Python code that rebuilds ``loop``."""
        from mfc_analysis.requirements.replay import replay

        return str(replay(self.loop))


def _told(line: Line) -> str:
    _, label, found, asked, _, place, _ = line.cells()
    return f"{label}: found {found}, asked {asked}{f' ({place})' if place else ''}"


def tune(
    make_loop: Callable[..., ClosedLoop],
    gains: Mapping[str, tuple[float, float]],
    requirements: Requirements,
    times: ArrayLike = (0.0,),
    *,
    ranges: Mapping[str, Sequence[float]] | None = None,
    wanted: float | None = None,
    start: Mapping[str, float] | None = None,
    at: str | None = None,
    progress: bool = False,
) -> Tuned:
    """The fastest gains that meet all requirements at all times and over all ranges.

    Args:
        make_loop: ``make_loop(**gains, **case)`` -> loop, such as one that takes ``bandwidth``, ``damping`` and ``payload``.
        gains: name -> (low, high), 0 < low < high: keywords of ``make_loop``, such as "bandwidth" and "damping" of a helper, or gains of a law.
        requirements: to be met. times: (m,) [s]. at: analysis point; None: the plant input. progress: a bar on the terminal.
        ranges: name -> values (two: the ends of a range). Every combination counts.
        wanted: [rad/s] of ``bandwidth``: the nearest to it that meets the requirements, with the largest distance to them; None: the fastest.
        start: of the other gains; omitted: 1 for ``damping``, as the helpers have it, and the middle of the others.

    A result keeps a relative 1e-3 to each limit, and is the same each time. WATCH counts as met. Raises BadArgument, and the last error of
    ``make_loop`` where no loop can be built.
    """
    if not callable(make_loop):
        raise BadArgument("make_loop", make_loop, "a function of the gains and the parameters that returns a ClosedLoop")
    bounds = _bounds(gains)
    names = sorted(bounds, key=lambda name: name != "bandwidth")
    if wanted is not None:
        wanted = checks.number("wanted", wanted, low=0.0, strict=True)
        if "bandwidth" not in bounds:
            raise BadArgument("wanted", wanted, "a gain 'bandwidth' with it")
    begin = {name: _middle(name, bounds[name]) for name in names} | {k: checks.number(f"start[{k!r}]", v) for k, v in (start or {}).items()}
    if unknown := sorted(set(begin) - set(names)):
        raise BadArgument("start", unknown, f"values of {', '.join(names)}")
    axes = {name: _values(f"ranges[{name!r}]", given) for name, given in (ranges or {}).items()}
    places = _Places(make_loop, Judge(requirements, checks.times(times), at), axes)
    with shown(progress, f"gains: {names[0]}") as tick:
        orders = [names] if names[0] == "bandwidth" else [[name, *(x for x in names if x != name)] for name in names]
        searches = [_Search(places, order, bounds, begin, wanted, tick) for order in orders]
        _, x, search = max(((*one.solved(), one) for one in searches), key=lambda found: found[0])
        for _ in range(MOST_ROUNDS):
            if not search.met(x) or places.confirmed(x):
                break
            x = search.solved(near=x)[1]
        else:
            while search.met(x) and not places.confirmed(x) and x[search.names[0]] * (1 - CLOSE) > bounds[search.names[0]][0]:
                x = x | {search.names[0]: x[search.names[0]] * (1 - CLOSE)}
    return _tuned(places, search.names[0], x)


def _bounds(gains: Any) -> dict[str, tuple[float, float]]:
    if not isinstance(gains, Mapping) or not gains:
        raise BadArgument("gains", gains, "a mapping of names to (low, high), such as {'bandwidth': (1.0, 80.0)}")
    out = {}
    for name, given in gains.items():
        low, high = (float(x) for x in checks.array(f"gains[{name!r}]", given, (2,), "(low, high) with 0 < low < high"))
        if not 0 < low < high:
            raise BadArgument(f"gains[{name!r}]", given, "(low, high) with 0 < low < high")
        out[str(name)] = (low, high)
    return out


def _middle(name: str, bounds: tuple[float, float]) -> float:
    return float(np.clip(1.0, *bounds)) if name == "damping" else float(np.sqrt(bounds[0] * bounds[1]))


def _values(name: str, given: Any) -> list[float]:
    values = checks.vector(name, given, "one or more values")
    if not values.size:
        raise BadArgument(name, given, "one or more values")
    return [float(x) for x in values]


# --- where the requirements are judged -----------------------------------------------------------------------------------


@dataclass(eq=False)
class _Places:
    """The places at which the requirements are judged: those that bind, and all of them to confirm a result."""

    make: Callable[..., ClosedLoop]
    judge: Judge
    axes: Mapping[str, list[float]]
    active: dict[tuple[float, ...], set[float]] = field(default_factory=dict)  #: case -> times
    newest: Gains = field(default_factory=dict)  #: the gains of the loops in ``built``
    built: dict[tuple[float, ...], ClosedLoop] = field(default_factory=dict)
    count: int = 0
    last: MfcError | None = None

    def __post_init__(self) -> None:
        asked = self.judge.requirements
        linear: dict[str, Any] = {name: limit for name, limit in asked.asked().items() if name not in GROUPS[-1]}
        self.linear = Requirements(**linear, horizon=asked.horizon, step=asked.step) if len(linear) < len(asked.asked()) else asked
        self.middle = tuple(values[len(values) // 2] for values in self.axes.values())
        t = self.judge.times
        for case in {self.middle, *itertools.product(*([min(v), max(v)] for v in self.axes.values()))}:
            self.active[case] = {float(t[0]), float(t[len(t) // 2]), float(t[-1])}

    def case(self, values: tuple[float, ...]) -> Case:
        return dict(zip(self.axes, values, strict=True))

    def loop(self, x: Gains, values: tuple[float, ...]) -> ClosedLoop:
        if x != self.newest:
            self.newest, self.built = dict(x), {}
        if values not in self.built:
            made = self.make(**x, **self.case(values))
            if not isinstance(made, ClosedLoop):
                raise BadArgument("make_loop", made, "a function that returns a ClosedLoop")
            self.built[values] = made
        return self.built[values]

    def distance(self, x: Gains) -> float:
        """The smallest distance to a limit, relative to it, at the active places, less the reserve; -inf: no such loop."""
        least, tightest = np.inf, None
        for values, times in self.active.items():
            here = self._at(x, values, np.array(sorted(times)))
            if here < least:
                least, tightest = here, values
            if least < 0:
                break
        if tightest is not None and least < 0:  # the first to be looked at next time
            self.active = {tightest: self.active[tightest]} | self.active
        return least

    def _at(self, x: Gains, values: tuple[float, ...], times: Array) -> float:
        self.count += 1
        try:
            loop = self.loop(x, values)
            found = Judge(self.linear, times, self.judge.at).distance(loop)
            if found >= 0 and self.linear is not self.judge.requirements:
                found = min(found, self.judge.distance(loop))
        except MfcError as why:
            self.last = why
            return -np.inf
        return found - RESERVE

    def confirmed(self, x: Gains) -> bool:
        """Whether the requirements are met everywhere; the places where they are not become active."""
        t, met = self.judge.times, True
        for values in itertools.product(*(sorted({*v, *(np.add(v[1:], v[:-1]) / 2)}) for v in self.axes.values())):
            for when in ([t] if self._at(x, values, t) < 0 else []) or self._finer(x, values):
                hit = self._worst_time(x, values, when)
                if hit is not None:
                    self.active.setdefault(values, set()).add(hit)
                    met = False
                    break
        return met

    def _finer(self, x: Gains, values: tuple[float, ...]) -> list[Array]:
        """Finer times about the worst given one, in the cases that bind."""
        t = self.judge.times
        if t.size == 1 or values not in self.active:
            return []
        i = int(np.argmin([self._at(x, values, t[k : k + 1]) for k in range(t.size)]))
        return [np.linspace(t[max(i - 1, 0)], t[min(i + 1, t.size - 1)], 2 * FINER + 1)]

    def _worst_time(self, x: Gains, values: tuple[float, ...], times: Array) -> float | None:
        each = [self._at(x, values, times[k : k + 1]) for k in range(times.size)]
        return float(times[int(np.argmin(each))]) if min(each) < 0 else None


# --- the search ----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Search:
    places: _Places
    names: list[str]
    bounds: Mapping[str, tuple[float, float]]
    start: Gains
    wanted: float | None
    tick: Tick
    known: dict[tuple[float, ...], float] = field(default_factory=dict)

    def distance(self, x: Gains) -> float:
        key = tuple(x[name] for name in self.names)
        if key not in self.known:
            self.tick(key[0])
            self.known[key] = self.places.distance(x)
        return self.known[key]

    def met(self, x: Gains) -> bool:
        return self.distance(x) >= 0

    def solved(self, near: Gains | None = None) -> tuple[float, Gains]:
        """Score and gains: the best gains at the active places; ``near``: those of fewer places, about which the search begins."""
        self.known.clear()
        others = self.names[1:]
        each = GRID.get(len(others), 3)
        grid = [np.geomspace(*self.bounds[name], each) for name in others]
        tries = [self.start] if near is None else [near]
        tries += [dict(zip(others, map(float, values), strict=True)) for values in itertools.product(*grid)] if near is None and others else []
        scored = [self._best(one, near) for one in tries]
        score, x = max(scored, key=lambda pair: pair[0])
        if not np.isfinite(score) and self.places.last is not None:
            raise self.places.last
        return self._refined(score, x, each, near) if others else (score, x)

    def _refined(self, score: float, x: Gains, each: int, near: Gains | None) -> tuple[float, Gains]:
        from scipy.optimize import minimize

        others, best = self.names[1:], (score, x)

        def cost(u: Array) -> float:
            nonlocal best
            low, high = (np.array([self.bounds[name][k] for name in others]) for k in (0, 1))
            theta = np.clip(np.exp(u), low, high)
            found = self._best(dict(zip(others, map(float, theta), strict=True)), best[1])
            if found[0] > best[0]:
                best = found
            return -found[0]

        limits = [tuple(np.log(self.bounds[name])) for name in others]
        u0 = np.array([np.log(x[name]) for name in others])
        step = np.array([(high - low) / max(each - 1, 1) / (2 if near is None else 8) for low, high in limits])
        simplex = np.vstack([u0, *(u0 + np.where(u0 + d > [high for _, high in limits], -d, d) for d in np.diag(step))])
        options = {"initial_simplex": simplex, "xatol": CLOSE, "fatol": 0.1 * CLOSE, "maxfev": MOST_TRIES * len(others) // (1 if near is None else 2)}
        minimize(cost, u0, method="Nelder-Mead", bounds=limits, options=options)
        return best

    def _best(self, others: Gains, near: Gains | None = None) -> tuple[float, Gains]:
        """Score and gains with the best first gain for these others. Scores: met above 0 (a speed, or a distance), missed below -1e3."""
        main = self.names[0]

        def at(b: float) -> Gains:
            return {main: b} | {name: others[name] for name in self.names[1:]}

        low, high = self.bounds[main]
        if self.wanted is not None:
            b = float(np.clip(self.wanted, low, high))
            reserve = self.distance(at(b))
            if reserve >= 0:
                return 1e3 + min(reserve, 1e2), at(b)
        grid = np.geomspace(low, high, STEPS + 1)[::-1]
        if near is not None and self.wanted is None:
            grid = np.clip(near[main] * np.geomspace(1.2, 1 / 1.2, 3), low, high)
            if self.met(at(float(grid[0]))) and grid[0] < high:
                grid = np.geomspace(float(grid[0]), high, STEPS + 1)[::-1]
        if self.wanted is not None:
            grid = np.array(sorted(grid, key=lambda b: abs(np.log(b / self.wanted))))
        distances = []
        for i, b in enumerate(map(float, grid)):
            distances.append(self.distance(at(b)))
            if distances[-1] < 0:
                continue
            b = b if self._ends(i) else self._pushed(at, b, self.wanted if self.wanted is not None else float(grid[i - 1]))
            return (self._speed(at(b)), at(b)) if self.wanted is None else (1.0 - abs(float(np.log(b / self.wanted))), at(b))
        if near is not None:
            return self._best(others)
        i = int(np.argmax(distances))
        return -1e3 + max(distances[i], FLOOR) if np.isfinite(distances[i]) else -np.inf, at(float(grid[i]))

    def _ends(self, i: int) -> bool:
        """True where the first value of the grid meets the requirements: the bound ends the search."""
        return i == 0 and self.wanted is None

    def _pushed(self, at: Callable[[float], Gains], holds: float, lost: float) -> float:
        """From a value that meets the requirements towards one that does not."""
        a, b = self.distance(at(holds)), max(self.distance(at(lost)), FLOOR)
        turn = False
        while abs(lost - holds) > 0.1 * CLOSE * holds:
            share = 0.5 if turn or not np.isfinite(a) else float(np.clip(a / (a - b), 0.02, 0.98))
            middle = holds + share * (lost - holds)
            found = self.distance(at(middle))
            if found >= 0:
                holds, a = middle, found
            else:
                lost, b = middle, max(found, FLOOR)
            turn = not turn
        return holds

    def _speed(self, x: Gains) -> float:
        """Logarithm of the bandwidth, or of the smallest crossover; of the loop in the middle of the ranges."""
        if self.names[0] == "bandwidth":
            return float(np.log(x["bandwidth"])) + 50.0
        return float(np.log(_crossover(self.places.loop(x, self.places.middle), self.places.judge))) + 50.0


def _crossover(loop: ClosedLoop, judge: Judge) -> float:
    """Smallest crossover [rad/s] of a loop over its channels and times; NaN where it has none."""
    found = loop.linearize(judge.times, horizon=judge.requirements.horizon).margins(judge.at or loop.default_at).crossover
    some = found[np.isfinite(found) & (found > 0)]
    return float(some.min()) if some.size else np.nan


def _tuned(places: _Places, main: str, x: Gains) -> Tuned:
    """The result: what binds in the tightest case, and what one more hertz misses."""
    cases = [*itertools.product(*places.axes.values())]
    judge = places.judge
    verdicts = {values: judge.check(places.loop(x, values)) for values in cases}
    tightest = max(cases, key=lambda values: verdicts[values].worst.severity)
    verdict = verdicts[tightest]
    loop = places.loop(x, tightest)
    speed = x["bandwidth"] if "bandwidth" in x else _crossover(places.loop(x, places.middle), judge)
    met = all(not verdict.failed for verdict in verdicts.values())
    binding = tuple(line for line in verdict.lines if line.name != "stable" and -line.severity[1] < TIGHT) if met else verdict.failed
    more = x | {main: x[main] * (1 + ONE_HERTZ / speed)} if np.isfinite(speed) else x
    breaks: dict[str, Line] = {}
    for values in cases if met and more is not x else ():
        for line in judge.check(places.loop(more, values)).lines:
            if line.status is Status.FAIL and (line.name not in breaks or line.severity > breaks[line.name].severity):
                breaks[line.name] = line
    return Tuned(x, met, loop, places.case(tightest), float(speed), binding, tuple(breaks.values()), more, places.count)
