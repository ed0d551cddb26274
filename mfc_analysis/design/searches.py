"""Search for the value at which a condition is lost: a logarithmic scan, its first loss, then bisection. No monotonicity is assumed.

An interval of loss narrower than one step of the scan can be missed; the scan has ``STEPS`` steps per decade.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Self, cast

import numpy as np

from mfc_analysis.design.ahead import Ahead
from mfc_analysis.errors import BadArgument
from mfc_analysis.maths.arrays import Array
from mfc_analysis.notebook import Shown

if TYPE_CHECKING:
    from mfc_analysis.loop import ClosedLoop
    from mfc_analysis.requirements.line import Line


STEPS = 8  #: steps of the scan per decade
WIDEST = 1e30  #: largest ratio of the ends of a scan
CLOSE = 1e-7  #: relative width at which bisection ends

Tick = Callable[[float], None]


class Outcome(Enum):
    """Outcome of a search; the value is a sentence."""

    FOUND = "the limit is known to a relative 1e-5"
    UNLIMITED = "the condition holds up to the end of the search"
    NOWHERE = "the condition holds nowhere in the search"


@dataclass(frozen=True)
class Bracket:
    """The last value at which the condition holds and the first at which it does not."""

    holds: float  #: NaN if it holds nowhere
    lost: float  #: NaN if it is never lost
    outcome: Outcome
    before: float | None  #: below ``holds``, the condition also fails up to this value of the scan
    evaluations: int


class Limit(Shown, float):
    """A limit found by a search: a float with the limiting condition and the loop at the limit.

    ``loop`` is the closed loop at the last value at which the condition holds; it can be linearised, simulated or checked.
    """

    name: str  #: quantity searched
    unit: str  #: of the limit
    outcome: Outcome  #: how the search ended
    binds: str  #: condition lost beyond the limit, a sentence
    loop: ClosedLoop  #: at the limit
    beyond: ClosedLoop | None  #: the loop at the first value at which the condition fails; None where there is none
    evaluations: int  #: number of loops checked
    notes: tuple[str, ...]  #: remarks, a sentence each
    binding: Line | None  #: the requirement (or "stable") missed just beyond the limit, with its joint and time; None where none is

    def __new__(
        cls, value: float, name: str = "", unit: str = "", outcome: Outcome = Outcome.FOUND, binds: str = "", loop: ClosedLoop | None = None,
        beyond: ClosedLoop | None = None, evaluations: int = 0, notes: tuple[str, ...] = (), binding: Line | None = None,
    ) -> Self:  # fmt: skip
        self = super().__new__(cls, value)
        self.name, self.unit, self.outcome, self.binds = name, unit, outcome, binds
        self.loop = cast("ClosedLoop", loop)  # None only while it is unpickled
        self.beyond, self.evaluations, self.notes, self.binding = beyond, evaluations, notes, binding
        return self

    def __getnewargs__(self) -> tuple[float]:
        return (float(self),)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        head = f"{self.name}: {float(self):.6g}{unit} ({self.evaluations} loops checked)"
        return "\n".join([head, f"  {self.binds or self.outcome.value}", *(f"  note: {note}" for note in self.notes)])

    __repr__ = __str__

    @property
    def pose(self) -> dict[str, float]:
        """Joint angles [rad, m] by name at the time of ``binding``, on the reference; empty where nothing binds."""
        loop = self.beyond or self.loop
        if self.binding is None or self.binding.when is None:
            return {}
        q = loop.nominal([self.binding.when]).q[0]
        return {name: float(x) for name, x in zip(loop.robot.joint_names, q, strict=True)}

    @property
    def replay(self) -> str:
        """Python code that rebuilds the loop at the limit."""
        from mfc_analysis.requirements.replay import replay

        return str(replay(self.loop))


def scan(lower: float, upper: float, steps: int = STEPS) -> Array:
    """Values from ``lower`` to ``upper``, equally spaced on a logarithmic scale, ``steps`` per decade. Raises BadArgument."""
    if not 0 < lower < upper < np.inf or upper > WIDEST * lower:
        raise BadArgument("upper", upper, f"a finite number above {lower:g}, and at most {WIDEST:g} times as large")
    return np.geomspace(lower, upper, max(2, int(np.ceil(steps * np.log10(upper / lower))) + 1))


def first_loss(
    holds: Callable[[float], bool], values: Array, *, skip: bool = True, tick: Tick = lambda x: None, n_jobs: int | None = None,
    together: Callable[[Sequence[float]], Sequence[bool] | None] | None = None,
) -> Bracket:  # fmt: skip
    """The first loss along increasing values, located by bisection.

    ``skip``: initial values at which the condition fails are skipped (``Bracket.before``); otherwise they end the search. ``tick`` is called
    with each value; ``n_jobs`` and ``together`` as in ``Ahead``, with the same numbers.
    """
    count, last, before = 0, np.nan, None
    ahead = Ahead(holds, n_jobs, together)
    ascending = [float(x) for x in values]
    for i, x in enumerate(ascending):
        count += 1
        tick(x)
        if ahead(x, ascending[i + 1 :]):
            last = x
            continue
        if np.isnan(last):
            before = x
            if skip:
                continue
            return Bracket(np.nan, before, Outcome.NOWHERE, before, count)
        low, high, more = bisected(ahead, last, x, tick)
        return Bracket(low, high, Outcome.FOUND, before, count + more)
    if np.isnan(last):
        return Bracket(np.nan, ascending[0], Outcome.NOWHERE, before, count)
    return Bracket(last, np.nan, Outcome.UNLIMITED, before, count)


def bisected(ahead: Ahead[float, bool], low: float, high: float, tick: Tick = lambda x: None) -> tuple[float, float, int]:
    """(low, high, evaluations): holds at low, not at high, a relative ``CLOSE`` apart. Geometric bisection; arithmetic from zero."""
    count = 0
    while _apart(low, high):
        middle = _middle(low, high)
        count += 1
        tick(middle)
        if ahead(middle, _middles(low, high)):
            low = middle
        else:
            high = middle
    return low, high, count


def _apart(low: float, high: float) -> bool:
    return high - low > CLOSE * high and high >= 1e-300


def _middle(low: float, high: float) -> float:
    return float(np.sqrt(low * high)) if low > 0.1 * high else 0.5 * (low + high)


def _middles(low: float, high: float) -> Iterator[float]:
    """The values that a bisection asks for, whatever it finds: the first, then the two that may follow it, the four after these..."""
    waiting = deque([(low, high)])
    while waiting:
        low, high = waiting.popleft()
        if _apart(low, high):
            middle = _middle(low, high)
            yield middle
            waiting += [(low, middle), (middle, high)]


@contextmanager
def shown(progress: bool, title: str) -> Iterator[Tick]:
    """A line on the terminal with the value being checked, if ``progress``."""
    if not progress:
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status(title) as status:
        yield lambda x: status.update(f"{title}: {x:.6g}")
