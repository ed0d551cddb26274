"""The value of a quantity at which the requirements are just met, searched from the value of the loop as given.

The search goes away from that value, in the direction that is harder for the loop, to the first value at which a requirement is missed. Where
the loop misses one as given, it goes towards easier values to the first one that meets them all. In between the limit is the root of the
tightest distance to a requirement, to a relative ``NEAR``. A loss narrower than one step of the scan can be missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from mfc_analysis.analysis.loop_step import SettlingStep
from mfc_analysis.design.ahead import Ahead
from mfc_analysis.design.searches import Limit, Outcome, shown
from mfc_analysis.errors import BadArgument
from mfc_analysis.loop import ClosedLoop
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array
from mfc_analysis.requirements.evidence import Evidence
from mfc_analysis.requirements.line import Line, Status
from mfc_analysis.requirements.requirements import Requirements, Verdict, compared

NEAR = 1e-5  #: relative width at which a search ends
FLOOR = -10.0  #: distance of a loop that is not stable, and the lowest one that is interpolated
USUAL_ROOM = 1e-3  #: [s] of dead time where the loop as given has no delay margin
#: metrics in the order of their cost; a search looks at the next ones only where these are met
GROUPS = (
    ("gain_increase_db", "gain_reduction_db", "phase_deg", "delay", "sensitivity_peak"),
    ("disk_margin",),
    ("damping_ratio", "settling_time", "overshoot"),
    ("tracking_error", "torque_fraction"),
)

Make = Callable[[float], ClosedLoop | Sequence[ClosedLoop]]


class Quantity(NamedTuple):
    """What is varied."""

    name: str  #: of the limit, in words
    unit: str
    rate: bool = False  #: True: the search varies the period 1/x


QUANTITIES = {
    "payload": Quantity("largest payload", "kg"),
    "delay": Quantity("largest dead time", "s"),
    "bandwidth": Quantity("largest bandwidth", "rad/s"),
    "stiffness": Quantity("largest stiffness", "N/m"),
    "sample_time": Quantity("smallest sample rate", "1/s", rate=True),
}


@dataclass(frozen=True, eq=False)
class Judge:
    """The requirements on the loops of one or several searches; each loop is judged once.

    Args:
        times: (m,) [s]. at: analysis point; None: the plant input.
    """

    requirements: Requirements
    times: Array
    at: str | None = None
    _known: dict[ClosedLoop, float] = field(default_factory=dict, init=False, repr=False)
    _rooms: dict[ClosedLoop, float] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        checks.instance("requirements", self.requirements, Requirements, "a Requirements, such as mfc.Requirements(phase_deg=45)")
        object.__setattr__(self, "times", checks.times(self.times))

    def distance(self, loop: ClosedLoop) -> float:
        """The smallest distance to a limit, relative to it; at least 0: all met. -inf: not stable, or a metric that is not defined.

        It stops at the first group of metrics with a limit missed. WATCH counts as met.
        """
        if loop not in self._known:
            self._known[loop] = self._distance(loop)
        return self._known[loop]

    def _distance(self, loop: ClosedLoop) -> float:
        asked, step = self.requirements.asked(), self.requirements.step
        evidence = self._evidence(loop, step)
        if not evidence.judged.all():
            return -np.inf
        least = np.inf
        for group in GROUPS:
            lines = [compared(name, asked[name], evidence.found(name), step) for name in group if name in asked]
            least = min([least, *(-line.severity[1] for line in lines)])
            if least < 0:
                break
        return least

    def _evidence(self, loop: ClosedLoop, step: SettlingStep = "reference") -> Evidence:
        return Evidence(loop.equations, self.times, self.at, self.requirements.horizon, step)

    @property
    def count(self) -> int:
        """Number of loops judged."""
        return len(self._known)

    def worst(self, loops: Sequence[ClosedLoop]) -> tuple[float, ClosedLoop]:
        """The tightest of several loops; the first one that misses a requirement ends the comparison."""
        least, tightest = np.inf, loops[0]
        for loop in loops:
            distance = self.distance(loop)
            if distance < least:
                least, tightest = distance, loop
            if least < 0:
                break
        return least, tightest

    def distances(self, loops: Sequence[ClosedLoop]) -> list[float]:
        """The distances of the loops that ``worst`` compares."""
        self.worst(loops)
        return [self._known[loop] for loop in loops if loop in self._known]

    def learn(self, loops: Sequence[ClosedLoop], distances: Sequence[float]) -> None:
        """What another process found for the first of these loops."""
        for loop, distance in zip(loops, distances, strict=False):
            self._known.setdefault(loop, distance)

    def check(self, loop: ClosedLoop) -> Verdict:
        """The verdict with all its lines."""
        return self.requirements.check(loop, self.times, self.at)

    def room(self, loop: ClosedLoop) -> float:
        """Smallest delay margin [s] at the plant input, the scale of a search of times."""
        if loop not in self._rooms:
            margins = Evidence(loop.equations, self.times, None, self.requirements.horizon).margins.delay
            some = margins[np.isfinite(margins) & (margins > 0)]
            self._rooms[loop] = float(some.min()) if some.size else USUAL_ROOM
        return self._rooms[loop]


class Edge(NamedTuple):
    """The last value that meets the requirements and the first that does not."""

    holds: float  #: NaN if none does
    lost: float  #: NaN if all do
    start: float  #: the first value of the interval that meets them; NaN: the value given


class _Way(NamedTuple):
    """The values of a search, each list in order away from the value given."""

    harder: Array
    easier: Array
    nominal: float
    other: bool = False  #: True: where no easier value meets the requirements, a harder one may

    def after(self, x: float) -> list[float]:
        """The values that a scan asks for after x, if it finds nothing; none within an interval."""
        for values in (np.append(self.nominal, self.harder), self.easier):
            found = np.flatnonzero(values == x)
            if found.size:
                return [float(one) for one in values[found[0] + 1 :]]
        return []


def requirement_limit(
    make: Make, quantity: str, nominal: float, judge: Judge, *, lower: float = 0.0, upper: float = np.inf, progress: bool = False,
    n_jobs: int | None = None,
) -> Limit:  # fmt: skip
    """The limit of a quantity of ``QUANTITIES`` at which the requirements are just met, from its value ``nominal`` in the loop as given.

    Args:
        make: value -> the loop, or several that must all meet them; a rate is given as its period [s]. lower: start of the search. upper: its end.
        n_jobs: processes, as in ``limits``; they judge the next values of the scan.

    ``Limit.binding`` is the requirement missed just beyond it. Where the loop as given misses a requirement, the limit is the nearest value that
    meets them all, and a note says what is missed; 0 (a rate: inf) if no value does. Raises BadArgument, and any error of ``make``.
    """
    about = QUANTITIES[quantity]
    made: dict[float, list[ClosedLoop]] = {}
    ahead = Ahead(_Apart(make, Judge(judge.requirements, judge.times, judge.at)), n_jobs)

    def loops(x: float) -> list[ClosedLoop]:
        if x not in made:
            made[x] = _made(make, x)
        return made[x]

    def told(x: float) -> float:
        return (1 / x if x else np.inf) if about.rate else x

    known: dict[float, float] = {}
    before = judge.count
    with shown(progress, f"{about.name} [{about.unit}]") as tick:

        def distance(x: float) -> float:
            if x not in known:
                tick(told(x))
                if ahead.workers > 1:
                    judge.learn(loops(x), ahead(x, way.after(x)))
                known[x] = judge.worst(loops(x))[0]
            return known[x]

        way = _way(quantity, nominal, loops(nominal)[0], judge, lower, upper)
        edge = first_edge(distance, nominal, way.harder, way.easier, other=way.other)
    count = judge.count - before
    missed = _missed(judge, loops(nominal)) if distance(nominal) < 0 else None
    if np.isnan(edge.holds):
        assert missed is not None
        tried = [nominal, *way.easier[-1:], *(way.harder[-1:] if way.other else ())]
        ends = sorted(told(float(x)) for x in tried)
        span = (
            f"no value from {ends[0]:.4g} to {ends[-1]:.4g} {about.unit} meets the requirements" if ends[0] < ends[-1] else "there is no easier value"
        )
        binds = f"{span}; as given {missed[1]}"
        return Limit(np.inf if about.rate else 0.0, about.name, about.unit, Outcome.NOWHERE, binds, missed[0], missed[0], count, (), missed[2])
    loop = judge.worst(loops(edge.holds))[1]
    notes = []
    if not np.isnan(edge.start):
        notes.append(f"the requirements are missed from {told(nominal):.6g} up to {told(edge.start):.4g} {about.unit}: {missed[1] if missed else ''}")
    elif missed:
        notes.append(f"the requirements are missed at {told(nominal):.6g} {about.unit}, as given: {missed[1]}")
    watch = [line for line in judge.check(loop).lines if line.status is Status.WATCH]
    notes += [f"WATCH at the limit: {line.label}, {line.note}" for line in watch]
    if np.isnan(edge.lost):
        last = told(edge.holds)
        binds = f"the requirements are met {'down' if about.rate else 'up'} to {last:.6g} {about.unit}"
        return Limit(0.0 if about.rate else np.inf, about.name, about.unit, Outcome.UNLIMITED, binds, loop, None, count, tuple(notes))
    beyond, said, binding = _missed(judge, loops(edge.lost))
    if about.rate and edge.holds:
        notes.insert(0, f"sample time {edge.holds:.6g} s")
    return Limit(told(edge.holds), about.name, about.unit, Outcome.FOUND, f"beyond it {said}", loop, beyond, count, tuple(notes), binding)


def _made(make: Make, x: float) -> list[ClosedLoop]:
    given = make(x)
    out = [given] if isinstance(given, ClosedLoop) else list(given)
    if not out or not all(isinstance(loop, ClosedLoop) for loop in out):
        raise BadArgument("make_loop", given, "a function that returns a ClosedLoop or several")
    return out


@dataclass(frozen=True, eq=False)
class _Apart:
    """The distances of the loops at a value, by a judge that knows nothing yet: what another process is asked for."""

    make: Make
    judge: Judge

    def __call__(self, x: float) -> list[float]:
        return replace(self.judge).distances(_made(self.make, x))


def first_edge(
    distance: Callable[[float], float], nominal: float, harder: Sequence[float] | Array, easier: Sequence[float] | Array, *, other: bool = False
) -> Edge:
    """The edge nearest to ``nominal`` of the values with a distance of at least 0: among the harder ones where it holds there, else the easier.

    ``other``: where no easier value holds, the first harder one that does begins the search.
    """
    if distance(nominal) >= 0:
        return _onward(distance, nominal, harder, np.nan)
    last = nominal
    for x in map(float, easier):
        if distance(x) >= 0:
            return Edge(*_narrowed(distance, x, last), np.nan)
        last = x
    for i, x in enumerate(map(float, harder) if other else ()):
        if distance(x) >= 0:
            start, _ = _narrowed(distance, x, float(harder[i - 1]) if i else nominal)
            return _onward(distance, x, harder[i + 1 :], start)
    return Edge(np.nan, nominal, np.nan)


def _onward(distance: Callable[[float], float], holds: float, values: Sequence[float] | Array, start: float) -> Edge:
    for x in map(float, values):
        if distance(x) < 0:
            return Edge(*_narrowed(distance, holds, x), start)
        holds = x
    return Edge(holds, np.nan, start)


def _narrowed(distance: Callable[[float], float], holds: float, lost: float) -> tuple[float, float]:
    """(holds, lost) a relative ``NEAR`` apart, by Brent's method; it bisects where the distance jumps."""
    from scipy.optimize import brentq

    sides = {True: [holds], False: [lost]}

    def clipped(x: float) -> float:
        value = distance(x)
        sides[value >= 0].append(x)
        return float(np.clip(value, 1e-12, -FLOOR) if value >= 0 else max(value, FLOOR))

    low, high = sorted((holds, lost))
    brentq(clipped, low, high, xtol=1e-3 * NEAR * max(abs(low), abs(high)), rtol=np.float64(0.5 * NEAR))
    return min(((a, b) for a in sides[True] for b in sides[False]), key=lambda pair: abs(pair[0] - pair[1]))


def _missed(judge: Judge, loops: Sequence[ClosedLoop]) -> tuple[ClosedLoop, str, Line]:
    """The loop that misses a requirement, what is missed in words, and its line."""
    loop = judge.worst(loops)[1]
    line = judge.check(loop).worst
    if line.name == "stable":
        return loop, f"the loop is not stable: {line.note.removeprefix('unstable: ')}", line
    _, label, found, asked, _, place, note = line.cells()
    where = "; ".join(part for part in (place, note if np.isnan(line.found) else "") if part)
    return loop, f"{label} is missed: found {found}, asked {asked}{f' ({where})' if where else ''}", line


def _way(quantity: str, nominal: float, loop: ClosedLoop, judge: Judge, lower: float, upper: float) -> _Way:
    """The values of a search: first within its natural scale, then geometrically."""
    if quantity in ("stiffness", "bandwidth"):
        up = _geometric(nominal, upper)
        return _Way(up, _geometric(nominal, lower, 4), nominal, other=True)
    unit = loop.robot.total_mass / 4 if quantity == "payload" else judge.room(loop) * (2 if quantity == "sample_time" else 1)
    away = np.concatenate([unit * np.array([0.25, 0.5, 0.75, 1.0]), _geometric(unit, max(upper - nominal, unit))])
    harder = np.append(nominal + away[away < upper - nominal], upper)
    if quantity == "sample_time":
        return _Way(harder, _geometric(nominal, lower, 4) if nominal else np.zeros(0), nominal)
    return _Way(harder, np.linspace(nominal, lower, 9)[1:] if nominal > lower else np.zeros(0), nominal)


def _geometric(start: float, end: float, steps: int = 8) -> Array:
    """Values from ``start`` (left out) to ``end``, ``steps`` to a decade."""
    if start == end:
        return np.zeros(0)
    count = max(int(np.ceil(steps * abs(np.log10(end / start)))), 1)
    return np.asarray(np.geomspace(start, end, count + 1)[1:])
