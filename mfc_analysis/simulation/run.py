"""One simulation run: segments of the equations in scipy's ``solve_ivp``. No other file integrates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from mfc_analysis.dynamics.environment import LoseContact
from mfc_analysis.dynamics.equations import Equations, Inputs
from mfc_analysis.errors import BadArgument, MfcError
from mfc_analysis.maths.arrays import Array
from mfc_analysis.simulation.touching import Event, Touching

Disturbance = Callable[[float], Array]
Guard = Callable[[Callable[[float, Array], Array], float], Callable[[float, Array], Array]]


FAR = 1e4  #: [rad, m, rad/s, m/s] above this position or velocity a run has diverged


FASTEST = 1e15  #: [1/s of any state] above this rate the solver would not finish


MOST = 100_000  #: evaluations that a run takes at most for a joint law without surfaces: about 10 s of work


COST = {"joint": 1.0, "tool": 5.0, "tool force": 12.0, "push": 1.5, "turn": 3.5}  #: time of an evaluation by the law, and that of each surface


SOLVER = {"LSODA": 0.0, "RK23": 1.0, "RK45": 1.0, "DOP853": 1.0, "Radau": 5.0, "BDF": 5.0}  #: time of the solver itself for each evaluation, likewise


STEP = 10_000  #: evaluations beyond the limit after which the step under way has no end


JACOBIAN = 4  #: evaluations that take about as long as one of the Jacobian


HELD = 0.25  #: evaluations that take about as long as one of the plant alone, under a held command


CONTACT_STEP = 2e-3  #: [s] longest step where contact can be lost, so that no short contact is missed


def cost(e: Equations) -> float:
    """Time of one evaluation, in evaluations of a joint law without surfaces."""
    law = "tool force" if e.law.space == "tool" and e.law.senses_force else e.law.space
    return COST[law] + sum(COST["push" if max(s.index) < 3 else "turn"] for s in e.surfaces)


def most_evaluations(e: Equations) -> int:
    """The limit of a run for which none is given: about 10 s of work, whatever an evaluation of these equations costs."""
    return int(MOST / cost(e))


class Outcome(Enum):
    """How a run ended."""

    FINISHED = "the run reached its end"
    DIVERGED = "the motion diverged"
    REFUSED = "the law could not be evaluated"
    SOLVER = "the solver failed"
    STOPPED = "the run was stopped"


class DenseOutput:
    """Dense output assembled from segments."""

    def __init__(self, t0: float, x0: Array) -> None:
        self.starts: list[float] = [t0]
        self.pieces: list[Callable[[float], Array]] = []
        self.first = x0

    def add(self, end: float, piece: Callable[[float], Array]) -> None:
        self.pieces.append(piece)
        self.starts.append(end)

    def at(self, t: float) -> Array:
        if t <= self.starts[0] or not self.pieces:
            return self.first
        late = t + 1e-12 * max(1.0, abs(t))  # at a sampling instant: what the law holds after it
        i = min(max(int(np.searchsorted(self.starts, late, side="right")) - 1, 0), len(self.pieces) - 1)
        return np.asarray(self.pieces[i](min(t, self.starts[i + 1])))


@dataclass(eq=False)
class Run:
    """One run in progress: the part that the three integration methods share."""

    equations: Equations
    disturbance: Disturbance | None
    options: dict[str, Any]
    path: DenseOutput
    events: list[Event]
    end: float = np.inf  #: [s] where the run is to end
    most: int = MOST  #: evaluations allowed
    spent: float = 0.0  #: evaluations so far
    outcome: Outcome = Outcome.FINISHED
    message: str = Outcome.FINISHED.value
    refused: MfcError | None = None
    arrived: Callable[[float], Array] | None = None  #: with dead time or sampling: the command that has reached the joints
    touching: Touching | None = field(init=False, default=None)  #: None without a one-sided surface
    _changed: bool = False  #: the last piece ended where contact changes

    def __post_init__(self) -> None:
        if any(s.one_sided for s in self.equations.surfaces):
            self.touching = Touching(self.equations, self.path.first)

    @cached_property
    def price(self) -> float:
        return cost(self.equations)

    def inputs(self, t: float) -> Inputs:
        return Inputs() if self.disturbance is None else Inputs(disturbance=self.disturbance(t))

    @property
    def lose_contact(self) -> LoseContact:
        """For the equations at this time of the run: the axes of one-sided surfaces that are touched."""
        return False if self.touching is None else self.touching.axes

    def integrate(
        self, rates: Callable[[float, Array], Array], start: float, end: float, x: Array, jac: Any = None, short: bool = False, cost: float = 1.0,
        record: Callable[[float, float], None] | None = None,
    ) -> Array | None:  # fmt: skip
        """Integrates from start to end and adds to the path. Returns the final state, None where the run has stopped.

        Where contact is made or lost a piece ends and the solver starts again, so that no step contains a jump of the force.
        ``short``: one of many short segments. These use explicit Runge-Kutta, since a multistep method would restart on each.
        ``cost``: of the rates, in evaluations of the equations. ``record(begin, stop)`` sees each piece before contact changes.
        """
        now: Array | None = x
        while now is not None:
            begin, now = start, self._piece(rates, start, end, now, jac, short, cost)
            start = self.path.starts[-1]
            if now is not None and record is not None:
                record(begin, start)
                now = now if self.outcome is Outcome.FINISHED else None
            if now is not None and self.touching is not None and self._changed:
                self.events += self.touching.switch(start, now)
            if end - start <= 1e-14 * max(1.0, abs(end)):
                break
        return now

    def _piece(
        self, rates: Callable[[float, Array], Array], start: float, end: float, x: Array, jac: Any, short: bool, cost: float
    ) -> Array | None:  # fmt: skip
        """``integrate`` up to ``end`` or to where contact changes."""
        self.spent += 1
        if self.spent >= self.most:
            self._give_up(start)
            return None
        if not np.isfinite(x).all():
            self.stop(Outcome.DIVERGED, start, "the state is not finite")
            return None
        options = dict(self.options)
        if short and options["method"] == "LSODA":
            options.update(method="DOP853" if options["rtol"] < 1e-8 else "RK45", first_step=end - start)
        if self.touching is not None:
            options["max_step"] = CONTACT_STEP

        def solve(guard: Guard, options: dict[str, Any]) -> Any:
            f = guard(rates, cost + SOLVER[options["method"]] / self.price)
            if jac is not None and options["method"] in ("LSODA", "Radau", "BDF"):
                options["jac"] = self._counted(jac)
            events = [self._far(), self._used_up(), *([] if self.touching is None else [self.touching.change()])]
            with np.errstate(all="ignore"):
                return solve_ivp(f, (start, end), x, dense_output=True, events=events, **options)

        try:
            try:
                found = solve(self._stopping, options)
            except _Stop:  # perhaps only the trial step is too long: retry with a method that shortens it
                found = solve(self._or_nan, {**options, "method": "Radau" if jac is not None else "RK45", "first_step": None})
        except _Endless:
            self._give_up(start)
            return None
        self.path.add(float(found.t[-1]), found.sol)
        if found.t_events is not None and found.t_events[1].size:
            self._give_up(float(found.t[-1]))
            return None
        self._changed = self.touching is not None and found.t_events is not None and found.t_events[2].size > 0
        if (found.status == 1 and not self._changed) or not np.isfinite(found.y).all():
            self.stop(Outcome.DIVERGED, float(found.t[-1]), f"position or velocity beyond {FAR:g}")
            return None
        if found.status < 0:
            outcome = Outcome.SOLVER if self.refused is None else Outcome.REFUSED
            self.stop(outcome, float(found.t[-1]), str(self.refused or found.message))
            return None
        self.refused = None
        return np.asarray(found.y[:, -1])

    def _stopping(self, rates: Callable[[float, Array], Array], cost: float) -> Callable[[float, Array], Array]:
        def guarded(t: float, x: Array) -> Array:
            self._spend(cost)
            try:
                return bounded(rates(t, x))
            except MfcError as why:
                self.refused = why
                raise _Stop from why

        return guarded

    def _or_nan(self, rates: Callable[[float, Array], Array], cost: float) -> Callable[[float, Array], Array]:
        def guarded(t: float, x: Array) -> Array:
            self._spend(cost)
            try:
                return bounded(rates(t, x))
            except MfcError as why:
                self.refused = why
                return np.full(x.shape, np.nan)

        return guarded

    def _counted(self, jac: Callable[[float, Array], Array]) -> Callable[[float, Array], Array]:
        def counted(t: float, x: Array) -> Array:
            self._spend(JACOBIAN)
            return jac(t, x)

        return counted

    def _spend(self, work: float) -> None:
        self.spent += work
        if self.spent > self.most + STEP:
            raise _Endless

    def refuse(self, t: float, why: MfcError) -> None:
        """Stops the run where the law cannot be evaluated between two segments."""
        self.stop(Outcome.REFUSED, t, str(why))

    def stop(self, outcome: Outcome, t: float, why: str) -> None:
        self.outcome, self.message = outcome, f"{outcome.value} at t = {t:.4g} s: {why}"

    def _give_up(self, t: float) -> None:
        why = f"{self.most} evaluations of the equations are not enough to reach {self.end:g} s; max_evaluations= allows more"
        self.stop(Outcome.STOPPED, t, why)

    def _used_up(self) -> Any:
        last = np.inf

        def left(t: float, x: Array) -> float:
            nonlocal last
            if self.spent >= self.most:
                last = min(last, t)  # a step ends here: solve_ivp finds its zero at this very time
            return last - t

        left.terminal = True  # type: ignore[attr-defined]  # solve_ivp reads it there
        return left

    def _far(self) -> Any:
        watch = np.concatenate(
            [np.arange(where.start, where.stop) for name, (where, _) in self.equations.parts.items() if name in ("q", "v", "theta", "omega")]
        )

        def far(t: float, x: Array) -> float:
            return FAR - float(np.abs(x[watch]).max())

        far.terminal = True  # type: ignore[attr-defined]  # solve_ivp reads it there
        return far


def bounded(rates: Array) -> Array:
    """The rates unchanged. Raises BadArgument above ``FASTEST``, where the solver would not finish."""
    if not np.abs(rates).max() < FASTEST:
        raise BadArgument("the motion", f"rates of {np.abs(rates).max():.3g}", f"state rates below {FASTEST:g}")
    return rates


class _Endless(Exception):
    """The solver repeats one step and never ends it."""


class _Stop(Exception):
    """The law cannot be evaluated; leaves the solver."""
